"""Effects act where their library puts them."""

import numpy as np
import pytest

from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effect_places import effect_places
from calib.structure.effects.attach import hung_masses, maxwell_branches, motion
from calib.structure.effects.extend import Addition
from models.railway.bogie import CROSSBAR_X, GIRDER_Y, GIRDER_Z, UY
from models.railway.effects import bogie_effects
from models.railway.effects_frame import BRAKE_UNIT_Z
from models.railway.rig import bogie_on_rig

EFFECTS = {effect.name: effect for effect in bogie_effects()}


@pytest.fixture(scope="module")
def model():
    return bogie_on_rig()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("brake_unit", [(CROSSBAR_X, GIRDER_Y, BRAKE_UNIT_Z)]),  # a motion of its own, hung on the crossbar
        ("crossbar_mass", [(CROSSBAR_X, GIRDER_Y, 0.0)]),
        ("gear_case_offset", [(1.45, 0.43, 0.0)]),  # many terms along the axle are one place
    ],
)
def test_one_place(model, name, expected):
    np.testing.assert_allclose(effect_places(model, EFFECTS[name]), expected, atol=0.08)  # half an element


def test_four_corners(model):
    found = np.array(effect_places(model, EFFECTS["girder_end"]))
    assert sorted(map(tuple, np.sign(found[:, ::2]))) == [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    np.testing.assert_allclose(np.abs(found[:, 2]), GIRDER_Z, atol=1e-9)


def test_what_an_added_motion_joins_is_one_place_and_unjoined_ones_are_several(model):
    def effect(build):
        magnitude = Parameter("it", 0.0, 0.0, 10.0, "kg", prior_sd=5.0)
        more = Parameter("it_freq", 10.0, 1.0, 20.0, "Hz", prior_sd=5.0)
        grid = ({"it": 1.0, "it_freq": 10.0},)
        return Effect("it", "It", "a", "b", magnitude, build, (more,), grid)

    def rows(model):
        return [motion(model, ("crossbar", (s * CROSSBAR_X, GIRDER_Y, 0.0)), UY) for s in (-1, 1)]

    across = effect(lambda model: maxwell_branches([rows(model)[1] - rows(model)[0]], "it", "it_freq"))
    np.testing.assert_allclose(effect_places(model, across), [(0.0, GIRDER_Y, 0.0)], atol=1e-9)
    apart = effect(lambda model: hung_masses(rows(model), "it", "it_freq", 0.03))
    found = sorted(effect_places(model, apart))
    np.testing.assert_allclose(found, [(-CROSSBAR_X, GIRDER_Y, 0.0), (CROSSBAR_X, GIRDER_Y, 0.0)], atol=1e-9)
    assert effect_places(model, effect(lambda model: Addition())) == []
