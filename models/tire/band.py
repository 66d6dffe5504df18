"""Symmetric matrices in a band, with a factor that also serves when the matrix is not positive definite."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import lapack

from calib import EvaluationError


@dataclass(frozen=True)
class SymmetricBand:
    """A symmetric matrix by its lower band.

    Attributes
    ----------
    lower : (bandwidth + 1, n) ndarray
        ``lower[k, j]`` is the entry (j + k, j).
    """

    lower: np.ndarray

    def __add__(self, other: SymmetricBand) -> SymmetricBand:
        return SymmetricBand(self.lower + other.lower)

    def __mul__(self, factor: float) -> SymmetricBand:
        return SymmetricBand(self.lower * factor)

    def matrix(self) -> sparse.csr_array:
        """Return the whole matrix, (n, n)."""
        n = self.lower.shape[1]
        rows, cols = np.nonzero(self.lower)
        entry = self.lower[rows, cols]
        half = sparse.csr_array((entry, (rows + cols, cols)), shape=(n, n))
        return (half + half.T - sparse.diags_array(self.lower[0])).tocsr()

    def factor(self) -> BandFactor:
        """Cholesky factor; LU where the matrix is indefinite.

        Raises
        ------
        EvaluationError
            For a singular matrix or values that are not finite.
        """
        if not np.isfinite(self.lower).all():
            raise EvaluationError("the tangent stiffness of the tire is not finite")
        chol, info = lapack.dpbtrf(self.lower, lower=1)
        if info == 0:
            return BandFactor(chol, None)
        k, n = self.lower.shape[0] - 1, self.lower.shape[1]
        full = np.zeros((3 * k + 1, n), order="F")
        full[2 * k :] = self.lower
        for d in range(1, k + 1):
            full[2 * k - d, d:] = self.lower[d, : n - d]
        lu, pivots, info = lapack.dgbtrf(full, k, k)
        if info:
            raise EvaluationError("the tangent stiffness of the tire is singular")
        return BandFactor(lu, pivots)


@dataclass(frozen=True)
class BandFactor:
    """Factor of a symmetric band; `solve` takes (n,) or (n, k)."""

    data: np.ndarray
    pivots: np.ndarray | None

    @property
    def positive_definite(self) -> bool:
        """Whether the matrix is positive definite."""
        return self.pivots is None

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution for one or several right sides."""
        if self.pivots is None:
            return linalg.cho_solve_banded((self.data, True), right, check_finite=False)
        k = (self.data.shape[0] - 1) // 3
        out, info = lapack.dgbtrs(self.data, k, k, right, self.pivots)
        if info:
            raise EvaluationError("the tangent stiffness of the tire cannot be solved")
        return out
