"""What is handed over to a cluster, without one: batches of short points, and points whose process or worker dies."""

import pytest

from calib.errors.errors import InputError
from calib.execution import cluster_worker
from calib.execution.cluster import Cluster, _Batch
from calib.execution.outcome import WORKER_DIED, Outcome


def points(*xs):
    return [{"x": float(x)} for x in xs]


def silent(sentence):
    """Nobody is told."""


class KilledWorker(Exception):
    """As Dask raises it."""

    def __init__(self, allowed_failures=1):
        super().__init__("killed")
        self.allowed_failures = allowed_failures


class Future:
    def __init__(self, number, points, where):
        self.key, self.points, self.where, self.status, self.fault = str(number), points, where, "pending", None
        self.answered = None

    def add_done_callback(self, call):
        self.answered = call

    def exception(self):
        return self.fault

    def end(self, fault=None):
        self.fault, self.status = fault, "finished" if fault is None else "error"
        self.answered(self)


class Client:
    """A client whose tasks end when the test says so; points of x = -2 kill their process."""

    status = "running"

    def __init__(self, *workers):
        self.workers, self.tasks = workers, []

    def nthreads(self):
        return dict.fromkeys(self.workers, 1)

    def submit(self, function, parcel, points, pure, workers, allow_other_workers):
        self.tasks.append(Future(len(self.tasks), points, workers))
        return self.tasks[-1]

    def gather(self, futures, errors):
        return [cluster_worker.ParcelOutcomes(f.where[0] if f.where else "a", self.outcomes(f.points)) for f in futures]

    def outcomes(self, points):
        return tuple(
            Outcome(v, "failed", {}, WORKER_DIED) if v["x"] == -2 else Outcome(v, "ok", {"y": v["x"]}) for v in points
        )


def batch(client, given, told=None):
    heard = [] if told is None else told
    return _Batch(Cluster("dask", client=client, tell=heard.append), None, given, lambda outcome: None)


@pytest.mark.parametrize(("seconds", "sizes"), [(None, [1] * 16), (0.2, [1] * 16), (0.02, [5] * 8), (1e-4, [20, 20])])
def test_short_points_travel_together_and_every_worker_has_some(seconds, sizes):
    client, told = Client("a", "b"), []
    batch(client, points(*range(40)), told).hand_over(seconds)
    assert [len(task.points) for task in client.tasks] == sizes
    assert bool(told) == (seconds in (0.02, 1e-4))


def test_a_point_whose_process_dies_is_tried_once_more_on_another_worker():
    client = Client("a", "b")
    some = batch(client, points(1, -2))
    some.hand_over(0.01)
    while some.unfinished():
        for task in client.tasks:
            if task.status == "pending":
                task.end()
        some.next_outcomes()
    assert [(task.points, task.where) for task in client.tasks[-1:]] == [(points(-2), ["b"])]
    assert [(o.status, o.error) for o in some.in_order()] == [("ok", ""), ("failed", f"{WORKER_DIED} twice")]
    assert some.in_order()[1].transient


def test_points_whose_worker_was_killed_are_tried_alone_and_then_have_failed():
    client = Client("a", "b")
    some = batch(client, points(1, 2))
    some.hand_over(1e-9)
    for task in list(client.tasks):
        task.points = points(1, 2)  # both in one
    some._running = {client.tasks[0].key: (client.tasks[0], [0, 1])}
    client.tasks[0].end(KilledWorker())
    assert some.next_outcomes() == [] and [task.points for task in client.tasks[-2:]] == [points(1), points(2)]
    client.tasks[-2].end()
    client.tasks[-1].end(KilledWorker(3))
    some.next_outcomes()
    assert [(o.status, o.error) for o in some.in_order()] == [("ok", ""), ("failed", f"{WORKER_DIED} 4 times")]


def test_a_result_that_is_lost_with_its_worker_is_awaited_again():
    client = Client("a", "b")
    some = batch(client, points(1, 2))
    some.hand_over(None)
    first, second = client.tasks
    first.end()
    first.status = "lost"  # its worker died before the result was fetched: Dask makes it again
    second.end()
    assert [o.values for o in some.next_outcomes()] == points(2) and some.unfinished()
    first.end()
    some.next_outcomes()
    assert [o.responses["y"] for o in some.in_order()] == [1.0, 2.0] and len(client.tasks) == 2


def test_a_worker_that_dies_while_results_are_fetched_loses_none():
    client = Client("a", "b")
    some, gather = batch(client, points(1, 2)), client.gather
    some.hand_over(None)
    first, second = client.tasks

    def failing(futures, errors):
        first.status, first.fault, client.gather = "error", KilledWorker(), gather
        raise first.fault

    client.gather = failing
    for task in (first, second):
        task.end()
    assert some.next_outcomes() == []
    for task in (first, second):
        task.answered(task)  # Dask calls at once where a future has ended
    some.next_outcomes()
    assert [(o.values["x"], o.status, o.error) for o in some.in_order()] == [
        (1.0, "failed", f"{WORKER_DIED} twice"), (2.0, "ok", "")
    ]  # fmt: skip


def test_results_that_nobody_can_fetch_are_told():
    client = Client("a")
    some = batch(client, points(1))
    some.hand_over(None)

    def failing(futures, errors):
        raise OSError("no route")

    client.gather = failing
    client.tasks[0].end()
    with pytest.raises(InputError, match="went away") as told:
        some.next_outcomes()
    assert told.value.__cause__ is None  # a sentence: the command keeps tracebacks of a user's own code only
