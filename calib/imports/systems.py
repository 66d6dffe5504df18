"""Nastran nodes that move in systems of their own (field CD of GRID), and matrices turned into global axes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.bulk import Grid, bulk_entries, grids, real
from calib.measurement.files.uff_nodes import CoordinateSystem
from calib.measurement.places import Point


@dataclass(frozen=True, eq=False)
class Defined:
    """A system as it is defined: 0 Cartesian, 1 cylindrical, 2 spherical, and its points A, B and C, (3, 3).

    The points are in the system ``reference``; where ``nodes`` names three nodes, these are the points.
    """

    kind: int
    reference: str
    points: np.ndarray
    nodes: tuple[int, ...] = ()


Systems = dict[str, Defined]
"""Systems by their number."""
_KINDS = {"R": 0, "C": 1, "S": 2}
_BASIC = CoordinateSystem(0, np.eye(3), np.zeros(3))


def defined_systems(text: str) -> Systems:
    """Systems of CORD1R, CORD1C, CORD1S, CORD2R, CORD2C and CORD2S."""
    found: Systems = {}
    for name, fields in bulk_entries(text):
        kind = _KINDS.get(name[5:], -1) if re.match(r"CORD[12]", name) else -1
        if kind >= 0 and name[4] == "2" and len(fields) >= 11:
            points = np.array([real(part) for part in fields[2:11]]).reshape(3, 3)
            found[fields[0]] = Defined(kind, fields[1] or "0", points)
        for k in (0, 4) if kind >= 0 and name[4] == "1" else ():
            if len(fields) > k + 3 and fields[k]:
                a, b, c = (int(one) for one in fields[k + 1 : k + 4])
                found[fields[k]] = Defined(kind, "0", np.zeros((3, 3)), (a, b, c))
    return found


class _Frames:
    """Systems in basic axes, found from their definitions when they are needed; LookupError for one that is not known.

    Source: a system is given by its origin A, a point B on its z axis and a point C in its xz plane.
    """

    def __init__(self, systems: Systems, nodes: Mapping[int, Grid]):
        self.systems, self.nodes = systems, nodes
        self.found: dict[str, CoordinateSystem] = {"0": _BASIC}
        self.pending: list[str] = []

    def frame(self, number: str) -> CoordinateSystem:
        if number not in self.found:
            if number not in self.systems or number in self.pending:
                raise LookupError(number)
            self.pending.append(number)
            own = self.systems[number]
            if own.nodes:
                a, b, c = (self.place(node, number) for node in own.nodes)
            else:
                reference = self.frame(own.reference)
                a, b, c = (reference.place(one) for one in own.points)
            z = (b - a) / np.linalg.norm(b - a)
            y = np.cross(z, c - a)
            y /= np.linalg.norm(y)
            self.found[number] = CoordinateSystem(own.kind, np.array([np.cross(y, z), y, z]), a)
        return self.found[number]

    def place(self, node: int, number: str = "") -> np.ndarray:
        """Place of a node in basic axes, (3,)."""
        if node not in self.nodes:
            raise LookupError(number or str(node))
        return self.frame(self.nodes[node].placed).place(self.nodes[node].entry)


def placed_nodes(text: str) -> tuple[dict[int, np.ndarray], dict[int, str]]:
    """Places (3,) of the nodes of bulk data in basic axes, and of other nodes the system that is not known."""
    nodes = grids(text)
    frames = _Frames(defined_systems(text), nodes)
    places: dict[int, np.ndarray] = {}
    unknown: dict[int, str] = {}
    for node in nodes:
        try:
            places[node] = frames.place(node)
        except LookupError as fault:
            unknown[node] = str(fault.args[0])
    return places, unknown


def axes_of(file: Path, text: str) -> dict[int, np.ndarray]:
    """Axes of the nodes whose motions are not in the basic system, (3, 3) each: its columns are their x, y and z.

    Raises
    ------
    InputError
        For a node that moves in a system that is not in the file.
    """
    nodes = grids(text)
    axes, unknown = _axes(_Frames(defined_systems(text), nodes), {node: one.moves for node, one in nodes.items()})
    for node, number in unknown.items():
        raise InputError(f"node {node} moves in system {number}", place=file,
                         remedy="give that system in the same file, or write the matrices in global axes")  # fmt: skip
    return axes


def axes_in(
    systems: Systems, nodes: Mapping[int, str], points: Mapping[int, Point]
) -> tuple[dict[int, np.ndarray], dict[int, str]]:
    """Axes (3, 3) of nodes that move in systems of their own, and, of other nodes, the system that is not known.

    Parameters
    ----------
    systems : mapping from number to Defined
    nodes : mapping from node to the number of its system
        Nodes of system 0 are in none of the results.
    points : mapping from node to place in basic axes
        Of nodes that move in cylindrical and spherical systems.
    """
    at = {node: Grid("0", np.array(place), nodes.get(node, "0")) for node, place in points.items()}
    return _axes(_Frames(systems, at), nodes)


def _axes(frames: _Frames, nodes: Mapping[int, str]) -> tuple[dict[int, np.ndarray], dict[int, str]]:
    """As `axes_in`. A node on the axis of a cylindrical or spherical system moves in its Cartesian axes."""
    found: dict[int, np.ndarray] = {}
    unknown: dict[int, str] = {}
    for node, number in nodes.items():
        try:
            if number != "0":
                own = frames.frame(number)
                turned = own.axes if own.kind == 0 else own.directions(frames.place(node, number))
                found[node] = (own.axes if turned is None else turned).T
        except LookupError as fault:
            unknown[node] = str(fault.args[0])
    return found, unknown


def turned_into_global(
    matrices: Mapping[str, Mapping[str, sp.coo_array]], rows: pd.DataFrame, axes: Mapping[int, np.ndarray], file: Path
) -> tuple[dict[str, dict[str, sp.coo_array]], int]:
    """Matrices over motions in global axes, and the number of nodes that were turned.

    With ``u_global = R u_own`` of each node a matrix becomes ``R A R^T``. Matrices are completed from one triangle
    first.

    Raises
    ------
    InputError
        For a node that has some of its three translations, or rotations, alone.
    """
    n = len(rows)
    named = rows["node"].notna().to_numpy()
    node = pd.to_numeric(rows["node"]).where(named, -1).astype(int).to_numpy()
    direction = pd.to_numeric(rows["direction"]).where(named, 0).astype(int).to_numpy()
    turn = sp.lil_array(sp.eye_array(n))
    count = 0
    for one in np.unique(node[named]):
        own = axes.get(int(one))
        if own is None or np.allclose(own, np.eye(3), atol=1e-12):
            continue
        count += 1
        here = {int(direction[k]): int(k) for k in np.flatnonzero(node == one)}
        for first in (1, 4):
            there = [here[d] for d in range(first, first + 3) if d in here]
            if there and len(there) < 3:
                raise InputError(f"node {one} moves in axes of its own, and has {len(there)} of three directions",
                                 place=file, remedy="let the matrices hold all three, or set its CD to 0")  # fmt: skip
            for i, row in enumerate(there):
                for j, column in enumerate(there):
                    turn[row, column] = own[i, j]
    if not count:
        return {kind: dict(held) for kind, held in matrices.items()}, 0
    rotation = sp.csr_array(turn)
    return {
        kind: {name: sp.coo_array(rotation @ _whole(one) @ rotation.T) for name, one in held.items()}
        for kind, held in matrices.items()
    }, count


def _whole(matrix: sp.coo_array) -> sp.csr_array:
    """The matrix, completed where one triangle is empty."""
    full = sp.csr_array(matrix)
    if not sp.tril(full, -1).nnz or not sp.triu(full, 1).nnz:
        return sp.csr_array(full + full.T - sp.diags_array(full.diagonal()))
    return full


def analysis_set(text: str) -> np.ndarray | None:
    """Node and direction of the rows of KAA and MAA, (n, 2) int; None where the deck does not name them.

    They are those of EXTRN, else of ASET, BSET, CSET and QSET entries, in the order of the nodes' numbers, as Nastran
    has them; scalar points have direction 0.
    """
    found: dict[str, set[tuple[int, int]]] = {"EXTRN": set(), "SETS": set()}
    for name, fields in bulk_entries(text):
        if name == "EXTRN" or re.fullmatch("[ABCQ]SET", name):
            for node, directions in zip(fields[::2], fields[1::2], strict=False):
                if node:
                    found[name if name == "EXTRN" else "SETS"] |= {(int(node), int(d)) for d in directions or "0"}
        elif re.fullmatch("[ABCQ]SET1", name):
            found["SETS"] |= {(node, int(d)) for node in _listed(fields[1:]) for d in fields[0] or "0"}
    rows = found["EXTRN"] or found["SETS"]
    return np.array(sorted(rows), dtype=int) if rows else None


def all_motions(text: str) -> np.ndarray | None:
    """Node and direction of the rows of KGG and MGG, (n, 2) int: six of each GRID, one of each SPOINT; None without.

    They are in the order of the nodes' numbers, as Nastran has them unless SEQGP states another, for which None stands.
    """
    found: set[tuple[int, int]] = set()
    for name, fields in bulk_entries(text):
        if name == "SEQGP":
            return None
        if name == "GRID":
            found |= {(int(fields[0]), d) for d in range(1, 7)}
        elif name == "SPOINT":
            found |= {(node, 0) for node in _listed(fields)}
    return np.array(sorted(found), dtype=int) if found else None


def _listed(fields: Sequence[str]) -> Iterable[int]:
    """Numbers of a list, of which ``THRU`` makes a range."""
    numbers = [field for field in fields if field]
    return range(int(numbers[0]), int(numbers[2]) + 1) if "THRU" in numbers else map(int, numbers)


def is_bulk(text: str) -> bool:
    """Whether a text has entries of Nastran about nodes, systems or sets."""
    return re.search(r"^(GRID|CORD2R|[ABCQ]SET1?|EXTRN)[\s*,]", text, re.MULTILINE | re.IGNORECASE) is not None
