"""Figures of a folder drawn in two processes: this one from the beginning of their list, another from its end."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.sharedctypes import SynchronizedArray

from calib import interrupt, worker
from calib.report.figures import Asked, Figures, Made
from calib.report.shown import Shown

ENOUGH = 12
"""Figures from which on a second process, which takes two seconds to start, is worth its while."""


@contextmanager
def in_two_processes(figures: Figures, asking: Callable[[], Asked], cores: int) -> Iterator[None]:
    """While this lasts, a second process draws some of the figures, where there are enough and a core for it.

    Both draw the same: a figure that the other has begun is taken from it, any other is drawn here. When the other
    process dies, all others are drawn here.

    Parameters
    ----------
    figures : Figures
    asking : callable
        Gives what is made of each figure; called where there is a second process.
    cores : int
        Processor cores that may be used.
    """
    if cores < 2 or len(figures.plan) < ENOUGH:
        yield
        return
    asked, context = asking(), get_context("spawn")
    names = list(figures.plan)
    begun = context.Array("b", len(names))
    given = (figures.folder, figures.title, figures.synthetic, begun)
    with ProcessPoolExecutor(1, context, _start, given) as pool:
        with interrupt.held(), worker.environment(script=False):
            # pages show their figures about in this order
            other = {name: pool.submit(_make, k, asked) for k, name in reversed(list(enumerate(names)))}

        def take(name: str) -> Made | None:
            if not _is_first(begun, names.index(name)):
                try:
                    return other[name].result()
                except BrokenExecutor:
                    pass
            return None

        try:
            with figures.helped(take, asked):
                yield
        finally:
            for k in range(len(names)):
                _is_first(begun, k)  # nothing is drawn in vain after an interruption


def _is_first(begun: SynchronizedArray[int], number: int) -> bool:
    """Whether nobody has begun a figure; from now on somebody has."""
    with begun.get_lock():
        before, begun[number] = begun[number], 1
        return not before


class _Second:
    """State of the second process."""

    figures: Figures
    begun: SynchronizedArray[int]


def _start(folder: Shown, title: str, synthetic: bool, begun: SynchronizedArray[int]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process decides when to stop
    worker.leave_with_parent()
    _Second.figures, _Second.begun = Figures(folder, title, synthetic), begun


def _make(number: int, asked: Asked) -> Made | None:
    """A figure by its number; None where the first process has begun it."""
    figures = _Second.figures
    return figures.made(list(figures.plan)[number], asked) if _is_first(_Second.begun, number) else None
