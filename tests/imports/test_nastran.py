"""Nastran's matrices: real exports of every form of OUTPUT4, a real DMIG punch, a superelement in axes of its own."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports import op4
from calib.imports.matrices import read_matrices
from calib.imports.nastran import read_dmig
from calib.imports.op4 import StoredStrings, read_op4, taken
from calib.imports.systems import analysis_set, axes_of, turned_into_global

EXPORTS = Path(__file__).parent / "exports"


def entries(name):
    """Matrices of an OUTPUT4 file of any shape, dense."""
    raw = (EXPORTS / f"{name}.op4").read_bytes()
    assert op4.is_op4(raw)
    found = op4._binary(raw) if op4._order(raw) else op4._text(raw.decode("latin-1").splitlines())
    out = []
    for one in found:
        full = np.zeros((one.n_rows, one.n_columns), dtype=complex if one.kind > 2 else float)
        for row, column, values in one.strings:
            values = values[::2] + 1j * values[1::2] if one.kind > 2 else values
            full[row : row + len(values), column] = values
        out.append(full)
    return out


@pytest.mark.parametrize(
    ("one", "another", "digits"),
    [
        ("rd", "rdbin", 1e-15),
        ("rs", "rsbin", 1e-6),
        ("big_bigmat_ascii", "big_bigmat_binary", 1e-8),
        ("big_dense_ascii", "big_dense_binary", 1e-8),
        ("big_bigmat_binary", "big_dense_binary", 1e-15),
        ("single_nonbigmat_le", "double_nonbigmat_be_i64", 1e-6),
        ("double_bigmat_ascii_d", "double_nonbigmat_be_i64", 1e-8),
    ],
)
def test_forms_of_output4_hold_the_same_matrices(one, another, digits):
    first, second = entries(one), entries(another)
    assert len(first) == len(second) > 0
    assert sum(np.count_nonzero(a) for a in first) > 3
    for a, b in zip(first, second, strict=True):
        assert a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=digits, atol=digits * np.abs(b).max())


@pytest.mark.parametrize("cut", [20, 100, 1000, 4000])
def test_an_output4_file_that_is_cut_off_is_refused(cut, tmp_path):
    raw = (EXPORTS / "inboard.op4").read_bytes()
    with pytest.raises(InputError, match="cut off"):
        read_op4(tmp_path / "k.op4", raw[:-cut])


def test_a_file_without_square_matrices_is_refused():
    with pytest.raises(InputError, match=r"no square real matrix.*VA \(2 rows, 1 columns\)"):
        taken(Path("all.op4"), [StoredStrings("VA", 2, 1, 2, [])])


def test_matrices_beside_stiffness_and_mass_are_left_out_and_told():
    one = np.array([2.0])
    square = StoredStrings("KAA", 2, 2, 2, [(0, 0, one), (1, 1, one)])
    (kept,), (words,) = taken(Path("all.op4"), [square, replace(square, name="VA", n_columns=1, strings=[]),
                                                replace(square, name="K4", kind=4)])  # fmt: skip
    assert kept.name == "KAA" and kept.matrix.toarray().tolist() == [[2, 0], [0, 2]]
    assert "VA" in words and "K4" in words and "KAA" not in words


def test_a_damping_of_one_row_is_none(tmp_path):
    for name, entry in (("K", "1 1 2.0\n2 2 3.0"), ("M", "1 1 1.0\n2 2 1.0")):
        (tmp_path / f"{name}.mtx").write_text(entry)
    lines = [f"{1:8d}{1:8d}{2:8d}{1:8d}{'B':8}1P,3E23.16", f"{1:8d}{1:8d}{1:8d}", f"{0.0:23.16E}"]
    (tmp_path / "all.op4").write_text("\n".join([*lines, f"{2:8d}{1:8d}{1:8d}", f"{1.0:23.16E}", ""]))
    (tmp_path / "rows.csv").write_text("node,direction\n1,x\n2,x\n")
    files, dofs = [tmp_path / name for name in ("K.mtx", "M.mtx", "all.op4")], tmp_path / "rows.csv"
    found = read_matrices(files, dofs=dofs)
    assert not found.matrices["damping"] and any("B" in note for note in found.notes)
    with pytest.raises(InputError, match="1 rows"):
        read_matrices(files, dofs=dofs, chosen={"damping": ["B"]})


def test_a_real_punch_names_its_rows_with_scalar_points_among_them():
    (found,), notes = read_dmig(EXPORTS / "ident.pch", (EXPORTS / "ident.pch").read_text())
    assert found.name == "IDENT" and notes == () and found.matrix.toarray().tolist() == np.eye(21).tolist()
    assert found.labels[:6].tolist() == [[1, d] for d in range(1, 7)] and found.labels[-3:].tolist() == [
        [10, 0], [11, 0], [12, 0]
    ]  # fmt: skip


def test_narrow_fields_with_two_entries_a_line_and_numbers_without_letter(tmp_path):
    text = (
        "DMIG    STIF    0       6       1       0\n"
        "DMIG    STIF    27      1               27      1       2.5+3   0.      +A\n"
        "+A      27      3       -1.5+3          30              4.-2\n"
        "DMIG    STIF    30      0               30      0       7.\n"
        "ENDDATA\n"
    )
    (found,), _ = read_dmig(tmp_path / "a.bdf", text)
    assert found.labels.tolist() == [[27, 1], [27, 3], [30, 0]]
    assert found.matrix.toarray() == pytest.approx(np.array([[2500.0, 0, 0], [-1500, 0, 0], [0.04, 0, 7]]))


def test_complex_and_rectangular_matrices_are_told_apart(tmp_path):
    head = "DMIG    LOAD    0       9       1       0                       1\n"
    head += "DMIG    LOAD    1       1               5       1       3.\n"
    found, notes = read_dmig(tmp_path / "a.pch", head)
    assert not found and "LOAD" in notes[0]
    with pytest.raises(InputError, match=r"line 2.*complex"):
        read_dmig(tmp_path / "a.pch", head.replace("9       1", "1       3").replace("3.", "3.      1."))


@pytest.fixture
def superelement(tmp_path):
    for name in ("inboard.op4", "inboard.pch"):
        shutil.copy(EXPORTS / name, tmp_path)
    return [tmp_path / "inboard.op4", tmp_path / "inboard.pch"]


def rigid(found):
    """Six rigid-body motions at the rows of nodes, (n_dof, 6), in global axes."""
    motions = np.zeros((len(found.dofs), 6))
    for k, (node, direction, *place) in enumerate(found.dofs.to_numpy(dtype=float, na_value=np.nan)):
        if np.isfinite(node):
            d, arm = int(direction) - 1, np.array(place)
            axis = np.eye(3)[d % 3]
            motions[k, 3:] = axis if d >= 3 else np.cross(arm, axis)
            motions[k, :3] = 0.0 if d >= 3 else axis
    return motions


def test_a_superelement_of_which_a_node_has_axes_of_its_own_is_free(superelement):
    found = read_matrices(superelement)
    assert len(found.dofs) == 32 and found.dofs["node"].isna().sum() == 8  # amplitudes of component modes
    assert any("turned" in note and note.endswith(" 1.") for note in found.notes)
    stiffness, mass = (next(iter(found.matrices[kind].values())).toarray() for kind in ("stiffness", "mass"))
    motions = rigid(found)
    assert np.abs(stiffness @ motions).max() < 1e-6 * np.abs(stiffness).max()
    inertia = motions.T @ mass @ motions
    assert np.diag(inertia)[:3] == pytest.approx(1.7551, rel=1e-4) and np.abs(inertia[0, 1]) < 1e-6
    superelement[1].write_text(superelement[1].read_text().replace("             10       ", "              0       "))
    unturned = next(iter(read_matrices(superelement).matrices["stiffness"].values())).toarray()
    assert unturned == pytest.approx(stiffness) or np.abs(unturned @ motions).max() > 1e-3 * np.abs(stiffness).max()


def test_axes_follow_from_the_points_of_a_system():
    text = "CORD2R  5       0       0.      0.      0.      0.      0.      1.\n"
    text += "        0.      1.      0.\nGRID    7       0       1.      2.      3.      5\n"
    axes = axes_of(Path("a.bdf"), text)[7]
    assert axes == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], dtype=float))
    radial = np.array([1, 2, 0]) / np.sqrt(5)
    around = np.array([-2, 1, 0]) / np.sqrt(5)
    turned = axes_of(Path("a.bdf"), text.replace("CORD2R", "CORD2C"))[7]
    assert turned == pytest.approx(np.column_stack([radial, around, [0, 0, 1]]))
    with pytest.raises(InputError, match="system 6"):
        axes_of(Path("a.bdf"), text.replace("3.      5", "3.      6"))


def test_a_node_with_two_directions_cannot_be_turned(tmp_path):
    (tmp_path / "k.pch").write_text(
        "CORD2R  5       0       0.      0.      0.      0.      0.      1.\n        0.      1.      0.\n"
        "GRID    7       0       1.      2.      3.      5\n"
        + "".join(
            f"DMIG    {name}AA     0       6       1       0\n"
            + "".join(f"DMIG    {name}AA     7       {d}               7       {d}       1.\n" for d in (1, 2))
            for name in "KM"
        )
    )
    with pytest.raises(InputError, match=r"node 7 .* 2 of three"):
        read_matrices([tmp_path / "k.pch"])


def test_rows_of_the_analysis_set():
    assert analysis_set("ASET1   12      5       THRU    7\nASET    3       3\n").tolist() == [
        [3, 3], [5, 1], [5, 2], [6, 1], [6, 2], [7, 1], [7, 2]
    ]  # fmt: skip
    assert analysis_set("GRID    1\n") is None


def test_sizes_must_agree_with_the_rows(superelement):
    text = superelement[1].read_text()
    superelement[1].write_text(text.replace(" 2995008       0", "", 1))
    with pytest.raises(InputError, match="--dofs"):
        read_matrices(superelement)


def test_a_triangle_is_completed_before_it_is_turned():
    rows = pd.DataFrame({"node": [1, 1, 1, None], "direction": [1, 2, 3, None]})
    full = np.array([[4.0, 1, 0, 2], [1, 3, 1, 0], [0, 1, 5, 0], [2, 0, 0, 6]])
    axes = {1: np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])}
    turn = np.eye(4)
    turn[:3, :3] = axes[1]
    for given in (full, np.tril(full), np.triu(full)):
        found, count = turned_into_global({"stiffness": {"K": sp.coo_array(given)}}, rows, axes, Path("a.pch"))
        assert count == 1 and found["stiffness"]["K"].toarray() == pytest.approx(turn @ full @ turn.T)
