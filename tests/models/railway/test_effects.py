"""Effects that the bogie on its rig may lack: against the base model, another mesh and the sensors of the study."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.scatter import Floors
from calib.mac import mac
from calib.measurement.read import read_measurement
from calib.structure.extend import extend
from models.railway import bogie_effects, bogie_on_rig

STUDY = Path(__file__).resolve().parents[3] / "studies" / "bogie" / "measured"
EFFECTS = {e.name: e for e in bogie_effects()}
NAMES = tuple(EFFECTS)
MODES = tuple(f"{k}BT" for k in range(1, 9))
SELECTED = (
    "K_primary", "c_primary", "m_girder_centre", "m_girder_ends", "m_crossbar", "K_block", "K_rod_upper", "K_rod_lower",
)  # fmt: skip
PRIOR = {"K_": 0.15, "E_": 0.15, "c_": 0.4}
STD_FREQ, STD_DAMPING, STD_SHAPE = 0.005, 0.07, 0.025


@cache
def base(kind="fitted"):
    sizes = {"fitted": {}, "coarse": {"element_size": 0.3}, "twin": {"element_size": 0.025, "distributed": True}}
    return bogie_on_rig(**sizes[kind])


@cache
def with_effect(name, kind="fitted"):
    return extend(base(kind), [EFFECTS[name]])


def points(effect):
    """Plausible strengths, with nuisance parameters where there are any."""
    return effect.grid or ({effect.name: effect.plausible},)


# -- all of them -------------------------------------------------------------------------------------------------------


def test_names_are_unique_and_not_those_of_parameters():
    every = [name for e in bogie_effects() for name in e.names]
    assert len(set(every)) == len(every) and not set(every) & set(base().space.names)
    assert 14 <= len(EFFECTS) == len(bogie_effects())
    for e in EFFECTS.values():
        assert e.title and e.lacks.endswith(".") and e.look_for.endswith(".") and e.strength.description


@pytest.mark.parametrize("name", NAMES)
def test_strength_zero_leaves_the_base_model(name):
    model, n = with_effect(name), base().n_dof
    zero = {name: 0.0}
    for own, bare in zip(model.matrices(zero), base().matrices({}), strict=True):
        assert abs(own[:n, :n] - bare).max() <= 1e-12 * abs(bare).max()
        assert own[:n, n:].count_nonzero() == 0 and own[n:, :n].count_nonzero() == 0
    nuisance = [q.value for q in EFFECTS[name].nuisance if q.unit == "Hz"]
    found, adopted = model.modes(zero, 10 + len(nuisance)), base().modes({}, 10)
    kept = np.array([all(abs(f / q - 1) > 1e-6 for q in nuisance) for f in found.natural_freq])
    assert kept.sum() == 10
    np.testing.assert_allclose(found.natural_freq[kept], adopted.natural_freq, rtol=1e-8)
    np.testing.assert_allclose(found.damping_ratio[kept], adopted.damping_ratio, atol=1e-8)


def test_all_effects_together_leave_the_base_model():
    model = extend(base(), bogie_effects())
    found = model.modes(dict.fromkeys(NAMES, 0.0), 11).natural_freq
    np.testing.assert_allclose(
        found[np.abs(found / model.space["brake_unit_freq"].value - 1) > 1e-6],
        base().modes({}, 10).natural_freq, rtol=1e-8,
    )  # fmt: skip
    both = extend(extend(base(), [EFFECTS["brake_unit"]]), [EFFECTS["gear_case_offset"], EFFECTS["crossbar_joint"]])
    once = extend(base(), [EFFECTS[name] for name in ("brake_unit", "gear_case_offset", "crossbar_joint")])
    values = {"brake_unit": 50.0, "gear_case_offset": 100.0, "crossbar_joint": 0.4}
    for one, other in zip(both.matrices(values), once.matrices(values), strict=True):
        assert abs(one - other).max() <= 1e-12 * abs(one).max()


@pytest.mark.parametrize("name", NAMES)
def test_matrix_derivatives_agree_with_differences(name):
    effect, model = EFFECTS[name], with_effect(name)
    point = model.space.complete({"c_primary": 15.0, "K_primary": 600.0, **points(effect)[0]})
    moving = [*effect.names, *(("c_primary",) if name in ("weak_damper", "damper_mount") else ())]
    for parameter_name in moving:
        step = 1e-4 * max(abs(point[parameter_name]), 1e-6)
        sides = [model.matrices({**point, parameter_name: point[parameter_name] + s * step}) for s in (1, -1)]
        slopes = model.matrix_derivatives(point, parameter_name)
        assert any(abs(slope).max() > 0 for slope in slopes)
        for slope, up, down in zip(slopes, *sides, strict=True):
            rounding = 1e-13 * abs(up).max() / step
            assert abs((up - down) / (2 * step) - slope).max() <= 1e-6 * abs(slope).max() + rounding


@pytest.mark.parametrize("name", NAMES)
def test_matrices_stay_semidefinite_and_modes_solvable_at_the_limits(name):
    # The coarse mesh has 0.3 m long elements: soft stretches end within them.
    strength = EFFECTS[name].strength
    for value in {strength.lower, strength.upper}:
        for nuisance in ({}, *({q.name: v} for q in EFFECTS[name].nuisance for v in (q.lower, q.upper))):
            values = {name: value, **nuisance}
            for matrix in with_effect(name, "coarse").matrices(values):
                size = np.sqrt(np.maximum(abs(matrix).max(axis=0).toarray().ravel(), 1e-12))
                scaled = sp.diags_array(1 / size) @ matrix @ sp.diags_array(1 / size)
                assert np.linalg.eigvalsh(scaled.toarray()).min() > -1e-9
            modes = with_effect(name).modes(values, 10)
            assert modes.n_modes == 10 and np.all(np.isfinite(modes.natural_freq))
            assert np.all(modes.damping_ratio > 0)


@pytest.mark.parametrize("name", NAMES)
def test_fine_mesh_feels_an_effect_as_the_fitted_one(name):
    sensors = residual(base()).problem.measured.sensors

    def changes(kind, values):
        model = with_effect(name, kind)
        rows, adopted = base(kind).sensor_rows(sensors), base(kind).modes({}, 8)
        moved = model.modes(values, 12)
        wide = np.pad(rows, ((0, 0), (0, model.n_dof - base(kind).n_dof)))
        similar = mac(rows @ adopted.shapes, wide @ moved.shapes)
        partner = similar.argmax(axis=1)
        assert len(set(partner)) == 8
        return moved.natural_freq[partner] / adopted.natural_freq - 1

    for values in points(EFFECTS[name])[:2]:
        coarse, fine = changes("fitted", values), changes("twin", values)
        assert np.abs(coarse).max() > 1e-6
        assert np.abs(coarse - fine).max() < 0.1 * np.abs(coarse).max()
        assert np.abs(coarse - fine).max() < 5e-4


# -- fingerprints ------------------------------------------------------------------------------------------------------


@cache
def measured():
    """The eight modes of the adopted base model at the study's sensors, with the study's scatter."""
    found = read_measurement([STUDY / "repeat_1.uff"], sensor_table=STUDY / "sensors.csv")
    modes = base().modes({}, 8)
    shapes = base().sensor_rows(found.sensors) @ modes.shapes
    return replace(
        found,
        names=MODES,
        natural_freq=modes.natural_freq,
        damped_freq=modes.damped_freq,
        freq_std=STD_FREQ * modes.natural_freq,
        damping_ratio=modes.damping_ratio,
        damping_std=STD_DAMPING * modes.damping_ratio,
        shapes=shapes / np.abs(shapes).max(axis=0),
        shape_std=np.full(shapes.shape, STD_SHAPE),
        n_repeats=1,
    )


def residual(model):
    floors = Floors(freq=0.0, damping=0.0, shape=0.0)
    return ModalResidual(ModalProblem(model, measured(), mode_count=12, threshold=0.1), floors)


@cache
def jacobian():
    """Of the residual by all continuous parameters of the base model, over their prior widths."""
    names = tuple(n for n in base().space.names if not n.startswith("pos"))
    widths = [PRIOR.get(n[:2], 0.0) * base().space[n].value or 20.0 for n in names]
    return names, residual(base()).jacobian({}, names) * widths


@cache
def fingerprints(name):
    asked = residual(with_effect(name))
    if not EFFECTS[name].grid:
        return [asked.jacobian({}, [name])[:, 0] * EFFECTS[name].plausible]
    return [asked.residual(values) - asked.residual({}) for values in EFFECTS[name].grid]


def outside(vector, columns, prior):
    """Share of a vector outside the span of columns; with a prior they may move by about their own size only."""
    g = np.vstack([columns, np.eye(columns.shape[1])]) if prior else columns
    q = np.linalg.qr(g)[0]
    wide = np.pad(vector, (0, len(g) - len(vector)))
    return np.linalg.norm(wide - q @ (q.T @ wide)) / np.linalg.norm(vector)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_of_the_base_model_cannot_do_what_an_effect_does(name):
    names, columns = jacobian()
    for vector in fingerprints(name):
        assert outside(vector, columns[:, [names.index(n) for n in SELECTED]], prior=False) > 0.1
        assert outside(vector, columns, prior=True) > 0.1


def test_wood_bends_as_actuators_give_way():
    # Nothing but what is known of the wood beforehand tells these two apart at the sensors of the study.
    names, columns = jacobian()
    (vector,) = fingerprints("actuator_flexibility")
    without = [k for k, name in enumerate(names) if name != "E_wood"]
    assert outside(vector, columns, prior=False) < 0.05 < 0.3 < outside(vector, columns[:, without], prior=False)


def test_plausible_strengths_that_the_sensors_cannot_see():
    columns = jacobian()[1]
    seen = {
        name: max(np.linalg.norm(v) * outside(v, columns, prior=True) for v in fingerprints(name)) for name in NAMES
    }
    assert {name for name, size in seen.items() if size < 1} == {"girder_end", "wheel_contact"}
