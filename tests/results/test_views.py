"""What plain SQL reads in a ledger: every number to its last bit."""

import math
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calib.execution.outcome import Outcome, point_key
from calib.results.ledger import Individual, Ledger
from calib.results.ledger.rows import packed_array

pytestmark = pytest.mark.skipif(sqlite3.sqlite_version_info < (3, 38), reason="the views need SQLite 3.38")


@pytest.mark.medium
@given(st.lists(st.floats(), max_size=8))
@example([0.0, -0.0, 5e-324, -5e-324, 2.225073858507201e-308, 2.2250738585072014e-308, 1.7976931348623157e308])
@example([math.nan, math.inf, -math.inf, 1.0, -1.0, 2.0**-1022, 2.0**1023, 0.1, 1 / 3])
def test_numbers_are_read_to_the_last_bit(numbers):
    with Ledger.in_memory() as ledger:
        ledger.append("f", [Outcome({"x": 1.0}, "ok", {f"r{k}": v for k, v in enumerate(numbers)})])
        ledger.keep_vectors("g", point_key({"x": 1.0}), {"v": np.array(numbers)})
        responses = ledger._database.execute("SELECT name, value FROM responses").fetchall()
        vector = ledger._database.execute("SELECT value FROM vectors ORDER BY place").fetchall()
    wanted = [None if math.isnan(v) else v for v in numbers]
    assert dict(responses) == {f"r{k}": v for k, v in enumerate(wanted)}
    assert [value for (value,) in vector] == wanted


def test_without_calib(tmp_path):
    points = [{"a": 0.1, "b": 1e300}, {"a": 0.2, "b": -3.0}]
    keys = [point_key(p) for p in points]
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        ledger.append("f", [Outcome(points[0], "ok", {"y": 0.3, "z": math.nan}, "", 0.5)])
        ledger.append("f", [Outcome(points[1], "failed", {}, "singular", 0.25)])
        ledger.record("run", "f", 1, [Individual(keys[0], "ok", 0.7), Individual(keys[1], "failed")])
        ledger.keep_vectors("g", keys[0], {"": np.array([1.0, 2.0]), "a": np.array([3.0])})
        when = ledger.stored_at("f", points[0])
    with closing(sqlite3.connect(f"file:{tmp_path / 'ledger.sqlite'}?mode=ro", uri=True)) as database:
        ask = database.execute
        assert ask("SELECT fingerprint, key, attempt, status, error, seconds FROM evaluations").fetchall() == [
            ("f", keys[0], 1, "ok", "", 0.5),
            ("f", keys[1], 1, "failed", "singular", 0.25),
        ]
        assert ask("SELECT strftime('%Y-%m-%d %H:%M UTC', MIN(created)) FROM evaluations").fetchone() == (when,)
        assert ask("SELECT key, attempt, name, value FROM parameters").fetchall() == [
            (key, 1, name, value) for key, point in zip(keys, points, strict=True) for name, value in point.items()
        ]
        assert ask("SELECT fingerprint, key, name, value FROM responses").fetchall() == [
            ("f", keys[0], "y", 0.3),
            ("f", keys[0], "z", None),
        ]
        assert ask("SELECT * FROM individuals").fetchall() == [
            ("run", 1, 0, "f", keys[0], "solved", 0.7),
            ("run", 1, 1, "f", keys[1], "failed", None),
        ]
        assert sorted(ask("SELECT * FROM vectors").fetchall()) == [
            ("g", keys[0], "", 0, 1.0),
            ("g", keys[0], "", 1, 2.0),
            ("g", keys[0], "a", 0, 3.0),
        ]


@pytest.mark.medium
def test_names_stand_once(tmp_path):
    """Bytes of a row: its numbers and little else, whatever the length of names."""
    parameters, responses, count = 16, 48, 1000
    rng = np.random.default_rng(1)
    drawn = rng.uniform(1.0, 1e4, (count, parameters + responses))
    names = [f"a_name_of_ordinary_length_{k}" for k in range(parameters + responses)]
    outcomes = [
        Outcome(dict(zip(names[:parameters], x[:parameters], strict=True)), "ok",
                dict(zip(names[parameters:], x[parameters:], strict=True)), "", 0.1)
        for x in drawn.tolist()
    ]  # fmt: skip
    path = tmp_path / "ledger.sqlite"
    Ledger.open(path).close()
    empty = path.stat().st_size
    with Ledger.open(path) as ledger:
        for outcome in outcomes:
            ledger.append("f" * 16, [outcome])
    evaluated = path.stat().st_size
    with Ledger.open(path) as ledger:
        for generation in range(count // 20):
            asked = [
                Individual(point_key(o.values), "ok", 0.5) for o in outcomes[20 * generation : 20 * generation + 20]
            ]
            ledger.record("a run with a long name", "f" * 16, generation, asked)
    recorded = path.stat().st_size
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT COUNT(*) FROM names").fetchone() == (2,)
    # Key, its index and that of attempts, time and status, and what pages leave free.
    assert 8 * drawn.shape[1] < (evaluated - empty) / count < 8 * drawn.shape[1] + 160
    assert (recorded - evaluated) / count < 110
    assert packed_array(drawn[0]) == drawn[0].astype("<f8").tobytes()
