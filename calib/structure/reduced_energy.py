"""Shares of clusters in the strain energy of a reduced model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import Term


@dataclass(frozen=True, eq=False)
class ClusterEnergy:
    """What of the strain energy belongs to one cluster.

    Attributes
    ----------
    vectors : ndarray (n_dof, size)
        Of the basis.
    members : ndarray (n_members,), int
        Degrees of freedom of the cluster.
    terms : tuple of Term
        Of the stiffness.
    supports : tuple of mapping from tuple of int to ndarray (size,)
        ``V_c^T b_c`` of every selected vector that has a part in the cluster, one mapping for each selected term.
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
        """Of one term, over the first vectors where it touches no others; None where it has no part in the cluster.

        Made when first asked for: few of many terms are.
        """
        if self.inner is not None and q < len(self.inner.terms):
            return self.inner.block(q)
        if q not in self._blocks:
            rows = sp.csr_array(self.terms[q].matrix)[self.members]
            part = self.vectors[self.members].T @ (rows @ self.vectors) if rows.nnz else None
            self._blocks[q] = None if part is None else 0.5 * (part + part.T)
        return self._blocks[q]
