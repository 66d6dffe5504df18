"""Walls: panels that continue one another without a fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from models.fem.quad import Quads
from models.fem.surface import edges

_FOLD = np.cos(np.radians(35.0))
"""Cosine of the angle between normals from which on an edge is a fold."""


def walls(corners: np.ndarray, normals: np.ndarray, panel_of: np.ndarray) -> np.ndarray:
    """The wall of every element, shape (n,), int.

    Panels belong to one wall where elements of both share an edge and their normals differ by less than 35 degrees.

    Parameters
    ----------
    corners : ndarray (n, 4), int
        Nodes of the elements.
    normals : ndarray (n, 3)
    panel_of : ndarray (n,), int
    """
    _, edge, count = np.unique(edges(corners), axis=0, return_inverse=True, return_counts=True)
    by_edge = np.argsort(edge.ravel(), kind="stable")
    element, edge = by_edge // 4, edge.ravel()[by_edge]
    pairs = [np.zeros((0, 2), dtype=int)]
    for apart in range(1, count.max(initial=0)):
        both = np.stack([element[:-apart], element[apart:]], axis=1)[edge[:-apart] == edge[apart:]]
        flat = np.abs((normals[both[:, 0]] * normals[both[:, 1]]).sum(axis=1)) > _FOLD
        pairs.append(panel_of[both[flat]])
    one, other = np.concatenate(pairs).T
    size = int(panel_of.max(initial=-1)) + 1
    joined = sp.coo_array((np.ones(len(one)), (one, other)), shape=(size, size))
    return np.asarray(connected_components(joined, directed=False)[1][panel_of])


def evened(elements: Quads, corners: np.ndarray, panel_of: np.ndarray) -> Quads:
    """The same elements whose edges bend alike within each wall, as its most distorted element needs."""
    if not len(corners):
        return elements
    wall_of = walls(corners, elements.axes[:, 2], panel_of)
    most = np.zeros(wall_of.max() + 1)
    np.maximum.at(most, wall_of, elements.allman)
    return replace(elements, allman=most[wall_of])
