"""Rigid motions strain nothing and show the mass, its centre and its inertia."""

import numpy as np
import pytest
import scipy.linalg as la

from models.fem import beam
from models.fem.frame import Frame
from models.fem.member import Member


def random_member(seed, section, arm=(0.0, 0.0, 0.0), size=0.4, shift=(0.0, 0.0, 0.0)):
    rng = np.random.default_rng(seed)
    start, end, up = rng.standard_normal((3, 3))
    start, end = start + shift, end + shift
    return Member("beam", "all", section, tuple(start), tuple(end), size, up=tuple(up), arm=arm)


def arms(seed):
    return tuple(float(v) for v in np.random.default_rng(100 + seed).uniform(-0.5, 0.5, 3)) if seed else (0.0, 0.0, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_rigid_motion_strains_no_beam(section, rigid, seed):
    frame = Frame((random_member(seed, section, arms(seed)),))
    k = frame.beams()[0]
    np.testing.assert_allclose(k @ rigid(frame.points), 0.0, atol=1e-11 * abs(k).max())


@pytest.mark.parametrize("seed", range(4))
def test_six_zero_eigenvalues_in_any_orientation(section, seed):
    frame = Frame((random_member(seed, section, arms(seed)),))
    k, m = (matrix.toarray() for matrix in frame.beams())
    squares = la.eigh(k, m, eigvals_only=True)
    assert np.all(np.abs(squares[:6]) < 1e-9 * squares[6])
    assert squares[6] > 0


@pytest.mark.parametrize("seed", range(4))
def test_mass_matrix_holds_mass_centre_and_inertia(section, rigid, seed):
    member = random_member(seed, section, arms(seed))
    frame = Frame((member,))
    r = rigid(frame.points)
    found = r.T @ frame.beams()[1] @ r

    a, b = np.add(member.start, member.arm), np.add(member.end, member.arm)
    length = np.linalg.norm(b - a)
    x = (b - a) / length
    y = np.array(member.up) - (np.array(member.up) @ x) * x
    y /= np.linalg.norm(y)
    z = np.cross(x, y)
    total, centre = section.density * section.area * length, (a + b) / 2
    slice_inertia = section.i_y * np.outer(y, y) + section.i_z * np.outer(z, z)
    slice_inertia += (section.i_y + section.i_z) * np.outer(x, x)
    rod = total * length**2 / 12 * (np.eye(3) - np.outer(x, x)) + section.density * length * slice_inertia
    about_origin = rod + total * (centre @ centre * np.eye(3) - np.outer(centre, centre))

    scale = total * (1 + centre @ centre)
    np.testing.assert_allclose(found[:3, :3], total * np.eye(3), atol=1e-11 * scale)
    for d in range(3):  # u = theta x r, so the first moment shows as total * (e_d x centre)
        np.testing.assert_allclose(found[:3, 3 + d], total * np.cross(np.eye(3)[d], centre), atol=1e-11 * scale)
    np.testing.assert_allclose(found[3:, 3:], about_origin, atol=1e-11 * scale)


@pytest.mark.parametrize("distributed", [True, False])
def test_added_mass_weighs_its_length(section, rigid, distributed):
    frame = Frame((random_member(3, section, arms(3)), random_member(4, section)))
    r = rigid(frame.points)
    found = r.T @ frame.added_mass(("all",), distributed) @ r
    parts = []
    for m in frame.members:
        a, b = np.add(m.start, m.arm), np.add(m.end, m.arm)
        parts.append((np.linalg.norm(b - a), (a + b) / 2, b - a))
    total = sum(length for length, _, _ in parts)
    centre = sum(length * middle for length, middle, _ in parts) / total
    np.testing.assert_allclose(found[:3, :3], total * np.eye(3), atol=1e-12 * total)
    for d in range(3):
        np.testing.assert_allclose(found[:3, 3 + d], total * np.cross(np.eye(3)[d], centre), atol=1e-11 * total)
    inertia = np.zeros((3, 3))
    for length, middle, span in parts:
        inertia += length * (middle @ middle * np.eye(3) - np.outer(middle, middle))
        inertia += length / 12 * (span @ span * np.eye(3) - np.outer(span, span))
    if distributed:
        np.testing.assert_allclose(found[3:, 3:], inertia, atol=1e-11 * total)
    else:  # halves at the ends of elements lie further out: by L h^2 / 6 instead of L h^2 / 12 for every element
        assert np.all(np.linalg.eigvalsh(found[3:, 3:] - inertia) > -1e-12 * total)
        longest = max(np.linalg.norm(np.diff(frame.points[e], axis=0)) for e in frame.ends)
        assert np.trace(found[3:, 3:] - inertia) < 2 * total * longest**2 / 6


@pytest.mark.parametrize("seed", [1, 2])
def test_arm_is_a_rigid_shift_of_the_axis(section, seed):
    arm = arms(seed)
    on_nodes = Frame((random_member(seed, section, arm),))
    on_axis = Frame((random_member(seed, section, shift=arm),))
    n = len(on_axis.points)
    assert len(on_nodes.points) == n
    one = np.eye(6)
    for d in range(3):
        one[:3, 3 + d] = np.cross(np.eye(3)[d], arm)
    t = np.kron(np.eye(n), one)
    for here, there in zip(on_nodes.beams(), on_axis.beams(), strict=True):
        np.testing.assert_allclose(here.toarray(), t.T @ there @ t, atol=1e-11 * abs(here).max())
    a, b = ([m.toarray() for m in f.beams()] for f in (on_nodes, on_axis))
    np.testing.assert_allclose(la.eigh(*a, eigvals_only=True)[6:30], la.eigh(*b, eigvals_only=True)[6:30], rtol=1e-7)
    point = (0.3, -0.2, 0.5)
    rows = [f.motion(point) for f in (on_nodes, on_axis)]
    assert rows[0][1] == pytest.approx(rows[1][1], rel=1e-12)
    np.testing.assert_allclose(rows[0][0], rows[1][0] @ t, atol=1e-12)


def test_arm_matrix_is_a_cross_product():
    rng = np.random.default_rng(0)
    theta, arm = rng.standard_normal((2, 3))
    np.testing.assert_allclose(beam.arm_matrix(arm) @ theta, np.cross(theta, arm), rtol=1e-13)


def test_every_point_follows_a_rigid_motion(section, rigid):
    frame = Frame((random_member(5, section, arms(5)), random_member(6, section)))
    r = rigid(frame.points)
    for point in np.random.default_rng(1).uniform(-2, 2, (20, 3)):
        rows, _ = frame.motion(point)
        np.testing.assert_allclose(rows @ r, rigid(point[None, :]), atol=1e-11)


def test_matrices_are_symmetric_and_never_negative(section):
    for matrix in Frame((random_member(7, section, arms(7)),)).beams():
        dense = matrix.toarray()
        np.testing.assert_allclose(dense, dense.T, atol=1e-12 * np.abs(dense).max())
        assert np.linalg.eigvalsh(dense).min() > -1e-9 * np.abs(dense).max()
