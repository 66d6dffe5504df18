"""Strain energy of a reduced model by cluster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import Term


@dataclass(frozen=True, eq=False)
class ClusterEnergy:
    """Strain energy of one cluster as a quadratic form over the basis.

    Attributes
    ----------
    vectors : ndarray (n_dof, size)
        Of the basis.
    members : ndarray (n_members,), int
        Degrees of freedom of the cluster.
    terms : tuple of Term
        Of the stiffness.
    supports : tuple of mapping from tuple of int to ndarray (size,)
        ``V_c^T b_c`` of every selected vector with entries in the cluster, one mapping for each selected term.
    inner : ClusterEnergy, optional
        Of the model that this one extends; its blocks are shared.
    """

    vectors: np.ndarray
    members: np.ndarray
    terms: tuple[Term, ...]
    supports: tuple[Mapping[tuple[int, ...], np.ndarray], ...]
    inner: ClusterEnergy | None = None
    _blocks: dict[int, np.ndarray | None] = field(init=False, repr=False, default_factory=dict)

    def matrix(self, factors: Sequence[float]) -> np.ndarray:
        """Symmetric part of ``V_c^T K_c V``."""
        out = np.zeros((self.vectors.shape[1],) * 2)
        for q, factor in enumerate(factors):
            block = self.block(q) if factor else None
            if block is not None:
                out[: len(block), : len(block)] += factor * block
        return out

    def block(self, q: int) -> np.ndarray | None:
        """Contribution of one term, over the leading vectors that it involves; None where it has none.

        Computed on first use: few of many terms are needed.
        """
        if self.inner is not None and q < len(self.inner.terms):
            return self.inner.block(q)
        if q not in self._blocks:
            rows = sp.csr_array(self.terms[q].matrix)[self.members]
            part = self.vectors[self.members].T @ (rows @ self.vectors) if rows.nnz else None
            self._blocks[q] = None if part is None else 0.5 * (part + part.T)
        return self._blocks[q]
