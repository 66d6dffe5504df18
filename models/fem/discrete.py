"""Springs, dampers and point masses between points of a frame, and attachments spread over several points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError
from models.fem.beam import arm_matrix
from models.fem.frame import Frame, Point

FEWEST_FEET = 4


class Spider(NamedTuple):
    """A place that moves as the mean of several feet on a part, which it does not stiffen.

    The feet share a force evenly and a moment in proportion to their distance from their centre: the place moves with
    the feet's mean motion and with the rotation that fits them best (least squares, as in an RBE3 element). Feet are
    geometry: they stay where they are when the mesh is refined.

    Attributes
    ----------
    on : str
        Body or group that carries the feet.
    point : (3,) coordinates in m
    feet : tuple of points
        Offsets of the feet from the place, m; at least four, not all on one line.
    """

    on: str
    point: Point
    feet: tuple[Point, ...]

    def motion(self, frame: Frame, offset: Point = (0.0, 0.0, 0.0)) -> np.ndarray:
        """Six motions of the place, or of a point rigidly held at an offset from it, shape (6, n_full)."""
        called = f"spider at {self.point} on {self.on!r}"
        feet = np.asarray(self.feet, dtype=float).reshape(-1, 3)
        if len(feet) < FEWEST_FEET:
            raise InputError(
                f"it has {len(feet)} feet",
                place=called,
                remedy=f"give at least {FEWEST_FEET}, so that none rules alone",
            )
        centre = feet.mean(axis=0)
        across = feet - centre
        inertia = np.einsum("ij,ij->", across, across) * np.eye(3) - across.T @ across
        sizes = np.linalg.eigvalsh(inertia)
        if not sizes[0] > 1e-6 * sizes[-1]:
            raise InputError("its feet lie on one line", place=called, remedy="spread them over an area")
        moved = np.array([frame.motion(self.point + foot, self.on)[0][:3] for foot in feet])
        # The offsets add up to nothing, so the mean motion drops out of the moments.
        turned = np.linalg.solve(inertia, np.einsum("fij,fjk->ik", arm_matrix(-across), moved))
        shifted = moved.mean(axis=0) + arm_matrix(np.asarray(offset) - centre) @ turned
        return np.concatenate([shifted, turned])


End = tuple[str, Point] | Spider
"""A body or group and a place, which a rigid arm ties to the nearest point of that part; or a spider."""


def end_motion(frame: Frame, end: End, offset: Point = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Six motions of an end, or of a point held at an offset from it, over all nodal motions, shape (6, n_full)."""
    if isinstance(end, Spider):
        return end.motion(frame, offset)
    return frame.motion(np.add(end[1], offset), end[0])[0]


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
        Acts between rotations about ``direction``.
    weight : float
        Multiplies the stiffness or damping value of its term.
    name : str
        Springs of one name and term are one part of the model.
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
        out = d @ end_motion(frame, self.end)[part]
        if self.other is not None:
            gap = np.subtract(self.end[1], self.other[1])
            if not self.rotational and np.linalg.norm(np.cross(gap, d)) > 1e-6:
                raise InputError(
                    f"its points {self.end[1]} and {self.other[1]} are not in line with its direction",
                    place="spring",
                    remedy="let both ends meet in one point, or turn the spring along the line between them",
                )
            out = out - d @ end_motion(frame, self.other)[part]
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
        Offsets over which the mass is shared out evenly; one zero offset means a point.
    name : str
        Masses of one name are one part of the model.
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
            rows.append(end_motion(frame, item.at, offset))
            weights.append(np.array([item.mass] * 3 + list(item.inertia)) / len(item.spread))
    if not rows:
        return sp.csr_array((n, n))
    stacked = sp.csr_array(np.concatenate(rows))
    return sp.csr_array(stacked.T @ sp.diags_array(np.concatenate(weights)) @ stacked)


@dataclass(frozen=True)
class FrameLocator:
    """Finds points of the geometry on a frame, over its free degrees of freedom."""

    frame: Frame
    expansion: sp.csr_array

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """See `calib.structure.model.Locator`."""
        rows, distance = self.frame.motion(point, on)
        return rows[direction] @ self.expansion, distance
