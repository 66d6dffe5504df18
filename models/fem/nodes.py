"""Table of shared nodes, and assembly of matrices over their motions."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

MERGE = 1e-6
"""Nodes of one body closer than this (m) are one node."""


@dataclass
class NodeTable:
    """Nodes in the order of their first use; filled while a structure is numbered."""

    points: list[np.ndarray] = field(default_factory=list)
    bodies: list[str] = field(default_factory=list)
    _near: dict[tuple[str, tuple[int, ...]], list[int]] = field(default_factory=dict)

    def number(self, body: str, place: np.ndarray) -> int:
        """Number of the node of a body at a place (3,); a new node is added if there is none."""
        known = (k for cell in _cells(place) for k in self._near.get((body, cell), ()))
        node = next((k for k in known if np.linalg.norm(self.points[k] - place) <= MERGE), len(self.points))
        if node == len(self.points):
            self._near.setdefault((body, _cell(place)), []).append(node)
            self.points.append(place)
            self.bodies.append(body)
        return node


def _cell(place: np.ndarray) -> tuple[int, ...]:
    """Cell of a grid ten times coarser than `MERGE`."""
    return tuple(int(c) for c in np.round(place / (10 * MERGE)))


def _cells(place: np.ndarray) -> Iterator[tuple[int, ...]]:
    """Every cell that may hold a node closer than `MERGE`: two along an axis where the place is near a border."""
    both = zip(_cell(place - MERGE), _cell(place + MERGE), strict=True)
    return itertools.product(*(sorted({low, high}) for low, high in both))


def assemble(nodes: np.ndarray, blocks: np.ndarray, n_full: int) -> sp.csr_array:
    """Matrix (n_full, n_full) of element blocks (n, 6 m, 6 m) over the motions of their nodes (n, m)."""
    n, size = len(nodes), 6 * nodes.shape[1]
    dofs = (6 * nodes[:, :, None] + np.arange(6)).reshape(n, size)
    rows, columns = np.repeat(dofs, size, axis=1).ravel(), np.tile(dofs, (1, size)).ravel()
    return sp.csr_array(sp.coo_array((blocks.ravel(), (rows, columns)), shape=(n_full, n_full)))
