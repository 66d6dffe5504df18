"""Nastran nodes that move in systems of their own (field CD of GRID), and matrices turned into global axes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.coordinates import bulk_entries, real

Systems = dict[str, tuple[str, np.ndarray]]
"""Systems of CORD2R by their number: that of the reference, and the points A, B and C, (3, 3)."""


def axes_of(file: Path, text: str) -> dict[int, np.ndarray]:
    """Axes of the nodes whose motions are not in the basic system, (3, 3) each: its columns are their x, y and z.

    Source: a system of CORD2R is given by its origin A, a point B on its z axis and a point C in its xz plane.

    Raises
    ------
    InputError
        For a node that moves in a cylindrical or spherical system, or one that is not in the file.
    """
    systems: Systems = {}
    others: dict[str, str] = {}
    nodes: dict[int, str] = {}
    for name, fields in bulk_entries(text):
        if name == "CORD2R" and len(fields) >= 11:
            systems[fields[0]] = fields[1] or "0", np.array([real(part) for part in fields[2:11]]).reshape(3, 3)
        elif name.startswith("CORD"):
            others[fields[0]] = name
        elif name == "GRID" and len(fields) > 5 and fields[5] not in ("", "0", "-1"):
            nodes[int(fields[0])] = fields[5]
    axes, unknown = axes_in(systems, nodes)
    for node, number in unknown.items():
        what = f"{others[number]} {number}" if number in others else f"system {number}"
        raise InputError(f"node {node} moves in {what}", place=file,
                         remedy="give its CORD2R in the same file, or write the matrices in global axes")  # fmt: skip
    return axes


def axes_in(systems: Systems, nodes: Mapping[int, str]) -> tuple[dict[int, np.ndarray], dict[int, str]]:
    """Axes (3, 3) of nodes that move in systems of CORD2R, and, of other nodes, the system that is not known.

    Parameters
    ----------
    systems : mapping from number to (number of the reference, (3, 3) points A, B and C)
    nodes : mapping from node to the number of its system
        Nodes of system 0 are in none of the results.
    """
    turned: dict[str, tuple[np.ndarray, np.ndarray]] = {"0": (np.zeros(3), np.eye(3))}

    def frame(number: str, depth: int = 0) -> tuple[np.ndarray, np.ndarray]:
        if number not in turned:
            if number not in systems or depth > len(systems):
                raise LookupError(number)
            reference, (a, b, c) = systems[number]
            origin, axes = frame(reference, depth + 1)
            z = (b - a) / np.linalg.norm(b - a)
            y = np.cross(z, c - a)
            y /= np.linalg.norm(y)
            turned[number] = origin + axes @ a, axes @ np.column_stack([np.cross(y, z), y, z])
        return turned[number]

    found: dict[int, np.ndarray] = {}
    unknown: dict[int, str] = {}
    for node, number in nodes.items():
        try:
            if number != "0":
                found[node] = frame(number)[1]
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
    """Node and direction of the rows of KAA and MAA, (n, 2) int, from EXTRN, ASET and ASET1 entries; None without.

    They are in the order of the nodes' numbers, as Nastran has them; scalar points have direction 0.
    """
    found: dict[str, set[tuple[int, int]]] = {"EXTRN": set(), "ASET": set()}
    for name, fields in bulk_entries(text):
        if name in ("EXTRN", "ASET"):
            for node, directions in zip(fields[::2], fields[1::2], strict=False):
                if node:
                    found[name] |= {(int(node), int(d)) for d in directions or "0"}
        elif name == "ASET1":
            nodes = [part for part in fields[1:] if part]
            listed = range(int(nodes[0]), int(nodes[2]) + 1) if "THRU" in nodes else map(int, nodes)
            found["ASET"] |= {(node, int(d)) for node in listed for d in fields[0] or "0"}
    rows = found["EXTRN"] or found["ASET"]
    return np.array(sorted(rows), dtype=int) if rows else None


def is_bulk(text: str) -> bool:
    """Whether a text has entries of Nastran about nodes, systems or sets."""
    return re.search(r"^(GRID|CORD2R|ASET1?|EXTRN)[\s*,]", text, re.MULTILINE | re.IGNORECASE) is not None
