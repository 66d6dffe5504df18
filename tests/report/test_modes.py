import os

import numpy as np
import pandas as pd
import pytest

from calib.report.mesh import LINE, pieces, point_coordinates
from calib.report.modes import AMPLITUDE, draw_model_mode, model_modes_figure, pages, views
from calib.report.style import COLUMN, style


def motion(hull, of_hull, of_bars):
    """Upward motion of the points of the box and of the two bars, as a table and as an array."""
    up = np.concatenate([np.full(44, of_hull), np.repeat(of_bars, 2)])
    table = pd.DataFrame({"point": range(48), "u": 0.0, "v": up, "w": 0.0})
    return table, table[["u", "v", "w"]].to_numpy()


def test_pieces_are_coloured_by_their_amplitude_over_the_largest(deflection, mesh, pixels):
    ax = draw_model_mode(deflection.assign(**(7.0 * deflection[["u", "v", "w"]])), mesh)
    pixels.seen(ax, "deformed")
    far = (1.0 + np.sqrt(0.1**2 + 0.5**2 + 0.2**2)) / 2
    np.testing.assert_allclose(ax.collections[0].get_edgecolor(), AMPLITUDE([far, 1.0]))


def test_the_largest_motion_is_drawn_as_a_tenth_of_the_diagonal(deflection, mesh, pixels):
    ax = draw_model_mode(deflection, mesh)
    moved = point_coordinates(mesh) + 0.1 * np.sqrt(8.25) * deflection[["u", "v", "w"]].to_numpy()
    expected = pixels.expected(ax, moved[[[2, 3, 3, 2], [0, 1, 1, 0]]])
    np.testing.assert_allclose(pixels.seen(ax, "deformed"), expected, atol=1e-6)


def test_a_mode_of_the_hull_shows_all_pieces(hull):
    (whole,) = views(pieces(hull), point_coordinates(hull), motion(hull, 1.0, [0.9, 0.9])[1])
    assert whole.all()


def test_a_mode_of_small_parts_shows_these_from_one_end_to_the_other(hull):
    parts = pieces(hull)
    rear, front = views(parts, point_coordinates(hull), motion(hull, 0.8, [0.6, -1.0])[1])
    assert rear.sum() == front.sum() == 1 and (parts.kind[rear | front] == LINE).all()
    assert point_coordinates(hull)[parts.corners[rear], 0].max() == 2.0
    assert point_coordinates(hull)[parts.corners[front], 0].min() == 18.0


def test_a_part_that_hardly_moves_is_not_shown(hull):
    (front,) = views(pieces(hull), point_coordinates(hull), motion(hull, 0.0, [0.4, 1.0])[1])
    assert front.sum() == 1


def test_a_structure_of_similar_bodies_shows_all_pieces(deflection, mesh):
    (whole,) = views(pieces(mesh), point_coordinates(mesh), deflection[["u", "v", "w"]].to_numpy())
    assert whole.all()


@pytest.mark.medium
def test_panels_name_mode_damped_frequency_and_damping(hull, model_modes):
    rows = pd.concat([model_modes, model_modes.assign(mode="2BT", damped_freq=9.876, damping_ratio=0.0)])
    tables = [motion(hull, 1.0, [0.0, 0.0])[0].assign(mode="1BT"), motion(hull, 0.1, [1.0, -1.0])[0].assign(mode="2BT")]
    figure = model_modes_figure(rows, pd.concat(tables), hull)
    figure.savefig(os.devnull, format="png")
    words = [t.get_text() for ax in figure.axes for t in ax.texts]
    assert {"1BT   6.12 Hz   damping 15.0 %", "2BT   9.88 Hz", "at x = 2.0 m", "at x = 18.0 m"} <= set(words)
    assert len([c for ax in figure.axes for c in ax.collections if c.get_gid() == "deformed"]) == 3
    with style(COLUMN):
        narrow = model_modes_figure(rows, pd.concat(tables), hull)
    narrow.savefig(os.devnull, format="png")
    (title,) = (t for ax in narrow.axes for t in ax.texts if t.get_text().startswith("2BT"))
    for at in (t for ax in narrow.axes for t in ax.texts if t.get_text().startswith("at x")):
        low = title.get_window_extent().y0 - at.get_window_extent().y1
        assert 0 <= low < 0.1 * narrow.dpi and at.axes.name != "3d"


@pytest.mark.parametrize(("count", "sizes"), [(0, []), (1, [1]), (8, [8]), (9, [5, 4]), (12, [6, 6]), (17, [6, 6, 5])])
def test_many_modes_are_distributed_evenly_over_figures(count, sizes):
    found = pages(pd.DataFrame({"mode": range(count)}))
    assert [len(part) for part in found.values()] == sizes
    assert list(found) == ([""] if len(sizes) == 1 else [f"_{k + 1}" for k in range(len(sizes))])
    assert [mode for part in found.values() for mode in part["mode"]] == list(range(count))
