"""What effects are made of: springs between places, hung masses, dampers on soft mounts.

All act at points of the geometry through a model's locator, so that an effect is the same on every mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError
from calib.structure.affine import Coefficient, Monomial, Term
from calib.structure.extend import Addition
from calib.structure.model import StructuralModel

Place = tuple[str | None, tuple[float, float, float]]
"""Part that carries a point (None for the nearest), and the point in m."""


def motion(model: StructuralModel, place: Place, direction: int) -> np.ndarray:
    """Motion of a place over the model's degrees of freedom, (n_dof,); direction 0..5 for ux, uy, uz, rx, ry, rz.

    InputError for an unknown part, or a point farther from its part than the model is large.
    """
    part, point = place
    row, distance = model.locator.row(point, direction, part)
    extent = float(np.ptp(model.mesh.points, axis=0).max(initial=0.0))
    if distance > max(extent, model.sensor_tolerance):
        raise InputError(
            f"the point ({', '.join(f'{c:g}' for c in point)}) lies {distance:.4g} m from the {part or 'model'}",
            remedy="coordinates are in m",
        )
    return row


def between(model: StructuralModel, one: Place, other: Place, direction: int) -> np.ndarray:
    """Relative motion of two places, (n_dof,); for translations both should be one point, or rotations would enter."""
    return motion(model, one, direction) - motion(model, other, direction)


def outer_term(name: str, rows: Sequence[np.ndarray], coefficient: Coefficient, n_added: int = 0) -> Term:
    """The sum of ``b b^T`` over motions b (n_dof,), such as springs of one stiffness, with degrees of freedom added."""
    stacked = sp.csr_array(np.pad(np.atleast_2d(np.asarray(rows, dtype=float)), ((0, 0), (0, n_added))))
    stacked.eliminate_zeros()
    return Term(name, sp.csr_array(stacked.T @ stacked), coefficient)


def hung_masses(rows: Sequence[np.ndarray], mass: str, freq: str, damping_ratio: float, share: float = 1.0) -> Addition:
    """Masses hung elastically at motions of a model, one degree of freedom each.

    With b the motion of the attachment and s the relative motion times the root of the mass, the kinetic energy is
    ``m b'^2/2 + sqrt(m) b' s' + s'^2/2`` and the strain energy ``(2 pi f)^2 s^2/2``: regular at mass 0, where the
    oscillators stand by themselves.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
    mass, freq : str
        Names of the parameters: mass of them all together, natural frequency on a fixed base.
    damping_ratio : float
        Of the oscillators on a fixed base.
    share : float
        Part of the mass that each of them takes, times their number.
    """
    count = len(rows)
    part = share / count
    own, cross = _beside(rows)
    return Addition(
        stiffness=(Term(f"{mass}: spring", own, Monomial((2 * math.pi) ** 2, ((freq, 2.0),))),),
        damping=(Term(f"{mass}: damper", own, Monomial(4 * math.pi * damping_ratio, ((freq, 1.0),))),),
        mass=(
            outer_term(f"{mass}: carried along", rows, Monomial(part, ((mass, 1.0),)), count),
            Term(f"{mass}: coupling", cross, Monomial(math.sqrt(part), ((mass, 0.5),))),
            Term(f"{mass}: own", own),
        ),
        n_added=count,
    )


def soft_mounts(rows: Sequence[np.ndarray], damping: str, flexibility: str) -> Addition:
    """Dampers that a model holds rigidly, each with the flexibility of its mount in series (Maxwell elements).

    With s the flexibility and ``g = x/sqrt(s)`` for the deflection x of the mount, the balance of forces between mount
    and damper is ``g + c s g' - c sqrt(s) b' = 0``: regular at flexibility 0, where g is 0.

    Parameters
    ----------
    rows : sequence of ndarray (n_dof,)
        Elongation of each damper.
    damping, flexibility : str
        Names of the parameters: constant of each damper, flexibility of each mount.
    """
    count = len(rows)
    own, cross = _beside(rows)
    return Addition(
        stiffness=(Term(f"{flexibility}: mounts", own),),
        damping=(
            Term(f"{flexibility}: own", own, Monomial(1.0, ((damping, 1.0), (flexibility, 1.0)))),
            Term(f"{flexibility}: coupling", cross, Monomial(-1.0, ((damping, 1.0), (flexibility, 0.5)))),
        ),
        n_added=count,
    )


def elongation(model: StructuralModel, one: Place, other: Place) -> np.ndarray:
    """Elongation of a rod between two places, (n_dof,), along the line that joins them."""
    along = np.subtract(one[1], other[1])
    along = along / np.linalg.norm(along)
    moves = [motion(model, one, d) - motion(model, other, d) for d in range(3)]
    return np.asarray(along @ np.array(moves))


def _beside(rows: Sequence[np.ndarray]) -> tuple[sp.csr_array, sp.csr_array]:
    """Unit matrix of one added degree of freedom a row, and its coupling with that row; over all degrees of freedom."""
    n, count = len(rows[0]), len(rows)
    own = sp.csr_array(sp.diags_array(np.concatenate([np.zeros(n), np.ones(count)])))
    own.eliminate_zeros()
    motions = sp.csr_array(np.asarray(rows, dtype=float))
    cross = sp.hstack([sp.csr_array((n + count, n)), sp.vstack([motions.T, sp.csr_array((count, count))])])
    return own, sp.csr_array(cross + cross.T)
