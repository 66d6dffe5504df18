"""The common sparsity pattern of the terms of a matrix, and matrices of one pattern."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy.sparse as sp


@dataclass(frozen=True, eq=False)
class Pattern:
    """The common sparsity pattern, entries of the terms (n_entries, n_terms) and of every selected vector."""

    form: sp.csc_array
    stack: sp.csr_array
    picks: tuple[Mapping[tuple[int, ...], tuple[np.ndarray, np.ndarray]], ...]

    @classmethod
    def of(cls, n: int, matrices: Sequence[Any], selected: Sequence[Mapping[tuple[int, ...], np.ndarray]]) -> Self:
        """That of terms over the first of n degrees of freedom, and of vectors b that are selected as ``b b^T``."""
        blocks = [{key: _outer(b) for key, b in vectors.items()} for vectors in selected]
        coos = [sp.coo_array(matrix) for matrix in matrices]
        entries = [(coo.row, coo.col) for coo in coos]
        entries += [(rows, cols) for options in blocks for rows, cols, _ in options.values()]
        indices, indptr = _united(entries, n)
        keys = _key(indices, np.repeat(np.arange(n), np.diff(indptr)), n)
        # Entries over terms, (n_entries, n_terms): most terms have few of the entries.
        rows = [np.searchsorted(keys, _key(coo.row, coo.col, n)) for coo in coos]
        picks = [
            {key: (np.searchsorted(keys, _key(rows, cols, n)), data) for key, (rows, cols, data) in options.items()}
            for options in blocks
        ]
        form = sp.csc_array((np.zeros(len(keys)), indices, indptr), shape=(n, n))
        form.has_sorted_indices = form.has_canonical_format = True
        return cls(form=form, stack=_stacked(rows, [coo.data for coo in coos], len(keys)), picks=tuple(picks))


def padded(matrix: sp.csr_array, size: int) -> sp.csr_array:
    """A matrix over more degrees of freedom, which follow its own; the entries are shared."""
    if matrix.shape == (size, size):
        return matrix
    ends = np.full(size - matrix.shape[0], matrix.indptr[-1], dtype=matrix.indptr.dtype)
    indptr = np.concatenate([matrix.indptr, ends])
    return sp.csr_array((matrix.data, matrix.indices, indptr), shape=(size, size))


def narrow(matrix: Any) -> Any:
    """A compressed matrix with indices of 32 bits, as solvers take them; itself where it has these, or needs more.

    SciPy keeps the 64 bits of coordinates, with which indices take as much memory as entries. The entries are copied:
    operations of SciPy sort and drop them in place, together with the indices of one matrix.
    """
    if getattr(matrix, "format", "") not in ("csr", "csc") or matrix.indices.dtype == np.int32 == matrix.indptr.dtype:
        return matrix
    parts = (matrix.indices, matrix.indptr)
    if any(part.dtype.kind not in "iu" or (part.size and not 0 <= part.min() <= part.max() < 2**31) for part in parts):
        return matrix
    out = copy.copy(matrix)
    out.data, out.indices, out.indptr = matrix.data.copy(), *(part.astype(np.int32) for part in parts)
    return out


def with_data(form: Any, data: np.ndarray) -> Any:
    """A matrix of the same pattern with other entries; making one anew takes longer than to solve a small model."""
    out = copy.copy(form)
    out.data = data
    return out


def _stacked(rows: list[np.ndarray], entries: list[np.ndarray], size: int) -> sp.csr_array:
    columns = np.repeat(np.arange(len(rows)), [len(r) for r in rows])
    if not len(columns):
        return sp.csr_array((size, len(rows)))
    where = (np.concatenate(rows), columns)
    stack: sp.csr_array = narrow(sp.csr_array(sp.coo_array((np.concatenate(entries), where), shape=(size, len(rows)))))
    return stack


def _united(entries: list[tuple[np.ndarray, np.ndarray]], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of all different entries, by column and sorted in each, and where the columns begin.

    SciPy's conversion counts where `numpy.unique` sorts or hashes; it is tens of times as fast.
    """
    if not entries:
        return np.zeros(0, dtype=np.int32), np.zeros(n + 1, dtype=np.int32)
    rows, cols = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    form = sp.coo_array((np.ones(len(rows), dtype=np.int8), (rows, cols)), shape=(n, n)).tocsc()
    form.sum_duplicates()
    return form.indices.astype(np.int32), form.indptr.astype(np.int32)


def _key(rows: np.ndarray, cols: np.ndarray, n: int) -> np.ndarray:
    return cols.astype(np.int64) * n + rows


def _outer(b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries (rows, columns, values) of ``b b^T``."""
    index = np.flatnonzero(b)
    rows, cols = np.meshgrid(index, index, indexing="ij")
    return rows.ravel(), cols.ravel(), np.outer(b[index], b[index]).ravel()
