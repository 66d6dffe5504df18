"""Thin rectangular plate element of twelve motions (Adini and Clough 1960, Melosh 1963): bending alone.

Nodes go round the rectangle from its corner at the origin: (0, 0), (a, 0), (a, b), (0, b). Each has the deflection w
along z and the rotations rx = dw/dy and ry = -dw/dx. The deflection is the cubic polynomial with x^3 y and x y^3 added;
its slope normal to an edge is not continuous.
"""

from __future__ import annotations

import numpy as np

POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3))
"""Of x and y in the twelve terms of the deflection."""

_POINT, _WEIGHT = np.polynomial.legendre.leggauss(4)  # exact for the mass, of degree 6 in either direction


def _terms(x: np.ndarray, y: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """Derivative of the twelve terms at points (n,), shape (n, 12)."""
    out = np.zeros((len(x), len(POWERS)))
    for k, (p, q) in enumerate(POWERS):
        if p >= dx and q >= dy:
            factor = np.prod(np.arange(p - dx + 1, p + 1)) * np.prod(np.arange(q - dy + 1, q + 1))
            out[:, k] = factor * x ** (p - dx) * y ** (q - dy)
    return out


def shape(a: float, b: float, x: np.ndarray, y: np.ndarray, dx: int = 0, dy: int = 0) -> np.ndarray:
    """Deflection, or its derivative, over the twelve nodal motions.

    Parameters
    ----------
    a, b : float
        Sides along x and y, m.
    x, y : ndarray (n,)
        Points, 0..a and 0..b.
    dx, dy : int
        Order of the derivative.

    Returns
    -------
    ndarray (n, 12)
    """
    corner_x, corner_y = np.array([0.0, a, a, 0.0]), np.array([0.0, 0.0, b, b])
    nodal = np.stack(
        [_terms(corner_x, corner_y, 0, 0), _terms(corner_x, corner_y, 0, 1), -_terms(corner_x, corner_y, 1, 0)], axis=1
    ).reshape(12, 12)
    return np.linalg.solve(nodal.T, _terms(np.asarray(x), np.asarray(y), dx, dy).T).T


def _points(a: float, b: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss points and weights on the rectangle, each (16,)."""
    x, y = np.meshgrid((_POINT + 1) * a / 2, (_POINT + 1) * b / 2, indexing="ij")
    return x.ravel(), y.ravel(), np.outer(_WEIGHT * a / 2, _WEIGHT * b / 2).ravel()


def stiffness(a: float, b: float, thickness: float, poisson_ratio: float) -> np.ndarray:
    """Bending stiffness for a Young's modulus of 1, shape (12, 12): m^4 (w, w), m^5, m^6 over m^3.

    Parameters
    ----------
    a, b, thickness : float
        m.
    poisson_ratio : float
    """
    x, y, weight = _points(a, b)
    curvature = np.stack(
        [shape(a, b, x, y, 2, 0), shape(a, b, x, y, 0, 2), 2 * shape(a, b, x, y, 1, 1)], axis=1
    )  # (16, 3, 12)
    nu = poisson_ratio
    rigidity = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1 - nu) / 2]])
    rigidity *= thickness**3 / (12 * (1 - nu**2))
    return np.einsum("g,gki,kl,glj->ij", weight, curvature, rigidity, curvature)


def mass(a: float, b: float, per_area: float) -> np.ndarray:
    """Consistent mass of a plate of ``per_area`` kg/m^2 without rotary inertia, shape (12, 12)."""
    x, y, weight = _points(a, b)
    deflection = shape(a, b, x, y)
    return per_area * np.einsum("g,gi,gj->ij", weight, deflection, deflection)
