"""Matrices of finite-element codes: real exports where there are, else written here after the formats' descriptions.

Each form holds the solid that CalculiX exported, so that all of them give its matrices.
"""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io
import scipy.sparse as sp

import calib
from calib.errors.errors import InputError
from calib.imports.matrices import read_matrices
from calib.imports.stored import matrix_kind

EXPORTS = Path(__file__).parent / "exports"


def table(file):
    rows, columns, values = np.loadtxt(EXPORTS / file).T
    half = sp.coo_array((values, (rows.astype(int) - 1, columns.astype(int) - 1)), shape=(42, 42)).toarray()
    return half + half.T - np.diag(half.diagonal())


K, M = table("solid.sti"), table("solid.mas")
NAMES = [tuple(map(int, line.split("."))) for line in (EXPORTS / "solid.dof").read_text().split()]


def whole(found, kind):
    (one,) = found.matrices[kind].values()
    out = one.toarray()
    return out if np.allclose(out, out.T) else out + out.T - np.diag(out.diagonal())


def triangle(matrix):
    rows, columns = np.nonzero(np.tril(matrix))
    return rows, columns, matrix[rows, columns]


# -- one writer a form: files, and further arguments ------------------------------------------------------------------


def dofs_table(home):
    pd.DataFrame(NAMES, columns=["node", "direction"]).to_csv(home / "rows.csv", index=False)
    return {"dofs": home / "rows.csv"}


def calculix(home):
    for suffix in ("sti", "mas", "dof"):
        shutil.copy(EXPORTS / f"solid.{suffix}", home)
    return [home / "solid.sti"], {}


def abaqus_labels(home):
    for name, matrix in (("beam_STIF2.mtx", K), ("beam_MASS2.mtx", M)):
        lines = [
            f"{NAMES[i][0]},{NAMES[i][1]}, {NAMES[j][0]},{NAMES[j][1]}, {v:.14e}"
            for i, j, v in zip(*triangle(matrix), strict=True)
        ]
        (home / name).write_text("\n".join(lines) + "\n")
    return [home / "beam_STIF2.mtx", home / "beam_MASS2.mtx"], {}


def abaqus_coordinates(home):
    for name, matrix in (("beam_STIF2.mtx", K), ("beam_MASS2.mtx", M)):
        (home / name).write_text(
            "\n".join(f"{i + 1} {j + 1} {v:.14e}" for i, j, v in zip(*triangle(matrix), strict=True))
        )
    return [home / "beam_STIF2.mtx", home / "beam_MASS2.mtx"], dofs_table(home)


def matrix_market(home):
    for name, matrix in (("matk.txt", K), ("matm.txt", M)):
        with (home / name).open("wb") as file:
            scipy.io.mmwrite(file, sp.coo_array(matrix), symmetry="symmetric")
    return [home / "matk.txt", home / "matm.txt"], dofs_table(home)


def matlab(home):
    packed = np.array([node + direction / 100 for node, direction in NAMES])[:, None]
    scipy.io.savemat(home / "beam.mat", {"K": sp.csc_array(K), "M": M, "MDOF": packed, "note": "text"})
    return [home / "beam.mat"], {}


def numpy_archive(home):
    np.savez(home / "beam.npz", stiffness=K, mass=np.tril(M), dofs=np.array(NAMES, dtype=float))
    return [home / "beam.npz"], {}


def dmig(home, wide=True):
    out = ["$ punched"]
    for node in dict.fromkeys(node for node, _ in NAMES):
        out += [f"GRID*   {node:16d}               0{10.0 * node:16.9E} 0.000000000E+00", "*        0.0"]
    for name, matrix in (("KAAX", K), ("MAAX", M)):
        out.append(f"DMIG    {name:8}       0       6       2       0                {len(NAMES):8d}")
        for j, (node, direction) in enumerate(NAMES):
            below = [i for i in range(j, len(NAMES)) if matrix[i, j] != 0]
            if wide:
                out.append(f"DMIG*   {name:16}{node:16d}{direction:16d}")
                out += [f"*       {NAMES[i][0]:16d}{NAMES[i][1]:16d}{fortran(matrix[i, j]):>16}" for i in below]
            else:
                out += [
                    f"DMIG,{name},{node},{direction},,{NAMES[i][0]},{NAMES[i][1]},{matrix[i, j]:.12e}," for i in below
                ]
    (home / "beam.pch").write_text("\n".join(out) + "\n")
    return [home / "beam.pch"], {}


def fortran(value):
    return f"{value:.9e}".replace("e", "D")


def harwell_boeing(home, kind="RSA"):
    for name, matrix in (("beam_stiff.matrix", K), ("beam_mass.matrix", M)):
        held = sp.csc_array(np.tril(matrix) if kind == "RSA" else matrix)
        counts = [cut(held.indptr + 1, 10, "{:8d}"), cut(held.indices + 1, 10, "{:8d}")]
        values = cut(held.data, 4, "{:20.13E}")
        right = cut(np.zeros(42), 4, "{:20.13E}")
        sizes = [len(one) for one in (*counts, values, right)]
        head = [f"{'a model':72}{'KEY':8}", "".join(f"{n:14d}" for n in (sum(sizes), *sizes)),
                f"{kind:14}{42:14d}{42:14d}{held.nnz:14d}{0:14d}",
                f"{'(10I8)':16}{'(10I8)':16}{'(1P,4E20.13)':20}{'(4D20.13)':20}",
                f"{'F':14}{1:14d}{0:14d}"]  # fmt: skip
        text = "\n".join([*head, *counts[0], *counts[1], *values, *right])
        (home / name).write_text(text.replace("E-", "D-").replace("E+", "D+"))
    lines = ["  Matrix Eqn       Node      DOF"]
    labels = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    lines += [f"{k + 1:10d} {node:10d}      {labels[direction - 1]}" for k, (node, direction) in enumerate(NAMES)]
    (home / "beam_stiff.mapping").write_text("\n".join(lines) + "\n")
    return [home / "beam_stiff.matrix", home / "beam_mass.matrix"], {}


def cut(numbers, per_line, form):
    cells = [form.format(one) for one in numbers]
    return ["".join(cells[k : k + per_line]) for k in range(0, len(cells), per_line)]


FORMS = {
    "CalculiX": calculix, "Abaqus labels": abaqus_labels, "Abaqus coordinates": abaqus_coordinates,
    "Matrix Market": matrix_market, "MATLAB": matlab, "npz": numpy_archive, "DMIG": dmig,
    "DMIG free": lambda home: dmig(home, wide=False), "RSA": harwell_boeing,
    "RUA": lambda home: harwell_boeing(home, "RUA"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_matrices_and_the_names_of_their_rows(form, tmp_path):
    files, more = FORMS[form](tmp_path)
    found = read_matrices(files, **more)
    rows = {(int(node), int(d)): k for k, (node, d) in enumerate(found.dofs[["node", "direction"]].to_numpy())}
    assert sorted(rows) == sorted(NAMES)
    order = [rows[name] for name in NAMES]
    for kind, wanted in (("stiffness", K), ("mass", M)):
        assert whole(found, kind)[np.ix_(order, order)] == pytest.approx(wanted, rel=1e-9, abs=1e-9 * abs(wanted).max())


@pytest.mark.parametrize(
    ("name", "kind"),
    [("K", "stiffness"), ("KAAX", "stiffness"), ("job-1_STIF2", "stiffness"), ("beam_k", "stiffness"), ("MXX", "mass"),
     ("K1", "stiffness"), ("job_MASS2", "mass"), ("part_b_mass", "mass"), ("K4AAX", "structural damping"),
     ("BAAX", "damping"), ("job_DMPV2", "damping"), ("C", "damping"), ("front_c", ""), ("foo", "")],
)  # fmt: skip
def test_names_tell_what_a_matrix_is(name, kind):
    assert matrix_kind(name) == kind


def test_tables_among_the_files_name_rows_and_places(tmp_path):
    files, more = matrix_market(tmp_path)
    nodes = dict.fromkeys(node for node, _ in NAMES)
    pd.DataFrame({"node": list(nodes), "x": 0.5, "y": 0.0, "z": 0.0}).to_csv(tmp_path / "places.csv", index=False)
    found = read_matrices([*files, more["dofs"], tmp_path / "places.csv"], metres=1e-3)
    assert found.dofs["x"].unique().tolist() == [500.0] and len(found.dofs) == len(NAMES)


def test_matrices_with_other_names_are_chosen(tmp_path):
    np.savez(tmp_path / "beam.npz", A=0.25 * K, A2=0.75 * K, B3=M, dofs=np.array(NAMES))
    with pytest.raises(InputError, match="A2"):
        read_matrices([tmp_path / "beam.npz"])
    found = read_matrices([tmp_path / "beam.npz"], chosen={"stiffness": ["A", "a2"], "mass": ["B3"]})
    assert list(found.matrices["stiffness"]) == ["A", "A2"]
    assert sum(found.matrices["stiffness"].values()).toarray() == pytest.approx(K)
    with pytest.raises(InputError, match="B4"):
        read_matrices([tmp_path / "beam.npz"], chosen={"stiffness": ["A"], "mass": ["B4"]})


def test_a_matrix_that_lacks_or_is_there_twice_is_told_with_its_file(tmp_path):
    shutil.copy(EXPORTS / "solid.sti", tmp_path)
    with pytest.raises(InputError, match=r"solid\.mas, the mass, is not beside it"):
        read_matrices([tmp_path / "solid.sti"])
    np.savez(tmp_path / "k.npz", K=K, dofs=np.array(NAMES, dtype=float))
    with pytest.raises(InputError, match="give the file that has the mass"):
        read_matrices([tmp_path / "k.npz"])
    np.savez(tmp_path / "both.npz", K=K[:2, :2])
    with pytest.raises(InputError, match=r"two matrices 'K', of 42 and 2 rows"):
        read_matrices([tmp_path / "k.npz", tmp_path / "both.npz"])
    np.savez(tmp_path / "both.npz", K=K[:2, :2], M=np.eye(2), dofs=np.array(NAMES, dtype=float)[:2])
    np.savez(tmp_path / "k.npz", K=K, M=np.eye(len(K)), dofs=np.array(NAMES, dtype=float))
    for rows in (2, len(K)):
        files, chosen = [tmp_path / "k.npz", tmp_path / "both.npz"], {"stiffness": [f"K:{rows}"]}
        read = read_matrices(files, chosen=chosen, dofs=None)
        assert [len(read.dofs), read.matrices["mass"]["M"].shape[0]] == [rows, rows]
    with pytest.raises(InputError, match="K:42, M:42, K:2, M:2"):
        read_matrices(files, chosen={"stiffness": ["K:7"]})
    (tmp_path / "job.full").write_bytes(b"\0\1\2\3" * 20)
    with pytest.raises(InputError, match="ansys-mapdl-reader"):
        read_matrices([tmp_path / "job.full"])


def test_rows_of_the_code_itself_keep_no_node():
    found = read_matrices([EXPORTS / "solid.sti"])  # .mas, .dof and .inp lie beside it
    own = found.dofs["node"].isna().to_numpy()
    assert own.sum() == 18 and found.dofs.loc[~own, ["x", "y", "z"]].notna().all(axis=None)
    assert any("18" in note and "13 to 18" in note for note in found.notes) and found.layers is None
    assert read_matrices([EXPORTS / "shell.sti"]).layers == "mean"


def test_rows_that_a_large_number_holds_are_fixed(tmp_path):
    held, bare = K.copy(), M.copy()
    held[3], held[:, 3], bare[3], bare[:, 3] = 0.0, 0.0, 0.0, 0.0
    held[3, 3] = 1e36
    np.savez(tmp_path / "beam.npz", K=held, M=bare, dofs=np.array(NAMES))
    found = read_matrices([tmp_path / "beam.npz"])
    assert len(found.dofs) == 41 and found.matrices["stiffness"]["K"].max() < 1e12
    assert found.dofs.to_numpy().tolist() == [list(name) for k, name in enumerate(NAMES) if k != 3]


def test_internal_nodes_of_abaqus_are_rows_of_no_node(tmp_path):
    files, _ = abaqus_labels(tmp_path)
    text = files[0].read_text()
    files[0].write_text(text + "-1,1, -1,1, 5.0\n0,1, -1,1, 1.0\n")
    found = read_matrices(files)
    assert len(found.dofs) == 44 and found.dofs["node"].isna().sum() == 2
    assert found.matrices["mass"]["beam_MASS2"].shape == (44, 44)


# -- what is refused ---------------------------------------------------------------------------------------------------


def edit(home, name, old, new):
    file = home / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("form", "damage", "words"),
    [
        ("CalculiX", lambda h: edit(h, "solid.sti", "1 1 ", "0 1 "), "row 0, column 1; .*counted from 1"),
        ("CalculiX", lambda h: edit(h, "solid.mas", "1 1 ", "42 42 "), "row 42 .*twice"),
        ("CalculiX", lambda h: edit(h, "solid.sti", "2 2 ", "2 2.5 "), "line 3"),
        ("CalculiX", lambda h: edit(h, "solid.dof", "5.3\n", ""), "41 are named"),
        ("CalculiX", lambda h: edit(h, "solid.dof", "5.3\n", "5.\n"), "row 3"),
        ("CalculiX", lambda h: (h / "solid.dof").unlink(), "--dofs"),
        ("CalculiX", lambda h: (h / "solid.mas").unlink(), r"solid\.mas, the mass, is not"),
        ("Abaqus labels", lambda h: edit(h, "beam_MASS2.mtx", "5,1, 5,1,", "5,1, 5,"), "numbers"),
        ("RSA", lambda h: edit(h, "beam_mass.matrix", "RSA", "CSA"), "CSA"),
        ("RSA", lambda h: edit(h, "beam_mass.matrix", "(10I8)", "(5I16)"), "pointers|read|cut off"),
        ("RSA", lambda h: edit(h, "beam_stiff.mapping", "         3 ", "         2 "), "equation 2"),
        ("DMIG", lambda h: edit(h, "beam.pch", "DMIG    KAAX ", "DMIG    KABX "), "KAAX has no header"),
        ("DMIG", lambda h: edit(h, "beam.pch", "D+06", "D*06"), "line"),
        ("MATLAB", lambda h: (h / "beam.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(40)), "MATLAB"),
        ("npz", lambda h: (h / "beam.npz").write_bytes(b"PK damaged"), "cannot be read"),
        ("Matrix Market", lambda h: edit(h, "matk.txt", "42 42", "42 41"), "matk"),
        ("Matrix Market", lambda h: edit(h, "rows.csv", "direction", "way"), "direction"),
        ("Matrix Market", lambda h: (h / "matm.txt").write_text(""), "empty"),
    ],
)
def test_damaged_files_are_refused_with_their_place(form, damage, words, tmp_path):
    files, more = FORMS[form](tmp_path)
    damage(tmp_path)
    with pytest.raises(InputError, match=words):
        read_matrices(files, **more)


def damaged(fault):
    stiffness, mass = K.copy(), M.copy()
    if fault == "not a number":
        stiffness[3, 3] = np.nan
    elif fault == "asymmetry":
        i, j = np.unravel_index(np.argmax(np.abs(np.triu(K, 1))), K.shape)
        stiffness[i, j] *= 1.01
    elif fault == "negative mass":
        mass[5, 5] *= -1.0
    elif fault == "empty row":
        stiffness[7], stiffness[:, 7], mass[7], mass[:, 7] = 0.0, 0.0, 0.0, 0.0
    return stiffness, mass


def written(form, home, monkeypatch, stiffness, mass):
    """The files of a form with other matrices."""
    for name, matrix in (("K", stiffness), ("M", mass)):
        monkeypatch.setitem(globals(), name, matrix)
    files, more = FORMS[form](home)
    for suffix, matrix in (("sti", stiffness), ("mas", mass)) if form == "CalculiX" else ():
        rows = (f"{j + 1} {i + 1} {v:.14e}" for i, j, v in zip(*triangle(matrix), strict=True))
        (home / f"solid.{suffix}").write_text("\n".join(rows))
    return files, more


FULL = ("MATLAB", "npz", "RUA")
"""Forms that hold both triangles."""


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("fault", "words"),
    [("not a number", r"nan|finite"), ("negative mass", r"mass at row \d+ .*sign"), ("asymmetry", "symmetric")],
)
def test_wrong_matrices_are_refused_at_every_door(form, fault, words, tmp_path, monkeypatch):
    if fault == "asymmetry" and form not in FULL:
        pytest.skip("it holds one triangle")
    files, more = written(form, tmp_path, monkeypatch, *damaged(fault))
    with pytest.raises(InputError, match=words):
        calib.import_matrices(files, units="mm-t-N", **more)


@pytest.mark.parametrize("form", FORMS)
def test_an_empty_row_is_fixed_and_the_mass_is_told_at_every_door(form, tmp_path, monkeypatch):
    stiffness, mass = damaged("empty row")
    files, more = written(form, tmp_path, monkeypatch, stiffness, mass)
    found = calib.import_matrices(files, units="mm-t-N", **more)
    assert found.model.n_dof == 41 or len(found.read.dofs) == 41
    moving = [k for k, (_, d) in enumerate(NAMES) if d == 1]
    kg = f"{1e3 * mass[np.ix_(moving, moving)].sum():.5g} kg"
    assert any("Mass that moves in x" in note and kg.split()[0] in note for note in found.notes)
