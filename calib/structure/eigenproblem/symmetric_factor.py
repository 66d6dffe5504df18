"""Factors of sparse symmetric matrices, and the order in which their rows are eliminated."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from threading import Lock

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

DISSECTED = 10_000
"""Rows from which on a matrix is dissected: a factor of 10,440 of solids then takes 0.36 for 1.05 s, one of 12,870 of
shells 0.15 for 0.14 s, one of 33,456 of the vehicle 0.35 for 0.43 s. No fitted model of a study in this repository has
as many, so that fits there do not depend on what is installed."""
_KEPT = 4
"""Patterns whose order is kept: of two models, each with and without a border (assumed)."""
_orders: OrderedDict[bytes, np.ndarray | None] = OrderedDict()
_lock = Lock()


@dataclass(frozen=True)
class SymmetricFactor:
    """LU of a symmetric matrix, real or complex.

    Attributes
    ----------
    lu : SuperLU
        Of the matrix with its rows and columns in order.
    order : ndarray of int (n,) or None
        Row of the matrix at each place; None where the factor found an order itself.
    """

    lu: spla.SuperLU
    order: np.ndarray | None = None

    def solve(self, columns: np.ndarray) -> np.ndarray:
        """Solutions for one or several columns, (n,) or (n, m), of the matrix' type."""
        if self.order is None:
            return np.asarray(self.lu.solve(columns))
        found = self.lu.solve(columns[self.order])
        out = np.empty_like(found)
        out[self.order] = found
        return out

    def solve_by_parts(self, columns: np.ndarray) -> np.ndarray:
        """Solutions for real or complex columns (n, m) with the factor of a real matrix."""
        if not np.iscomplexobj(columns):
            return self.solve(columns)
        both = self.solve(np.hstack([columns.real, columns.imag]))
        return np.asarray(both[:, : columns.shape[1]] + 1j * both[:, columns.shape[1] :])

    @property
    def pivots(self) -> np.ndarray:
        """Pivot of each column of the matrix, shape (n,)."""
        own = np.asarray(self.lu.U.diagonal())[self.lu.perm_c]
        if self.order is None:
            return own
        out = np.empty_like(own)
        out[self.order] = own
        return out

    @property
    def on_diagonal(self) -> bool:
        """Whether every pivot is on the diagonal."""
        return bool(np.array_equal(self.lu.perm_r, self.lu.perm_c))


def symmetric_factor(
    matrix: sp.csc_array | sp.csc_matrix, threshold: float = 0.0, dissected: bool = True
) -> SymmetricFactor:
    """LU of a symmetric matrix, in an order with few entries.

    Pivots are on the diagonal, except where they are smaller than the largest of their column times the threshold.

    Minimum degree of the symmetric pattern is 5-7 times faster here than the default order, and narrow panels without
    merged subtrees save another fifth. From `DISSECTED` rows on, nested dissection (Karypis and Kumar 1998) where the
    extra ``metis`` is installed: a factor of 74,385 degrees of freedom of solids takes a quarter of the time and half
    the memory.

    Parameters
    ----------
    matrix : sparse (n, n)
    threshold : float
        Smallest pivot on the diagonal over the largest entry of its column.
    dissected : bool
        False where which pivot is small must not depend on what is installed.

    Raises
    ------
    RuntimeError
        Where the matrix is singular.
    """
    whole = sp.csc_matrix(matrix)
    order = nested_dissection(whole) if dissected and whole.shape[0] >= DISSECTED else None
    lu = spla.splu(
        whole if order is None else sp.csc_matrix(whole[order][:, order]),
        permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
        diag_pivot_thresh=threshold,
        relax=1,
        panel_size=10,
        options={"SymmetricMode": True},
    )
    return SymmetricFactor(lu, order)


@cache
def metis() -> str:
    """Version of METIS's Python package; empty where it is not installed."""
    try:
        return metadata.version("pymetis")
    except metadata.PackageNotFoundError:
        return ""


def nested_dissection(matrix: sp.csc_matrix) -> np.ndarray | None:
    """Row of a symmetric matrix at each place of its elimination by METIS; None where METIS is not installed or fails.

    That of the last patterns is kept: all factors of a model share one.
    """
    if not metis():
        return None
    key = hashlib.blake2b(matrix.indptr.tobytes() + matrix.indices.tobytes()).digest()
    with _lock:  # models may be evaluated by threads
        if key not in _orders:
            _orders[key] = _order_by_metis(matrix)
            if len(_orders) > _KEPT:
                _orders.popitem(last=False)
        _orders.move_to_end(key)
        return _orders[key]


def _order_by_metis(matrix: sp.csc_matrix) -> np.ndarray | None:
    import pymetis  # for large matrices alone

    pattern = sp.csc_array((np.ones(matrix.nnz, dtype=np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)
    both = sp.coo_array(pattern + pattern.T)  # where terms cancel, rounding may leave one of two entries
    off = both.row != both.col
    edges = sp.csr_array((both.data[off], (both.row[off], both.col[off])), shape=matrix.shape)
    try:
        order, _ = pymetis.nested_dissection(adjacency=pymetis.CSRAdjacency(edges.indptr, edges.indices))
    except RuntimeError:
        return None
    return np.asarray(order)
