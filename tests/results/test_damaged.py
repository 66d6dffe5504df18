"""A ledger whose bytes have changed is used or refused in one sentence; nothing else happens."""

import random

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.execution.outcome import Outcome, point_key
from calib.results.ledger import Individual, Ledger

POINTS = [{"a": float(k), "b": 2.0} for k in range(60)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a ledger with two batches and one generation."""
    path = tmp_path_factory.mktemp("ledger") / "whole.sqlite"
    with Ledger.open(path) as ledger:
        ledger.append("f", [Outcome(p, "ok", {"r": p["a"]}, "", 0.1) for p in POINTS])
        ledger.record("run", "f", 0, [Individual(point_key(p), "ok", p["a"]) for p in POINTS[:20]])
        ledger.keep_vectors("rows", point_key(POINTS[0]), {"": np.ones(50), "a": np.zeros(50)})
    return path.read_bytes()


@pytest.fixture(scope="module")
def of_version_1(contents, tmp_path_factory):
    """Bytes of the same evaluations before they are converted."""
    path = tmp_path_factory.mktemp("ledger") / "former.sqlite"
    contents([("f", Outcome(p, "ok", {"r": p["a"]}, "", 0.1)) for p in POINTS]).write(path)
    return path.read_bytes()


class Doubling:
    """Evaluates points and notes them."""

    isolated = False

    def __init__(self):
        self.asked = []

    def evaluate(self, points, arrived):
        self.asked += points
        outcomes = [Outcome(dict(p), "ok", {"r": p["a"]}, "", 0.1) for p in points]
        for outcome in outcomes:
            arrived(outcome)
        return outcomes


CHANGES = {  # a table, and what happens to its columns
    "evaluation": ["responses = x'0000000000000040'", "parameters = responses || responses", "status = 'failed'",
                   "error = 'b'", "attempt = 7", "responses = x'00'", "parameter_names = response_names",
                   "response_names = 99", "checksum = x''"],
    "names": ["""names = '["q"]' WHERE names = '["r"]' OR 0""", "names = 'no list'", "names = CAST(x'ff' AS TEXT)"],
}  # fmt: skip


@pytest.mark.parametrize(("table", "change"), [(table, one) for table, many in CHANGES.items() for one in many])
def test_a_changed_row_is_evaluated_again_and_counted(tmp_path, table, change):
    path, points = tmp_path / "ledger.sqlite", POINTS[:3]
    with Ledger.open(path) as ledger:
        ledger.append("f", [Outcome(p, "ok", {"r": p["a"]}, "", 0.1) for p in points])
        ledger._database.execute(f"DROP TRIGGER {table}_stays")
        if "WHERE" not in change and table == "evaluation":
            change += " WHERE id = 2"
        elif "WHERE" not in change:
            change += " WHERE id = 1"
        ledger._database.execute(f"UPDATE {table} SET {change}")
    touched = points[1:2] if table == "evaluation" else points
    for expected in (touched, []):
        with Ledger.open(path) as ledger:
            found = ledger.evaluate("f", points, doubling := Doubling())
            assert doubling.asked == expected and ledger.damaged == len(expected)
            assert [o.responses for o in found] == [{"r": p["a"]} for p in points]
            assert ledger.stored("f") in found and ledger.failed("f") == [] and ledger.count("f") >= 2


def test_a_changed_vector_is_not_there_and_is_replaced(tmp_path):
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        ledger.keep_vectors("f", key := point_key(POINTS[0]), {"": np.ones(2), "a": np.zeros(2)})
        ledger._database.execute("UPDATE vector SET numbers = x'00000000000000000000000000000040' WHERE name = 'a'")
        assert list(ledger.vectors("f", key, ["", "a"])) == [""] and ledger.damaged == 1
        ledger.keep_vectors("f", key, {"": np.full(2, 5.0), "a": np.full(2, 7.0)})
        found = ledger.vectors("f", key, ["", "a"])
        assert found[""].tolist() == [1.0, 1.0] and found["a"].tolist() == [7.0, 7.0]


def damaged(data, rng):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20, 200))):
        at = rng.randrange(len(out))
        out[at] = rng.choice((0, 255, rng.randrange(256), out[at] ^ (1 << rng.randrange(8))))
    return bytes(out[: rng.randrange(len(out))] if rng.random() < 0.1 else out)


@pytest.mark.medium
@pytest.mark.parametrize("trials", [range(60), pytest.param(range(60, 260), marks=pytest.mark.slow)], ids=len)
@pytest.mark.parametrize("version", ["whole", "of_version_1"])
def test_a_damaged_ledger_is_used_or_refused(version, trials, request, tmp_path):
    whole, told = request.getfixturevalue(version), set()
    for number in trials:
        path = tmp_path / f"{number}.sqlite"
        path.write_bytes(damaged(whole, random.Random(number)))
        try:
            with Ledger.open(path, busy_seconds=1.0) as ledger:
                found = ledger.lookup("f", map(point_key, POINTS))
                assert all(o == Outcome(o.values, "ok", {"r": o.values["a"]}) for o in found.values())
                assert all(key == point_key(o.values) for key, o in found.items())
                ledger.count("f"), ledger.other_fingerprints("g"), ledger.history("run")
                ledger.stored("f"), ledger.failed("f"), ledger.stored_at("f", POINTS[3])
                vectors = ledger.vectors("rows", point_key(POINTS[0]), ["", "a"])
                assert all(np.array_equal(v, np.full(50, 0.0 if name else 1.0)) for name, v in vectors.items())
                ledger.append("f", [Outcome({"a": 99.0, "b": 1.0}, "ok", {"r": 1.0}, "", 0.1)])
                ledger.record("run", "f", 1, [Individual(point_key(p), "ok", 1.0) for p in POINTS[5:25]])
            told.add("used")
        except InputError as fault:
            assert path.name in str(fault) and "\n" not in str(fault)
            told.add("refused")
    assert told == {"used", "refused"}
