"""Masses, stiffness and damping of the bogie on its rig, added up by hand for rigid motions of its parts."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla

from models.railway import bogie_on_rig

STEEL = 7850.0
FRAME = (
    4.46 * (STEEL * 2.0e-2 + 75) + 3.56 * (STEEL * 1.0e-2 + 38) + 5.26 * (STEEL * 1.05e-2 + 70.8)
    + 4 * 40 + 2 * 220 + 4 * 150
)  # fmt: skip
TRAILING = 2.1 * (STEEL * 2.01e-2 + 271) + 2 * 330 + 2 * 80
DRIVEN = TRAILING + 300
BLOCKS = 2 * 0.56 * 0.04 * 650
KP, C_PRIMARY, K_BLOCK, K_CONTACT, K_RAIL = 564e3, 18e3, 12e6, 25.25e6, 1200e6
K_UPPER, K_LOWER, K_LATERAL, K_GUIDANCE, K_RESTRAINT, K_SUPPORT = 6.5e6, 25e6, 300e3, 20e6, 20e6, 500e6

# Rods from the box (x, y) to the frame (x, y) in the vertical plane, front left; the others mirror it.
UPPER = (np.array([1.45, 0.63]), np.array([2.005, 0.70]))
LOWER = (np.array([1.45, 0.26]), np.array([0.75, 0.36]))


@pytest.fixture(scope="module", params=[False, True], ids=["lumped", "distributed"])
def rig(request):
    return bogie_on_rig(distributed=request.param)


def moved(model, bodies, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0), centre=(0.0, 0.0, 0.0)):
    """Free degrees of freedom when some bodies move rigidly and the others rest."""
    frame = model.locator.frame
    own = np.array([any(b.startswith(name) for name in bodies) for b in frame.bodies])
    full = np.zeros((len(frame.points), 6))
    full[own, :3] = np.asarray(translation) + np.cross(np.asarray(rotation), frame.points[own] - np.asarray(centre))
    full[own, 3:] = rotation
    q = full[model.dofs.node, model.dofs.direction]
    np.testing.assert_allclose((model.dofs.expansion @ q).reshape(-1, 6)[own], full[own], atol=1e-12)
    return q


def energy(matrix, q):
    return q @ (matrix @ q)


@pytest.mark.medium
def test_frame_weighs_3455_kg(rig):
    _, _, m = rig.matrices({})
    assert pytest.approx(3455, abs=1) == FRAME
    assert energy(m, moved(rig, ["frame"], (0, 1, 0))) == pytest.approx(FRAME, rel=1e-9)


@pytest.mark.parametrize(("end", "weight", "rounded"), [("rear", TRAILING, 1720), ("front", DRIVEN, 2020)])
def test_wheelsets_weigh_1720_and_2020_kg(rig, end, weight, rounded):
    _, _, m = rig.matrices({})
    assert weight == pytest.approx(rounded, abs=1)
    for direction in ((1, 0, 0), (0, 1, 0)):
        q = moved(rig, [f"axle_{end}", f"box_{end}"], direction)
        assert energy(m, q) == pytest.approx(weight, rel=1e-9)


def test_added_masses_act_on_the_printed_lengths(rig):
    _, _, m = rig.matrices({})
    q = moved(rig, ["frame"], (0, 1, 0))
    for name, length in (("m_girder_centre", 4.46), ("m_girder_ends", 3.56), ("m_crossbar", 5.26)):
        _, _, more = rig.matrices({name: rig.space[name].value + 10})
        assert energy(more - m, q) == pytest.approx(10 * length, rel=1e-9)


def test_wheelset_yaw_inertia(rig):
    # About the vertical axis: wheels 24 kg m2 and 330 kg at 0.87 m, boxes 1.5 kg m2 and 80 kg at 1.05 m, the axle.
    _, _, m = rig.matrices({})
    q = moved(rig, ["axle_rear", "box_rear"], rotation=(0, 1, 0), centre=(-1.45, 0, 0))
    axle = (STEEL * 2.01e-2 + 271) * 2.1**3 / 12 + STEEL * 3.22e-5 * 2.1
    by_hand = axle + 2 * (24 + 330 * 0.87**2) + 2 * (1.5 + 80 * 1.05**2)
    # Halved elements and spread wheels stand up to half an element further out.
    assert energy(m, q) == pytest.approx(by_hand, rel=5e-3)


def along(rod, motion):
    d = rod[1] - rod[0]
    return (d @ motion / np.linalg.norm(d)) ** 2


def test_frame_bouncing_strains_what_it_should(rig):
    k, c, _ = rig.matrices({})
    q = moved(rig, ["frame"], (0, 1, 0))
    up = np.array([0.0, 1.0])
    by_hand = 8 * KP + 2 * K_BLOCK + 4 * K_UPPER * along(UPPER, up) + 4 * K_LOWER * along(LOWER, up)
    assert energy(k, q) == pytest.approx(by_hand, rel=1e-9)
    assert energy(c, q) == pytest.approx(4 * C_PRIMARY, rel=1e-9)


def test_frame_pitching_strains_what_it_should(rig):
    k, c, _ = rig.matrices({})
    q = moved(rig, ["frame"], rotation=(0, 0, 1), centre=(0, 0.62, 0))

    def at(x, y):
        return np.array([-(y - 0.62), x])

    by_hand = KP * 4 * (1.17**2 + 1.73**2) + 8 * K_LATERAL * at(0, 0.525)[0] ** 2
    by_hand += 2 * K_BLOCK * 0.28**2 + 2 * K_CONTACT * at(0, 0.92)[0] ** 2
    by_hand += 4 * K_UPPER * along(UPPER, at(2.005, 0.70)) + 4 * K_LOWER * along(LOWER, at(0.75, 0.36))
    assert energy(k, q) == pytest.approx(by_hand, rel=1e-9)
    assert energy(c, q) == pytest.approx(4 * C_PRIMARY * 1.45**2, rel=1e-9)


def test_frame_rolling_strains_what_it_should(rig):
    k, c, _ = rig.matrices({})
    q = moved(rig, ["frame"], rotation=(1, 0, 0), centre=(0, 0.62, 0))
    # u = e_x x r = (0, -z, y - 0.62): uy = -z, uz = y - 0.62
    up = np.array([0.0, 1.0])
    by_hand = 8 * KP * 1.05**2 + 2 * K_BLOCK * 1.17**2 + (8 * K_LATERAL + 4 * K_GUIDANCE) * 0.095**2
    by_hand += 2 * K_CONTACT * 0.30**2
    by_hand += 1.05**2 * (4 * K_UPPER * along(UPPER, up) + 4 * K_LOWER * along(LOWER, up))
    assert energy(k, q) == pytest.approx(by_hand, rel=1e-9)
    assert energy(c, q) == pytest.approx(4 * C_PRIMARY * 1.05**2, rel=1e-9)


def test_wheelset_moving_along_strains_rods_and_springs(rig):
    k, c, _ = rig.matrices({})
    q = moved(rig, ["axle_front", "box_front"], (1, 0, 0))
    ahead = np.array([1.0, 0.0])
    by_hand = 4 * K_LATERAL + 2 * K_UPPER * along(UPPER, ahead) + 2 * K_LOWER * along(LOWER, ahead)
    assert energy(k, q) == pytest.approx(by_hand, rel=1e-9)
    assert energy(c, q) == pytest.approx(0.0, abs=1e-6)


def test_blocks_stand_on_springs_and_supports(rig):
    k, _, m = rig.matrices({})
    q = moved(rig, ["block"], (0, 1, 0))
    assert energy(k, q) == pytest.approx(2 * K_BLOCK + 2 * K_SUPPORT, rel=1e-9)
    assert energy(m, q) == pytest.approx(BLOCKS, rel=1e-9)
    for direction in ((1, 0, 0), (0, 0, 1)):
        q = moved(rig, ["block"], direction)
        assert energy(k, q) == pytest.approx(2 * K_CONTACT + 2 * K_RESTRAINT, rel=1e-9)


def test_weight_arrives_at_rails_and_actuators(rig):
    k, _, m = rig.matrices({})
    gravity = 9.81 * (m @ moved(rig, ["frame", "axle", "box", "block"], (0, 1, 0)))
    sag = spla.spsolve(k.tocsc(), gravity)
    rails = [rig.locator.row((x, 0.43, z), 1, f"axle_{end}")[0] @ sag
             for end, x in (("front", 1.45), ("rear", -1.45)) for z in (0.87, -0.87)]  # fmt: skip
    supports = [
        rig.locator.row((0, 1.05, z), 1, f"block_{side}")[0] @ sag for side, z in (("left", 1.17), ("right", -1.17))
    ]
    total = FRAME + TRAILING + DRIVEN + BLOCKS
    assert K_RAIL * sum(rails) + K_SUPPORT * sum(supports) == pytest.approx(9.81 * total, rel=1e-6)
    # the driven axle is the heavier one, left and right carry alike
    assert rails[0] == pytest.approx(rails[1], rel=1e-6) and rails[0] > rails[2]
