"""Decks in many files, of parts, with systems and transforms of their own; meshes. Real exports where it is said."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from calib.errors.errors import InputError
from calib.imports.coordinates import read_coordinates
from calib.imports.elements import element_sets, held_motions, transformed_nodes
from calib.imports.fe_modes import read_fe_modes
from calib.imports.keywords import deck_text
from calib.imports.matrices import read_matrices
from calib.imports.meshes import read_element_mesh
from calib.imports.systems import all_motions, analysis_set, axes_of, placed_nodes

EXPORTS = Path(__file__).parent / "exports"


@pytest.mark.parametrize(
    "line", ["*include, input=mesh.inc", '*INCLUDE,\n  INPUT="mesh.inc"', "include 'mesh.inc'", "INCLUDE 'mesh\n.inc'"]
)
def test_included_files_stand_at_their_places(line, tmp_path):
    (tmp_path / "mesh.inc").write_text("*node, nset=all\n1, 2.0, 3.0\n")
    (deck := tmp_path / "deck.inp").write_text(f"** by hand\n{line}\n*Nset, Nset=tip\n1,\n")
    assert read_coordinates(deck) == {1: (2.0, 3.0, 0.0)}
    assert deck_text(deck).index("2.0") < deck_text(deck).index("tip")


def test_included_files_that_are_missing_or_endless_are_refused(tmp_path):
    (deck := tmp_path / "deck.inp").write_text("*include, input=other.inc\n")
    with pytest.raises(
        InputError, match=r"deck.inp: it includes other.inc, which is not there; put it beside deck.inp"
    ):
        read_coordinates(deck)
    (tmp_path / "other.inc").write_text("*include, input=deck.inp\n")
    with pytest.raises(InputError, match="include each other"):
        read_coordinates(deck)


def test_files_of_the_control_of_nastran_are_not_needed(tmp_path):
    control = "SOL 111\ninclude '../nowhere.v9'\nCEND\nTITLE = x\nBEGIN BULK\n"
    (deck := tmp_path / "a.dat").write_text(control + "GRID,1,,2.0,3.0,0.0\nINCLUDE 'more.bdf'\n")
    (tmp_path / "more.bdf").write_text("GRID,2,,4.0,3.0,0.0\n")
    assert sorted(read_coordinates(deck)) == [1, 2]
    (tmp_path / "more.bdf").unlink()
    with pytest.raises(InputError, match=r"put it beside a\.dat"):
        read_coordinates(deck)


def test_a_study_is_imported_from_a_deck_in_two_files(tmp_path):
    """Real export: the solid of CalculiX, whose nodes and elements are moved into a file of their own."""
    text = (EXPORTS / "solid.inp").read_text()
    first, last = text.index("*NODE"), text.index("*MATERIAL")
    (tmp_path / "mesh.inc").write_text(text[first:last].lower())
    (tmp_path / "solid.inp").write_text(f"{text[:first]}*include,input=mesh.inc\n{text[last:]}")
    for suffix in (".sti", ".mas", ".dof"):
        (tmp_path / f"solid{suffix}").write_bytes((EXPORTS / f"solid{suffix}").read_bytes())
    found, whole = read_matrices([tmp_path / "solid.sti"]), read_matrices([EXPORTS / "solid.sti"])
    assert found.lines == whole.lines and found.sets == whole.sets and found.dofs.equals(whole.dofs)


def test_a_keyword_line_goes_on_behind_a_comma():
    text = "*Element, type=B31,\n elset = frame arm\n7, 1, 2\n*elset, elset=ALL, generate\n7, 7,\n"
    assert element_sets(text) == {"FRAMEARM": {1, 2}, "ALL": {1, 2}}


PARTS = """*Heading
*Part, name=Arm
*Node
 1, 1., 0., 0.
 2, 3., 0., 0.
*Element, type=B31, elset=E
1, 1, 2
*End Part
*Part, name=Unused
*Node
 1, 9., 9., 9.
*End Part
*Assembly, name=A
*Instance, name=Arm-1, part=Arm
 1., 0., 0.
 0., 0., 0., 0., 0., 1., 90.
*End Instance
*Node
 500, 5., 5., 5.
*End Assembly
"""


def test_the_nodes_of_one_instance_stand_where_it_does(tmp_path):
    """Moved by 1 along x, then turned by 90 degrees about z; a reference node of the assembly stays."""
    (deck := tmp_path / "cae.inp").write_text(PARTS)
    found = read_coordinates(deck, 1e-3)
    assert {node: pytest.approx(place, abs=1e-12) for node, place in found.items()} == {
        1: (0.0, 2e-3, 0.0), 2: (0.0, 4e-3, 0.0), 500: (5e-3, 5e-3, 5e-3)
    }  # fmt: skip
    deck.write_text(
        PARTS.replace("*End Instance\n*Node", "*End Instance\n*Instance, name=B, part=Arm\n*End Instance\n*Node")
    )
    with pytest.raises(InputError, match="2 part instances"):
        read_coordinates(deck)


@pytest.mark.parametrize("line", ["*NGEN, NSET=A\n1, 9\n", "*nfill\nA, B, 2\n", "*NCOPY, CHANGE NUMBER=9\n"])
def test_nodes_that_a_deck_makes_are_refused(line, tmp_path):
    (deck := tmp_path / "deck.inp").write_text(f"*NODE\n1, 0, 0, 0\n9, 8, 0, 0\n{line}")
    with pytest.raises(InputError, match="makes or moves nodes"):
        read_coordinates(deck)


# -- directions of nodes -----------------------------------------------------------------------------------------------


def test_systems_within_systems_have_the_motions_of_nastran():
    """Real: Nastran's own RBE3 among nodes in nested Cartesian, cylindrical and spherical systems (pyYeti's tests).

    Its matrix gives the motion of a node by those of others, in their own axes, and keeps rigid-body motions.
    """
    text = (EXPORTS / "rbe3.bdf").read_text()
    rows = loadmat(EXPORTS / "rbe3.mat")["uset"][0, 0]["k0"]
    rigid_element = loadmat(EXPORTS / "rbe3.mat")["gm"][0, 0]["k0"]
    places, unknown = placed_nodes(text)
    axes = axes_of(Path("rbe3.bdf"), text)
    motions = []
    for node, (x, y, z) in zip(rows[::6, 0].astype(int), rows[::6, 3:], strict=True):
        assert places[node] == pytest.approx((x, y, z), rel=1e-12, abs=1e-9)
        rigid = np.eye(6)
        rigid[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        motions.append(np.kron(np.eye(2), axes.get(node, np.eye(3)).T) @ rigid)
    assert not unknown and len(motions) == 17 and len(axes) == 16
    led = list(rows[::6, 0].astype(int)).index(124)
    others = np.vstack(motions[:led] + motions[led + 1 :])
    assert rigid_element @ others == pytest.approx(motions[led], abs=1e-9)


def test_grdset_and_systems_by_nodes_count():
    text = (
        "GRDSET,,4,,,,4\nCORD1C,4,10,11,12\nGRID,10,0,1.,0.,0.,-1\nGRID,11,0,1.,0.,5.,-1\nGRID,12,0,2.,0.,0.,-1\n"
        "GRID,7,,2.,90.,3.\nGRID,8,,0.,0.,3.\n"
    )
    places, _ = placed_nodes(text)
    assert places[7] == pytest.approx([1.0, 2.0, 3.0]) and places[8] == pytest.approx([1.0, 0.0, 3.0])
    axes = axes_of(Path("a.bdf"), text)
    assert axes[7] == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-12)
    assert axes[8] == pytest.approx(np.eye(3)) and set(axes) == {7, 8}  # on the axis: the Cartesian ones


def test_entries_that_a_line_repeats_are_refused(tmp_path):
    (deck := tmp_path / "deck.bdf").write_text("GRID,1,,0.,0.,0.\n=,*1,,*10.,==\n=8220\n")
    with pytest.raises(InputError, match="repeats an entry"):
        read_coordinates(deck)


def test_transforms_of_calculix_leave_printed_motions_out_that_are_not_global(tmp_path):
    """Real listing: CalculiX marks nodes in local directions by L, the default of *NODE PRINT."""
    text = (
        "\n     E I G E N V A L U E   O U T P U T\n\n MODE NO    EIGENVALUE                       FREQUENCY   \n\n"
        "      1   0.6245016E+08   0.7902541E+04   0.1257728E+04   0.0000000E+00\n\n"
        "                    E I G E N V A L U E    N U M B E R     1\n\n"
        " displacements (vx,vy,vz) for set NALL and time  0.1000000E+01\n\n"
        "         8 -1.879927E+01 -8.243668E+00  1.320666E+02\n"
        "         9 -9.591118E+00 -3.527690E+01  4.196228E+02 L\n"
    )
    (listing := tmp_path / "modes.dat").write_text(text)
    found = read_fe_modes(listing)
    assert {s.node for s in found.sensors} == {8} and any("9" in note and "GLOBAL=YES" in note for note in found.notes)
    listing.write_text(text.replace(" L\n", "\n"))  # as Abaqus prints it
    assert {s.node for s in read_fe_modes(listing).sensors} == {8, 9}
    deck = "*NODE\n8,0,0,0\n9,1,0,0\n*NSET,NSET=TIP\n9\n*TRANSFORM, TYPE=R, NSET=TIP\n0,1,0,-1,0,0\n"
    deck += "*NODE PRINT, NSET=A{}\nU\n"
    (given := tmp_path / "deck.inp").write_text(deck.format(""))
    assert {s.node for s in read_fe_modes(listing, coordinates=given).sensors} == {8}
    given.write_text(deck.format(", GLOBAL=YES"))
    assert {s.node for s in read_fe_modes(listing, coordinates=given).sensors} == {8, 9}


def test_supports_in_directions_of_their_own_hold_no_global_one():
    text = "*NSET,NSET=A\n1,2\n*TRANSFORM,NSET=A\n.6,.8,0,-.8,.6,0\n*BOUNDARY\n1,1,3\n2,2\n3,2\n"
    assert transformed_nodes(text) == {1, 2}
    assert held_motions(text) == {(1, 1), (1, 2), (1, 3), (3, 2)}


# -- rows of OUTPUT4 ---------------------------------------------------------------------------------------------------


def test_the_boundary_of_a_deck_names_the_rows_as_its_punch_does():
    """Real: BSET1 and QSET1 of the deck that wrote inboard.op4, with an included file, and EXTRN of the punch."""
    own, punched = analysis_set(deck_text(EXPORTS / "inboard.bdf")), analysis_set((EXPORTS / "inboard.pch").read_text())
    assert own.tolist() == punched.tolist() and len(own) == 32
    found = read_matrices([EXPORTS / "inboard.op4", EXPORTS / "inboard.bdf"])
    other = read_matrices([EXPORTS / "inboard.op4", EXPORTS / "inboard.pch"])
    assert found.dofs[["node", "direction"]].equals(other.dofs[["node", "direction"]])
    assert found.matrices["mass"]["MXX"].toarray() == pytest.approx(other.matrices["mass"]["MXX"].toarray())


def output4(**matrices):
    """Text of OUTPUT4 after its description: columns of rows without gaps."""
    out = []
    for name, one in matrices.items():
        out.append(f"{one.shape[1]:8d}{one.shape[0]:8d}{6:8d}{2:8d}{name:8}1P,3E23.16")
        for j, column in enumerate(one.T if one.any() else [], start=1):
            out.append(f"{j:8d}{1:8d}{len(column):8d}")
            out += ["".join(f"{v:23.16E}" for v in column[k : k + 3]) for k in range(0, len(column), 3)]
        out += [f"{one.shape[1] + 1:8d}{1:8d}{1:8d}", f"{1.0:23.16E}"]
    return "\n".join(out) + "\n"


def test_all_motions_of_a_deck_name_the_rows_of_kgg(tmp_path):
    stiffness, mass = np.diag(np.arange(1.0, 14.0)), np.eye(13)
    (file := tmp_path / "m.op4").write_text(output4(KGG=stiffness, MGG=mass, MASMX=np.zeros((1, 1))))
    (deck := tmp_path / "m.bdf").write_text("GRID,7,,1.,2.,3.\nSPOINT,5\nGRID,3,,0.,0.,0.\n")
    found = read_matrices([file, deck])
    assert all_motions(deck.read_text())[[0, 6, 7]].tolist() == [[3, 1], [5, 0], [7, 1]]
    assert found.dofs["node"].tolist()[5] == 3 and found.dofs["node"].isna().tolist() == [k == 6 for k in range(13)]
    assert list(found.matrices["mass"]) == ["MGG"] and any("MASMX, a mass of one row" in note for note in found.notes)
    deck.write_text(deck.read_text() + "SEQGP,3,12.\n")
    with pytest.raises(InputError, match=r"13 rows.*--dofs"):
        read_matrices([file, deck])


# -- meshes ------------------------------------------------------------------------------------------------------------


def test_both_forms_of_gmsh_hold_one_mesh():
    """Real: Gmsh 4.2.2, of meshio's tests: 111 triangles in two groups and 21 lines in one."""
    old, new = (read_element_mesh(EXPORTS / f"insulated-{version}.msh") for version in ("2.2", "4.1"))
    assert {name: len(own) for name, own in old.groups.items()} == {"convection": 21, "wire": 45, "insulation": 66}
    of_kinds = [len(one.nodes) for one in old.elements]
    assert of_kinds.count(3) == 111 and of_kinds.count(2) == 21
    assert old.points == {node: pytest.approx(place) for node, place in new.points.items()} and old.groups == new.groups
    assert [one.nodes for one in old.elements] == [one.nodes for one in new.elements]


def test_a_binary_mesh_is_refused(tmp_path):
    (file := tmp_path / "a.msh").write_text("$MeshFormat\n4.1 1 8\n$EndMeshFormat\n")
    with pytest.raises(InputError, match=r"binary.*save it as text"):
        read_coordinates(file)


def universal(units=True):
    """A mesh in mm after the description of the datasets: a beam, a shell of eight nodes, a group of the shell."""
    nodes = {k: (10.0 * k, 5.0 * (k % 2), 0.0) for k in range(1, 11)}
    out = ["    -1", "   164", "         5mm (milli-newton)             2", "  1.0000000000000000D+03" * 3,
           "  0.0000000000000000D+00", "    -1"] if units else []  # fmt: skip
    out += ["    -1", "  2411"]
    for k, place in nodes.items():
        out += [f"{k:10d}{1:10d}{1:10d}{11:10d}", "".join(f"{v:25.16E}".replace("E", "D") for v in place)]
    out += ["    -1", "    -1", "  2412",
            f"{1:10d}{21:10d}{2:10d}{1:10d}{7:10d}{2:10d}", f"{0:10d}{1:10d}{1:10d}", f"{9:10d}{10:10d}",
            f"{2:10d}{95:10d}{3:10d}{1:10d}{7:10d}{8:10d}", "".join(f"{k:10d}" for k in range(1, 9)), "    -1",
            "    -1", "  2467", "".join(f"{v:10d}" for v in (1, 0, 0, 0, 0, 0, 0, 3)), "floor",
            "".join(f"{v:10d}" for v in (8, 2, 0, 0, 7, 9, 0, 0)), "".join(f"{v:10d}" for v in (7, 10, 0, 0)),
            "    -1"]  # fmt: skip
    return "\n".join(out) + "\n"


@pytest.mark.parametrize("units", [True, False])
def test_a_universal_file_has_nodes_edges_and_groups(units, tmp_path):
    (file := tmp_path / "mesh.unv").write_text(universal(units))
    assert read_coordinates(file, 1e-3)[9] == pytest.approx((0.09, 0.005, 0.0))
    mesh = read_element_mesh(file, 1e-3)
    assert mesh.groups == {"floor": {2}} and [one.group for one in mesh.elements] == ["property 2", "property 3"]
    shell = [(mesh.elements[1].nodes[i], mesh.elements[1].nodes[j]) for i, j in mesh.elements[1].edges]
    assert shell == [(1, 3), (3, 5), (5, 7), (7, 1)]


def test_the_sets_of_a_mesh_reach_the_import(tmp_path):
    (mesh := tmp_path / "mesh.unv").write_text(universal())
    np.savez(tmp_path / "km.npz", K=np.diag(np.arange(1.0, 11.0)), M=np.eye(10), dofs=[[k, 3] for k in range(1, 11)])
    found = read_matrices([tmp_path / "km.npz", mesh])
    assert found.sets["floor"] == tuple(range(1, 9)) and found.sets["property 2"] == (9, 10)
    assert (9, 10) in found.lines and found.dofs["x"].tolist()[8] == pytest.approx(0.09)


def test_measured_modes_are_no_mesh(tmp_path):
    np.savez(tmp_path / "km.npz", K=np.eye(2), M=np.eye(2), dofs=[[1, 3], [2, 3]])
    (tmp_path / "test.uff").write_text(universal().split("    -1\n    -1\n  2412")[0] + "    -1\n")
    with pytest.raises(InputError, match="--measured"):
        read_matrices([tmp_path / "km.npz", tmp_path / "test.uff"])


@pytest.mark.parametrize(
    "line",
    [
        "GRID           7            1.5   -2.+0     3.-1", "GRID,7,,1.5,-2.0,.3",
        "GRID*                  7                             1.5            -2.0\n*                    0.3",
    ],
)  # fmt: skip
def test_nodes_of_nastran_decks(tmp_path, line):
    (path := tmp_path / "deck.bdf").write_text(f"$ comment\nBEGIN BULK\n{line}\nENDDATA\n")
    assert read_coordinates(path, 1e-3)[7] == pytest.approx((1.5e-3, -2e-3, 0.3e-3))


@pytest.mark.parametrize(
    ("name", "lines", "place"),
    [
        ("a.bdf", "GRID,5,,1200.,0.,300.\nGRID,5,,12{}0.,0.,300.\n", "GRID 5"),
        ("a.inp", "*NODE\n5, 1200., 0., 300.\n5, 12{}0., 0., 300.\n", "node 5"),
        ("a.cdb", "NBLOCK,6,SOLID\n(3i9,6e21.13e3)\n" + f"{5:9d}{0:9d}{0:9d}{1200.0:21.13e}\n{5:9d}{0:9d}{0:9d}"
         "{:>21}\n", "node 5"),
        ("a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n2\n5 1200. 0 300\n5 12{}0. 0. 300\n$EndNodes\n"
         "$Elements\n0\n$EndElements\n", "node 5"),
    ],
)  # fmt: skip
def test_a_node_at_two_places_is_refused(name, lines, place, tmp_path):
    (tmp_path / name).write_text(lines.format("1200.0" if name == "a.cdb" else "0"))
    assert read_coordinates(tmp_path / name)[5][0] == 1200.0
    (tmp_path / name).write_text(lines.format("1250.0" if name == "a.cdb" else "5"))
    with pytest.raises(InputError, match=f"{place}.* is there twice, at"):
        read_coordinates(tmp_path / name)


def test_nodes_in_local_systems_are_refused(tmp_path):
    (path := tmp_path / "deck.bdf").write_text("GRID           7       3     1.5     0.0     0.0\n")
    with pytest.raises(InputError, match="local"):
        read_coordinates(path)
