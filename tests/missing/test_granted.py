"""Effects and faults of the measurement are found together."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.analyses.added import nothing_added, to_add
from calib.missing.decision import decide
from calib.missing.facts import Places
from calib.missing.findings import correction_offered
from calib.missing.tables import faults_table, pull_table
from calib.missing.verdict_words import _checks
from tests.missing.verdict_cases import text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")
NONE: Places = {f"F{k}": ("gain", (np.nan,) * 3, f"{k}y") for k in range(6)}


def told(found):
    return {fault.name: one.magnitude(fault.name) for fault, one in found.faulty}


@pytest.mark.parametrize(
    ("truth", "verdict"),
    [
        ({"F2": 2.0, "F4": -1.5}, "measurement"),
        ({"F0": 2.0, "F2": 2.0, "F4": 2.0}, "measurement"),
        ({"E1": 1.5, "F4": 2.0}, "effect"),
        ({"E1": 1.2, "E3": 1.5, "F4": -2.0}, "two_effects"),
        ({"E1": 2.0, "F2": 2.0, "F4": 2.0}, "effect"),
    ],
)
def test_effects_and_faults_are_told_together(faulty, truth, verdict):
    found = decide(faulty().drawn(np.random.default_rng(1), truth))
    assert found.verdict == verdict and not found.remains
    assert set(found.credible) == {name for name in truth if name[0] == "E"}
    assert set(told(found)) == {name for name in truth if name[0] == "F"}
    for name, (value, std) in told(found).items():
        assert abs(value - truth[name]) < 4 * std
    text = text_of(found)
    assert all(f"{name}, about" in text for name in told(found)) and "measurement" in text
    assert "something is left" not in text and "stands in for something else" not in text


def test_what_to_check_of_several_is_in_the_plural():
    gain, axis = "Check its calibration, its mounting and its sign.", "Check how it is mounted."
    faults = [SimpleNamespace(look_for=text) for text in (gain, axis, gain)]
    assert _checks(faults[1:]) == f"{axis} {gain}"
    assert _checks(faults) == f"Check their calibration, their mounting and their sign. {axis}"


def test_an_effect_alone_grants_no_fault(faulty):
    for seed in range(4):
        found = decide(faulty().drawn(np.random.default_rng(seed), {"E1": 1.5}))
        assert found.verdict == "effect" and found.granted == () and found.faulty == ()


@pytest.mark.medium
def test_more_than_four_are_not_told_as_all(faulty):
    made = faulty(number=6, modes=10, sensors=16)
    found = decide(made.drawn(np.random.default_rng(1), {f"F{k}": 3.0 for k in range(6)}))
    assert len(found.granted) <= 4 and found.credible == ()
    assert found.remains or found.verdict in ("none_explains", "misfit_unlocated", "partial")


@pytest.mark.medium
def test_of_two_faults_alike_the_other_is_granted_where_the_first_leaves_something(faulty, monkeypatch):
    """F2 has most of the pattern of F3 and a part of E1's, so that it stands out while E1 is missing."""
    made = faulty()
    own = {name: column / np.linalg.norm(column) for name, column in made.columns.items()}
    other = np.random.default_rng(3).standard_normal(len(own["F3"]))
    mixed = own["F3"] + 0.35 * own["E1"] + 0.35 * other / np.linalg.norm(other)
    made = replace(made, columns={**made.columns, "F2": 8.0 * mixed / np.linalg.norm(mixed)})
    posed = made.drawn(np.random.default_rng(1), {"E1": 2.0, "F3": 3.0})
    found = decide(posed)
    assert found.verdict == "effect" and found.credible == ("E1",) and set(told(found)) == {"F3"}
    monkeypatch.setattr("calib.missing.granted.alike_faults", lambda *_: False)
    assert set(told(decide(posed))) != {"F3"}


@pytest.mark.parametrize(("rho", "alike"), [(0.999, True), (0.5, False)])
def test_a_fault_like_a_granted_one_is_told_in_its_place(faulty, rho, alike):
    made = faulty().correlated("F2", "F3", rho)
    found = decide(made.drawn(np.random.default_rng(1), {"E1": 2.0, "F2": 3.0}))
    assert found.verdict == "effect" and found.credible == ("E1",)
    (first,) = told(found)
    other = {"F2": "F3", "F3": "F2"}[first]
    assert found.mistakable == (((first, other),) if alike else ())
    assert (f"In the place of {first}, {other} explains about as well" in text_of(found)) == alike


def test_an_effect_like_a_granted_fault_is_told_in_its_place(faulty):
    made = faulty(kind="damping").correlated("F2", "E2", 0.97)
    found = decide(made.drawn(np.random.default_rng(3), {"E1": 2.0, "F2": 3.0}))
    assert found.verdict == "effect" and found.credible == ("E1",) and found.mistakable == (("F2", "E2"),)
    assert "In the place of F2, E2 explains about as well" in text_of(found)
    assert to_add(found) is None and "errors" in nothing_added(found)


def test_two_effects_of_which_one_is_like_added_damping_are_told_with_it(faulty):
    made = faulty(kind="damping").correlated("F2", "E2", 0.97)
    found = decide(made.drawn(np.random.default_rng(1), {"E1": 2.0, "E2": 3.0}))
    assert set(found.credible) == {"E1", "E2"} and found.mistakable == (("E2", "F2"),)
    assert "In the place of E2, F2 explains about as well" in text_of(found)
    assert to_add(found) is None and "E2 and F2" in nothing_added(found)


def test_granted_faults_are_in_the_tables(faulty):
    found = decide(faulty().drawn(np.random.default_rng(1), {"E1": 1.5, "F4": 2.0}))
    (fault,) = found.granted
    table = faults_table(found, NONE, {f"F{k}": replace(fault, magnitude=fault.magnitude) for k in range(6)})
    first = table.iloc[0]
    assert first["fault"] == "F4" and first["blamed"] and first["fitted"] and len(table) == 6
    value, std = found.chosen.magnitude("F4")
    assert first["magnitude"] == value and first["score"] == pytest.approx(value / std)
    assert "F4" not in set(pull_table(found)["parameter"])  # its magnitude is no parameter of the model
    assert f'"F4" = {value:.3g}' in correction_offered(found, lambda name: True)
    assert correction_offered(found, lambda name: False) == ""


def test_a_second_fault_is_told_although_the_standard_deviation_is_overstated(faulty):
    """With the first one in, all fits better than independent errors would; the second stands out all the same."""
    made = faulty(modes=0, sensors=120)
    found = decide(made.drawn(np.random.default_rng(2), {"F2": 3.0, "F4": -1.0}, noise=0.2))
    assert set(told(found)) == {"F2", "F4"}
    assert found.verdict == "measurement" and not found.remains
