from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.report.mesh import (
    BORDER,
    FACE,
    LINE,
    MeshTables,
    bodies,
    check_mesh,
    draw_pieces,
    motions,
    pieces,
    thickness,
)
from calib.report.scene import frame_panel, new_axes, plot_coordinates, view_directions


def test_openings_ends_and_other_groups_have_borders_and_stiffeners_are_not_drawn(hull):
    parts = pieces(hull)
    assert [(parts.kind == kind).sum() for kind in (FACE, BORDER, LINE)] == [39, 31, 2]
    borders = {tuple(sorted(pair)) for pair in parts.corners[parts.kind == BORDER, :2].tolist()}
    ends = {(4 * k + a, 4 * k + b) for k in (0, 10) for a, b in ((0, 1), (1, 2), (2, 3), (0, 3))}
    top = {(4 * k + c, 4 * k + 4 + c) for k in range(10) for c in (1, 2)}
    opening = {(16, 17), (20, 21), (16, 20), (17, 21)}
    assert borders == ends | top | opening
    assert set(parts.group[parts.kind == LINE]) == {"bar"}


def test_bodies_are_connected_by_common_points(hull):
    parts = pieces(hull)
    found = bodies(parts, len(hull.points))
    assert len(set(found[parts.kind != LINE])) == 1 and len(set(found)) == 3


def test_thickness_is_the_middle_extent_of_the_shells_alone(hull, mesh):
    assert thickness(hull) == 2.0
    assert thickness(mesh) == np.inf


def test_motions_follow_the_numbers_of_the_points(mesh, deflection):
    np.testing.assert_allclose(motions(mesh, deflection.iloc[::-1])[3], [0.1, 0.5, 0.2])
    np.testing.assert_array_equal(motions(mesh, deflection.iloc[:1]), [[0, 1, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])


def test_points_that_do_not_exist_are_named(mesh):
    mesh.elements.loc[1, "b"] = 9
    with pytest.raises(InputError, match=r"no point 9.*mesh_points.csv") as problem:
        check_mesh(mesh, Path("mesh_elements.csv"))
    assert "mesh_elements.csv, line 3" in str(problem.value)


def test_near_pieces_are_drawn_last_with_their_own_colour_and_width(pixels):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    towards = np.cross(*view_directions())
    back = np.linalg.inv([plot_coordinates(e) for e in np.eye(3)]).T @ towards
    vertices = np.array([square + 3 * back, square - 3 * back, square])
    colours = np.eye(4)[:3] + np.array([0, 0, 0, 1])
    ax = new_axes(None)
    draw_pieces(ax, vertices, np.zeros(3, dtype=int), colours, colours, np.array([3.0, 1.0, 2.0]), "squares")
    frame_panel(ax, vertices.reshape(-1, 3), "")
    pixels.seen(ax, "squares")
    (drawn,) = ax.collections
    np.testing.assert_array_equal(drawn.get_facecolor(), colours[[1, 2, 0]])
    assert list(drawn.get_linewidth()) == [1.0, 2.0, 3.0]


def test_a_mesh_without_elements_is_drawn_as_its_points(mesh):
    drawn = pieces(MeshTables(mesh.points, mesh.elements.iloc[:0]))
    np.testing.assert_array_equal(drawn.corners, np.repeat(np.arange(len(mesh.points))[:, None], 4, axis=1))


def test_nothing_to_draw_adds_nothing(mesh):
    ax = new_axes(None)
    draw_pieces(ax, np.zeros((0, 4, 3)), *[np.zeros(0)] * 4, "none")
    assert not ax.collections


def test_numbers_of_points_need_not_begin_at_zero(mesh):
    shifted = MeshTables(
        mesh.points.assign(point=mesh.points["point"] + 7), mesh.elements.assign(a=[7, 9], b=[8, 10])
    )  # fmt: skip
    pd.testing.assert_frame_equal(pd.DataFrame(pieces(shifted).corners), pd.DataFrame(pieces(mesh).corners))
