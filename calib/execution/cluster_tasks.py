"""Long tasks of a cluster: solutions of large models, for training and effects."""

from __future__ import annotations

import contextlib
import pickle
import queue
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from calib.execution import tasks
from calib.execution.cluster import Cluster
from calib.execution.cluster_worker import library_versions, passed_on, require_same
from calib.execution.outcome import WORKER_DIED, words_of
from calib.execution.tasks import I, R, S, Share, Told, one_thread, unreported

LONG = 1.0
"""Seconds of a task below which it stays on this machine: its matrices and its answer are megabytes."""


class ClusterTasks:
    """Shares the long tasks of `calib.execution.tasks.each` between the workers of a cluster.

    The first task of every function is done here and shows how long one takes. What all tasks need travels once. What
    cannot be sent, fails elsewhere, or dies with its workers is done here, so that a failure is that of
    `calib.execution.tasks.in_this_process`; so are tasks within a task. Tasks whose shared object has a true attribute
    ``stays_here`` need files of this machine, or more than is worth sending, and do not travel.

    Parameters
    ----------
    cluster : Cluster
    others : Share
        Who does short tasks, and all while the cluster has no worker.
    """

    def __init__(self, cluster: Cluster, others: Share):
        self._cluster, self._others = cluster, others
        self._seconds: dict[object, float] = {}
        self._within = False

    def __call__(
        self, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported
    ) -> list[R]:
        """Results in the order of the items; see `calib.execution.tasks.each`."""
        if self._within:
            return tasks.in_this_process(function, shared, items, told)
        if getattr(shared, "stays_here", False):
            return self._by(self._others, function, shared, items, told)
        first: list[R] = []
        if function not in self._seconds and len(items) > 1:
            began = time.perf_counter()
            first, items = self._by(tasks.in_this_process, function, shared, items[:1], told), items[1:]
            self._seconds[function] = time.perf_counter() - began
        own = (lambda done: told(len(first) + done)) if first else told
        long = len(items) > 1 and self._seconds[function] >= LONG and self._cluster.threads() > 0
        content = _written(function, shared) if long else None
        if content is None:
            return first + self._by(self._others, function, shared, items, own)
        return first + self._there(content, function, shared, items, own)

    def _by(
        self, share: Share, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told = unreported
    ) -> list[R]:
        """Results of who begins tasks in this process, where tasks within them stay."""
        self._within = True
        try:
            return share(function, shared, items, told)
        finally:
            self._within = False

    def _there(
        self, content: bytes, function: Callable[[S, I], R], shared: S, items: Sequence[I], told: Told
    ) -> list[R]:
        import dask

        client, ended = self._cluster.client(), queue.SimpleQueue[Any]()
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"}):
            sent = client.submit(passed_on, content, pure=False)
        numbers: dict[str, int] = {}
        found: dict[int, R] = {}
        lost: dict[int, Exception] = {}
        try:
            waiting = [client.submit(_done, sent, item, library_versions(), pure=False) for item in items]
            for k, future in enumerate(waiting):
                numbers[future.key] = k
                future.add_done_callback(ended.put)
            told(0)
            while len(found) + len(lost) < len(items):
                with contextlib.suppress(queue.Empty):
                    future = ended.get(timeout=1.0)  # unlike dask's own waiting it may be interrupted anywhere
                    try:
                        found[numbers[future.key]] = future.result()
                    except Exception as fault:  # the task's, or its workers': here it succeeds, or fails in its own way
                        lost[numbers[future.key]] = fault
                    told(len(found))
                self._cluster.threads()  # a scheduler that is gone is told
        except BaseException:  # KeyboardInterrupt too
            with contextlib.suppress(Exception):
                client.cancel(waiting, force=True)
            raise
        for k, why_not in sorted(lost.items(), key=lambda one: one[0]):
            why = WORKER_DIED if type(why_not).__name__ == "KilledWorker" else words_of(why_not)
            self._cluster.once("tasks", f"the cluster cannot do a task, which is done here: {why}")
            found[k] = self._by(tasks.in_this_process, function, shared, [items[k]])[0]
        return [found[k] for k in range(len(items))]


def _written(function: object, shared: object) -> bytes | None:
    """What tasks share; None where it cannot be sent."""
    import cloudpickle

    try:
        content: bytes = cloudpickle.dumps((function, shared))
        return content
    except Exception:  # a class may raise anything from its own `__reduce__` or `__getstate__`
        return None


def _done(content: bytes, item: object, versions: Mapping[str, str]) -> Any:
    """The result of a task, in a worker."""
    require_same(versions, "of a task")
    function, shared = _unpacked(content)
    with one_thread():
        return function(shared, item)


_last: tuple[bytes, Any] = (b"", None)


def _unpacked(content: bytes) -> Any:
    """Function and what it needs, kept for the worker's next task."""
    global _last
    if _last[0] is not content:
        _last = content, pickle.loads(content)
    return _last[1]
