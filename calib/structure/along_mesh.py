"""Nodes before and after a place along a mesh."""

from __future__ import annotations

import numpy as np

from calib.structure.geometry import Mesh

_STRAIGHT = 0.9
"""Cosine of the largest angle between two lines of one member."""
_AXES = "xyz"


def along_mesh(mesh: Mesh, point: tuple[float, float, float]) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Directions in which the mesh goes on from the node nearest to a place.

    Parameters
    ----------
    mesh : Mesh
        All points with coordinates.
    point : (3,) float
        m.

    Returns
    -------
    list of (axis, before, after)
        Such as ``x`` with the neighbouring points (3,), m, against and along it; at a free end one of them is the node
        itself. The axis is the coordinate along which the direction mostly goes, with a number where it occurs twice.
    """
    at = np.asarray(point, dtype=float)
    node = int(np.argmin(np.linalg.norm(mesh.points - at, axis=1)))
    ends = mesh.lines[np.any(mesh.lines == node, axis=1)]
    others = np.unique(ends[ends != node])
    here = mesh.points[node]
    ways = [(other, mesh.points[other] - here) for other in others.tolist()]
    ways = [(other, way / np.linalg.norm(way)) for other, way in ways if np.linalg.norm(way) > 0]
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    used: set[int] = set()
    for other, way in ways:
        if other in used:
            continue
        used.add(other)
        axis = int(np.argmax(np.abs(way)))
        opposite = [o for o, w in ways if o not in used and float(way @ w) < -_STRAIGHT]
        used.update(opposite[:1])
        back = mesh.points[opposite[0]] if opposite else here
        first, last = (back, mesh.points[other]) if way[axis] > 0 else (mesh.points[other], back)
        same = sum(name.startswith(_AXES[axis]) for name, _, _ in found)
        found.append((_AXES[axis] + (f" ({same + 1})" if same else ""), first, last))
    return found
