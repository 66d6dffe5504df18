"""Projection of an affine matrix on a basis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import AffineMatrix, Term
from calib.structure.reduction.basis import Basis


@dataclass(frozen=True, eq=False)
class ReducedTerm:
    """Projection of one term; a term with few nonzero rows is kept with the rows of the vectors there.

    Attributes
    ----------
    matrix : ndarray (n_rows, n_rows)
        The projection itself, or the term at its nonzero rows.
    rows : ndarray (n_rows, size) or None
        The vectors at these rows; None for the projection itself.
    """

    matrix: np.ndarray
    rows: np.ndarray | None = None

    @property
    def size(self) -> int:
        """Number of vectors."""
        return len(self.matrix) if self.rows is None else self.rows.shape[1]

    def __matmul__(self, shapes: np.ndarray) -> np.ndarray:
        """``V^T A V`` times shapes (size,) or (size, m)."""
        if self.rows is None:
            return self.matrix @ shapes
        return self.rows.T @ (self.matrix @ (self.rows @ shapes))

    def projected(self) -> np.ndarray:
        """``V^T A V``, (size, size)."""
        if self.rows is None:
            return self.matrix
        product = self.rows.T @ (self.matrix @ self.rows)
        return np.asarray(0.5 * (product + product.T))

    @cached_property
    def kept(self) -> np.ndarray:
        """Its lower triangle row by row, cached on first use: few of many terms enter the evaluations.

        That of a block over leading vectors only is the beginning of one over all.
        """
        return self.projected()[_lower(self.size)]


@dataclass(frozen=True, eq=False)
class ReducedMatrix:
    """Projection ``V^T A V`` of an affine matrix; a selected term keeps vectors ``V^T b`` instead of matrices.

    Attributes
    ----------
    affine : AffineMatrix
    size : int
        Number of vectors.
    blocks : tuple of Block
        One for each term; a smaller one involves only the leading vectors.
    vectors : tuple of mapping from tuple of int to ndarray (size,)
        One mapping for each selected term.
    """

    affine: AffineMatrix
    size: int
    blocks: tuple[ReducedTerm, ...]
    vectors: tuple[Mapping[tuple[int, ...], np.ndarray], ...]
    _last: list[tuple[Mapping[str, float], np.ndarray]] = field(init=False, repr=False, default_factory=list)

    def __call__(self, si: Mapping[str, float]) -> np.ndarray:
        """The matrix at parameters in SI, (size, size), read-only; the last one is kept.

        Modes, energies and derivatives at a point ask for it four times.
        """
        for known, matrix in self._last:
            if known == si:
                return matrix
        out = self._assembled(si)
        out.flags.writeable = False
        self._last[:] = [(dict(si), out)]
        return out

    def _assembled(self, si: Mapping[str, float]) -> np.ndarray:
        out, triangle = np.zeros((self.size, self.size)), np.zeros(self.size * (self.size + 1) // 2)
        for term, block in zip(self.affine.terms, self.blocks, strict=True):
            factor = term.coefficient(si)
            if factor and block.rows is None:
                _add(out, factor, block.matrix)
            elif factor:
                triangle[: len(block.kept)] += factor * block.kept
        if any(block.rows is not None for block in self.blocks):
            lower = _lower(self.size)
            out[lower] += triangle
            out.T[lower] += np.where(_diagonal(self.size), 0.0, triangle)
        for selected, vectors in zip(self.affine.selected, self.vectors, strict=True):
            b = vectors[selected.choice(si)]
            out += selected.coefficient(si) * np.outer(b, b)
        return out

    def derivative(self, si: Mapping[str, float], name: str) -> ReducedSlope:
        """Its derivative with respect to one parameter in SI; a selector counts as fixed."""
        slopes = [(self.affine.terms[q].coefficient.derivative(si, name), q) for q in self._terms_of.get(name, [])]
        parts = tuple((slope, self.blocks[q]) for slope, q in slopes if slope)
        picked = []
        for term, vectors in zip(self.affine.selected, self.vectors, strict=True):
            slope = term.coefficient.derivative(si, name)
            if slope:
                picked.append((slope, vectors[term.choice(si)]))
        return ReducedSlope(self.size, parts, tuple(picked))

    @cached_property
    def _terms_of(self) -> Mapping[str, list[int]]:
        """Indices of the terms that depend on each parameter."""
        out: dict[str, list[int]] = {}
        for q, term in enumerate(self.affine.terms):
            for name in term.coefficient.names:
                out.setdefault(name, []).append(q)
        return out


@dataclass(frozen=True, eq=False)
class ReducedSlope:
    """Derivative of a reduced matrix as a linear operator: hundreds of dense ones would fill the memory.

    Attributes
    ----------
    size : int
        Number of vectors.
    parts : tuple of (float, Block)
        Factors and the blocks they multiply.
    picked : tuple of (float, ndarray (size,))
        Factors and vectors b of ``b b^T``.
    """

    size: int
    parts: tuple[tuple[float, ReducedTerm], ...]
    picked: tuple[tuple[float, np.ndarray], ...] = ()

    def __matmul__(self, shapes: np.ndarray) -> np.ndarray:
        """Product with shapes (size,) or (size, m)."""
        out = np.zeros(shapes.shape, dtype=shapes.dtype)
        for factor, block in self.parts:
            out[: block.size] += factor * (block @ shapes[: block.size])
        for factor, b in self.picked:
            out += factor * np.multiply.outer(b, b @ shapes)
        return out

    def __mul__(self, factor: float) -> ReducedSlope:
        """The derivative times a factor, such as a change of unit."""
        parts = tuple((factor * slope, block) for slope, block in self.parts)
        return ReducedSlope(self.size, parts, tuple((factor * slope, b) for slope, b in self.picked))

    def __abs__(self) -> np.ndarray:
        """Absolute values of the entries, (size, size)."""
        return np.abs(self.toarray())

    def toarray(self) -> np.ndarray:
        """The dense matrix, (size, size)."""
        out = np.zeros((self.size, self.size))
        for factor, block in self.parts:
            _add(out, factor, block.projected())
        for factor, b in self.picked:
            out += factor * np.outer(b, b)
        return out


@lru_cache(maxsize=4)
def _lower(size: int) -> np.ndarray:
    """Which entries of a matrix are in its lower triangle, the diagonal included."""
    return np.tri(size, dtype=bool)


@lru_cache(maxsize=4)
def _diagonal(size: int) -> np.ndarray:
    """Which entries of a lower triangle are on the diagonal."""
    return np.eye(size, dtype=bool)[_lower(size)]


def _add(matrix: np.ndarray, factor: float, block: np.ndarray) -> None:
    size = len(block)
    matrix[:size, :size] += factor * block


def reduce_matrix(affine: AffineMatrix, vectors: np.ndarray, known: Sequence[ReducedTerm] = ()) -> ReducedMatrix:
    """Project an affine matrix on vectors.

    Parameters
    ----------
    affine : AffineMatrix
    vectors : ndarray (n_dof, size)
    known : sequence of Block
        Known projections of the first terms, which involve only leading vectors.
    """
    size = vectors.shape[1]
    blocks = list(known)
    for term in affine.terms[len(known) :]:
        matrix = sp.csr_array(term.matrix)
        active = np.flatnonzero(np.diff(matrix.indptr))  # most terms have few nonzero rows
        rows = vectors[active]
        if 2 * len(active) <= size:
            blocks.append(ReducedTerm(matrix[active][:, active].toarray(), rows))
        else:
            product = rows.T @ (matrix[active] @ vectors[: matrix.shape[1]])
            blocks.append(ReducedTerm(0.5 * (product + product.T)))
    chosen = tuple({key: vectors.T @ b for key, b in term.vectors.items()} for term in affine.selected)
    return ReducedMatrix(affine, size, tuple(blocks), chosen)


@dataclass(frozen=True, eq=False)
class ClusterEnergy:
    """Strain energy of one cluster as a quadratic form over the basis.

    Attributes
    ----------
    basis : Basis
    members : ndarray (n_members,), int
        Degrees of freedom of the cluster.
    terms : tuple of Term
        Of the stiffness.
    supports : tuple of mapping from tuple of int to ndarray (size,)
        ``V_c^T b_c`` of every selected vector with entries in the cluster, one mapping for each selected term.
    inner : ClusterEnergy, optional
        Of the model that this one extends; its blocks are shared.
    """

    basis: Basis
    members: np.ndarray
    terms: tuple[Term, ...]
    supports: tuple[Mapping[tuple[int, ...], np.ndarray], ...]
    inner: ClusterEnergy | None = None
    _blocks: dict[int, np.ndarray | None] = field(init=False, repr=False, default_factory=dict)

    def matrix(self, factors: Sequence[float]) -> np.ndarray:
        """Symmetric part of ``V_c^T K_c V``."""
        out = np.zeros((self.basis.size,) * 2)
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
            vectors = self.basis.vectors
            part = vectors[self.members].T @ (rows @ vectors[: rows.shape[1]]) if rows.nnz else None
            self._blocks[q] = None if part is None else 0.5 * (part + part.T)
        return self._blocks[q]
