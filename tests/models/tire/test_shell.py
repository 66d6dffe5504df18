"""The shell: rigid motions, closed forms of a cylinder, pressure and tangent, with mutants that must fail."""

import numpy as np
import pytest
from scipy import sparse

from models.tire import base_tire
from models.tire.grid import Grid
from models.tire.inflated import Wall
from models.tire.laminate import Ply, abd
from models.tire.micromechanics import isotropic
from models.tire.pressure import EnclosedVolume
from models.tire.profile import Profile, netting_profile
from models.tire.strains import strain_rows

R, LENGTH, H, MODULUS, PRESSURE = 0.3, 0.4, 0.005, 1e9, 2e5


def cylinder(n, poisson):
    s = np.linspace(0.0, LENGTH, 21)
    profile = Profile(s, np.column_stack([np.full(21, R), s]))
    stiffness = abd([Ply(H, 0.0, isotropic(MODULUS, poisson))])
    return Wall.build(Grid(profile, n), np.broadcast_to(stiffness, (2 * n, 6, 6)), np.ones(2 * n))


def rigid_motions(grid):
    """Six rigid motions at the places of u, v, w; beads move too, so that only the inside counts."""
    p, out = grid.profile, []
    for k in range(6):
        fields = []
        for name, s, theta in (
            ("u", grid.s_half, grid.theta_node),
            ("v", grid.s_node, grid.theta_half),
            ("w", grid.s_node, grid.theta_node),
        ):
            s, theta = s[:, None], theta[None, :]
            place = np.stack(np.broadcast_arrays(p.r(s) * np.cos(theta), p.r(s) * np.sin(theta), p.z(s) + 0 * theta))
            unit = np.eye(3)[k % 3][:, None, None]
            moved = np.broadcast_to(unit, place.shape) if k < 3 else np.cross(unit, place, axis=0)
            one = {
                "u": (p.dr(s) * np.cos(theta), p.dr(s) * np.sin(theta), p.dz(s) + 0 * theta),
                "v": (-np.sin(theta) + 0 * s, np.cos(theta) + 0 * s, 0 * s + 0 * theta),
                "w": (p.dz(s) * np.cos(theta), p.dz(s) * np.sin(theta), -p.dr(s) + 0 * theta),
            }[name]
            fields.append(sum(m * d for m, d in zip(moved, np.broadcast_arrays(*one), strict=True)))
        out.append(grid.gathered(*fields))
    return np.array(out).T


MUTANTS = {
    "no last twist term": lambda grid, rows: {"t12": rows.t12 - _twist(grid, 1.0)},
    "last twist term reversed": lambda grid, rows: {"t12": rows.t12 - _twist(grid, 2.0)},
    "no slope in the hoop's curvature": lambda grid, rows: {
        "c2": rows.c2 - _node(grid, grid.profile.dr) @ _node(grid, lambda s: 1 / grid.profile.r(s))
        @ grid.both(grid.as_down) @ rows.b1
    },
    "meridian strain without sign": lambda grid, rows: {
        "e1": rows.e1 - 2 * _node(grid, grid.profile.k1) @ grid.take[2]
    },
    "slope of v in the shear reversed": lambda grid, rows: {
        "g12": rows.g12 + 2 * _half(grid, lambda s: grid.profile.dr(s) / grid.profile.r(s))
        @ grid.both(grid.as_up) @ grid.take[1]
    },
    "rotations of Donnell": lambda grid, rows: _donnell(grid, rows),
}  # fmt: skip


def _node(grid, function):
    return grid.both(sparse.diags_array(function(grid.s_node)))


def _half(grid, function):
    return grid.both(sparse.diags_array(function(grid.s_half)))


def _donnell(grid, rows):
    """Curvature changes without the turn of the wall by tangential displacements, as in a shallow shell."""
    p, (u, v, _) = grid.profile, grid.take
    b1, b2 = _half(grid, p.k1) @ u, _node(grid, p.k2) @ v
    slope = (lambda s: p.dr(s) / p.r(s)), (lambda s: 1 / p.r(s))
    around_half = grid.both(sparse.diags_array(1 / p.r(grid.s_half)), grid.dt_up)
    return {
        "c1": rows.c1 - grid.both(grid.ds_down) @ b1,
        "c2": rows.c2
        - _node(grid, slope[1]) @ grid.both(None, grid.dt_down) @ b2
        - _node(grid, slope[0]) @ grid.both(grid.as_down) @ b1,
        "t12": rows.t12
        - _twist(grid, 1.0)
        - grid.both(grid.ds_up) @ b2
        + _half(grid, slope[0]) @ grid.both(grid.as_up) @ b2
        - around_half @ b1,
    }


def _twist(grid, factor):
    p, half, (u, v, _) = grid.profile, grid.s_half, grid.take
    scaled = [grid.both(sparse.diags_array(f)) for f in (
        factor * (p.k2(half) - p.k1(half)) / 2, p.dr(half) / p.r(half), 1 / p.r(half)
    )]  # fmt: skip
    shear = grid.both(grid.ds_up) @ v + scaled[1] @ grid.both(grid.as_up) @ v
    return scaled[0] @ (shear - grid.both(sparse.diags_array(1 / p.r(half)), grid.dt_up) @ u)


def strain_of_rigid_motions(n, m, mutant=None):
    grid = Grid(netting_profile(0.33, 0.265, 0.215, np.radians(38)), n, m, 0.0)
    rows = strain_rows(grid)
    changed = MUTANTS[mutant](grid, rows) if mutant else {}
    motions, largest = rigid_motions(grid), 0.0
    for name in ("e1", "e2", "g12", "c1", "c2", "t12"):
        strain = changed.get(name, getattr(rows, name)) @ motions
        inside = strain.reshape(-1, m, 6)[2:-2]
        largest = max(largest, float(np.abs(inside).max()))
    return largest


def test_rigid_motions_strain_nothing():
    coarse, fine = strain_of_rigid_motions(16, 29), strain_of_rigid_motions(32, 58)
    assert 1.9 < np.log2(coarse / fine) < 2.1


@pytest.mark.parametrize("mutant", MUTANTS)
def test_wrong_strains_are_seen_by_rigid_motions(mutant):
    coarse, fine = strain_of_rigid_motions(16, 29, mutant), strain_of_rigid_motions(32, 58, mutant)
    assert fine > 0.05 and np.log2(coarse / fine) < 0.6


def clamped_shape(x, lam):
    """1 + c1 cosh cos + c2 sinh sin about the middle, with w = w' = 0 at the ends."""

    def parts(y):
        c, s, ch, sh = np.cos(y), np.sin(y), np.cosh(y), np.sinh(y)
        return np.array([ch * c, sh * s]), np.array([sh * c - ch * s, ch * s + sh * c])

    ends = np.array(parts(lam * LENGTH / 2))
    c1, c2 = np.linalg.solve(ends, [-1.0, 0.0])
    shape, _ = parts(lam * (x - LENGTH / 2))
    y = lam * LENGTH / 2
    bend = 2 * lam**2 * (-c1 * np.sinh(y) * np.sin(y) + c2 * np.cosh(y) * np.cos(y))
    return 1 + c1 * shape[0] + c2 * shape[1], bend


def pressurised(n, poisson):
    wall = cylinder(n, poisson)
    q = wall.cells.linear_stiffness().factor().solve(PRESSURE * wall.volume.load)
    return wall, q


def test_a_clamped_cylinder_under_pressure_deflects_as_in_closed_form():
    a11 = MODULUS * H / (1 - 0.3**2)
    a12, d = 0.3 * a11, MODULUS * H**3 / 12 / (1 - 0.3**2)
    k = (a11 - a12**2 / a11) / R**2
    lam = (k / (4 * d)) ** 0.25
    fine = np.linspace(0, LENGTH, 20001)
    shape, bend = clamped_shape(fine, lam)
    w0 = PRESSURE / (k + a12**2 / (a11 * R**2) * np.trapezoid(shape, fine) / LENGTH)
    assert -d * w0 * bend == pytest.approx(-83.74871, rel=1e-5)
    errors, moments = [], []
    for n in (32, 64, 128):
        wall, q = pressurised(n, 0.3)
        w = wall.grid.fields(q)[2][:, 0]
        exact = w0 * clamped_shape(wall.grid.s_node, lam)[0]
        errors.append(np.abs(w - exact).max() / exact.max())
        moments.append(wall.cells.at_nodes(wall.cells.resultants(q, linear=True))[0, 3])
    assert errors[2] < 3e-3
    assert np.log2(errors[0] / errors[1]) > 1.9 and np.log2(errors[1] / errors[2]) > 1.9
    # The moment at the bead approaches its exact value with order 2 as well.
    left = np.array(moments) + 83.74871
    assert np.log2(left[1] / left[2]) == pytest.approx(2.0, abs=0.1) and left[2] < 0.5


@pytest.mark.parametrize(("share", "wanted"), [(0.8, 1.000151), (0.0, 1.043254), (-0.8, 1.354509)])
def test_a_prestressed_cylinder(share, wanted):
    """Without the geometric stiffness all three would be 1.0433."""
    wall = cylinder(256, 0.0)
    n1 = share * 2 * np.sqrt(MODULUS * H**3 / 12 * MODULUS * H / R**2)
    forces = np.zeros((wall.cells.area.size, 6))
    forces[:, 0] = n1
    stiffness = wall.cells.linear_stiffness() + wall.cells.geometric_stiffness(forces)
    w = wall.grid.fields(stiffness.factor().solve(PRESSURE * wall.volume.load))[2]
    assert w.max() / (PRESSURE * R**2 / (MODULUS * H)) == pytest.approx(wanted, rel=2e-3)


@pytest.fixture(scope="module")
def wall():
    return base_tire().wall(10, 12)


def test_the_tangent_is_the_derivative_of_the_gradient_and_that_of_the_energy(wall):
    rng = np.random.default_rng(0)
    q, direction = 2e-3 * rng.standard_normal((2, wall.grid.n_dof))
    gradient, band = wall.tangent(q, PRESSURE)
    assert gradient == pytest.approx(wall.gradient(q, PRESSURE), rel=1e-9, abs=1e-9 * np.abs(gradient).max())
    step = 1e-4
    change = (wall.gradient(q + step * direction, PRESSURE) - wall.gradient(q - step * direction, PRESSURE)) / (
        2 * step
    )
    product = band.matrix() @ direction
    assert np.abs(product - change).max() < 1e-7 * np.abs(change).max()
    power = (wall.energy(q + step * direction, PRESSURE) - wall.energy(q - step * direction, PRESSURE)) / (2 * step)
    assert gradient @ direction == pytest.approx(power, rel=1e-6)
    whole = band.matrix()
    assert abs(whole - whole.T).max() == 0.0


def test_a_translation_changes_no_pressure_force_inside():
    left = []
    for n, m in ((16, 24), (32, 48)):
        grid = Grid(netting_profile(0.33, 0.265, 0.215, np.radians(38)), n, m, 0.0)
        volume = EnclosedVolume.build(grid, strain_rows(grid))
        force = volume.curvature @ rigid_motions(grid)[:, :3]
        worst = 0.0
        for number, area in zip(grid.numbers, (grid.area_u, grid.area_v, grid.area_node), strict=True):
            inside = slice(3, number.shape[0] - 3)
            per_area = force[number[inside].ravel()] / area[inside].reshape(-1, 1)
            worst = max(worst, float(np.abs(per_area).max()))
        left.append(worst)
    assert np.log2(left[0] / left[1]) == pytest.approx(2.0, abs=0.15)


def test_strains_at_no_displacement_are_none(wall):
    assert not wall.cells.strains(np.zeros(wall.grid.n_dof)).any()
    assert wall.energy(np.zeros(wall.grid.n_dof), PRESSURE) == 0.0
