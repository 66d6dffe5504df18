"""Panels and beams on one table of nodes: meshing, motions of points, RBE3s, affine terms."""

from dataclasses import fields, replace

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib import InputError, Parameter, ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, Monomial, Term
from models.fem.discrete import FrameLocator, PointMass, Spring, mass_matrix, spring_matrix
from models.fem.member import Member, Suppression
from models.fem.panel import Panel, sheet_panel
from models.fem.parts import shell_coefficients, shell_parts, shell_terms
from models.fem.rbe3 import Rbe3
from models.fem.section import Section
from models.fem.sheet import Sheet
from models.fem.structure import Structure

SHEET = Sheet(0.01, 70e9, 0.33, 2700.0)
BAR = Section(2e-3, 3e-6, 2e-6, 1e-6, 70e9, 0.33, 2700.0)
X, WINDOW = (0.0, 0.5, 1.1, 1.6, 2.0), (((1, 2), (1, 2)),)
PROFILE = ((0.0, 1.0), (0.4, 1.05), (0.8, 1.0), (1.1, 0.7))


def side(refinement=0, group="side", sheet=SHEET, openings=WINDOW, **more) -> Panel:
    return sheet_panel("car", group, sheet, X, PROFILE, openings=openings, refinement=refinement, **more)


def floor(refinement=0, sheet=SHEET) -> Panel:
    return sheet_panel("car", "floor", sheet, X, [(0.0, z) for z in (0.0, 0.6, 1.0)], refinement=refinement)


def car(refinement=0, sheet=SHEET, **more) -> Structure:
    panels = (floor(refinement, sheet), side(refinement, sheet=sheet))
    bars = panels[0].stiffener("sill", BAR, (0, 1, 0), v=2) + panels[1].stiffener("ring", BAR, (1, 0, 0), u=2)
    return Structure(bars, panels=panels, **more)


def constant(name: str, matrix: sp.csr_array) -> list[Term]:
    return [Term(name, sp.csr_array(matrix))]


def same(full: sp.csr_array) -> sp.csr_array:
    return full


# -- meshing -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("refinement", [0, 1, 2])
def test_refinement_halves_edges_and_keeps_lines_openings_and_area(refinement):
    s = Structure((), panels=(side(refinement),))
    assert len(s.corners) == 11 * 4**refinement
    for place in side().points.reshape(-1, 3):
        s.node("car", place)
    lengths = np.hypot(*np.diff(PROFILE, axis=0).T)
    assert s.area(["side"]) == pytest.approx(lengths.sum() * 2.0 - lengths[1] * 0.6, rel=1e-12)
    middle = s.points[s.corners].mean(axis=1)
    assert not np.any((np.abs(middle[:, 0] - 0.8) < 0.3) & (np.abs(middle[:, 1] - 0.6) < 0.2))
    weight = s.area_mass(["side"]).sum(axis=1)[2::6].sum()
    assert weight == pytest.approx(s.area(["side"]), rel=1e-12)


def test_nodes_without_an_element_are_left_out():
    s = Structure((), panels=(side(1, openings=(((1, 3), (0, 3)),)),))
    assert set(s.corners.ravel()) == set(range(len(s.points)))
    assert not np.any(np.abs(s.points[:, 0] - 1.1) < 0.4)


def test_without_panels_a_structure_is_whole_and_has_no_shells():
    s = Structure((Member("car", "post", BAR, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.5, up=(1, 0, 0)),))
    assert all(hasattr(s, f.name) for f in fields(s))
    assert s.area(()) == 0.0 and s.shells().stiffness.nnz == 0 and len(s.mesh().lines) == 2


@pytest.mark.parametrize("refinement", [0, 1, 2])
def test_stiffeners_share_the_nodes_of_their_line(refinement):
    s = car(refinement)
    bare = Structure((), panels=s.panels)
    assert len(s.points) == len(bare.points)
    assert len(s.ends) == (4 + 3) * 2**refinement
    assert len(s.members) == 1 + 3  # one for every straight run
    assert set(map(tuple, np.sort(s.ends, axis=1))) <= {tuple(e) for e in np.sort(s.mesh().lines, axis=1)}
    part = s.panels[1].stiffener("half", BAR, (0, 1, 0), v=0, between=(1, 3))
    assert (part[0].start, part[-1].end) == ((0.5, 0.0, 1.0), (1.6, 0.0, 1.0))


def test_panels_of_one_body_share_their_common_line_and_others_do_not():
    alone = sum(len(Structure((), panels=(p,)).points) for p in (floor(), side()))
    assert len(Structure((), panels=(floor(), side())).points) == alone - len(X)
    other = sheet_panel("crate", "side", SHEET, X, PROFILE, openings=WINDOW)
    assert len(Structure((), panels=(floor(), other)).points) == alone


def test_lines_of_the_picture_cover_every_edge_once():
    mesh = car(1).mesh()
    lines = np.sort(mesh.lines, axis=1)
    assert len(np.unique(lines, axis=0)) == len(lines) == len(mesh.groups)
    assert set(mesh.groups) == {"floor", "side", "sill", "ring"}
    edges = {tuple(sorted(edge)) for face in mesh.faces for edge in zip(face, np.roll(face, -1), strict=True)}
    assert edges <= set(map(tuple, lines)) and set(mesh.face_groups) == {"floor", "side"}


def test_a_gap_between_meshes_is_refused():
    with pytest.raises(InputError, match="is on the edge of a shell element but is not a corner"):
        Structure((), panels=(floor(1), side(0)))
    loose = Member("car", "bar", BAR, (0.25, 0.0, 0.0), (0.25, 1.0, 0.0), 9.0, up=(1, 0, 0))
    with pytest.raises(InputError, match="same lines and the same refinement"):
        Structure((loose,), panels=(floor(),))
    Structure((replace(loose, body="other"),), panels=(floor(),))


def test_panels_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="shape"):
        Panel("b", "g", SHEET, np.zeros((3, 3)))
    with pytest.raises(InputError, match="refinement is -1"):
        side(-1)
    with pytest.raises(InputError, match=r"opening .* leaves its lines 0\.\.4, 0\.\.3"):
        side(openings=(((1, 2), (1, 4)),))
    with pytest.raises(InputError, match="leave nothing"):
        side(openings=(((0, 4), (0, 3)),))
    with pytest.raises(InputError, match="panel car/side") as caught:
        Structure((), panels=(sheet_panel("car", "side", SHEET, (0.0, 1.0, 1.0), PROFILE),))
    assert "corners in turn" in str(caught.value)
    with pytest.raises(InputError, match="either u or v"):
        side().stiffener("g", BAR, (0, 1, 0))
    with pytest.raises(InputError, match="no line 9"):
        side().stiffener("g", BAR, (0, 1, 0), u=9)


# -- motions of points -------------------------------------------------------------------------------------------------


def test_every_point_follows_a_rigid_motion(rigid):
    rng = np.random.default_rng(0)
    warped = side(1).points + rng.uniform(-0.03, 0.03, (*side().points.shape,))
    s = Structure((), panels=(Panel("car", "side", SHEET, warped, WINDOW, 1),), reach=9.0)
    r = rigid(s.points)
    assert np.abs(s._quads.arms).max() > 1e-4
    for point in rng.uniform((-0.5, -0.5, 0.2), (2.5, 1.5, 1.4), (40, 3)):
        np.testing.assert_allclose(s.motion(point)[0] @ r, rigid(point[None]), atol=1e-12)


@pytest.mark.parametrize("refinement", [0, 1])
def test_linear_fields_are_followed_exactly_on_irregular_elements(refinement):
    rng = np.random.default_rng(1)
    points = np.zeros((4, 4, 3))
    points[..., 0], points[..., 2] = np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 4)
    points[1:3, 1:3, ::2] += rng.uniform(-0.08, 0.08, (2, 2, 2))
    s = Structure((), panels=(Panel("b", "g", SHEET, points, refinement=refinement),))
    a, b = rng.standard_normal((6, 3)), rng.standard_normal(6)
    field = (s.points @ a.T + b).ravel()
    for x, z in rng.uniform(0, 1, (30, 2)):
        p = np.array([x, 0.0, z])
        rows, distance = s.motion(p, "g")
        assert distance < 1e-12
        np.testing.assert_allclose(rows @ field, a @ p + b, atol=1e-12)
        above = np.add(p, (0.0, 0.3, 0.0))
        rows, distance = s.motion(above, "g")
        assert distance == pytest.approx(0.3)
        turn = (a @ p + b)[3:]
        np.testing.assert_allclose((rows @ field)[:3], (a @ p + b)[:3] + np.cross(turn, above - p), atol=1e-12)
    for k, p in enumerate(s.points):
        np.testing.assert_allclose(s.motion(p)[0], np.eye(s.n_full)[6 * k : 6 * k + 6], atol=1e-12)


def test_nearest_place_is_the_nearest_of_many(rigid):
    s = Structure((), panels=(side(1),), reach=9.0)
    at = np.linspace(-1, 1, 41)
    a, b = np.meshgrid(at, at)
    grid = np.stack([(1 - a) * (1 - b), (1 + a) * (1 - b), (1 + a) * (1 + b), (1 - a) * (1 + b)], axis=2) / 4
    dense = np.einsum("abk,eki->eabi", grid, s.points[s.corners]).reshape(-1, 3)
    for point in np.random.default_rng(2).uniform((-0.3, -0.3, 0.5), (2.3, 1.3, 1.3), (40, 3)):
        best = np.linalg.norm(dense - point, axis=1).min()
        assert best - 0.01 < s.motion(point)[1] <= best + 1e-12


def test_points_beside_a_panel_and_in_a_window_are_refused():
    s = car()
    with pytest.raises(InputError, match="beside the edge") as caught:
        s.motion((2.4, 0.0, 0.5), "floor")
    assert "panel car/floor" in str(caught.value) and "within 0.05 m" in str(caught.value)
    with pytest.raises(InputError, match="beside the edge"):
        s.motion((0.8, 0.6, 1.02), "side")
    assert s.motion((2.005, 0.0, 0.5), "floor")[1] == pytest.approx(0.005)  # a sensor a little off
    assert s.motion((1.3, 0.88, 1.18), "side")[1] > 0.1  # outside a ridge, beside no edge
    with pytest.raises(InputError, match="no part 'roof'") as caught:
        s.motion((0, 0, 0), "roof")
    assert "floor" in str(caught.value)


def test_of_a_beam_and_a_panel_at_one_place_the_beam_is_taken():
    s = car()
    place = (0.25, 0.0, 1.0)
    np.testing.assert_array_equal(s.motion(place)[0], s.motion(place, "sill")[0])
    assert np.abs(s.motion(place)[0] - s.motion(place, "floor")[0]).max() > 1e-3
    assert set(s.group_nodes(["sill"])) <= set(s.group_nodes(["floor"]))
    with pytest.raises(InputError, match="no group 'roof'"):
        s.group_nodes(["roof"])
    with pytest.raises(InputError, match="no group 'roof'"):
        s.shells(["roof"])


FEET = tuple((1.0 + x, 0.0, 0.5 + z) for x in (-0.3, 0.3) for z in (-0.25, 0.2))
TANK = (1.0, -0.4, 0.5)


@pytest.mark.parametrize("refinement", [0, 1])
def test_an_rbe3_follows_rigid_motions_and_shares_its_load_in_balance(rigid, refinement):
    s = car(refinement, rbe3s=(Rbe3("tank", "floor", FEET),))
    for point in (TANK, (0.9, -0.7, 0.2)):
        rows, distance = s.motion(point, "tank")
        assert distance == 0.0
        np.testing.assert_allclose(rows @ rigid(s.points), rigid(np.array([point])), atol=1e-12)
    # A pull over the feet's centre is shared evenly by them.
    pull = s.motion((1.0, -0.4, 0.475), "tank")[0][1]
    feet = [s.motion(foot, "floor")[0][1] for foot in FEET]
    np.testing.assert_allclose(pull, np.mean(feet, axis=0), atol=1e-12)


def test_an_rbe3_is_the_same_on_every_mesh():
    def moved(refinement, field):
        s = Structure((), panels=(floor(refinement),), rbe3s=(Rbe3("tank", "floor", FEET),))
        return s.motion(TANK, "tank")[0] @ np.array([field(p) for p in s.points]).ravel()

    def linear(p):
        return (*(np.arange(9).reshape(3, 3) @ p), 0.0, 0.0, 0.0)

    np.testing.assert_allclose(moved(2, linear), moved(0, linear), atol=1e-12)
    exact = np.array([moved(k, lambda p: (0, np.sin(2 * p[0]) * p[2] ** 2, 0, 0, 0, 0)) for k in range(5)])
    error = np.abs(exact[:-1] - exact[-1]).max(axis=1)
    assert np.all(np.diff(error) < 0) and error[-1] < 0.02 * error[0]


def test_rbe3s_that_cannot_stand_are_refused():
    with pytest.raises(InputError, match="has 3 feet"):
        Rbe3("tank", "floor", FEET[:3])
    with pytest.raises(InputError, match="one line"):
        Rbe3("tank", "floor", tuple((x, 0.0, 0.5) for x in (0.3, 0.5, 0.7, 0.9)))
    with pytest.raises(InputError, match="another part has its name"):
        car(rbe3s=(Rbe3("side", "floor", FEET),))
    off = tuple((x + 1.0, y, z) for x, y, z in FEET)
    with pytest.raises(InputError, match="beside the edge"):
        car(rbe3s=(Rbe3("tank", "floor", off),)).motion(TANK, "tank")
    with pytest.raises(InputError, match="no part 'tray'") as caught:
        car(rbe3s=(Rbe3("tank", "floor", FEET),)).motion(TANK, "tray")
    assert "tank" in str(caught.value)


def test_springs_and_masses_hang_on_rbe3s(rigid):
    s = car(rbe3s=(Rbe3("tank", "floor", FEET),))
    down = Spring(("tank", TANK), None, (0, 1, 0)).row(s)
    np.testing.assert_allclose(down, s.motion(TANK, "tank")[0][1])
    m = mass_matrix(s, [PointMass(("tank", TANK), 300.0, (4.0, 5.0, 6.0))])
    found, arm = rigid(s.points).T @ m @ rigid(s.points), np.array(TANK)
    np.testing.assert_allclose(found[:3, :3], 300.0 * np.eye(3), atol=1e-9)
    expected = 300.0 * (arm @ arm * np.eye(3) - np.outer(arm, arm)) + np.diag([4.0, 5.0, 6.0])
    np.testing.assert_allclose(found[3:, 3:], expected, atol=1e-9)


# -- matrices ----------------------------------------------------------------------------------------------------------


def test_a_body_of_walls_and_beams_has_six_rigid_motions_and_its_mass(rigid):
    s = car()
    beams, shells = s.beams(), s.shells()
    k, m = (beams[0] + shells.stiffness).toarray(), (beams[1] + shells.mass + shells.rotary).toarray()
    r = rigid(s.points)
    np.testing.assert_allclose(k @ r, 0.0, atol=1e-10 * np.abs(k).max())
    values = np.linalg.eigvalsh(k)
    assert np.all(np.abs(values[:6]) < 1e-12 * values[-1]) and values[6] > 1e-9 * values[-1]
    length = sum(np.linalg.norm(np.subtract(b.end, b.start)) for b in s.members)
    total = 2700.0 * (0.01 * s.area(["floor", "side"]) + 2e-3 * length)
    np.testing.assert_allclose((r.T @ m @ r)[:3, :3], total * np.eye(3), atol=1e-10 * total)


def test_groups_add_up():
    s = car()
    for whole, one, other in zip(s.shells(), s.shells(["floor"]), s.shells(["side"]), strict=True):
        np.testing.assert_allclose((one + other).toarray(), whole.toarray(), atol=1e-12 * abs(whole).max())


def test_a_wall_and_a_stiffener_together_bend_by_the_sum_of_their_moments():
    # A long strip with a beam in its middle plane, clamped: Euler's beam to 1 %.
    x, sheet = np.linspace(0, 10.0, 41), Sheet(0.02, 70e9, 0.0, 2700.0)
    panel = sheet_panel("b", "g", sheet, x, [(0.0, z) for z in (-0.1, 0.0, 0.1)])
    bar = replace(BAR, i_z=3e-7, poisson_ratio=0.0)
    held = tuple(Suppression(tuple(range(6)), body="b", point=(0.0, 0.0, z)) for z in (-0.1, 0.0, 0.1))
    s = Structure(panel.stiffener("bar", bar, (0, 1, 0), v=1), (), held, panels=(panel,))
    t = s.dof_map().expansion
    k = sp.csc_array(t.T @ (s.beams()[0] + s.shells().stiffness) @ t)
    load = t.T @ np.eye(s.n_full)[6 * s.node("b", (10.0, 0.0, 0.0)) + 1]
    tip = load @ sp.linalg.spsolve(k, load)
    assert tip == pytest.approx(10.0**3 / (3 * 70e9 * (3e-7 + 0.2 * 0.02**3 / 12)), rel=0.01)


def reference(values) -> Sheet:
    return replace(SHEET, young_modulus=values["E"], thickness=values["t"], rmi=values["RMI"])


def test_affine_terms_are_the_direct_matrices_at_any_value():
    s, values = car(), {"E": 55e9, "t": 0.017, "RMI": 120.0, "G": 9e9}
    stiffness, mass = shell_terms(s, same, "side", "E", "t", "RMI")
    assert [t.name for t in stiffness] == ["side: membrane, shear, drilling", "side: bending"]
    direct = car(sheet=reference(values)).shells(["side"])
    for terms, matrix in ((stiffness, direct.stiffness), (mass, direct.mass + direct.rotary)):
        found = AffineMatrix(s.n_full, tuple(terms))(values)
        assert abs(found - matrix).max() < 1e-13 * abs(matrix).max()
    stiffness, _ = shell_terms(s, same, "side", "E", "t", "RMI", "G")
    direct = car(sheet=replace(reference(values), shear_modulus=55e9 / 2.66, shear_modulus_through=(9e9, 9e9)))
    matrix = direct.shells(["side"]).stiffness
    assert abs(AffineMatrix(s.n_full, tuple(stiffness))(values) - matrix).max() < 1e-13 * abs(matrix).max()
    fixed, _ = shell_terms(s, same, "side")
    assert [t.coefficient for t in fixed] == [Monomial()]
    different = Structure((), panels=(side(), sheet_panel("b", "side", replace(SHEET, thickness=0.02), X, PROFILE)))
    with pytest.raises(InputError, match="panels differ"):
        shell_terms(different, same, "side", thickness="t")
    assert shell_terms(different, same, "side", modulus="E")


def test_parts_add_up_to_the_whole():
    s = car()
    its = shell_coefficients(SHEET, "E", "t", "RMI")
    parts, values = shell_parts(s, same, {"side": its}), {"E": 70e9, "t": 0.01, "RMI": 1.0}
    for kind, whole in (("stiffness", s.shells().stiffness), ("mass", s.shells().mass)):
        found = sum(p.matrix * p.coefficient(values) for p in parts if p.kind == kind)
        assert abs(found - whole).max() < 1e-13 * abs(whole).max()
    assert {p.name for p in parts} >= {"floor", "side", "side, bending"}


@pytest.mark.medium
def test_a_model_of_panels_and_stiffeners_has_modes_and_sensor_rows():
    freq = []
    for refinement in (0, 1, 2):
        s = car(refinement, rbe3s=(Rbe3("tank", "floor", FEET),))
        dofs = s.dof_map()
        stiffness, mass = shell_terms(s, same, "side", "E", "t", "RMI")
        rest, weight = shell_terms(s, same, "floor")
        corners = [(x, 0.0, z) for x in (0.2, 1.8) for z in (0.2, 0.8)]
        springs = spring_matrix(s, [Spring(("floor", c), None, d) for c in corners for d in np.eye(3).tolist()])
        k, m = s.beams()
        space = ParameterSpace(
            (
                Parameter("E", 70.0, 50.0, 90.0, "GPa"),
                Parameter("t", 10.0, 5.0, 20.0, "mm"),
                Parameter("RMI", 1.0, 0.5, 300.0, "-"),
            )
        )
        n = dofs.n_dof
        stiffness += [*rest, *constant("bars", k), *constant("springs", 1e3 * springs)]
        mass += [*weight, *constant("bars", m)]
        mass += constant("tank", mass_matrix(s, [PointMass(("tank", TANK), 50.0)]))
        model = StructuralModel(
            "car", space, AffineMatrix(n, tuple(stiffness)), AffineMatrix(n, ()), AffineMatrix(n, tuple(mass)),
            s.mesh(), dofs, {"all": np.arange(n)}, FrameLocator(s, dofs.expansion),
        )  # fmt: skip
        modes = model.modes({"RMI": 20.0}, 8)
        assert not modes.excluded
        k, _, m = (a.toarray() for a in model.matrices({"RMI": 20.0}))
        if refinement == 0:
            inverse = la.eigh(m, k, eigvals_only=True)[::-1][:8]
            np.testing.assert_allclose(modes.natural_freq, 1 / np.sqrt(inverse) / (2 * np.pi), rtol=1e-6)
        row, distance = model.locator.row((0.3, 0.0, 0.3), 1, "floor")
        assert distance < 1e-12 and row.sum() == pytest.approx(1.0)
        freq.append(modes.natural_freq)
    freq = np.array(freq)
    np.testing.assert_allclose(freq[0, :6], freq[2, :6], rtol=1e-3)  # on its springs
    assert np.all(np.abs(freq[1] / freq[2] - 1) < 0.8 * np.abs(freq[0] / freq[2] - 1), where=np.arange(8) > 5)
