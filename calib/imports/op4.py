"""Matrices of Nastran's OUTPUT4: text and binary, dense and sparse, of either byte order and word length."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.stored import Stored

_FORMAT = re.compile(r"(\d+)[DE](\d+)\.\d+")
"""Numbers a line and columns of each, in the format of a header such as ``1P,3E23.16``."""
_HEADS = (24, 48)
"""Bytes of the header of a binary matrix, with words of 32 and of 64 bits."""
_TYPES = (1, 2, 3, 4)
"""Real and complex, each in one word and in double precision."""


@dataclass
class StoredStrings:
    """Head of a matrix, and its entries as strings of consecutive rows."""

    name: str
    n_rows: int
    n_columns: int
    kind: int
    strings: list[tuple[int, int, np.ndarray]]

    @property
    def is_taken(self) -> bool:
        """Whether it is square and real."""
        return self.n_rows == self.n_columns and self.kind <= 2

    def stored(self, file: Path) -> Stored:
        """The matrix, without names of its rows; InputError for one with entries outside."""
        place = f"{file}, matrix {self.name}"
        lengths = [len(values) for _, _, values in self.strings]
        rows = np.concatenate([np.arange(first, first + len(v)) for first, _, v in self.strings] or [np.zeros(0, int)])
        columns = np.repeat([column for _, column, _ in self.strings], lengths).astype(int)
        values = np.concatenate([values for _, _, values in self.strings] or [np.zeros(0)])
        if len(rows) and (rows.min() < 0 or rows.max() >= self.n_rows):
            raise InputError("an entry lies outside the matrix", place=place, remedy="write the file again")
        return Stored(self.name, sp.coo_array((values, (rows, columns)), shape=(self.n_rows, self.n_columns)))


def is_op4(raw: bytes) -> bool:
    """Whether a file begins as the binary or the text form does."""
    if len(raw) >= 8 and _order(raw) is not None:
        return True
    head = raw[:120].split(b"\n", 1)[0].decode("latin-1").rstrip()
    wide = 16 if head.endswith("|I16") else 8
    cells = [head[:wide], head[wide : 2 * wide], *(head[2 * wide + k : 2 * wide + k + 8].strip() for k in (0, 8, 16))]
    return all(re.fullmatch(r"\s*-?\d+", cell) for cell in cells[:4]) and cells[3] in "1234" and bool(cells[4])


def read_op4(file: Path, raw: bytes) -> tuple[list[Stored], tuple[str, ...]]:
    """Square real matrices of an OUTPUT4 file, without names of their rows, which it does not have; what is left out.

    Raises
    ------
    InputError
        For a file that is cut off, and one without such a matrix.
    """
    try:
        found = list(_binary(raw) if _order(raw) is not None else _text(raw.decode("latin-1").splitlines()))
    except (ValueError, IndexError, struct.error) as fault:
        raise InputError(f"it cannot be read ({fault})", place=file, remedy="write it again; it may be cut off"
                         ) from None  # fmt: skip
    return taken(file, found)


def taken(file: Path, found: Sequence[StoredStrings]) -> tuple[list[Stored], tuple[str, ...]]:
    """The square real ones of the matrices of a file, and a sentence on the others; InputError where none is left."""
    other = [
        f"{one.name} ({'complex' if one.kind > 2 else f'{one.n_rows} rows, {one.n_columns} columns'})"
        for one in found
        if not one.is_taken
    ]
    if len(other) == len(found):
        what = f", but {', '.join(other)}" if other else ""
        raise InputError(
            f"it holds no square real matrix{what}", place=file, remedy="write KAA and MAA, or KGG and MGG"
        )
    words = f"Left out of {file.name}, since they are not square or not real: {', '.join(other)}."
    return [one.stored(file) for one in found if one.is_taken], (words,) if other else ()


def _strings(
    words: int,
    n_rows: int,
    first: int,
    per_value: int,
    per_dense: int,
    integer: Callable[[], int],
    values: Callable[[int], np.ndarray],
) -> Iterator[tuple[int, np.ndarray]]:
    """Strings of one column: its first row, from 0, and its values.

    Parameters
    ----------
    words : int
        Of the column.
    n_rows : int
        Negative where the head of a string has its row by itself ("bigmat").
    first : int
        First row of a dense column; 0 for strings with heads.
    per_value, per_dense : int
        Words of a value in strings and in dense columns, which the text form counts by values.
    integer, values : callable
        Take the next integer of a head, and so many values.
    """
    if first > 0:
        yield first - 1, values(words // per_dense)
        return
    while words > 0:
        if n_rows < 0:
            length = integer() - 1
            row = integer()
            words -= length + 2
        else:
            packed = integer()
            length = (packed >> 16) - 1
            row = packed - ((length + 1) << 16)
            words -= length + 1
        if length < 1 or row < 1:
            raise ValueError("the head of a string is damaged")
        yield row - 1, values(length // per_value)


# -- text ----------------------------------------------------------------------------------------------------------


def _text(lines: list[str]) -> Iterator[StoredStrings]:
    at = 0
    while at < len(lines) and lines[at].strip():
        head = lines[at].rstrip()
        wide = 16 if head.endswith("|I16") else 8
        head = head.removesuffix("|I16")
        n_columns, n_rows = int(head[:wide]), int(head[wide : 2 * wide])
        kind = int(head[2 * wide + 8 : 2 * wide + 16])
        name, form = head[2 * wide + 16 : 2 * wide + 24].strip("\0 "), _FORMAT.search(head[2 * wide + 24 :].upper())
        if kind not in _TYPES:
            raise ValueError(f"{name} is of the unknown type {kind}")
        count, width = (int(form[1]), int(form[2])) if form else (5, 16)
        out = StoredStrings(name, abs(n_rows), n_columns, kind, [])
        reader = _Lines(lines, at + 1, count, width)
        while True:
            column, first, words = reader.head()
            if column > n_columns:  # one value ends a matrix
                reader.at += 1
                break
            per_value = 1 if kind in (1, 3) else 2
            for row, values in _strings(words, n_rows, first, per_value, 1, reader.integer, reader.values):
                out.strings.append((row, column - 1, values))
            reader.close()
        at = reader.at
        yield out


class _Lines:
    """Takes numbers from lines of fixed columns."""

    def __init__(self, lines: list[str], at: int, count: int, width: int):
        self.lines, self.at, self.count, self.width = lines, at, count, width
        self.pending: list[int] = []

    def head(self) -> tuple[int, int, int]:
        line = self.lines[self.at]
        self.at += 1
        return int(line[:8]), int(line[8:16]), int(line[16:24])

    def integer(self) -> int:
        if not self.pending:
            self.pending = [int(part) for part in self.lines[self.at].split()]
            self.at += 1
        return self.pending.pop(0)

    def values(self, length: int) -> np.ndarray:
        n = -(-length // self.count)
        text = "".join(line[: self.count * self.width].ljust(self.count * self.width)
                       for line in self.lines[self.at : self.at + n])  # fmt: skip
        self.at += n
        cut = [text[k * self.width : (k + 1) * self.width] for k in range(length)]
        return np.array([float(part.upper().replace("D", "E")) for part in cut])

    def close(self) -> None:
        self.pending = []


# -- binary --------------------------------------------------------------------------------------------------------


def _order(raw: bytes) -> str | None:
    """Byte order, of which the first record's length is that of a head; None for no binary OUTPUT4 file."""
    return next((order for order in "<>" if struct.unpack(order + "i", raw[:4])[0] in _HEADS), None)


def _records(raw: bytes, order: str) -> Iterator[bytes]:
    """Records of Fortran, each between two copies of its length."""
    at = 0
    while at + 8 <= len(raw):
        (length,) = struct.unpack(order + "i", raw[at : at + 4])
        if length < 0 or at + 8 + length > len(raw):
            raise ValueError("a record is longer than the file")
        yield raw[at + 4 : at + 4 + length]
        at += 8 + length


class _Words:
    """Takes integers and values from the words of a record."""

    def __init__(self, record: bytes, order: str, word: int, kind: int):
        self.record, self.at, self.word = record, 0, word
        self.whole = f"{order}i{word}"
        self.real = f"{order}f8" if kind in (2, 4) or word == 8 else f"{order}f4"

    def integer(self) -> int:
        (out,) = np.frombuffer(self.record, self.whole, 1, self.at)
        self.at += self.word
        return int(out)

    def values(self, length: int) -> np.ndarray:
        out = np.frombuffer(self.record, self.real, length, self.at).astype(float)
        self.at += out.size * np.dtype(self.real).itemsize
        return out


def _binary(raw: bytes) -> Iterator[StoredStrings]:
    order = _order(raw) or "<"
    records = _records(raw, order)
    for head in records:
        if len(head) not in _HEADS:
            raise ValueError(f"the head of a matrix has {len(head)} bytes")
        word = 4 if len(head) == _HEADS[0] else 8
        n_columns, n_rows, _, kind = (int(one) for one in np.frombuffer(head, f"{order}i{word}", 4))
        name = head[4 * word :].decode("latin-1").replace("\0", " ")
        name = (name[:4] + name[8:12] if word == 8 and not name[4:8].strip() else name).strip()
        if kind not in _TYPES:
            raise ValueError(f"{name} is of the unknown type {kind}")
        out = StoredStrings(name, abs(n_rows), n_columns, kind, [])
        per_value = 2 if kind in (2, 4) and word == 4 else 1
        for record in records:
            taken = _Words(record, order, word, kind)
            column, first, words = taken.integer(), taken.integer(), taken.integer()
            if column > n_columns:
                break
            for row, values in _strings(words, n_rows, first, per_value, per_value, taken.integer, taken.values):
                out.strings.append((row, column - 1, values))
        else:
            raise ValueError(f"{name} has no end")
        yield out
