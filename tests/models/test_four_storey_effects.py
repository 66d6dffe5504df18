"""The measured rig and what its model may lack: closed forms, and the answer to its measurement."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.structure import extend
from models.four_storey_effects import GRAVITY, four_storey_effects, leaf_mass
from models.four_storey_rig import LEAF_LENGTH, MASS, STOREYS, four_storey_rig, storey_stiffness

STUDY = Path(__file__).resolve().parents[2] / "studies/four_storey_rig_missing"
K = storey_stiffness()
FRAME = 2 * np.sin((2 * np.arange(1, STOREYS + 1) - 1) * np.pi / (2 * (2 * STOREYS + 1)))
"""Natural circular frequencies of a uniform chain over sqrt(k / m), clamped below and free above."""


@pytest.fixture(scope="module")
def rig():
    return extend(four_storey_rig(damped=True), four_storey_effects())


def matrices(rig, **values):
    return [np.asarray(m.toarray()) for m in rig.matrices(values)]


def test_dashpots_alike_give_damping_in_proportion_to_the_frequency(rig):
    modes = rig.modes({"c": 1.2}, STOREYS)
    omega = FRAME * np.sqrt(K / MASS)
    np.testing.assert_allclose(modes.natural_freq, omega / (2 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratio, 1.2 * omega / (2 * K), rtol=1e-9)


def test_air_gives_damping_in_inverse_proportion_to_the_frequency(rig):
    modes = rig.modes({"c": 0.0, "air": 0.3}, STOREYS)
    np.testing.assert_allclose(modes.damping_ratio, 0.3 / (2 * MASS * FRAME * np.sqrt(K / MASS)), rtol=1e-9)


def test_a_foundation_is_in_series_with_the_lowest_storey(rig):
    flexibility = 20e-6
    stiffness = matrices(rig, foundation=20.0)[0] - matrices(rig)[0]
    assert stiffness[0, 0] == pytest.approx(1 / (1 / K + flexibility) - K, rel=1e-9)
    assert np.count_nonzero(stiffness) == 1


def test_weight_softens_a_storey_by_six_fifths_of_the_load_over_its_length(rig):
    upright, lying = matrices(rig, gravity=1.0)[0], matrices(rig)[0]
    assert (lying - upright) @ np.ones(STOREYS) == pytest.approx(
        [1.2 * STOREYS * MASS * GRAVITY / LEAF_LENGTH, 0, 0, 0], rel=1e-9, abs=1e-9
    )
    top = np.zeros(STOREYS)
    top[-1] = 1.0
    assert top @ (lying - upright) @ top == pytest.approx(1.2 * MASS * GRAVITY / LEAF_LENGTH, rel=1e-9)


def test_leaf_springs_that_move_with_both_ends_weigh_what_they_weigh(rig):
    mass = matrices(rig, leaf_mass=leaf_mass() * 1e3)[2] - matrices(rig)[2]
    every = np.ones(STOREYS)
    # Three storeys move whole; of the lowest, clamped below, 13/35 move.
    assert every @ mass @ every == pytest.approx((3 + 13 / 35) * leaf_mass(), rel=1e-9)


def test_rocking_is_a_leaf_spring_on_a_hinge_to_first_order(rig):
    """One storey alone: the mass turns by f k L/2 per drift, so the stiffness k is lost by f (k L/2)^2."""
    lost = matrices(rig)[0] - matrices(rig, joint_rotation=2.0)[0]
    top = np.zeros(STOREYS)
    top[-1] = 1.0
    # The top drifts against the third mass: moments act on both.
    assert top @ lost @ top == pytest.approx(2 * 2e-3 * (K * LEAF_LENGTH / 2) ** 2, rel=1e-9)
    assert np.linalg.eigvalsh(lost).min() > -1e-6 * np.abs(lost).max()


@pytest.fixture(scope="module")
def why(tmp_path_factory):
    study = calib.Study.load(STUDY, tmp_path_factory.mktemp("rig"), workers=1)
    return study.problem.calibrate(starts=1, progress=False).explain(list(four_storey_effects()), progress=False)


@pytest.mark.medium
def test_the_measured_damping_shows_loss_at_the_ground(why):
    assert why.verdict == "effect"
    row = why.table.iloc[0]
    assert row["name"] == "foundation_damping" and row["magnitude_low"] > 1.0 and row["magnitude_high"] < 2.0


@pytest.mark.medium
def test_frequencies_show_none_of_the_other_effects(why):
    scores = why.table.set_index("name")["z"].abs()
    assert scores[["foundation", "joint_rotation", "leaf_mass", "gravity", "top_mass", "cable"]].max() < 2.5


@pytest.mark.slow
def test_without_that_effect_its_place_is_found_and_nothing_is_named():
    study = calib.Study.load(STUDY, workers=1)
    library = [e for e in four_storey_effects() if e.name != "foundation_damping"]
    found = study.problem.calibrate(starts=1, progress=False).explain(library, progress=False)
    assert found.verdict in ("none_explains", "partial", "indistinguishable")
    perturbation = found.explanation.explanation.perturbation
    assert perturbation is not None and "c1" in str(perturbation.names)


@pytest.mark.medium
def test_four_frequencies_for_four_parameters_tell_nothing():
    study = calib.Study.load(STUDY.parent / "four_storey_rig", workers=1)
    found = study.problem.calibrate(starts=1, progress=False).explain((), progress=False)
    assert not found.explanation.explanation.base_adequacy.can_tell
    assert "Nothing can be told" in str(found)


def test_measured_values_are_those_of_the_data_set():
    measured = pd.read_csv(STUDY.parent / "four_storey_rig/measured.csv", comment="#")
    assert measured["damping"].tolist() == [0.005979, 0.012586, 0.010997, 0.009148]
