"""Ahead: points that independent computations will ask of a function, evaluated as one batch before they run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

from calib.errors.errors import EvaluationError
from calib.execution.outcome import PointWanted

_ROUNDS = 3
"""Batches for one set of computations: an effect may ask its function twice, at points that need no result."""


class Batched(Protocol):
    """A function that keeps its results, and evaluates several points at once."""

    def ahead(self, points: Sequence[Mapping[str, float]]) -> None:
        """Evaluate points that are about to be asked for; a failure is kept like any result."""
        ...


class _Wanted:
    """Points that the computations of one `evaluated_together` asked for, and whether they asked a function at all."""

    def __init__(self, leaves: bool = True) -> None:
        self.points: list[tuple[Batched, Mapping[str, float]]] = []
        self.asked = False
        self.leaves = leaves
        """Whether a computation is left at a point that is not known; else that is evaluated."""


_collecting: ContextVar[_Wanted | None] = ContextVar("collecting", default=None)
_shared: ContextVar[bool] = ContextVar("shared", default=False)


@contextmanager
def in_advance() -> Iterator[None]:
    """While this lasts, results serve only to learn what will be asked: `is_collecting`, but every point is solved."""
    token = _collecting.set(_Wanted(leaves=False))
    try:
        yield
    finally:
        _collecting.reset(token)


@contextmanager
def points_shared() -> Iterator[None]:
    """While this lasts, functions may be evaluated by several workers, and `evaluated_together` has an effect."""
    token = _shared.set(True)
    try:
        yield
    finally:
        _shared.reset(token)


def is_collecting() -> bool:
    """Whether results are not used now: the computation runs only to learn which points it asks for."""
    return _collecting.get() is not None


def is_in_advance() -> bool:
    """Whether this is so within `in_advance`, where every point is solved."""
    wanted = _collecting.get()
    return wanted is not None and not wanted.leaves


def ask(function: Batched, values: Mapping[str, float], is_known: Callable[[], bool]) -> None:
    """Note, while points are collected, that a function is asked; PointWanted where its result is not known."""
    wanted = _collecting.get()
    if wanted is None or not wanted.leaves:
        return
    wanted.asked = True
    if not is_known():
        wanted.points.append((function, dict(values)))
        raise PointWanted


def evaluated_together(computations: Iterable[Callable[[], object]]) -> bool:
    """Evaluate as one batch all points that some computations will ask of functions that keep their results.

    Every computation is run, and left where it asks for a point that is not known; their results are not used. Whoever
    runs them afterwards finds the points known, so that results do not depend on whether this was called. Where the
    first one asks no such function, nothing is gained, and no other is run.

    Within the computations of another call the points are left to that one.

    Returns
    -------
    bool
        Whether they ask such a function.
    """
    outer, waiting = _collecting.get(), list(computations)
    if not _shared.get() or is_in_advance():
        return False
    asked = False
    for _ in range(_ROUNDS):
        wanted = _Wanted()
        waiting = list(_left(waiting, wanted))
        if outer is not None:
            outer.points += wanted.points
            outer.asked = outer.asked or wanted.asked
            if waiting:
                raise PointWanted
        for function in {id(function): function for function, _ in wanted.points}.values():
            function.ahead([values for owner, values in wanted.points if owner is function])
        asked = asked or wanted.asked
        if not waiting:
            break
    return asked


def _left(computations: Sequence[Callable[[], object]], wanted: _Wanted) -> Iterator[Callable[[], object]]:
    """Computations that ask for a point that is not known."""
    for computation in computations:
        token = _collecting.set(wanted)
        try:
            computation()
        except PointWanted:
            yield computation
        except EvaluationError:  # of a point that is known to fail
            pass
        finally:
            _collecting.reset(token)
        if not wanted.asked:
            return
