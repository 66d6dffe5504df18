"""Plies and laminates: reference values of a bias tire, invariances, refusals."""

import numpy as np
import pytest

from calib import InputError
from models.tire.laminate import Ply, abd, pantograph
from models.tire.micromechanics import CordRubber, isotropic

CORDS = CordRubber(2e9, 5e6, 0.3)
ANGLE = np.radians(38.0)


def laminate(n):
    return abd([Ply(1.2e-3, ANGLE if k % 2 == 0 else -ANGLE, CORDS.ply()) for k in range(n)])


@pytest.mark.parametrize(
    ("rule", "wanted"),
    [
        ("gough_tangorra", (6.035e8, 4.65766e6, 1.1745e6)),
        ("akasaka_hirano", (6e8, 6.66667e6, 1.66667e6)),
        ("halpin_tsai", (6.035e8, 1.14286e7, 3.1064e6)),
    ],
)
def test_constants_of_a_ply(rule, wanted):
    assert CORDS.ply(rule)[:3] == pytest.approx(wanted, rel=1e-5)


def test_a_turned_ply():
    q = Ply(1e-3, ANGLE, CORDS.ply()).reduced / 1e6
    wanted = [90.8764, 143.547031, 236.029538, 110.33583, 180.752888, 142.388194]
    assert [q[0, 0], q[0, 1], q[1, 1], q[0, 2], q[1, 2], q[2, 2]] == pytest.approx(wanted, rel=1e-5)


def test_a_laminate_of_four_plies():
    four = laminate(4)
    assert [four[i, j] / 1e3 for i, j in ((0, 0), (0, 1), (1, 1), (2, 2))] == pytest.approx(
        [436.206721, 689.025749, 1132.94178, 683.463333], rel=1e-5
    )
    assert [four[0, 5], four[1, 5]] == pytest.approx([-317.7672, -520.5683], rel=1e-5)
    assert [four[3, 3], four[3, 4], four[4, 4], four[5, 5]] == pytest.approx(
        [0.837517, 1.322929, 2.175248, 1.31225], rel=1e-5
    )
    assert np.abs(four[:2, 2]).max() < 1e-9 * four[0, 0] and np.abs(four[3:5, 5]).max() < 1e-9 * four[3, 3]


def test_two_plies_couple_extension_and_twist():
    two, t = laminate(2), 1.2e-3
    assert two[0, 5] == pytest.approx(-(t**2) * Ply(t, ANGLE, CORDS.ply()).reduced[0, 2], rel=1e-12)
    assert [two[0, 5], two[1, 5]] == pytest.approx([-158.883595, -260.284159], rel=1e-5)


def test_an_isotropic_layer_is_the_same_at_every_angle():
    angles = np.linspace(0, np.pi, 13)
    turned = abd([Ply(3e-3, angles, isotropic(7e6, 0.3))])
    assert turned == pytest.approx(np.broadcast_to(turned[0], turned.shape), rel=1e-12, abs=1e-12 * turned.max())
    plate = 7e6 * 3e-3**3 / (12 * (1 - 0.3**2))
    assert turned[0, 3, 3] == pytest.approx(plate, rel=1e-12)


def test_stresses_turned_in_place_of_strains_would_be_seen():
    """The transformation of stresses, a common slip, misses the reference values."""
    c, s = np.sin(ANGLE), np.cos(ANGLE)
    t = np.array([[c**2, s**2, 2 * s * c], [s**2, c**2, -2 * s * c], [-s * c, s * c, c**2 - s**2]])
    straight = Ply(1e-3, np.pi / 2, CORDS.ply()).reduced
    assert abs((t.T @ straight @ t)[2, 2] / 1e6 - 142.388194) > 1


def test_cords_follow_the_pantograph():
    assert pantograph(ANGLE, 0.33, np.array([0.33, 0.265])) == pytest.approx(
        [ANGLE, np.arccos(0.265 / 0.33 * np.cos(ANGLE))]
    )
    with pytest.raises(InputError, match="reach"):
        pantograph(ANGLE, 0.33, np.array([0.5]))
    with pytest.raises(InputError, match="degrees"):
        pantograph(2.0, 0.33, np.array([0.3]))


def test_impossible_plies_are_refused():
    for make in (
        lambda: CordRubber(2e9, 5e6, 1.2),
        lambda: CordRubber(-2e9, 5e6, 0.3),
        lambda: CORDS.ply("rule of thumb"),
        lambda: Ply(-1e-3, 0.0, CORDS.ply()),
        lambda: abd([]),
        lambda: Ply(1e-3, 0.0, isotropic(1e6, 1.1)).reduced,
    ):
        with pytest.raises(InputError):
            make()
