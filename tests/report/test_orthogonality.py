"""Matrices of cross- and self-orthogonality: values in the cells, frames around those that fail."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from calib.correlation.rules import RULES
from calib.report import orthogonality
from calib.report.orthogonality import draw_cross_orthogonality, draw_self_orthogonality, orthogonality_figure
from calib.report.style import VERMILLION, new_figure


def cells(ax):
    return {(round(t.get_position()[1]), round(t.get_position()[0])): t.get_text() for t in ax.texts}


def framed(ax):
    """Cells (row, column) with a frame."""
    frames = [p for p in ax.patches if p.get_gid() == "fails"]
    assert all(to_hex(p.get_edgecolor()).upper() == VERMILLION for p in frames)
    return sorted((round(p.get_y() + p.get_height() / 2), round(p.get_x() + p.get_width() / 2)) for p in frames)


def test_pairs_below_and_others_above_the_limits_have_a_frame(cross, own):
    ax = draw_cross_orthogonality(cross)
    assert cells(ax) == {(0, 0): "0.90", (0, 1): "0.10", (1, 0): "0.30", (2, 0): "0.11", (2, 1): "0.89"}
    assert framed(ax) == [(1, 0), (2, 0), (2, 1)]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1 (11.70 Hz)", "12 (16.20 Hz)"]
    assert framed(draw_self_orthogonality(own)) == [(0, 1), (1, 0)]
    np.testing.assert_array_equal(draw_self_orthogonality(own).images[0].get_array(), own.drop(columns="mode"))


def test_the_limits_are_those_of_the_sentence():
    assert (orthogonality.KEPT, orthogonality.LEAK) == (RULES.orthogonal_kept, RULES.orthogonal_leak)


@pytest.mark.medium
def test_the_figure_holds_both_beside_each_other_and_large_ones_below(cross, own):
    figure = orthogonality_figure(cross, own)
    assert [framed(ax) for ax in figure.axes[:2]] == [[(1, 0), (2, 0), (2, 1)], [(0, 1), (1, 0)]]
    assert len(figure.axes) == 3 and len(figure.legends) == 1  # one key to colours, one to frames
    many = [f"M{k}" for k in range(12)]
    large = pd.DataFrame(np.eye(12), columns=many).assign(mode=many)
    big = orthogonality_figure(cross, large)
    whole = pd.DataFrame(np.eye(2), columns=["M0", "M1"]).assign(mode=["M0", "M1"])
    assert not draw_self_orthogonality(whole).get_legend() and len(draw_self_orthogonality(own).get_legend().texts) == 1
    for found, beside in ((figure, True), (big, False)):
        (a, b) = (ax.get_subplotspec() for ax in found.axes[:2])
        assert (a.colspan != b.colspan) == beside and (a.rowspan != b.rowspan) != beside


def test_given_axes_are_drawn_on_and_returned(cross, own):
    for draw, table in ((draw_cross_orthogonality, cross), (draw_self_orthogonality, own)):
        ax = new_figure(3.0).add_subplot()
        assert draw(table, ax) is ax and ax.get_legend() is not None
