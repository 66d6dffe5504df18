"""Distributing couplings (RBE3): attachments whose load is shared by several points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib import InputError
from models.fem.beam import arm_matrix
from models.fem.frame import Frame
from models.fem.member import Point

FEWEST_FEET = 4


@dataclass(frozen=True)
class Rbe3:
    """Distributing coupling (RBE3): a massless rigid body that follows the mean motion of its feet.

    Its translation is the mean of the feet, its rotation their least-squares fit, and it adds no stiffness between
    them: a force through their centre is shared evenly, a moment in proportion to the distance from it. Feet are places
    of the geometry and do not move when the mesh is refined.

    Attributes
    ----------
    name : str
        Name by which springs, masses and sensors attach to it, as to a body or group.
    on : str
        Body or group that carries the feet.
    feet : tuple of points
        At least four, not all on one line, m.
    """

    name: str
    on: str
    feet: tuple[Point, ...]

    def __post_init__(self) -> None:
        if len(self.feet) < FEWEST_FEET:
            raise InputError(
                f"it has {len(self.feet)} feet",
                place=f"RBE3 {self.name!r}",
                remedy=f"give at least {FEWEST_FEET}, so that the load is shared",
            )
        sizes = np.linalg.eigvalsh(self._inertia())
        if not sizes[0] > 1e-6 * sizes[-1]:
            raise InputError("its feet lie on one line", place=f"RBE3 {self.name!r}", remedy="spread them over an area")

    @property
    def centre(self) -> np.ndarray:
        """Mean place of the feet, shape (3,), m."""
        return np.mean(np.asarray(self.feet, dtype=float), axis=0)

    def _across(self) -> np.ndarray:
        return np.asarray(self.feet, dtype=float) - self.centre

    def _inertia(self) -> np.ndarray:
        across = self._across()
        return np.einsum("ij,ij->", across, across) * np.eye(3) - across.T @ across

    def motion(self, frame: Frame, point: np.ndarray) -> np.ndarray:
        """Six motions of a point (3,) of the rigid body over all nodal motions, shape (6, n_full)."""
        return self.follow(np.array([frame.motion(foot, self.on)[0][:3] for foot in self.feet]), point)

    def follow(self, feet: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Six motions of a point (3,) from the shifts of the feet (n_feet, 3, n), shape (6, n)."""
        # The offsets from the centre sum to zero, so the mean motion drops out of the moments.
        moments = np.einsum("fij,fjk->ik", arm_matrix(-self._across()), feet)
        turned = np.linalg.solve(self._inertia(), moments)
        return np.concatenate([feet.mean(axis=0) + arm_matrix(point - self.centre) @ turned, turned])
