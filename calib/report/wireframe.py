"""The wireframe of a test: lines between sensors that are neighbours on the mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from calib.report.mesh import Mesh, element_corners, element_edges, places


def wireframe(mesh: Mesh, sensors: np.ndarray) -> np.ndarray:
    """Return pairs of sensors that are neighbours along the mesh.

    They are the Gabriel neighbours (Gabriel and Sokal 1969) by distances d along edges: no third sensor r has
    d(p, r)^2 + d(r, q)^2 < d(p, q)^2. So lines follow rows of sensors, no diagonal cuts a corner that has a sensor, and
    a line through the inside of a hollow body gives way to those along its walls. All sensors of a body are connected.
    A sensor counts as at its nearest point. Parts that no edge joins stay apart.

    Parameters
    ----------
    mesh : Mesh
    sensors : ndarray (n_places, 3)
        Metres.

    Returns
    -------
    ndarray (n, 2), int
        Rows of ``sensors``, the smaller first, each pair once.
    """
    rest, same = _merged(places(mesh))
    edges = np.unique(np.sort(same[element_edges(element_corners(mesh))], axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    if not len(sensors) or not len(edges):
        return np.zeros((0, 2), dtype=int)
    length = np.maximum(np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1), 1e-12)
    both = np.concatenate([edges, edges[:, ::-1]]).T
    weights = sp.csr_array((np.tile(length, 2), tuple(both)), shape=(len(rest), len(rest)))
    used = np.unique(edges)
    at, first = np.unique(used[cKDTree(rest[used]).query(sensors)[1]], return_index=True)
    reach = _reach(weights, edges, length, at)
    distance = np.array([dijkstra(weights, indices=one, limit=reach)[at] for one in at])
    pairs = np.argwhere(np.triu(np.isfinite(distance), 1))
    kept = first[pairs[_gabriel(distance, pairs)]]
    return np.unique(np.sort(kept, axis=1), axis=0)


def _reach(weights: sp.csr_array, edges: np.ndarray, length: np.ndarray, at: np.ndarray) -> float:
    """Distance along the mesh up to which pairs are tried: within it the sensors of each body are connected.

    Every point of the mesh belongs to its nearest sensor. The paths over the edges that join the points of two sensors
    contain the minimum spanning tree of all sensors (Mehlhorn 1988); this is the longest of the shortest such paths.
    """
    far, _, nearest = dijkstra(weights, indices=at, min_only=True, return_predecessors=True)
    owners = nearest[edges]
    between = (owners[:, 0] != owners[:, 1]) & (owners >= 0).all(axis=1)
    if not between.any():
        return 0.0
    _, which = np.unique(np.sort(owners[between], axis=1), axis=0, return_inverse=True)
    paths = np.full(which.max() + 1, np.inf)
    np.minimum.at(paths, which.reshape(-1), (length + far[edges].sum(axis=1))[between])
    return float(paths.max()) * (1 + 1e-9)


def _gabriel(distance: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Mask of the pairs (n, 2) that no third sensor separates; ``distance`` (n_at, n_at) is infinite beyond reach."""
    square = distance**2
    separates = [(square[a] + square[b] < square[a, b] * (1 - 1e-9)).any() for a, b in pairs.tolist()]
    return ~np.array(separates, dtype=bool)


def _merged(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points, and the place of each: bodies meet where points of both coincide."""
    fine = 1e-6 * float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    _, first, same = np.unique(np.round(points / fine), axis=0, return_index=True, return_inverse=True)
    return points[first], same.reshape(-1)
