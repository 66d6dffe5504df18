"""Springs, dampers, masses and supports of a model are drawn where the table says, with their parameters."""

import re
from html import unescape
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from calib.report.mesh import MeshTables
from calib.report.model import draw_model, model_figure
from calib.report.places import DIRECTION, draw_places, numbered_parameters, places_figure
from calib.report.scene import plot_coordinates, view_directions
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


def test_pieces_of_one_form_at_one_place_have_one_label(mesh, table):
    again = table[table["name"] == "bar"].assign(name="bar, stiffness", kind="stiffness", parameters="E_bar")
    numbers = [t.get_text() for t in draw_places(mesh, pd.concat([table, again])).texts if t.get_text()]
    assert sorted(numbers) == ["1", "1", "1+3+4", "2"]


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


def test_a_damper_stands_beside_the_spring_at_its_place(mesh, table):
    def damper(table):
        (line,) = (line for line in draw_places(mesh, table).lines if line.get_gid() == "damper")
        return line._marker.get_transform().transform([(0.0, 0.0)])[0]

    spring, own = (table.index[table["form"] == form][0] for form in ("spring", "damper"))
    together = table.copy()
    together.loc[own, PLACE] = table.loc[spring, PLACE]
    assert np.linalg.norm(damper(table)) < 1e-9 < 0.3 < np.linalg.norm(damper(together))


def test_marks_stand_in_the_direction_of_springs(mesh, table):
    ways = {"rod left": (1.0, 0.0, 0.0), "rod right": (0.0, 1.0, 0.0), "damper": (0.0, 0.0, 1.0)}
    turned = table.assign(
        **{c: [ways.get(n, (np.nan,) * 3)[k] for n in table["name"]] for k, c in enumerate(DIRECTION)}
    )
    found = {}
    for line in draw_places(mesh, turned).lines:
        if line.get_gid() in ("spring", "damper"):
            place = tuple(np.asarray(v, dtype=float)[0] for v in line.get_data_3d())
            along = line._marker.get_transform().transform([(0.0, 1.0)])[0]  # the mark's own upward direction
            found[line.get_gid(), place] = along / np.linalg.norm(along)
    seen = view_directions() @ plot_coordinates(np.array(list(ways.values()))).T
    for (name, _), flat in zip(ways.items(), seen.T, strict=True):
        row = table.set_index("name").loc[name]
        own = found[row["form"], tuple(plot_coordinates(row[PLACE].to_numpy(dtype=float)))]
        assert abs(own @ flat) / np.linalg.norm(flat) > np.cos(np.radians(3.0))


def test_groups_that_are_small_in_the_whole_have_panels_of_their_own(mesh, table):
    points = pd.DataFrame([(0, 0.0, 0.0, 0.0), (1, 40.0, 0.0, 0.0)], columns=["point", *PLACE])
    elements = pd.DataFrame([("beam", 0, 1, np.nan, np.nan)], columns=["group", *"abcd"])
    rows = [("s", "spring", "stiffness", f"k{k}", end + 0.4 * k, 0.0, 0.0) for end in (30.0, 5.0) for k in range(9)]
    far = ("m", "mass", "mass", "m", 20.0, 0.0, 0.0)
    crowd = pd.DataFrame([*rows, far], columns=table.columns)
    figure = places_figure(MeshTables(points, elements), crowd)
    whole, *panels = figure.axes[:3]
    assert sorted({t.get_text() for t in whole.texts} - {""}) == ["10", "A", "B"]
    own = [drawn(ax)["spring"] for ax in panels]
    assert [places[0][0] for places in own] == [5.0, 30.0] and {len(places) for places in own} == {9}
    assert len(places_figure(mesh, table).axes) == len(figure.axes) - 2


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


def test_where_the_structure_was_excited_has_a_star(mesh):
    rows = [("z", 1.0, 0.5, 1.0), ("y", 1.0, 0.5, 1.0), ("z", np.nan, 0.0, 0.0)]
    forces = pd.DataFrame(rows, columns=["direction", *PLACE])
    assert drawn(draw_model(mesh, forces=forces))["forces"] == [[1.0, 0.5, 1.0]]
    assert "forces" not in drawn(draw_model(mesh))


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
