"""Springs, dampers and point masses between points of a frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from calib import InputError
from models.fem.frame import Frame
from models.fem.member import Point

End = tuple[str, Point]
"""A body or group and a place; a rigid arm ties the place to the nearest point of that part."""


@dataclass(frozen=True)
class Spring:
    """A spring or damper of one direction between two points, or between a point and the ground.

    Its two points must coincide or lie on a line along its direction: otherwise a rigid rotation would strain it.

    Attributes
    ----------
    end : End
    other : End or None
        None is the ground.
    direction : (3,) float
        Any length but zero.
    rotational : bool
        Whether it acts between rotations about ``direction``.
    weight : float
        Factor on the stiffness or damping value of its term.
    name : str
        Springs of one name and term form one part of the model.
    """

    end: End
    other: End | None
    direction: Point
    rotational: bool = False
    weight: float = 1.0
    name: str = ""

    def row(self, frame: Frame) -> np.ndarray:
        """Elongation over all nodal motions, shape (n_full,)."""
        d = np.asarray(self.direction, dtype=float)
        size = np.linalg.norm(d)
        if not size > 0:
            raise InputError("its direction is zero", place=f"spring at {self.end}")
        d = d / size
        part = slice(3, 6) if self.rotational else slice(0, 3)
        out = d @ frame.motion(self.end[1], self.end[0])[0][part]
        if self.other is not None:
            gap = np.subtract(self.end[1], self.other[1])
            if not self.rotational and np.linalg.norm(np.cross(gap, d)) > 1e-6:
                raise InputError(
                    f"its points {self.end[1]} and {self.other[1]} are not in line with its direction",
                    place="spring",
                    remedy="let both ends meet in one point, or turn the spring along the line between them",
                )
            out = out - d @ frame.motion(self.other[1], self.other[0])[0][part]
        return out


def rod(end: End, other: End, weight: float = 1.0, name: str = "") -> Spring:
    """A spring along the line between its two points."""
    along = np.subtract(end[1], other[1])
    return Spring(end, other, (float(along[0]), float(along[1]), float(along[2])), weight=weight, name=name)


def spring_matrix(frame: Frame, springs: Iterable[Spring]) -> sp.csr_array:
    """Sum of ``weight b b^T`` over the springs, shape (n_full, n_full), for a value of 1."""
    springs = tuple(springs)
    rows = sp.csr_array(np.array([s.row(frame) for s in springs]))
    weights = sp.diags_array([s.weight for s in springs])
    return sp.csr_array(rows.T @ weights @ rows)


@dataclass(frozen=True)
class PointMass:
    """A rigid mass tied to a point.

    Attributes
    ----------
    at : End
    mass : float
        kg.
    inertia : (3,) float
        About the global axes through its own centre, kg m2.
    spread : tuple of points
        Offsets over which the mass is distributed evenly; one zero offset means a point.
    name : str
        Masses of one name form one part of the model.
    """

    at: End
    mass: float
    inertia: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spread: tuple[Point, ...] = ((0.0, 0.0, 0.0),)
    name: str = ""


def mass_matrix(frame: Frame, masses: Sequence[PointMass]) -> sp.csr_array:
    """Mass matrix (n_full, n_full) of point masses; off-axis ones act through rigid arms."""
    n = frame.n_full
    rows, weights = [], []
    for item in masses:
        for offset in item.spread:
            place = np.add(item.at[1], offset)
            rows.append(frame.motion(place, item.at[0])[0])
            weights.append(np.array([item.mass] * 3 + list(item.inertia)) / len(item.spread))
    if not rows:
        return sp.csr_array((n, n))
    stacked = sp.csr_array(np.concatenate(rows))
    return sp.csr_array(stacked.T @ sp.diags_array(np.concatenate(weights)) @ stacked)


@dataclass(frozen=True)
class FrameLocator:
    """Motions of points of the geometry over the free degrees of freedom of a frame."""

    frame: Frame
    expansion: sp.csr_array

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """See `calib.structure.model.Locator`."""
        rows, distance = self.frame.motion(point, on)
        return self._turned @ rows[direction], distance

    @cached_property
    def _turned(self) -> sp.csc_array:
        """Transpose of the expansion, computed once."""
        return sp.csc_array(self.expansion.T)
