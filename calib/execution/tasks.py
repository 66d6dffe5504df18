"""Independent tasks: one function over many items, done in this process unless others share them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import Protocol, TypeVar

from threadpoolctl import ThreadpoolController, threadpool_limits

S = TypeVar("S")
I = TypeVar("I")  # noqa: E741
R = TypeVar("R")

Told = Callable[[int], None]
"""Receives the number of finished tasks before each one that this process does."""


def unreported(done: int) -> None:
    """Nobody listens."""


class Share(Protocol):
    """Does the tasks of `each`, as `calib.execution.team.Team` does; results are those of `in_this_process`."""

    def __call__(
        self, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported
    ) -> list[R]:
        """See `each`."""
        ...


def in_this_process(function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported) -> list[R]:
    """Do all tasks in this process, in order; numerical libraries use one thread, as in every other process."""
    out = []
    with one_thread():
        for k, item in enumerate(items):
            told(k)
            out.append(function(shared, item))
    return out


_in_use: ContextVar[Share] = ContextVar("tasks", default=in_this_process)


def each(function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported) -> list[R]:
    """``function(shared, item)`` for every item, in their order.

    Whoever shares the tasks, see `shared_by`, changes no digit of the results.

    Parameters
    ----------
    function : callable
        Defined in a module, so that other processes can import it. It changes neither argument.
    shared : object
        What all tasks need; sent once to each other process, where large arrays in it stay until the next call: nobody
        changes them between calls.
    items : sequence
    told : callable
        Receives the number of finished tasks before each one that this process does.

    Raises
    ------
    Exception
        That of the first task that fails, in the order of the items.
    """
    return _in_use.get()(function, shared, items, told)


def are_shared() -> bool:
    """Whether somebody shares the tasks of `each`."""
    return _in_use.get() is not in_this_process


def processes() -> int:
    """Processes of this machine that share the tasks of `each`; 1 where a cluster takes the long ones."""
    return int(getattr(_in_use.get(), "processes", 1))


@contextmanager
def shared_by(share: Share) -> Iterator[None]:
    """While this lasts, the tasks of `each` are shared by ``share``."""
    before = _in_use.set(share)
    try:
        yield
    finally:
        _in_use.reset(before)


def one_thread() -> threadpool_limits:
    """Context in which numerical libraries use one thread: rounding depends on their number, and more are slower."""
    return _libraries(len(sys.modules)).limit(limits=1)


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Loaded libraries, cached by the number of modules: finding them takes longer than evaluating a small model."""
    return ThreadpoolController()
