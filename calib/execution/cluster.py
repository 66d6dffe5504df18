"""A Dask cluster that evaluates points: a scheduler somewhere, the user's client, or workers on this machine."""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import re
import sys
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calib.errors.errors import InputError
from calib.execution import cluster_worker
from calib.execution.cluster_worker import Packed, Parcel, ParcelOutcomes
from calib.execution.evaluate import Arrived, failed, ignored
from calib.execution.local_cluster import started
from calib.execution.outcome import WORKER_DIED, Outcome, error_line
from calib.execution.stage import Tell, warned
from calib.execution.worker import Sent, Source, available_cores

EXTRA = "pip install 'calib[cluster]'"
LOCAL = "dask"
"""Name of a cluster on this machine."""
ADDRESS = re.compile(r"dask://([^\s/]+:\d+)")
"""Name of a scheduler."""
WORTHWHILE = 0.05
"""Seconds of a point below which sending it costs too much; see the page on many machines."""
_TASK = 0.1
"""Seconds of work that are sent together: a task costs some milliseconds."""
_AHEAD = 4
"""Tasks for each thread of a worker that are handed over before results are awaited."""
_FIRST = 16
"""Tasks that are handed over before it is known how long a point takes: an adaptive cluster grows by them."""
_LOOK = 1.0
"""Seconds between two looks at the number of workers."""
_CONNECT = 10.0
"""Seconds in which a scheduler answers."""
_PATIENCE = 15.0
"""Seconds without a worker before that is told."""


class Cluster:
    """Workers of a Dask scheduler; connected on first use.

    Attributes
    ----------
    name : str
        ``"dask://HOST:PORT"``, ``"dask"`` for workers on this machine, or the address behind a client.

    Parameters
    ----------
    name : str
    workers : int, optional
        Workers that are started on this machine; one per core by default.
    client : distributed.Client, optional
        The caller owns it and closes it.
    tell : callable
        Receives what the user should know at once, in one sentence.
    """

    def __init__(self, name: str, workers: int | None = None, client: Any = None, tell: Tell = warned):
        self.name = name
        self._tell = tell
        self._workers = workers
        self._own = client is None
        self._client = client
        self._told: set[str] = set()
        self._evaluators: weakref.WeakSet[ClusterEvaluator] = weakref.WeakSet()
        self._end: Callable[[], Any] = _nothing

    @staticmethod
    def of_client(given: object, tell: Tell = warned) -> Cluster | None:
        """The cluster of a `distributed.Client` or of the executor that it returns; None for any other object."""
        distributed = sys.modules.get("distributed")
        if distributed is None:
            return None
        client = getattr(given, "_client", None) if type(given).__name__ == "ClientExecutor" else given
        if not isinstance(client, distributed.Client):
            return None
        return Cluster(str(client.scheduler.address), client=client, tell=tell)

    # -- connection ----------------------------------------------------------------------------------------------------

    def client(self) -> Any:
        """The client of the scheduler; InputError where none answers."""
        if self._client is None:
            try:
                from distributed import Client
            except ImportError:
                raise InputError(
                    "a cluster needs a package that is not installed", place="executor",
                    remedy=EXTRA,
                ) from None  # fmt: skip
            for name in [n for n in logging.Logger.manager.loggerDict if n.partition(".")[0] == "distributed"]:
                logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is told in sentences
            found = ADDRESS.fullmatch(self.name)
            address, end = (found[1], _nothing) if found else started(self._workers or available_cores())
            try:
                self._client = Client(address, timeout=_CONNECT, set_as_default=False)
            except (OSError, ValueError, TimeoutError):
                end()
                raise InputError(
                    f"no Dask scheduler answers at {address}", place="executor",
                    remedy="start one with 'dask scheduler', or correct the address",
                ) from None  # fmt: skip
            self._end = weakref.finalize(self, _closed, self._client, end)
        return self._client

    def workers(self) -> dict[str, int]:
        """Addresses of the workers, and points that each evaluates at once."""
        try:
            return dict(self.client().nthreads())
        except (OSError, RuntimeError, TimeoutError):  # the scheduler is gone
            raise self.lost() from None

    def threads(self) -> int:
        """Points that all workers evaluate at once; 0 while there is no worker."""
        return sum(self.workers().values())

    def lost(self) -> InputError:
        """The fault of a scheduler that went away."""
        return InputError(
            f"the Dask scheduler of {self.name} went away; what was evaluated before is stored", place="executor",
            remedy="start it again; the same command then goes on where it stopped",
        )  # fmt: skip

    def close(self) -> None:
        """Release what was started or connected here; a client that was given stays open."""
        for evaluator in list(self._evaluators):
            evaluator.close()
        self._end()
        if self._own:
            self._client = None

    def once(self, subject: str, sentence: str) -> None:
        """Tell the user something on a subject, once."""
        if subject not in self._told:
            self._told.add(subject)
            self._tell(sentence)

    def evaluator(self, source: Source, time_limit: float | None = None, required: bool = False) -> ClusterEvaluator:
        """Evaluator of batches of points; see `ClusterEvaluator`."""
        evaluator = ClusterEvaluator(self, source, time_limit, required)
        self._evaluators.add(evaluator)
        return evaluator


class ClusterEvaluator:
    """Evaluates batches of points by the workers of a cluster; see `calib.execution.evaluate.Evaluator.evaluate`.

    The source travels once: it is the result of a task, which workers pass on to each other and make again when one is
    lost. Short points travel in batches. A point whose process or worker dies is tried once more, elsewhere if there is
    another worker.

    Parameters
    ----------
    cluster : Cluster
    source : callable
        Builds the evaluation function, once in every process.
    time_limit : float, optional
        Seconds after which a point is abandoned.
    required : bool
        Whether workers that cannot keep the limit are refused.
    """

    isolated = True

    def __init__(self, cluster: Cluster, source: Source, time_limit: float | None = None, required: bool = False):
        self._cluster = cluster
        self._source, self._limit, self._required = source, time_limit, required
        self._parcel: Any = None
        self._spent, self._done = 0.0, 0
        self._end: Callable[[], Any] = _nothing

    def __enter__(self) -> ClusterEvaluator:
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes of this evaluator in all workers; the cluster stays connected."""
        self._end()
        self._parcel = None

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = ignored) -> list[Outcome]:
        """Outcomes in the order of the points; ``arrived`` is called in this thread with each as soon as it is there.

        Raises
        ------
        InputError
            For a wrong set-up, workers of another version, a model that cannot be sent, and a scheduler that goes away.
            On any exception waiting points are cancelled and the processes of running ones ended.
        """
        if not points:
            return []
        batch = _Batch(self._cluster, self._sent(), [dict(values) for values in points], arrived)
        try:
            while batch.unfinished():
                batch.hand_over(self._spent / self._done if self._done else None)
                for outcome in batch.next_outcomes():
                    self._spent, self._done = self._spent + outcome.seconds, self._done + 1
        except BaseException:  # KeyboardInterrupt too
            batch.cancel()
            self.close()
            raise
        return batch.in_order()

    def _sent(self) -> Any:
        """Future of the parcel with the source."""
        client = self._cluster.client()
        if self._parcel is None:
            import cloudpickle
            import dask

            try:
                packed = Packed.of(self._source, cloudpickle.dumps)
            except Exception as fault:  # a class may raise anything from its own `__reduce__` or `__getstate__`
                raise InputError(
                    f"the model cannot be sent to other machines: {error_line(fault)}", place="executor",
                    remedy="leave out what belongs to this process, such as open files",
                ) from None  # fmt: skip
            sent = Sent(packed)
            parcel = Parcel(sent, cluster_worker.library_versions(), self._limit, self._required)
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
                self._parcel = client.submit(cluster_worker.passed_on, parcel, pure=False)
            self._end = weakref.finalize(self, _release, client, sent.name)
        return self._parcel


class _Batch:
    """Points in progress."""

    def __init__(self, cluster: Cluster, parcel: Any, points: Sequence[dict[str, float]], arrived: Arrived):
        self._cluster, self._parcel, self._points, self._arrived = cluster, parcel, points, arrived
        self._client = cluster.client()
        self._left = deque(range(len(points)))
        self._deaths: dict[int, int] = {}
        self._running: dict[str, tuple[Any, list[int]]] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._outcomes: dict[int, Outcome] = {}
        self._threads = cluster.threads()
        self._without = 0.0

    def unfinished(self) -> bool:
        return len(self._outcomes) < len(self._points)

    def in_order(self) -> list[Outcome]:
        return [self._outcomes[k] for k in range(len(self._points))]

    def hand_over(self, seconds: float | None) -> None:
        """Hand over tasks, of several points each where one takes less than `_TASK`."""
        threads = max(self._threads, 1)
        most = max(_FIRST, _AHEAD * threads)
        if seconds is not None and seconds < WORTHWHILE:
            self._cluster.once(
                "worth",
                f"a point takes {1e3 * seconds:.3g} ms: below {1e3 * WORTHWHILE:g} ms a cluster does not pay; own "
                "processes do (--executor processes)",
            )
        size = 1
        if seconds is not None:
            size = min(math.ceil(_TASK / max(seconds, 1e-6)), max(1, math.ceil(len(self._left) / threads)))
        while self._left and len(self._running) < most:
            self._submit([self._left.popleft() for _ in range(min(size, len(self._left)))])

    def next_outcomes(self) -> list[Outcome]:
        """Wait until some tasks have ended, at most until the next look at the workers; what has become known."""
        ended = []
        with contextlib.suppress(queue.Empty):
            # A queue, unlike dask's own waiting, may be interrupted anywhere; see `Evaluator._finished`.
            ended.append(self._ended.get(timeout=_LOOK))
            while True:
                ended.append(self._ended.get_nowait())
        if not ended:
            self._look()
        before = len(self._outcomes)
        tasks = [self._running.pop(future.key) for future in ended if future.key in self._running]
        states = [future.status for future, _ in tasks]  # once: they change where a worker dies
        good = [task for task, state in zip(tasks, states, strict=True) if state == "finished"]
        try:
            answers: Sequence[ParcelOutcomes] = self._client.gather([future for future, _ in good], errors="raise")
        except Exception:
            if all(future.status == "finished" for future, _ in good):
                raise self._cluster.lost() from None
            answers = []  # the worker of one died meanwhile: all are asked again
            states = ["lost" if state == "finished" else state for state in states]
        for answer, (_, numbers) in zip(answers, good, strict=False):
            if answer.fault is not None:
                raise answer.fault
            for k, outcome in zip(numbers, answer.outcomes, strict=True):
                self._known(k, outcome, answer.worker)
        for (future, numbers), state in zip(tasks, states, strict=True):
            if state in ("error", "cancelled"):
                self._lost(numbers, self._fault_of(future))
            elif state != "finished":  # its result was lost with a worker: the scheduler has it made once more
                self._await(future, numbers)
        return list(self._outcomes.values())[before:]

    def cancel(self) -> None:
        """Cancel what waits; running points end with their processes."""
        if self._client.status == "running":
            with contextlib.suppress(Exception):
                self._client.cancel([future for future, _ in self._running.values()], force=True)

    # -- one task ------------------------------------------------------------------------------------------------------

    def _submit(self, numbers: list[int], avoided: str = "") -> None:
        others = [name for name in self._cluster.workers() if name != avoided] if avoided else []
        future = self._client.submit(
            cluster_worker.evaluate_parcel, self._parcel, [self._points[k] for k in numbers], pure=False,
            workers=others or None, allow_other_workers=bool(others),
        )  # fmt: skip
        self._await(future, numbers)

    def _await(self, future: Any, numbers: list[int]) -> None:
        self._running[future.key] = future, numbers
        future.add_done_callback(self._ended.put)

    def _known(self, k: int, outcome: Outcome, name: str) -> None:
        if outcome.error == WORKER_DIED:
            self._deaths[k] = self._deaths.get(k, 0) + 1
            if self._deaths[k] < 2:
                self._submit([k], avoided=name)
                return
            outcome = failed(outcome.values, f"{WORKER_DIED} {_times(self._deaths[k])}", outcome.seconds)
        self._settle(k, outcome)

    def _settle(self, k: int, outcome: Outcome) -> None:
        self._outcomes[k] = outcome
        self._arrived(outcome)

    def _fault_of(self, future: Any) -> BaseException:
        """Why a task has no result; InputError where that is not due to its points."""
        if future.status == "cancelled" or self._client.status != "running":
            raise self._cluster.lost()
        fault: BaseException = future.exception()
        below: BaseException | None = fault
        while below is not None:
            if isinstance(below, ImportError):
                raise InputError(
                    f"a worker of {self._cluster.name} cannot import calib ({error_line(below)})", place="executor",
                    remedy="start the workers from an environment that has calib and its extra 'cluster'",
                ) from None  # fmt: skip
            below = below.__cause__ or below.__context__
        return fault

    def _lost(self, numbers: Sequence[int], fault: BaseException) -> None:
        """Points whose task failed; after the death of its workers each is tried alone, or has failed."""
        killed = type(fault).__name__ == "KilledWorker"
        for k in numbers:
            if killed and len(numbers) == 1:
                self._deaths[k] = self._deaths.get(k, 0) + 1 + getattr(fault, "allowed_failures", 0)
            if killed and self._deaths.get(k, 0) < 2:
                self._submit([k])
            else:
                why = _times(self._deaths[k]) if killed else f"({error_line(fault)})"
                self._settle(k, failed(self._points[k], f"{WORKER_DIED} {why}"))

    def _look(self) -> None:
        """Look how many workers there are."""
        self._threads = self._cluster.threads()
        self._without = 0.0 if self._threads else self._without + _LOOK
        if self._without >= _PATIENCE:
            self._cluster.once("workers", f"the cluster {self._cluster.name} has no worker: points wait for one")


def _times(deaths: int) -> str:
    """How often a point's process died, where that is more than once."""
    return "twice" if deaths == 2 else f"{deaths} times"


def _nothing() -> None:
    """Nothing was started here."""


def _release(client: Any, name: str) -> None:
    """End the processes of an evaluator in all workers."""
    if client.status == "running":
        with contextlib.suppress(Exception):
            client.run(cluster_worker.release, name, on_error="ignore")


def _closed(client: Any, end: Callable[[], None]) -> None:
    with contextlib.suppress(Exception):
        client.close(timeout=2)
    end()
