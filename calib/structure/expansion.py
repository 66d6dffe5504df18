"""Expansion of shapes from sensors to all degrees of freedom of a model, and its test-analysis mass matrix.

A shape y at the sensors becomes ``x = T y`` over all degrees of freedom. Sensors may point anywhere and lie between
nodes: their motion is ``y = S x``, with one row of S for each. Two choices of T:

- SEREP, ``T = Phi (S Phi)^+`` (O'Callahan, Avitabile and Riemer 1989): the combination of some mode shapes of the model
  that fits the sensors best, in least squares. What the modes cannot explain remains as a residual at the sensors.
- static (Guyan 1965): the sensors are held at y and everything else follows without inertia. It keeps the sensors'
  values.

``M_TAM = T^T M T`` is the mass matrix at the sensors, that of a test-analysis model (Kammer 1987). With it the
mass-orthogonality of shapes is checked that are known there only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.reduction.static_reduction import static_reduction

_ALIKE = 1e-8
"""Smallest singular value over the largest below which modes look alike at the sensors, or sensors repeat others."""

_PLACE = "expansion"


@dataclass(frozen=True, eq=False)
class Expansion:
    """The motion of a whole model by that of its sensors.

    Attributes
    ----------
    rows : ndarray (n_sensors, n_dof)
        S: motion of every sensor over the degrees of freedom, as `StructuralModel.sensor_rows` gives it.
    transformation : ndarray (n_dof, n_sensors)
        T; complex where the shapes behind it are.
    """

    rows: np.ndarray
    transformation: np.ndarray

    def expand(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes at the sensors (n_sensors, n_modes) over all degrees of freedom (n_dof, n_modes); real or complex."""
        return np.asarray(self.transformation @ shapes)

    def residual(self, shapes: np.ndarray) -> np.ndarray:
        """Share of each shape that its expansion leaves at the sensors, ``|y - S T y|/|y|``, (n_modes,).

        About 0 for a static expansion, and 0 of a zero shape.
        """
        left = np.linalg.norm(shapes - self.rows @ self.expand(shapes), axis=0)
        size = np.linalg.norm(shapes, axis=0)
        return np.divide(left, size, out=np.zeros_like(left), where=size > 0)

    def mass(self, mass: sp.csc_array) -> np.ndarray:
        """Test-analysis mass matrix ``T^H M T`` of a mass matrix (n_dof, n_dof); (n_sensors, n_sensors), SI."""
        found = self.transformation.conj().T @ (mass @ self.transformation)
        return np.asarray((found + found.conj().T) / 2)


def serep_expansion(rows: np.ndarray, shapes: np.ndarray) -> Expansion:
    """Expansion by mode shapes of the model: a shape in their span is recovered exactly, others in least squares.

    Parameters
    ----------
    rows : ndarray (n_sensors, n_dof)
        Motion of the sensors.
    shapes : ndarray (n_dof, n_modes)
        Real or complex, at most as many as sensors; their scale does not matter.

    Raises
    ------
    InputError
        For no modes, more modes than sensors, or modes that the sensors cannot tell apart.
    """
    seen = rows @ shapes
    n_sensors, n_modes = seen.shape
    if not 0 < n_modes <= n_sensors:
        raise InputError(
            f"{n_modes} modes are to be fitted to {n_sensors} sensors", place=_PLACE,
            remedy="give at least one mode and at most as many as sensors",
        )  # fmt: skip
    size = np.linalg.norm(seen, axis=0)
    still = size <= _ALIKE * np.linalg.norm(shapes, axis=0)
    whole = np.where(still, 1.0, size)  # modes of other units or scales are as good
    values = la.svdvals(np.where(still, 0.0, seen / whole))
    apart = int(np.count_nonzero(values > _ALIKE * max(values[0], 1.0)))
    if apart < n_modes:
        raise InputError(
            f"{n_sensors} sensors tell {apart} of {n_modes} modes apart", place=_PLACE,
            remedy="give fewer modes or more sensors",
        )  # fmt: skip
    return Expansion(rows, (shapes / whole) @ la.pinv(seen / whole))


def static_expansion(
    stiffness: sp.csc_array, mass: sp.csc_array, rows: np.ndarray, names: Sequence[str] = ()
) -> Expansion:
    """Static expansion (Guyan 1965): least strain energy for the given motion of the sensors, which is kept.

    Sensors become degrees of freedom first: each replaces one that it moves with, so that sensors between nodes and in
    oblique directions are masters like others.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    rows : ndarray (n_sensors, n_dof)
        Motion of the sensors, linearly independent.
    names : sequence of str
        Of the sensors, for the message.

    Raises
    ------
    InputError
        When the motion of some sensors follows from that of others.
    EvaluationError
        When a part moves without strain while the sensors are held.
    """
    replaced = _replaced(rows, names)
    n = rows.shape[1]
    rest = np.setdiff1d(np.arange(n), replaced)
    own = la.inv(rows[:, replaced])
    back = sp.coo_array(np.concatenate([own, -own @ rows[:, rest]], axis=1))
    columns = np.concatenate([replaced, rest])
    # Degrees of freedom over the sensors, at the places of those that they replace, and the others.
    turned = sp.csc_array(
        (
            np.concatenate([back.data, np.ones(len(rest))]),
            (np.concatenate([replaced[back.row], rest]), np.concatenate([columns[back.col], rest])),
        ),
        shape=(n, n),
    )
    found = static_reduction(
        sp.csc_array(turned.T @ stiffness @ turned), sp.csc_array(turned.T @ mass @ turned), replaced
    )
    return Expansion(rows, turned @ found.transformation)


def _replaced(rows: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Degrees of freedom that the sensors replace, as many; InputError where some sensors follow from others."""
    size = np.linalg.norm(rows, axis=1)
    scaled = rows / np.where(size > 0, size, 1.0)[:, None]
    _, upper, order = la.qr(scaled.T, mode="economic", pivoting=True)
    found = np.abs(np.diagonal(upper))
    rank = int(np.count_nonzero(found > _ALIKE * max(float(found.max(initial=0.0)), 1.0)))
    if rank < len(rows):
        over = sorted(order[rank:].tolist())
        listed = ", ".join(names[k] if len(names) else f"row {k} (counted from 0)" for k in over)
        raise InputError(
            f"the motion of {listed} follows from that of the other sensors", place=_PLACE,
            remedy="leave these sensors out or expand by modes",
        )  # fmt: skip
    return np.asarray(la.qr(scaled, mode="r", pivoting=True)[1][: len(rows)], dtype=int)
