"""Bars on the error stream that show how far a command is; where it is no terminal, a line now and then."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

from calib.stage import Progress as Told
from calib.terminal import ERR

SPARSE = 10.0
"""Seconds between two lines where the error stream is no terminal; the first comes after that time."""
_BAR = 24
"""Columns of a bar."""
_STEADY = 3.0
"""Seconds of a stage before its time left is told: earlier it is a guess."""


@contextmanager
def bars(verb: str) -> Iterator[Told]:
    """One bar for the present stage of a command, with the time left where the whole is known."""
    if not ERR.is_terminal:
        yield _Lines(verb)
        return
    words = TextColumn("{task.description}", table_column=Column(ratio=1, overflow="fold"))
    columns = (words, BarColumn(bar_width=_BAR), TimeElapsedColumn(), _Left())
    with Progress(*columns, console=ERR, transient=True, expand=True) as bar:
        yield _Bars(bar, verb)


class _Bars:
    """The present stage on a terminal."""

    def __init__(self, bar: Progress, verb: str) -> None:
        self.bar, self.verb = bar, verb
        self.stage, self.task = "", bar.add_task(verb, total=None)

    def __call__(self, stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        if stage != self.stage:
            self.bar.remove_task(self.task)
            self.stage, self.task = stage, TaskID(self.bar.add_task("", total=None))
        words = in_words(self.verb, stage, done, total, best)
        self.bar.update(self.task, description=words, completed=done, total=total or None)


class _Lines:
    """The present stage in sparse lines, without control characters."""

    def __init__(self, verb: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.verb, self.clock = verb, clock
        self.told, self.stage, self.began, self.first = clock(), "", clock(), 0.0

    def __call__(self, stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        now = self.clock()
        if stage != self.stage:
            self.stage, self.began, self.first = stage, now, done
        if now - self.told < SPARSE:
            return
        self.told = now
        left = time_left(now - self.began, done - self.first, total - self.first)
        ERR.print(in_words(self.verb, stage, done, total, best) + (f", {left} left" if left else ""))


class _Left(ProgressColumn):
    """Time left of a stage."""

    def render(self, task: Task) -> Text:
        if task.total is None:
            return Text("")
        left = time_left(task.elapsed or 0.0, task.completed, task.total)
        return Text(f"{left} left" if left else "", style="progress.remaining")


def in_words(verb: str, stage: str, done: float, total: float, best: float) -> str:
    """The present stage, such as ``calibrate: GB1, genetic search 12/60, best 0.31``."""
    count = f" {done:.0f}/{total:.0f}" if total else ""
    return f"{verb}: {stage}{count}" + (f", best {best:.4g}" if math.isfinite(best) else "")


def time_left(elapsed: float, done: float, total: float) -> str:
    """The remaining time at the average speed so far, such as ``2 min``; empty where it is unknown."""
    if elapsed < _STEADY or done <= 0 or total <= done:
        return ""
    seconds = elapsed * (total - done) / done
    unit, size = next((one for one in (("h", 3600), ("min", 60)) if seconds >= 1.7 * one[1]), ("s", 1))
    return f"{seconds / size:.0f} {unit}"
