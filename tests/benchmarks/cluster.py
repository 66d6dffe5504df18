"""A cluster on this machine: evaluations of the reduced bogie while its workers are killed, and what a task costs.

    python tests/benchmarks/cluster.py [--points 100000] [--kill 10] [--workers 2] [--check 1] [--write FILE]

The table must be that of one process; a last line of JSON says whether it is, and a line after every part of the points
how far it is. ``--check 10`` has one process evaluate only every tenth point again; that each outcome is of its own
point is always checked. Bytes are those of pickles, as they travel. Processor time of the scheduler is that of its
whole process while points without work are evaluated.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import pickle
import random
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cloudpickle
from page import Page
from subject import study_of

from calib.analyses.provenance.places import open_evaluator
from calib.analyses.provenance.recorded import Evaluated
from calib.analyses.reduction import reduction_of
from calib.execution.cluster import Cluster
from calib.execution.cluster_worker import Packed, ParcelOutcomes
from calib.execution.executor import Injected
from calib.execution.outcome import Function, Outcome
from calib.problem.sampling import sample
from calib.results.results import Results

EMPTY = 1000
"""Points without work by which the cost of a task is found."""
PART = 5000
"""Points after which it is told how far it is; one process and the cluster take turns, as a busy machine slows both."""
TOGETHER = 10
"""Points of a task of several."""


class Nothing:
    """Source of a function without work."""

    def __call__(self) -> Function:
        """The function."""
        return lambda values: {"y": values["x"]}


def main() -> None:
    """Evaluate, compare, and tell the costs."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--points", type=int, default=100_000)
    arguments.add_argument("--kill", type=float, default=10.0, help="seconds between two deaths of a worker")
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--check", type=int, default=1, help="every how many points one is evaluated again")
    arguments.add_argument("--write", type=Path, help="append the tables to this file")
    given = arguments.parse_args()
    page, study = Page(given.write), study_of("bogie")
    page.begin("A cluster")
    workers = Injected.of("dask", given.workers, page.say)
    assert workers.cluster is not None
    with tempfile.TemporaryDirectory() as scratch, contextlib.closing(workers):
        reduction = reduction_of(study, Results(Path(scratch)))
        assert reduction is not None
        points = [study.search_space.complete(x) for x in sample(study.search_space, given.points, 1).points]
        compared = differ = failed = 0
        own = taken = 0.0
        with (
            open_evaluator(study, 1, given.points, reduction.problem, reduction.path) as here,
            open_evaluator(study, workers, given.points, reduction.problem, reduction.path) as there,
            killing(workers.cluster, given.kill) as (killed, arrived),
        ):
            for first in range(0, len(points), PART):
                part = points[first : first + PART]
                found, seconds = timed(lambda part=part: there.evaluate(part, arrived.append))
                taken += seconds
                expected, seconds = timed(lambda part=part: here.evaluate(part[:: given.check]))
                own += seconds
                compared += len(expected)
                failed += sum(outcome.status == "failed" for outcome in found)
                differ += sum(dict(a.values) != dict(b) for a, b in zip(found, part, strict=True))
                pairs = zip(found[:: given.check], expected, strict=True)
                differ += sum(a.status == "ok" and row(a) != row(b) for a, b in pairs)
                told = {"points": first + len(part), "killed": len(killed), "differ": differ, "failed": failed}
                print(json.dumps(told), flush=True)
        page.table(
            ("points", "workers killed", "compared", "other rows", "failed", "s by the cluster", "s by one process"),
            [(len(points), len(killed), compared, differ, failed, f"{taken:.1f}", f"{own:.1f}")],
        )
        costs(page, workers.cluster, Evaluated(reduction.problem), expected[0])
    print(json.dumps(told))


def row(outcome: Outcome) -> str:
    """What a table has of a point, to the last digit."""
    return repr((outcome.values, outcome.status, outcome.responses))


def timed(call: Callable[[], Sequence[Outcome]]) -> tuple[Sequence[Outcome], float]:
    """What a call returns, and its seconds by the wall clock."""
    began = time.perf_counter()
    return call(), time.perf_counter() - began


@contextlib.contextmanager
def killing(cluster: Cluster, every: float) -> Iterator[tuple[list[int], list[Outcome]]]:
    """While this lasts, a worker is killed every so many seconds, unless no outcome has arrived since the last one.

    Processes of the killed, and the list to which the caller adds what arrives.
    """
    over, killed, arrived, client = threading.Event(), list[int](), list[Outcome](), cluster.client()

    def kill() -> None:
        seen = 0
        while not over.wait(every):
            pids = list(client.run(os.getpid, on_error="ignore").values())
            if pids and len(arrived) > seen:
                seen = len(arrived)
                killed.append(random.choice(pids))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield killed, arrived
    finally:
        over.set()
        thread.join()


def costs(page: Page, cluster: Cluster, source: Callable[[], Function], outcome: Outcome) -> None:
    """Bytes of a model, of points and of answers; processor time of scheduler and client for a task."""
    point, client = dict(outcome.values), cluster.client()
    sizes = [("the model, once a worker", len(Packed.of(source, cloudpickle.dumps).content))]
    for count in (1, TOGETHER):
        copies = [replace(outcome, values=dict(point), responses=dict(outcome.responses)) for _ in range(count)]
        answer = ParcelOutcomes("tcp://127.0.0.1:40000", tuple(copies))
        sizes += [
            (f"a task of {count}, {len(point)} parameters", len(pickle.dumps([one.values for one in copies]))),
            (f"its answer, {len(outcome.responses)} responses", len(pickle.dumps(answer))),
        ]
    page.table(("what travels", "bytes"), sizes)
    with cluster.evaluator(Nothing()) as evaluator:
        evaluator.evaluate([{"x": 0.0}])
        evaluator._spent = 1e9  # each in a task of its own, as points that take long
        before = client.run_on_scheduler(time.process_time), time.process_time(), time.perf_counter()
        evaluator.evaluate([{"x": float(k)} for k in range(EMPTY)])
        after = client.run_on_scheduler(time.process_time), time.process_time(), time.perf_counter()
    spent = [f"{1e3 * (b - a) / EMPTY:.2f}" for a, b in zip(before, after, strict=True)]
    page.table(("ms a task: scheduler and nannies", "asking process", "by the wall clock"), [spent])


if __name__ == "__main__":
    main()
