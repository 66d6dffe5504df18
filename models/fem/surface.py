"""Nearest place on shell elements to a point, and its motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.fem.beam import arm_matrix
from models.fem.quad import CORNER, Quads, shape, slope


class Foot(NamedTuple):
    """Nearest place on shell elements.

    Attributes
    ----------
    element : int
    at : ndarray (2,)
        Natural coordinates within it.
    place : ndarray (3,)
        m.
    edge : int
        Edge 0..3 (from corner k to the next) it lies on; -1 inside the element.
    beside : float
        In-plane distance of the point from the element, m.
    """

    element: int
    at: np.ndarray
    place: np.ndarray
    edge: int
    beside: float


def foot(elements: Quads, point: np.ndarray) -> Foot:
    """Nearest place to a point (3,) on the projected elements."""
    away = np.linalg.norm(elements.centre - point, axis=1)
    near = np.flatnonzero(away - elements.reach <= away.min() * (1 + 1e-12))
    corners = elements.corners[near]
    p = np.einsum("eij,ej->ei", elements.axes[near], point - elements.centre[near])
    along = np.roll(corners, -1, axis=1) - corners
    gap = p[:, None, :2] - corners
    t = np.clip(np.einsum("eki,eki->ek", gap, along) / np.einsum("eki,eki->ek", along, along), 0.0, 1.0)
    beside = np.linalg.norm(gap - t[..., None] * along, axis=2)
    inside = np.all(along[..., 0] * gap[..., 1] - along[..., 1] * gap[..., 0] >= 0, axis=1)
    edge = np.where(inside, -1, beside.argmin(axis=1))
    beside = np.where(inside, 0.0, beside.min(axis=1))
    k = int(np.argmin(np.hypot(beside, p[:, 2])))
    if inside[k]:
        at = _natural(corners[k], p[k, :2])
    else:
        turn = CORNER[[edge[k], (edge[k] + 1) % 4]]
        at = turn[0] + t[k, edge[k]] * (turn[1] - turn[0])
    e = int(near[k])
    place = elements.centre[e] + shape(at) @ corners[k] @ elements.axes[e, :2]
    return Foot(e, at, place, int(edge[k]), float(beside[k]))


def _natural(corners: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Natural coordinates of a point inside a convex quadrilateral, by Newton's method."""
    at = np.zeros(2)
    for _ in range(50):
        step = np.linalg.solve((slope(at) @ corners).T, p - shape(at) @ corners)
        at = np.clip(at + step, -1.0, 1.0)
        if np.abs(step).max() < 1e-14:
            break
    return at


def motion(elements: Quads, place: Foot, point: np.ndarray) -> np.ndarray:
    """Six motions of a point that a rigid arm ties to its foot, over the 24 nodal motions, shape (6, 24).

    Bilinear like the element's own displacements and rotations.
    """
    n = shape(place.at)
    out = np.zeros((6, 24))
    arms = arm_matrix(elements.arms[place.element])
    reach = arm_matrix(point - place.place)
    for corner in range(4):
        k = 6 * corner
        out[:3, k : k + 3] = out[3:, k + 3 : k + 6] = n[corner] * np.eye(3)
        out[:3, k + 3 : k + 6] = n[corner] * (arms[corner] + reach)
    return out


def edges(nodes: np.ndarray) -> np.ndarray:
    """Both ends of each edge (from corner k to the next), lower number first, shape (4 n, 2), from nodes (n, 4)."""
    return np.sort(np.stack([nodes, np.roll(nodes, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)


def free_edges(nodes: np.ndarray) -> np.ndarray:
    """Whether each edge (from corner k to the next) belongs to one element only, shape (n, 4), from nodes (n, 4)."""
    _, which, count = np.unique(edges(nodes), axis=0, return_inverse=True, return_counts=True)
    return (count[which.ravel()] == 1).reshape(-1, 4)
