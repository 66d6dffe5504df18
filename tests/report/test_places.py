"""Springs, dampers, masses and supports of a model are drawn where the table says, with their parameters."""

import re
from html import unescape
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from calib.report.mesh import MeshTables
from calib.report.model import model_figure
from calib.report.places import draw_places, numbered_parameters, places_figure
from calib.report.style import style
from calib.report.svg import svg_text

PLACE = ["x", "y", "z"]


@pytest.fixture
def table():
    rows = [
        ("rod left", "spring", "stiffness", "K of rod", 0.0, 0.5, 1.0),
        ("rod right", "spring", "stiffness", "K of rod", 0.0, 0.0, -1.0),
        ("rod right, z", "spring", "stiffness", "K of rod", 0.0, 0.0, -1.0),
        ("damper", "damper", "damping", "c_rod", 1e-17, 0.5, 1.0),
        ("block", "mass", "mass", "", 2.0, 0.5, 1.0),
        ("contact", "spring", "stiffness", "", 2.0, 0.0, -1.0),
        ("support", "support", "", "", 2.0, 0.0, -1.0),
        ("bar", "part", "mass", "m_bar; K of rod", 1.0, 0.5, 1.0),
    ]
    return pd.DataFrame(rows, columns=["name", "form", "kind", "parameters", *PLACE])


def drawn(ax):
    """Places (n, 3) of the marks of each gid, sorted."""
    found = {}
    for line in ax.lines:
        x, y, z = (np.asarray(v, dtype=float) for v in line.get_data_3d())
        found.setdefault(line.get_gid(), []).extend(np.column_stack([x, z, -y]).tolist())
    return {gid: sorted(places) for gid, places in found.items()}


def test_every_piece_is_drawn_at_its_place_in_the_look_of_its_form(mesh, table):
    found = drawn(draw_places(mesh, table))
    for (form, fixed), rows in table.groupby(["form", table["parameters"] == ""]):
        assert found[f"fixed {form}" if fixed else form] == sorted(rows[PLACE].to_numpy().tolist())
    assert {*found} == {
        "mesh",
        "faces",
        "spring",
        "fixed spring",
        "damper",
        "fixed mass",
        "fixed support",
        "part",
        "words",
    }


def test_a_number_stands_once_at_every_place_of_a_parameter(mesh, table):
    assert numbered_parameters(table) == {"K of rod": 1, "c_rod": 2, "m_bar": 3}
    numbers = [text.get_text() for text in draw_places(mesh, table).texts if text.get_text()]
    assert sorted(numbers) == ["1", "1", "1+3", "2"]


def test_names_appear_under_the_mouse_together_at_one_place(mesh, table):
    order = {}
    for line in draw_places(mesh, table).lines:
        order.setdefault(line.get_gid() == "words", []).append(line.get_zorder())
    assert min(order[True]) > max(order[False])  # a mark above would take the mouse
    with style():
        text = svg_text(places_figure(mesh, table), "places")
    words = [unescape(found) for found in re.findall("<title>(.*?)</title>", text, re.S)]
    assert words == [
        "rod left: spring, K of rod\ndamper: damper, c_rod",
        "rod right: spring, K of rod\nrod right, z: spring, K of rod",
        "block: lumped mass, fixed",
        "contact: spring, fixed\nsupport",
        "bar: mass of a part, m_bar, K of rod",
    ]


def test_the_key_counts_the_pieces_of_every_parameter(mesh, table):
    (key,) = {t.get_text() for t in places_figure(mesh, table).texts if "K of rod" in t.get_text()}
    assert key == "1  K of rod: 3 springs, mass of 1 part"


@pytest.mark.parametrize(("name", "columns"), [("K", 3), ("K_of_a_rod_with_a_long_name", 2), ("K" * 90, 1)])
def test_the_columns_of_the_key_do_not_meet(mesh, table, name, columns):
    rows = [table[:1].assign(parameters=f"{name}{k}") for k in range(6)]
    figure = places_figure(mesh, pd.concat(rows, ignore_index=True))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.texts if name in text.get_text()]
    assert len(boxes) == columns
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))


@pytest.mark.parametrize("kept", [["support"], ["mass"], ["spring", "support"]])
def test_a_model_of_few_pieces_is_drawn_too(mesh, table, kept):
    some = table[table["form"].isin(kept)]
    figure = places_figure(mesh, some.assign(parameters=""))
    figure.draw_without_rendering()
    assert len(figure.legends[0].get_texts()) == len(kept)


@pytest.mark.parametrize("line", [None, (0, 1)])
def test_a_model_at_one_point_is_drawn_too(table, line):
    points = pd.DataFrame([(0, 1.0, 1.0, 1.0), (1, 1.0, 1.0, 1.0)], columns=["point", *PLACE])
    elements = pd.DataFrame([] if line is None else [("rod", *line, np.nan, np.nan)], columns=["group", *"abcd"])
    sensor = pd.DataFrame([("y", 1.0, 1.0, 1.0)], columns=["direction", *PLACE])
    mesh, some = MeshTables(points, elements), table[:1].assign(x=1.0, y=1.0, z=1.0)
    for figure in (places_figure(mesh, some), model_figure(mesh, sensor)):
        figure.draw_without_rendering()
        panel = figure.axes[0].get_position(original=True)
        assert panel.height * figure.get_size_inches()[1] > 1.0
