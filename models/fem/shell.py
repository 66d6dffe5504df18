"""Flat four-node shell element with six motions a node, vectorised over elements.

Membrane and drilling: see `models.fem.membrane`. Bending: bilinear rotations with the assumed transverse shear of Bathe
and Dvorkin (1985, MITC4), free of shear locking. A warped quadrilateral is projected on its mean plane and rigid arms
lead from its nodes to the projected corners, so that rigid motions cause no strain.

Local motions are ``(ux, uy, uz, rx, ry, rz)`` at the four corners in turn, z along the normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.fem.membrane import membrane
from models.fem.quad import GAUSS, Quads, shape, slope
from models.fem.sheet import Sheet

_MID_BOTTOM, _MID_RIGHT, _MID_TOP, _MID_LEFT = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
_IN_PLANE = np.r_[(6 * np.arange(4)[:, None] + np.array([0, 1])).ravel(), 6 * np.arange(4) + 5]
_PLATE = (6 * np.arange(4)[:, None] + np.array([2, 3, 4])).ravel()


class Stiffness(NamedTuple):
    """The four contributions to the stiffness; their sum is the stiffness.

    Membrane, shear and drilling grow with the thickness and bending with its cube; all grow with the moduli. Shapes
    are (n, 24, 24) for elements, or those of whole models.
    """

    membrane: np.ndarray
    bending: np.ndarray
    shear: np.ndarray
    drilling: np.ndarray


def stiffness(elements: Quads, sheet: Sheet) -> Stiffness:
    """Element stiffness in local axes, each contribution of shape (n, 24, 24)."""
    flat, drilling = (_placed(blocks, _IN_PLANE) for blocks in membrane(elements, sheet))
    return Stiffness(flat, _bending(elements, sheet.bending), _shear(elements, sheet.shear), drilling)


def _gradients(elements: Quads) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of the shape functions by x and y (n, 4, 2, 4) and areas (n, 4) of the Gauss points."""
    jacobian = elements.jacobian(GAUSS)
    natural = np.broadcast_to(slope(GAUSS), (*jacobian.shape[:2], 2, 4))
    return np.linalg.solve(jacobian, natural), np.linalg.det(jacobian)


def _bending(elements: Quads, rigidity: np.ndarray) -> np.ndarray:
    """Bending from the bilinear rotations, shape (n, 24, 24)."""
    gradient, area = _gradients(elements)
    b = np.zeros((len(area), 4, 3, 12))  # kxx, kyy, 2 kxy over (uz, rx, ry) of corners
    b[:, :, 0, 2::3] = gradient[:, :, 0]
    b[:, :, 1, 1::3] = -gradient[:, :, 1]
    b[:, :, 2, 2::3], b[:, :, 2, 1::3] = gradient[:, :, 1], -gradient[:, :, 0]
    return _placed(_integrate(b, rigidity, area), _PLATE)


def _shear(elements: Quads, rigidity: np.ndarray) -> np.ndarray:
    """Transverse shear, interpolated between the middles of the edges (Bathe and Dvorkin 1985), shape (n, 24, 24)."""
    jacobian = elements.jacobian(GAUSS)
    ends = []
    for axis, low, high in ((0, _MID_BOTTOM, _MID_TOP), (1, _MID_LEFT, _MID_RIGHT)):
        weight = (1 + np.outer(GAUSS[:, 1 - axis], [-1.0, 1.0])) / 2
        rows = [_covariant_shear(elements, at, axis) for at in (low, high)]
        ends.append(np.einsum("ps,sej->epj", weight, np.array(rows)))
    b = np.linalg.solve(jacobian, np.stack(ends, axis=2))
    return _placed(_integrate(b, rigidity, np.linalg.det(jacobian)), _PLATE)


def _covariant_shear(elements: Quads, at: np.ndarray, axis: int) -> np.ndarray:
    """Shear angle times length along one natural coordinate, over (uz, rx, ry) of the corners, shape (n, 12)."""
    n, tangent = shape(at), elements.jacobian(at[None])[:, 0, axis]
    b = np.zeros((len(tangent), 12))
    b[:, 0::3] = slope(at)[axis]
    b[:, 1::3], b[:, 2::3] = -np.outer(tangent[:, 1], n), np.outer(tangent[:, 0], n)
    return b


def _integrate(b: np.ndarray, rigidity: np.ndarray, area: np.ndarray) -> np.ndarray:
    weighted = (rigidity @ b) * area[:, :, None, None]
    n, points, rows, columns = b.shape
    flat, weighted = b.reshape(n, points * rows, columns), weighted.reshape(n, points * rows, columns)
    return np.swapaxes(flat, 1, 2) @ weighted


def _placed(blocks: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Blocks (n, 12, 12) at 12 of the 24 motions."""
    out = np.zeros((len(blocks), 24, 24))
    out[:, motions[:, None], motions] = blocks
    return out


def mass(elements: Quads, per_area: float, rotary: float = 0.0) -> np.ndarray:
    """Consistent mass in local axes, shape (n, 24, 24); 2 x 2 points integrate it exactly.

    Parameters
    ----------
    elements : Quads
    per_area : float
        kg/m2.
    rotary : float
        Rotary inertia per area about the local x and y axes, kg; there is none about the normal.
    """
    area = np.linalg.det(elements.jacobian(GAUSS))
    products = np.einsum("pi,pj->pij", shape(GAUSS), shape(GAUSS))
    block = np.einsum("ep,pij->eij", area, products)
    out = np.zeros((len(area), 24, 24))
    for motion, weight in ((0, per_area), (1, per_area), (2, per_area), (3, rotary), (4, rotary)):
        where = 6 * np.arange(4) + motion
        out[:, where[:, None], where] = weight * block
    return out


def to_global(matrices: np.ndarray, t: np.ndarray) -> np.ndarray:
    """``t^T matrix t`` of every element, shape (n, 24, 24)."""
    return np.swapaxes(t, 1, 2) @ matrices @ t
