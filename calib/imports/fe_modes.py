"""Computed modes of any finite-element code: read from its files, as named frequencies and motions of nodes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.imports.coordinates import DECKS, read_coordinates
from calib.imports.elements import Edge, Element, edges_of, elements, transformed_nodes
from calib.imports.fil import read_fil
from calib.imports.frd import frd_elements, read_frd
from calib.imports.keywords import deck_text, is_keyword, keyword_blocks
from calib.imports.meshes import MESHES, has_elements, read_element_mesh
from calib.imports.op2 import read_op2
from calib.imports.printed import local_words, read_printed
from calib.measurement.files.csv_format import is_rigid
from calib.measurement.files.read import UFF_SUFFIXES, read_modes
from calib.measurement.frf_units import LENGTHS
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.measurement.places import Point


@dataclass(frozen=True, eq=False)
class ReadModes:
    """What a file of a code says of its modes, in its own unit of length.

    Attributes
    ----------
    freq : ndarray (n_modes,)
        Hz, in the order of the file.
    motions : mapping from (node, direction index) to ndarray (n_modes,)
        Real or complex; directions 0..5 for ux, uy, uz, rx, ry, rz. NaN in a mode that does not print the node.
    points : mapping from node to (x, y, z)
        Empty where the file has no coordinates.
    notes : tuple of str
        What was left out or assumed.
    """

    freq: np.ndarray
    motions: Mapping[tuple[int, int], np.ndarray]
    points: Mapping[int, Point] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_fe_modes(
    file: Path,
    *,
    shapes: Path | None = None,
    coordinates: Path | None = None,
    length_unit: str | None = None,
) -> MeasuredModes:
    """Read the modes that a finite-element code has computed.

    Rigid-body modes are left out and noted. Each shape is scaled to a largest modulus of 1, so that its unit does not
    matter; beside rotations, which are in rad whatever the unit of length, translations are converted to m.

    Parameters
    ----------
    file : Path
        Universal file (datasets 55, 2414), modes table (.csv), CalculiX .frd, Abaqus .fil as text, Nastran .op2,
        or what a code has printed: Nastran .f06, Abaqus and CalculiX .dat, ANSYS PRNSOL (.txt, .lis, .out).
    shapes : Path, optional
        Shapes table beside a modes table.
    coordinates : Path, optional
        Where the file has none: a table ``node, x, y, z`` in m, a deck or a mesh; see `read_coordinates`.
    length_unit : str, optional
        Of coordinates, and of translations beside rotations, in files that do not state it, such as ``mm``; by default
        m.

    Raises
    ------
    InputError
        For a file that cannot be read, has no modes, or is of a kind that is not read.
    """
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    if length_unit is not None and length_unit not in LENGTHS:
        raise InputError(f"length_unit is {length_unit!r:.40}", place=file, remedy=f"one of {', '.join(LENGTHS)}")
    metres, suffix = LENGTHS.get(length_unit or "m", 1.0), file.suffix.lower()
    if suffix in (*UFF_SUFFIXES, ".csv"):
        is_table = coordinates is not None and coordinates.suffix.lower() == ".csv"
        found = read_modes(
            file, shapes=() if shapes is None else shapes, sensors=coordinates if is_table else None,
            length_unit=length_unit if suffix in UFF_SUFFIXES else None,
        )  # fmt: skip
        found = found if suffix in UFF_SUFFIXES else replace(found, shapes=_beside_rotations(found, metres))
        return found if coordinates is None or is_table else _placed(found, read_coordinates(coordinates, metres))
    reader = {".frd": read_frd, ".fil": read_fil, ".op2": read_op2}.get(suffix, read_printed)
    freq, motions, points, notes = reader(file)
    if reader is read_printed and coordinates is not None:
        motions, told = _without_own_axes(motions, coordinates)
        notes += told
    read = ReadModes(freq, motions, {n: _scaled(p, metres) for n, p in points.items()}, notes)
    if coordinates is not None:
        read = ReadModes(freq, motions, read_coordinates(coordinates, metres), notes)
    found = _as_modes(file, read)
    return replace(found, shapes=_beside_rotations(found, metres))


def element_lines(files: Iterable[Path | None]) -> list[Edge]:
    """Edges of the elements in the first of some files that has any: .frd, mesh (.unv, .msh) or deck; else none."""
    for file in files:
        suffix = "" if file is None else file.suffix.lower()
        found: Iterable[Element] = ()
        if file is None or not file.is_file():
            continue
        if suffix == ".frd":
            found = frd_elements(file)
        elif suffix in MESHES and (suffix not in UFF_SUFFIXES or has_elements(file)):
            found = read_element_mesh(file).elements
        elif suffix in DECKS:
            found = elements(deck_text(file))
        if edges := edges_of(found):
            return edges
    return []


def _beside_rotations(found: MeasuredModes, metres: float) -> np.ndarray:
    """Shapes whose translations, in a unit of so many metres, are in m where rotations (rad) stand beside them."""
    moves = np.array([DIRECTIONS.index(s.direction) < 3 for s in found.sensors], dtype=bool)
    if moves.all() or metres == 1:
        return found.shapes
    return found.shapes * np.where(moves, metres, 1.0)[:, None]


def _without_own_axes(
    motions: Mapping[tuple[int, int], np.ndarray], deck: Path
) -> tuple[dict[tuple[int, int], np.ndarray], tuple[str, ...]]:
    """Printed motions without those of nodes with a ``*TRANSFORM``, which ``*NODE PRINT`` has in their own directions.

    Source: CalculiX, keyword *NODE PRINT: the default is GLOBAL=NO.
    """
    text = deck_text(deck) if deck.suffix.lower() in DECKS else ""
    requests = [key for key, _ in keyword_blocks(text.splitlines()) if is_keyword(key, "*NODEPRINT")]
    if all("GLOBAL=YES" in key for key in requests) and requests:
        return dict(motions), ()
    own = transformed_nodes(text)
    kept = {at: row for at, row in motions.items() if at[0] not in own}
    if len(kept) == len(motions):
        return kept, ()
    nodes = sorted({node for node, _ in motions if node in own})
    return kept, (local_words(nodes),)


def _as_modes(file: Path, read: ReadModes) -> MeasuredModes:
    """Modes in ascending frequency, without rigid-body motions and rows that are not printed in every mode."""
    freq, notes = read.freq, list(read.notes)
    if not len(freq):
        raise InputError("it holds no modes", place=file, remedy="let the code print or write its modes")
    highest = float(np.abs(freq).max())
    elastic = np.array([not is_rigid(float(f), highest) and f > 0 for f in freq])
    if not elastic.any():
        raise InputError("all of its modes are rigid-body motions", place=file, remedy="compute elastic modes too")
    if not elastic.all():
        notes.append(f"{int((~elastic).sum())} rigid-body modes of {file.name} were left out.")
    order = np.flatnonzero(elastic)[np.argsort(freq[elastic], kind="stable")]
    whole = {at: row[order] for at, row in read.motions.items() if np.isfinite(row[order]).all()}
    partial = len(read.motions) - len(whole)
    if partial:
        notes.append(f"{partial} motions that {file.name} does not have in every mode were left out.")
    sensors = tuple(Sensor(node, DIRECTIONS[d], read.points.get(node)) for node, d in whole)
    rows = np.array(list(whole.values())) if whole else np.zeros((0, len(order)))
    size = np.abs(rows).max(axis=0, initial=0.0)
    if whole and not np.all(size > 0):
        k = int(np.argmin(size))
        raise InputError(
            f"its mode {int(order[k]) + 1} ({freq[order[k]]:.6g} Hz) moves no node", place=file,
            remedy="let the code print the modes of all nodes",
        )  # fmt: skip
    n, unknown = len(order), np.full(len(order), np.nan)
    return MeasuredModes(
        tuple(str(k + 1) for k in order), freq[order], freq[order], unknown, unknown, unknown, sensors,
        rows / np.where(size > 0, size, 1.0), np.full((len(sensors), n), np.nan), source=str(file), notes=tuple(notes),
    )  # fmt: skip


def _scaled(point: Point, metres: float) -> Point:
    x, y, z = point
    return metres * x, metres * y, metres * z


def _placed(modes: MeasuredModes, points: Mapping[int, Point]) -> MeasuredModes:
    return replace(modes, sensors=tuple(replace(s, point=points.get(s.node, s.point)) for s in modes.sensors))
