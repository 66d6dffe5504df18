"""A ledger of version 1 is converted when it is opened: wholly or not at all, and with the same contents."""

import multiprocessing
import os
import signal
import sqlite3
from contextlib import closing

import pytest

from calib.errors.errors import InputError
from calib.execution.outcome import Outcome, point_key
from calib.results.ledger import Individual, Ledger, ledger
from calib.results.ledger.database import Database

FORK = multiprocessing.get_context("fork")


def raw(path, query):
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def version(path):
    return raw(path, "PRAGMA user_version")[0][0]


@pytest.mark.medium
@pytest.mark.parametrize("with_vectors", [True, False])
def test_every_bit_is_kept(former, tmp_path, with_vectors):
    path = tmp_path / "ledger.sqlite"
    former.write(path, with_vectors)
    for _ in range(2):  # converted, and then not again
        with Ledger.open(path) as opened:
            former.check(opened, with_vectors)
    assert version(path) == 3 and raw(path, "PRAGMA integrity_check") == [("ok",)]
    assert [name for (name,) in raw(path, "SELECT name FROM sqlite_master") if name.startswith("former")] == []


def without_checksums(path):
    """Turn a ledger into one of version 2."""
    with closing(sqlite3.connect(path)) as database:
        for table in ("evaluation", "vector"):
            database.execute(f"ALTER TABLE {table} DROP COLUMN checksum")
        database.execute("PRAGMA user_version = 2")
        database.commit()


def test_every_bit_of_version_2_is_kept(former, tmp_path):
    path = tmp_path / "ledger.sqlite"
    former.write(path, True)
    Ledger.open(path).close()
    before = [raw(path, f"SELECT * FROM {table}") for table in ("evaluation", "vector", "history")]
    without_checksums(path)
    for _ in range(2):
        with Ledger.open(path) as opened:
            former.check(opened, True)
            assert opened.damaged == 0
            with pytest.raises(sqlite3.IntegrityError, match="append-only"):
                opened._database.execute("UPDATE evaluation SET seconds = 0")
    assert version(path) == 3 and raw(path, "PRAGMA integrity_check") == [("ok",)]
    now = [raw(path, f"SELECT * FROM {table}") for table in ("evaluation", "vector", "history")]
    assert now == before


def test_a_row_of_version_2_whose_key_is_not_that_of_its_parameters_counts_as_not_there(tmp_path):
    path = tmp_path / "ledger.sqlite"
    outcome = Outcome({"a": 1.0}, "ok", {"r": 2.0}, "", 0.1)
    with Ledger.open(path) as opened:
        opened.append("f", [outcome])
        opened._database.execute("DROP TRIGGER evaluation_stays")
        opened._database.execute("UPDATE evaluation SET parameters = x'000000000000F0BF'")
    without_checksums(path)
    with Ledger.open(path) as opened:
        assert opened.lookup("f", [point_key(outcome.values)]) == {} and opened.damaged == 1


def test_what_a_search_asks_is_answered_as_before(former, tmp_path):
    path = tmp_path / "ledger.sqlite"
    former.write(path)
    values = former.evaluations[-1][1].values
    with Ledger.open(path) as opened:
        assert opened.stored_at("two", values) == "2026-03-01 11:16 UTC"
        assert [o.error for o in opened.failed("one")] == ["singular — é"]
        assert opened.stored("one") in former.last().values()
        attempts = raw(path, "SELECT attempt, status FROM evaluations WHERE attempt = 2")
        assert attempts == [(2, "ok")]
        order = [(fingerprint, point_key(o.values)) for fingerprint, o in former.evaluations]
        assert raw(path, "SELECT fingerprint, key FROM evaluations ORDER BY created") == order
        keys = [row[4] for row in former.individuals if row[0] == "A:1" and row[1] == 1]
        asked = [Individual(key, "ok", 1.0) for key in keys]
        opened.record("C:3", "one", 1, asked)
        # Infeasible points were never evaluated, so that the first such point is not reused; every other one is.
        assert opened.history("C:3")["status"].tolist() == ["reused"] * 4 + ["solved"] + ["reused"] * 2
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            opened._database.execute("DELETE FROM evaluation")


@pytest.mark.medium
def test_the_disk_gets_its_room_back(contents, tmp_path, monkeypatch):
    many = [
        Outcome({f"p{k}": i + k / 7.0 for k in range(16)}, "ok", {f"r{k}": i / (k + 3.0) for k in range(48)}, "", 0.1)
        for i in range(1000)
    ]
    path = tmp_path / "ledger.sqlite"
    contents([("f", outcome) for outcome in many]).write(path)
    before = path.stat().st_size
    with monkeypatch.context() as patch:
        patch.setattr(Database, "shrink", lambda self: None)  # as if the process had been killed there
        Ledger.open(path).close()
    converted = path.stat().st_size
    with Ledger.open(path) as opened, Ledger.open(tmp_path / "new.sqlite") as new:
        new.append("f", many)
        keys = [point_key(o.values) for o in many]
        assert opened.lookup("f", keys) == new.lookup("f", keys)
    assert before < converted and path.stat().st_size <= (tmp_path / "new.sqlite").stat().st_size < 0.4 * before


# -- interrupted -------------------------------------------------------------------------------------------------------


def traced(path, callback):
    """Open a ledger; every statement is told to the callback first."""
    connected = ledger.connected

    def watched(*given):
        database = connected(*given)
        database.set_trace_callback(callback)
        return database

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ledger, "connected", watched)
        Ledger.open(path).close()


def _killed_at(path, number):
    calls = 0

    def count(statement):
        nonlocal calls
        calls += 1
        if calls == number:
            os.kill(os.getpid(), signal.SIGKILL)

    traced(path, count)


@pytest.mark.slow
def test_killed_at_any_statement_nothing_is_lost(former, tmp_path):
    statements = []
    former.write(tmp_path / "whole.sqlite")
    traced(tmp_path / "whole.sqlite", statements.append)
    begun, done = statements.index("BEGIN IMMEDIATE"), statements.index("COMMIT")
    assert done - begun > 200
    left = set()
    for place in {*range(begun, done, (done - begun) // 12), done - 1, done, done + 1}:
        path = tmp_path / f"{place}.sqlite"
        former.write(path)
        process = FORK.Process(target=_killed_at, args=(path, place + 1))
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        left.add(version(path))
        assert version(path) == (1 if place <= done else 3)
        with Ledger.open(path) as opened:
            former.check(opened)
    assert left == {1, 3}


def test_a_full_disk_leaves_the_ledger_as_it_was(former, tmp_path, monkeypatch):
    path, connected = tmp_path / "ledger.sqlite", ledger.connected
    former.write(path)
    before = raw(path, "SELECT * FROM evaluation ORDER BY id"), raw(path, "SELECT * FROM history ORDER BY id")

    def full(*given):
        database = connected(*given)
        (pages,) = database.execute("PRAGMA page_count").fetchone()
        database.execute(f"PRAGMA max_page_count = {pages + 8}")
        return database

    with monkeypatch.context() as patch:
        patch.setattr(ledger, "connected", full)
        with pytest.raises(InputError, match="disk is full"):
            Ledger.open(path)
    assert version(path) == 1 and raw(path, "PRAGMA integrity_check") == [("ok",)]
    after = raw(path, "SELECT * FROM evaluation ORDER BY id"), raw(path, "SELECT * FROM history ORDER BY id")
    assert after == before
    with Ledger.open(path) as opened:
        former.check(opened)


def _opened(path, number, gate):
    gate.wait()
    with Ledger.open(path) as opened:
        opened.append("three", [Outcome({"x": float(number)}, "ok", {"y": 1.0}), Outcome({"x": 0.0}, "ok", {"y": 0.0})])


@pytest.mark.medium
def test_processes_that_open_it_at_once_convert_it_once(former, tmp_path):
    path, gate = tmp_path / "ledger.sqlite", FORK.Barrier(3)
    former.write(path)
    processes = [FORK.Process(target=_opened, args=(path, k, gate)) for k in (1, 2, 3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0, 0]
    with Ledger.open(path) as opened:
        assert opened.count("three") == 4 and opened.other_fingerprints("three") == len(former.evaluations)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE evaluation SET responses = '{\"r\": ' WHERE id = 30",
        "UPDATE evaluation SET parameters = '[1.0]' WHERE id = 3",
        "UPDATE evaluation SET key = 'no key' WHERE id = 3",
        "UPDATE evaluation SET created = 'yesterday' WHERE id = 3",
        "UPDATE history SET key = x'00' WHERE id = 3",
        "UPDATE vector SET numbers = x'00' WHERE name = 'a'",
        "DROP TABLE history",
    ],
)
def test_a_damaged_one_is_refused_and_stays(former, tmp_path, damage):
    path = tmp_path / "ledger.sqlite"
    former.write(path)
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("DROP TRIGGER evaluation_stays")
        database.execute(damage)
    before = raw(path, "SELECT * FROM evaluation")
    with pytest.raises(InputError) as caught:
        Ledger.open(path)
    assert caught.value.place == str(path) and caught.value.remedy
    assert version(path) == 1 and raw(path, "SELECT * FROM evaluation") == before
