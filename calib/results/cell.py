"""Cells of a table: numbers, and texts that a spreadsheet would run."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calib.errors.place import Place

if TYPE_CHECKING:
    import pandas as pd

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
COMMA_NUMBER = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
"""A number with a decimal comma."""
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.IGNORECASE)
_BREAKS = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029]+")
_RUN = re.compile(r"'*[=+\-@\t\r].", re.DOTALL)
_GUARDED = re.compile(r"''*[=+\-@\t\r].", re.DOTALL)


def number_of(text: str, comma: bool = False) -> float | None:
    """The number in a text, possibly infinite; None for anything else, such as ``1_000``, ``0x1`` or ``nan``."""
    if comma:
        if not (COMMA_NUMBER.fullmatch(text) or (_NUMBER.fullmatch(text) and "." not in text)):
            return float(text) if _INFINITE.fullmatch(text) else None
        return float(text.replace(",", "."))
    return float(text) if _NUMBER.fullmatch(text) or _INFINITE.fullmatch(text) else None


def shortened(text: str) -> str:
    """A text in quotes, of at most 60 characters."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


def guarded(text: str) -> str:
    """A text as written to a table: on one line, prefixed by an apostrophe where a spreadsheet would run it."""
    line = _BREAKS.sub(" ", text)
    return f"'{line}" if _RUN.match(line) and number_of(line) is None else line


def unguarded(cell: str) -> str:
    """The text that `guarded` has written."""
    return cell[1:] if _GUARDED.match(cell) else cell


def guarded_table(table: pd.DataFrame) -> pd.DataFrame:
    """A table whose texts, names of columns and rows included, are `guarded`; numbers stay numbers."""
    import pandas as pd

    def cell(value: object) -> object:
        return guarded(value) if isinstance(value, str) else value

    def runs(values: Iterable[object]) -> bool:
        return any(isinstance(value, str) and guarded(value) != value for value in values)

    # Hardly any table holds such a text: the others are not copied.
    words = [c for c, kind in table.dtypes.items() if not pd.api.types.is_numeric_dtype(kind) and runs(table[c].array)]
    out = table.assign(**{str(c): table[c].astype(object).map(cell) for c in words}) if words else table
    return out.rename(columns=cell, index=cell) if runs(table.columns) or runs(table.index) else out


SEPARATORS = (",", ";", "\t")


def separator_of(line: str, required: Sequence[str]) -> str:
    """Separator of a header: the one that finds most of the required names."""

    def found(separator: str) -> int:
        return sum(name in [cell.strip().strip('"') for cell in line.split(separator)] for name in required)

    return max(SEPARATORS, key=lambda separator: (found(separator), separator == ","))


def place_of_entry(path: Path, line: int, text: str, separator: str, index: int | None) -> Place:
    """Place of an entry of a line, counted from 0; behind the line for one that it lacks, all of it for None."""
    if index is None:
        return Place(str(path), line, text)
    begins, with_quotes, inside = [0], False, False
    for k, c in enumerate(text):
        if c == '"' and (with_quotes or not text[begins[-1] : k].strip()):
            with_quotes, inside = True, not inside
        elif c == separator and not inside:
            begins.append(k + 1)
            with_quotes = False
    if index >= len(begins):
        return Place(str(path), line, text, len(text.rstrip()) + 1)
    cell = text[begins[index] : begins[index + 1] - 1 if index + 1 < len(begins) else len(text)]
    column = begins[index] + (len(cell) - len(cell.lstrip()) if cell.strip() else 0) + 1
    return Place(str(path), line, text, column, max(len(cell.strip()), 1))
