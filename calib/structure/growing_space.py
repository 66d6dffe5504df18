"""A space of directions that grows step by step, with matrices projected on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp


class GrowingSpace:
    """A growing space and the matrices projected on it; each step multiplies only the directions that are new.

    Directions are orthonormal after division by ``scale``, where K is nearly diagonal. Columns that depend on others
    become any further direction. Old directions are taken out of new ones twice, which suffices for orthogonality to
    machine precision (Giraud, Langou, Rozloznik and van den Eshof 2005).

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
        if old.shape[1] + new.shape[1] > len(old):  # more columns than directions: begin anew with all there are
            old, new = old[:, :0], np.hstack([old, new])
            self.projected = tuple(one[:0, :0] for one in self.projected)
        for _ in range(2 if old.shape[1] else 1):
            new = la.qr(new - old @ (old.T @ new), mode="economic", check_finite=False)[0]
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
