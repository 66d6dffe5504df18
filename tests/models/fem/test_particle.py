"""Particles: bodies of one node on springs."""

import numpy as np
import pytest
import scipy.sparse as sp

from calib import InputError
from calib.structure.eigenproblem.solve import solve_modes
from models.fem.discrete import PointMass, Spring, mass_matrix, spring_matrix
from models.fem.frame import Frame
from models.fem.member import Member, Particle, Suppression
from models.fem.panel import sheet_panel
from models.fem.section import Section
from models.fem.sheet import Sheet
from models.fem.structure import Structure

BAR = Member("bar", "bars", Section(6e-3, 9e-6, 2.3e-5, 1.1e-5), (0, 0, 0), (1, 0, 0), 0.5)
UPRIGHT = Suppression((0, 2, 3, 4, 5), groups=("seats",))


def seats(*places):
    return tuple(Particle(f"seat_{k}", "seats", p) for k, p in enumerate(places))


def test_a_mass_on_a_spring_to_the_ground_swings_as_the_root_of_stiffness_over_mass():
    frame = Frame((), (), (UPRIGHT,), seats((0, 0, 0), (3.0, 1.0, 0)))
    springs = [
        Spring((p.body, p.point), None, (0, 1, 0), weight=w) for p, w in zip(frame.particles, (1e3, 9e3), strict=True)
    ]
    masses = [PointMass((p.body, p.point), 10.0) for p in frame.particles]
    dofs = frame.dof_map()
    assert dofs.n_dof == 2 and np.array_equal(dofs.direction, [1, 1])
    k, m = (sp.csc_array(dofs.expansion.T @ a @ dofs.expansion)
            for a in (spring_matrix(frame, springs), mass_matrix(frame, masses)))  # fmt: skip
    freq = solve_modes(k, None, m, 2).natural_freq
    np.testing.assert_allclose(freq, np.sqrt([1e3 / 10, 9e3 / 10]) / (2 * np.pi))


def test_a_particle_shares_no_node_and_keeps_its_own_place():
    frame = Frame((BAR,), particles=seats((0.5, 0, 0), (2, 0, 0)))
    assert len(frame.points) == 3 + 2
    assert frame.node("seat_0", (0.5, 0, 0)) != frame.node("bar", (0.5, 0, 0))
    assert np.array_equal(frame.group_nodes(["seats"]), np.sort(frame.particle_nodes))
    assert {"seats", "seat_1"} <= frame.parts


def test_points_on_a_particle_follow_its_rigid_motion():
    frame = Frame((BAR,), particles=seats((2, 0, 0), (4, 0, 0)))
    rows, distance = frame.motion((4.0, 0.3, 0.1), "seats")
    assert distance == pytest.approx(np.hypot(0.3, 0.1))
    node = frame.node("seat_1", (4, 0, 0))
    motion = np.zeros(frame.n_full)
    motion[6 * node : 6 * node + 6] = shift = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(rows @ motion, [*(shift[:3] + np.cross(shift[3:], [0, 0.3, 0.1])), *shift[3:]])


def test_the_nearest_of_all_is_found_among_bars_walls_and_particles():
    panel = sheet_panel("wall", "walls", Sheet(0.01), [0.0, 1.0], [(0.0, 5.0), (1.0, 5.0)])
    structure = Structure((BAR,), particles=seats((0, 2, 0)), panels=(panel,))
    for point, body in (((0.5, 0.1, 0), "bar"), ((0.1, 1.9, 0), "seat_0"), ((0.5, 0.5, 4.9), "wall")):
        rows, distance = structure.motion(point)
        own = np.repeat([b == body for b in structure.bodies], 6)
        assert distance < 0.2 and np.any(rows[:, own]) and not np.any(rows[:, ~own])


def test_the_error_for_an_unknown_part_lists_particles_too():
    with pytest.raises(InputError, match="seat_0"):
        Frame((BAR,), particles=seats((0, 2, 0))).motion((0, 0, 0), "nowhere")
