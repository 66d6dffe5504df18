"""Killed, stopped and failing searches end with the same result as an uninterrupted one."""

import multiprocessing
import os
import signal
import sqlite3

import pytest

from calib.execution.outcome import WORKER_DIED, Outcome
from calib.results.ledger import Ledger

FORK = multiprocessing.get_context("fork")


def everything(path):
    """Evaluations and history as tables, without what depends on the clock."""
    with sqlite3.connect(path) as database:
        return [
            database.execute(query).fetchall()
            for query in (
                "SELECT fingerprint, key, attempt, p.names, parameters, r.names, responses, status, error"
                " FROM state JOIN evaluation ON state = state.id"
                " JOIN names p ON parameter_names = p.id JOIN names r ON response_names = r.id ORDER BY evaluation.id",
                "SELECT run.name, generation, individual, fingerprint, hex(key), status, misfit"
                " FROM state JOIN history ON state = state.id JOIN run ON run = run.id ORDER BY history.id",
            )
        ]


def search_all(search, path, evaluator, kill=lambda ledger: None):
    with Ledger.open(path) as ledger:
        kill(ledger)
        return [search.run(case, ledger, evaluator) for case in search.cases]


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def _killed_at(search, path, place, number):
    """Search until the given place is passed for the given time, and be killed there."""
    calls = 0

    def count():
        nonlocal calls
        calls += 1
        if calls == number:
            die()

    def prepare(ledger):
        append, record = ledger.append, ledger.record
        if place == "statement":  # anywhere, in the middle of transactions too
            ledger._database.set_trace_callback(lambda statement: count())
        elif place == "before append":
            ledger.append = lambda *given: (count(), append(*given))
        elif place == "between append and record":
            ledger.append = lambda *given: (append(*given), count())
        elif place == "after record":
            ledger.record = lambda *given: (record(*given), count())

    search_all(search, path, search.evaluator(), prepare)


def killed(search, path, place, number):
    process = FORK.Process(target=_killed_at, args=(search, path, place, number))
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.fixture(scope="module")
def uninterrupted(search, tmp_path_factory):
    path = tmp_path_factory.mktemp("uninterrupted") / "ledger.sqlite"
    results = search_all(search, path, search.evaluator())
    tables = everything(path)
    kinds = {row[5] for row in tables[1]}
    assert kinds == {"solved", "reused", "infeasible", "failed"}  # or the comparison would prove little
    return results, tables


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "numbers"),
    [
        ("before append", (1, 5)),
        ("between append and record", (4, 12)),
        ("after record", (9, 17)),
        ("statement", (3, 151)),
        pytest.param("between append and record", (1,), marks=pytest.mark.slow),
        pytest.param("after record", (1, 10), marks=pytest.mark.slow),
        pytest.param("statement", (1, 2, 9, 10, 40, 77, 150, 152, 300, 333, 500), marks=pytest.mark.slow),
    ],
)
def test_killed_at_any_moment_it_ends_the_same(tmp_path, uninterrupted, place, numbers, search, assert_equal):
    for number in numbers:
        path = tmp_path / f"{number}.sqlite"
        assert killed(search, path, place, number)
        results = search_all(search, path, search.evaluator())
        assert everything(path) == uninterrupted[1]
        for one, other in zip(results, uninterrupted[0], strict=True):
            assert_equal(one, other)


@pytest.mark.medium
def test_killed_again_and_again(tmp_path, uninterrupted, search):
    path, times = tmp_path / "ledger.sqlite", 0
    # Replaying takes statements too, so every start gets a little further than the last.
    while killed(search, path, "statement", 30 + 25 * times):
        times += 1
    assert times > 5 and everything(path) == uninterrupted[1]


def _slowly(search, path):
    search_all(search, path, search.evaluator(pause=0.01))


@pytest.mark.medium
def test_killed_from_outside(tmp_path, uninterrupted, search):
    for attempt in range(20):  # a run that got through before the first kill, on a busy machine, is repeated
        path, times = tmp_path / f"{attempt}.sqlite", 0
        while True:
            process = FORK.Process(target=_slowly, args=(search, path))
            process.start()
            process.join(0.05 + 0.08 * times)
            if process.exitcode is not None:
                break
            process.kill()
            process.join()
            times += 1
        if times:
            break
    assert times > 0 and process.exitcode == 0 and everything(path) == uninterrupted[1]


def test_stopped_by_the_keyboard(tmp_path, uninterrupted, search):
    path = tmp_path / "ledger.sqlite"
    evaluator = search.evaluator()

    def pressed(generation, generations, best):
        if generation == 4:
            raise KeyboardInterrupt

    with Ledger.open(path) as ledger, pytest.raises(KeyboardInterrupt):
        search.run(search.cases[0], ledger, evaluator, progress=pressed)
    search_all(search, path, evaluator)
    assert everything(path) == uninterrupted[1]
    assert len(evaluator.points) == len(uninterrupted[1][0])


@pytest.mark.medium
def test_a_failure_of_the_machine_is_repaired_by_the_next_run(tmp_path, uninterrupted, search):
    class Unlucky(search.evaluator):
        isolated = True

        def evaluate(self, points, arrived):
            given = super().evaluate(points)
            outcomes = [Outcome(o.values, "failed", {}, WORKER_DIED) if k == 3 else o for k, o in enumerate(given)]
            for outcome in outcomes:
                arrived(outcome)
            return outcomes

    path = tmp_path / "ledger.sqlite"
    unlucky = search_all(search, path, Unlucky())
    assert unlucky[0].failed > uninterrupted[0][0].failed
    healthy = search.evaluator()
    healthy.isolated = True
    mended = search_all(search, path, healthy)
    assert mended[0].misfit == uninterrupted[0][0].misfit
    assert mended[0].failed == uninterrupted[0][0].failed
    history = [[r[:5] + r[6:] for r in sorted(rows)] for rows in (everything(path)[1], uninterrupted[1][1])]
    assert history[0] == history[1]
