"""Places of measured nodes: common to all repeats, and contradictions between two files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError

Point = tuple[float, float, float]

REPEAT_TOLERANCE = 1e-4
"""Largest distance of a node between repeats, relative to the size of the geometry; universal files have six digits."""
TABLE_TOLERANCE = 0.005
"""The same between a sensor table and the universal files: tape measures are read to millimetres."""
MILLIMETRES = 1000.0
UNIT_TOLERANCE = 0.02
"""Relative tolerance of the factor by which two sets of places count as the same in different units."""


class Doubt(str):
    """A note on reading that must not be missed, such as what was left out of a fit; see `doubts.doubts_of`."""


@dataclass(frozen=True)
class Misplaced:
    """A node whose place in the sensor table contradicts the universal files.

    Attributes
    ----------
    node : int
    table, file : tuple of float
        Its two places, m; that of the table is used.
    distance : float
        Between them, m.
    """

    node: int
    table: Point
    file: Point
    distance: float


def common_points(
    given: Sequence[tuple[str, Mapping[int, Point]]], table: Mapping[int, object]
) -> Mapping[int, Point] | None:
    """Places of the nodes, which must not differ between repeats; None when no file has any.

    Parameters
    ----------
    given : sequence of (source, places by node in m)
    table : mapping from node to anything
        Nodes whose places the sensor table gives; their places in the files may differ.
    """
    common: dict[int, Point] = {}
    origin: dict[int, str] = {}
    for source, points in given:
        for node, point in points.items():
            common.setdefault(node, point)
            origin.setdefault(node, source)
    if not common:
        return None
    size = _size(list(common.values()))
    for source, points in given:
        for node, point in points.items():
            moved = max(abs(a - b) for a, b in zip(common[node], point, strict=True))
            if node not in table and moved > REPEAT_TOLERANCE * size:
                raise InputError(
                    f"node {node} is at another place than in {origin[node]}",
                    place=source,
                    remedy="correct one of them, or give the node in the sensor table",
                )
    return common


def place_conflicts(
    points: Mapping[int, Point], table: Mapping[int, Point]
) -> tuple[tuple[Misplaced, ...], float | None]:
    """Nodes whose places in table and universal files differ, most distant first, and the unit factor that explains it.

    Two places differ when they are further apart than `TABLE_TOLERANCE` of the size of the geometry that the universal
    files span. The factor is 1000 or 1/1000 (table over files) when the table is the same geometry in other units:
    within 2 % for the median of all coordinates, and most nodes agree once it is divided out.
    """
    shared = [node for node in table if node in points]
    if not shared:
        return (), None
    ours = np.array([table[node] for node in shared])
    theirs = np.array([points[node] for node in shared])
    tolerance = TABLE_TOLERANCE * _size(list(points.values()))
    apart = np.linalg.norm(ours - theirs, axis=1)
    order = [int(k) for k in np.argsort(-apart, kind="stable") if apart[k] > tolerance]
    misplaced = tuple(Misplaced(shared[k], table[shared[k]], points[shared[k]], float(apart[k])) for k in order)
    large = np.abs(theirs) > tolerance
    if not misplaced or not large.any():
        return misplaced, None
    ratio = float(np.median(np.abs(ours[large] / theirs[large])))
    for factor in (MILLIMETRES, 1 / MILLIMETRES):
        if abs(ratio / factor - 1) < UNIT_TOLERANCE:
            left = np.linalg.norm(ours / factor - theirs, axis=1)
            if np.median(left) <= tolerance:
                return misplaced, factor
    return misplaced, None


def _size(points: Sequence[Point]) -> float:
    """Largest extent of a set of points, m; 1 where all coincide."""
    return float(np.max(np.ptp(np.array(points), axis=0))) or 1.0
