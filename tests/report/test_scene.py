import os

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.text import Text
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.scene import (
    draw_dots,
    frame_panel,
    new_axes,
    new_scene,
    number_points,
    plot_coordinates,
    view_directions,
)


def test_numbers_stay_inside_the_panel_and_off_the_points():
    figure = new_scene(4.0)
    ax = new_axes(figure.add_subplot(projection="3d"))
    # The last circle is surrounded by others, except towards the edge of the panel.
    row, column = np.linspace(0.0, 40.0, 81), np.linspace(-3.0, 3.0, 13)
    points = np.zeros((94, 3))
    points[:13, 0], points[:13, 1], points[13:, 0] = 40.0, column, row
    place = 93
    draw_dots(ax, points, np.ones(94), Normalize(0.0, 1.0), "OrRd", "dots")
    frame_panel(ax, points, "")
    number_points(ax, points, {place: 7})
    figure.savefig(os.devnull, format="png")
    (number,) = [t for t in ax.texts if t.get_text() == "7"]
    panel = ax.get_position(original=True).transformed(figure.transFigure)
    box = number.get_tightbbox()
    assert panel.x0 <= box.x0 and box.x1 <= panel.x1 and panel.y0 <= box.y0 and box.y1 <= panel.y1
    seen = ax.transData.transform(ax.collections[0].get_offsets())
    end = seen[place] + np.array(number.xyann) * figure.dpi / 72.0
    assert np.linalg.norm(seen - end, axis=1).min() > 10.0


def test_circles_grow_with_the_absolute_value():
    ax = new_axes(None)
    draw_dots(ax, np.zeros((3, 3)), np.array([-4.0, 2.0, 4.0]), Normalize(-4.0, 4.0), "RdBu_r", "dots")
    areas = ax.collections[0].get_sizes()
    assert areas[0] == areas[2] > areas[1]


def test_numbers_at_one_place_cover_neither_each_other_nor_the_place():
    figure = new_scene(4.0)
    ax = new_axes(figure.add_subplot(projection="3d"))
    points = np.array([[0.0, 0, 0], *[[4, 0, 0]] * 4, [8, 0, 0]])
    draw_dots(ax, points, np.ones(6), Normalize(0.0, 1.0), "OrRd", "dots")
    frame_panel(ax, points, "")
    number_points(ax, points, {1: "1+2+3", 2: "11+12", 3: 6, 4: "14+15"})
    figure.savefig(os.devnull, format="png")
    boxes = [Text.get_window_extent(t) for t in ax.texts if t.get_text()]
    seen = ax.transData.transform(ax.collections[0].get_offsets())
    assert len(boxes) == 4
    for k, box in enumerate(boxes):
        assert not any(box.contains(*place) for place in seen)
        assert not any(box.overlaps(other) for other in boxes[:k])


def test_a_number_stays_off_a_large_mark():
    """Small points stand closer all around but where the mark is: without its size the number would lie on it."""
    figure = new_scene(4.0)
    ax = new_axes(figure.add_subplot(projection="3d"))
    turns = np.arange(12) * np.pi / 6.0
    distance = np.where(turns == 0, 38.0, 30.0)  # points of the page
    seen = distance[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    x, up, across = (seen @ view_directions()).T[[0, 2, 1]]
    points = np.vstack([np.zeros(3), np.column_stack([x, up, -across]), [[-190.0, 0, 0], [190.0, 0, 0]]])
    frame_panel(ax, points, "")
    ax.apply_aspect()
    at = ax.transData.transform(np.column_stack(proj_transform(*plot_coordinates(points).T, ax.get_proj())[:2]))
    off = []
    for radius in (0.0, 30.0):
        number_points(ax, points, {0: 7}, np.where(np.arange(len(points)) == 1, radius, 0.0))
        off.append(np.linalg.norm(at[0] + np.array(ax.texts[-1].xyann) * figure.dpi / 72.0 - at[1]) * 72.0 / figure.dpi)
    assert off[0] + 10.0 < np.linalg.norm(at[1] - at[0]) * 72.0 / figure.dpi < off[1]  # towards the mark; away from it
