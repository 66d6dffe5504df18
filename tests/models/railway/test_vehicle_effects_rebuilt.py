"""Every effect of the vehicle against a vehicle rebuilt with it: the library's magnitude is that of the mesh."""

from pathlib import Path

import numpy as np
import pytest

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import Floors
from calib.structure import extend
from calib.study.loading import module_of
from models.railway import vehicle_effects

EFFECTS = {e.name: e for e in vehicle_effects()}
SOME = [name if k % 6 == 0 else pytest.param(name, marks=pytest.mark.whole) for k, name in enumerate(EFFECTS)]
"""All effects, of which every sixth is tried with the slow tests, the others with those of whole studies."""
rebuilt = module_of(Path(__file__).with_name("rebuilt_vehicle.py"))
MODES = 12
BOUNDS = {"floor_joint": (0.15, 0.2), "window_corners": (0.1, 0.12)}
"""Largest error of the magnitude and remaining change, where the library softens less than the rebuilt section."""
STEP = 0.05
"""Relative step of the magnitude for the derivative of its change."""


@pytest.fixture(scope="module")
def plain(effect_checks, rigid_car, vehicle_sensors):
    return effect_checks.noise_free(rigid_car, vehicle_sensors, rigid_car.modes({}, MODES), range(MODES))


def residual_of(model, plain, more):
    """Differences of a model's modes from those of the unchanged vehicle, in standard deviations."""
    problem = ModalProblem(model, plain, mode_count=MODES + 4 + more, threshold=0.1)
    return ModalResidual(problem, Floors(freq=0.0, damping=0.0, shape=0.0))


def changes(model, plain, values, more):
    """The same at some values."""
    return residual_of(model, plain, more).residual(values)


def test_every_effect_is_rebuilt():
    assert set(rebuilt.VEHICLES) == set(EFFECTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_the_magnitude_found_is_the_one_built_in(rigid_car, plain, name):
    effect = EFFECTS[name]
    truth = dict(effect.grid[len(effect.grid) // 2]) if effect.grid else {name: effect.plausible}
    model, bodies = extend(rigid_car, [effect]), 60 if name == "soft_seats" else 1
    added = model.n_dof - rigid_car.n_dof
    built = changes(rebuilt.VEHICLES[name](truth, 1), plain, {}, added + bodies)
    explained = changes(model, plain, truth, added)
    more = changes(model, plain, {**truth, name: (1 + STEP) * truth[name]}, added)
    slope = (more - explained) / STEP
    off, std = float(slope @ (built - explained) / (slope @ slope)), 1 / float(np.linalg.norm(slope))
    nearly, left = BOUNDS.get(name, (0.02, 0.02))
    assert abs(off) < nearly and abs(off) < 1.96 * std
    assert np.linalg.norm(built - explained) < left * np.linalg.norm(built)


@pytest.mark.slow
def test_a_unit_that_is_heavy_low_down_on_other_mounts_is_found(rigid_car, plain):
    """Its centre 0.25 m lower, damped more, of another box: the assumed values are fitted too (one step)."""
    name = "hung_converter"
    truth = {name: 1.3, f"{name}_drop": 0.25, f"{name}_sideways": 0.7, f"{name}_damping": 0.04}
    unit = rebuilt.hung(truth, 1, name, "traction converter", box=(2.2, 0.8, 1.7))
    built = changes(unit, plain, {}, 6)
    effect = EFFECTS[name]
    model = extend(rigid_car, [effect])
    residual = residual_of(model, plain, 6)
    off = built - residual.residual(truth)
    slopes = residual.jacobian(truth, effect.names)
    step = np.linalg.lstsq(slopes, off, rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    assert abs(step[0]) < 1.96 * std[0] and abs(step[0]) < 0.05 * truth[name]
    assert np.linalg.norm(off - slopes @ step) < 0.02 * np.linalg.norm(built)
