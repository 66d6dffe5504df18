"""What is no tire is refused in one sentence when given; what the theory cannot follow ends with its good steps."""

import re
from dataclasses import replace

import numpy as np
import pytest

from calib import EvaluationError, InputError
from models.tire import base_tire
from models.tire import load_curve as curves
from models.tire.laminate import Ply
from models.tire.load_curve import REFUSED_ROTATION, WARNED_ROTATION, RotationWarning, load_curve, press_to_load
from models.tire.micromechanics import CordRubber, isotropic
from models.tire.profile import Profile

NAN, INF = float("nan"), float("inf")


def sentence(fault):
    """One sentence: an error's text has no second one and no line break."""
    text = str(fault.value)
    assert "\n" not in text and not re.search(r"\.\s+[A-Z]", text)
    return text


WRONG = {
    "n_plies": (3, 0, 2.5, NAN),
    "ply_thickness": (-1e-3, 0.0, NAN, INF),
    "crown_angle": (0.0, -0.1, 2.0, 38.0, NAN),
    "rule": ("of thumb",),
    "belt_thickness": (-1e-3, NAN, INF),
    "belt_modulus": (-1.0, 0.0, NAN),
    "belt_angle": (2.0, 20.0, NAN),
    "tread_thickness": (-1e-3, NAN),
    "tread_modulus": (-1.0, 0.0, NAN),
    "tread_compliance": (-1e-9, NAN, INF),
    "tread_width": (0.0, 1.1, NAN),
    "density": (-1.0, 0.0, NAN),
    "soft_bead": (1.0, 1.5, NAN),
    "thin_sidewall": (1.0, NAN),
    "halpin_tsai": (NAN,),
    "crown_mass": (-100.0, NAN),
    "uncoupled": (-0.1, 1.1, NAN),
    "dead_pressure": (-0.1, 1.1, NAN),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_value_of_a_tire_is_refused_when_it_is_given(name):
    for value in WRONG[name]:
        with pytest.raises(InputError) as fault:
            replace(base_tire(), **{name: value})
        said = sentence(fault)
        assert set(name.split("_")) & set(re.split(r"\W+|_", said)), said  # it names the thing


def test_angles_in_degrees_are_met_with_a_word_on_radians():
    for name in ("crown_angle", "belt_angle"):
        with pytest.raises(InputError, match="radians"):
            replace(base_tire(), **{name: 38.0})
    with pytest.raises(InputError, match="radians"):
        Ply(1e-3, np.array([0.5, 38.0]), isotropic(1e6, 0.3))


@pytest.mark.parametrize(
    "make",
    [
        lambda: isotropic(-1.0, 0.3),
        lambda: isotropic(1e6, NAN),
        lambda: isotropic(1e6, 0.51),
        lambda: CordRubber(INF, 5e6, 0.3),
        lambda: CordRubber(2e9, 0.0, 0.3),
        lambda: CordRubber(2e9, 5e6, NAN),
        lambda: CordRubber(2e9, 5e6, 0.3, rubber_poisson=0.6),
        lambda: CordRubber(2e9, 5e6, 0.3, cord_poisson=-1.0),
        lambda: Ply(INF, 0.0, isotropic(1e6, 0.3)),
        lambda: Ply(1e-3, NAN, isotropic(1e6, 0.3)),
        lambda: Profile.from_points(np.linspace(0.2, 0.3, 10), np.linspace(0.0, 0.1, 9)),
        lambda: Profile.from_points(["a"] * 8, range(8)),
        lambda: Profile.from_points(np.ones((8, 2)), np.ones((8, 2))),
    ],
)
def test_wrong_materials_and_points_are_refused(make):
    with pytest.raises(InputError) as fault:
        make()
    assert sentence(fault)


@pytest.fixture(scope="module")
def ground():
    return base_tire().on_ground(2e5, 16, 12)


@pytest.mark.parametrize("pressure", [1e7, 1e9, 1e11])
def test_a_pressure_without_a_stable_equilibrium_says_how_far_it_went(pressure):
    with pytest.raises(EvaluationError, match="no stable equilibrium of the tire beyond") as fault:
        base_tire().inflate(pressure, 12, 8)
    assert 0.0 <= float(re.search(r"beyond ([\d.e+]+) Pa", str(fault.value))[1]) < pressure


def test_a_wall_that_stretches_beyond_small_strains_is_refused():
    assert base_tire().inflate(1e6, 12, 8).growth > 0
    with pytest.raises(EvaluationError, match="small strains"):
        base_tire().inflate(4e6, 12, 8)


@pytest.mark.medium
def test_rotations_are_warned_of_at_the_limit_and_refused_beyond_with_the_good_steps_kept(ground, recwarn):
    load_curve(ground, np.array([4e-3]))
    assert not recwarn.list
    depths = np.linspace(5e-3, 40e-3, 8)
    with pytest.warns(RotationWarning) as told:
        curve = load_curve(ground, depths)
    rotations = [step.largest_rotation for step in curve.steps]
    assert len(told) == 1 and WARNED_ROTATION < rotations[-1] <= REFUSED_ROTATION
    assert 3 < len(curve.steps) < 8 and curve.deflections == pytest.approx(depths[: len(curve.steps)])
    assert f"last good deflection is {curve.last.deflection:g} m" in curve.failure
    with pytest.raises(EvaluationError, match="moderate rotations"):
        curve.complete()
    with pytest.raises(EvaluationError, match="moderate rotations"):
        press_to_load(ground, 4 * curve.last.load)


def test_steps_before_one_that_does_not_converge_are_kept_and_smaller_steps_are_tried(ground, monkeypatch):
    solve, tried = curves.equilibrium, []

    def stuck(ground, q, active, deflection):
        tried.append(deflection)
        if deflection > 9e-3:
            raise EvaluationError("Newton's method does not converge")
        return solve(ground, q, active, deflection)

    whole = load_curve(ground, np.array([4e-3, 8e-3]))
    monkeypatch.setattr(curves, "equilibrium", stuck)
    curve = load_curve(ground, np.array([4e-3, 8e-3, 12e-3, 16e-3]))
    assert curve.deflections == pytest.approx([4e-3, 8e-3]) and curve.loads == pytest.approx(whole.loads, rel=1e-8)
    assert "does not converge" in curve.failure and max(tried) == pytest.approx(12e-3)
    beyond = float(re.search(r"beyond a deflection of ([\d.e-]+) m", curve.failure)[1])
    assert 8.5e-3 < beyond <= 9e-3
    with pytest.raises(EvaluationError, match="does not converge"):
        curve.complete()
