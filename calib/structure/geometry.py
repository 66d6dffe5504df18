"""Geometry of a model: mesh, map of degrees of freedom, and location of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from calib.structure.sparse_indices import require_consistent


@dataclass(frozen=True)
class Mesh:
    """Nodes, lines and faces of a model, for figures and for locating points.

    Attributes
    ----------
    points : ndarray (n_nodes, 3)
        Coordinates in metres.
    lines : ndarray (n_lines, 2), int
        Node indices of each line element and of each edge of a face.
    groups : tuple of str
        Group name of each line; an edge has that of a face.
    faces : ndarray (n_faces, 4), int
        Node indices of each shell element, in turn.
    face_groups : tuple of str
        Group name of each face.
    axes : str
        What they mean on this structure, such as ``x to the front, y up, z to the left``; empty where it is not stated.
    """

    points: np.ndarray
    lines: np.ndarray
    groups: tuple[str, ...]
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), dtype=int))
    face_groups: tuple[str, ...] = ()
    axes: str = ""

    @property
    def placed(self) -> np.ndarray:
        """Which points have coordinates, (n_nodes,), bool."""
        return np.isfinite(self.points).all(axis=1)


@dataclass(frozen=True)
class DofMap:
    """Nodal motions in terms of the free degrees of freedom.

    Attributes
    ----------
    expansion : csr_array (6 * n_nodes, n_dof)
        Nodal motions (ux, uy, uz, rx, ry, rz of every node) over the free degrees of freedom; rows of suppressed
        motions are empty, those of shared or rigidly linked motions have several entries.
    node, direction : ndarray (n_dof,), int
        Node index and direction index (0..5) that name each free degree of freedom; the node is -1 where it has none.
    """

    expansion: sp.csr_array
    node: np.ndarray
    direction: np.ndarray

    def __post_init__(self) -> None:
        if sp.issparse(self.expansion):
            require_consistent(self.expansion, "model, expansion of the degrees of freedom")

    @property
    def n_dof(self) -> int:
        """Number of free degrees of freedom."""
        return self.expansion.shape[1]


class Locator(Protocol):
    """Finds points of the geometry on a model."""

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """Motion of a point over the free degrees of freedom.

        Parameters
        ----------
        point : (3,) coordinates in metres
        direction : int
            0..5 for ux, uy, uz, rx, ry, rz.
        on : str, optional
            Name of the part that carries the point; default the nearest part.

        Returns
        -------
        row : ndarray (n_dof,)
        distance : float
            From the point to the part, in metres.
        """
        ...


@dataclass(frozen=True)
class NodeLocator:
    """Finds the nearest node, for a model without elements to interpolate in.

    Attributes
    ----------
    points : ndarray (n_nodes, 3)
        Coordinates, m.
    expansion : csr_array (6 * n_nodes, n_dof)
        As in `DofMap`.
    """

    points: np.ndarray
    expansion: sp.csr_array

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """See `Locator`; there are no parts, and ``on`` is ignored."""
        distance = np.linalg.norm(self.points - np.asarray(point, dtype=float), axis=1)
        nearest = int(np.argmin(distance))
        return self.expansion[[6 * nearest + direction]].toarray()[0], float(distance[nearest])


def at_nodes(locator: Locator) -> bool:
    """Whether a locator finds nodes only, so that the motion between them is unknown."""
    while not isinstance(locator, NodeLocator):
        inner = getattr(locator, "inner", None)  # that of an extended model
        if inner is None:
            return False
        locator = inner
    return True
