import os

import numpy as np
import pandas as pd
from matplotlib.colors import to_rgb

from calib.report.mesh import FACE, pieces, point_coordinates
from calib.report.model import COLOURS, coloured_groups, draw_model, face_groups, model_figure
from calib.report.style import BLACK


def drawn(ax, gid):
    (line,) = [line for line in ax.lines if line.get_gid() == gid]
    x, y, z = (np.asarray(v, dtype=float) for v in line.get_data_3d())
    points = np.column_stack([x, z, -y])
    return points[~np.isnan(points).any(axis=1)]


def test_every_piece_lies_where_the_tables_say(hull, pixels):
    ax = draw_model(hull)
    wanted = pixels.expected(ax, point_coordinates(hull)[pieces(hull).corners])
    seen = pixels.seen(ax, "model")
    assert {tuple(np.round(s.ravel(), 3)) for s in seen} == {tuple(np.round(w.ravel(), 3)) for w in wanted}


def test_faces_have_the_hue_of_their_group(hull, pixels):
    ax = draw_model(hull)
    pixels.seen(ax, "model")
    faces = ax.collections[0].get_facecolor()
    faces = faces[faces[:, 3] > 0]
    assert face_groups(hull) == ["hull", "top"] and len(faces) == (pieces(hull).kind == FACE).sum()
    hues = {tuple(np.round(face[:3] / face[:3].max(), 6)) for face in faces}
    assert hues == {tuple(np.round(np.array(to_rgb(c)) / max(to_rgb(c)), 6)) for c in COLOURS[:2]}


def test_lines_without_faces_have_the_colour_of_their_group(hull):
    bare = hull.elements[hull.elements["c"].isna()].reset_index(drop=True)
    lines = hull._replace(elements=bare.assign(group=["mast", "lines", "mast"]))
    assert coloured_groups(lines) == ["mast"]
    edges = draw_model(lines).collections[0].get_edgecolor()
    assert {tuple(row[:3]) for row in edges} == {to_rgb(COLOURS[0]), to_rgb(BLACK)}
    assert not coloured_groups(hull._replace(elements=bare.assign(group="mast")))
    many = pd.concat([bare] * 3, ignore_index=True)
    assert not coloured_groups(hull._replace(elements=many.assign(group=[str(k) for k in range(len(many))])))


def test_sensors_are_drawn_at_their_coordinates_along_their_directions(shapes, mesh):
    sensors = shapes[shapes["mode"] == "1BT"]
    ax = draw_model(mesh, sensors)
    np.testing.assert_array_equal(drawn(ax, "sensors"), [[0, 0.5, 1], [2, 0.5, 1]])
    ends = drawn(ax, "directions").reshape(-1, 2, 3)
    np.testing.assert_allclose((ends[:, 1] - ends[:, 0]) / (0.02 * np.sqrt(8.25)), [[0, 1, 0], [0, 1, 0], [0, 0, 1]])


def test_the_legend_names_groups_and_counts_sensors(shapes, hull):
    figure = model_figure(hull, shapes[shapes["mode"] == "1BT"])
    figure.savefig(os.devnull, format="png")
    words = [t.get_text() for t in figure.legends[0].get_texts()]
    assert words == ["hull", "top", "beams and other lines", "sensors used (4) and their directions"]
