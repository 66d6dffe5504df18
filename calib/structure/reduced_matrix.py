"""An affine matrix projected on a few vectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import AffineMatrix


@dataclass(frozen=True, eq=False)
class ReducedMatrix:
    """Projection ``V^T A V`` of an affine matrix; a selected term keeps its vectors ``V^T b`` and no matrices.

    Attributes
    ----------
    affine : AffineMatrix
    stack : ndarray (n_terms, size, size)
    vectors : tuple of mapping from tuple of int to ndarray (size,)
        One mapping for each selected term.
    """

    affine: AffineMatrix
    stack: np.ndarray
    vectors: tuple[Mapping[tuple[int, ...], np.ndarray], ...]

    def __call__(self, si: Mapping[str, float]) -> np.ndarray:
        """The matrix at parameters in SI, (size, size)."""
        return self._sum([t.coefficient(si) for t in self.affine.terms], si, None)

    def derivative(self, si: Mapping[str, float], name: str) -> np.ndarray:
        """Its derivative with respect to one parameter in SI, (size, size); a selector counts as fixed."""
        return self._sum([self.affine.terms[q].coefficient.derivative(si, name) for q in self._own(name)], si, name)

    @cached_property
    def _terms_of(self) -> Mapping[str, list[int]]:
        """Indices of the terms that depend on each parameter: few of many."""
        out: dict[str, list[int]] = {}
        for q, term in enumerate(self.affine.terms):
            for name in term.coefficient.names:
                out.setdefault(name, []).append(q)
        return out

    def _own(self, name: str) -> list[int]:
        return self._terms_of.get(name, [])

    def _sum(self, coefficients: list[float], si: Mapping[str, float], name: str | None) -> np.ndarray:
        size = self.stack.shape[1]
        stack = self.stack if name is None else self.stack[self._own(name)]
        out = (np.array(coefficients) @ stack.reshape(len(stack), size**2)).reshape(size, size)
        for term, vectors in zip(self.affine.selected, self.vectors, strict=True):
            factor = term.coefficient(si) if name is None else term.coefficient.derivative(si, name)
            if factor:
                b = vectors[term.choice(si)]
                out += factor * np.outer(b, b)
        return out


def reduce_matrix(affine: AffineMatrix, vectors: np.ndarray) -> ReducedMatrix:
    """Project an affine matrix on vectors (n_dof, size)."""
    size = vectors.shape[1]
    stack = np.zeros((len(affine.terms), size, size))
    for q, term in enumerate(affine.terms):
        matrix = sp.csr_array(term.matrix)
        active = np.flatnonzero(np.diff(matrix.indptr))  # a part of the model touches few of its motions
        block = vectors[active].T @ (matrix[active] @ vectors)
        stack[q] = 0.5 * (block + block.T)
    chosen = tuple({key: vectors.T @ b for key, b in term.vectors.items()} for term in affine.selected)
    return ReducedMatrix(affine, stack, chosen)
