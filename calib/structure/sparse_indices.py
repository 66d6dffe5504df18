"""Validation of the index arrays of sparse matrices, before native code follows them out of its memory.

SciPy checks lengths when it builds a compressed matrix, and no index: its routines, and those of SuperLU behind it,
then read and write wherever a wrong index points. What is here reads the arrays as numbers alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.errors.errors import InputError


def require_consistent(matrix: Any, place: str) -> None:
    """InputError for a sparse matrix whose index arrays contradict each other or its shape, or of an unusable type.

    Parameters
    ----------
    matrix : sparse array or matrix
        Of any format of SciPy; a dense one has no indices.
    place : str
        Of the error.
    """
    if fault := _fault(matrix):
        problem, remedy = fault
        raise InputError(problem, place=place, remedy=remedy)


def _fault(matrix: Any) -> tuple[str, str] | None:
    """What is wrong, and the remedy; None where nothing is."""
    form = getattr(matrix, "format", None)
    if form is None:  # dense
        return None
    rows, columns = matrix.shape
    kind = matrix.dtype
    if kind.kind not in "fciub" or kind in (np.float16, np.longdouble, np.clongdouble):
        return f"its entries are of type {kind.name}", "give them as float64"
    if form in ("csr", "csc", "bsr"):
        major, minor = (rows, columns) if form != "csc" else (columns, rows)
        if form == "bsr":
            height, width = matrix.data.shape[1:]
            major, minor = major // height, minor // width
        return compressed_fault(matrix.indptr, matrix.indices, len(matrix.data), major, minor)
    if form == "coo":
        return coordinates_fault(matrix.row, matrix.col, len(matrix.data), rows, columns)
    if form == "lil":
        lengths = [len(one) for one in matrix.rows]
        found = np.array([k for one in matrix.rows for k in one], dtype=object)
        if lengths != [len(one) for one in matrix.data]:
            return "its rows hold more or fewer indices than entries", _AGAIN
        return _outside("column", found, columns)
    return None  # the others hold no index that native code follows


_AGAIN = "build it as scipy.sparse.coo_array((data, (row, col)), shape), with rows and columns counted from 0"


def compressed_fault(
    indptr: np.ndarray, indices: np.ndarray, entries: int, major: int, minor: int
) -> tuple[str, str] | None:
    """What is wrong with the arrays of a compressed matrix, and the remedy; None where nothing is.

    Parameters
    ----------
    indptr : ndarray (major + 1,), int
        Where each row (of columns: each column) begins in ``indices``, and where the last one ends.
    indices : ndarray (n,), int
    entries : int
        Number of stored entries; beyond the end of ``indptr`` some may be unused.
    major, minor : int
        Number of rows and columns, for a matrix compressed by columns the other way round.
    """
    for name, array in (("indptr", indptr), ("indices", indices)):
        if array.ndim != 1 or array.dtype.kind not in "iu":
            return f"its {name} is an array of {array.dtype.name}, of shape {array.shape}", _AGAIN
    if len(indptr) != major + 1:
        return f"its indptr has {len(indptr)} entries, and {major} rows need {major + 1}", _AGAIN
    if indptr[0] != 0:
        return f"its indptr begins with {indptr[0]}, not with 0", _AGAIN
    if len(falling := np.flatnonzero(indptr[1:] < indptr[:-1])):
        k = int(falling[0])
        return f"its indptr falls from {indptr[k]} to {indptr[k + 1]} at row {k}, counted from 0", _AGAIN
    end = int(indptr[-1])
    if end > min(len(indices), entries):
        return f"its indptr ends with {end}, beyond its {len(indices)} indices and {entries} entries", _AGAIN
    return _outside("index", indices[:end], minor)


def coordinates_fault(
    row: np.ndarray, column: np.ndarray, entries: int, rows: int, columns: int
) -> tuple[str, str] | None:
    """What is wrong with rows and columns of entries, (n,) each, and the remedy; None where nothing is."""
    for name, array in (("rows", row), ("columns", column)):
        if array.ndim != 1 or array.dtype.kind not in "iu":
            return f"its {name} are an array of {array.dtype.name}, of shape {array.shape}", _AGAIN
    if not len(row) == len(column) == entries:
        return f"it has {len(row)} rows and {len(column)} columns for {entries} entries", _AGAIN
    return _outside("row", row, rows) or _outside("column", column, columns)


def _outside(what: str, indices: np.ndarray, count: int) -> tuple[str, str] | None:
    """The first index outside of 0 to count - 1, in words."""
    if not len(indices):
        return None
    wrong = np.flatnonzero((indices < 0) | (indices >= count))
    if not len(wrong):
        return None
    from_one = min(indices) >= 1 and max(indices) == count
    remedy = "indices count from 0: subtract 1" if from_one else _AGAIN
    return f"its {what} {indices[wrong[0]]} (entry {wrong[0]}) is outside of 0 to {count - 1}", remedy
