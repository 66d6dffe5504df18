"""Batch evaluation by an executor that the user supplies: threads, processes, or a cluster's client."""

from __future__ import annotations

import contextlib
import pickle
import queue
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, Union

from calib.errors.errors import InputError
from calib.execution import interrupt, worker
from calib.execution.evaluate import Arrived, failed, ignored, unwrapped
from calib.execution.outcome import TOOK_TOO_LONG, WORKER_DIED, Outcome, directory_kept, error_line
from calib.execution.stage import Tell, warned
from calib.execution.tasks import Share, one_thread
from calib.execution.worker import Source

if TYPE_CHECKING:
    from distributed import Client

    from calib.execution.cluster import Cluster, ClusterEvaluator

_Task = Future[Outcome | Exception]
AnyExecutor: TypeAlias = Union[Executor, "Injected", "Client", str]
"""What takes the place of own processes: an executor, a Dask client, or a cluster by name."""


@dataclass(frozen=True)
class Injected:
    """An executor and the guarantees it gives; none by default, as in `concurrent.futures`.

    Attributes
    ----------
    executor : concurrent.futures.Executor or Cluster
        The caller owns an executor and shuts it down. A cluster keeps every limit and survives crashes.
    time_limit : float or None
        Seconds after which it ends a task, whose future then raises `TimeoutError`; None where it ends none.
    isolated : bool
        Whether the executor and its other tasks survive a task that kills its process.

    Raises
    ------
    InputError
        For an object that is not an executor, and for a limit that is not positive.
    """

    executor: Executor | Cluster
    time_limit: float | None = None
    isolated: bool = False

    def __post_init__(self) -> None:
        if not (isinstance(self.executor, Executor) or self.cluster):
            raise InputError(
                f"it is of type {type(self.executor).__name__}", place="executor",
                remedy="give one of concurrent.futures, a Dask client, 'dask', or 'dask://HOST:PORT'",
            )  # fmt: skip
        if self.time_limit is not None and not self.time_limit > 0:
            raise InputError(
                f"it ends tasks after {self.time_limit:g} s", place="executor",
                remedy="state a positive number, or none",
            )  # fmt: skip

    @property
    def cluster(self) -> Cluster | None:
        """The cluster; None for an executor."""
        known = sys.modules.get("calib.execution.cluster")  # it is loaded for those who ask for one
        return self.executor if known is not None and isinstance(self.executor, known.Cluster) else None

    def require(self, time_limit: float | None, isolated: bool = False) -> None:
        """InputError for a time limit or an isolation that the executor is not stated to support."""
        if self.cluster is not None:
            return
        own = self.time_limit
        if time_limit is not None and own != time_limit:
            does = "is not stated to end any" if own is None else f"ends them after {own:g} s"
            raise InputError(
                f"a point is allowed {time_limit:g} s, and the executor {does}", place="time limit",
                remedy="leave it out, or state by calib.execution.executor.Injected what limit the executor keeps",
            )  # fmt: skip
        if isolated and not self.isolated:
            raise InputError(
                "a point that kills its process must be survived, and the executor is not stated to do so",
                place="isolation",
                remedy="leave it out, or state by calib.execution.executor.Injected that the executor does",
            )

    @staticmethod
    def of(given: AnyExecutor, workers: int | None = None, tell: Tell = warned) -> Injected:
        """The argument itself; a bare executor is wrapped as one without further guarantees.

        Parameters
        ----------
        given : Executor, Injected, distributed.Client or str
            ``"dask"`` starts a cluster on this machine when it is first used, ``"dask://HOST:PORT"`` names a scheduler.
        workers : int, optional
            Of the cluster on this machine; one per core by default.
        tell : callable
            Receives what the user should know of a cluster at once, in one sentence.

        Raises
        ------
        InputError
            For anything else, and for a number of workers of what has its own.
        """
        from calib.execution.cluster import ADDRESS, LOCAL, Cluster

        if workers is not None and given != LOCAL:
            raise InputError(
                f"{workers} workers are requested, and an executor has its own", place="executor",
                remedy="leave one of them out",
            )  # fmt: skip
        if isinstance(given, Injected):
            return given
        if isinstance(given, str):
            if given != LOCAL and not ADDRESS.fullmatch(given):
                raise InputError(
                    f"{given!r:.60} names no cluster", place="executor",
                    remedy=f"write '{LOCAL}' for this machine, or 'dask://HOST:PORT'",
                )  # fmt: skip
            return Injected(Cluster(given, workers, tell=tell))
        cluster = Cluster.of_client(given, tell)
        return Injected(given if cluster is None else cluster)

    def evaluator(
        self, source: Source, time_limit: float | None = None, usual_limit: float | None = None
    ) -> ExecutorEvaluator | ClusterEvaluator:
        """Evaluator of batches of points.

        Parameters
        ----------
        source : callable
            See `ExecutorEvaluator`.
        time_limit : float, optional
            Seconds after which a point has to be abandoned.
        usual_limit : float, optional
            The same where none has to be kept, for those who can.

        Raises
        ------
        InputError
            For a time limit that the executor is not stated to support.
        """
        if self.cluster is not None:
            return self.cluster.evaluator(source, time_limit or usual_limit, required=time_limit is not None)
        return ExecutorEvaluator(source, self, time_limit)

    def tasks(self, others: Share) -> Share:
        """Who does independent tasks: a cluster what takes long, ``others`` the rest, and all without one."""
        if self.cluster is None:
            return others
        from calib.execution.cluster_tasks import ClusterTasks

        return ClusterTasks(self.cluster, others)

    @property
    def at_once(self) -> int:
        """Points that it evaluates at once, as far as is known: 1 for an executor."""
        return 1 if self.cluster is None else max(1, self.cluster.threads())

    def close(self) -> None:
        """Release a cluster; what the caller owns stays open."""
        if self.cluster is not None:
            self.cluster.close()


@contextmanager
def injected(given: AnyExecutor | None, workers: int | None = None, tell: Tell = warned) -> Iterator[Injected | None]:
    """As `Injected.of`, and released at the end unless the caller made it; None for none, and for own processes."""
    found = None if given is None or given == "processes" else Injected.of(given, workers, tell)
    try:
        yield found
    finally:
        if found is not None and found is not given:
            found.close()


class ExecutorEvaluator:
    """Evaluates batches of points by a given executor; the results are those of `calib.execution.evaluate.Evaluator`.

    Every point is a task of its own, and results are returned in the order of the points. Numerical libraries use one
    thread: in this process until the batch is done, in others from their first task on. Threads share their process:
    a function must not change what its other calls see, such as the working directory.

    Parameters
    ----------
    source : callable
        Builds the evaluation function, once in every process. It is sent with every task; an executor with other
        processes must be able to pickle it.
    executor : concurrent.futures.Executor or Injected
    time_limit : float, optional
        Seconds after which a point is to be abandoned.
    isolated : bool
        Whether a point that kills its process must be survived.

    Raises
    ------
    InputError
        For a time limit or an isolation that the executor is not stated to support.
    """

    def __init__(
        self, source: Source, executor: Executor | Injected, time_limit: float | None = None, isolated: bool = False
    ):
        self._injected = Injected.of(executor)
        self._injected.require(time_limit, isolated)
        assert isinstance(self._injected.executor, Executor)
        self._executor = self._injected.executor
        self._sent = worker.Sent(source)

    @property
    def isolated(self) -> bool:
        """Whether the executor states that it survives a point that kills its process."""
        return self._injected.isolated

    def __enter__(self) -> ExecutorEvaluator:
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the function; the executor stays open."""
        self._sent.forget()

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = ignored) -> list[Outcome]:
        """As `calib.execution.evaluate.Evaluator.evaluate`; ``arrived`` is called in this thread.

        A point whose worker died, or that the executor refused, cancelled or lost, has failed. InputError also for a
        set-up that cannot be sent to other processes. On any exception waiting tasks are cancelled; running ones
        cannot be ended.
        """
        outcomes: dict[int, Outcome] = {}
        numbers: dict[_Task, int] = {}
        ended: queue.SimpleQueue[_Task] = queue.SimpleQueue()

        def known(k: int, outcome: Outcome) -> None:
            outcomes[k] = outcome
            arrived(outcome)

        try:
            # Threads of this process share both.
            with one_thread(), directory_kept():
                for k, values in enumerate(points):
                    try:
                        future: _Task = self._executor.submit(worker.work_anywhere, self._sent, dict(values))
                    except Exception as fault:  # a given executor raises what it likes: the point is a failed row
                        known(k, self._lost(values, fault))
                        continue
                    numbers[future] = k
                    future.add_done_callback(ended.put)
                for _ in range(len(numbers)):
                    # A queue, unlike `wait`, may be interrupted anywhere; see `Evaluator._finished`.
                    k = numbers[future := interrupt.next_of(ended)]
                    try:
                        answer = future.result()
                    except Exception as fault:  # whatever ended the task, of the executor's own classes too
                        known(k, self._lost(points[k], fault))
                    else:
                        known(k, unwrapped(answer))
        except BaseException:  # KeyboardInterrupt too
            for future in numbers:
                with contextlib.suppress(Exception):
                    future.cancel()
            raise
        return [outcomes[k] for k in range(len(points))]

    def _lost(self, values: Mapping[str, float], fault: BaseException) -> Outcome:
        """The failed outcome of a point that was not evaluated; InputError where the source cannot be pickled."""
        limit = self._injected.time_limit
        if limit is not None and isinstance(fault, TimeoutError):
            return failed(values, f"{TOOK_TOO_LONG} {limit:g} s", limit)
        if isinstance(fault, BrokenExecutor):
            return failed(values, WORKER_DIED, trace=error_line(fault))
        unsent = isinstance(fault, pickle.PicklingError | AttributeError | TypeError)
        if unsent and (why := _cannot_be_sent(self._sent)):
            raise InputError(
                f"the model cannot be sent to other processes: {why}", place="executor",
                remedy="define its function in a module, or give a ThreadPoolExecutor",
            )  # fmt: skip
        return failed(values, f"{WORKER_DIED} ({error_line(fault)})")


def _cannot_be_sent(sent: worker.Sent) -> str:
    """Why the source cannot be pickled; empty where it can."""
    try:
        pickle.dumps(sent)
    except Exception as fault:  # a class may raise anything from its own `__reduce__` or `__getstate__`
        return error_line(fault)
    return ""
