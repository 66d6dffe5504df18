"""Strict reader of CSV tables: anything damaged or ambiguous is refused with its file, line and column.

Spreadsheets may have written them: with a byte-order mark, with semicolons or tabs between the entries, with decimal
commas where the separator is not a comma, and with ``WAHR`` or ``VRAI`` for true. A text that a spreadsheet would run
as a formula is prefixed by an apostrophe in the file (OWASP, "CSV injection") and without it everywhere else.
"""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.results.cell import COMMA_NUMBER, SEPARATORS, number_of, place_of_entry, separator_of, shortened, unguarded
from calib.results.former_names import old_column
from calib.results.written import FLAGS

if TYPE_CHECKING:
    import pandas as pd

AGAIN = "run the study again to rewrite it"
"""Remedy for a damaged table that calib has written itself."""
LEAVE_OUT = "give the value, or leave the line out"
"""Remedy for a value that was not measured."""
_NODE = re.compile(r"(\d{1,10})(?:[.,]0*)?", re.ASCII)
"""A spreadsheet may write the integer as ``12.0``."""
_LABELS = ("mode", "repeat", "response")
"""Columns whose entries are names, even where these are numbers."""
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_HINT = re.compile(r'"?sep=(.)"?', re.IGNORECASE)


@dataclass(frozen=True)
class TableRow:
    """One line of a table.

    Attributes
    ----------
    path : Path
    line : int
        Counted from 1.
    cells : mapping from column to text
        Stripped; columns missing from the file are absent.
    comma : bool
        Whether numbers are written with a decimal comma.
    raw, separator : str
        The line as it stands in the file, and what separates its entries.
    """

    path: Path
    line: int
    cells: Mapping[str, str]
    comma: bool = False
    raw: str = ""
    separator: str = ","

    def place(self, column: str) -> Place:
        """Where the file has the entry of a column."""
        index = list(self.cells).index(column) if column in self.cells else None
        return place_of_entry(self.path, self.line, self.raw, self.separator, index).of(f"column {column}")

    def error(self, column: str, problem: str, remedy: str | None = None) -> InputError:
        """An InputError that names file, line and column."""
        return InputError(problem, place=self.place(column), remedy=remedy)

    def text(self, column: str) -> str:
        """Text that must not be empty."""
        if not self.cells[column]:
            raise self.error(column, "it is empty", "give a value")
        return self.cells[column]

    def number(self, column: str) -> float:
        """A finite number that must be there."""
        text = self.cells[column]
        if _unknown(text):
            raise self.error(column, f"{shortened(text)} is not a number" if text else "it is empty", LEAVE_OUT)
        value = number_of(text, self.comma)
        if value is None:
            raise self.error(column, f"{shortened(text)} is not a number", "write it like 12.5 or 1.25e1")
        if math.isinf(value):
            raise self.error(column, f"{shortened(text)} is not finite", "correct it")
        return value

    def optional(self, column: str) -> float:
        """A finite number, or NaN when the column or the entry is empty."""
        text = self.cells.get(column)
        if text and _unknown(text):
            raise self.error(column, f"{shortened(text)} is not a number", "leave the entry empty")
        return self.number(column) if text else math.nan

    def node(self) -> int:
        """The node label, an integer from 0."""
        text = self.text("node")
        match = _NODE.fullmatch(text)
        if match is None:
            raise self.error("node", f"{shortened(text)} is not a node label", "write an integer, 10 digits or less")
        return int(match[1])


def read_rows(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> list[TableRow]:
    """Rows of a table that the user has written; lines that start with # and blank lines are skipped.

    Raises InputError for a file that cannot be read, is no UTF-8 text, has a wrong column, or holds no row.
    """
    sheet = _read(path, required, comments=True)
    allowed = (*required, *optional)
    for name in sheet.header:
        if name not in allowed:
            index = sheet.header.index(name)
            near = difflib.get_close_matches(name, allowed, n=1)
            raise InputError(
                f"unknown column {name[:60]!r}" + (f" (did you mean {near[0]!r}?)" if near else ""),
                place=place_of_entry(path, sheet.top, sheet.head, sheet.separator, index).of(f"column {index + 1}"),
                remedy=f"the columns are {', '.join(allowed)}, separated by commas or semicolons",
            )
    if not sheet.cells:
        raise InputError("it holds a header but no rows", place=path, remedy="add one line a mode, sensor or node")
    rows = [
        TableRow(path, line, dict(zip(sheet.header, cells, strict=True)), sheet.comma, text, sheet.separator)
        for line, cells, text in zip(sheet.lines, sheet.cells, sheet.texts, strict=True)
    ]
    for column in (name for name in _LABELS if name in sheet.header):
        _require_one_spelling(rows, column)
    return rows


def _require_one_spelling(rows: Sequence[TableRow], column: str) -> None:
    """InputError where a label stands beside another spelling of the same number, such as ``0.0`` beside ``0``."""
    spelled: dict[float, str] = {}
    for row in rows:
        text = row.cells[column]
        value = number_of(text, row.comma)
        if value is not None and (other := spelled.setdefault(value, text)) != text:
            words = f"{shortened(text)} beside {shortened(other)}: one label or two"
            raise row.error(column, words, "write the same label alike")


def read_table(
    path: Path,
    text: Sequence[str],
    numbers: Sequence[str] = (),
    *,
    complete: Sequence[str] = (),
    unbounded: Sequence[str] = (),
    flags: Sequence[str] = (),
    if_there: Sequence[str] = (),
    blank: Sequence[str] = (),
    others_are_numbers: bool = False,
    unique: str | Sequence[str] = (),
    may_be_empty: bool = False,
) -> pd.DataFrame:
    """Read a table that calib has written and check the requested columns; others are dropped.

    Parameters
    ----------
    path : Path
    text, numbers, flags : sequence of str
        Columns of words, of numbers (empty or nan where unknown) and of true or false (None where unknown).
    complete : sequence of str
        Those of `numbers` and `flags` that must not be unknown.
    unbounded : sequence of str
        Those of `numbers` that may be infinite.
    if_there : sequence of str
        Columns that a table may lack: those of `flags`, or further ones of numbers.
    blank : sequence of str
        Columns of words that may be empty, or missing altogether.
    others_are_numbers : bool
        Whether every other column is kept and holds numbers.
    unique : str or sequence of str
        Column, or columns together, in which no entry may occur twice.
    may_be_empty : bool
        Whether a table without rows is valid.

    Raises
    ------
    InputError
        Naming the file, the line and the column.
    """
    import pandas as pd

    wanted = [column for column in (*text, *numbers, *flags) if column not in if_there]
    key = (unique,) if isinstance(unique, str) else tuple(unique)
    sheet = _read(path, [*wanted, *(column for column in key if column not in wanted)], comments=False, remedy=AGAIN)
    header = sheet.header
    if not sheet.cells and not may_be_empty:
        raise InputError("the table has no rows", place=path, remedy=AGAIN)
    wanted += [column for column in if_there if column in header]
    others = [c for c in header if c not in [*wanted, *blank]] if others_are_numbers else []
    if others_are_numbers and not others and sheet.cells:
        raise InputError(f"there is no column beside {', '.join(text)}", place=path)
    columns = dict(zip(header, map(list, zip(*sheet.cells, strict=True)), strict=True)) if sheet.cells else {}
    out: dict[str, np.ndarray | pd.api.extensions.ExtensionArray] = {}
    for column in [*blank, *wanted, *others]:
        cells = columns.get(column, [""] * len(sheet.cells))
        if column in blank:
            out[column] = pd.Series(["" if cell == "nan" else cell for cell in cells], dtype=str).array
        elif column in text:
            _require(sheet, column, [bool(cell) for cell in cells], cells, "a name")
            out[column] = pd.Series(cells, dtype=str).array
        elif column in flags:
            known = [None if _unknown(cell) else FLAGS.get(cell.lower()) for cell in cells]
            fine = [
                k is not None or (_unknown(c) and column not in complete) for k, c in zip(known, cells, strict=True)
            ]
            _require(sheet, column, fine, cells, "True or False")
            out[column] = np.array(known, dtype=object)
        else:
            found = [math.nan if _unknown(cell) else number_of(cell, sheet.comma) for cell in cells]
            fine = [
                v is not None
                and not (math.isnan(v) and column in complete)
                and not (math.isinf(v) and column not in unbounded)
                for v in found
            ]
            _require(sheet, column, fine, cells, "a number")
            out[column] = np.array(found, dtype=float)
    _require_unique(sheet, key, {name for name, values in out.items() if values.dtype == np.dtype(float)})
    return pd.DataFrame(out)


# -- lines and cells ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Sheet:
    """Header and cells of a file, their lines, and whether its numbers have decimal commas.

    ``top`` and ``head`` are number and text of the header's line, ``lines`` and ``texts`` those of the rows.
    """

    path: Path
    header: list[str]
    top: int
    head: str
    cells: list[list[str]]
    lines: list[int]
    texts: list[str]
    separator: str
    comma: bool


def _read(path: Path, required: Sequence[str], comments: bool, remedy: str | None = None) -> _Sheet:
    """Split a file into cells; every line has one per column, and every required column occurs once."""
    lines = _lines(path)
    separator, header, top, head = None, None, 0, ""
    cells: list[list[str]] = []
    numbers: list[int] = []
    texts: list[str] = []
    for number, line in enumerate(lines, start=1):
        bare = line.strip()
        if not bare or (comments and bare.startswith("#")):
            continue
        if header is None:
            if separator is None and (hint := _HINT.fullmatch(bare)) and hint.group(1) in SEPARATORS:
                separator = hint.group(1)
                continue
            separator = separator or separator_of(line, required)
            header, top, head = _without_empty_end(_cells(path, number, line, separator), 1), number, line
            _check_header(path, number, line, separator, header, required, remedy)
            continue
        found = _cells(path, number, line, separator or ",")
        if not any(found) or (comments and found[0].startswith("#")):
            continue
        found = _without_empty_end(found, len(header))  # spreadsheets fill lines up to the longest one
        if len(found) != len(header):
            index = min(len(found), len(header))
            raise InputError(
                f"it has {len(found)} entries, but the header has {len(header)} columns",
                place=place_of_entry(path, number, line, separator or ",", index).of(
                    f"column {header[min(index, len(header) - 1)]}"
                ),
                remedy="give every line one entry a column; decimal commas need semicolons between the entries",
            )
        cells.append(found)
        numbers.append(number)
        texts.append(line)
    if header is None:
        raise InputError("it is empty", place=path, remedy=remedy or f"start it with the header {', '.join(required)}")
    comma = separator != "," and any(COMMA_NUMBER.fullmatch(cell) for row in cells for cell in row)
    return _Sheet(path, header, top, head, cells, numbers, texts, separator or ",", comma)


def _lines(path: Path) -> list[str]:
    """Lines of a UTF-8 file without control characters."""
    try:
        data = path.read_bytes()
    except OSError as err:
        raise InputError(f"it cannot be read ({err.strerror})", place=path, remedy="check the path") from None
    lines = []
    for number, raw in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), start=1):
        try:
            line = raw.decode("utf-8")
        except UnicodeDecodeError as err:
            column = len(raw[: err.start].decode("utf-8")) + 1
            raise InputError(
                f"byte {err.start + 1} is not UTF-8 text",
                place=Place(str(path), number, raw.decode("utf-8", errors="replace"), column),
                remedy="save the table as UTF-8 CSV",
            ) from None
        if bad := _CONTROL.search(line):
            raise InputError(
                f"character {bad.start() + 1} is not printable: this is no text",
                place=Place(str(path), number, line, bad.start() + 1),
                remedy="save the table as UTF-8 CSV",
            )
        lines.append(line)
    return lines


def _cells(path: Path, number: int, line: str, separator: str) -> list[str]:
    """Stripped entries of one line."""
    if '"' not in line:
        return [unguarded(cell.strip()) for cell in line.split(separator)]
    try:
        # one line at a time, so that a forgotten quote cannot swallow the lines after it
        found = next(csv.reader([line], strict=True, skipinitialspace=True, delimiter=separator))
    except (csv.Error, StopIteration) as err:
        raise InputError(
            f"its entries cannot be separated ({err})",
            place=Place(str(path), number, line, line.index('"') + 1),
            remedy="check its quotes",
        ) from None
    return [unguarded(cell.strip()) for cell in found]


def _without_empty_end(cells: list[str], least: int) -> list[str]:
    end = len(cells)
    while end > least and not cells[end - 1]:
        end -= 1
    return cells[:end]


def _check_header(
    path: Path, line: int, text: str, separator: str, header: list[str], required: Sequence[str], remedy: str | None
) -> None:
    for k, name in enumerate(header):
        if name in header[:k]:
            place = place_of_entry(path, line, text, separator, k)
            raise InputError(f"column {name[:60]!r} appears twice", place=place, remedy="remove one")
    for name in required:
        if name not in header:
            old = old_column(name, header)
            place = place_of_entry(path, line, text, separator, None if old is None else header.index(old))
            if old is not None:
                raise InputError(
                    f"the column {old!r} is called {name!r} now", place=place, remedy=remedy or "rename it"
                )
            others = [own[:60] for own in header if own not in required]
            more = f" and {len(others) - 5} more" if len(others) > 5 else ""
            rename = f"add it, or rename one of {', '.join(others[:5])}{more}" if others else "add it"
            raise InputError(f"column {name!r} is missing", place=place, remedy=remedy or rename)


def _as_number(cell: str, comma: bool) -> str:
    """One text for all spellings of a number."""
    value = None if _unknown(cell) else number_of(cell, comma)
    return cell if value is None else repr(value + 0.0)  # -0.0 is 0.0


def _unknown(cell: str) -> bool:
    return cell.lower() in ("", "nan")


def _require(sheet: _Sheet, column: str, fine: Sequence[bool], cells: Sequence[str], expected: str) -> None:
    if not all(fine):
        row = fine.index(False)
        raise InputError(
            f"column {column!r} holds {shortened(cells[row])}, which is not {expected}",
            place=place_of_entry(
                sheet.path, sheet.lines[row], sheet.texts[row], sheet.separator, sheet.header.index(column)
            ),
            remedy=AGAIN,
        )


def _require_unique(sheet: _Sheet, columns: Sequence[str], numbers: Collection[str]) -> None:
    """No entries of some columns occur together twice; numbers are compared as such: ``0.0`` is ``0``."""
    if not columns:
        return
    where = [sheet.header.index(column) for column in columns]
    seen: set[tuple[str, ...]] = set()
    for line, cells, text in zip(sheet.lines, sheet.cells, sheet.texts, strict=True):
        given = zip(columns, (cells[k] for k in where), strict=True)
        key = tuple(_as_number(cell, sheet.comma) if name in numbers else cell for name, cell in given)
        if key in seen:
            raise InputError(
                f"column {', '.join(columns)!r} holds {', '.join(map(shortened, key))} twice",
                place=place_of_entry(sheet.path, line, text, sheet.separator, where[0]),
                remedy=AGAIN,
            )
        seen.add(key)
