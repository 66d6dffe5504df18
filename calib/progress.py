"""Progress bars on the error stream; none when it is not a terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from calib.terminal import ERR


@contextmanager
def samples() -> Iterator[Callable[[int, int], None]]:
    """A bar over samples."""
    with _bar(TextColumn("{task.completed:.0f}/{task.total:.0f} samples")) as bar:
        task: TaskID | None = None

        def step(done: int, total: int) -> None:
            nonlocal task
            if task is None:
                task = bar.add_task("sampling", total=total)
            bar.update(task, completed=done)

        yield step


@contextmanager
def search() -> Iterator[Callable[[str, int, int, float], None]]:
    """One bar per case with generation, best misfit and time left."""
    columns = (TextColumn("generation {task.completed:.0f}/{task.total:.0f}"), TextColumn("best {task.fields[best]}"))
    with _bar(*columns) as bar:
        tasks: dict[str, TaskID] = {}

        def step(case: str, generation: int, generations: int, best: float) -> None:
            if case not in tasks:
                tasks[case] = bar.add_task(case, total=generations, best="-")
            bar.update(tasks[case], completed=generation, best=f"{best:.5g}" if math.isfinite(best) else "-")

        yield step


@contextmanager
def doing() -> Iterator[Callable[[str], None]]:
    """A line that names the current step."""
    with Progress(
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        console=ERR,
        disable=not ERR.is_terminal,
        transient=True,
    ) as bar:
        task = bar.add_task("", total=None)
        yield lambda words: bar.update(task, description=words)


def _bar(*columns: TextColumn) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        *columns,
        TimeRemainingColumn(elapsed_when_finished=True),
        console=ERR,
        disable=not ERR.is_terminal,
    )
