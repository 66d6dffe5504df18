"""Stiffness, mass and damping that a finite-element code has written, from its own files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.containers import read_container
from calib.imports.coordinates import DECKS, read_coordinates
from calib.imports.dof_file import read_dofs, require_layers, table_of_dofs, without_held
from calib.imports.elements import edges_of, element_sets, read_edges, sets_of
from calib.imports.harwell_boeing import is_harwell_boeing, is_mapping, read_harwell_boeing
from calib.imports.keywords import deck_text, with_included
from calib.imports.meshes import MESHES, has_elements, read_element_mesh
from calib.imports.nastran import is_dmig, read_dmig
from calib.imports.op2 import is_op2, read_op2_matrices
from calib.imports.op4 import is_op4, read_op4
from calib.imports.stored import Stored, counted_from_one, matrix_kind, named, spread, stored_numbers
from calib.imports.systems import all_motions, analysis_set, axes_of, is_bulk, turned_into_global
from calib.measurement.files.read import UFF_SUFFIXES
from calib.measurement.places import Point

Kind = Literal["stiffness", "mass", "damping"]
KINDS: tuple[Kind, ...] = ("stiffness", "mass", "damping")

_PENALTY = 1e18
"""Diagonal over the median one of a row that a support holds by a large number, such as 1e36."""


@dataclass(frozen=True, eq=False)
class ReadMatrices:
    """Matrices of a code with the names of their rows, in the code's own units.

    Attributes
    ----------
    matrices : mapping from kind to mapping from name to coo_array (n_dof, n_dof)
        As stored: a symmetric one may have one triangle alone.
    dofs : DataFrame (n_dof rows)
        ``node, direction`` and, where they are known, ``x, y, z`` in the code's unit of length.
    layers : {"mean"} or None
        Whether rows of one name are the layers of a shell.
    lines : tuple of (node, node)
        Edges of elements of the deck between nodes that have rows.
    sets : mapping from str to tuple of nodes
        Element sets of the deck, by those of their nodes that have rows.
    notes : tuple of str
        What was left out, found or assumed.
    """

    matrices: Mapping[str, Mapping[str, sp.coo_array]]
    dofs: pd.DataFrame
    layers: Literal["mean"] | None = None
    lines: tuple[tuple[int, int], ...] = ()
    sets: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_matrices(
    files: Sequence[Path],
    *,
    dofs: Path | None = None,
    coordinates: Path | None = None,
    metres: float = 1.0,
    chosen: Mapping[str, Sequence[str]] | None = None,
) -> ReadMatrices:
    """Read the matrices of a model, whatever code wrote them.

    Parameters
    ----------
    files : sequence of Path
        CalculiX .sti and .mas, Abaqus .mtx, Nastran DMIG, OUTPUT4 or OUTPUT2, Harwell-Boeing, Matrix Market, .mat and
        .npz; decks among them give coordinates, tables and mappings the names of rows.
    dofs : Path, optional
        Names of the rows where no file has them; see `calib.imports.dof_file.read_dofs`.
    coordinates : Path, optional
        A table ``node, x, y, z`` in m, or a deck; see `calib.imports.coordinates.read_coordinates`.
    metres : float
        Of the code's unit of length, m.
    chosen : mapping from kind to names, optional
        Which matrices are stiffness, mass and damping where their names do not tell it: of a matrix or of its file.

    Raises
    ------
    InputError
        For a file that cannot be read, rows without names, and matrices that do not belong together.
    """
    given, notes = _with_neighbours(files)
    stored: list[tuple[Path, Stored]] = []
    is_calculix, bulk, rows = False, dict[Path, str](), dict[str, np.ndarray]()
    for file in given:
        raw = _bytes(file)
        text = "" if b"\0" in raw[:2000] else with_included(file, raw.decode("latin-1"))
        lines = text.splitlines()
        if is_bulk(text):
            bulk[file] = text
        if is_dmig(text):
            found, told = read_dmig(file, text)
            notes += told
            stored += [(file, one) for one in found]
        elif file.suffix.lower() == ".csv":
            is_places = "direction" not in lines[0].lower()
            dofs, coordinates = (dofs, coordinates or file) if is_places else (dofs or file, coordinates)
        elif file.suffix.lower() == ".dof" or (text and is_mapping(lines)):
            dofs = file if dofs is None else dofs
            is_calculix |= file.suffix.lower() == ".dof"
        elif file.suffix.lower() in DECKS or file in bulk or _is_mesh(file):
            coordinates = file if coordinates is None else coordinates
        else:
            found, told = _stored(file, raw, text, lines)
            notes += told
            stored += [(file, one) for one in found]
    for file, text in bulk.items():
        coordinates = file if coordinates is None and re.search(r"^GRID[\s*,]", text, re.MULTILINE) else coordinates
        rows |= {words: own for words, own in _rows_of_deck(file, text) if words not in rows and own is not None}
    by_kind, told = _sorted_out(stored, chosen or {})
    notes += told
    table, told = _rows([one for own in by_kind.values() for one in own.values()], dofs, rows)
    notes += told
    for kind, own in by_kind.items():
        single = [name for name, one in own.items() if one.labels is None and one.matrix.shape[0] == 1 < len(table)]
        empty = [] if (chosen or {}).get(kind) else single
        for name in empty:  # what Nastran writes for none
            notes += (f"Left out: {name}, a {kind} of one row.",)
            own.pop(name)
    matrices: Mapping[str, Mapping[str, sp.coo_array]] = {
        kind: {name: _sized(one, table, name).matrix for name, one in own.items()} for kind, own in by_kind.items()
    }
    for file, text in bulk.items():
        matrices, turned = turned_into_global(matrices, table, axes_of(file, text), file)
        notes += (f"Nodes that move in axes of their own, turned into global ones: {turned}.",) if turned else ()
    if coordinates is not None:
        table, told = _placed(table, coordinates, metres, is_calculix)
        notes += told
        if is_calculix:
            table, told = without_held(table, coordinates)
            notes += told
    if "x" not in table:
        notes += ("No coordinates of nodes were given (--coordinates): sensors lie at the nodes of their numbers.",)
    matrices, table, told = _without_penalties(matrices, table)
    named_twice = bool(table.dropna(subset=["node"]).duplicated(["node", "direction"]).any())
    if is_calculix and named_twice and coordinates is not None and coordinates.suffix.lower() in DECKS:
        require_layers(table, coordinates)
    edges, sets = _drawn(table, coordinates)
    if sets:
        listed = ", ".join(f"{name} ({len(nodes)} nodes)" for name, nodes in sets.items())
        told = (*told, f"Element sets, for figures and for the strain energy of modes: {listed}.")
    return ReadMatrices(matrices, table, "mean" if is_calculix and named_twice else None, edges, sets, notes + told)


def _is_mesh(file: Path) -> bool:
    """Whether a file is a mesh rather than measured modes, which universal files hold too."""
    return file.suffix.lower() in MESHES and (file.suffix.lower() not in UFF_SUFFIXES or has_elements(file))


def _bytes(file: Path) -> bytes:
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    raw = file.read_bytes()
    if not raw.strip():
        raise InputError("it is empty", place=file, remedy="did the code end as it should?")
    return raw


def _with_neighbours(files: Sequence[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """The files, and those that a code writes beside them, of the same name."""
    out = list(dict.fromkeys(files))
    beside: list[Path] = []
    for file in files:
        wanted = {".sti": (".mas", ".dof", ".inp"), ".mas": (".sti", ".dof", ".inp")}.get(file.suffix.lower(), ())
        for other in [*(file.with_suffix(suffix) for suffix in wanted), file.with_suffix(".mapping")]:
            if other.is_file() and other not in out:
                out.append(other)
                beside.append(other)
    words = f"Found beside the files, and read too: {', '.join(one.name for one in beside)}."
    return out, (words,) if beside else ()


def _stored(file: Path, raw: bytes, text: str, lines: list[str]) -> tuple[list[Stored], tuple[str, ...]]:
    """The matrices of one file that is neither DMIG nor a deck, and what is left out of it."""
    if file.suffix.lower() in UFF_SUFFIXES:
        remedy = f"name what was measured by an option of its own, --measured {file}, or all by a pattern in quotes"
        raise InputError("it is a universal file, which holds no matrices", place=file, remedy=remedy)
    held = read_container(file, raw)
    if held is not None:
        return held, ()
    if is_op2(raw):
        return read_op2_matrices(file, raw)
    if is_op4(raw):
        return read_op4(file, raw)
    if is_harwell_boeing(lines):
        return [read_harwell_boeing(file, lines)], ()
    if not text:
        remedy = "give matrices in a form of the page on finite-element codes"
        if file.suffix.lower() in (".full", ".rst"):
            remedy = "write its matrices by HBMAT, or turn job.full into a .mat by ansys-mapdl-reader (docs/fe_code.md)"
        raise InputError("it is binary, of no form that is read", place=file, remedy=remedy)
    name = {".sti": "stiffness", ".mas": "mass"}.get(file.suffix.lower(), file.stem)
    table = stored_numbers(text, (3, 5), file)
    if table.shape[1] == 3:
        return [counted_from_one(name, table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2], file)], ()
    labels = table[:, :4].astype(int)
    return [named(name, labels[:, :2], labels[:, 2:], table[:, 4], file)], ()


def _sorted_out(
    stored: Sequence[tuple[Path, Stored]], chosen: Mapping[str, Sequence[str]]
) -> tuple[dict[Kind, dict[str, Stored]], tuple[str, ...]]:
    """Matrices by kind and name; InputError where stiffness or mass is missing, or a chosen name is."""
    out: dict[Kind, dict[str, Stored]] = {kind: {} for kind in KINDS}
    left = []
    called = [(one, {n.lower() for n in (one.name, one.sized, file.name, file.stem)}, file) for file, one in stored]
    if not called:
        raise InputError("none of them holds a matrix", place="files", remedy="give those of stiffness and mass")
    count = Counter(one.name for one, _, _ in called)
    listed = ", ".join(dict.fromkeys(one.name if count[one.name] == 1 else one.sized for one, _, _ in called))
    for kind in KINDS:
        for name in chosen.get(kind, ()):
            found = [one for one, names, _ in called if name.lower() in names]
            if not found:
                raise InputError(f"there is no matrix {name!r}", place=f"--{kind}", remedy=f"there are: {listed}")
            for one in found:
                out[kind][one.name] = one
    taken = {id(one): one.matrix.shape[0] for own in out.values() for one in own.values()}
    for one, _, file in called:
        if id(one) in taken:
            continue
        other_model = taken and count[one.name] > 1 and one.matrix.shape[0] not in taken.values()
        kind_found = "" if other_model else matrix_kind(one.name) or matrix_kind(file.stem)
        if kind_found in KINDS and not chosen.get(kind_found):
            known: Kind = kind_found
            if (other := out[known].get(one.name)) is not None:
                words = f"two matrices {one.name!r}, of {other.matrix.shape[0]} and {one.matrix.shape[0]} rows"
                remedy = f"choose a model by its number of rows, such as --{known} {one.sized}, or give its file alone"
                raise InputError(f"there are {words}", place=file, remedy=remedy)
            out[known][one.name] = one
        else:
            left.append(one.sized if other_model else f"{one.name} ({kind_found})" if kind_found else one.name)
    for kind in ("stiffness", "mass"):
        if not out[kind]:
            raise _without(kind, stored, left)
    notes = (f"Left out: {', '.join(left)}.",) if left else ()
    return out, notes


def _without(kind: str, stored: Sequence[tuple[Path, Stored]], left: Sequence[str]) -> InputError:
    """No stiffness, or no mass: the file that should be beside another one, or the matrices whose kind is unknown."""
    own, other = (".mas", ".sti") if kind == "mass" else (".sti", ".mas")
    for file, _ in stored:
        if file.suffix.lower() == other:
            return InputError(f"{file.stem}{own}, the {kind}, is not beside it", place=file,
                              remedy="put it there, as the same run wrote it")  # fmt: skip
    remedy = f"name it: --{kind} NAME, one of {', '.join(left)}" if left else f"give the file that has the {kind}"
    return InputError(f"no matrix is recognised as {kind}", place="files", remedy=remedy)


def _rows(
    flat: Sequence[Stored], dofs: Path | None, of_deck: Mapping[str, np.ndarray]
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Names of the rows: those of a file of their own, of the matrices, or of the analysis set of a deck."""
    labels = [one.labels for one in flat if one.labels is not None]
    if not labels:
        if dofs is not None:
            return read_dofs(dofs), ()
        size = max(one.matrix.shape[0] for one in flat)
        is_all = any("GG" in one.name.upper() for one in flat)
        for words, listed in of_deck.items():
            if len(listed) == size and (is_all or words == next(iter(of_deck))):
                return table_of_dofs(listed), (f"The {size} rows are {words} of the deck.",)
        other = "".join(f"; {len(listed)} are {words} of the deck" for words, listed in of_deck.items())
        raise InputError(
            f"no file names their {size} rows{other}", place="matrices",
            remedy="give node and direction of each row: --dofs TABLE (node,direction), or the .mapping of ANSYS",
        )  # fmt: skip
    alike = all(np.array_equal(one, labels[0]) for one in labels[1:])
    joined = labels[0] if alike else np.unique(np.concatenate(labels), axis=0)
    table = table_of_dofs(joined)
    table.attrs["labels"] = joined
    if dofs is None:
        return table, ()
    own = read_dofs(dofs)
    if "x" not in own:
        raise InputError("the matrices name their rows themselves", place=dofs, remedy="leave --dofs out")
    places = own.dropna(subset=["node"]).astype({"node": int}).drop_duplicates("node").set_index("node")
    for axis in "xyz":
        table[axis] = table["node"].map(places[axis])
    return table, ()


def _rows_of_deck(file: Path, text: str) -> Iterator[tuple[str, np.ndarray | None]]:
    """Rows that a deck of Nastran may mean, each with what they are."""
    try:
        yield "those of the analysis set (EXTRN, ASET and others)", analysis_set(text)
        yield "those of all GRID and SPOINT, in ascending order,", all_motions(text)
    except ValueError as fault:
        raise InputError(f"it cannot be read ({fault})", place=file, remedy="give --dofs and --coordinates") from None


def _sized(stored: Stored, table: pd.DataFrame, name: str) -> Stored:
    """A matrix over the rows of the table; InputError for one that has another size."""
    labels = table.attrs.get("labels")
    if stored.labels is not None and labels is not None and not np.array_equal(stored.labels, labels):
        return spread(stored, labels)
    n, own = len(table), stored.matrix.shape[0]
    if own != n and not (stored.open_ended and own < n):
        raise InputError(f"it has {own} rows, and {n} are named", place=f"matrix {name}",
                         remedy="give the names of its rows, in their order, as the same run wrote them")  # fmt: skip
    coo = stored.matrix
    return replace(stored, matrix=sp.coo_array((coo.data, (coo.row, coo.col)), shape=(n, n)))


def _placed(table: pd.DataFrame, file: Path, metres: float, has_own: bool) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """The table with coordinates, where all nodes have them.

    ``has_own`` tells that rows of nodes that the deck does not define are the code's own, which then have no node.
    """
    scale = 1 / metres if file.suffix.lower() == ".csv" else 1.0
    points: Mapping[int, Point] = read_coordinates(file)
    named_rows = table["node"].notna().to_numpy()
    nodes = pd.to_numeric(table["node"]).where(named_rows, 0).astype(int).to_numpy()
    known = np.array([node in points for node in nodes]) & named_rows
    if not known.any():
        raise InputError(
            "it defines none of the nodes of the matrices", place=file, remedy="give the deck of this model"
        )
    out = table.copy()
    listed = zip(nodes.tolist(), known, strict=True)
    places = np.array([points[node] if there else (np.nan,) * 3 for node, there in listed])
    out[["x", "y", "z"]] = scale * places
    lost = named_rows & ~known
    if not lost.any():
        return out, ()
    if not has_own:
        words = f"{file.name} does not define node {nodes[lost][0]}: no coordinates are used."
        return table, (words,)
    out.loc[lost, ["node", "direction"]] = pd.NA
    count = len(np.unique(nodes[lost]))
    first, last = nodes[lost].min(), nodes[lost].max()
    return out, (
        f"{int(lost.sum())} rows belong to {count} nodes that {file.name} does not define ({first} to {last}), which "
        "are the code's own: they stay in the model, and no sensor lies there.",
    )


def _drawn(table: pd.DataFrame, file: Path | None) -> tuple[tuple[tuple[int, int], ...], dict[str, tuple[int, ...]]]:
    """Edges and sets of the elements of a deck between nodes that have rows; no edges without coordinates."""
    if file is None or file.suffix.lower() == ".csv":
        return (), {}
    nodes = set(table["node"].dropna().astype(int))
    if file.suffix.lower() in MESHES:
        mesh = read_element_mesh(file)
        of_sets, all_edges = sets_of(mesh.elements, mesh.groups), edges_of(mesh.elements)
    else:
        text = deck_text(file)
        of_sets, all_edges = element_sets(text), read_edges(text)
    sets = {name: tuple(sorted(own & nodes)) for name, own in of_sets.items()}
    edges = tuple(edge for edge in all_edges if nodes.issuperset(edge)) if "x" in table else ()
    return edges, {name: own for name, own in sets.items() if own}


def _without_penalties(
    matrices: Mapping[str, Mapping[str, sp.coo_array]], table: pd.DataFrame
) -> tuple[dict[str, dict[str, sp.coo_array]], pd.DataFrame, tuple[str, ...]]:
    """Matrices without the rows that supports hold by a large number on the diagonal."""
    diagonal = sum((np.abs(one.diagonal()) for one in matrices["stiffness"].values()), np.zeros(len(table)))
    usual = np.median(diagonal[diagonal > 0]) if (diagonal > 0).any() else 0.0
    held = (diagonal >= _PENALTY * usual) & (diagonal > 0) & np.isfinite(diagonal)
    plain = {kind: dict(own) for kind, own in matrices.items()}
    if not held.any() or held.all():
        return plain, table, ()
    kept = np.flatnonzero(~held)
    cut = {
        kind: {name: sp.coo_array(sp.csr_array(one)[kept][:, kept]) for name, one in own.items()}
        for kind, own in plain.items()
    }
    words = f"{int(held.sum())} rows that supports hold by a diagonal of {diagonal[held].max():.0e} were fixed."
    return cut, table.iloc[kept].reset_index(drop=True), (words,)
