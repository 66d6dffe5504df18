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
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Protocol

from threadpoolctl import threadpool_limits

from calib.errors import EvaluationError, InputError

Function = Callable[[Mapping[str, float]], Mapping[str, float]]
Source = Callable[[], Function]

WORKER_DIED = "the worker process died"
OUT_OF_MEMORY = "there was not enough memory"

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
        return self.error in (WORKER_DIED, OUT_OF_MEMORY)


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
        responses = {str(name): float(value) for name, value in function(dict(given)).items()}
        error = next((f"the response {n!r} is {v}" for n, v in responses.items() if math.isinf(v)), "")
    except InputError:
        raise
    except MemoryError:
        error = OUT_OF_MEMORY
    except EvaluationError as fault:
        error = _one_line(str(fault)) or "it cannot be evaluated"
    except (Exception, SystemExit) as fault:  # a model that calls sys.exit must not end the study
        error = _one_line(f"{type(fault).__name__}: {fault}")
    seconds = time.perf_counter() - started
    if error:
        return Outcome(given, "failed", {}, error, seconds)
    return Outcome(given, "ok", responses, "", seconds)


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

    Raises
    ------
    InputError
        When ``workers`` is below 1.
    """

    def __init__(self, source: Source, workers: int = 1):
        if workers < 1:
            raise InputError(f"{workers} workers are asked", place="workers", remedy="ask for at least 1")
        self.source = source
        self.workers = workers
        self._function: Function | None = None
        self._pool: ProcessPoolExecutor | None = None

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
            one that kills again has failed.

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
        futures: list[Future[Outcome | Exception]] = []
        with contextlib.suppress(BrokenProcessPool):
            for values in points:
                futures.append(self._submit(_work, values))
        outcomes: list[Outcome | None] = [None] * len(points)
        for k, future in enumerate(futures):
            with contextlib.suppress(BrokenProcessPool):
                outcomes[k] = _opened(future.result())
        if any(outcome is None for outcome in outcomes):
            self._stop(at_once=True)
        return [self._alone(v) if o is None else o for v, o in zip(points, outcomes, strict=True)]

    def _alone(self, values: Mapping[str, float]) -> Outcome:
        """Evaluate one point with nothing else under way, so that a dying process is this point's doing."""
        if self._pool is None:
            try:
                self._submit(_ready, {}).result()
            except BrokenProcessPool:
                raise InputError(
                    "the worker processes end while they start",
                    place="workers",
                    remedy="use one worker to see why; a script of your own must guard its main part",
                ) from None
        started = time.perf_counter()
        try:
            return _opened(self._submit(_work, values).result())
        except BrokenProcessPool:
            self._stop(at_once=True)
            given = {str(name): float(value) for name, value in values.items()}
            return Outcome(given, "failed", {}, WORKER_DIED, time.perf_counter() - started)

    def _submit(
        self, task: Callable[[dict[str, float]], Outcome | Exception], values: Mapping[str, float]
    ) -> Future[Outcome | Exception]:
        if self._pool is None:
            pickle.dumps(self.source)  # fails here in plain words, and not in a half-started process
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.workers, context, _start_worker, (self.source,))
        # Processes are started on demand, while a task is handed over.
        with _environment_of_workers():
            return self._pool.submit(task, dict(values))

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


def _start_worker(source: Source) -> None:
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


def _leave_with_parent() -> None:
    """End this process when its parent is gone: it would otherwise wait for tasks for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _ready(values: Mapping[str, float]) -> Outcome:
    return Outcome(dict(values), "ok", {})


def _work(values: Mapping[str, float]) -> Outcome | Exception:
    if _Worker.fault is not None:
        return _Worker.fault
    assert _Worker.function is not None
    try:
        return attempt(_Worker.function, values)
    except InputError as fault:
        return fault
