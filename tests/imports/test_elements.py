"""Edges of elements: decks of Abaqus and CalculiX, and bulk data of Nastran."""

from pathlib import Path

import pytest

from calib.imports.coordinates import read_coordinates
from calib.imports.elements import element_sets, elements, held_motions, read_edges
from calib.imports.fe_modes import element_lines
from calib.imports.matrices import read_matrices

EXPORTS = Path(__file__).parent / "exports"


def test_edges_of_an_exported_deck_join_nodes_that_have_rows():
    edges = read_edges((EXPORTS / "solid.inp").read_text())
    assert len(edges) == len(set(edges)) == 12 + 8  # two bricks that share four edges
    drawn = read_matrices([EXPORTS / "solid.sti"]).lines
    assert len(drawn) == 4 + 4 + 4 and set(drawn) < set(edges)  # without those of the clamped end
    assert (1, 2) in edges and not any(1 in edge for edge in drawn)


@pytest.mark.parametrize("name", ["solid", "shell"])
def test_edges_of_a_file_of_modes_are_those_of_its_deck(name):
    deck = set(map(frozenset, read_edges((EXPORTS / f"{name}.inp").read_text())))
    assert deck and set(map(frozenset, element_lines([None, EXPORTS / f"{name}_modes.frd"]))) == deck
    assert element_lines([EXPORTS / "solid_modes.dat", EXPORTS / f"{name}.inp"])
    assert not element_lines([Path("absent.frd")])


@pytest.mark.parametrize(
    ("text", "count", "some"),
    [
        ("*ELEMENT, TYPE=B32R, ELSET=A\n1, 11, 12, 13\n*NSET\n1, 2, 3\n", 2, (11, 12)),
        ("*Element, type=S8R\n1, 1,2,3,4,5,6,7,\n8\n** a comment\n2, 2,9,10,3,11,12,13,6\n", 7, (9, 10)),
        ("*ELEMENT,TYPE=C3D20R\n1," + ",".join(map(str, range(1, 16))) + ",\n16,17,18,19,20", 12, (4, 8)),
        ("*ELEMENT, TYPE=C3D10\n1,1,2,3,4,5,6,7,8,9,10\n*ELEMENT, TYPE=MASS\n2, 7\n", 6, (3, 4)),
        ("*ELEMENT, TYPE=STRI3\n1,1,2,3\n*ELEMENT, TYPE=SPRINGA\n2,1,5\n", 3, (1, 3)),
        ("CQUAD4  1       7       1       2       3       4\nCBAR,2,8,4,5,0.,0.,1.\nCELAS2,3,1.,1,1\n", 5, (4, 5)),
        ("CHEXA   1       7       1       2       3       4       5       6\n        7       8\n", 12, (3, 7)),
        ("CTRIA3* 1               7               1               2\n*       3\n", 3, (1, 3)),
        ("GRID    1               0.      0.      0.\n", 0, None),
    ],
)  # fmt: skip
def test_edges_of_each_kind_of_element(text, count, some):
    edges = read_edges(text)
    assert len(edges) == count and (some is None or some in edges)


@pytest.mark.parametrize(
    ("text", "sets"),
    [
        ("*ELEMENT, TYPE=B31, ELSET=Legs\n1, 11, 12\n2,12,13\n*ELEMENT,TYPE=S4\n7,1,2,3,4\n8,3,4,5,6\n"
         "*ELSET, ELSET=FLOOR, GENERATE\n7, 8\n*Elset,elset=both\nfloor, 2\n*ELSET,ELSET=NONE\n99\n*NSET,NSET=N\n1,\n",
         {"LEGS": {11, 12, 13}, "FLOOR": {1, 2, 3, 4, 5, 6}, "BOTH": {1, 2, 3, 4, 5, 6, 12, 13}}),
        ("CQUAD4  1       7       1       2       3       4\nCBAR,2,8,4,5,0.,0.,1.\nCBAR,3,8,5,6,0.,0.,1.\n",
         {"property 7": {1, 2, 3, 4}, "property 8": {4, 5, 6}}),
        ("CQUAD8,1,7,1,2,3,4,5,6\n,7,8\n", {"property 7": set(range(1, 9))}),
        ("*NODE\n1,0,0,0\n", {}),
    ],
)  # fmt: skip
def test_sets_hold_the_nodes_of_their_elements(text, sets):
    assert element_sets(text) == sets


def test_a_database_of_ansys_has_nodes_elements_and_components():
    file = EXPORTS / "hexbeam.cdb"
    text, points = file.read_text("latin-1"), read_coordinates(file, 2.0)
    assert len(points) == 321 and max(points.values(), key=lambda p: p[2])[2] == 10.0
    assert points[2] == (2.0, 0.0, 0.0)  # zeros at the end of its line are not written
    assert len(list(elements(text))) == 40 and len(read_edges(text)) == 90 + 132  # 2 x 2 x 10 bricks
    sets = element_sets(text)
    assert {name: len(nodes) for name, nodes in sets.items()} == {"ECOMP1": 190, "ECOMP2": 190}
    assert min(points[node][2] for node in sets["ECOMP1"]) == 4.0  # bricks 17, 18 and 21 to 40, 0.5 high before scaling
    assert max(points[node][2] for node in sets["ECOMP2"]) == 6.0 and sets["ECOMP1"] | sets["ECOMP2"] == set(points)


def test_motions_that_a_deck_holds_are_known_by_node_and_set():
    deck = """*NODE, NSET=ALL
1,0,0,0
2,1,0,0
*NSET, NSET=EDGE, GENERATE
4, 8, 2
*Nset, nset=Both
edge, 11,
*BOUNDARY
** a comment
1,1,3
Both,3
all,6,6,0.0
*STEP
*BOUNDARY, OP=NEW
12,2
*NODE PRINT, NSET=ALL
U
"""
    both = {(node, 3) for node in (4, 6, 8, 11)}
    assert held_motions("*BOUNDARY\n4, 2, , 0\n") == {(4, 2)}  # the value is no last direction
    assert held_motions(deck) == {(1, 1), (1, 2), (1, 3), (1, 6), (2, 6), (12, 2)} | both


@pytest.mark.parametrize(("form", "width"), [("1", 10), ("0", 5)])
def test_edges_of_elements_in_a_file_of_results(tmp_path, form, width):
    """Numbers that fill their columns touch; a line that cannot be read ends the elements."""
    number = f"{{:>{width}}}".format
    plate = [98760 + k for k in range(1, 9)]
    lines = [
        f"    3C                             2{form:>38}",
        f" -1{number(1)}{10:>5}    0    1",  # a shell of eight nodes, in two lines
        " -2" + "".join(map(number, plate[:5])),
        " -2" + "".join(map(number, plate[5:])),
        f" -1{number(2)}{11:>5}    0    1",
        " -2" + number(7) + number(8),
        f" -1{number('x')}{11:>5}    0    1",
    ]
    (tmp_path / "a.frd").write_text("\n".join(lines))
    edges = {tuple(sorted(edge)) for edge in element_lines([None, tmp_path / "a.frd"])}
    assert edges == {(7, 8), (98761, 98762), (98762, 98763), (98763, 98764), (98761, 98764)}
