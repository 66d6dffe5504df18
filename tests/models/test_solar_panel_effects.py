"""The library of the solar array: neutral at magnitude 0, the same on any mesh, and true to what it stands for."""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as la

from calib.structure import extend
from calib.study.loading import module_of
from models.solar_panel import PLATE_DENSITY, THICKNESS, solar_panel
from models.solar_panel_effects import solar_panel_effects

ROOT = Path(__file__).resolve().parents[2]
FRAME, RATIO = 0.04, 0.01
LIBRARY = {effect.name: effect for effect in solar_panel_effects()}
BELOW = 6
"""Modes below 20 Hz, which the studies measure."""
NEUTRAL = 1e-4
"""Least magnitude of a hung mass, 1 g, over the array's 50 kg."""

remodelled = module_of(ROOT / "studies/hidden_panel/remodelled.py")
BUILT = {effect.name: effect for effect in remodelled.remodelled_effects()}


@pytest.fixture(scope="module")
def coarse():
    return solar_panel(frame=FRAME, damping_ratio=RATIO)


@pytest.fixture(scope="module")
def fine():
    return solar_panel(4, frame=FRAME)


def freq(model, values, count=BELOW):
    """Natural frequencies without damping, Hz."""
    k, _, m = model.matrices(values)
    squares = la.eigvalsh(k.toarray(), m.toarray(), subset_by_index=(0, count - 1))
    return np.sqrt(squares) / (2 * np.pi)


def magnitudes(effect, factor=1.0):
    return {effect.name: factor * effect.plausible} | {q.name: q.value for q in effect.nuisance}


@pytest.mark.parametrize("name", LIBRARY)
def test_at_its_least_magnitude_an_effect_leaves_the_model_as_it_is(coarse, name):
    effect = LIBRARY[name]
    model = extend(coarse, [effect])
    found = freq(model, model.space.values, BELOW + model.n_dof - coarse.n_dof)
    own = [q.value for q in effect.nuisance]
    kept = [f for f in found if not any(abs(f / o - 1) < 0.01 for o in own)]
    np.testing.assert_allclose(kept[:BELOW], freq(coarse, {}), rtol=NEUTRAL)


@pytest.mark.slow
@pytest.mark.parametrize("name", LIBRARY)
def test_an_effect_built_into_the_finer_mesh_shifts_frequencies_alike(coarse, fine, name):
    """Shifts of the library on the coarse mesh, and of the real thing on the finer one, within a tenth of a percent."""
    factor = 1.5
    shifts = []
    for model, effect in ((coarse, LIBRARY[name]), (fine, BUILT[name])):
        with_it, added = extend(model, [effect]), len(effect.nuisance)
        shifts.append(freq(with_it, magnitudes(effect, factor), BELOW + added)[:BELOW] / freq(model, {}))
    change = np.abs(shifts[1] - 1).max()
    tolerance = 1e-3 if name != "hinge_damper" else 1e-9
    assert np.abs(shifts[0] - shifts[1]).max() < tolerance
    assert name in ("hinge_damper", "cracked_row") or change > 2 * tolerance


@pytest.mark.medium
def test_a_flexible_hinge_is_a_split_node_on_the_same_mesh():
    """Exact but for the rotary inertia behind the hinge."""
    halved = solar_panel(2, frame=FRAME)
    for name in ("hinge_flexibility", "yoke_flexibility", "root_flexibility"):
        values = {name: 2.0}
        series, split = (extend(halved, [one[name]]) for one in (LIBRARY, BUILT))
        found, expected = freq(series, values), freq(split, values)
        np.testing.assert_allclose(found, expected, rtol=1e-3)
        assert np.abs(found / freq(halved, {}) - 1).max() > 0.05


@pytest.mark.medium
def test_a_damper_damps_as_the_one_with_two_feet(coarse):
    """Ratios of the bending modes, which turn the panels against each other."""
    effect = LIBRARY["hinge_damper"]
    framed = solar_panel(2, frame=FRAME, damping_ratio=RATIO)
    ratios = [
        extend(model, [one]).modes({"hinge_damper": effect.plausible}, BELOW).damping_ratio
        for model, one in ((coarse, effect), (framed, effect))
    ]
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=0.01)
    assert ratios[0].max() > 3 * RATIO


def test_masses_and_cords_are_those_that_are_stated(coarse):
    lifted = (coarse.dofs.direction == 2).astype(float)

    def added(name, kind):
        model = extend(coarse, [LIBRARY[name]])
        index = {"stiffness": 0, "mass": 2}[kind]
        with_it, without = (model.matrices({name: size})[index].toarray() for size in (1.0, 0.0))
        return lifted @ (with_it - without) @ lifted

    assert added("instrument_mass", "mass") == pytest.approx(1.0)
    assert added("air_mass", "mass") == pytest.approx(2 * 0.8 * 0.4)
    assert added("offload_cords", "stiffness") == pytest.approx(2.0)
    plates = sum(part.matrix for part in coarse.parts if part.kind == "mass" and part.name.startswith("plate"))
    assert lifted @ plates @ lifted == pytest.approx(2 * 0.8 * 0.4 * THICKNESS * PLATE_DENSITY)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["instrument_mass", "air_mass"])
def test_masses_built_into_the_finer_mesh_weigh_as_much(fine, name):
    lifted = (fine.dofs.direction == 2).astype(float)
    weights = []
    for one in (LIBRARY, BUILT):
        model = extend(fine, [one[name]])
        change = model.matrices({name: 1.0})[2] - model.matrices({name: 0.0})[2]
        weights.append(lifted @ change @ lifted)
    # The elliptic strip has its mass at the centres of eight elements across the width.
    assert weights[1] == pytest.approx(weights[0], rel=0.03)


def test_a_strut_is_its_bending_and_torsion(coarse):
    """Rigid motions of both panels together do not strain it; turning one against the other does."""
    model = extend(coarse, [LIBRARY["locking_strut"]])
    change = (model.matrices({"locking_strut": 1.0})[0] - model.matrices({"locking_strut": 0.0})[0]).toarray()
    x, y = coarse.mesh.points[coarse.dofs.node, :2].T
    direction = coarse.dofs.direction
    lifted = (direction == 2).astype(float)
    pitched = np.where(direction == 2, -x, (direction == 4).astype(float))
    rolled = np.where(direction == 2, y, (direction == 3).astype(float))
    size = np.abs(change).max()
    for motion in (lifted, pitched, rolled):
        assert np.abs(change @ motion).max() < 1e-9 * size
    rear = x > 1.0
    beam = 70e9 * 1e-8 / 12 / 0.4
    twisted = rolled * rear
    assert twisted @ change @ twisted == pytest.approx(beam * 0.1406 * 12 / (2 * 1.33), rel=1e-6)
    folded = np.where(rear & (direction == 2), -(x - 1.0), (rear & (direction == 4)).astype(float))
    assert folded @ change @ folded == pytest.approx(beam, rel=1e-6)
