"""The membrane by itself: patch tests, rank, invariances, rectangles, and bending in meshes of distorted elements."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from qm6 import qm6

from models.fem.membrane import membrane
from models.fem.quad import Quads, one_wall, projected
from models.fem.sheet import Sheet

SHEET = Sheet(0.02, 70e9, 0.3, 2700.0)
ORTHOTROPIC = Sheet(0.03, 40e9, 0.25, 1500.0, young_modulus_across=10e9, shear_modulus=5e9)
SHEETS = pytest.mark.parametrize("sheet", [SHEET, ORTHOTROPIC], ids=["isotropic", "orthotropic"])
# Five distorted elements round an inner quadrilateral (MacNeal and Harder 1985).
PATCH = np.array([[0, 0], [0.24, 0], [0.24, 0.12], [0, 0.12], [0.04, 0.02], [0.18, 0.03], [0.16, 0.08], [0.08, 0.08]])
TURNS = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]])


def raised(points: np.ndarray) -> np.ndarray:
    """The same points (..., 2) in space, z = 0."""
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


@dataclass(frozen=True)
class Wall:
    """A flat wall that moves in its plane only.

    Its points form a grid (n_u, n_v, 2), or are (n, 2) with the corners (n_elements, 4) of the elements given.
    Motions are (ux, uy, rz) of the points in turn.
    """

    sheet: Sheet
    grid: np.ndarray
    elements: np.ndarray | None = None

    @property
    def points(self) -> np.ndarray:
        return self.grid.reshape(-1, 2)

    @cached_property
    def corners(self) -> np.ndarray:
        if self.elements is not None:
            return self.elements
        k = np.arange(len(self.points)).reshape(self.grid.shape[:2])
        return np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=2).reshape(-1, 4)

    @cached_property
    def quads(self) -> Quads:
        return projected(raised(self.points)[self.corners], np.array([1.0, 0.0, 0.0]))

    @cached_property
    def stiffness(self) -> sp.csc_array:
        blocks = sum(membrane(self.quads, self.sheet))
        c = self.corners
        dofs = np.concatenate([(3 * c[:, :, None] + [0, 1]).reshape(-1, 8), 3 * c + 2], axis=1)
        rows, columns = np.repeat(dofs, 12, axis=1).ravel(), np.tile(dofs, (1, 12)).ravel()
        n = 3 * len(self.points)
        return sp.csc_array((blocks.ravel(), (rows, columns)), shape=(n, n))

    def at(self, axis: int, coordinate: float) -> np.ndarray:
        """Points on a line."""
        return np.flatnonzero(np.abs(self.points[:, axis] - coordinate) < 1e-9)

    def solve(self, held: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Motions (n, 3) under forces (n, 3) where ``held`` (n, 3), bool, does not move."""
        free = np.flatnonzero(~held.ravel())
        u = np.zeros(held.size)
        u[free] = spla.spsolve(self.stiffness[free][:, free], load.ravel()[free])
        return u.reshape(-1, 3)


def convex(count: int) -> np.ndarray:
    """Random convex quadrilaterals (count, 4, 2), some close to triangles, with sides up to 30 to 1."""
    rng = np.random.default_rng(11)
    turn = np.sort(rng.uniform(0, 2 * np.pi, (200 * count, 4)), axis=1)
    points = np.stack([np.cos(turn), np.sin(turn)], axis=2) * [1.0, 0.2]
    edge = np.roll(points, -1, axis=1) - points
    back = np.roll(edge, 1, axis=1)
    sine = back[..., 0] * edge[..., 1] - back[..., 1] * edge[..., 0]
    sine /= np.linalg.norm(edge, axis=2) * np.linalg.norm(back, axis=2)
    return points[sine.min(axis=1) > 0.05][:count]


def straight(elements: Quads, share: float) -> Quads:
    return replace(elements, allman=np.full(len(elements.centre), share))


def fields(points: np.ndarray) -> np.ndarray:
    """Three rigid motions and three constant strains, over (ux, uy) of the corners and their rz, shape (12, 6)."""
    x, y = points.T
    zero, one = np.zeros(4), np.ones(4)
    flat = [(one, zero), (zero, one), (-y, x), (x, zero), (zero, y), (y / 2, x / 2)]
    return np.array([[*np.stack(uv, axis=1).ravel(), *(one if k == 2 else zero)] for k, uv in enumerate(flat)]).T


@SHEETS
@pytest.mark.parametrize("strain", np.eye(3), ids=["along", "across", "shear"])
def test_patch_of_constant_strain_is_exact(sheet, strain):
    wall = Wall(sheet, PATCH, TURNS)
    assert wall.quads.allman[0] > 0.9
    x, y = PATCH.T
    u = np.stack([strain[0] * x + strain[2] * y, strain[1] * y, 0 * x - strain[2] / 2], axis=1)
    k = wall.stiffness.toarray()
    found = np.linalg.solve(k[12:, 12:], -k[12:, :12] @ u.ravel()[:12])
    np.testing.assert_allclose(found, u.ravel()[12:], atol=1e-12)
    assert u.ravel() @ k @ u.ravel() == pytest.approx(0.24 * 0.12 * strain @ sheet.membrane @ strain, rel=1e-12)


@SHEETS
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_three_motions_without_energy_and_exact_constant_strains(sheet, share):
    points = convex(60)
    k = straight(projected(raised(points)), share)
    stiff, tied = membrane(k, sheet)
    motions = np.array([fields(own) for own in k.corners])
    largest = np.abs(stiff).max(axis=(1, 2))[:, None, None]
    assert np.abs(stiff @ motions[:, :, :3] / largest).max() < 1e-11 and np.abs(tied @ motions / largest).max() < 1e-10
    values = np.linalg.eigvalsh(stiff + tied).T
    assert np.all(np.abs(values[:3]) < 1e-14 * values[-1]) and np.all(values[3] > 1e-9 * values[-1])
    strain = fields(k.corners[0])[:, 3:]
    np.testing.assert_allclose(strain.T @ stiff[0] @ strain, k.area[0] * sheet.membrane, rtol=1e-10, atol=1e-3)


def test_membrane_holds_five_patterns_and_drilling_the_other_four():
    elements = projected(raised(convex(50)))
    for share, rank in zip(membrane(elements, SHEET), (5, 4), strict=True):
        np.testing.assert_allclose(share, np.swapaxes(share, 1, 2), atol=1e-13 * np.abs(share).max())
        values = np.linalg.eigvalsh(share).T
        assert np.all(values[0] > -1e-12 * values[-1])
        assert np.all(np.count_nonzero(values > 1e-9 * values[-1], axis=0) == rank)


def test_equal_rotations_against_the_wall_pay_the_penalty_on_its_area():
    elements = projected(raised(convex(50)))
    turned = np.r_[np.zeros(8), np.ones(4)]
    a, b = membrane(elements, SHEET)
    np.testing.assert_allclose(a @ turned, 0.0, atol=1e-14 * np.abs(a).max())
    np.testing.assert_allclose(turned @ b @ turned, SHEET.drilling * elements.area, rtol=1e-12)


@pytest.mark.parametrize("order", [[1, 2, 3, 0], [2, 3, 0, 1], [3, 2, 1, 0]])
def test_the_corner_that_comes_first_does_not_matter(order):
    points = raised(convex(20))
    along = np.array([0.3, 1.0, 0.0])
    here, there = projected(points, along), projected(points[:, order], along)
    np.testing.assert_allclose(there.distortion, here.distortion, rtol=1e-9)
    flip = -1.0 if order[0] == 3 else 1.0  # the normal turns over, and with it y and rz
    signs = np.r_[np.tile([1.0, flip], 4), np.full(4, flip)]
    which = np.r_[(2 * np.array(order)[:, None] + [0, 1]).ravel(), 8 + np.array(order)]
    for a, b in zip(membrane(here, ORTHOTROPIC), membrane(there, ORTHOTROPIC), strict=True):
        np.testing.assert_allclose(b * np.outer(signs, signs), a[:, which][:, :, which], atol=1e-10 * np.abs(a).max())


def test_turning_and_scaling_change_nothing():
    points = raised(convex(20))
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    x = np.array([1.0, 0, 0])
    here, there = projected(points, x), projected(points @ turn.T + 3.0, turn @ x)
    large = projected(5 * points, x)
    np.testing.assert_allclose(large.distortion, here.distortion, rtol=1e-9)
    scale = np.r_[np.full(8, 5.0), np.ones(4)]
    for a, b, e in zip(*(membrane(q, ORTHOTROPIC) for q in (here, there, large)), strict=True):
        np.testing.assert_allclose(b, a, atol=1e-10 * np.abs(a).max())
        np.testing.assert_allclose(e * np.outer(scale, scale) / 25, a, atol=1e-10 * np.abs(a).max())


@pytest.mark.parametrize("factor", [0.1, 1.0])
@SHEETS
def test_a_rectangle_is_that_of_incompatible_modes(sheet, factor):
    sheet = replace(sheet, drilling_factor=factor)
    for length in (0.1, 1.0, 30.0):
        elements = projected(raised(np.array([[[0, 0], [length, 0], [length, 1], [0, 1.0]]])))
        assert elements.distortion[0] < 1e-25
        a, b = membrane(elements, sheet)
        np.testing.assert_allclose(a, qm6(elements, sheet, 0.0), atol=1e-13 * a.max())
        np.testing.assert_allclose(a + b, qm6(elements, sheet, sheet.drilling), atol=1e-13 * a.max())


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_bent_rectangle_is_exact_however_far_its_edges_bend(share):
    for length in (0.1, 1.0, 20.0):
        points = np.array([[0, 0], [length, 0], [length, 0.4], [0, 0.4]])
        k = sum(membrane(straight(projected(raised(points[None])), share), SHEET))[0]
        x, y = (points - points.mean(axis=0)).T
        u = np.r_[np.stack([x * y, -(x**2) / 2 - 0.3 * y**2 / 2], axis=1).ravel(), -x]
        assert u @ k @ u == pytest.approx(70e9 * 0.02 * 0.4**3 / 12 * length, rel=1e-9)


def test_edges_bend_the_more_the_more_an_element_is_distorted():
    def share(lean: float, taper: float) -> float:
        flat = np.array([[[-lean - taper, 0], [1 - lean + taper, 0], [1 + lean - taper, 0.5], [lean + taper, 0.5]]])
        return float(projected(raised(flat)).allman[0])

    for shares in ([share(v, 0.0) for v in (0, 1e-5, 0.02, 0.1)], [share(0.0, v) for v in (0, 1e-5, 0.02, 0.1)]):
        assert shares[0] == 0 < shares[1] < 1e-6 and np.all(np.diff(shares) > 0) and shares[3] > 0.5
    two = projected(raised(np.array([[[0, 0], [1, 0], [1, 1], [0, 1]], [[1, 0], [2, 0], [1.5, 1], [1, 1.0]]])))
    assert two.allman[0] == two.allman[1] == one_wall(two.some(np.array([1]))).allman[0] > 0.5


def beam(lean: float, alternate: bool, height: float = 0.2) -> Wall:
    """Six elements along 6 m; inner lines lean by ``lean`` either way at both edges, alternately for trapezoids."""
    grid = np.zeros((7, 2, 2))
    grid[..., 0] = np.arange(7.0)[:, None]
    grid[:, 1, 1] = height
    signs = (-1.0) ** np.arange(1, 6) if alternate else np.ones(5)
    grid[1:-1, :, 0] += lean * np.outer(signs, [-1, 1])
    return Wall(Sheet(0.1, 1e7, 0.3, 1.0), grid)


def tip(wall: Wall, moment: bool) -> float:
    """Deflection under a unit shear force or moment over that of a beam, clamped as a beam is."""
    height, sheet = wall.grid[0, 1, 1], wall.sheet
    held = np.zeros((14, 3), dtype=bool)
    held[:2, 0] = held[0, 1] = True
    load = np.zeros((14, 3))
    load[-2:] = [[-1 / height, 0, 0], [1 / height, 0, 0]] if moment else [0, 0.5, 0]
    bending = sheet.young_modulus * sheet.thickness * height**3 / 12
    sheared = 0.0 if moment else 6 / (5 / 6 * sheet.in_plane_shear * sheet.thickness * height)
    exact = 36 / (2 * bending) if moment else 72 / bending + sheared
    return abs(float(wall.solve(held, load)[-2:, 1].mean())) / exact


def clamped(wall: Wall) -> float:
    """Deflection under a unit shear force over 0.1081, the exact value of MacNeal and Harder (1985)."""
    held = np.zeros((14, 3), dtype=bool)
    held[:2] = True
    load = np.zeros((14, 3))
    load[-2:, 1] = 0.5
    return float(wall.solve(held, load)[-2:, 1].mean()) / 0.1081


@pytest.mark.parametrize(("lean", "alternate"), [(0.0, False), (0.1, True), (0.1, False)])
def test_straight_cantilever(lean, alternate):
    # MacNeal and Harder (1985): rectangles, then trapezoids and parallelograms of 45 degrees.
    wall = beam(lean, alternate)
    assert clamped(wall) == pytest.approx(0.992, abs=2e-3)
    assert tip(wall, moment=True) == pytest.approx(1.0, abs=3e-4)


@pytest.mark.parametrize(("alternate", "share"), [(True, 0.051), (False, 0.627)])
def test_straight_edges_lock(alternate, share):
    # As those of every element without rotations, QM6 among them (MacNeal 1992).
    wall = beam(0.1, alternate)
    object.__setattr__(wall, "quads", straight(wall.quads, 0.0))
    assert clamped(wall) == pytest.approx(share, abs=2e-3)


@pytest.mark.parametrize("height", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("alternate", [True, False])
def test_no_shape_locks_in_bending(height, alternate):
    # Up to 63 degrees and an edge of a fifth of the opposite one; the worst is where distortion is slight.
    for lean in (0.003, 0.01, 0.03, 0.1, 0.2, 0.4):
        wall = beam(lean, alternate, height)
        assert tip(wall, moment=True) == pytest.approx(1.0, abs=6e-3)
        assert tip(wall, moment=False) == pytest.approx(0.99, abs=0.04 if height == 0.2 else 0.02)


def test_curved_beam():
    # MacNeal and Harder (1985): a quarter of a circle under a force within the plane.
    def deflection(n_along: int, n_across: int) -> float:
        turn, radius = np.linspace(np.pi / 2, 0, n_along + 1)[:, None], np.linspace(4.32, 4.12, n_across + 1)
        wall = Wall(Sheet(0.1, 1e7, 0.25, 1.0), np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=2))
        held = np.zeros((len(wall.points), 3), dtype=bool)
        held[wall.at(0, 0.0)] = True
        end = wall.at(1, 0.0)
        load = np.zeros(held.shape)
        load[end, 0] = np.r_[0.5, np.ones(n_across - 1), 0.5] / n_across
        return float((load * wall.solve(held, load)).sum()) / 0.08734

    assert deflection(6, 1) == pytest.approx(1.0, abs=0.03)
    assert deflection(24, 2) == pytest.approx(1.0, abs=0.02)


def test_cooks_membrane_converges():
    # 23.96 is what fine meshes of many elements agree on (Cook 1974; Simo and Rifai 1990).
    def deflection(n: int) -> float:
        u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
        wall = Wall(Sheet(1.0, 1.0, 1 / 3, 1.0), np.stack([48 * u, 44 * u + v * (44 - 28 * u)], axis=2))
        held = np.zeros((len(wall.points), 3), dtype=bool)
        held[wall.at(0, 0.0)] = True
        end = wall.at(0, 48.0)
        load = np.zeros(held.shape)
        load[end, 1] = np.r_[0.5, np.ones(n - 1), 0.5] / n
        return float(wall.solve(held, load)[end[n // 2], 1])

    error = 1 - np.array([deflection(n) for n in (2, 4, 8, 16)]) / 23.96
    assert np.all(error > 0) and np.all(error < [0.04, 0.016, 0.01, 0.005]) and np.all(np.diff(error) < 0)
