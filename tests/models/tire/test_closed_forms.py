"""Membrane forces of inflated walls against closed forms: torus, netting cords, sphere."""

import numpy as np
import pytest
from meridians import Torus

from models.tire.grid import Grid
from models.tire.inflated import Wall
from models.tire.laminate import Ply, abd, pantograph
from models.tire.micromechanics import CordRubber, isotropic
from models.tire.profile import netting_profile

PRESSURE = 2e5


def wall_of(profile, n, plies):
    """Axisymmetric strip with plies that are given at arc lengths."""
    grid = Grid(profile, n)
    stiffness = np.broadcast_to(abd(plies(grid.s_quarter)), (2 * n, 6, 6))
    return Wall.build(grid, stiffness, np.ones(2 * n))


def forces_of(wall):
    """N1 and N2 at the nodes of the linear wall under pressure, N/m."""
    q = wall.cells.linear_stiffness().factor().solve(PRESSURE * wall.volume.load)
    return wall.cells.at_nodes(wall.cells.resultants(q, linear=True))[:, :2].T


@pytest.mark.parametrize(("thickness", "wanted"), [(4e-3, 0.99807), (1e-3, 0.99953), (0.25e-3, 0.99993)])
def test_a_torus_carries_pressure_as_a_membrane(thickness, wanted):
    """N1 = p a (r + R) / (2 r) and N2 = p a / 2 (Fluegge 1973), but for what bending takes, which thins out."""
    torus, n = Torus(), 400
    meridian, hoop = forces_of(wall_of(torus, n, lambda s: [Ply(thickness, 0.0, isotropic(1e9, 0.3))]))
    r = torus.r(torus.length / 2)
    exact = PRESSURE * torus.a * (r + torus.centre) / (2 * r)
    assert meridian[n // 2] / exact == pytest.approx(wanted, abs=2e-5)
    # As the equilibrium of a sheet goes, the hoop takes what the meridian leaves.
    missing = (exact - meridian[n // 2]) / torus.a * r
    assert hoop[n // 2] - PRESSURE * torus.a / 2 == pytest.approx(missing, rel=0.15)


R0, RM, ANGLE = 0.35, 0.28, np.radians(38.0)


def netting_errors(rubber, swapped=False):
    """Worst errors of N1 and of N2 / N1 against inextensible cords over the middle half of the section."""
    profile, n = netting_profile(R0, RM, 0.22, ANGLE), 160
    cords = CordRubber(2e9, rubber * 2e9, 0.3).ply()

    def cord_angle(s):
        return pantograph(ANGLE, R0, np.minimum(profile.r(s), R0))

    def plies(s):
        angle = np.pi / 2 - cord_angle(s) if swapped else cord_angle(s)
        return [Ply(1.2e-3, sign * angle, cords) for sign in (1, -1, 1, -1)]

    wall = wall_of(profile, n, plies)
    middle = slice(n // 4, 3 * n // 4 + 1)
    meridian, hoop = (force[middle] for force in forces_of(wall))
    s = wall.grid.s_node[middle]
    r, alpha = profile.r(s), cord_angle(s)
    exact = PRESSURE * (R0**2 - RM**2) / (2 * r) * np.sin(ANGLE) / np.sin(alpha)
    assert exact[n // 4] == pytest.approx(12600.0, rel=1e-6)  # the crown
    return np.abs(meridian / exact - 1).max(), np.abs(hoop / meridian * np.tan(alpha) ** 2 - 1).max()


def test_cords_in_soft_rubber_carry_the_forces_of_a_net():
    """Inextensible cords alone (Hofferberth 1956; Purdy 1963): what rubber takes vanishes with its modulus."""
    firm, soft = netting_errors(1e-4), netting_errors(1e-5)
    assert firm[0] < 5e-3 and soft[0] < 5e-3
    assert firm[1] < 2e-3 and soft[1] < 1e-3
    assert firm[1] > 5 * soft[1]  # the rest is left by the mesh


def test_cord_angles_taken_from_the_meridian_would_be_seen():
    force, ratio = netting_errors(1e-4, swapped=True)
    assert force > 0.1 and ratio > 0.3


def test_a_sphere_that_grows_evenly_is_in_balance():
    """w = p R^2 (1 - nu) / (2 E h) everywhere: what is left of the pressure inside is of order 2 in the mesh."""
    radius, thickness, modulus, poisson = 0.3, 5e-3, 1e9, 0.3
    left = []
    for n in (24, 48, 96):
        sphere = Torus(0.0, radius, np.radians(60.0))
        wall = wall_of(sphere, n, lambda s: [Ply(thickness, 0.0, isotropic(modulus, poisson))])
        grid = wall.grid
        q = grid.gathered(0.0, 0.0, PRESSURE * radius**2 * (1 - poisson) / (2 * modulus * thickness))
        force = wall.cells.linear_stiffness().matrix() @ q - PRESSURE * wall.volume.load
        inside = slice(n // 6, n - n // 6)
        along, _, normal = (
            np.abs(force[number[inside, 0]] / area[inside, 0]).max() / PRESSURE
            for number, area in zip(grid.numbers, (grid.area_u, grid.area_v, grid.area_node), strict=True)
        )
        left.append(along)
        assert normal < 1e-9  # the even growth of a sphere is exact against the normal
    assert left[0] < 1e-3
    assert np.log2(np.divide(left[:-1], left[1:])) == pytest.approx([2.0, 2.0], abs=0.15)
