"""Supports and ends of beams in matrices that name none: where they are, and what a flexibility in series does."""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.errors.errors import InputError
from calib.measurement.modal import DIRECTIONS
from calib.structure import hung_masses, softened_joint
from calib.structure.effects.composition import Names
from calib.structure.effects.extend import extend
from calib.structure.effects.part_compositions import of_rigid_joints
from calib.structure.effects.rigid_joints import member_ends, supports
from models.fem import beam, thin_plate
from models.fem.nodes import assemble
from models.fem.section import Section

EXPORTS = Path(__file__).parents[1] / "imports" / "exports"
SECTION = Section(area=4e-3, i_y=3e-6, i_z=8e-6, torsion=5e-6)
LEG, SPAN, CELLS = 2.0, 3.0, 4
FEET = ((0.0, 0.0, 0.0), (SPAN, 0.0, 0.0))


def portal():
    """Points of a portal of two columns and a beam, and its stiffness and mass with free feet, the first two nodes."""
    corners = [np.array(p) for p in (FEET[0], (0.0, 0.0, LEG), (SPAN, 0.0, LEG), FEET[1])]
    points = [corners[0], corners[3]]
    chain = [0]
    for a, b in itertools.pairwise(corners):
        for k in range(1, CELLS + 1):
            last = k == CELLS and b is corners[3]
            chain.append(1 if last else len(points))
            points += [] if last else [a + (b - a) * k / CELLS]
    points, pairs = np.array(points), np.array(list(itertools.pairwise(chain)))
    length, axes = beam.axes(points[pairs[:, 0]], points[pairs[:, 1]], np.array([[0.0, 1.0, 0.0]]))
    arms = np.zeros((len(pairs), 2, 3))
    k, m = (beam.to_global(of(SECTION, length), axes, arms) for of in (beam.stiffness, beam.mass))
    return points, *(assemble(pairs, blocks, 6 * len(points)).toarray() for blocks in (k, m))


POINTS, STIFFNESS, MASS = portal()
ROWS = [(n + 1, d, *p) for n, p in enumerate(POINTS.tolist()) for d in DIRECTIONS]


def held(suppressed, factor=1.0):
    """The model without some rows, its stiffness scaled by a parameter."""
    free = [k for k in range(len(ROWS)) if k not in suppressed]
    return free, calib.StructuralModel.from_matrices(
        {"K": (factor * STIFFNESS[np.ix_(free, free)], "stiffness")}, MASS[np.ix_(free, free)],
        dofs=pd.DataFrame([ROWS[k] for k in free], columns=["node", "direction", "x", "y", "z"]),
        parameters=[calib.Parameter("stiffness", 1 / factor, 0.1 / factor, 3.0 / factor)], name="portal",
    )  # fmt: skip


def test_clamped_feet_are_found_where_they_are_although_their_rows_are_gone():
    _, model = held(range(12))
    found = sorted(supports(model, {}), key=lambda one: one.place)
    assert len(found) == 2 and all(one.directions == (0, 1, 2, 3, 4, 5) for one in found)
    np.testing.assert_allclose([one.place for one in found], FEET, atol=1e-6)


def test_the_free_rotations_of_pinned_feet_are_not_resisted():
    _, model = held([*range(3), *range(6, 9)])
    found = sorted(supports(model, {}), key=lambda one: one.place)
    assert [one.directions for one in found] == [(0, 1, 2)] * 2
    np.testing.assert_allclose([one.place for one in found], FEET, atol=1e-9)


def test_rows_of_the_code_s_own_do_not_hide_the_clamped_face_of_a_solid():
    """Eight-node solids of CalculiX with incompatible modes, clamped at x = 0; 60 by 10 by 5 mm."""
    found = calib.import_matrices(EXPORTS / "solid.sti", units="mm-t-N")
    (face,) = supports(found.model, {})
    assert sorted(found.model.labels[n] for n in face.nodes) == [5, 6, 7, 8]
    np.testing.assert_allclose(face.place, (0.0, 0.005, 0.0025), atol=2e-3)
    assert face.directions == (0, 1, 2, 3, 4, 5)


def test_a_free_structure_and_one_that_is_not_placed_have_none():
    _, model = held([])
    assert not list(supports(model, {}))
    rows = pd.DataFrame([row[:2] for row in ROWS], columns=["node", "direction"])
    assert not list(supports(calib.StructuralModel.from_matrices(STIFFNESS, MASS, dofs=rows), {}))


@pytest.mark.parametrize("direction", range(6))
@pytest.mark.parametrize("stiffness", [1.0, 0.6])
def test_a_soft_support_is_a_spring_under_a_foot_that_moves(direction, stiffness):
    """Condensed of the stiffness with the foot free in that direction, on a spring to the ground."""
    free, model = held(range(12), factor=2.0)
    soft = {"f": 2e-8 if direction < 3 else 4e-6}
    built = softened_joint(model, [FEET[1]], direction, "f")
    foot = 6 + direction
    whole = stiffness * STIFFNESS
    column, own = whole[free, foot], whole[foot, foot] + 1 / soft["f"]
    exact = whole[np.ix_(free, free)] - np.outer(column, column) / own
    si = {"stiffness": stiffness / 2.0, **soft}
    (term,) = built.stiffness
    changed = model.stiffness(si).toarray() + term.coefficient(si) * term.matrix.toarray()
    np.testing.assert_allclose(changed, exact, atol=1e-7 * np.abs(exact).max())
    assert np.abs(changed - whole[np.ix_(free, free)]).max() > 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("stiffness", [1.0, 0.6])
def test_a_support_that_is_soft_in_all_directions_stands_on_springs_in_proportion_to_its_stiffness(stiffness):
    free, model = held(range(12), factor=2.0)
    (term,) = softened_joint(model, [FEET[1]], None, "f").stiffness
    whole, foot = stiffness * STIFFNESS, list(range(6, 12))
    column, own = whole[np.ix_(free, foot)], whole[np.ix_(foot, foot)]
    exact = whole[np.ix_(free, free)] - column @ np.linalg.solve(own + own / 0.4, column.T)
    si = {"stiffness": stiffness / 2.0, "f": 0.4}
    changed = model.stiffness(si).toarray() + term.coefficient(si) * term.matrix.toarray()
    np.testing.assert_allclose(changed, exact, atol=1e-7 * np.abs(exact).max())


def test_ends_of_beams_are_found_where_they_meet_at_an_angle():
    """At both upper corners; nodes within a member go on straight, and a foot has no other beam."""
    _, model = held(range(12))
    found = list(member_ends(model, {}))
    assert sorted(one.place for one in found) == [(0.0, 0.0, LEG), (SPAN, 0.0, LEG)]
    assert all(one.directions == (3, 4, 5) for one in found)


@pytest.mark.parametrize("direction", [3, 4, 5])
def test_a_soft_joint_is_a_spring_between_a_beam_s_end_and_its_node(direction):
    """The end's rotation apart from that of the node, a spring between both, and condensed."""
    flexibility, n = 4e-6, len(STIFFNESS)
    free, model = held(range(12))
    joint = next(iter(member_ends(model, {})))
    node, other = (model.labels[k] - 1 for k in joint.nodes)
    length, axes = beam.axes(POINTS[[node]], POINTS[[other]], np.array([[0.0, 1.0, 0.0]]))
    own = beam.to_global(beam.stiffness(SECTION, length), axes, np.zeros((1, 2, 3)))[0]
    dofs = [*range(6 * node, 6 * node + 6), *range(6 * other, 6 * other + 6)]
    whole = np.pad(STIFFNESS, (0, 1))
    whole[np.ix_(dofs, dofs)] -= own
    apart = [n if k == 6 * node + direction else k for k in dofs]
    whole[np.ix_(apart, apart)] += own
    spring = np.zeros(n + 1)
    spring[[n, 6 * node + direction]] = 1.0, -1.0
    whole += np.outer(spring, spring) / flexibility
    exact = whole[np.ix_(free, free)] - np.outer(whole[free, n], whole[n, free]) / whole[n, n]
    (term,) = softened_joint(model, [POINTS[node], POINTS[other]], direction, "f").stiffness
    si = {"stiffness": 1.0, "f": flexibility}
    changed = model.stiffness(si).toarray() + term.coefficient(si) * term.matrix.toarray()
    np.testing.assert_allclose(changed, exact, atol=1e-7 * np.abs(exact).max())
    assert np.abs(changed - STIFFNESS[np.ix_(free, free)]).max() > 1e-4 * np.abs(exact).max()


def test_a_mass_on_a_spring_hides_neither_supports_nor_ends_of_beams():
    _, model = held(range(12))
    row = np.zeros(model.n_dof)
    row[0] = 1.0
    hung = calib.Effect(
        "hung", "a hung mass", "None.", "There.", calib.Parameter("hung", 0.01, 0.01, 9.0, "kg", prior_sd=2.0),
        lambda model: hung_masses([row], "hung", "f", 0.03), (calib.Parameter("f", 5.0, 1.0, 9.0, "Hz", prior_sd=2.0),),
        ({"hung": 2.0, "f": 5.0},),
    )  # fmt: skip
    wider = extend(model, [hung])
    assert wider.n_dof == model.n_dof + 1
    for of in (supports, member_ends):
        one, other = ([(j.nodes, j.directions) for j in of(m, {})] for m in (model, wider))
        assert one == other and one
    extend(wider, [c.effect for c in of_rigid_joints(model, [], {"stiffness": 1.0}, Names(()), 20.0)])


def test_nodes_that_plates_join_have_no_ends_of_beams():
    """Four plates share the middle node: its block with another is that of two of them."""
    own, points = thin_plate.stiffness(1.0, 1.0, 0.01, 0.3), [(x, y) for y in range(3) for x in range(3)]
    k = np.zeros((27, 27))
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        corners = [3 * (y + j) + x + i for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        dofs = [3 * c + d for c in corners for d in range(3)]
        k[np.ix_(dofs, dofs)] += 2.1e11 * own
    rows = [(n + 1, d, x, y, 0.0) for n, (x, y) in enumerate(points) for d in ("z", "rx", "ry")]
    dofs = pd.DataFrame(rows, columns=["node", "direction", "x", "y", "z"])
    assert not list(member_ends(calib.StructuralModel.from_matrices(k, np.eye(27), dofs=dofs), {}))


def test_compositions_soften_each_support_and_joint_in_each_direction_and_are_neutral_at_0():
    _, model = held(range(12))
    found = list(of_rigid_joints(model, [], {"stiffness": 1.0}, Names(()), 20.0))
    assert [c.kind for c in found] == ["soft support"] * 14 + ["soft joint"] * 6
    assert {c.effect.magnitude.unit for c in found} == {"mm/MN", "rad/kNm", "-"}
    for kind in ("soft support", "soft joint"):
        turning = next(c.effect for c in found if c.at.endswith("about y") and c.kind == kind)
        changed = extend(model, [turning])
        stiff, soft = (changed.modes({turning.name: x}, 3).natural_freq for x in (0.0, turning.plausible))
        np.testing.assert_allclose(stiff, model.modes({}, 3).natural_freq, rtol=1e-9)
        assert soft[0] < 0.995 * stiff[0]


def test_of_many_ends_of_beams_those_next_to_sensors_come_first():
    _, model = held(range(12))
    for corner in ((0.0, 0.0, LEG), (SPAN, 0.0, LEG)):
        found = of_rigid_joints(model, [calib.Sensor(0, "x", corner)], {"stiffness": 1.0}, Names(()), 20.0)
        assert next(c for c in found if c.kind == "soft joint").place == corner


def test_code_of_a_composition_builds_what_it_builds():
    _, model = held(range(12))
    every = [c.effect for c in of_rigid_joints(model, [], {"stiffness": 1.0}, Names(()), 20.0)]
    for effect in (every[0], every[-1]):
        scope = {"softened_joint": softened_joint}
        exec("def build(model):\n" + "\n".join(f"    {line}" for line in effect.build.code), scope)
        one, other = (built(model).stiffness[0] for built in (effect.build, scope["build"]))
        assert one.coefficient == other.coefficient and abs(one.matrix - other.matrix).max() == 0


def test_a_support_that_is_not_there_is_refused():
    _, model = held([])
    with pytest.raises(InputError, match="has no support"):
        softened_joint(model, [FEET[0]], 0, "f")
