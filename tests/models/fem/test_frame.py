"""Frames: where nodes lie, what bodies share, and what ties and suppressions do."""

import numpy as np
import pytest
import scipy.linalg as la
from hypothesis import given
from hypothesis import strategies as st

from calib import InputError
from models.fem.frame import Frame
from models.fem.member import Member, Suppression, Tie
from models.fem.section import Section

FIXED = tuple(range(6))
SECTION = Section(area=6e-3, i_y=9e-6, i_z=2.3e-5, torsion=1.1e-5)


def member(body, group, start, end, size=10.0, **more):
    return Member(body, group, SECTION, start, end, size, **more)


def frequencies(frame, count=8):
    k, m = frame.beams()
    t = frame.dof_map().expansion
    squares = la.eigh((t.T @ k @ t).toarray(), (t.T @ m @ t).toarray(), eigvals_only=True)
    return np.sqrt(np.maximum(squares[:count], 0)) / (2 * np.pi)


def test_stations_hold_ends_and_places_and_keep_the_size():
    m = member("b", "g", (0, 0, 0), (2.0, 0, 0), 0.3, through=((0.5, 0, 0), (1.9, 0, 0), (2.0, 0, 0)))
    x = m.stations()[:, 0]
    assert np.all(np.diff(x) > 0)
    assert np.all(np.diff(x) <= 0.3 + 1e-9)
    for place in (0.0, 0.5, 1.9, 2.0):
        assert np.abs(x - place).min() < 1e-12
    # as few elements as the size allows: 2 + 5 + 1
    assert len(x) == 9


def test_stations_refuse_places_off_the_axis():
    for point in ((0.5, 0.01, 0), (2.1, 0, 0), (-0.1, 0, 0)):
        with pytest.raises(InputError, match="not on its axis"):
            member("b", "g", (0, 0, 0), (2.0, 0, 0), through=(point,)).stations()
    with pytest.raises(InputError, match="coincide"):
        member("b", "g", (1, 2, 3), (1, 2, 3)).stations()


coordinate = st.integers(-2_000_000, 2_000_000).map(lambda k: k * 1e-6)


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(coordinate, coordinate, coordinate))
def test_members_that_meet_share_their_node(corner, direction):
    if np.linalg.norm(direction) < 0.01 or np.linalg.norm(np.add(direction, (0.3, 0.4, 0.5))) < 0.01:
        return
    start = tuple(float(v) for v in np.subtract(corner, direction))
    third = tuple(float(v) for v in np.add(corner, (0.3, 0.4, 0.5)))
    up = tuple(np.eye(3)[int(np.argmin(np.abs(direction)))])
    frame = Frame((member("b", "g", start, corner, up=up), member("b", "g", corner, third, up=(1.0, 0.0, 0.0))))
    assert len(frame.points) == 3


def test_members_of_different_bodies_never_share_nodes():
    a, b = member("one", "g", (0, 0, 0), (1, 0, 0)), member("two", "g", (1, 0, 0), (2, 0, 0))
    frame = Frame((a, b))
    assert len(frame.points) == 4
    assert frame.node("one", (1, 0, 0)) != frame.node("two", (1, 0, 0))


def test_unknown_names_and_places_are_named():
    frame = Frame((member("one", "g", (0, 0, 0), (1, 0, 0)),))
    with pytest.raises(InputError, match="no body 'three'"):
        frame.node("three", (0, 0, 0))
    with pytest.raises(InputError, match="no node"):
        frame.node("one", (0.5, 0, 0))
    with pytest.raises(InputError, match="no group 'h'"):
        frame.group_nodes(["h"])
    with pytest.raises(InputError, match="no part 'h'"):
        frame.motion((0, 0, 0), "h")
    with pytest.raises(InputError, match="no group 'h'"):
        frame.beams(("h",))


def test_a_named_part_is_used_though_another_is_nearer():
    frame = Frame((member("one", "g", (0, 0, 0), (1, 0, 0)), member("two", "h", (0, 0, 1), (1, 0, 1))))
    near, distance = frame.motion((0.25, 0.0, 0.1))
    assert distance == pytest.approx(0.1)
    for name in ("two", "h"):
        far, distance = frame.motion((0.25, 0.0, 0.1), name)
        assert distance == pytest.approx(0.9)
        assert not np.any(far[:, :12]) and np.any(near[:, :12])


def test_groups_add_up():
    frame = Frame(
        (member("b", "g", (0, 0, 0), (1, 0, 0), 0.3), member("b", "h", (1, 0, 0), (1, 1, 0), 0.3, up=(1, 0, 0)))
    )
    for whole, one, other in zip(frame.beams(), frame.beams(("g",)), frame.beams(("h",)), strict=True):
        np.testing.assert_allclose((one + other).toarray(), whole.toarray(), atol=1e-12 * abs(whole).max())


def test_a_beam_cut_in_two_and_tied_is_whole_again():
    held = (Suppression(FIXED, body="one", point=(0.0, 0.0, 0.0)),)
    whole = Frame((member("one", "g", (0, 0, 0), (2, 0, 0), 0.25),), (), held)
    halves = (member("one", "g", (0, 0, 0), (1, 0, 0), 0.25), member("two", "g", (1, 0, 0), (2, 0, 0), 0.25))
    tied = Frame(halves, (Tie("one", "two", (1, 0, 0), FIXED),), held)
    assert tied.dof_map().n_dof == whole.dof_map().n_dof
    np.testing.assert_allclose(frequencies(tied, 12), frequencies(whole, 12), rtol=1e-9)


def test_a_tie_that_leaves_rotation_free_is_a_hinge():
    # Two halves of a pinned beam, hinged in the middle, fold: one motion without stiffness.
    halves = (member("one", "g", (0, 0, 0), (1, 0, 0), 0.25), member("two", "g", (1, 0, 0), (2, 0, 0), 0.25))
    pins = tuple(Suppression((0, 1, 2, 3), body=b, point=p) for b, p in (("one", (0, 0, 0)), ("two", (2, 0, 0))))
    for free, folds in (((), 0), ((5,), 1), ((4, 5), 2)):
        tie = Tie("one", "two", (1, 0, 0), tuple(d for d in FIXED if d not in free))
        found = frequencies(Frame(halves, (tie,), pins), 12)
        assert np.count_nonzero(found < 1e-3 * found[-1]) == folds


def test_ties_chain_and_suppression_reaches_all_who_share():
    lines = tuple(
        member(name, "g", (0, 0, 0), end) for name, end in (("a", (1, 0, 0)), ("b", (0, 0, 1)), ("c", (1, 0, 1)))
    )
    ties = (Tie("b", "c", (0, 0, 0), (0, 1)), Tie("a", "b", (0, 0, 0), (0, 1)))
    frame = Frame(lines, ties, (Suppression((1,), body="c", point=(0, 0, 0)),))
    dofs = frame.dof_map()
    nodes = [frame.node(name, (0, 0, 0)) for name in "abc"]
    expansion = dofs.expansion.toarray()
    rows = expansion[[6 * n for n in nodes]]
    assert np.all(rows == rows[0]) and rows[0].sum() == 1
    assert not expansion[[6 * n + 1 for n in nodes]].any()
    assert dofs.n_dof == frame.n_full - 2 - 3
    assert np.all(expansion.sum(axis=1) <= 1)


def test_degrees_of_freedom_are_named_after_a_motion_they_are():
    frame = Frame(
        (member("a", "g", (0, 0, 0), (1, 0, 0), 0.4), member("b", "g", (1, 0, 0), (2, 0, 0), 0.4)),
        (Tie("a", "b", (1, 0, 0), (0, 2, 4)),),
        (Suppression((3, 5), body="a", point=(0, 0, 0)),),
    )
    dofs = frame.dof_map()
    for j, (node, direction) in enumerate(zip(dofs.node, dofs.direction, strict=True)):
        unit = np.zeros(dofs.n_dof)
        unit[j] = 1.0
        assert (dofs.expansion @ unit)[6 * node + direction] == 1.0


def test_suppression_of_a_group_holds_every_node_of_it():
    frame = Frame(
        (member("b", "g", (0, 0, 0), (1, 0, 0), 0.3), member("b", "h", (1, 0, 0), (2, 0, 0), 0.3)),
        (),
        (Suppression((0, 2), groups=("g",)),),
    )
    moving = np.flatnonzero(np.asarray(abs(frame.dof_map().expansion).sum(axis=1)).ravel())
    nodes = frame.group_nodes(["g"])
    assert len(nodes) == 5
    assert not set(moving) & {6 * n + d for n in nodes for d in (0, 2)}
    assert len(moving) == frame.n_full - 2 * len(nodes)


def test_a_hinged_end_is_seen_by_points_beside_it():
    # A point on the beam follows the beam, not the node that the hinge lets turn alone.
    one = member("b", "g", (0, 0, 0), (1, 0, 0), released_end=(5,))
    frame = Frame((one,))
    full = np.zeros(12)
    full[11] = 1.0  # the node at the hinge turns: the beam stays at rest
    for x in (0.3, 0.7, 1.0 - 1e-9):
        np.testing.assert_allclose(frame.motion((x, 0, 0))[0] @ full, 0.0, atol=1e-9)


def test_a_reference_direction_along_the_beam_is_refused():
    with pytest.raises(InputError, match="up"):
        Frame((member("b", "g", (0, 0, 0), (0, 1, 0), up=(0.0, 1.0, 0.0)),)).beams()


@pytest.mark.parametrize("size", [-1.0, 0.0, np.nan, np.inf, 1e-9])
def test_an_element_length_that_makes_no_mesh_is_refused(size):
    with pytest.raises(InputError, match="largest element length"):
        Frame((member("a", "beam", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), size),))
