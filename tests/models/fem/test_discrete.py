"""Springs, dampers and point masses: elongation, inertia and refused input."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from calib import InputError, ParameterSpace, Sensor, StructuralModel
from calib.structure import AffineMatrix, Term
from calib.structure.eigenproblem.solve import solve_modes
from models.fem.discrete import FrameLocator, PointMass, Spring, mass_matrix, rod, spring_matrix
from models.fem.frame import Frame
from models.fem.member import Member, Suppression
from models.fem.section import Section

FIXED = tuple(range(6))
SECTION = Section(area=6e-3, i_y=9e-6, i_z=2.3e-5, torsion=1.1e-5)
MASSLESS = Section(area=6e-3, i_y=9e-6, i_z=2.3e-5, torsion=1.1e-5, density=0.0)


def two_bars(section=SECTION):
    return Frame(
        (
            Member("one", "g", section, (0, 0, 0), (1, 0, 0), 0.4),
            Member("two", "h", section, (0.2, 0.5, 1), (1.3, 0.4, 0.8), 0.4),
        )
    )


def rigid_motions(points):
    out = np.zeros((6 * len(points), 6))
    for i, p in enumerate(points):
        out[6 * i : 6 * i + 6] = np.eye(6)
        for d in range(3):
            out[6 * i : 6 * i + 3, 3 + d] = np.cross(np.eye(3)[d], p)
    return out


number = st.floats(-2.0, 2.0)
point = st.tuples(number, number, number)


@given(point, st.sampled_from(np.eye(3).tolist()), st.floats(-1.0, 1.0), st.booleans())
def test_rigid_motion_of_both_bodies_strains_no_spring(place, direction, gap, rotational):
    frame = two_bars()
    other = tuple(float(v) for v in np.add(place, np.multiply(gap, direction)))
    row = Spring(("one", place), ("two", other), tuple(direction), rotational=rotational).row(frame)
    assert np.any(row)
    np.testing.assert_allclose(row @ rigid_motions(frame.points), 0.0, atol=1e-10)


@given(point, point)
def test_rigid_motion_strains_no_rod(a, b):
    if np.linalg.norm(np.subtract(a, b)) < 1e-3:
        return
    frame = two_bars()
    np.testing.assert_allclose(rod(("one", a), ("two", b)).row(frame) @ rigid_motions(frame.points), 0.0, atol=1e-9)


@given(point, point)
def test_a_rod_feels_the_change_of_its_length(a, b):
    distance = np.linalg.norm(np.subtract(a, b))
    if distance < 0.1:
        return
    frame = two_bars()
    full = 1e-7 * np.random.default_rng(0).standard_normal(frame.n_full)
    new_a, new_b = a + (frame.motion(a, "one")[0] @ full)[:3], b + (frame.motion(b, "two")[0] @ full)[:3]
    stretch = np.linalg.norm(new_a - new_b) - distance
    assert rod(("one", a), ("two", b)).row(frame) @ full == pytest.approx(stretch, abs=1e-10)


def test_springs_off_their_line_are_refused():
    frame = two_bars()
    with pytest.raises(InputError, match="not in line"):
        Spring(("one", (0, 0, 0)), ("two", (0.0, 1.0, 0.001)), (0, 1, 0)).row(frame)
    Spring(("one", (0, 0, 0)), ("two", (0.0, 1.0, 0.001)), (0, 1, 0), rotational=True).row(frame)
    with pytest.raises(InputError, match="zero"):
        Spring(("one", (0, 0, 0)), None, (0, 0, 0)).row(frame)
    with pytest.raises(InputError, match="zero"):
        rod(("one", (0, 0, 0)), ("two", (0, 0, 0))).row(frame)
    with pytest.raises(InputError, match="no part"):
        Spring(("three", (0, 0, 0)), None, (0, 1, 0)).row(frame)


def test_matrix_of_springs_is_their_energy():
    frame = two_bars()
    springs = (
        Spring(("one", (0.3, 0.2, 0.1)), None, (1, 2, 0), weight=3.0),
        rod(("one", (0.3, 0.2, 0.1)), ("two", (1.0, 1.0, 1.0)), weight=0.5),
        Spring(("one", (0.3, 0.0, 0.0)), ("two", (0.9, 0.1, 0.7)), (0, 0, 5.0), rotational=True),
    )
    k = spring_matrix(frame, springs)
    full = np.random.default_rng(1).standard_normal(frame.n_full)
    energy = sum(s.weight * (s.row(frame) @ full) ** 2 for s in springs)
    assert full @ (k @ full) == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(k.toarray(), k.toarray().T, atol=1e-12)
    # the length of a direction is no part of the value
    a, b = (Spring(("one", (0.3, 0.2, 0.1)), None, (0, s, 0)).row(frame) for s in (1.0, 7.0))
    np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.7, 0.99])
def test_oscillator_on_spring_and_damper(ratio):
    mass, stiffness = 120.0, 4.7e5
    held = Suppression((0, 2, 3, 4, 5), groups=("g",))
    bar = Frame((Member("one", "g", MASSLESS, (0, 0, 0), (1, 0, 0), 1.0),), (), (held,))
    t = bar.dof_map().expansion
    upright = Spring(("one", (0.5, 0, 0)), None, (0, 1, 0))
    square = (t.T @ spring_matrix(bar, (upright,)) @ t).tocsc()
    k = (t.T @ bar.beams()[0] @ t).tocsc() + stiffness * square
    m = (t.T @ mass_matrix(bar, (PointMass(("one", (0.5, 0, 0)), mass),)) @ t).tocsc()
    damping = 2 * ratio * np.sqrt(mass * stiffness)
    modes = solve_modes(sp.csc_array(k), sp.csc_array(damping * square), sp.csc_array(m), 1)
    natural = np.sqrt(stiffness / mass) / (2 * np.pi)
    assert modes.natural_freq[0] == pytest.approx(natural, rel=1e-9)
    assert modes.damping_ratio[0] == pytest.approx(ratio, abs=1e-9)
    assert modes.damped_freq[0] == pytest.approx(natural * np.sqrt(1 - ratio**2), rel=1e-7)


@given(point)
def test_point_mass_on_an_arm_obeys_the_parallel_axis_theorem(place):
    frame = two_bars()
    inertia = (3.0, 5.0, 7.0)
    r = rigid_motions(frame.points)
    found = r.T @ mass_matrix(frame, (PointMass(("one", place), 11.0, inertia),)) @ r
    p = np.array(place)
    np.testing.assert_allclose(found[:3, :3], 11.0 * np.eye(3), atol=1e-9)
    about = np.diag(inertia) + 11.0 * (p @ p * np.eye(3) - np.outer(p, p))
    np.testing.assert_allclose(found[3:, 3:], about, atol=1e-9)
    for d in range(3):
        np.testing.assert_allclose(found[:3, 3 + d], 11.0 * np.cross(np.eye(3)[d], p), atol=1e-9)


def test_spread_keeps_mass_and_centre_and_adds_its_own_inertia():
    frame = two_bars()
    offsets = tuple((0.0, 0.0, float(z)) for z in np.linspace(-0.3, 0.3, 7))
    r = rigid_motions(frame.points)
    at = ("one", (0.4, 0.1, -0.2))
    lumped, spread = (
        r.T @ mass_matrix(frame, (PointMass(at, 11.0, (3.0, 5.0, 7.0), spread=s),)) @ r
        for s in (((0.0, 0.0, 0.0),), offsets)
    )
    np.testing.assert_allclose(spread[:3], lumped[:3], atol=1e-11)
    square = 11.0 * np.mean([o[2] ** 2 for o in offsets])
    np.testing.assert_allclose(spread[3:, 3:] - lumped[3:, 3:], np.diag([square, square, 0.0]), atol=1e-11)


def test_masses_add_up_and_none_is_nothing():
    frame = two_bars()
    a, b = PointMass(("one", (0, 1, 0)), 2.0), PointMass(("two", (0.5, 0, 0)), 3.0, (1.0, 1.0, 1.0))
    both, alone = mass_matrix(frame, (a, b)), [mass_matrix(frame, (x,)) for x in (a, b)]
    np.testing.assert_allclose(both.toarray(), (alone[0] + alone[1]).toarray(), atol=1e-13)
    nothing = mass_matrix(frame, ())
    assert nothing.shape == (frame.n_full, frame.n_full) and nothing.nnz == 0


def test_locator_rows_are_over_the_free_motions():
    members = two_bars().members
    frame = Frame(members, (), (Suppression(FIXED, body="one", point=(0, 0, 0)), Suppression((1,), groups=("h",))))
    dofs = frame.dof_map()
    locator = FrameLocator(frame, dofs.expansion)
    rng = np.random.default_rng(2)
    q = rng.standard_normal(dofs.n_dof)
    for place in rng.uniform(-1, 2, (5, 3)):
        rows, distance = frame.motion(place, "two")
        for direction in range(6):
            row, d = locator.row(place, direction, "two")
            assert d == distance
            assert row @ q == pytest.approx(rows[direction] @ (dofs.expansion @ q), abs=1e-12)


def test_a_sensor_on_a_suppressed_motion_of_an_inclined_beam_is_refused():
    frame = Frame(two_bars().members[1:], (), (Suppression((1,), groups=("h",)),))
    dofs = frame.dof_map()
    t = dofs.expansion
    k, m = (sp.csr_array(t.T @ matrix @ t) for matrix in frame.beams())
    model = StructuralModel(
        name="inclined bar",
        space=ParameterSpace(()),
        stiffness=AffineMatrix(dofs.n_dof, (Term("k", k),)),
        damping=AffineMatrix(dofs.n_dof, ()),
        mass=AffineMatrix(dofs.n_dof, (Term("m", m),)),
        mesh=frame.mesh(),
        dofs=dofs,
        clusters={},
        locator=FrameLocator(frame, t),
    )
    start = (0.2, 0.5, 1.0)
    across = Sensor(1, "x", start)
    assert np.any(model.sensor_rows((across,)))
    with pytest.raises(InputError, match="suppresses"):
        model.sensor_rows((across, Sensor(1, "y", start)))
    with pytest.raises(InputError, match="off the model"):
        model.sensor_rows((Sensor(1, "x", (0.2, 5.0, 1.0)),))
