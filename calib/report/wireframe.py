"""The wireframe of a test: lines between sensors that are neighbours on the mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from calib.report.mesh import Mesh, element_corners, element_edges, places


def wireframe(mesh: Mesh, sensors: np.ndarray) -> np.ndarray:
    """Return pairs of sensors between which no other one lies along the mesh.

    Every point of the mesh belongs to the sensor that is nearest along edges; two sensors are neighbours where an edge
    joins their points. A sensor counts as at its nearest point. Parts that no edge joins stay apart.

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
    used = np.unique(edges)
    at = used[cKDTree(rest[used]).query(sensors)[1]]
    weights = sp.csr_array((length, (edges[:, 0], edges[:, 1])), shape=(len(rest), len(rest)))
    owners = dijkstra(weights, directed=False, indices=np.unique(at), min_only=True, return_predecessors=True)[2]
    first = {point: k for k, point in reversed(list(enumerate(at.tolist())))}
    joined = {
        (min(first[a], first[b]), max(first[a], first[b]))
        for a, b in owners[edges].tolist()
        if a != b and a >= 0 and b >= 0
    }
    return np.array(sorted(joined), dtype=int).reshape(-1, 2)


def _merged(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points, and the place of each: bodies meet where points of both coincide."""
    fine = 1e-6 * float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    _, first, same = np.unique(np.round(points / fine), axis=0, return_index=True, return_inverse=True)
    return points[first], same.reshape(-1)
