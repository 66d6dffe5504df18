"""Membrane of a four-node shell element with rotations about the normal (drilling), vectorised over elements.

Assumed stresses in equilibrium (Pian 1964): three constant ones and, along each natural direction of the centre, one
that is linear across it (Pian and Sumihara 1984, here in Cartesian terms, so that equilibrium is exact in every shape).
Their work is taken on the edges alone. Edges bend with the difference of the rotations at their ends (Allman 1984), as
far as `Quads.allman` says.

No element of four nodes without rotations passes the patch test and bends as a trapezoid without locking (MacNeal
1987, 1992): its straight edges feign a strain across. With bent edges bending within the plane is nearly exact in every
shape. A rectangle needs none: its stiffness with straight edges is that of the incompatible modes of Taylor, Beresford
and Wilson (1976, QM6).

The stresses leave four patterns of rotation without energy. A penalty (Hughes and Brezzi 1989) ties the rotations to
that of the assumed field, so that in-plane bending pays nothing for it (Ibrahimbegovic and Wilson 1991).

Motions are ``(ux, uy)`` of the four corners in turn, then their ``rz``.
"""

from __future__ import annotations

import numpy as np

from models.fem.quad import CORNER, GAUSS, Quads, shape
from models.fem.sheet import Sheet

_PATTERNS = np.stack([np.ones(4), *CORNER.T, CORNER.prod(axis=1)]) / 4
"""From four corners to mean, both slopes and twist, as factors of 1, xi, eta and xi eta."""


def membrane(elements: Quads, sheet: Sheet) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of membrane and drilling over the in-plane motions, each of shape (n, 12, 12)."""
    area = elements.area
    jacobian = elements.jacobian(np.zeros((1, 2)))[:, 0]
    weight = np.linalg.det(elements.jacobian(GAUSS))
    points = shape(GAUSS) @ elements.corners
    arms = elements.corners - (weight[:, None] @ points / area[:, None, None])
    points = points + (arms - elements.corners)[:, :1]
    # Linear functions about the centroid: the second natural coordinate for stresses along the first, and vice versa.
    gradient = np.linalg.inv(jacobian)[:, :, ::-1]
    work = _work_of_linear_stresses(elements, jacobian, arms @ gradient)
    voigt = np.stack([jacobian[..., 0] ** 2, jacobian[..., 1] ** 2, jacobian[..., 0] * jacobian[..., 1]], axis=2)
    strain = voigt @ np.linalg.inv(sheet.membrane)
    at = points @ gradient
    flexibility = (np.swapaxes(at, 1, 2) * weight[:, None]) @ at * (voigt @ np.swapaxes(strain, 1, 2))
    stress = np.linalg.solve(flexibility, work)
    mean = _mean_strain(elements)
    constant = np.swapaxes(mean, 1, 2) @ sheet.membrane @ mean * area[:, None, None]
    rotation = _mean_rotation(elements) + arms @ (_rotation_gradient(strain, gradient) @ stress)
    return constant + np.swapaxes(work, 1, 2) @ stress, _tie(rotation, area, sheet)


def _edges(elements: Quads) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of the edges from each corner to the next, and outward normals of the same length, (n, 4, 2)."""
    along = np.roll(elements.corners, -1, axis=1) - elements.corners
    return along, np.stack([along[..., 1], -along[..., 0]], axis=2)


def _mean_strain(elements: Quads) -> np.ndarray:
    """Mean strains (xx, yy, xy) over the motions, from the displacement of the edges, shape (n, 3, 12)."""
    _, normal = _edges(elements)
    outward = (normal + np.roll(normal, 1, axis=1)) / 2
    out = np.zeros((len(normal), 3, 12))
    out[:, 0, 0:8:2] = out[:, 2, 1:8:2] = outward[..., 0]
    out[:, 1, 1:8:2] = out[:, 2, 0:8:2] = outward[..., 1]
    # The bent edge bulges along its normal by (difference of rotations) length s (1 - s) / 2, on average a sixth of it.
    bulge = np.stack([normal[..., 0] ** 2, normal[..., 1] ** 2, 2 * normal[..., 0] * normal[..., 1]], axis=1) / 12
    bulge *= elements.allman[:, None, None]
    out[:, :, 8:] = np.roll(bulge, 1, axis=2) - bulge
    return np.asarray(out / elements.area[:, None, None])


def _mean_rotation(elements: Quads) -> np.ndarray:
    """Mean rotation over the motions, from the circulation along the edges, shape (n, 1, 12)."""
    along, _ = _edges(elements)
    out = np.zeros((len(along), 1, 12))
    out[:, 0, :8] = (along + np.roll(along, 1, axis=1)).reshape(-1, 8) / 4 / elements.area[:, None]
    return out


def _work_of_linear_stresses(elements: Quads, directions: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Work of the edges' tractions on the motions, shape (n, 2, 12), N m for stresses ``t t^T`` times ``at``.

    Parameters
    ----------
    elements : Quads
    directions : ndarray (n, 2, 2)
        Of the two stresses, as rows ``t``.
    at : ndarray (n, 4, 2)
        Their linear factors at the corners.
    """
    _, normal = _edges(elements)
    flow = normal @ np.swapaxes(directions, 1, 2)
    there = np.roll(at, -1, axis=1)
    pull = flow * (at / 3 + there / 6) + np.roll(flow * (at / 6 + there / 3), 1, axis=1)
    out = np.zeros((len(at), 2, 12))
    out[:, :, :8] = np.einsum("eck,eki->ekci", pull, directions).reshape(-1, 2, 8)
    bulge = np.swapaxes(flow**2 * (at + there) / 24, 1, 2) * elements.allman[:, None, None]
    out[:, :, 8:] = np.roll(bulge, 1, axis=2) - bulge
    return out


def _rotation_gradient(strain: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Derivatives of the rotation by x and y for each of two linear strain fields, shape (n, 2, 2).

    Compatibility gives them: ``exy,x - exx,y`` and ``eyy,x - exy,y``.
    """
    xx, yy, xy = strain[..., 0], strain[..., 1], strain[..., 2] / 2
    by_x, by_y = gradient[:, 0], gradient[:, 1]
    return np.stack([xy * by_x - xx * by_y, yy * by_x - xy * by_y], axis=1)


def _tie(rotation: np.ndarray, area: np.ndarray, sheet: Sheet) -> np.ndarray:
    """Penalty on rotations of the corners that differ from ``rotation`` (n, 4, 12) of the field, shape (n, 12, 12).

    A difference with a slope is in series with the shear that would follow it, four times as stiff as the shear
    modulus; the penalty is twice the drilling factor times that modulus.
    """
    apart = -rotation
    apart[:, np.arange(4), 8 + np.arange(4)] += 1
    sloped = 1 / (3 * (1 + sheet.drilling_factor / 2))
    apart = (_PATTERNS * np.sqrt([[1], [sloped], [sloped], [1 / 9]])) @ apart
    return np.asarray(np.swapaxes(apart, 1, 2) @ apart * (sheet.drilling * area)[:, None, None])
