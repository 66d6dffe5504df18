"""An affine matrix projected on a few vectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import AffineMatrix


@dataclass(frozen=True, eq=False)
class Block:
    """Projection of one term; one that touches few motions is kept as the rows of the vectors there.

    Attributes
    ----------
    matrix : ndarray (n_rows, n_rows)
        The projection itself, or the term at the motions it touches.
    rows : ndarray (n_rows, size) or None
        The vectors at these motions.
    """

    matrix: np.ndarray
    rows: np.ndarray | None = None

    def projected(self) -> np.ndarray:
        """``V^T A V``, (size, size)."""
        if self.rows is None:
            return self.matrix
        product = self.rows.T @ (self.matrix @ self.rows)
        return np.asarray(0.5 * (product + product.T))

    @cached_property
    def kept(self) -> np.ndarray:
        """The same, kept once it has been asked for: few of many terms enter the evaluations."""
        return self.projected()


@dataclass(frozen=True, eq=False)
class ReducedMatrix:
    """Projection ``V^T A V`` of an affine matrix; a selected term keeps its vectors ``V^T b`` and no matrices.

    Attributes
    ----------
    affine : AffineMatrix
    size : int
        Number of vectors.
    blocks : tuple of Block
        One for each term.
    vectors : tuple of mapping from tuple of int to ndarray (size,)
        One mapping for each selected term.
    """

    affine: AffineMatrix
    size: int
    blocks: tuple[Block, ...]
    vectors: tuple[Mapping[tuple[int, ...], np.ndarray], ...]

    def __call__(self, si: Mapping[str, float]) -> np.ndarray:
        """The matrix at parameters in SI, (size, size)."""
        out = np.zeros((self.size, self.size))
        for term, block in zip(self.affine.terms, self.blocks, strict=True):
            factor = term.coefficient(si)
            if factor:
                out += factor * block.kept
        for selected, vectors in zip(self.affine.selected, self.vectors, strict=True):
            b = vectors[selected.choice(si)]
            out += selected.coefficient(si) * np.outer(b, b)
        return out

    def derivative(self, si: Mapping[str, float], name: str) -> np.ndarray | sp.csc_array:
        """Its derivative with respect to one parameter in SI, (size, size), sparse where it does not depend on it.

        A selector counts as fixed.
        """
        slopes = [(self.affine.terms[q].coefficient.derivative(si, name), q) for q in self._terms_of.get(name, [])]
        parts = [slope * self.blocks[q].projected() for slope, q in slopes if slope]
        for term, vectors in zip(self.affine.selected, self.vectors, strict=True):
            slope = term.coefficient.derivative(si, name)
            if slope:
                b = vectors[term.choice(si)]
                parts.append(slope * np.outer(b, b))
        return np.asarray(sum(parts)) if parts else sp.csc_array((self.size, self.size))

    @cached_property
    def _terms_of(self) -> Mapping[str, list[int]]:
        """Indices of the terms that depend on each parameter: few of many."""
        out: dict[str, list[int]] = {}
        for q, term in enumerate(self.affine.terms):
            for name in term.coefficient.names:
                out.setdefault(name, []).append(q)
        return out


def reduce_matrix(affine: AffineMatrix, vectors: np.ndarray) -> ReducedMatrix:
    """Project an affine matrix on vectors (n_dof, size)."""
    size = vectors.shape[1]
    blocks = []
    for term in affine.terms:
        matrix = sp.csr_array(term.matrix)
        active = np.flatnonzero(np.diff(matrix.indptr))  # a part of the model touches few of its motions
        rows = vectors[active]
        if 2 * len(active) <= size:
            blocks.append(Block(matrix[active][:, active].toarray(), rows))
        else:
            product = rows.T @ (matrix[active] @ vectors)
            blocks.append(Block(0.5 * (product + product.T)))
    chosen = tuple({key: vectors.T @ b for key, b in term.vectors.items()} for term in affine.selected)
    return ReducedMatrix(affine, size, tuple(blocks), chosen)
