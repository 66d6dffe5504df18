"""Beam stiffness against closed forms of statics."""

import numpy as np
import pytest

from calib import InputError
from models.fem import beam
from models.fem.frame import Frame
from models.fem.member import Member, Suppression
from models.fem.section import Section

CORNERS = ((0.0, 0.0, 0.0), (0.9, 0.2, -0.3), (1.1, 0.8, 0.4), (0.6, 1.5, 0.9))
UPS = ((0.3, 1.0, 0.2), (1.0, 0.1, 0.4), (0.2, 0.3, 1.0))


def chain(section: Section, size: float = 10.0) -> tuple[Member, ...]:
    """Three members that lie in no plane, each turned about its axis."""
    return tuple(Member("frame", f"m{i}", section, CORNERS[i], CORNERS[i + 1], size, up=up) for i, up in enumerate(UPS))


def load_at(frame, body, point, values):
    load = np.zeros(frame.n_full)
    node = frame.node(body, point)
    load[6 * node : 6 * node + 6] = values
    return load


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize(("direction", "inertia"), [(1, "i_z"), (2, "i_y")])
def test_cantilever_bends_and_shears(line, section, solve_static, n, direction, inertia):
    length, force = 2.0, 1234.0
    frame = line(n, length, start=range(6))
    load = np.zeros(6)
    load[direction] = force
    tip = solve_static(frame, load_at(frame, "beam", (length, 0, 0), load)).reshape(-1, 6)[-1]
    flexural = section.young_modulus * getattr(section, inertia)
    shear = section.shear_coefficient * section.shear_modulus * section.area
    assert tip[direction] == pytest.approx(force * length**3 / (3 * flexural) + force * length / shear, rel=1e-10)
    slope = tip[5] if direction == 1 else -tip[4]
    assert slope == pytest.approx(force * length**2 / (2 * flexural), rel=1e-10)


def test_cantilever_stretches_and_twists(line, section, solve_static):
    frame = line(4, 2.0, start=range(6))
    load = load_at(frame, "beam", (2.0, 0, 0), [1e5, 0, 0, 1e3, 0, 0])
    tip = solve_static(frame, load).reshape(-1, 6)[-1]
    assert tip[0] == pytest.approx(1e5 * 2.0 / (section.young_modulus * section.area), rel=1e-10)
    assert tip[3] == pytest.approx(1e3 * 2.0 / (section.shear_modulus * section.torsion), rel=1e-10)


def test_clamped_beam_with_settling_end(section):
    # End shear of a clamped-clamped beam whose end moves: 12 E I / (L^3 (1 + phi)) (Przemieniecki 1968).
    length = np.array([0.5])
    k = beam.stiffness(section, length)[0]
    shear = section.shear_coefficient * section.shear_modulus * section.area
    for d, inertia in ((1, section.i_z), (2, section.i_y)):
        compliance = length[0] ** 3 / (12 * section.young_modulus * inertia) + length[0] / shear
        assert k[d + 6, d + 6] == pytest.approx(1 / compliance, rel=1e-12)


@pytest.mark.parametrize("size", [10.0, 0.2])
def test_space_frame_is_exact_under_end_loads(section, exact, solve_static, size):
    members = chain(section, size)
    frame = Frame(members, (), (Suppression(tuple(range(6)), body="frame", point=CORNERS[0]),))
    load = np.array([300.0, -500.0, 200.0, 40.0, -70.0, 90.0])
    tip = solve_static(frame, load_at(frame, "frame", CORNERS[-1], load))
    node = frame.node("frame", CORNERS[-1])
    np.testing.assert_allclose(tip[6 * node : 6 * node + 6], exact(*members).tip_motion(load), rtol=1e-9)


def test_motion_between_nodes_is_that_of_a_finer_mesh(section, solve_static):
    # Without distributed load the shape functions are the exact solution, so that the coarsest mesh knows every point.
    load = np.array([300.0, -500.0, 200.0, 40.0, -70.0, 90.0])
    held = (Suppression(tuple(range(6)), body="frame", point=CORNERS[0]),)
    coarse, fine = (Frame(chain(section, size), (), held) for size in (10.0, 0.07))
    answer = [solve_static(f, load_at(f, "frame", CORNERS[-1], load)) for f in (coarse, fine)]
    expected = answer[1].reshape(-1, 6)
    largest = np.abs(expected).max(axis=0)
    for node, point in enumerate(fine.points):
        rows, distance = coarse.motion(point)
        assert distance < 1e-9
        np.testing.assert_allclose((rows @ answer[0] - expected[node]) / largest, 0.0, atol=1e-8)


def test_motion_off_the_axis_follows_a_rigid_arm(section, solve_static):
    frame = Frame(chain(section), (), (Suppression(tuple(range(6)), body="frame", point=CORNERS[0]),))
    full = solve_static(frame, load_at(frame, "frame", CORNERS[-1], [300.0, -500.0, 200.0, 40.0, -70.0, 90.0]))
    foot = np.array([0.45, 0.1, -0.15])  # middle of the first member
    arm = np.cross([0.9, 0.2, -0.3], [0.1, -0.4, 0.3])
    rows, distance = frame.motion(foot + arm, "m0")
    at_axis = frame.motion(foot, "m0")[0] @ full
    assert distance == pytest.approx(np.linalg.norm(arm), rel=1e-12)
    np.testing.assert_allclose((rows @ full)[:3], at_axis[:3] + np.cross(at_axis[3:], arm), rtol=1e-12)
    np.testing.assert_allclose((rows @ full)[3:], at_axis[3:], rtol=1e-12)


@pytest.mark.parametrize("phi", [0.0, 0.3, 40.0])
def test_shape_functions_hold_end_motions_and_rigid_motion(phi):
    length = 0.7
    for xi, place in ((0.0, 0), (1.0, 2)):
        deflection, rotation = beam.bending_shape(np.array(xi), np.array(length), np.array(phi))
        np.testing.assert_allclose(deflection, np.eye(4)[place], atol=1e-14)
        np.testing.assert_allclose(rotation, np.eye(4)[place + 1], atol=1e-14)
    xi = np.linspace(0, 1, 7)
    deflection, rotation = beam.bending_shape(xi, np.array(length), np.array(phi))
    turning = np.array([0, 1, length, 1])
    np.testing.assert_allclose(deflection @ turning, length * xi, atol=1e-14)
    np.testing.assert_allclose(rotation @ turning, 1.0, atol=1e-14)


def test_shape_functions_balance_moment_and_shear(section):
    # Static Timoshenko beam without load: E I theta'' + k G A (w' - theta) = 0 (from the equilibrium of a slice).
    length, h = 0.4, 1e-4
    xi = np.linspace(0.1, 0.9, 5)
    phi = beam.shear_ratio(section, np.array([length]))[0][0]
    values = [beam.bending_shape(xi + d * h, np.array(length), np.array(phi)) for d in (-1, 0, 1)]
    slope = (values[2][0] - values[0][0]) / (2 * h * length)
    curvature_change = (values[2][1] - 2 * values[1][1] + values[0][1]) / (h * length) ** 2
    shear = section.shear_coefficient * section.shear_modulus * section.area
    moment = section.young_modulus * section.i_z * curvature_change
    np.testing.assert_allclose(moment + shear * (slope - values[1][1]), 0.0, atol=1e-4 * np.abs(moment).max())


@pytest.mark.parametrize("name", ["area", "i_y", "i_z", "torsion", "young_modulus", "shear_coefficient"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_section_refuses_what_no_beam_has(name, value):
    numbers = {"area": 1.0, "i_y": 1.0, "i_z": 1.0, "torsion": 1.0, name: value}
    with pytest.raises(InputError, match=name):
        Section(**numbers)
    with pytest.raises(InputError, match="density"):
        Section(1.0, 1.0, 1.0, 1.0, density=-1.0)
