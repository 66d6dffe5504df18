"""The energy of the shell against its strong form, which shares no code with it: sympy, central differences.

Both are solved by hoop order, so that a fine mesh costs little: the surface and the laminate are axisymmetric, and the
stiffness of equal hoop cells is circulant.
"""

from functools import cached_property

import numpy as np
import pytest
from meridians import Torus
from scipy.sparse.linalg import spsolve

from models.tire.grid import Grid
from models.tire.inflated import Wall
from models.tire.laminate import Ply, abd
from models.tire.micromechanics import Orthotropic

pytest.importorskip("sympy", reason="needs sympy: pip install calib[dev]")

from shell_of_revolution import Form, adjoint, clamped_response, equilibrium, operators

PRESSURE = 2e5
CORDS = Orthotropic(1e9, 1e8, 5e7, 0.3)
AROUND = 4096  # hoop cells of the whole ring: order 2 is then exact to 1e-6


class Sector(Grid):
    """Five neighbouring cells of a ring of `AROUND` equal ones: all that a cell of the ring is coupled with."""

    @cached_property
    def _edges(self):
        return 2 * np.pi * np.arange(-1.0, self.n_hoop + 1) / AROUND


def laminate(thickness, *degrees):
    return abd([Ply(thickness / len(degrees), np.radians(angle), CORDS) for angle in degrees])


def by_energy(surface, stiffness, n, order):
    """Amplitudes of v and w at the crown under a normal load of one hoop order."""
    grid = Sector(surface, n, 5, 0.0)
    wall = Wall.build(grid, np.broadcast_to(stiffness, (2 * n, 6, 6)), np.ones(2 * n))
    ring = np.concatenate([number[number[:, 0] >= 0] for number in grid.numbers])
    whole = wall.cells.linear_stiffness().matrix()
    step = 2j * np.pi * order / AROUND
    matrix = sum(whole[ring[:, 0]][:, ring[:, k]] * np.exp(step * away) for k, away in enumerate((0, 1, 2, -2, -1)))
    found = spsolve(matrix.tocsc(), PRESSURE * wall.volume.load[ring[:, 0]].astype(complex))
    v, w = found[n:].reshape(2, n - 1)[:, n // 2 - 1]
    return np.array([v * np.exp(-step / 2), w])  # v stands half a cell further round


def by_strong_form(surface, stiffness, n, order):
    return clamped_response(surface, stiffness, n, order, (0.0, 0.0, PRESSURE))[1][1:, n // 2]


def limit(coarse, fine):
    """What a sequence of order 2 approaches (Richardson 1911)."""
    return (4 * fine - coarse) / 3


def test_the_adjoint_of_the_strains_is_the_equilibrium_of_sanders():
    forces = tuple(Form.of(name) for name in ("N1", "N2", "N12", "M1", "M2", "M12"))
    for found, written in zip(adjoint(forces), equilibrium(*forces), strict=True):
        assert len(found.terms) > 5 and not (found + written).terms


def test_the_operators_are_complete_and_self_adjoint_in_their_highest_derivatives():
    found = operators()
    # All derivatives up to orders 2 (u, v), 3 (u or v with w) and 4 (w) but the one of w by s, s and theta.
    wanted = {
        (m, f, a, b) for m in range(3) for f in range(3) for a in range(5) for b in range(5)
        if a + b <= 2 + (m == 2) + (f == 2)
    } - {(2, 2, 2, 1)}  # fmt: skip
    assert set(found) == wanted and len(found) == 78
    # 603 terms while r, k1, k2 and their derivatives pass for independent; Gauss and Codazzi leave fewer.
    assert sum(len(factor) for factor in found.values()) == 579
    for (m, f, a, b), factor in found.items():
        if a + b == 2 + (m == 2) + (f == 2):
            assert found[f, m, a, b] == (-1) ** (a + b) * factor


@pytest.mark.medium
@pytest.mark.parametrize("order", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_both_forms_approach_the_same_displacements_of_a_laminate_with_every_coupling(order):
    surface, stiffness = Torus(reach=np.pi / 2), laminate(8e-3, 20.0, 70.0, -10.0)
    root = np.sqrt(np.diag(stiffness))
    assert (np.abs(stiffness) > 5e-3 * np.outer(root, root)).all()
    energy = limit(*(by_energy(surface, stiffness, n, order) for n in (24, 48)))
    strong = [by_strong_form(surface, stiffness, n, order) for n in (96, 192, 384, 768)]
    size = np.abs(energy).max()
    assert np.abs(limit(*strong[2:]) - energy).max() < 6e-4 * size
    change = np.abs(np.diff(strong, axis=0)).max(axis=1)
    assert np.log2(change[:-1] / change[1:]) == pytest.approx([2.0, 2.0], abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 2])
def test_both_forms_approach_the_same_displacements_of_a_bias_torus(order):
    """The bead layers of an antisymmetric bias laminate are narrow: the strong form needs many cells."""
    surface, stiffness = Torus(), laminate(8e-3, 38.0, -38.0)
    energy = [by_energy(surface, stiffness, n, order)[1] for n in (96, 192, 384)]
    strong = [by_strong_form(surface, stiffness, n, order)[1] for n in (384, 768, 1536, 3072)]
    wanted = limit(*energy[1:])
    assert limit(*strong[2:]) == pytest.approx(wanted, rel=2e-4)
    for sequence in (energy, strong):
        error = np.abs(np.array(sequence) - wanted)
        assert np.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.35)
    assert abs(strong[0] - wanted) > 2 * abs(energy[2] - wanted)  # at the same 384 cells
