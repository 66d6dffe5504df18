"""The benchmark of the four kinds: what is drawn has the scores that it states, and what counts as told."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.fixture(scope="module")
def four():
    """The script, and what it imports by name."""
    sys.path.insert(0, str(BENCH))
    try:
        yield importlib.import_module("rates_four")
    finally:
        sys.path.remove(str(BENCH))


@pytest.fixture(scope="module")
def world(four, tmp_path_factory):
    return four.FourFrameWorld(four.FRAME_FAULT, tmp_path_factory.mktemp("four"), "test")


@pytest.mark.medium
def test_a_hidden_effect_and_fault_are_seen_with_the_other_free(four, world):
    """The change that is left is at most that with nothing but the parameters free, and at least the least."""
    both = next(s for s in four.KINDS if s.group == "both")
    measured = world.measure(both, 0)
    assert set(measured.scores) == {"effect", "fault"} and min(measured.scores.values()) >= four.LEAST
    assert len(measured.hidden) == 1 and measured.fault in four.FAULTS and measured.right
    again = world.measure(both, 0)
    assert np.array_equal(measured.whole.shapes, again.whole.shapes)  # the seed is the case
    assert not np.allclose(measured.clean.natural_freq, world.measure(both, 1).clean.natural_freq)


@pytest.mark.medium
def test_nothing_has_no_score(four, world):
    measured = world.measure(four.KINDS[0], 0)
    assert measured.scores == {} and measured.hidden == () and measured.fault == ""


ROW = {"group": "both", "verdict": "effect", "outcome": "right", "hidden": ["brace"], "credible": ["brace"],
       "fault": "gain", "fault_right": "5x", "faults_told": ["gain of sensor 5x"], "measurement_too": False,
       "equally_good": ["brace"]}  # fmt: skip
ALONE = ROW | {"group": "fault", "verdict": "measurement", "outcome": "measurement", "hidden": [], "credible": []}
NONE = ALONE | {"group": "nothing", "verdict": "nothing_detectable", "fault": "", "fault_right": "", "faults_told": []}


@pytest.mark.parametrize(
    ("row", "right", "alarm", "wrong"),
    [
        (ROW, True, False, False),
        (ROW | {"faults_told": []}, False, False, False),
        (ROW | {"faults_told": ["gain of sensor 15x"]}, False, False, False),
        (ROW | {"faults_told": ["cross-talk of sensor 4x into 5x"]}, True, False, False),
        (ROW | {"faults_told": ["cross-talk of sensor 5x into 4x"]}, False, False, False),
        (ROW | {"credible": ["machine"], "outcome": "wrong"}, False, False, True),
        (ROW | {"credible": ["brace", "machine"], "outcome": "extra"}, False, False, False),
        (ALONE, True, False, False),
        (ALONE | {"faults_told": [], "verdict": "none_explains"}, False, True, False),
        (ALONE | {"faults_told": [], "verdict": "partial", "measurement_too": True}, False, False, False),
        (ALONE | {"fault_right": "exchange of sensors 1x and 2x"}, False, False, False),
        (ALONE | {"verdict": "effect", "credible": ["brace"], "outcome": "wrong"}, False, True, True),
        (NONE, True, False, False),
        (NONE | {"verdict": "none_explains"}, False, True, False),
        (NONE | {"verdict": "effect", "credible": ["brace"], "outcome": "wrong"}, False, True, True),
    ],
)
def test_what_counts(four, row, right, alarm, wrong):
    assert (four.is_right(row), four.is_alarm(row), four.is_wrong(row)) == (right, alarm, wrong)


def test_rates_count_each_kind_by_its_own_criterion(four):
    single = ROW | {"group": "single", "fault": "", "fault_right": "", "faults_told": []}
    found = {rate.hidden: rate for rate in four.rates([ROW, ALONE, NONE, single, ROW | {"faults_told": []}])}
    assert (found["an effect and a fault"].count, found["an effect and a fault"].n) == (1, 2)
    assert (found["an effect alone"].count, found["a fault alone"].n, found["any"].n) == (1, 1, 5)
