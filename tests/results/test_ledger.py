import math
import multiprocessing
import os
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.execution.evaluate import Evaluator
from calib.execution.outcome import OUT_OF_MEMORY, WORKER_DIED, Outcome, attempt, point_key
from calib.results.ledger import Individual, Ledger

FORK = multiprocessing.get_context("fork")


@pytest.fixture
def ledger(tmp_path):
    with Ledger.open(tmp_path / "results" / "study" / "ledger.sqlite") as opened:
        yield opened


def ok(**values):
    return Outcome(values, "ok", {"y": sum(values.values())}, "", 0.5)


KEYS = [point_key({"x": float(k)}) for k in range(5)]


class Counting:
    """An evaluator that counts, and returns given outcomes for some points."""

    def __init__(self, isolated=False, **answers):
        self.isolated, self.answers, self.batches = isolated, answers, []

    def evaluate(self, points, arrived=lambda outcome: None):
        self.batches.append([p["x"] for p in points])
        outcomes = [self.answers.get(f"x{p['x']:g}", ok(**p)) for p in points]
        for outcome in outcomes[::-1]:  # they arrive in whatever order
            arrived(outcome)
        return outcomes


# -- evaluations -------------------------------------------------------------------------------------------------------

numbers = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.slow
@given(st.dictionaries(st.text(), numbers), st.dictionaries(st.text(), numbers | st.just(math.nan)))
def test_what_is_written_reads_back_exactly(values, responses):
    with Ledger.open(Path(":memory:")) as ledger:
        ledger.append("f", [Outcome(values, "ok", responses, "", 0.25)])
        found = ledger.lookup("f", [point_key(values)])[point_key(values)]
    assert repr(found) == repr(Outcome(values, "ok", responses, "", 0.25))


def test_a_key_is_the_point_and_nothing_else():
    assert point_key({"a": 1.0, "b": 2.0}) == point_key({"b": np.float64(2.0), "a": 1})
    others = [{"a": 1.0, "b": np.nextafter(2.0, 3.0)}, {"a": 1.0}, {"a": 2.0, "b": 1.0}, {"a": 1.0, "c": 2.0}, {}]
    assert len({point_key(v) for v in [{"a": 1.0, "b": 2.0}, *others]}) == 6


def test_one_in_memory_remembers_until_it_is_closed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    evaluator = Counting()
    for _ in range(2):
        with Ledger.in_memory() as ledger:
            for _ in range(2):
                ledger.evaluate("f", [{"x": 1.0}], evaluator)
            ledger.record("run", "f", 1, [Individual(point_key({"x": 1.0}), "ok", 0.5)])
            assert ledger.history("run")["status"].tolist() == ["solved"]
    assert evaluator.batches == [[1.0], [1.0]] and list(tmp_path.iterdir()) == []


def test_states_of_the_model_do_not_mix(ledger):
    ledger.append("one", [ok(x=1.0), ok(x=2.0)])
    ledger.append("two", [ok(x=1.0)])
    assert (ledger.count("one"), ledger.count("two"), ledger.count("three")) == (2, 1, 0)
    assert (ledger.other_fingerprints("one"), ledger.other_fingerprints("three")) == (1, 3)
    assert ledger.lookup("two", [point_key({"x": 2.0})]) == {}


def test_what_is_asked_again_is_counted_from_the_opening(tmp_path):
    """A point that killed its process is evaluated once per command; one that failed by itself never again."""
    dead, wrong = (Outcome({"x": x}, "failed", {}, why, 0.1) for x, why in ((1.0, WORKER_DIED), (2.0, "no root")))
    batch = [{"x": x} for x in (1.0, 2.0, 3.0, 1.0)]
    for command, (asked, retried) in enumerate((([1.0, 2.0, 3.0], 0), ([1.0], 1), ([1.0], 1))):
        evaluator = Counting(isolated=True, x1=dead, x2=wrong)
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            for _ in range(2):
                told = [o.error for o in ledger.evaluate("f", batch, evaluator)]
                assert told == [WORKER_DIED, "no root", "", WORKER_DIED]
            assert (evaluator.batches, ledger.retried) == ([asked], retried), command


def test_a_known_point_is_never_evaluated_again(ledger):
    evaluator = Counting()
    batch = [{"x": float(k)} for k in (3, 1, 3, 2)]
    first = ledger.evaluate("f", batch, evaluator)
    second = ledger.evaluate("f", [*batch[::-1], {"x": 4.0}], evaluator)
    assert evaluator.batches == [[3.0, 1.0, 2.0], [4.0]]
    assert [o.values["x"] for o in first] == [3, 1, 3, 2] and second[:4] == first[::-1]
    assert ledger.evaluate("f", [], evaluator) == [] and len(evaluator.batches) == 2


@pytest.mark.medium
def test_many_points_at_once(ledger):
    evaluator = Counting()
    batch = [{"x": float(k)} for k in range(1201)]
    assert ledger.evaluate("f", batch, evaluator) == ledger.evaluate("f", batch, evaluator)
    assert len(evaluator.batches) == 1 and ledger.count("f") == 1201


def test_the_first_outcome_stays(ledger):
    ledger.append("f", [ok(x=1.0)])
    ledger.append("f", [replace(ok(x=1.0), responses={"y": 9.0})])
    assert ledger.lookup("f", [point_key({"x": 1.0})])[point_key({"x": 1.0})].responses == {"y": 1.0}
    with sqlite3.connect(ledger.path) as other:
        for statement in ("UPDATE evaluation SET seconds = 0", "DELETE FROM evaluation"):
            with pytest.raises(sqlite3.IntegrityError, match="append-only"):
                other.execute(statement)


def test_failures_are_final_unless_transient(tmp_path):
    def failed(x, error):
        return Outcome({"x": x}, "failed", {}, error)

    path = tmp_path / "ledger.sqlite"
    batch = [{"x": 1.0}, {"x": 2.0}, {"x": 3.0}]
    evaluator = Counting(True, x1=failed(1.0, "singular"), x2=failed(2.0, WORKER_DIED), x3=failed(3.0, OUT_OF_MEMORY))
    with Ledger.open(path) as ledger:
        for _ in range(3):  # once in a run is enough
            assert [o.status for o in ledger.evaluate("f", batch, evaluator)] == ["failed"] * 3
    assert len(evaluator.batches) == 1
    with Ledger.open(path) as ledger:  # not in this process, which it could end
        serial = Counting()
        assert ledger.evaluate("f", batch, serial)[1].error == WORKER_DIED and not serial.batches
    with Ledger.open(path) as ledger:
        evaluator = Counting(True)
        assert [o.status for o in ledger.evaluate("f", batch, evaluator)] == ["failed", "ok", "ok"]
        assert evaluator.batches == [[2.0, 3.0]]
    with Ledger.open(path) as ledger:
        assert [o.status for o in ledger.evaluate("f", batch, evaluator)] == ["failed", "ok", "ok"]
        assert len(evaluator.batches) == 1 and ledger.count("f") == 3
    with sqlite3.connect(path) as other:
        assert other.execute("SELECT COUNT(*) FROM evaluation").fetchone() == (5,)  # every attempt is kept


# -- vectors -----------------------------------------------------------------------------------------------------------


def test_a_vector_stays_as_it_was_first_stored(ledger):
    first, other = np.array([0.1, math.nan, -0.0]), np.arange(4.0)
    ledger.keep_vectors("f", KEYS[1], {"": first, "a": other})
    ledger.keep_vectors("f", KEYS[1], {"": other, "b": first[:0]})
    ledger.keep_vectors("f", KEYS[2], {"": other})
    found = ledger.vectors("f", KEYS[1], ["", "a", "b", "c"])
    assert {name: numbers.tobytes() for name, numbers in found.items()} == {
        "": first.tobytes(), "a": other.tobytes(), "b": b""
    }  # fmt: skip
    assert ledger.vectors("g", KEYS[1], [""]) == {} and ledger.count("f") == 0


# -- history -----------------------------------------------------------------------------------------------------------


def statuses(ledger, run):
    return ledger.history(run)["status"].tolist()


def test_reused_means_requested_before(ledger):
    ledger.append("f", [ok(x=1.0)])  # known, such as from a batch whose generation was not recorded: not reused
    one, two = Individual(KEYS[1], "ok", 1.0), Individual(KEYS[2], "ok", 2.0)
    ledger.record("A", "f", 1, [one, two, one])
    ledger.record("A", "f", 2, [two, Individual(KEYS[3], "infeasible"), Individual(KEYS[4], "failed")])
    ledger.record("B", "f", 1, [Individual(KEYS[3], "ok", 1.0), Individual(KEYS[4], "failed"), two])
    ledger.record("C", "g", 1, [Individual(KEYS[2], "ok", 1.0)])
    assert statuses(ledger, "A") == ["solved", "solved", "reused", "reused", "infeasible", "failed"]
    assert statuses(ledger, "B") == ["solved", "failed", "reused"]
    assert statuses(ledger, "C") == ["solved"]
    table = ledger.history("A")
    assert table.columns.tolist() == ["generation", "individual", "key", "status", "misfit"]
    assert table[["generation", "individual"]].values.tolist() == [[1, 0], [1, 1], [1, 2], [2, 0], [2, 1], [2, 2]]
    assert table["misfit"].isna().tolist() == [False, False, False, False, True, True]
    assert ledger.history("nobody").empty


def test_a_run_that_started_later_reuses_nothing_of_what_followed(ledger):
    ledger.record("A", "f", 1, [Individual(KEYS[1], "ok", 1.0)])
    ledger.record("B", "f", 1, [Individual(KEYS[2], "ok", 1.0)])  # asked while A was interrupted
    ledger.record("A", "f", 2, [Individual(KEYS[2], "ok", 1.0)])
    assert statuses(ledger, "A") == ["solved", "solved"]


def test_recording_again_changes_nothing(ledger):
    rows = [
        Individual(KEYS[1], "ok", 1.0),
        Individual(KEYS[1], "ok", 1.0),
        Individual(KEYS[2], "failed"),
        Individual(KEYS[3], "infeasible"),
    ]
    for generation in (1, 2):
        ledger.record("A", "f", generation, rows)
    before = ledger.history("A")
    changes = ledger._database.total_changes
    for generation in (1, 2):
        ledger.record("A", "f", generation, rows)
    assert ledger.history("A").equals(before) and ledger._database.total_changes == changes


def test_a_history_tells_one_search(ledger):
    for generation in (1, 2, 3):
        ledger.record("A", "f", generation, [Individual(KEYS[generation], "failed" if generation == 2 else "ok", 1.0)])
    ledger.record("A", "f", 1, [Individual(KEYS[1], "ok", 1.0)])
    ledger.record("A", "f", 2, [Individual(KEYS[2], "ok", 0.5)])  # the machine was mended
    assert ledger.history("A")[["generation", "status"]].values.tolist() == [[1, "solved"], [2, "solved"]]


# -- faults of files ---------------------------------------------------------------------------------------------------


def complaint(path, busy_seconds=0.1):
    with pytest.raises(InputError) as caught, Ledger.open(path, busy_seconds) as ledger:
        ledger.append("f", [ok(x=1.0)])
    assert caught.value.remedy and str(path.parent) in caught.value.place
    return caught.value.problem


def test_what_is_no_ledger(tmp_path):
    text, foreign, newer, like = (tmp_path / f"{name}.sqlite" for name in ("text", "foreign", "newer", "like"))
    text.write_text("parameters, responses\n" * 100)
    with sqlite3.connect(foreign) as other:
        other.execute("CREATE TABLE evaluation (x)")
    with sqlite3.connect(newer) as other:
        other.execute("CREATE TABLE evaluation (x)")
        other.execute("PRAGMA user_version = 99")
    with sqlite3.connect(like) as other:  # its version happens to be one of ours
        other.execute("CREATE TABLE evaluation (x)")
        other.execute("PRAGMA user_version = 1")
    before = [p.read_bytes() for p in (text, foreign, newer, like)]
    assert "not a ledger" in complaint(text)
    assert "not a ledger" in complaint(foreign) and "not a ledger" in complaint(newer)
    assert "not a ledger" in complaint(like)
    assert [p.read_bytes() for p in (text, foreign, newer, like)] == before
    for path in (foreign, newer, like):
        with sqlite3.connect(path) as other:
            assert other.execute("SELECT name FROM sqlite_master").fetchall() == [("evaluation",)]


def test_a_truncated_ledger(tmp_path):
    path = tmp_path / "ledger.sqlite"
    with Ledger.open(path) as ledger:
        ledger.append("f", [ok(x=float(k)) for k in range(200)])
    path.write_bytes(path.read_bytes()[:9000])
    assert "damaged" in complaint(path)


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert "folder cannot be made" in complaint(tmp_path / "file" / "ledger.sqlite")
    (tmp_path / "taken.sqlite").mkdir()
    assert "cannot be opened" in complaint(tmp_path / "taken.sqlite")
    if os.geteuid() != 0:
        (tmp_path / "closed").mkdir(mode=0o500)
        assert complaint(tmp_path / "closed" / "ledger.sqlite")


def test_a_ledger_that_may_not_be_written(ledger):
    ledger._database.execute("PRAGMA query_only = ON")
    with pytest.raises(InputError, match="cannot be written"):
        ledger.append("f", [ok(x=1.0)])


def test_a_full_disk_leaves_whole_batches_only(ledger):
    ledger.append("f", [ok(x=1.0)])
    (pages,) = ledger._database.execute("PRAGMA page_count").fetchone()
    ledger._database.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(InputError, match="disk is full"):
        ledger.append("f", [ok(x=2.0 + k) for k in range(500)])
    assert ledger.count("f") == 1
    ledger._database.execute("PRAGMA max_page_count = 1000000")
    ledger.append("f", [ok(x=2.0)])
    assert ledger.count("f") == 2


def test_an_interrupted_batch_leaves_nothing(ledger):
    class Interrupted:
        def __float__(self):
            assert ledger.count("f") == 2
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ledger.append("f", [ok(x=1.0), ok(x=2.0), replace(ok(x=3.0), responses={"other": Interrupted()})])
    assert ledger.count("f") == 0
    named = replace(ok(x=1.0), responses={"another": 1.0})  # the integer of names that were rolled back is free again
    ledger.append("f", [named, replace(ok(x=2.0), responses={"other": 2.0})])
    assert list(ledger.lookup("f", KEYS[1:2]).values()) == [named]
    assert ledger.lookup("f", KEYS[2:3])[KEYS[2]].responses == {"other": 2.0}


def test_a_locked_ledger(tmp_path):
    path = tmp_path / "ledger.sqlite"
    Ledger.open(path).close()
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    assert "another process" in complaint(path)
    other.execute("ROLLBACK")
    other.close()
    with Ledger.open(path) as ledger:
        ledger.append("f", [ok(x=1.0)])


def _write(path, number, gate):
    gate.wait()
    with Ledger.open(path) as ledger:
        for k in range(40):
            ledger.append("f", [ok(x=float(k)), ok(x=float(1000 * number + k))])


@pytest.mark.medium
def test_processes_on_one_ledger_wait_for_each_other(tmp_path):
    path, gate = tmp_path / "new" / "ledger.sqlite", FORK.Barrier(3)
    writers = [FORK.Process(target=_write, args=(path, k, gate)) for k in (1, 2, 3)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [w.exitcode for w in writers] == [0, 0, 0]
    with Ledger.open(path) as ledger:
        assert ledger.count("f") == 160


def test_with_the_real_evaluator(ledger):
    def function(values):
        return {"y": 1.0 / values["x"]}

    with Evaluator(lambda: function) as evaluator:
        found = ledger.evaluate("f", [{"x": 4.0}, {"x": 0.0}], evaluator)
        assert found == ledger.evaluate("f", [{"x": 4.0}, {"x": 0.0}], evaluator)
    assert found[0] == attempt(function, {"x": 4.0}) and found[1].error.startswith("ZeroDivisionError")
