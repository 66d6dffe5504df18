"""A tire on the ground without stress, under a pressure that does not follow, or pushed along its normal."""

from dataclasses import replace

import numpy as np
import pytest

from models.tire import base_tire
from models.tire.contact import Ground
from models.tire.inflated import inflate
from models.tire.load_curve import load_curve

DEFLECTION = 12.5e-3
MESH = 29, 16


def without_geometric_stiffness(wall):
    """A wall whose rotations stretch nothing: linear, so that it has no memory of its stress."""
    rows = wall.cells.rows.copy()
    rows[:, 6:] = 0.0
    return replace(wall, cells=replace(wall.cells, rows=rows))


def without_pressure_stiffness(wall):
    """A wall under a dead pressure, which keeps direction and area of the undeformed wall."""
    return replace(wall, volume=replace(wall.volume, curvature=0 * wall.volume.curvature))


def linear(wall):
    return without_pressure_stiffness(without_geometric_stiffness(wall))


def unchanged(wall):
    return wall


def pressed(change, pressure, mesh=MESH):
    tire = base_tire()
    wall, strip = change(tire.wall(*mesh)), change(tire.wall(mesh[0], 1))
    ground = Ground(inflate(wall, strip, pressure))
    return load_curve(ground, np.array([DEFLECTION])).complete().last


def centre(step):
    return float(step.pressure[np.argmax(step.ground.rest)])


@pytest.fixture(scope="module")
def right():
    return pressed(unchanged, 2e5)


def test_walls_without_stress_stiffness_or_under_dead_pressure_are_told_apart(right):
    dead, none = pressed(without_pressure_stiffness, 2e5), pressed(linear, 2e5)
    assert none.load < 0.3 * right.load and centre(none) < 0.3 * 2e5  # it hardly feels the pressure
    assert dead.load == pytest.approx(0.86 * right.load, rel=0.02)
    assert centre(right) == pytest.approx(2e5, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "loads"),
    [(unchanged, (806, 1303, 1763)), (without_pressure_stiffness, (None, 1127, None)), (linear, (357, 350, 345))],
)
def test_loads_of_right_and_wrong_walls_are_those_of_an_independent_prototype(change, loads):
    """The wrong trend of a linear wall is its own as well: more pressure, less load."""
    found = [pressed(change, p, (41, 24)).load for p, load in zip((1e5, 2e5, 3e5), loads, strict=True) if load]
    assert found == pytest.approx([load for load in loads if load], rel=5e-3)


def solved(ground, along, start, level, steps=30):
    """Equilibrium with nodes held above a level by forces along other rows than those of the gap."""
    wall, p = ground.inflated.wall, ground.inflated.pressure
    q, force = start.displacement, start.force
    active = force > 0.0
    for _ in range(steps):
        gradient, band = wall.tangent(q, p)
        factor = band.factor()
        shift = factor.solve(along[active].T.toarray(order="F"))
        free = factor.solve(-gradient)
        intrusion = ground.rest + ground.rows @ (q + free) - level
        force = np.zeros(active.size)
        force[active] = np.linalg.solve(ground.rows[active] @ shift, intrusion[active])
        change = free - shift @ force[active]
        q = q + change
        was, active = active, np.where(active, force > 0.0, intrusion - ground.rows @ (shift @ force[active]) > 1e-12)
        if np.abs(change).max() < 1e-12 and (was == active).all():
            return q, force
    raise AssertionError("no equilibrium")


@pytest.mark.parametrize("along_normal", [False, True])
def test_forces_along_the_normal_of_the_wall_are_not_the_derivative_of_the_energy(right, along_normal):
    """Such forces, under a vertical gap, change the load by a percent only: the energy shows them."""
    ground, wall = right.ground, right.ground.inflated.wall
    grid = wall.grid
    upright = np.cos(grid.theta_node[ground.nodes % grid.n_hoop])
    if along_normal:
        upright = upright * grid.profile.dz(grid.s_node)[ground.nodes // grid.n_hoop]
        along = grid.take[2][ground.nodes]
    else:
        upright, along = np.ones(ground.nodes.size), ground.rows
    step, level = 1e-5, right.loaded_radius
    middle, low, high = (solved(ground, along, right, level + x) for x in (0.0, step, -step))
    load = float(middle[1] @ upright)
    power = (wall.energy(high[0], 2e5) - wall.energy(low[0], 2e5)) / (2 * step)
    mismatch = abs(power / load - 1)
    assert load == pytest.approx(right.load, rel=0.03 if along_normal else 1e-8)
    assert mismatch > 3e-3 if along_normal else mismatch < 1e-6


@pytest.mark.slow
def test_one_step_and_38_lead_to_the_same_load():
    ground = base_tire().on_ground(2e5, *MESH)
    once = load_curve(ground, np.array([DEFLECTION])).last
    many = load_curve(ground, np.linspace(0.0, DEFLECTION, 39)[1:]).complete()
    assert len(many.steps) == 38 and (np.diff(many.loads) > 0).all()
    assert many.last.load == pytest.approx(once.load, rel=1e-8)
    assert np.abs(many.last.displacement - once.displacement).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("deflection", [4e-3, 15e-3])
def test_force_or_gap_vanishes_everywhere_on_a_fine_mesh(deflection):
    step = load_curve(base_tire().on_ground(2e5, 41, 24), np.array([deflection])).complete().last
    assert (step.force >= 0.0).all() and step.gap.min() > -1e-9
    assert np.abs(step.gap[step.force > 0.0]).max() < 1e-9
