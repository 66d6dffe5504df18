"""How far a computation is: a bar on the error stream, a line below a notebook's cell, or lines now and then."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from calib.execution.stage import Progress as Told
from calib.execution.stage import silent

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from calib.results.running import RunningNote

SPARSE = 10.0
"""Seconds between two lines where the error stream is no terminal; the first comes after that time."""
OFTEN = 0.2
"""Seconds between two changes of the line below a notebook's cell."""
_BAR = 24
"""Columns of a bar."""
_STEADY = 3.0
"""Seconds of a stage before its time left is told: earlier it is a guess."""


@cache
def error_stream() -> Console:
    """The error stream, on which progress stands."""
    from rich.console import Console  # who only imports calib needs none

    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


@contextmanager
def bars(verb: str) -> Iterator[Told]:
    """One bar for the present stage of a command, with the time left where the whole is known."""
    stream = error_stream()
    if not stream.is_terminal:
        yield _Lines(verb, stream.print, SPARSE)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # slow to import, and not always shown
    from rich.table import Column

    words = TextColumn("{task.description}", markup=False, table_column=Column(ratio=1, overflow="fold"))
    columns = (words, BarColumn(bar_width=_BAR), TimeElapsedColumn(), TextColumn("{task.fields[remaining]}"))
    with Progress(*columns, console=stream, transient=True, expand=True) as bar:
        yield _Bars(bar, verb)


def noted(told: Told, verb: str, note: RunningNote) -> Told:
    """Tell each stage on, and to a note that other processes read, that one no more often than a cell changes."""
    pace, written = _Pace(verb), [-math.inf]

    def tell(stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        told(stage, done, total, best)
        if pace.tell(stage, done, total, best) or pace.clock() - written[0] >= OFTEN:
            written[0] = pace.clock()
            note.tell(pace.words, pace.stage, done, total, best, pace.remaining)

    return tell


@contextmanager
def in_python(verb: str, wanted: bool = True) -> Iterator[Told]:
    """As `bars` for a call from Python, if wanted: on a terminal or below a notebook's cell; nothing elsewhere."""
    if wanted and error_stream().is_jupyter:
        cell = _Cell()
        try:
            yield _Lines(verb, cell, OFTEN)
        finally:
            cell.clear()
    elif wanted and error_stream().is_terminal:
        with bars(verb) as reported:
            yield reported
    else:
        yield silent


class _Cell:
    """A line below a notebook's cell, replaced by the next one."""

    def __init__(self) -> None:
        self.shown: Any = None

    def __call__(self, words: str) -> None:
        line = {"text/plain": words}
        if self.shown is None:
            self.shown = import_module("IPython.display").display(line, raw=True, display_id=True)
        else:
            self.shown.update(line, raw=True)

    def clear(self) -> None:
        if self.shown is not None:
            self("")


class _Pace:
    """What was told last, in words, and the time left at the average speed since the count began."""

    def __init__(self, verb: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.verb, self.clock = verb, clock
        self.stage = self.words = self.remaining = ""
        self.done = self.total = self.first = 0.0
        self.began = clock()

    def tell(self, stage: str, done: float, total: float, best: float) -> bool:
        """Take a call; whether another stage began."""
        now, other = self.clock(), stage not in ("", self.stage)
        self.stage = stage or self.stage
        # Several stages may share one whole, such as a budget: the count then goes on.
        if total != self.total or done < self.done or (other and total in (0, 1)):
            self.began, self.first = now, done
        self.done, self.total = done, total
        self.words = progress_words(self.verb, self.stage, done, total, best)
        self.remaining = remaining_time(now - self.began, done - self.first, total - self.first)
        return other


class _Bars:
    """The present stage on a terminal."""

    def __init__(self, bar: Progress, verb: str) -> None:
        self.bar, self.pace = bar, _Pace(verb)
        self.task = bar.add_task(verb, total=None, remaining="")

    def __call__(self, stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        if self.pace.tell(stage, done, total, best):
            self.bar.remove_task(self.task)
            self.task = self.bar.add_task("", total=None, remaining="")
        remaining = f"{self.pace.remaining} left" if self.pace.remaining else ""
        self.bar.update(
            self.task, description=self.pace.words, completed=done, total=total or None, remaining=remaining
        )


class _Lines:
    """The present stage in lines without control characters, at most one in ``every`` seconds."""

    def __init__(
        self, verb: str, write: Callable[[str], None], every: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.pace, self.write, self.every, self.clock, self.reported = _Pace(verb, clock), write, every, clock, clock()

    def __call__(self, stage: str, done: float = 0, total: float = 0, best: float = math.nan) -> None:
        self.pace.tell(stage, done, total, best)
        if self.clock() - self.reported >= self.every:
            self.reported = self.clock()
            self.write(self.pace.words + (f", {self.pace.remaining} left" if self.pace.remaining else ""))


def progress_words(verb: str, stage: str, done: float, total: float, best: float) -> str:
    """The present stage, such as ``calibrate: GB1, genetic search 12/60, best 0.31``."""
    count = f" {100 * done:.0f} %" if total == 1 else f" {done:.0f}/{total:.0f}" if total else ""
    return f"{verb}: {stage}{count}" + (f", best {best:.4g}" if math.isfinite(best) else "")


def remaining_time(elapsed: float, done: float, total: float) -> str:
    """The remaining time at the average speed so far, such as ``2 min``; empty where it is unknown."""
    seconds = elapsed * (total - done) / done if elapsed >= _STEADY and done > 0 else 0.0
    if seconds < 1:
        return ""
    unit, size = next((one for one in (("h", 3600), ("min", 60)) if seconds >= 1.7 * one[1]), ("s", 1))
    return f"{seconds / size:.0f} {unit}"
