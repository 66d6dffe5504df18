"""A space of directions that grows step by step, with matrices projected on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

_ORTHOGONAL = 1e-12
"""Largest product of an old direction with a new one."""


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
        self._scaled = np.zeros((len(scale), 0))
        self.projected = tuple(np.zeros((0, 0)) for _ in matrices)
        """Symmetric, (n, n) each, in the order of the matrices."""

    @property
    def basis(self) -> np.ndarray:
        """Directions, (n_dof, n)."""
        return self._scaled / self._scale

    def add(self, columns: np.ndarray) -> None:
        """Extend the space by columns, (n_dof, k)."""
        new, old = self._scale * columns, self._scaled
        new = new / np.maximum(np.linalg.norm(new, axis=0), 1e-300)
        apart = new
        for _ in range(2 if old.shape[1] else 1):
            apart = la.qr(apart - old @ (old.T @ apart), mode="economic", check_finite=False)[0]
        every = np.hstack([old, new])
        if every.shape[1] > len(old) or np.max(np.abs(old.T @ apart), initial=0.0) > _ORTHOGONAL:
            old, apart = old[:, :0], la.qr(every, mode="economic", check_finite=False)[0]
            self.projected = tuple(one[:0, :0] for one in self.projected)
        new = apart
        self._scaled = np.hstack([old, new])
        self.projected = tuple(
            _bordered(inner, old / self._scale, new / self._scale, matrix)
            for inner, matrix in zip(self.projected, self._matrices, strict=True)
        )


def _bordered(inner: np.ndarray, old: np.ndarray, new: np.ndarray, matrix: sp.csc_array) -> np.ndarray:
    """A symmetric matrix projected on old and new directions, from that on the old ones."""
    image = matrix @ new
    beside, corner = old.T @ image, new.T @ image
    return np.block([[inner, beside], [beside.T, 0.5 * (corner + corner.T)]])
