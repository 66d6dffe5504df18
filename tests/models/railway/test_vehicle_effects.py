"""Effects that the vehicle with rigid seats may lack: against the base model, a finer mesh and sensors of a test."""

import numpy as np
import pytest

from calib import InputError
from calib.structure import extend
from models.railway import vehicle, vehicle_effects

EFFECTS = {e.name: e for e in vehicle_effects()}
NAMES = tuple(EFFECTS)
SOME = [name if k % 6 == 0 else pytest.param(name, marks=pytest.mark.whole) for k, name in enumerate(NAMES)]
"""All effects, of which every sixth is tried with the slow tests, the others with those of whole studies."""
SELECTED = (
    "K_secondary_front", "K_secondary_rear", "K_rod_tilting", "RMI_base", "RMI_walls", "m_base", "m_walls", "m_cover",
)  # fmt: skip
SOLVED = 15
MEASURED = (0, 1, 8, 9, 10, 13)
"""Rolling, bouncing, bending, torsion and distortion of the car, and the bogies' pitching."""


@pytest.fixture(scope="module")
def modes(rigid_car):
    return rigid_car.modes({}, SOLVED)


@pytest.fixture(scope="module")
def library(effect_checks, rigid_car, modes, vehicle_sensors):
    def measured():
        return effect_checks.noise_free(rigid_car, vehicle_sensors, modes, MEASURED)

    return effect_checks.Library(rigid_car, EFFECTS, measured, SOLVED, SELECTED)


@pytest.mark.slow
def test_names_are_unique_and_not_those_of_parameters(rigid_car):
    every = [name for e in vehicle_effects() for name in e.names]
    assert len(set(every)) == len(every) and not set(every) & set(rigid_car.space.names)
    assert 14 <= len(EFFECTS) == len(vehicle_effects())
    for e in EFFECTS.values():
        assert e.title and e.lacks.endswith(".") and e.look_for.endswith(".") and e.magnitude.description


@pytest.mark.slow
def test_magnitude_zero_leaves_the_matrices_of_the_base_model(library):
    assert library.gap({}) <= 1e-12
    nuisance = {q.name: v for e in EFFECTS.values() for q in e.nuisance for v in (q.lower, q.upper)}
    assert library.gap(nuisance) <= 1e-12


@pytest.mark.slow
def test_magnitude_zero_leaves_the_modes_of_the_base_model(library, modes):
    model = library.together
    found = model.modes(dict.fromkeys(NAMES, 0.0), SOLVED)
    np.testing.assert_allclose(found.natural_freq, modes.natural_freq, rtol=1e-8)
    np.testing.assert_allclose(found.damping_ratio, modes.damping_ratio, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_matrix_derivatives_agree_with_differences(library, name):
    gaps = library.slope_gaps(name, {"c_yaw": 350.0, "RMI_base": 180.0})
    assert set(EFFECTS[name].names) <= set(gaps) and max(gaps.values()) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_matrices_stay_semidefinite_at_the_limits(library, effect_checks, name):
    for values in effect_checks.limits(EFFECTS[name]):
        assert library.negative_directions(values) == 0


@pytest.mark.slow
def test_a_joint_loses_no_more_than_a_thinner_floor_has(library):
    thin = {"floor_joint": 0.95, "RMI_base": 50.0, "t_base": 9.2, "E_aluminium": 65.0}
    assert library.negative_directions(thin) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_parameters_of_the_base_model_cannot_do_what_an_effect_does(library, effect_checks, name):
    for vector in library.signatures(name):
        assert effect_checks.outside(vector, library.columns(SELECTED), prior=True) > 0.1


@pytest.mark.slow
def test_plausible_magnitudes_that_the_sensors_cannot_see(library, effect_checks):
    columns = library.columns(SELECTED)
    plain = {name: next(library.signatures(name)) for name in NAMES if not EFFECTS[name].grid}
    seen = {name: np.linalg.norm(v) * effect_checks.outside(v, columns, prior=True) for name, v in plain.items()}
    # Frames do not yaw here, so that a pivot that resists turning works against links that are far stiffer.
    assert {name for name, size in seen.items() if size < 1} == {"floor_joint", "track_compliance", "pivot_yaw"}


@pytest.mark.slow
def test_effects_that_differ_only_in_sign(library, effect_checks):
    columns = library.columns(SELECTED)

    def collinearity(one, other):
        a, b = (next(library.signatures(name)) for name in (one, other))
        wide = np.vstack([columns, np.eye(columns.shape[1])])
        q = np.linalg.qr(wide)[0]
        a, b = (np.pad(v, (0, columns.shape[1])) for v in (a, b))
        a, b = (v - q @ (q.T @ v) for v in (a, b))
        return a @ b / np.linalg.norm(a) / np.linalg.norm(b)

    assert collinearity("window_corners", "window_glass") < -0.98
    assert collinearity("anti_roll_bar", "tipping") < -0.8
    assert not any(EFFECTS[name].signed for name in ("window_corners", "window_glass", "anti_roll_bar", "tipping"))


def test_seats_that_are_sprung_already_refuse_to_be_sprung(car):
    with pytest.raises(InputError, match="sprung already"):
        extend(car, [EFFECTS["soft_seats"]])


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_modes_are_solvable_at_the_limits(library, effect_checks, name):
    for values in effect_checks.limits(EFFECTS[name]):
        modes = library.solved(values)
        assert modes.n_modes >= SOLVED and np.all(np.isfinite(modes.natural_freq))
        assert np.all(modes.damping_ratio > -1e-9)


@pytest.fixture(scope="module")
def fine():
    return vehicle(2, distributed=True, seats="rigid")


@pytest.fixture(scope="module")
def nominal(rigid_car, fine):
    return [model.modes({}, 12) for model in (rigid_car, fine)]


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_an_effect_is_the_same_on_the_fine_and_the_fitted_mesh(
    effect_checks, vehicle_sensors, rigid_car, fine, nominal, name
):  # fmt: skip
    values = effect_checks.points(EFFECTS[name])[-1]
    coarse, finer = (
        effect_checks.frequency_changes(model, EFFECTS[name], values, vehicle_sensors, own)
        for model, own in zip((rigid_car, fine), nominal, strict=True)
    )
    # Moved equipment bends cross-beams between their nodes, where a finer mesh is softer: 8e-5 of a frequency.
    assert np.abs(coarse - finer).max() < max(0.11 * np.abs(coarse).max(), 1e-6)
    # The halves of pillars are softened in three stretches, whose curvatures differ by 7 % between the meshes.
    assert np.abs(coarse - finer).max() < max(0.07 * np.abs(coarse).max(), 5e-4)
