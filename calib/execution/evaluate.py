"""Batch in, batch out: evaluates named points serially or in worker processes; a failure is a row."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import pickle
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Protocol

from calib.errors.errors import InputError
from calib.execution import interrupt, worker
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED, Function, Individual, Outcome, attempt
from calib.execution.tasks import one_thread
from calib.execution.worker import Source

if TYPE_CHECKING:
    import pandas as pd

Arrived = Callable[[Outcome], None]
"""Callback for every outcome as soon as it is available, in any order."""


def ignored(outcome: Outcome) -> None:
    """Callback that ignores outcomes."""


class BatchEvaluator(Protocol):
    """Anything that evaluates batches: `Evaluator`, or `calib.execution.executor.ExecutorEvaluator`."""

    @property
    def isolated(self) -> bool:
        """Whether points are evaluated in other processes, so that a crash stays confined to its point."""
        ...

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = ignored) -> list[Outcome]:
        """Outcomes in the order of the points; ``arrived`` is called with each as soon as it is available."""
        ...


class Recorder(Protocol):
    """What keeps evaluated points and the history of searches, such as `calib.results.ledger.Ledger`; see there."""

    def evaluate(
        self,
        fingerprint: str,
        points: Sequence[Mapping[str, float]],
        evaluator: BatchEvaluator,
        told: Callable[[int], None],
    ) -> list[Outcome]:
        """Outcomes in the order of the points; those not known are evaluated as one batch and kept."""
        ...

    def record(self, run: str, fingerprint: str, generation: int, individuals: Sequence[Individual]) -> None:
        """Record one generation of a search."""
        ...

    def history(self, run: str) -> pd.DataFrame:
        """Points requested by a run, with ``status``: ``solved``, ``reused``, ``infeasible`` or ``failed``."""
        ...


class Evaluator:
    """Evaluates batches of points with one function, in this process or in several.

    Results do not depend on the number of workers: every point is a task of its own, results are returned in the order
    of the points, and numerical libraries use one thread everywhere.

    Parameters
    ----------
    source : callable
        Builds the evaluation function; it is called once in this process (one worker) or once in every worker process,
        for which it must be picklable.
    workers : int
        1 evaluates in this process, unless ``isolated``.
    time_limit : float, optional
        Seconds after which a point is abandoned and its process killed. The failure counts as transient, since the
        machine may be less busy another time. Only worker processes are limited, this process is not.
    isolated : bool
        Whether a single worker also runs in a process of its own, as several always do. Only then does the batch
        survive a point that kills its process.

    Raises
    ------
    InputError
        When ``workers`` is below 1 or the limit is not positive.
    """

    def __init__(self, source: Source, workers: int = 1, time_limit: float | None = None, isolated: bool = False):
        if workers < 1:
            raise InputError(f"{workers} workers are requested", place="workers", remedy="request at least 1")
        if time_limit is not None and not 0 < time_limit < math.inf:
            raise InputError(
                f"a point is allowed {time_limit:g} s", place="time limit", remedy="give a positive number, or none"
            )
        self.source = source
        self.workers = workers
        self.isolated = isolated or workers > 1
        self.time_limit = time_limit
        self._function: Function | None = None
        self._pool: ProcessPoolExecutor | None = None
        self._ended: queue.SimpleQueue[Future[Outcome | Exception]] = queue.SimpleQueue()
        self._board: worker.Board | None = None
        self._script = True

    def __enter__(self) -> Evaluator:
        return self

    def __exit__(self, kind: object, *fault: object) -> None:
        self._stop(at_once=kind is not None)

    def close(self, at_once: bool = False) -> None:
        """End the worker processes, also one that evaluates a point if ``at_once``."""
        self._stop(at_once)

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = ignored) -> list[Outcome]:
        """Evaluate a batch.

        Parameters
        ----------
        points : sequence of mapping
            Named values.
        arrived : callable
            Called with every outcome as soon as it is available, so that a stop loses only the points in progress.

        Returns
        -------
        list of Outcome
            In the order given. When a worker process dies, the point in progress has failed; of several points in
            progress, those that also kill a process alone have failed. A point beyond the time limit has failed.

        Raises
        ------
        InputError
            The set-up is wrong, or worker processes cannot be started. On any exception the worker processes are
            killed at once.
        """
        if not points:
            return []
        if not self.isolated:
            return self._serial(points, arrived)
        try:
            return self._parallel(points, arrived)
        except BaseException:  # KeyboardInterrupt too: no process may stay behind
            self._stop(at_once=True)
            raise

    # -- in this process -----------------------------------------------------------------------------------------------

    def _serial(self, points: Sequence[Mapping[str, float]], arrived: Arrived) -> list[Outcome]:
        if self._function is None:
            self._function = self.source()
        outcomes = []
        # Sums of multi-threaded libraries depend on the number of threads.
        with one_thread():
            for values in points:
                outcomes.append(attempt(self._function, values))
                arrived(outcomes[-1])
        return outcomes

    # -- in worker processes -------------------------------------------------------------------------------------------

    def _parallel(self, points: Sequence[Mapping[str, float]], arrived: Arrived) -> list[Outcome]:
        outcomes: list[Outcome | None] = [None] * len(points)
        while self._round(points, outcomes, arrived):
            pass
        return [self._alone(v, arrived) if o is None else o for v, o in zip(points, outcomes, strict=True)]

    def _round(self, points: Sequence[Mapping[str, float]], outcomes: list[Outcome | None], arrived: Arrived) -> bool:
        """Fill in missing outcomes; True when a point took too long or killed its process and others are pending."""
        numbers: dict[Future[Outcome | Exception], int] = {}
        late: dict[int, float] = {}

        def known(k: int, outcome: Outcome) -> None:
            outcomes[k] = outcome
            arrived(outcome)

        with contextlib.suppress(BrokenProcessPool):
            for k in [k for k, outcome in enumerate(outcomes) if outcome is None]:
                numbers[self._submit(worker.work, k, points[k])] = k
        waiting = set(numbers)
        while waiting:
            done = waiting & self._finished()
            waiting -= done
            late = self._late() if waiting else {}
            if late:
                self._stop(at_once=True)  # this also ends the other tasks
                done, waiting = done | waiting, set()
            for future in sorted(done, key=numbers.__getitem__):
                with contextlib.suppress(BrokenProcessPool, CancelledError):
                    known(numbers[future], unwrapped(future.result()))
        for k in [k for k in late if outcomes[k] is None]:
            known(k, failed(points[k], f"{TOOK_TOO_LONG} {self.time_limit:g} s", late[k]))
        if not late and any(outcome is None for outcome in outcomes):
            self._stop(at_once=True)
            late = self._died(points, outcomes, known)
        return bool(late)

    def _finished(self) -> set[Future[Outcome | Exception]]:
        """Wait for a task to end, at most until the next check for late tasks; return all that have ended by then.

        `concurrent.futures.wait` takes the locks of all tasks it waits for: an interrupt in between leaves one locked,
        and the pool never ends. This queue may be interrupted anywhere.
        """
        found = set()
        with contextlib.suppress(queue.Empty):
            found.add(self._ended.get(timeout=self._patience()))
            while True:
                found.add(self._ended.get_nowait())
        return found

    def _died(
        self,
        points: Sequence[Mapping[str, float]],
        outcomes: Sequence[Outcome | None],
        known: Callable[[int, Outcome], None],
    ) -> dict[int, float]:
        """Settle the points that were in progress when a process died; of several, each is tried alone."""
        board = self._board
        seen = {} if board is None else {k: s for k, s in board.late(0.0).items() if outcomes[k] is None}
        if len(seen) == 1:
            for k, seconds in seen.items():
                known(k, failed(points[k], WORKER_DIED, seconds))
        else:
            for k in seen:
                known(k, self._alone(points[k], ignored))
        return seen

    def _patience(self) -> float:
        """Seconds between two checks for late tasks, and of an interrupt."""
        return interrupt.SEEN if self.time_limit is None else min(interrupt.SEEN, self.time_limit / 4)

    def _late(self) -> dict[int, float]:
        return {} if self._board is None or self.time_limit is None else self._board.late(self.time_limit)

    def _alone(self, values: Mapping[str, float], arrived: Arrived) -> Outcome:
        """Evaluate one point with nothing else in progress, so that a dying process is due to this point."""
        if self._pool is None:
            try:
                self._submit(worker.ready, 0, {}).result()
            except BrokenProcessPool:
                raise InputError(
                    "the worker processes end while they start",
                    place="workers",
                    remedy="use one worker to see why; a script of your own must guard its main part",
                ) from None
        started = time.perf_counter()
        outcomes: list[Outcome | None] = [None]
        self._round([values], outcomes, arrived)
        if (outcome := outcomes[0]) is None:
            outcome = failed(values, WORKER_DIED, time.perf_counter() - started)
            arrived(outcome)
        return outcome

    def _submit(
        self,
        task: Callable[[int, dict[str, float]], Outcome | Exception],
        number: int,
        values: Mapping[str, float],
    ) -> Future[Outcome | Exception]:
        if self._pool is None:
            self._script = b"__main__" in pickle.dumps(self.source)  # fails here, and not in a half-started process
            context = multiprocessing.get_context("spawn")
            self._board = worker.Board(context, self.workers)
            self._pool = ProcessPoolExecutor(
                self.workers, context, interrupt.obey_parent,
                (interrupt.Following(worker.start, self.source, self._board),),
            )  # fmt: skip
        # Processes are started on demand, while a task is handed over.
        with interrupt.held(), worker.environment(self._script):
            future = self._pool.submit(task, number, dict(values))
            future.add_done_callback(self._ended.put)
        return future

    def _stop(self, at_once: bool) -> None:
        """End the processes; those that have not ended within `interrupt.PATIENCE` are killed."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        manager: threading.Thread | None = None
        processes: list[BaseProcess] = []

        def kill() -> None:
            for process in processes:
                process.kill()

        try:
            # The executor can only wait, for as long as it takes; public ways to end it exist from Python 3.14 on.
            processes += (getattr(pool, "_processes", None) or {}).values()
            manager = getattr(pool, "_executor_manager_thread", None)
            if at_once:
                kill()
            pool.shutdown(wait=at_once, cancel_futures=True)
            if manager is not None:
                manager.join(interrupt.PATIENCE)
        finally:  # KeyboardInterrupt too
            if manager is not None and manager.is_alive():
                kill()
                manager.join()


def failed(values: Mapping[str, float], error: str, seconds: float = 0.0, trace: str = "") -> Outcome:
    """The outcome of a point whose evaluation did not finish."""
    return Outcome({str(name): float(value) for name, value in values.items()}, "failed", {}, error, seconds, trace)


def unwrapped(answer: Outcome | Exception) -> Outcome:
    """The outcome that a task returned; raises the exception that a wrong set-up returned instead."""
    if isinstance(answer, Exception):
        raise answer
    return answer
