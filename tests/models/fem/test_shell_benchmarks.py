"""Curved, warped and slender shells against the standard problems of MacNeal and Harder (1985)."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from models.fem.panel import Panel
from models.fem.sheet import Sheet
from models.fem.structure import Structure


def solve(s: Structure, held, load: np.ndarray) -> np.ndarray:
    free = np.setdiff1d(np.arange(s.n_full), np.unique(np.array(held, dtype=int)))
    u = np.zeros(s.n_full)
    u[free] = spla.spsolve(sp.csc_matrix(s.shells().stiffness[free][:, free]), load[free])
    return u


def held_at(s: Structure, *planes) -> np.ndarray:
    """Degrees of freedom at planes (axis, coordinate, motions)."""
    found = [6 * np.flatnonzero(np.abs(s.points[:, a] - c) < 1e-6)[:, None] + np.array(d) for a, c, d in planes]
    return np.concatenate([f.ravel() for f in found])


def node(s: Structure, *place) -> int:
    return int(np.argmin(np.linalg.norm(s.points - place, axis=1)))


def cylinder(sheet: Sheet, length: float, radius: float, angle: float, n: int) -> Structure:
    x, turn = np.linspace(0, length, n + 1), np.radians(np.linspace(0, angle, n + 1))
    points = np.zeros((n + 1, n + 1, 3))
    points[..., 0] = x[:, None]
    points[..., 1], points[..., 2] = radius * np.sin(turn), radius * np.cos(turn)
    return Structure((), panels=(Panel("b", "g", sheet, points),))


def scordelis_lo(n: int, factor: float = 0.1) -> float:
    """Sag of the free edge's middle under own weight over 0.3024."""
    s = cylinder(Sheet(0.25, 4.32e8, 0.0, 360.0, drilling_factor=factor), 25.0, 25.0, 40.0, n)
    held = held_at(s, (0, 0.0, (1, 2, 3)), (0, 25.0, (0, 4, 5)), (1, 0.0, (1, 3, 5)))
    load = s.shells().mass @ np.tile([0, 0, -1.0, 0, 0, 0], len(s.points))
    edge = node(s, 25.0, 25.0 * np.sin(np.radians(40)), 25.0 * np.cos(np.radians(40)))
    return -solve(s, held, load)[6 * edge + 2] / 0.3024


def pinched(n: int, factor: float = 0.1) -> float:
    """Deflection under the load on a cylinder with end diaphragms over 1.8248e-5."""
    s = cylinder(Sheet(3.0, 3e6, 0.3, 1.0, drilling_factor=factor), 300.0, 300.0, 90.0, n)
    held = held_at(
        s, (0, 0.0, (1, 2, 3)), (0, 300.0, (0, 4, 5)), (1, 0.0, (1, 3, 5)), (2, 0.0, (2, 3, 4))
    )  # fmt: skip
    load = np.zeros(s.n_full)
    under = 6 * node(s, 300.0, 0.0, 300.0) + 2
    load[under] = -0.25
    return -solve(s, held, load)[under] / 1.8248e-5


def twisted(n: int, factor: float = 0.1) -> np.ndarray:
    """Tip of the beam twisted by 90 degrees: in plane over 0.005424, out of plane over 0.001754; 6 n by n elements."""
    x, y = np.linspace(0, 12.0, 6 * n + 1), np.linspace(-0.55, 0.55, n + 1)
    turn = np.pi / 2 * x[:, None] / 12.0
    points = np.stack([np.broadcast_to(x[:, None], (len(x), len(y))), np.cos(turn) * y, np.sin(turn) * y], axis=2)
    s = Structure((), panels=(Panel("b", "g", Sheet(0.32, 29e6, 0.22, 1.0, drilling_factor=factor), points),))
    tip = np.flatnonzero(s.points[:, 0] > 12.0 - 1e-9)
    share = np.where(np.abs(s.points[tip, 2]) > 0.55 - 1e-9, 0.5, 1.0) / n
    out = []
    for axis, reference in ((2, 0.005424), (1, 0.001754)):
        load = np.zeros(s.n_full)
        load[6 * tip + axis] = share
        u = solve(s, held_at(s, (0, 0.0, range(6))), load)
        out.append(float(share @ u[6 * tip + axis]) / reference)
    return np.array(out)


def hemisphere(n: int, factor: float = 0.1) -> float:
    """Deflection under the loads on a hemisphere with an 18 degree hole over 0.0940."""
    up, turn = np.radians(np.linspace(0, 72, n + 1)), np.radians(np.linspace(0, 90, n + 1))[:, None]
    points = 10 * np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up) + 0 * turn], axis=2)
    s = Structure((), panels=(Panel("b", "g", Sheet(0.04, 6.825e7, 0.3, 1.0, drilling_factor=factor), points),))
    one, other = node(s, 10.0, 0.0, 0.0), node(s, 0.0, 10.0, 0.0)
    held = [*held_at(s, (0, 0.0, (0, 4, 5)), (1, 0.0, (1, 3, 5))), 6 * one + 2]
    load = np.zeros(s.n_full)
    load[6 * one], load[6 * other + 1] = 1.0, -1.0
    return solve(s, held, load)[6 * one] / 0.0940


def test_scordelis_lo_roof():
    found = np.array([scordelis_lo(n) for n in (4, 8, 16)])
    np.testing.assert_allclose(found, [1.0447, 1.0046, 0.9972], atol=2e-3)


def test_pinched_cylinder_with_diaphragms():
    found = np.array([pinched(n) for n in (4, 8, 16)])
    assert np.all(found > [0.37, 0.74, 0.92]) and np.all(np.diff(found) > 0) and found[-1] < 1.0


def test_twisted_beam():
    assert np.abs(twisted(1) - 1).max() < 0.008
    assert np.abs(twisted(2) - 1).max() < 0.004
    assert np.abs(twisted(4) - 1).max() < 0.002


def test_pinched_hemisphere():
    assert hemisphere(8) > 0.89 and hemisphere(16) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_fine_meshes_converge():
    assert scordelis_lo(32) == pytest.approx(0.996, abs=2e-3)  # 0.3024 is the value of a shallow theory
    assert pinched(48) == pytest.approx(1.0, abs=0.01)
    assert np.abs(twisted(8) - 1).max() < 1e-3
    assert hemisphere(32) == pytest.approx(0.993, abs=3e-3)


@pytest.mark.medium
def test_what_the_drilling_factor_moves():
    # A tenth and ten times the default. Folded and cylindrical walls are hardly affected; a twisted wall becomes soft
    # with a small factor, a coarsely meshed doubly curved one stiff with a large one.
    for problem, limit in ((lambda f: scordelis_lo(8, f), 3e-4), (lambda f: pinched(8, f), 0.021)):
        base = problem(0.1)
        assert abs(problem(0.01) / base - 1) < limit and abs(problem(1.0) / base - 1) < limit
    np.testing.assert_allclose(twisted(2, 0.01) / twisted(2), [1.0142, 1.0120], atol=2e-3)
    np.testing.assert_allclose(twisted(2, 1.0) / twisted(2), [0.9986, 0.9988], atol=2e-3)
    assert hemisphere(8, 0.01) == pytest.approx(0.979, abs=5e-3)
    assert hemisphere(8, 1.0) == pytest.approx(0.52, abs=0.02)


def pillar(n: int, length: float, factor: float = 0.1, moment: bool = False) -> float:
    """Tip deflection of a wall 0.4 m wide, one element across, over that of a Timoshenko beam."""
    width, sheet = 0.4, Sheet(0.01, 70e9, 0.0, 2700.0, drilling_factor=factor)
    points = np.zeros((2, n + 1, 3))
    points[..., 0], points[..., 1] = np.array([[-width / 2], [width / 2]]), np.linspace(0, length, n + 1)
    s = Structure((), panels=(Panel("b", "g", sheet, points),))
    every = 6 * np.arange(len(s.points))[:, None] + np.array([2, 3, 4])
    held = np.concatenate([held_at(s, (1, 0.0, (0, 1, 5))), every.ravel()])
    top = np.flatnonzero(s.points[:, 1] > length - 1e-9)
    load = np.zeros(s.n_full)
    bending = sheet.young_modulus * sheet.thickness * width**3 / 12
    if moment:
        load[6 * top + 1] = -np.sign(s.points[top, 0]) / width
        exact = length**2 / (2 * bending)
    else:
        load[6 * top] = 0.5
        # The element's shear is constant across the width, so its shear coefficient is 1.
        exact = length**3 / (3 * bending) + length / (sheet.in_plane_shear * width * sheet.thickness)
    return float(solve(s, held, load)[6 * top].mean() / exact)


@pytest.mark.parametrize("length", [0.95, 4.0])
def test_a_pillar_one_element_wide_bends_like_a_beam(length):
    assert pillar(1, length, moment=True) == pytest.approx(1.0, abs=1e-9)
    error = 1 - np.array([pillar(n, length) for n in (1, 2, 4, 8)])
    # A moment that varies within the element is taken at its mean: n elements miss 1/(4 n^2) of the bending.
    bound = 0.25 / np.array([1, 4, 16, 64])
    assert np.all(error > 0) and np.all(error < 1.05 * bound)
    assert np.all(np.log2(error[:-1] / error[1:]) > 1.9)
    assert pillar(2, length, 0.01) == pytest.approx(pillar(2, length), rel=1e-3)
    assert pillar(2, length, 1.0) == pytest.approx(pillar(2, length), rel=6e-3)


def window_wall(refinement: int, factor: float = 0.1) -> float:
    """Sway (m/N) of a wall whose two windows leave three pillars one element wide, held below and pushed above."""
    points = np.zeros((8, 7, 3))
    points[..., 0] = np.array([0.0, 0.4, 1.2, 2.0, 2.4, 3.2, 4.0, 4.4])[:, None]
    points[..., 1] = [0.0, 0.6, 0.84, 1.08, 1.31, 1.55, 1.9]
    windows = (((1, 3), (1, 5)), ((4, 6), (1, 5)))
    sheet = Sheet(0.01, 70e9, 0.33, 2700.0, drilling_factor=factor)
    s = Structure((), panels=(Panel("b", "g", sheet, points, windows, refinement),))
    every = 6 * np.arange(len(s.points))[:, None] + np.array([2, 3, 4])
    held = np.concatenate([held_at(s, (1, 0.0, range(6))), every.ravel()])
    top = np.flatnonzero(s.points[:, 1] > 1.9 - 1e-9)
    load = np.zeros(s.n_full)
    load[6 * top] = s.area_mass(["g"]).sum(axis=1)[6 * top]
    load /= load.sum()
    return float(load @ solve(s, held, load))


@pytest.mark.medium
def test_a_wall_with_windows():
    # Sharp re-entrant corners let any mesh converge with the first power of the element size only.
    limit = 3.123e-8  # extrapolated from 2, 4, ... 32 elements across a pillar
    error = 1 - np.array([window_wall(r) for r in range(3)]) / limit
    np.testing.assert_allclose(error, [0.267, 0.163, 0.0785], atol=0.003)
    for refinement, softer, stiffer in ((0, 0.011, 0.06), (1, 0.006, 0.034)):
        base = window_wall(refinement)
        assert 0 < window_wall(refinement, 0.01) / base - 1 < softer
        assert 0 < 1 - window_wall(refinement, 1.0) / base < stiffer
