"""Every effect that the bogie on its rig may lack against closed forms and independent calculations."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp

from calib import InputError
from calib.structure import Addition, Term, extend, motion, outer_term, parameter
from models.railway import bogie_effects, bogie_on_rig, rig
from models.railway.bogie import AXLE_X, AXLE_Y, CROSSBAR_X, GIRDER_Y, bogie
from models.railway.effects_frame import BRAKE_UNIT_Z, JOINT_LENGTH

EFFECTS = {e.name: e for e in bogie_effects()}


@cache
def base(twin=False):
    return bogie_on_rig(element_size=0.025, distributed=True) if twin else bogie_on_rig()


def with_effect(name):
    return extend(base(), [EFFECTS[name]])


def change(name, values, twin=False):
    """What an effect alone does to K, C and M, over all degrees of freedom of the extended model."""
    model = extend(base(twin), [EFFECTS[name]])
    out = []
    for own, bare in zip(model.matrices(values), base(twin).matrices({}), strict=True):
        wide = sp.csr_array(bare, copy=True)
        wide.resize(own.shape)
        out.append(sp.csr_array(own - wide))
    return out


@pytest.fixture
def rigid(effect_checks):
    return effect_checks.rigid


@pytest.mark.slow
def test_flexible_actuators_are_softer_supports(monkeypatch):
    flexible = with_effect("actuator_flexibility").matrices({"actuator_flexibility": 10.0, "pos_long_left": 3})
    monkeypatch.setattr(rig, "K_SUPPORT", 1 / (1 / 500e6 + 10e-9))
    softer = bogie_on_rig().matrices({"pos_long_left": 3})
    for one, other in zip(flexible, softer, strict=True):
        assert abs(one - other).max() <= 1e-12 * abs(one).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crossbar_joint", "girder_end"])
def test_soft_stretches_lower_the_stiffness_of_their_elements(name):
    # The mesh has lines at 0.15 m from the joints; within each stretch the moment is nearly constant.
    model = bogie_on_rig(element_size=0.0751)
    frame, share = model.locator.frame, 0.4
    if name == "crossbar_joint":
        group, along, low, high = "crossbar", 2, 1.05 - JOINT_LENGTH, 1.05
    else:
        group, along, low, high = "girder_end", 0, CROSSBAR_X, AXLE_X
    ends = np.abs(frame.points[frame.ends][:, :, along])
    inside = np.all((ends > low - 1e-6) & (ends < high + 1e-6), axis=1)
    own = inside & np.array([frame.members[m].group == group for m in frame.member_of])
    assert own.sum() >= 8
    full = frame.beams((group,), own)[0]
    lost = model.dofs.expansion.T @ full @ model.dofs.expansion

    tips = [motion(model, ("frame", (x, GIRDER_Y, z)), 1) for x in (2.005, -2.005) for z in (1.05, -1.05)]
    twist = np.array([1.0, -1.0, -1.0, 1.0]) @ np.array(tips)

    def flexibility(stiffness=()):
        effect = replace(EFFECTS[name], build=lambda _: Addition(stiffness=stiffness))
        return twist @ sp.linalg.spsolve(extend(model, [effect]).matrices({name: share})[0], twist)

    mine = flexibility(EFFECTS[name].build(model).stiffness) - flexibility()
    theirs = flexibility((Term(name, sp.csr_array(lost), parameter(name, -1.0)),)) - flexibility()
    assert mine > 0 and mine == pytest.approx(theirs, rel=0.1)


@pytest.mark.slow
def test_only_what_stands_on_the_ground_holds_a_bogie_that_rises(rigid):
    up = rigid(base(), 1)
    for name, effect in EFFECTS.items():
        values = effect.grid[0] if effect.grid else {name: effect.plausible}
        stiffness, damping, mass = change(name, values)
        wide = np.pad(up, (0, mass.shape[0] - len(up)))
        if name not in ("actuator_flexibility", "wheel_contact"):
            assert abs(stiffness @ wide).max() <= 1e-9 * max(abs(stiffness).max(), 1.0)
        assert abs(damping @ wide).max() <= 1e-9 * max(abs(damping).max(), 1.0)
        weight = wide @ mass @ wide
        expected = {"crossbar_mass": 100.0, "brake_unit": 80.0}.get(name, 0.0)
        assert weight == pytest.approx(expected, abs=1e-6), name


@pytest.mark.medium
def test_block_tilt_resists_a_block_that_tilts(rigid):
    tilted = rigid(base(), 3, {"block_left"}, (0.0, rig.BLOCK_Y, rig.BLOCK_Z))
    stiffness = change("block_tilt", {"block_tilt": 70.0})[0]
    assert tilted @ stiffness @ tilted == pytest.approx(70e3)


@pytest.mark.medium
def test_blocks_and_rods_dissipate_as_they_store():
    terms = {t.name: t.matrix for t in base().stiffness.terms}
    blocks, rods = change("block_damping", {"block_damping": 3.0})[1], change("rod_damping", {"rod_damping": 2.0})[1]
    assert abs(blocks - 3e3 * terms["K_block"]).max() < 1e-9
    assert abs(rods - 2e3 * (terms["K_rod_upper"] + terms["K_rod_lower"])).max() < 1e-9


@pytest.mark.medium
def test_one_corner_only(rigid):
    raised = rigid(base(), 1, {"axle_front", "box_front_left", "box_front_right"})
    springs = change("primary_uneven", {"primary_uneven": 0.25})[0]
    damper = change("weak_damper", {"weak_damper": 0.5})[1]
    assert raised @ springs @ raised == pytest.approx(0.25 * 2 * 564e3)
    assert raised @ damper @ raised == pytest.approx(-0.5 * 18e3)
    for matrix in (springs, damper):
        touched = base().mesh.points[base().dofs.node[np.flatnonzero(abs(matrix).sum(axis=0) > 1.0)]]
        assert np.all(touched[:, [0, 2]] > 1.0)


@pytest.mark.medium
def test_soft_mounts_are_in_series_with_the_dampers():
    c, s, root, n = 18e3, 300e-9, 80j - 5, base().n_dof
    k, damping, _ = with_effect("damper_mount").matrices({"damper_mount": 300.0})
    z = (k + root * damping).toarray()
    seen = z[:n, :n] - z[:n, n:] @ np.linalg.solve(z[n:, n:], z[n:, :n])
    rigid_k, rigid_c, _ = base().matrices({})
    expected = rigid_k + rigid_c * (root / (1 + root * c * s))
    assert abs(seen - expected.toarray()).max() <= 1e-12 * abs(expected).max()


def test_wheel_contact_moves_from_one_wheel_to_the_other():
    frame = base().locator
    left, right = (frame.row((AXLE_X, AXLE_Y, z), 1, "axle_front")[0] for z in (0.87, -0.87))
    stiffness = change("wheel_contact", {"wheel_contact": 0.2})[0]
    expected = 0.2 * 1.2e9 * (np.outer(left, left) - np.outer(right, right))
    assert abs(stiffness - expected).max() <= 1e-9 * abs(expected).max()


def test_rolling_wheels_are_heavier_lengthwise(rigid):
    ahead = rigid(base(), 0, {"axle_front"})
    mass = change("rolling_wheels", {"rolling_wheels": 1.0})[2]
    assert ahead @ mass @ ahead == pytest.approx(2 * 48.0 / 0.43**2)


@pytest.mark.medium
@pytest.mark.parametrize("twin", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_gear_case_off_the_middle_turns_on_an_arm(rigid, twin):
    model, centre, mass, e = base(twin), (AXLE_X, AXLE_Y, 0.0), 300.0, 0.2
    ahead, up = (rigid(model, d, {"axle_front"}) for d in (0, 1))
    about_x, about_y = (rigid(model, d, {"axle_front"}, centre) for d in (3, 4))
    added = change("gear_case_offset", {"gear_case_offset": 200.0}, twin)[2]
    for one, other, expected in (
        (about_x, about_x, mass * e**2), (about_y, about_y, mass * e**2),
        (ahead, about_y, mass * e), (up, about_x, -mass * e), (ahead, ahead, 0.0), (up, about_y, 0.0),
    ):  # fmt: skip
        assert one @ added @ other == pytest.approx(expected, abs=1e-9 * mass)


def test_gear_case_of_another_bogie_is_refused():
    strange = tuple(replace(p, matrix=2 * p.matrix) if p.name == "gear case" else p for p in base().parts)
    with pytest.raises(InputError, match="gear case"):
        extend(replace(base(), parts=strange), [EFFECTS["gear_case_offset"]])


def test_torque_link_holds_the_axle_to_the_crossbar(rigid):
    raised = rigid(base(), 1, {"axle_front"})
    stiffness = change("torque_link", {"torque_link": 500.0})[0]
    assert raised @ stiffness @ raised == pytest.approx(500e3)


def test_stiff_bushes_resist_a_box_that_turns(rigid):
    # Turned by 1, a box moves the ends of its rods by 1 times their height; either bush then turns against the line.
    turned = rigid(base(), 5, {"box_front_left"}, (AXLE_X, AXLE_Y, 1.05))
    own = [r for group in ("rod_upper", "rod_lower") for r in bogie(1.0).springs[group] if r.end[0] == "box_front_left"]
    energy = 0.0
    for rod in own:
        (x, y, _), height = np.subtract(rod.other[1], rod.end[1]), rod.end[1][1] - AXLE_Y
        slope = -y * height / (x**2 + y**2)
        energy += (slope - 1) ** 2 + slope**2
    stiffness = change("stiff_bushes", {"stiff_bushes": 4.0})[0]
    assert len(own) == 2 and turned @ stiffness @ turned == pytest.approx(4e3 * energy)


def test_brake_unit_on_hard_bushes_is_a_mass():
    row = motion(base(), ("crossbar", (CROSSBAR_X, GIRDER_Y, BRAKE_UNIT_Z)), 1)
    mass = replace(
        EFFECTS["crossbar_mass"], build=lambda m: Addition(mass=(outer_term("m", [row], parameter("crossbar_mass")),))
    )
    expected = extend(base(), [mass]).modes({"crossbar_mass": 80.0}, 8)
    found = with_effect("brake_unit").modes({"brake_unit": 80.0, "brake_unit_freq": 2000.0}, 8)
    np.testing.assert_allclose(found.natural_freq, expected.natural_freq, rtol=1e-3)
    assert np.abs(expected.natural_freq / base().modes({}, 8).natural_freq - 1).max() > 0.01
