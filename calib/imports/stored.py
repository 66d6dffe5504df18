"""A matrix as a file stores it, with the names of its rows where the file knows them."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp

from calib.errors.errors import InputError

BASE = "rows and columns are counted from 1"
_WORDS: Mapping[str, str] = {
    "structural damping": r"k4\w*|dmps\w*",
    "stiffness": r"k|matk|k(aa|gg|ff|ll|jj|nn|xx)x?|k2gg|kred|sti\w*|steif\w*|rigid\w*",
    "mass": r"m|matm|m(aa|gg|ff|ll|jj|nn|xx)x?|m2gg|mred|mas\w*",
    "damping": r"c|b|d|matc|matd|b(aa|gg|ff|ll|jj|nn|xx)x?|b2gg|dam\w*|dmp\w*|amor\w*",
}
"""Words in the names of files and matrices that tell what they are."""


@dataclass(frozen=True, eq=False)
class Stored:
    """A square matrix of a file.

    Attributes
    ----------
    name : str
        As the file, or its own name, calls it.
    matrix : coo_array (n, n)
        Its entries as stored: a symmetric one may have one triangle alone.
    labels : ndarray (n, 2) of int, optional
        Node and direction (1 to 6) of each row. Directions beyond 1 to 6 and nodes up to 0 are rows of no node: scalar
        points, internal nodes and Lagrange multipliers.
    open_ended : bool
        Whether empty rows may be missing at its end, since nothing states its size.
    """

    name: str
    matrix: sp.coo_array
    labels: np.ndarray | None = None
    open_ended: bool = False

    @property
    def sized(self) -> str:
        """Its name with its number of rows, such as ``KAA:46``, for files of several superelements."""
        return f"{self.name}:{self.matrix.shape[0]}"


def counted_from_one(
    name: str, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, place: Path | str, size: int | None = None
) -> Stored:
    """A matrix of entries whose rows and columns are numbered.

    Parameters
    ----------
    name : str
    rows, columns : ndarray (n_entries,), int
        From 1.
    values : ndarray (n_entries,)
    place : Path or str
        In messages.
    size : int, optional
        Number of rows; by default the largest number.

    Raises
    ------
    InputError
        For a number outside the matrix, such as 0 of a base that C and Python have, and an entry given twice.
    """
    if not len(values):
        raise InputError("it holds no entries", place=place, remedy="let the code write the matrix again")
    least, most = int(min(rows.min(), columns.min())), int(max(rows.max(), columns.max()))
    if least < 1 or (size is not None and most > size):
        k = int(np.argmax((np.minimum(rows, columns) < 1) | (np.maximum(rows, columns) > (size or most))))
        raise InputError(
            f"entry {k + 1} is at row {rows[k]}, column {columns[k]}", place=place,
            remedy=f"{BASE}" + (f" to {size}" if size is not None else "") + ": add 1 to those of Python or C",
        )  # fmt: skip
    n = most if size is None else size
    matrix = _once(rows - 1, columns - 1, values, n, place, lambda k: f"row {k + 1}")
    return Stored(name, matrix, open_ended=size is None)


def named(name: str, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, place: Path | str) -> Stored:
    """A matrix of entries whose rows and columns are named by node and direction, (n_entries, 2) int each."""
    if not len(values):
        raise InputError("it holds no entries", place=place, remedy="let the code write the matrix again")
    labels, at = np.unique(np.concatenate([rows, columns]), axis=0, return_inverse=True)
    at = at.ravel()
    row, column = at[: len(rows)], at[len(rows) :]
    words = lambda k: f"node {labels[k, 0]}, direction {labels[k, 1]}"  # noqa: E731
    return Stored(name, _once(row, column, values, len(labels), place, words), labels)


def _once(
    row: np.ndarray, column: np.ndarray, values: np.ndarray, n: int, place: Path | str, words: object
) -> sp.coo_array:
    """The matrix; InputError for an entry that is given twice, of which the sum would be taken."""
    key = row.astype(np.int64) * n + column
    order = np.argsort(key, kind="stable")
    again = np.flatnonzero(np.diff(key[order]) == 0)
    if len(again):
        k = int(order[again[0] + 1])
        raise InputError(
            f"the entry at {words(int(row[k]))} and {words(int(column[k]))} is given twice", place=place,  # type: ignore[operator]
            remedy="write the assembled matrix, each entry once",
        )  # fmt: skip
    return sp.coo_array((values, (row, column)), shape=(n, n))


def spread(stored: Stored, labels: np.ndarray) -> Stored:
    """The same over more rows, all of whose names are in ``labels`` (n, 2).

    Raises
    ------
    InputError
        For a row that is named twice, whose place is then unknown.
    """
    if stored.labels is None:
        return stored
    if len(np.unique(stored.labels, axis=0)) < len(stored.labels):
        raise InputError("two of its rows bear one name", place=f"matrix {stored.name}",
                         remedy="write all matrices over the same rows")  # fmt: skip
    index = pd.MultiIndex.from_arrays(list(labels.T))
    at = index.get_indexer(pd.MultiIndex.from_arrays(list(stored.labels.T)))
    coo = stored.matrix
    return Stored(stored.name, sp.coo_array((coo.data, (at[coo.row], at[coo.col])), shape=(len(labels),) * 2), labels)


def stored_numbers(text: str, count: Sequence[int], place: Path) -> np.ndarray:
    """A table of numbers between blanks or commas, (n_rows, n_columns), without lines that begin with ``*`` or ``#``.

    Raises
    ------
    InputError
        For a line without one of the allowed counts of numbers, and for text among them.
    """
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] not in "*#%"]
    width = len(re.split(r"[,\s]+", lines[0].strip().rstrip(","))) if lines else 0
    if width not in count:
        held = f"{width} numbers a line" if lines else "no numbers"
        raise InputError(f"it holds {held}", place=place, remedy=f"{' or '.join(map(str, count))} are read")
    try:
        table = pd.read_csv(
            io.StringIO("\n".join(line.strip().rstrip(",") for line in lines).replace(",", " ")), sep=r"\s+",
            header=None, dtype=float, names=list(range(width)), index_col=False, on_bad_lines="error",
        )  # fmt: skip
    except (ValueError, pd.errors.ParserError) as fault:
        words = str(fault).splitlines()[0][:80]
        raise InputError(f"its numbers cannot be read ({words})", place=place, remedy="write it again") from None
    out = table.to_numpy(dtype=float)
    whole = out[:, : width - 1] if width > 1 else out[:, :0]
    if not np.all(np.isfinite(whole)) or np.any(whole != np.round(whole)):
        k = int(np.argmin((np.isfinite(whole) & (whole == np.round(whole))).all(axis=1)))
        raise InputError(
            f"line {k + 1} of its numbers is {lines[k].strip()[:60]!r}", place=place,
            remedy="whole numbers name row and column; it may be cut off",
        )  # fmt: skip
    return out


def matrix_kind(name: str) -> str:
    """What a matrix is, by the longest word in its name that tells it; empty where none does."""
    words = re.findall(r"[a-z]+\d*[a-z]*", name.lower())
    for word in sorted(words, key=len, reverse=True):
        for kind, pattern in _WORDS.items():
            if re.fullmatch(rf"({pattern})\d*", word) and (len(word) > 1 or word in "km" or len(words) == 1):
                return kind
    return ""
