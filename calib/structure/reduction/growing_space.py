"""A space of directions that grows step by step, with matrices projected on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

_ORTHOGONAL = 1e-12
"""Largest product of an old direction with a new one: a thousand times that of rounding."""


class GrowingSpace:
    """A growing space and the matrices projected on it; each step multiplies only the directions that are new.

    Directions times ``scale`` are orthonormal, as K is nearly diagonal after division by it. Columns that depend on
    others become any further direction. Old directions are taken out of new ones twice, which suffices for independent
    columns (Giraud, Langou, Rozloznik and van den Eshof 2005); where it does not, all are made orthonormal anew.

    Parameters
    ----------
    matrices : sequence of sparse matrix (n_dof, n_dof)
        Symmetric.
    scale : ndarray (n_dof, 1)
        Positive.
    """

    def __init__(self, matrices: Sequence[sp.csc_array], scale: np.ndarray) -> None:
        self._matrices, self._scale = tuple(matrices), scale
        self.basis = np.zeros((len(scale), 0))
        """Directions, (n_dof, n)."""
        self.projected = tuple(np.zeros((0, 0)) for _ in matrices)
        """Symmetric, (n, n) each, in the order of the matrices."""

    def add(self, columns: np.ndarray) -> None:
        """Extend the space by columns, (n_dof, k)."""
        scaled = self._scale * columns
        old, new = self._scale * self.basis, scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        every = np.hstack([old, new])
        for _ in range(2 if old.shape[1] else 1):
            new = _orthonormal(new - old @ (old.T @ new))
        if every.shape[1] > len(old) or np.max(np.abs(old.T @ new), initial=0.0) > _ORTHOGONAL:
            new = _orthonormal(every)
            self.basis, self.projected = self.basis[:, :0], tuple(one[:0, :0] for one in self.projected)
        more = new / self._scale
        self.projected = tuple(
            _bordered(inner, self.basis, more, matrix)
            for inner, matrix in zip(self.projected, self._matrices, strict=True)
        )
        self.basis = np.hstack([self.basis, more])


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    directions: np.ndarray = la.qr(columns, mode="economic", check_finite=False)[0]
    return directions


def _bordered(inner: np.ndarray, old: np.ndarray, new: np.ndarray, matrix: sp.csc_array) -> np.ndarray:
    """A symmetric matrix projected on old and new directions, from that on the old ones."""
    image = matrix @ new
    beside, corner = old.T @ image, new.T @ image
    return np.block([[inner, beside], [beside.T, 0.5 * (corner + corner.T)]])
