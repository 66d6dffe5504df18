"""Quadrilaterals in three dimensions, projected on their mean planes, with bilinear shape functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from calib import InputError
from models.fem.beam import arm_matrix

CORNER = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
GAUSS = CORNER / np.sqrt(3.0)
_FLATTEST = 1e-6
"""Smallest parallelogram at a corner over the area of the element."""
_STRAIGHT = 0.1
"""Distortion at which edges take on half of their bending."""
_ROUNDING = 1e-12
"""Distortion of rectangles whose coordinates are rounded."""


def shape(at: np.ndarray) -> np.ndarray:
    """Bilinear shape functions at natural coordinates (..., 2), shape (..., 4)."""
    return np.prod(1 + at[..., None, :] * CORNER, axis=-1) / 4


def slope(at: np.ndarray) -> np.ndarray:
    """Derivatives of the shape functions by the natural coordinates (..., 2), shape (..., 2, 4)."""
    other = 1 + at[..., None, ::-1] * CORNER[:, ::-1]
    return np.swapaxes(CORNER * other, -1, -2) / 4


@dataclass(frozen=True, eq=False)
class Quads:
    """Flat projections of quadrilaterals.

    Attributes
    ----------
    corners : ndarray (n, 4, 2)
        In local axes about the centre, m.
    centre : ndarray (n, 3)
    axes : ndarray (n, 3, 3)
        Local axes as rows, z along the normal.
    arms : ndarray (n, 4, 3)
        From the nodes to the projected corners, global axes.
    allman : ndarray (n,)
        How far edges bend with the rotations of their ends: 0 not at all, 1 as those of Allman (1984). Elements that
        share an edge within one wall need the same value, or constant stresses are not in equilibrium across it.
    """

    corners: np.ndarray
    centre: np.ndarray
    axes: np.ndarray
    arms: np.ndarray
    allman: np.ndarray

    @cached_property
    def reach(self) -> np.ndarray:
        """Largest distance of a corner from the centre, shape (n,), m."""
        return np.asarray(np.linalg.norm(self.corners, axis=2).max(axis=1))

    @property
    def area(self) -> np.ndarray:
        """Areas, shape (n,), m2."""
        a, b = self.corners[:, 2] - self.corners[:, 0], self.corners[:, 3] - self.corners[:, 1]
        return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2

    @staticmethod
    def joined(parts: Sequence[Quads]) -> Quads:
        """Concatenation of several sets."""
        none = Quads(np.zeros((0, 4, 2)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 4, 3)), np.zeros(0))
        return Quads(*(np.concatenate([getattr(q, f.name) for q in (none, *parts)]) for f in fields(Quads)))

    def some(self, which: np.ndarray) -> Quads:
        """The elements at ``which``."""
        return Quads(*(getattr(self, f.name)[which] for f in fields(Quads)))

    @property
    def distortion(self) -> np.ndarray:
        """Estimated false over true energy in bending within the plane, if edges stay straight, shape (n,).

        Zero for rectangles only. Bent about one natural direction, the two edges along it move sideways by half their
        length squared; where taper makes their lengths differ, that feigns a mean strain across, whose energy grows
        with the fourth power of length over height. Skew counts with the squared cotangent of the angle between the
        natural directions.
        """
        jacobian = self.jacobian(np.zeros((1, 2)))[:, 0]
        first, second = jacobian[:, 0], jacobian[:, 1]
        det2 = np.linalg.det(jacobian) ** 2
        twist = CORNER.prod(axis=1) @ self.corners / 4
        taper = np.linalg.solve(np.swapaxes(jacobian, 1, 2), twist[..., None])[..., 0]
        along, across = (first**2).sum(axis=1), (second**2).sum(axis=1)
        parts = (taper[:, 0] * along**2) ** 2 + (taper[:, 1] * across**2) ** 2
        return np.asarray(3 * parts / det2**2 + (first * second).sum(axis=1) ** 2 / det2)

    def jacobian(self, at: np.ndarray) -> np.ndarray:
        """``d(x, y)/d(xi, eta)`` at natural coordinates (m, 2), row by natural coordinate, shape (n, m, 2, 2)."""
        return np.einsum("pan,enb->epab", slope(at), self.corners)

    def transformation(self) -> np.ndarray:
        """Local motions of the corners over global motions of the nodes, shape (n, 24, 24)."""
        t = np.zeros((len(self.centre), 24, 24))
        for corner in range(4):
            k = 6 * corner
            t[:, k : k + 3, k : k + 3] = t[:, k + 3 : k + 6, k + 3 : k + 6] = self.axes
            t[:, k : k + 3, k + 3 : k + 6] = self.axes @ arm_matrix(self.arms[:, corner])
        return t


def projected(nodes: np.ndarray, along: np.ndarray | None = None, place: str = "shell") -> Quads:
    """Project the quadrilaterals of one wall on their mean planes, which are parallel to both diagonals.

    Parameters
    ----------
    nodes : ndarray (n, 4, 3)
        Corners in turn, m.
    along : ndarray (3,), optional
        Its projection is the local x axis; without it the mean direction of the first and third edge.
    place : str
        Names the elements in messages.

    Raises
    ------
    InputError
        For corners that coincide, lie on a line, or form no convex quadrilateral; for ``along`` normal to an element.
    """
    centre = nodes.mean(axis=1)
    normal = np.cross(nodes[:, 2] - nodes[:, 0], nodes[:, 3] - nodes[:, 1])
    size = np.linalg.norm(normal, axis=1)
    longest = np.linalg.norm(nodes - centre[:, None], axis=2).max(axis=1)
    _refuse(size <= _FLATTEST * longest**2, centre, place, "has no area")
    normal = normal / size[:, None]
    first = nodes[:, 1] + nodes[:, 2] - nodes[:, 0] - nodes[:, 3]
    x = first if along is None else np.broadcast_to(np.asarray(along, dtype=float), first.shape)
    flat = x - np.einsum("ei,ei->e", x, normal)[:, None] * normal
    length = np.linalg.norm(flat, axis=1)
    _refuse(
        length <= 1e-6 * np.linalg.norm(x, axis=1), centre, place, "is normal to the panel's direction along",
        "choose a direction within the wall",
    )  # fmt: skip
    flat = flat / length[:, None]
    axes = np.stack([flat, np.cross(normal, flat), normal], axis=1)
    local = np.einsum("eij,enj->eni", axes, nodes - centre[:, None])
    back, on = local - np.roll(local, 1, axis=1), np.roll(local, -1, axis=1) - local
    turn = back[..., 0] * on[..., 1] - back[..., 1] * on[..., 0]
    _refuse(turn.min(axis=1) <= _FLATTEST * size / 2, centre, place, "is not convex, or two of its corners coincide")
    flat_corners, arms = local[..., :2], -local[..., 2, None] * normal[:, None]
    return one_wall(Quads(flat_corners, centre, axes, arms, np.zeros(len(centre))))


def one_wall(elements: Quads) -> Quads:
    """The same elements with edges that bend as the most distorted of them needs.

    With a distortion ``q`` and a share ``a`` of bent edges the false energy is about ``(1 - a)^2 q`` of the true one;
    ``a = q / (q + 0.1)`` keeps it below 2.5 % for every shape and lets rectangles keep straight edges.
    """
    worst = elements.distortion.max(initial=0.0)
    share = worst / (worst + _STRAIGHT) if worst > _ROUNDING else 0.0
    return replace(elements, allman=np.full(len(elements.centre), share))


def _refuse(
    bad: np.ndarray, centre: np.ndarray, place: str, problem: str,
    remedy: str = "give four corners in turn round a convex quadrilateral",
) -> None:  # fmt: skip
    if bad.any():
        x, y, z = centre[np.flatnonzero(bad)[0]]
        raise InputError(f"the element at ({x:.4g}, {y:.4g}, {z:.4g}) {problem}", place=place, remedy=remedy)
