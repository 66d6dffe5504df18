"""Batch in, batch out: evaluates named points serially or in worker processes; a failure is a row."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing.context import SpawnContext
from types import TracebackType
from typing import Literal, Protocol

from threadpoolctl import threadpool_limits

from calib.errors import EvaluationError, InputError

Function = Callable[[Mapping[str, float]], Mapping[str, float]]
Source = Callable[[], Function]

WORKER_DIED = "the worker process died"
OUT_OF_MEMORY = "there was not enough memory"
TOOK_TOO_LONG = "it took longer than"

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


@dataclass(frozen=True)
class Outcome:
    """One evaluated point.

    Attributes
    ----------
    values : dict
        Named parameters, each in its own unit.
    status : {"ok", "failed"}
    responses : dict
        Named responses, NaN where one is not available; empty for a failed point.
    error : str
        Why it failed, one line; empty when it did not.
    seconds : float
        Time of the evaluation; ignored by comparisons.
    """

    values: dict[str, float]
    status: Literal["ok", "failed"]
    responses: dict[str, float]
    error: str = ""
    seconds: float = field(default=0.0, compare=False)

    @property
    def transient(self) -> bool:
        """Whether the failure is one of the machine, so that another try may succeed."""
        return self.error in (WORKER_DIED, OUT_OF_MEMORY) or self.error.startswith(TOOK_TOO_LONG)


class BatchEvaluator(Protocol):
    """Anything that evaluates batches; `Evaluator` is the one used outside tests."""

    @property
    def workers(self) -> int:
        """Worker processes; 1 evaluates in this process."""
        ...

    def evaluate(self, points: Sequence[Mapping[str, float]]) -> list[Outcome]:
        """Outcomes in the order of the points."""
        ...


def attempt(function: Function, values: Mapping[str, float]) -> Outcome:
    """Evaluate one point; whatever goes wrong there is told in the outcome.

    Parameters
    ----------
    function : callable
        Named values to named responses. NaN is a response that is not available, an infinite one is a failure.
    values : mapping

    Raises
    ------
    InputError
        The set-up is wrong, not the point.
    """
    given = {str(name): float(value) for name, value in values.items()}
    responses: dict[str, float] = {}
    error = ""
    started = time.perf_counter()
    try:
        with _directory_kept():
            answer = function(dict(given))
        responses = {str(name): float(value) for name, value in answer.items()}
        error = next((f"the response {n!r} is {v}" for n, v in responses.items() if math.isinf(v)), "")
    except (InputError, KeyboardInterrupt):
        raise
    except MemoryError:
        error = OUT_OF_MEMORY
    except EvaluationError as fault:
        error = _one_line(str(fault)) or "it cannot be evaluated"
    except BaseException as fault:  # sys.exit, or a panic in foreign code, must not end the study
        error = _one_line(f"{type(fault).__name__}: {fault}")
    seconds = time.perf_counter() - started
    if error:
        return Outcome(given, "failed", {}, error, seconds)
    return Outcome(given, "ok", responses, "", seconds)


@contextlib.contextmanager
def _directory_kept() -> Iterator[None]:
    """A model may leave for another directory, where nothing relative would be found."""
    try:
        before = os.getcwd()
    except OSError:  # somebody removed it
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.chdir(before)


def _one_line(text: str) -> str:
    return " ".join(text.split())[:500]


class Evaluator:
    """Evaluates batches of points with one function, in this process or in several.

    The answers do not depend on the number of workers: every point is a task of its own, answers come in the order
    asked, and numerical libraries use one thread everywhere.

    Parameters
    ----------
    source : callable
        Builds the evaluation function; it is called once in this process (one worker) or once in every worker process,
        for which it must be picklable.
    workers : int
        1 evaluates in this process. A point that kills its process is survived only with more.
    time_limit : float, optional
        Seconds after which a point is given up and its process ended; such a failure is the machine's (another time it
        may be less busy). Only worker processes can be ended: with one worker nothing is limited.

    Raises
    ------
    InputError
        When ``workers`` is below 1 or the limit is not positive.
    """

    def __init__(self, source: Source, workers: int = 1, time_limit: float | None = None):
        if workers < 1:
            raise InputError(f"{workers} workers are asked", place="workers", remedy="ask for at least 1")
        if time_limit is not None and not 0 < time_limit < math.inf:
            raise InputError(
                f"a point is allowed {time_limit:g} s", place="time limit", remedy="give a positive number, or none"
            )
        self.source = source
        self.workers = workers
        self.time_limit = time_limit
        self._function: Function | None = None
        self._pool: ProcessPoolExecutor | None = None
        self._board: _Board | None = None

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop(at_once=kind is not None)

    def close(self) -> None:
        """End the worker processes."""
        self._stop(at_once=False)

    def evaluate(self, points: Sequence[Mapping[str, float]]) -> list[Outcome]:
        """Evaluate a batch.

        Parameters
        ----------
        points : sequence of mapping
            Named values.

        Returns
        -------
        list of Outcome
            In the order given. When a worker process dies, the points without an answer are tried again one by one;
            one that kills again has failed. One that takes too long has failed, too.

        Raises
        ------
        InputError
            The set-up is wrong, or worker processes cannot be started. As with every exception that leaves here,
            worker processes are ended at once.
        """
        if not points:
            return []
        if self.workers == 1:
            return self._serial(points)
        try:
            return self._parallel(points)
        except BaseException:  # also the keyboard's: no process may stay behind
            self._stop(at_once=True)
            raise

    # -- in this process -----------------------------------------------------------------------------------------------

    def _serial(self, points: Sequence[Mapping[str, float]]) -> list[Outcome]:
        if self._function is None:
            self._function = self.source()
        # Sums of multi-threaded libraries depend on the number of threads.
        with threadpool_limits(1):
            return [attempt(self._function, values) for values in points]

    # -- in worker processes -------------------------------------------------------------------------------------------

    def _parallel(self, points: Sequence[Mapping[str, float]]) -> list[Outcome]:
        outcomes: list[Outcome | None] = [None] * len(points)
        while self._round(points, outcomes):
            pass
        return [self._alone(v) if o is None else o for v, o in zip(points, outcomes, strict=True)]

    def _round(self, points: Sequence[Mapping[str, float]], outcomes: list[Outcome | None]) -> bool:
        """Fill in the missing outcomes; True when that was cut short by a point that took too long."""
        futures: dict[int, Future[Outcome | Exception]] = {}
        late: dict[int, float] = {}
        with contextlib.suppress(BrokenProcessPool):
            for k in [k for k, outcome in enumerate(outcomes) if outcome is None]:
                futures[k] = self._submit(_work, k, points[k])
        for k, future in futures.items():
            while not late and not wait_for([future], timeout=self._patience()).done:
                late = self._late()
                if late:
                    self._stop(at_once=True)
            with contextlib.suppress(BrokenProcessPool, CancelledError):
                outcomes[k] = _opened(future.result())
        for k in [k for k in late if outcomes[k] is None]:
            outcomes[k] = _failed(points[k], f"{TOOK_TOO_LONG} {self.time_limit:g} s", late[k])
        if not late and any(outcome is None for outcome in outcomes):
            self._stop(at_once=True)
        return bool(late)

    def _patience(self) -> float | None:
        """Seconds between two looks at what takes too long."""
        return None if self.time_limit is None else min(1.0, self.time_limit / 4)

    def _late(self) -> dict[int, float]:
        return {} if self._board is None or self.time_limit is None else self._board.late(self.time_limit)

    def _alone(self, values: Mapping[str, float]) -> Outcome:
        """Evaluate one point with nothing else under way, so that a dying process is this point's doing."""
        if self._pool is None:
            try:
                self._submit(_ready, 0, {}).result()
            except BrokenProcessPool:
                raise InputError(
                    "the worker processes end while they start",
                    place="workers",
                    remedy="use one worker to see why; a script of your own must guard its main part",
                ) from None
        started = time.perf_counter()
        outcome: list[Outcome | None] = [None]
        self._round([values], outcome)
        return outcome[0] or _failed(values, WORKER_DIED, time.perf_counter() - started)

    def _submit(
        self,
        task: Callable[[int, dict[str, float]], Outcome | Exception],
        number: int,
        values: Mapping[str, float],
    ) -> Future[Outcome | Exception]:
        if self._pool is None:
            pickle.dumps(self.source)  # fails here in plain words, and not in a half-started process
            context = multiprocessing.get_context("spawn")
            self._board = _Board(context, self.workers)
            self._pool = ProcessPoolExecutor(self.workers, context, _start_worker, (self.source, self._board))
        # Processes are started on demand, while a task is handed over.
        with _environment_of_workers():
            return self._pool.submit(task, number, dict(values))

    def _stop(self, at_once: bool) -> None:
        pool, self._pool = self._pool, None
        if pool is None:
            return
        if at_once:
            # The executor can only wait for running tasks; public ways to end them exist from Python 3.14 on.
            for process in list((getattr(pool, "_processes", None) or {}).values()):
                process.kill()
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _environment_of_workers() -> Iterator[None]:
    """What new processes inherit: one thread for numerical libraries, and deafness to the keyboard's interrupt."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    mask = None
    if hasattr(signal, "pthread_sigmask"):
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class _Board:
    """Shared memory in which every worker process notes what it is working on and since when."""

    def __init__(self, context: SpawnContext, workers: int):
        self._places = context.Value("i", 0)
        self._notes = context.Array("d", 2 * workers, lock=False)  # pairs of number and start; nothing under way: 0

    def take_place(self) -> int:
        """A place of its own for a worker process."""
        with self._places.get_lock():
            self._places.value += 1
            return self._places.value - 1

    def note(self, place: int, number: int) -> None:
        """Work on the point of that number begins."""
        self._notes[2 * place] = number
        self._notes[2 * place + 1] = time.monotonic()

    def clear(self, place: int) -> None:
        """Work has ended."""
        self._notes[2 * place + 1] = 0.0

    def late(self, limit: float) -> dict[int, float]:
        """Points under way for longer than the limit, with how long."""
        now = time.monotonic()
        pairs = list(zip(self._notes[::2], self._notes[1::2], strict=True))
        return {int(number): now - start for number, start in pairs if start and now - start > limit}


def _failed(values: Mapping[str, float], error: str, seconds: float) -> Outcome:
    return Outcome({str(name): float(value) for name, value in values.items()}, "failed", {}, error, seconds)


def _opened(answer: Outcome | Exception) -> Outcome:
    if isinstance(answer, Exception):
        raise answer
    return answer


# -- inside a worker ---------------------------------------------------------------------------------------------------


class _Worker:
    """What a worker process keeps between tasks."""

    function: Function | None = None
    fault: Exception | None = None
    limits: object = None
    board: _Board
    place: int


def _start_worker(source: Source, board: _Board) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    try:
        _Worker.function = source()
    except InputError as fault:
        _Worker.fault = fault
    except Exception as fault:
        # An exception of the user's own class may not survive the way back.
        _Worker.fault = RuntimeError(f"the model cannot be built in a worker: {type(fault).__name__}: {fault}")
        _Worker.fault.add_note(traceback.format_exc())
    _Worker.limits = threadpool_limits(1)
    _Worker.board, _Worker.place = board, board.take_place()


def _leave_with_parent() -> None:
    """End this process when its parent is gone: it would otherwise wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _ready(number: int, values: Mapping[str, float]) -> Outcome:
    return Outcome(dict(values), "ok", {})


def _work(number: int, values: Mapping[str, float]) -> Outcome | Exception:
    if _Worker.fault is not None:
        return _Worker.fault
    assert _Worker.function is not None
    _Worker.board.note(_Worker.place, number)
    try:
        return attempt(_Worker.function, values)
    except InputError as fault:
        return fault
    finally:
        _Worker.board.clear(_Worker.place)
