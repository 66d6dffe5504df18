"""Nastran's binary results (.op2): real modes, places of nodes and matrices, of either byte order and word length."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.imports.frd import Found
from calib.imports.op4 import StoredStrings, taken
from calib.imports.stored import Stored
from calib.imports.systems import Defined, Systems, axes_in
from calib.measurement.places import Point

_WORDS = (4, 8)
"""Bytes of a word."""
_EIGENVECTORS, _REAL_MODES, _REAL = 7, 2, 1
"""Of the head of a table of displacements: what it holds, of which analysis, and real numbers."""
_GRID = (4501, 45)
"""Key of records of nodes in the geometry."""
_SYSTEMS = {(2101, 21): 0, (2001, 20): 1, (2201, 22): 2}
"""Keys of records of CORD2R, CORD2C and CORD2S, and their kinds."""


@dataclass(frozen=True, eq=False)
class _Block:
    """A data block: its name, its trailer, and its records as chunks of bytes; those of a matrix are strings."""

    name: str
    trailer: np.ndarray
    is_matrix: bool
    records: list[list[bytes]]
    order: str
    word: int

    def integers(self, record: bytes) -> np.ndarray:
        return np.frombuffer(record, f"{self.order}i{self.word}")

    def reals(self, record: bytes) -> np.ndarray:
        return np.frombuffer(record, f"{self.order}f{self.word}")

    def tables(self) -> list[bytes]:
        """Records of a table."""
        return [b"".join(chunks) for chunks in self.records]


def is_op2(raw: bytes) -> bool:
    """Whether a file begins as OUTPUT2 does: a record of one word that holds a small number."""
    return len(raw) >= 16 and any(struct.unpack(order + "i", raw[:4])[0] in _WORDS for order in "<>")


def _blocks(file: Path, raw: bytes) -> list[_Block]:
    """Data blocks in their order; InputError for a file that is none or is cut off."""
    if not is_op2(raw):
        raise InputError("it is no binary OUTPUT2 file", place=file, remedy="write it by PARAM,POST,-1")
    try:
        return list(_scanned(raw))
    except (ValueError, IndexError, struct.error) as fault:
        raise InputError(f"it cannot be read ({fault})", place=file, remedy="write it again; it may be cut off"
                         ) from None  # fmt: skip


def _scanned(raw: bytes) -> Iterator[_Block]:
    """Records between two copies of their length: a key above 0 comes before data, 0 ends a block, below 0 a record.

    Each record but the first two begins with a word that tells what it is of: 0 a table, 1 a column of a matrix.
    """
    order = next(order for order in "<>" if struct.unpack(order + "i", raw[:4])[0] in _WORDS)
    (word,) = struct.unpack(order + "i", raw[:4])
    at, records, chunks = 0, list[list[bytes]](), list[bytes]()

    def record() -> bytes:
        nonlocal at
        (length,) = struct.unpack_from(order + "i", raw, at)
        out = raw[at + 4 : at + 4 + length]
        if length < 0 or struct.unpack_from(order + "i", raw, at + 4 + length) != (length,):
            raise ValueError("a record is longer than the file")
        at += 8 + length
        return out

    while at < len(raw):
        (key,) = np.frombuffer(record(), f"{order}i{word}")
        if key > 0:
            chunks.append(record())
        elif key < 0:
            records.append(chunks)
            chunks = []
        else:
            if len(records) > 2:  # else it is the head of the file
                name = records[0][-1].decode("latin-1")
                short = "".join(name[k : k + 4] for k in range(0, len(name), word)).strip("\0 ")
                trailer = np.frombuffer(records[1][0], f"{order}i{word}")
                is_matrix = len(records) > 3 and bool(np.frombuffer(records[3][0], f"{order}i{word}")[0])
                yield _Block(short, trailer, is_matrix, [own[1:] for own in records[3:]], order, word)
            records, chunks = [], []
    if records or chunks:
        raise ValueError("its last data block has no end")


def read_op2(file: Path) -> Found:
    """Frequencies, displacements in basic axes and places of nodes; see `calib.imports.fe_modes.read_fe_modes`.

    Of several sets of modes the one with most nodes is taken; parts of one set, as superelements write them, are
    joined. Nodes that move in a system that the file does not define are left out.

    Raises
    ------
    InputError
        For a file that is no OUTPUT2 or is cut off, and one without real modes.
    """
    blocks = _blocks(file, file.read_bytes())
    points, own_axes, systems = _geometry(blocks)
    sets: dict[tuple[float, ...], dict[int, np.ndarray]] = {}
    for block in blocks:
        if block.name.startswith(("OUG", "BOPHIG")):
            for eigenvalues, nodes in _modes(block):
                sets.setdefault(eigenvalues, {}).update(nodes)
    if not sets:
        raise InputError("it holds no real modes", place=file,
                         remedy="ask for DISPLACEMENT(PLOT) = ALL and PARAM,POST,-1 in SOL 103")  # fmt: skip
    eigenvalues, nodes = max(sets.items(), key=lambda item: len(item[1]))
    notes = []
    if len(sets) > 1:
        notes.append(f"{file.name} holds {len(sets)} sets of modes, of which that with most nodes ({len(nodes)}) "
                     "is taken.")  # fmt: skip
    axes, unknown = axes_in(systems, {node: own_axes.get(node, "0") for node in nodes}, points)
    lost = set(unknown)
    if lost:
        notes.append(f"{len(lost)} nodes, such as {min(lost)}, move in axes that the file does not define and were "
                     "left out.")  # fmt: skip
    motions: dict[tuple[int, int], np.ndarray] = {}
    for node, own in nodes.items():
        if node not in lost:
            turned = axes[node] @ own.reshape(2, 3, -1) if node in axes else own.reshape(2, 3, -1)
            motions |= {(node, d): turned.reshape(6, -1)[d] for d in range(6)}
    value = np.array(eigenvalues)
    return np.sign(value) * np.sqrt(np.abs(value)) / (2 * np.pi), motions, points, tuple(notes)


def _modes(block: _Block) -> Iterator[tuple[tuple[float, ...], dict[int, np.ndarray]]]:
    """Sets of eigenvalues and motions of each node (6, n_modes) of a table of displacements, if it is of real modes."""
    tables = block.tables()
    found: list[tuple[int, float, np.ndarray]] = []
    for head, data in zip(tables[::2], tables[1::2], strict=False):
        code = block.integers(head)
        if code[0] // 10 != _REAL_MODES or code[1] % 1000 != _EIGENVECTORS or code[8] != _REAL:
            return
        found.append((int(code[4]), float(block.reals(head)[5]), block.integers(data).reshape(-1, 8)))
    starts = [k for k, (number, _, _) in enumerate(found) if k == 0 or number <= found[k - 1][0]]
    for first, last in zip(starts, [*starts[1:], len(found)], strict=True):
        own = found[first:last]
        node, kind = own[0][2][:, 0] // 10, own[0][2][:, 1]
        values = np.array([block.reals(words[:, 2:].tobytes()).reshape(-1, 6) for _, _, words in own], dtype=float)
        yield tuple(e for _, e, _ in own), {int(node[k]): values[:, k].T for k in np.flatnonzero(kind == 1)}


def _geometry(blocks: list[_Block]) -> tuple[dict[int, Point], dict[int, str], Systems]:
    """Places of nodes in basic axes, the system in which each moves, and the systems of CORD2R, CORD2C and CORD2S.

    Source of places: BGPDT, in basic axes, whose order EQEXIN names; GRID in basic axes where there is none.
    """
    points: dict[int, Point] = {}
    moves: dict[int, str] = {}
    systems: Systems = {}
    for block in blocks:
        for record in block.tables() if block.name.startswith("GEOM1") else ():
            code, number = block.integers(record), block.reals(record)
            key = (int(code[0]), int(code[1]))
            body, real = code[3:], number[3:]
            if key == _GRID:
                for k in range(0, len(body) - 7, 8):
                    moves[int(body[k])] = str(body[k + 5])
                    if body[k + 1] == 0:
                        points[int(body[k])] = _point(real[k + 2 : k + 5])
            for k in range(0, len(body) - 12, 13) if key in _SYSTEMS else ():
                abc = np.array(real[k + 4 : k + 13], dtype=float).reshape(3, 3)
                systems[str(body[k])] = Defined(_SYSTEMS[key], str(body[k + 3]), abc)
    for places in (block for block in blocks if block.name.startswith("BGPDT")):
        rows = places.integers(places.tables()[0])
        for names in (block for block in blocks if block.name.startswith("EQEXIN")):
            internal = _internal(names)
            if 4 * len(internal) == len(rows):
                real = places.reals(places.tables()[0]).reshape(-1, 4)
                for node, (system, *_), place in zip(internal, rows.reshape(-1, 4), real, strict=True):
                    if system >= 0:
                        points[node], moves[node] = _point(place[1:]), str(system)
    return points, moves, systems


def _point(place: np.ndarray) -> Point:
    x, y, z = (float(one) for one in place)
    return x, y, z


def _internal(names: _Block) -> list[int]:
    """Numbers of nodes and scalar points in the code's own order, from EQEXIN."""
    pairs = names.integers(names.tables()[0]).reshape(-1, 2)
    return [int(node) for node in pairs[np.argsort(pairs[:, 1]), 0]]


def _set_of_all(names: _Block) -> np.ndarray:
    """Node and direction of all degrees of freedom in the code's own order, from EQEXIN; 0 of scalar points."""
    rows: list[tuple[int, int, int]] = []
    for node, code in names.integers(names.tables()[1]).reshape(-1, 2):
        first, is_grid = int(code) // 10, code % 10 == 1
        rows += [(first + d, int(node), d + 1) for d in range(6)] if is_grid else [(first, int(node), 0)]
    return np.array(sorted(rows), dtype=int)[:, 1:]


def read_op2_matrices(file: Path, raw: bytes) -> tuple[list[Stored], tuple[str, ...]]:
    """Square real matrices of the file, of all degrees of freedom with the names of rows (EQEXIN); what is left out.

    Raises
    ------
    InputError
        For a file that cannot be read or has no such matrix.
    """
    blocks = _blocks(file, raw)
    rows = next((_set_of_all(block) for block in blocks if block.name.startswith("EQEXIN")), None)
    found = []
    for block in blocks:
        if not block.is_matrix:
            continue
        n_columns, n_rows, kind = (int(block.trailer[k]) for k in (1, 2, 4))
        real = f"{block.order}f8" if kind in (2, 4) or block.word == 8 else f"{block.order}f4"
        strings = [
            (int(block.integers(one[: block.word])[0]) - 1, k, np.frombuffer(one[block.word :], real).astype(float))
            for k, chunks in enumerate(block.records)
            for one in chunks
        ]
        found.append(StoredStrings(block.name, n_rows, n_columns, kind, strings))
    stored, notes = taken(file, found)
    known = [len(rows) == one.matrix.shape[0] if rows is not None else False for one in stored]
    return [replace(one, labels=rows) if own else one for one, own in zip(stored, known, strict=True)], notes
