"""Effects that the bogie on its rig may lack: against the base model, another mesh and the sensors of the study."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.measurement.files.read import read_modes
from calib.structure import extend
from models.railway import bogie_effects, bogie_on_rig
from models.railway.vehicle_effects import vehicle_effects

STUDY = Path(__file__).resolve().parents[3] / "studies" / "bogie" / "measured"
EFFECTS = {e.name: e for e in bogie_effects()}
NAMES = tuple(EFFECTS)
SELECTED = (
    "K_primary", "c_primary", "m_girder_centre", "m_girder_ends", "m_crossbar", "K_block", "K_rod_upper", "K_rod_lower",
)  # fmt: skip


@cache
def base(kind="fitted"):
    sizes = {"fitted": {}, "coarse": {"element_size": 0.3}, "twin": {"element_size": 0.025, "distributed": True}}
    return bogie_on_rig(**sizes[kind])


@cache
def nominal(kind="fitted", count=10):
    """Modes at the nominal values."""
    return base(kind).modes({}, count)


@cache
def sensors():
    return read_modes([STUDY / "repeat_1.uff"], sensors=STUDY / "sensors.csv").sensors


QUICK = {"brake_unit", "crossbar_joint", "gear_case_offset", "damper_mount"}
"""A hung mass, a soft stretch, a moved mass and a spring in series: those looked at every time."""


@pytest.fixture(scope="module")
def library(effect_checks):
    """On the mesh that is fitted; the eight modes of its nominal values are measured at the study's sensors."""

    def measured():
        return effect_checks.noise_free(base(), sensors(), base().modes({}, 8), range(8))

    return effect_checks.Library(base(), EFFECTS, measured, 12)


@pytest.fixture(scope="module")
def coarse(effect_checks):
    """With 0.3 m long elements: soft stretches end within them."""
    return effect_checks.Library(base("coarse"), EFFECTS, lambda: None, 12)


# -- all of them -------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_names_are_unique_and_not_those_of_parameters():
    every = [name for e in bogie_effects() for name in e.names]
    assert len(set(every)) == len(every) and not set(every) & set(base().space.names)
    assert 14 <= len(EFFECTS) == len(bogie_effects())
    for e in EFFECTS.values():
        assert e.title and e.lacks.endswith(".") and e.look_for.endswith(".") and e.magnitude.description


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("name", NAMES)
def test_magnitude_zero_leaves_the_base_model(library, name):
    model, n = library.alone(name), base().n_dof
    zero = dict.fromkeys(set(EFFECTS) & set(model.space.names), 0.0)
    for own, bare in zip(model.matrices(zero), base().matrices({}), strict=True):
        assert abs(own[:n, :n] - bare).max() <= 1e-12 * abs(bare).max()
        assert own[:n, n:].count_nonzero() == 0 and own[n:, :n].count_nonzero() == 0
    nuisance = [q.value for q in EFFECTS[name].nuisance if q.unit == "Hz"]
    found = model.modes(zero, 10 + len(nuisance))
    kept = np.array([all(abs(f / q - 1) > 1e-6 for q in nuisance) for f in found.natural_freq])
    assert kept.sum() == 10
    np.testing.assert_allclose(found.natural_freq[kept], nominal().natural_freq, rtol=1e-8)
    np.testing.assert_allclose(found.damping_ratio[kept], nominal().damping_ratio, atol=1e-8)


@pytest.mark.slow
def test_all_effects_together_leave_the_base_model(library):
    assert library.gap({}) <= 1e-12
    model = library.together
    found = model.modes(dict.fromkeys(NAMES, 0.0), 11).natural_freq
    np.testing.assert_allclose(
        found[np.abs(found / model.space["brake_unit_freq"].value - 1) > 1e-6],
        nominal().natural_freq, rtol=1e-8,
    )  # fmt: skip
    both = extend(extend(base(), [EFFECTS["brake_unit"]]), [EFFECTS["gear_case_offset"], EFFECTS["crossbar_joint"]])
    once = extend(base(), [EFFECTS[name] for name in ("brake_unit", "gear_case_offset", "crossbar_joint")])
    values = {"brake_unit": 50.0, "gear_case_offset": 100.0, "crossbar_joint": 0.4}
    for one, other in zip(both.matrices(values), once.matrices(values), strict=True):
        assert abs(one - other).max() <= 1e-12 * abs(one).max()


@pytest.mark.parametrize("name", NAMES)
def test_matrix_derivatives_agree_with_differences(library, name):
    gaps = library.slope_gaps(name, {"c_primary": 15.0, "K_primary": 600.0})
    assert set(EFFECTS[name].names) <= set(gaps) and max(gaps.values()) <= 1.0
    assert ("c_primary" in gaps) == (name in ("weak_damper", "damper_mount"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in NAMES])
def test_matrices_stay_semidefinite_and_modes_solvable_at_the_limits(library, coarse, effect_checks, name):
    for values in effect_checks.limits(EFFECTS[name]):
        assert coarse.negative_directions(values) == 0
        modes = library.solved(values)
        assert modes.n_modes >= 10 and np.all(np.isfinite(modes.natural_freq))
        assert np.all(modes.damping_ratio > -1e-12)  # two modes of the axles have none


# All effects are rebuilt by hand (test_effects_rebuilt.py) or checked alone (test_effects_alone.py) too.
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_the_same_on_the_fine_and_the_fitted_mesh(effect_checks, name):
    # The finer bogie distributes the gear case over 0.24 m of the axle, which its moment of inertia bends.
    share = 0.16 if name == "gear_case_offset" else 0.1
    for values in effect_checks.points(EFFECTS[name])[:2]:
        coarse, fine = (
            effect_checks.frequency_changes(base(kind), EFFECTS[name], values, sensors(), nominal(kind, 8))
            for kind in ("fitted", "twin")
        )
        assert np.abs(coarse).max() > 1e-6
        assert np.abs(coarse - fine).max() < share * np.abs(coarse).max()
        assert np.abs(coarse - fine).max() < 5e-4


# -- signatures --------------------------------------------------------------------------------------------------------


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("name", NAMES)
def test_parameters_of_the_base_model_cannot_do_what_an_effect_does(library, effect_checks, name):
    for vector in library.signatures(name):
        assert effect_checks.outside(vector, library.columns(SELECTED), prior=False) > 0.1
        assert effect_checks.outside(vector, library.columns(), prior=True) > 0.1


@pytest.mark.medium
def test_wood_bends_as_actuators_give_way(library, effect_checks):
    # Only the prior of the wood separates these two at the sensors of the study.
    (vector,) = library.signatures("actuator_flexibility")
    without = [p.name for p in base().space.parameters if not p.integer and p.name != "E_wood"]
    same, free = library.columns(), library.columns(without)
    assert (
        effect_checks.outside(vector, same, prior=False)
        < 0.05 < 0.3
        < effect_checks.outside(vector, free, prior=False)
    )  # fmt: skip


@pytest.mark.slow
def test_plausible_magnitudes_that_the_sensors_cannot_see(library, effect_checks):
    columns = library.columns()
    seen = {
        name: max(np.linalg.norm(v) * effect_checks.outside(v, columns, prior=True) for v in library.signatures(name))
        for name in NAMES
    }
    assert {name for name, size in seen.items() if size < 1} == {"girder_end", "wheel_contact"}


def test_every_effect_completes_the_sentence_on_what_the_model_lacks():
    for effect in (*bogie_effects(), *vehicle_effects()):
        assert effect.in_words == effect.phrase and effect.phrase[0].islower() and effect.phrase[-1] not in ".,;:"
