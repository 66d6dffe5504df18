import os

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.scene import motion_scale, plot_coordinates, view_directions
from calib.report.shapes import draw_mode_shape, measured_motions, mode_shapes_figure


def drawn(ax, gid):
    """Points (n, 3) of a line, gaps left out, back in the coordinates of the data."""
    (line,) = [line for line in ax.lines if line.get_gid() == gid]
    x, y, z = (np.asarray(v, dtype=float) for v in line.get_data_3d())
    points = np.column_stack([x, z, -y])
    return points[~np.isnan(points).any(axis=1)]


numbers = st.tuples(*[st.floats(-10, 10)] * 3)


@given(numbers, numbers)
def test_plot_coordinates_keep_right_handedness_and_show_y_upwards(a, b):
    a, b = np.array(a), np.array(b)
    np.testing.assert_allclose(
        np.cross(plot_coordinates(a), plot_coordinates(b)), plot_coordinates(np.cross(a, b)), atol=1e-12
    )
    np.testing.assert_array_equal(plot_coordinates(np.array([0.0, 1.0, 0.0])), [0.0, 0.0, 1.0])


REST = np.array([[0, 0.5, 1], [2, 0.5, 1], [0, 0, -1], [2, 0, -1]], dtype=float)


def test_mesh_and_sensors_are_drawn_where_the_tables_say(shapes, deflection, mesh, pixels):
    ax = draw_mode_shape(shapes[shapes["mode"] == "1BT"], deflection, mesh)
    motion = np.array([[0, 1, 0], [0, 1, 0], [0, 1, 0], [0.1, 0.5, 0.2]])
    scale = 0.1 * np.sqrt(2.0**2 + 0.5**2 + 2.0**2)
    np.testing.assert_allclose(drawn(ax, "undeformed"), REST, atol=1e-12)
    moved = (REST + scale * motion)[[[2, 3, 3, 2], [0, 1, 1, 0]]]  # the farther bar is drawn first
    np.testing.assert_allclose(pixels.seen(ax, "deformed"), pixels.expected(ax, moved), atol=1e-6)
    np.testing.assert_allclose(drawn(ax, "measured"), [[0, 0.5 + scale, 1], [2, 0.5 + scale, 1]], atol=1e-12)
    np.testing.assert_allclose(
        drawn(ax, "motion"), [[0, 0.5, 1], [0, 0.5 + scale, 1], [2, 0.5, 1], [2, 0.5 + scale, 1]], atol=1e-12
    )


def test_a_measurement_equal_to_the_model_lies_on_the_deformed_mesh(shapes, deflection, mesh, pixels):
    one = shapes[shapes["mode"] == "1BT"].copy()
    one.loc[one["sensor"] == "2z", "measured_re"] = -0.4
    tilted = deflection.copy()
    tilted.loc[1, "w"] = -0.4
    ax = draw_mode_shape(one, tilted, mesh)
    near = pixels.seen(ax, "deformed")[-1, :2]
    np.testing.assert_allclose(pixels.expected(ax, drawn(ax, "measured")), near, atol=1e-6)


def test_shells_are_drawn_with_their_borders_and_openings(shapes, hull, pixels):
    rows = [("1BT", p, 0.0, 1.0, 0.0) for p in hull.points["point"]]
    still = pd.DataFrame(rows, columns=["mode", "point", "u", "v", "w"])
    ax = draw_mode_shape(shapes[shapes["mode"] == "1BT"], still, hull)
    assert len(pixels.seen(ax, "deformed")) == 39 + (20 + 8) + 3 + 2
    assert len(drawn(ax, "undeformed")) == 2 * ((20 + 8) + 3 + 2)
    # Hollow bodies move by at most 40 % of their height, not by a tenth of the length of the box.
    assert drawn(ax, "motion")[1, 1] - drawn(ax, "motion")[0, 1] == pytest.approx(0.4 * 2.0)


def test_sensors_at_one_place_give_one_vector_and_rotations_none(shapes):
    one = shapes[shapes["mode"] == "2BT"].copy()
    one.loc[one["sensor"] == "1y", "direction"] = "rx"
    places, motions = measured_motions(one)
    np.testing.assert_array_equal(places, [[2.0, 0.5, 1.0]])
    np.testing.assert_array_equal(motions, [[0.0, 0.0, 0.5]])


@given(st.floats(0.01, 100.0), st.floats(1e-6, 1e6))
def test_the_largest_motion_is_a_tenth_of_the_model_whatever_the_units(size, amplitude):
    corners = size * np.array([[0, 0, 0], [3.0, 4.0, 12.0]])
    scale = motion_scale(corners, amplitude * np.array([[0.0, 0.6, 0.8], [0.1, 0.0, 0.0]]))
    assert scale * amplitude == pytest.approx(1.3 * size)


def test_no_motion_at_all_is_drawn_at_rest(shapes, deflection, mesh, pixels):
    still = deflection.assign(u=0.0, v=0.0, w=0.0)
    ax = draw_mode_shape(shapes.assign(measured_re=0.0), still, mesh)
    at_rest = pixels.expected(ax, REST[[[2, 3, 3, 2], [0, 1, 1, 0]]])
    np.testing.assert_allclose(pixels.seen(ax, "deformed"), at_rest, atol=1e-6)


def texts(ax):
    return [t.get_text() for t in ax.texts]


def test_the_test_stands_beside_the_model_of_every_mode(shapes, deflection, mesh, before):
    facts = before.assign(natural_freq_model=[6.12, np.nan, 1.0], mac=[0.93, np.nan, 0.5])
    figure = mode_shapes_figure(shapes, deflection, mesh, facts)
    panels = figure.axes[:-1]  # the last one shows the directions of the axes
    titles = ["1BT   6.95 Hz", "6.12 Hz   MAC 0.93", "2BT   10.83 Hz", "not paired"]
    assert [words for panel in panels for words in texts(panel)] == titles
    for test, model in zip(panels[::2], panels[1::2], strict=True):
        np.testing.assert_allclose(drawn(test, "measured") - drawn(model, "measured"), 0.0, atol=1e-9)
        wire = drawn(test, "wireframe")
        ends = wire[~np.isnan(wire[:, 0])]
        dots = drawn(test, "measured")
        assert len(ends) and all(np.linalg.norm(dots - end, axis=1).min() < 1e-9 for end in ends)


@pytest.mark.medium
def test_the_measured_shape_is_drawn_on_the_whole_mesh_where_it_is_expanded(shapes, deflection, mesh, pixels):
    """Its distance from the sensors' dots remains: the expansion explains half of the motion."""
    expanded = deflection.assign(v=0.5, u=0.0, w=0.0)
    figure = mode_shapes_figure(shapes, deflection, mesh, None, expanded)
    test, model, other = figure.axes[0], figure.axes[1], figure.axes[2]
    scale = 0.1 * np.sqrt(2.0**2 + 0.5**2 + 2.0**2)
    moved = (REST + scale * np.array([0.0, 0.5, 0.0]))[[[2, 3, 3, 2], [0, 1, 1, 0]]]
    np.testing.assert_allclose(pixels.seen(test, "expanded"), pixels.expected(test, moved), atol=1e-6)
    np.testing.assert_allclose(drawn(test, "measured"), [[0, 0.5 + scale, 1], [2, 0.5 + scale, 1]], atol=1e-12)
    assert not [line for line in test.lines if line.get_gid() == "wireframe"]
    assert [c.get_gid() for c in model.collections] == ["deformed"]
    # The other mode has no expansion and keeps the wireframe.
    assert not other.collections and [line for line in other.lines if line.get_gid() == "wireframe"]


def test_an_unpaired_mode_shows_the_mesh_at_rest_and_the_measurement(shapes, deflection, mesh):
    figure = mode_shapes_figure(shapes, deflection, mesh)
    first, second = figure.axes[1], figure.axes[3]
    assert texts(figure.axes[2]) == ["2BT"] and texts(second) == [""]
    assert {line.get_gid() for line in second.lines} == {"undeformed", "motion", "measured"}
    assert not second.collections
    np.testing.assert_allclose(drawn(second, "undeformed"), drawn(first, "undeformed"))
    assert not np.isclose(drawn(second, "measured")[1, 2], 1.0)


@pytest.mark.parametrize("tallness", [1.0, 30.0])
def test_everything_lies_inside_its_panel_below_the_title(shapes, deflection, mesh, tallness):
    shapes["y"] *= tallness
    mesh.points["y"] *= tallness
    figure = mode_shapes_figure(shapes, deflection, mesh)
    figure.savefig(os.devnull, format="png")
    for ax in figure.axes[:4]:
        panel = ax.get_position(original=True).transformed(figure.transFigure)
        title = ax.texts[0].get_window_extent()
        for line in ax.lines:
            points = np.array(line.get_data_3d(), dtype=float)
            x, y, _ = proj_transform(*points[:, ~np.isnan(points[0])], ax.get_proj())
            seen = ax.transData.transform(np.column_stack([x, y]))
            assert seen[:, 0].min() > panel.x0 and seen[:, 0].max() < panel.x1
            assert seen[:, 1].min() > panel.y0 and seen[:, 1].max() < title.y0


def test_a_metre_is_equally_long_in_every_direction_of_the_picture(shapes, deflection, mesh):
    figure = mode_shapes_figure(shapes, deflection, mesh)
    figure.savefig(os.devnull, format="png")
    for ax in figure.axes:
        points = np.vstack([np.zeros(3), np.eye(3)])
        x, y, _ = proj_transform(*points.T, ax.get_proj())
        pixels = ax.transData.transform(np.column_stack([x, y]))
        metres = (pixels[1:] - pixels[0]).T
        scale = metres[1, 2] / view_directions()[1, 2]
        np.testing.assert_allclose(metres, scale * view_directions(), atol=1e-6 * scale)


def test_sensors_of_one_direction_at_one_place_count_by_their_mean():
    rows = [("x", 0.0, 0.4), ("x", 0.0, 0.6), ("y", 0.0, -1.0), ("x", 2.0, 0.3), ("rx", 2.0, 9.0), ("z", 2.0, np.nan)]
    table = pd.DataFrame(rows, columns=["direction", "x", "measured_re"]).assign(y=1.0, z=2.0)
    place, motion = measured_motions(table)
    np.testing.assert_array_equal(place, [[0.0, 1.0, 2.0], [2.0, 1.0, 2.0]])
    np.testing.assert_allclose(motion, [[0.5, -1.0, 0.0], [0.3, 0.0, 0.0]], rtol=1e-15)
