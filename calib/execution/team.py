"""Team: this process and others that share independent tasks."""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import time
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from multiprocessing.context import SpawnContext
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from calib.errors.errors import InputError
from calib.execution import interrupt, tasks, worker
from calib.execution.memory import FreedMemory
from calib.execution.outcome import NotSent
from calib.execution.shared_store import SharedStore, can_be_sent, read
from calib.execution.tasks import I, R, S, Told, one_thread, unreported

_MOST = 1024
"""Tasks of one call; more are done in several."""
_WORTH = 0.3
"""Expected seconds of a call's tasks below which this process does them alone: sending takes about a tenth of it."""
_TO_START = 2.0
"""Seconds that the others take to start."""


class Team:
    """Shares the tasks of `calib.execution.tasks.each` between this process and others.

    This process begins with the first task, the others begin with the last, until they meet. Each task has the same
    result in every process: numerical libraries use one thread. What cannot be sent, fails elsewhere, or dies with its
    process is done here, so that a failure is that of `calib.execution.tasks.in_this_process`. So are tasks within a
    task.

    Parameters
    ----------
    workers : int
        Processes, this one included.
    patience : float
        Seconds of tasks after which the others are started; at once where a call is expected to take longer than that
        and their start together.

    Raises
    ------
    InputError
        When ``workers`` is below 1.
    """

    def __init__(self, workers: int, patience: float = 0.0):
        if workers < 1:
            raise InputError(f"{workers} workers are requested", place="workers", remedy="request at least 1")
        self.workers = workers
        self._patience = patience
        self._seconds: dict[object, float] = {}
        self._spent = 0.0
        self._calls = 0
        self._board: _Board | None = None
        self._pool: ProcessPoolExecutor | None = None
        self._store: SharedStore | None = None
        self._able = workers > 1
        self._unsent: set[object] = set()
        self._within = False

    def __enter__(self) -> Team:
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """End the other processes, whatever they do."""
        try:
            with interrupt.held():  # one that comes before they are killed would leave them
                pool, self._pool = self._pool, None
                # The executor can only wait for running tasks; public ways to end them exist from Python 3.14 on.
                for process in list((getattr(pool, "_processes", None) or {}).values()):
                    process.kill()
            if pool is not None:
                pool.shutdown(wait=True, cancel_futures=True)
        finally:
            store, self._store = self._store, None
            if store is not None:
                store.close()

    @property
    def processes(self) -> int:
        """Processes that do tasks, this one included, once the others have been started."""
        return self.workers if self._able else 1

    @property
    def shares(self) -> bool:
        """Whether other processes have been started, and are able to help."""
        return self._pool is not None and self._able

    def __call__(
        self, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported
    ) -> list[R]:
        """Results in the order of the items; see `calib.execution.tasks.each`."""
        if len(items) > _MOST:
            first = self(function, shared, items[:_MOST], told)
            return first + self(function, shared, items[_MOST:], lambda done: told(_MOST + done))
        if self._within:
            return tasks.in_this_process(function, shared, items, told)
        began = time.perf_counter()
        try:
            return self._results(function, shared, items, told)
        finally:
            if self._is_worth(function, len(items)):
                self._spent += time.perf_counter() - began

    def _is_worth(self, function: object, count: int) -> bool:
        """Whether tasks are worth sending; those of a function that has not been called yet may be."""
        return count > 1 and self._seconds.get(function, _WORTH) * count >= _WORTH

    def _results(self, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told) -> list[R]:
        """Tasks of a call: together or alone; before others are started, the first one shows whether that pays off."""
        first: list[R] = []
        impatient = self._spent >= self._patience
        known = impatient and (function in self._seconds or not self._patience)
        if self._able and self._pool is None and not known and len(items) > 1:
            first, items = self._alone(function, shared, items[:1], told), items[1:]
            if self._seconds[function] * (1 + len(items)) < (_WORTH if impatient else self._patience + _TO_START):
                return first + self._alone(function, shared, items, lambda done: told(1 + done))
        own = (lambda done: told(1 + done)) if first else told
        worth = self._is_worth(function, len(items))
        ready = worth and self._able and can_be_sent(function) and function not in self._unsent
        content = self._written(function, shared, items) if ready else None
        numbers = None if content is None else self._submitted(content, len(items))
        if numbers is None:
            return first + self._alone(function, shared, items, own)
        self._within = True
        try:
            return first + self._together(numbers, function, shared, items, own)
        finally:
            self._within = False

    def _alone(self, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told) -> list[R]:
        began = time.perf_counter()
        found = tasks.in_this_process(function, shared, items, told)
        if items:
            self._seconds[function] = (time.perf_counter() - began) / len(items)
        return found

    def _one(self, function: Callable[[S, I], R], shared: S, item: I) -> R:
        began = time.perf_counter()
        found = function(shared, item)
        self._seconds[function] = time.perf_counter() - began
        return found

    def _written(self, *content: object) -> Path | None:
        """File of what a call shares; None where it cannot be sent, which is not tried again for its function."""
        try:
            if self._store is None:
                self._store = SharedStore()
            return self._store.written(content)
        except Exception:  # a class may raise anything from its own `__reduce__` or `__getstate__`
            self._unsent.add(content[0])
        return None

    # -- one call ------------------------------------------------------------------------------------------------------

    def _together(
        self,
        numbers: dict[Future[Any], int],
        function: Callable[[S, I], R],
        shared: S,
        items: Sequence[I],
        told: Told,
    ) -> list[R]:
        ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        for future in numbers:
            future.add_done_callback(ended.put)
        found: dict[int, R] = {}
        elsewhere: set[int] = set()
        lost: set[int] = set()
        assert self._board is not None

        def arrived(future: Future[Any]) -> None:
            k = numbers[future]
            answer = self._answer(future)
            if isinstance(answer, _Done):
                found[k] = answer.result
            elif answer is not None:
                lost.add(k)
                if not answer.begun:
                    self._unsent.add(function)

        try:
            with one_thread():
                for k, item in enumerate(items):
                    if not self._board.is_first(self._calls, k):
                        elsewhere.add(k)
                        continue
                    with contextlib.suppress(queue.Empty):
                        while True:
                            arrived(ended.get_nowait())
                    told(len(found))
                    found[k] = self._one(function, shared, item)
                while elsewhere - found.keys() - lost:
                    # A queue, unlike `wait`, may be interrupted anywhere; see `calib.execution.evaluate`.
                    arrived(interrupt.next_of(ended))
                for k in sorted(lost - found.keys()):
                    found[k] = function(shared, items[k])
        except BaseException:  # KeyboardInterrupt too
            self._board.begin(0)  # what nobody has begun is not begun any more
            raise
        return [found[k] for k in range(len(items))]

    def _submitted(self, content: Path, count: int) -> dict[Future[Any], int] | None:
        """Numbers of a call's tasks, as the others will do them; None where the others cannot be started."""
        self._calls += 1
        numbers: dict[Future[Any], int] = {}
        try:
            if self._pool is None:
                context = multiprocessing.get_context("spawn")
                self._board = _Board(context)
                self._pool = ProcessPoolExecutor(
                    self.workers - 1, context, interrupt.obey_parent, (interrupt.Following(_start, self._board),)
                )  # fmt: skip
            assert self._board is not None
            self._board.begin(self._calls)
            with interrupt.held(), worker.environment(script=False):
                for k in reversed(range(count)):
                    numbers[self._pool.submit(_task, self._calls, k, content)] = k
        except BrokenExecutor:
            self._able = False
        except OSError:  # no memory or no process is left; what waits for one is nobody's any more
            self._able = False
            if self._board is not None:
                self._board.begin(0)
            return None
        return numbers

    def _answer(self, future: Future[Any]) -> _Done | _Lost | None:
        """What a task returned; None where this process has done it."""
        try:
            answer: _Done | _Lost | None = future.result()
            return answer
        except BrokenExecutor:
            self._able = False
        except Exception:  # a result that cannot be sent
            pass
        return _Lost()


class _Done:
    """The result of a task."""

    def __init__(self, result: Any):
        self.result = result


class _Lost:
    """A task that another process could not do; not ``begun`` where what its function needs could not be sent."""

    def __init__(self, begun: bool = True):
        self.begun = begun


class _Board:
    """Shared memory in which processes note the tasks of the present call that have been begun."""

    def __init__(self, context: SpawnContext):
        self._call = context.Value("q", 0)
        self._begun = context.Array("b", _MOST, lock=False)

    def begin(self, call: int) -> None:
        """From now on, tasks of this call only are to be done."""
        with self._call.get_lock():
            self._call.value = call
            self._begun[:] = [0] * len(self._begun)

    def is_open(self, call: int, number: int) -> bool:
        """Whether nobody has begun a task of the present call."""
        with self._call.get_lock():
            return bool(self._call.value == call and not self._begun[number])

    def is_first(self, call: int, number: int) -> bool:
        """Whether nobody has begun a task of the present call; from now on somebody has."""
        with self._call.get_lock():
            if self._call.value != call or self._begun[number]:
                return False
            self._begun[number] = 1
            return True


# -- in other processes ------------------------------------------------------------------------------------------------


class _Helper:
    """State of another process."""

    board: _Board
    limits: object = None
    path: Path | None = None
    content: tuple[Callable[..., Any], Any, Sequence[Any]]
    memory = FreedMemory()


def _start(board: _Board) -> None:
    worker.quiet_libraries()
    _Helper.limits = threadpool_limits(1)
    _Helper.board = board


def _task(call: int, number: int, path: Path) -> _Done | _Lost | None:
    """One task of a call; None where it has been begun elsewhere.

    What the call shares is read before: it may take long, and others can begin the task meanwhile.
    """
    if not _Helper.board.is_open(call, number):
        return None
    begun = False
    try:
        if _Helper.path != path:
            _Helper.memory.give_back()
            _Helper.content = read(path)
            _Helper.path = path
            _Helper.limits = threadpool_limits(1)  # of libraries loaded meanwhile
        if not _Helper.board.is_first(call, number):
            return None
        function, shared, items = _Helper.content
        begun = True
        return _Done(function(shared, items[number]))
    except NotSent:
        return _Lost(begun=False)
    except BaseException:  # the first process does it again, and fails as it does alone
        return _Lost(begun)
