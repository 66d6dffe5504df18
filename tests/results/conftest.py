"""Ledgers of version 1, as they were written before numbers were stored as bytes."""

import contextlib
import json
import math
import random
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from calib.execution.outcome import WORKER_DIED, Outcome, point_key
from calib.results.ledger import Ledger

TABLES = (
    """CREATE TABLE evaluation (
        id INTEGER PRIMARY KEY,
        fingerprint TEXT NOT NULL,
        key TEXT NOT NULL,
        attempt INTEGER NOT NULL,
        parameters TEXT NOT NULL,
        responses TEXT NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('ok', 'failed')),
        error TEXT NOT NULL,
        seconds REAL NOT NULL,
        created TEXT NOT NULL,
        UNIQUE (fingerprint, key, attempt))""",
    """CREATE TABLE history (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        run TEXT NOT NULL,
        generation INTEGER NOT NULL,
        individual INTEGER NOT NULL,
        fingerprint TEXT NOT NULL,
        key TEXT NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('solved', 'reused', 'infeasible', 'failed')),
        misfit REAL,
        UNIQUE (run, generation, individual))""",
    "CREATE INDEX history_key ON history (fingerprint, key)",
    "CREATE TRIGGER evaluation_stays BEFORE UPDATE ON evaluation BEGIN SELECT RAISE(ABORT, 'append-only'); END",
    "CREATE TRIGGER evaluation_remains BEFORE DELETE ON evaluation BEGIN SELECT RAISE(ABORT, 'append-only'); END",
    "PRAGMA user_version = 1",
)
VECTORS = """CREATE TABLE vector (
    fingerprint TEXT NOT NULL,
    key TEXT NOT NULL,
    name TEXT NOT NULL,
    numbers BLOB NOT NULL,
    PRIMARY KEY (fingerprint, key, name)) WITHOUT ROWID"""
BEGAN = datetime(2026, 3, 1, 10, 0, tzinfo=UTC)


@dataclass(frozen=True)
class Contents:
    """Synthetic contents: evaluations with their fingerprint in the order of their making, runs, vectors."""

    evaluations: Sequence[tuple[str, Outcome]]
    individuals: Sequence[tuple[str, int, int, str, str, str, float | None]] = ()
    vectors: Sequence[tuple[str, str, str, np.ndarray]] = field(default=())

    def last(self) -> dict[tuple[str, str], Outcome]:
        """Of several attempts the last one."""
        return {(fingerprint, point_key(o.values)): o for fingerprint, o in self.evaluations}

    def write(self, path: Path, with_vectors: bool = True) -> None:
        """A ledger of version 1."""
        attempts: dict[tuple[str, str], int] = {}
        with contextlib.closing(sqlite3.connect(path)) as database, database:
            for statement in (*TABLES, *[VECTORS] * with_vectors):
                database.execute(statement)
            for number, (fingerprint, o) in enumerate(self.evaluations):
                key = point_key(o.values)
                attempts[fingerprint, key] = attempts.get((fingerprint, key), 0) + 1
                database.execute(
                    "INSERT INTO evaluation (fingerprint, key, attempt, parameters, responses, status, error, seconds,"
                    " created) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    (
                        fingerprint, key, attempts[fingerprint, key], text(o.values), text(o.responses), o.status,
                        o.error, o.seconds, (BEGAN + timedelta(minutes=number)).isoformat(timespec="milliseconds"),
                    ),
                )  # fmt: skip
            database.executemany(
                "INSERT INTO history (run, generation, individual, fingerprint, key, status, misfit)"
                " VALUES (?, ?, ?, ?, ?, ?, ?)",
                self.individuals,
            )
            if with_vectors:
                database.executemany(
                    "INSERT INTO vector VALUES (?, ?, ?, ?)",
                    [(*of, v.astype("<f8").tobytes()) for *of, v in self.vectors],
                )

    def check(self, ledger: Ledger, with_vectors: bool = True) -> None:
        """Whether all of it is in a ledger, every number to its last bit."""
        last = self.last()
        for one in {fingerprint for fingerprint, _ in last}:
            keys = [key for fingerprint, key in last if fingerprint == one]
            found = ledger.lookup(one, keys)
            assert {key: repr(found[key]) for key in keys} == {key: repr(last[one, key]) for key in keys}
            assert ledger.count(one) == len(keys)
        assert ledger.other_fingerprints() == len(self.evaluations)
        for run in {row[0] for row in self.individuals}:
            history = ledger.history(run).values.tolist()
            wanted = sorted([g, i, key, status, m] for name, g, i, _, key, status, m in self.individuals if name == run)
            assert repr(history) == repr([[*row[:4], math.nan if row[4] is None else row[4]] for row in wanted])
        for fingerprint, key, name, numbers in self.vectors if with_vectors else ():
            assert ledger.vectors(fingerprint, key, [name])[name].tobytes() == numbers.tobytes()


def text(numbers: dict[str, float]) -> str:
    return json.dumps({name: None if math.isnan(value) else value for name, value in numbers.items()})


@pytest.fixture(scope="session")
def former() -> Contents:
    """Two states of a model, every kind of outcome, awkward numbers, two searches and vectors."""
    rng = random.Random(3)
    awkward = (0.1, -0.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, -1e22, 123456789.12345679)
    points = [{"a": rng.uniform(0.0, 1e4), "b": b, "ü": float(k)} for k, b in enumerate(awkward * 8)]
    evaluations = [("one", Outcome(p, "ok", {"r": rng.gauss(0.0, 1.0), "s": p["b"]}, "", rng.random())) for p in points]
    evaluations[7] = ("one", Outcome(points[7], "ok", {"r": math.nan, "s": 3.0}, "", 0.1))
    evaluations[9] = ("one", Outcome(points[9], "failed", {}, WORKER_DIED, 0.1))
    evaluations[11] = ("one", Outcome(points[11], "failed", {}, "singular — é", 0.1))
    evaluations += [("one", Outcome(points[9], "ok", {"r": 1.0, "s": 2.0}, "", 0.2))]
    evaluations += [("two", Outcome(p, "ok", {"t": p["a"] / 3.0}, "", 0.3)) for p in points[:20]]
    keys = [point_key(p) for p in points]
    outside = point_key({"a": -1.0})  # never evaluated
    individuals: list[tuple[str, int, int, str, str, str, float | None]] = []
    for run, fingerprint, start in (("A:1", "one", 0), ("B:2", "two", 5)):
        for generation in (1, 2, 3):
            asked = [(key, "solved", rng.random()) for key in keys[start : start + 4]]
            asked += [(outside, "infeasible", None), (keys[11], "failed", None), (keys[start], "reused", 0.25)]
            individuals += [(run, generation, k, fingerprint, *one) for k, one in enumerate(asked)]
    vectors = [
        ("rows", key, n, np.random.default_rng(k).normal(size=37)) for k, key in enumerate(keys[:6]) for n in "ab"
    ]
    return Contents(evaluations, individuals, [*vectors, ("rows", keys[0], "", np.array([math.nan, -0.0, 5e-324]))])


@pytest.fixture(scope="session")
def contents() -> type[Contents]:
    return Contents
