"""Timoshenko beam element in space, vectorised over elements.

Bending uses the interdependent interpolation of Friedman and Kosmatka (1993), whose stiffness is exact for end loads
and free of shear locking; the mass matrix is consistent and holds rotary inertia. Local motions of an element are
``(ux, uy, uz, rx, ry, rz)`` at its start, then at its end.
"""

from __future__ import annotations

import numpy as np

from models.fem.section import Section

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(4)
_XI, _WEIGHT = (_GAUSS_X + 1) / 2, _GAUSS_W / 2

# Where the four bending motions (w1, t1, w2, t2) of each plane sit among the twelve, and the sign of the rotation:
# rz = +duy/dx but ry = -duz/dx.
_PLANES = ((np.array([1, 5, 7, 11]), 1.0), (np.array([2, 4, 8, 10]), -1.0))


def shear_ratio(section: Section, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bending over shear flexibility, ``12 E I / (k G A L^2)``, in the local x-y and x-z planes; each (n,)."""
    stiff = section.shear_coefficient * section.shear_modulus * section.area * length**2
    return 12 * section.young_modulus * section.i_z / stiff, 12 * section.young_modulus * section.i_y / stiff


def bending_shape(xi: np.ndarray, length: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deflection and rotation along a beam over ``(w1, t1, w2, t2)`` (Friedman and Kosmatka 1993, eqs. 18-19).

    Parameters
    ----------
    xi : ndarray, broadcast with the others
        Position along the element, 0..1.
    length, phi : ndarray
        Length in m and shear ratio.

    Returns
    -------
    deflection, rotation : ndarray (..., 4)
    """
    xi, length, phi = np.broadcast_arrays(xi, length, phi)
    r = 1.0 / (1.0 + phi)
    deflection = np.stack(
        [
            r * (1 + phi - phi * xi - 3 * xi**2 + 2 * xi**3),
            r * length * ((1 + phi / 2) * xi - (2 + phi / 2) * xi**2 + xi**3),
            r * (phi * xi + 3 * xi**2 - 2 * xi**3),
            r * length * (-phi / 2 * xi - (1 - phi / 2) * xi**2 + xi**3),
        ],
        axis=-1,
    )
    rotation = np.stack(
        [
            r * 6 / length * (xi**2 - xi),
            r * (1 + phi - (4 + phi) * xi + 3 * xi**2),
            r * 6 / length * (xi - xi**2),
            r * ((phi - 2) * xi + 3 * xi**2),
        ],
        axis=-1,
    )
    return deflection, rotation


def motion(section: Section, length: float, xi: float) -> np.ndarray:
    """The six local motions at ``xi`` over the twelve local end motions, shape (6, 12)."""
    out = np.zeros((6, 12))
    out[0, [0, 6]] = out[3, [3, 9]] = 1 - xi, xi
    for (where, sign), phi, (w, t) in zip(
        _PLANES, shear_ratio(section, np.asarray(length)), ((1, 5), (2, 4)), strict=True
    ):
        deflection, rotation = bending_shape(np.asarray(xi), np.asarray(length), phi)
        signs = np.array([1, sign, 1, sign])
        out[w, where] = deflection * signs
        out[t, where] = sign * rotation * signs
    return out


def stiffness(section: Section, length: np.ndarray) -> np.ndarray:
    """Element stiffness in local axes, shape (n, 12, 12), for lengths (n,) in m."""
    n = len(length)
    k = np.zeros((n, 12, 12))
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    axial = section.young_modulus * section.area / length
    torsion = section.shear_modulus * section.torsion / length
    k[:, [[0], [6]], [0, 6]] = axial[:, None, None] * pair
    k[:, [[3], [9]], [3, 9]] = torsion[:, None, None] * pair
    for (where, sign), inertia, phi in zip(
        _PLANES, (section.i_z, section.i_y), shear_ratio(section, length), strict=True
    ):
        one = np.ones(n)
        a, b = 6 * length, length**2
        block = np.stack(
            [
                np.stack([12 * one, a, -12 * one, a], axis=-1),
                np.stack([a, (4 + phi) * b, -a, (2 - phi) * b], axis=-1),
                np.stack([-12 * one, -a, 12 * one, -a], axis=-1),
                np.stack([a, (2 - phi) * b, -a, (4 + phi) * b], axis=-1),
            ],
            axis=-2,
        )
        signs = np.array([1, sign, 1, sign])
        factor = section.young_modulus * inertia / (length**3 * (1 + phi))
        k[:, where[:, None], where] += factor[:, None, None] * block * np.outer(signs, signs)
    return k


def mass(section: Section, length: np.ndarray) -> np.ndarray:
    """Consistent element mass in local axes with rotary inertia, shape (n, 12, 12)."""
    density = section.density
    return distributed_mass(
        section,
        length,
        density * section.area,
        density * section.i_z,
        density * section.i_y,
        density * (section.i_y + section.i_z),
    )


def distributed_mass(
    section: Section,
    length: np.ndarray,
    per_length: float,
    rotary_z: float = 0.0,
    rotary_y: float = 0.0,
    polar: float = 0.0,
) -> np.ndarray:
    """Consistent mass of a distributed load on a beam, shape (n, 12, 12).

    Parameters
    ----------
    section : Section
        Gives the interpolation (through its shear flexibility).
    length : ndarray (n,)
    per_length : float
        kg/m.
    rotary_z, rotary_y, polar : float
        Rotary inertia per length about the local z, y and x axes, kg m.
    """
    n = len(length)
    m = np.zeros((n, 12, 12))
    pair = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
    m[:, [[0], [6]], [0, 6]] = (per_length * length)[:, None, None] * pair
    m[:, [[3], [9]], [3, 9]] = (polar * length)[:, None, None] * pair
    for (where, sign), rotary, phi in zip(_PLANES, (rotary_z, rotary_y), shear_ratio(section, length), strict=True):
        deflection, rotation = bending_shape(_XI[None, :], length[:, None], phi[:, None])
        block = per_length * np.einsum("g,egi,egj->eij", _WEIGHT, deflection, deflection)
        block = block + rotary * np.einsum("g,egi,egj->eij", _WEIGHT, rotation, rotation)
        signs = np.array([1, sign, 1, sign])
        m[:, where[:, None], where] += length[:, None, None] * block * np.outer(signs, signs)
    return m


def lumped_mass(length: np.ndarray, per_length: float) -> np.ndarray:
    """Half of a distributed load at either end, translations only, shape (n, 12, 12)."""
    m = np.zeros((len(length), 12, 12))
    for i in (0, 1, 2, 6, 7, 8):
        m[:, i, i] = per_length * length / 2
    return m


def axes(start: np.ndarray, end: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (n,) and local axes as rows (n, 3, 3) of elements from ``start`` to ``end`` (n, 3)."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    x = along / length[:, None]
    z = _cross(x, up)
    z /= np.linalg.norm(z, axis=1)[:, None]
    return length, np.stack([x, _cross(z, x), z], axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector product (n, 3); that of NumPy takes most of its time to look at shapes."""
    out = np.empty(a.shape)
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[:, k] = a[..., m] * b[..., n] - a[..., n] * b[..., m]
    return out


def to_global(matrices: np.ndarray, rotation: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Element matrices (n, 12, 12) from local axes at the beam's ends to global axes at its nodes.

    Parameters
    ----------
    matrices : ndarray (n, 12, 12)
    rotation : ndarray (n, 3, 3)
        Local axes as rows.
    arms : ndarray (n, 2, 3)
        Rigid arms from the nodes to the beam's ends, global axes.
    """
    return congruent(matrices, transformation(rotation, arms))


def transformation(rotation: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Local end motions over global nodal motions, shape (n, 12, 12)."""
    n = len(rotation)
    t = np.zeros((n, 12, 12))
    for block in range(4):
        t[:, 3 * block : 3 * block + 3, 3 * block : 3 * block + 3] = rotation
    for end in range(2):
        t[:, 6 * end : 6 * end + 3, 6 * end + 3 : 6 * end + 6] = rotation @ arm_matrix(arms[:, end])
    return t


def arm_matrix(arm: np.ndarray) -> np.ndarray:
    """Matrix A with ``u_tip = u + A theta`` (that is ``theta x arm``), shape (..., 3, 3) for arms (..., 3)."""
    out = np.zeros((*arm.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = arm[..., 2], -arm[..., 1]
    out[..., 1, 0], out[..., 1, 2] = -arm[..., 2], arm[..., 0]
    out[..., 2, 0], out[..., 2, 1] = arm[..., 1], -arm[..., 0]
    return out


def release(stiffness_: np.ndarray, mass_: np.ndarray, released: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Element matrices with hinged end motions condensed out (static condensation, Guyan 1965, for the mass).

    Parameters
    ----------
    stiffness_, mass_ : ndarray (n, 12, 12)
        Local axes.
    released : ndarray (12,), bool
        Local motions without force.
    """
    t = released_motion(stiffness_, released)
    return congruent(stiffness_, t), congruent(mass_, t)


def released_motion(stiffness_: np.ndarray, released: np.ndarray) -> np.ndarray:
    """Local end motions of a beam over those of its nodes, shape (n, 12, 12); hinged ones follow statically."""
    free, hinged = np.flatnonzero(~released), np.flatnonzero(released)
    t = np.zeros((len(stiffness_), 12, 12))
    t[:, free, free] = 1.0
    k_hh = stiffness_[:, hinged[:, None], hinged]
    # Releasing both ends of a motion leaves a rigid rotation without stiffness; it takes the least-norm solution.
    t[:, hinged[:, None], free] = -np.linalg.pinv(k_hh) @ stiffness_[:, hinged[:, None], free]
    return t


def congruent(matrices: np.ndarray, t: np.ndarray) -> np.ndarray:
    """``t^T matrix t`` of every element, shape (n, 12, 12)."""
    return np.einsum("eki,ekl,elj->eij", t, matrices, t, optimize=True)
