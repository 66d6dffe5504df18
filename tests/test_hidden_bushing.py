"""The air supply unit on four bushes: rigid motions by hand, its effects, and the answer to one run of a workshop."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.structure import extend
from calib.study.loading import module_of
from models.compressor import BUSH_X, BUSH_Z, RAIL_Y, bushes, compressor_set
from models.compressor_effects import compressor_effects

ROOT = Path(__file__).resolve().parents[1]
STUDY = ROOT / "studies/hidden_bushing"
TRUTH = json.loads((ROOT / "tests/truth/hidden_bushing.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def unit():
    return compressor_set()


def rigid(unit, direction):
    """Motion of all degrees of freedom as the whole unit moves by 1 m, or turns by 1 rad about an axis."""
    moved = np.zeros((len(unit.mesh.points), 6))
    moved[:, direction] = 1.0
    if direction >= 3:
        moved[:, :3] = np.cross(np.eye(3)[direction - 3], unit.mesh.points)
    found = np.linalg.lstsq(unit.dofs.expansion.toarray(), moved.ravel(), rcond=None)[0]
    np.testing.assert_allclose(unit.dofs.expansion @ found, moved.ravel(), atol=1e-9)
    return found


def test_rigid_motions_stretch_nothing_but_the_bushes(unit):
    values = unit.space.values
    stiffness, damping, _ = unit.matrices(values)
    upright, side = 1e3 * values["k_bush"], 1e3 * values["k_bush_side"]
    expected = {
        0: 4 * side, 1: 4 * side, 2: 4 * upright, 3: 4 * (upright * RAIL_Y**2 + side * BUSH_Z**2),
        4: 4 * (upright * BUSH_X**2 + side * BUSH_Z**2), 5: 4 * side * (BUSH_X**2 + RAIL_Y**2),
    }  # fmt: skip
    for direction, known in expected.items():
        motion = rigid(unit, direction)
        assert motion @ stiffness @ motion == pytest.approx(known, rel=1e-6)
    lifted = rigid(unit, 2)
    assert lifted @ damping @ lifted == pytest.approx(4e3 * values["c_bush"], rel=1e-9)


def test_it_weighs_its_tubes_and_both_machines(unit):
    values = unit.space.values
    mass = unit.matrices(values)[2]
    tubes = 7850.0 * 5.3e-4 * (2 * 1.24 + 4 * 0.72)
    for direction in range(3):
        motion = rigid(unit, direction)
        assert motion @ mass @ motion == pytest.approx(tubes + values["m_compressor"] + values["m_motor"], rel=1e-6)


def test_damping_is_as_a_workshop_measures_it(unit):
    modes = unit.modes(unit.space.values, 9)
    assert 0.001 < modes.damping_ratio.min() and modes.damping_ratio.max() < 0.1


@pytest.mark.medium
def test_a_ring_of_springs_is_the_bush_and_loses_what_is_stated(unit):
    twin = module_of(STUDY / "make_twin.py")
    for spring in bushes(((0.0, 0.0, 1.0),)):
        assert sum(s.weight for s in twin.ring(spring, 0.0)) == pytest.approx(1.0)
        assert sum(s.weight for s in twin.ring(spring, 0.3)) == pytest.approx(0.7)
    sound, cracked = twin.unit(), twin.unit(["loose_bush_front_left"], {"loose_bush_front_left": 30.0})
    values = unit.space.values
    motion = rigid(sound, 2)
    for one, other in zip(sound.matrices(values)[:2], cracked.matrices(values)[:2], strict=True):
        assert (motion @ other @ motion) / (motion @ one @ motion) == pytest.approx(1 - 0.3 / 4, rel=1e-6)


@pytest.mark.parametrize("effect", compressor_effects(), ids=lambda effect: effect.name)
def test_every_effect_vanishes_at_0_and_changes_the_modes_at_its_plausible_size(unit, effect):
    model = extend(unit, [effect])
    base = unit.modes(unit.space.values, 9)
    without = model.modes({effect.name: 0.0}, 9)
    some = model.modes({effect.name: effect.plausible}, 9)
    np.testing.assert_allclose(without.natural_freq, base.natural_freq, rtol=1e-9)
    moved = [getattr(some, n) / getattr(base, n) - 1 for n in ("natural_freq", "damping_ratio")]
    assert np.abs(moved).max() > 1e-3


def test_the_measurement_is_one_run_without_any_standard_deviation():
    modes = calib.read_modes(STUDY / "measured/run_1.uff", sensors=STUDY / "measured/sensors.csv", synthetic=True)
    assert modes.n_repeats == 1 and modes.damping_ratio.max() < 0.1
    assert np.isnan(modes.freq_std).all() and np.isnan(modes.damping_std).all()
    true = np.array([TRUTH["natural_freq"][name] for name in modes.names])
    assert 1e-4 < np.abs(modes.natural_freq / true - 1).max() < 4 * 0.005


@pytest.mark.slow
def test_one_run_names_the_worn_bush_and_how_much_it_has_lost(tmp_path, undrawn):
    assert cli.execute(["explain", str(STUDY), "--results", str(tmp_path)]) == 0
    (name,) = TRUTH["effects"]
    summary = json.loads((tmp_path / "hidden_bushing/explanation.json").read_text("utf-8"))
    assert summary["verdict"] == "effect" and summary["credible_set"] == [name]
    effects = pd.read_csv(tmp_path / "hidden_bushing/effects.csv").set_index("name")
    assert effects.loc[name, "magnitude_low"] <= TRUTH["magnitudes"][name] <= effects.loc[name, "magnitude_high"]
    errors = pd.read_csv(tmp_path / "hidden_bushing/errors.csv").set_index(["group", "stage"])["rms"]
    assert errors["held_out_sensors", "after"] < errors["held_out_sensors", "before"]
