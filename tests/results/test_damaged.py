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


def damaged(data, rng):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20, 200))):
        at = rng.randrange(len(out))
        out[at] = rng.choice((0, 255, rng.randrange(256), out[at] ^ (1 << rng.randrange(8))))
    return bytes(out[: rng.randrange(len(out))] if rng.random() < 0.1 else out)


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
                assert all(isinstance(outcome, Outcome) for outcome in found.values())
                ledger.count("f"), ledger.other_fingerprints("g"), ledger.history("run")
                ledger.stored("f"), ledger.failed("f"), ledger.stored_at("f", POINTS[3])
                ledger.vectors("rows", point_key(POINTS[0]), ["", "a"])
                ledger.append("f", [Outcome({"a": 99.0, "b": 1.0}, "ok", {"r": 1.0}, "", 0.1)])
                ledger.record("run", "f", 1, [Individual(point_key(p), "ok", 1.0) for p in POINTS[5:25]])
            told.add("used")
        except InputError as fault:
            assert path.name in str(fault) and "\n" not in str(fault)
            told.add("refused")
    assert told == {"used", "refused"}
