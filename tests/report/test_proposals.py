"""What is proposed and where: the places in the figure are those of the table."""

import numpy as np
import pandas as pd
import pytest

from calib.report.proposals import BEST, draw_proposals, placed_proposals, proposals_figure
from calib.report.scene import PLACE

REST = np.array([[[0.0, 0.0, -1.0], [4.0, 0.0, -1.0]], [[4.0, 0.0, -1.0], [4.0, 1.0, 1.0]]])


@pytest.fixture
def table():
    """Rank 2 acts at two places, rank 4 is as good as the first, rank 5 is not; the first has one that is like it."""
    rows = [
        (1, "stiffness", "beam", True, True, 20.0, 1.0, 0.0, -1.0),
        (1, "mass", "beam", False, True, np.nan, 2.0, 0.0, -1.0),
        (2, "added mass", "nodes 1 and 2", True, True, 19.0, 0.0, 0.0, -1.0),
        (2, "added mass", "nodes 1 and 2", True, True, 19.0, 4.0, 0.0, -1.0),
        (2, "section", "beam", False, True, np.nan, 1.0, 0.0, -1.0),
        (3, "damping", "joint", True, False, 9.0, 4.0, 1.0, 1.0),
        (4, "hung mass", "sensor 3y", True, True, 18.0, 4.0, 0.5, 0.0),
        (5, "damping", "seat", True, False, -2.0, 3.0, 0.0, -1.0),
    ]
    return pd.DataFrame(rows, columns="rank kind at fitted close evidence x y z".split())


def placed(collection):
    x, y, z = (np.asarray(v, dtype=float) for v in collection._offsets3d)
    return np.column_stack([x, z, -y])


def test_drawn_are_the_best_three_the_equal_ones_and_what_is_like_the_first(table):
    rows = placed_proposals(table)
    assert set(zip(rows["rank"], rows["kind"], strict=True)) == {
        (1, "stiffness"), (1, "mass"), (2, "added mass"), (3, "damping"), (4, "hung mass"),
    }  # fmt: skip
    assert BEST == 3


def test_every_place_is_drawn_where_it_is_with_its_evidence(table):
    ax = draw_proposals(table, REST)
    (dots,) = [c for c in ax.collections if c.get_gid() == "evidence"]
    own = placed_proposals(table)
    own = own[own["fitted"]]
    found = {tuple(at): value for at, value in zip(placed(dots).round(6).tolist(), dots.get_array(), strict=True)}
    assert found == {tuple(at): e for at, e in zip(own[PLACE].to_numpy().tolist(), own["evidence"], strict=True)}
    (squares,) = [line for line in ax.lines if line.get_gid() == "alike"]
    x, y, z = (np.asarray(v, dtype=float) for v in squares.get_data_3d())
    assert np.column_stack([x, z, -y]).tolist() == [[2.0, 0.0, -1.0]]
    assert sorted(text.get_text() for text in ax.texts if text.get_text()) == ["1", "2", "2", "3", "4"]


def test_the_key_names_each_number_once(table):
    figure = proposals_figure(table, REST)
    (key,) = [text.get_text() for text in figure.texts if "stiffness" in text.get_text()]
    lines = key.splitlines()
    assert [line[0] for line in lines] == ["1", "2", "3", "4", "□"]
    assert "(19.0, as good as the first)" in lines[1] and "(9.0)" in lines[2] and "1 composition like" in lines[4]


def test_a_place_without_coordinates_is_not_drawn(table):
    table.loc[0, PLACE] = np.nan
    assert "stiffness" not in set(placed_proposals(table)["kind"])
    proposals_figure(table, REST)
