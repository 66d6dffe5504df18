"""Every effect of the bogie against a bogie rebuilt with it: the library's magnitude is that of the mesh."""

from pathlib import Path

import numpy as np
import pytest

from calib.measurement.files.read import read_modes
from calib.structure import extend
from calib.study.loading import module_of
from models.railway import bogie_effects, bogie_on_rig

HERE = Path(__file__)
EFFECTS = {e.name: e for e in bogie_effects()}
STUDIES = HERE.resolve().parents[3] / "studies"
MEASURED = STUDIES / "bogie/measured"
rebuilt, rediscovery = module_of(STUDIES / "hidden_bogie/remodelled.py"), module_of(HERE.with_name("rediscovery.py"))
MODES = 9


@pytest.fixture(scope="module")
def base():
    return bogie_on_rig()


@pytest.fixture(scope="module")
def measure(effect_checks):
    """Noise-free modes of a rebuilt bogie at the sensors of the study."""
    sensors = read_modes([MEASURED / "repeat_1.uff"], sensors=MEASURED / "sensors.csv").sensors

    def measured(model):
        return effect_checks.noise_free(model, sensors, model.modes({}, MODES), range(MODES))

    return measured


@pytest.fixture(scope="module")
def plain(measure):
    return measure(rebuilt.rebuilt())


def test_every_effect_is_rebuilt():
    assert set(rebuilt.BOGIES) == set(EFFECTS)


# The others are checked by hand (test_effects_alone.py) and against a finer mesh (test_effects.py) every time.
QUICK = {"crossbar_mass"}
EACH = [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in EFFECTS]


@pytest.mark.slow
@pytest.mark.parametrize("name", EACH)
def test_the_magnitude_found_is_the_one_built_in(base, measure, plain, name):
    effect = EFFECTS[name]
    truth = dict(effect.grid[len(effect.grid) // 2]) if effect.grid else {name: effect.plausible}
    start = {p.name: truth[p.name] * (0.6 if p.name == name else 1.1) for p in effect.parameters}
    found = rediscovery.rediscovered(base, effect, plain, measure(rebuilt.built([name], truth)), start, 12)
    assert found.values[name] == pytest.approx(truth[name], rel=0.02)
    assert abs(found.values[name] - truth[name]) < 1.96 * found.std
    assert found.after < 0.1 * found.before
    for p in effect.nuisance:
        assert found.values[p.name] == pytest.approx(truth[p.name], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("offset", [-600.0, 280.0])
def test_a_gear_case_anywhere_on_its_axle_is_felt_there(base, measure, plain, offset):
    name = "gear_case_offset"
    changed = measure(rebuilt.built([name], {name: offset}))
    found = rediscovery.rediscovered(base, EFFECTS[name], plain, changed, {name: 0.8 * offset}, 12)
    assert found.values[name] == pytest.approx(offset, rel=0.02) and found.after < 0.1 * found.before


@pytest.mark.slow
def test_a_gear_case_off_the_middle_bends_its_axle_less(base):
    # The axle is softest in its middle: a mass that leaves it lets the axle's own bending rise.
    name = "gear_case_offset"
    before, after = rebuilt.rebuilt().modes({}, MODES), rebuilt.built([name], {name: 300.0}).modes({}, MODES)
    change = after.natural_freq / before.natural_freq - 1
    assert change[MODES - 1] > 0.03
    found = extend(base, [EFFECTS[name]]).modes({name: 300.0}, MODES)
    np.testing.assert_allclose(found.natural_freq / base.modes({}, MODES).natural_freq - 1, change, atol=5e-4)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("name", "scaled", "kind"),
    [("block_damping", "c_primary", 1), ("rod_damping", "c_primary", 1), ("block_tilt", "K_block", 0)],
)
def test_a_magnitude_in_its_unit_does_not_grow_with_another_parameter(name, scaled, kind):
    """Parts that are added to a group of the model have its parameter as a factor, which a twin draws."""
    plain, changes = rebuilt.rebuilt(element_size=0.2), []
    for factor in (1.0, 1.3):
        values = {**rebuilt.ADOPTED, name: EFFECTS[name].plausible, scaled: factor * rebuilt.ADOPTED[scaled]}
        model = rebuilt.built([name], values, element_size=0.2)
        own = {n: v for n, v in values.items() if n in model.space}
        changes.append((model.matrices(own)[kind] - plain.matrices(own)[kind]).toarray())
    np.testing.assert_allclose(changes[1], changes[0], atol=1e-5 * np.abs(changes[0]).max())
    assert np.abs(changes[0]).max() > 0
