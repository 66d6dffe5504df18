"""Place in a file of the user: the file, the line and what stands there."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path


@dataclass(frozen=True)
class Place:
    """Where in a file something is wrong; it is kept as data, so that it survives the way from another process.

    Attributes
    ----------
    file : str
    line : int or None
        Counted from 1; None where only the file is known.
    text : str
        That line without its end, as it was when it was read; empty where it is unknown.
    column : int or None
        First wrong character of the line, counted from 1; None where the whole line is meant.
    length : int
        Number of wrong characters.
    what : str
        The thing that stands there, such as ``column freq``.
    """

    file: str
    line: int | None = None
    text: str = ""
    column: int | None = None
    length: int = 1
    what: str = ""

    def __str__(self) -> str:
        line = "" if self.line is None else f"line {self.line}"
        return ", ".join(filter(None, (self.file, line, self.what)))

    @property
    def short(self) -> str:
        """The file's name and the thing, where the line is shown beside it."""
        return ", ".join(filter(None, (Path(self.file).name, self.what)))

    def of(self, what: str) -> Place:
        """The same place, naming the thing that stands there."""
        return replace(self, what=what)

    @staticmethod
    def in_lines(
        file: str | Path, lines: Sequence[str], line: int, column: int | None = None, length: int = 1, what: str = ""
    ) -> Place:
        """The place in a file of which all lines are known; a line beyond them has no text."""
        text = lines[line - 1] if 0 < line <= len(lines) else ""
        return Place(str(file), line, text.rstrip("\r\n"), column, length, what)


WIDEST = 100
"""Columns of the terminal that a line may take with its number; a longer one is cut around the mark."""
_LEAST = 30
"""Columns of the line itself that are shown on the narrowest terminal."""
TAB = 4
_CUT = "..."


def excerpt(place: Place, widest: int = WIDEST) -> tuple[str, ...]:
    """The place as lines of text: file and line, the line itself, and marks under the wrong characters.

    Tabs are expanded, characters that do not print become question marks, and wide or combining characters count by
    the columns that they take. Empty without a line.
    """
    if place.line is None:
        return ()
    head = f"  {_from_here(place.file)}, line {place.line}"
    if not place.text.strip():
        return (head,)
    cells = _cells(place.text.rstrip())
    begin = end = None
    if place.column is not None:
        begin = min(max(place.column - 1, 0), len(cells))
        end = min(begin + max(place.length, 1), len(cells))
    number = f"  {place.line} | "
    first, last = _window(cells, begin or 0, end or 0, max(widest - len(number), _LEAST))
    before = _CUT if first else ""
    shown = before + "".join(cells[first:last]) + (_CUT if last < len(cells) else "")
    out = (head, number + shown.rstrip())
    if begin is None or end is None:
        return out
    margin = " " * (len(number) - 2) + "| "
    gap = _width(before) + _width(cells[first:begin])
    return (*out, margin + " " * gap + "^" * max(_width(cells[begin : min(end, last)]), 1))


def _from_here(file: str) -> str:
    """The file relative to the current directory, where it lies below it."""
    path = Path(file)
    try:
        here = Path(os.getcwd())
    except OSError:  # it was removed
        return file
    return str(path.relative_to(here)) if path.is_absolute() and path.is_relative_to(here) else file


def _cells(text: str) -> list[str]:
    """One string for each character, as it is printed."""
    out: list[str] = []
    at = 0
    for c in text:
        shown = " " * (TAB - at % TAB) if c == "\t" else c if c.isprintable() else "?"
        out.append(shown)
        at += _width(shown)
    return out


def _width(cells: Sequence[str]) -> int:
    """Columns that characters take on a terminal."""
    return sum(_columns(c) for cell in cells for c in cell)


def _columns(c: str) -> int:
    if unicodedata.combining(c) or unicodedata.category(c) in ("Mn", "Me"):
        return 0
    return 2 if unicodedata.east_asian_width(c) in ("W", "F") else 1


def _window(cells: Sequence[str], begin: int, end: int, widest: int) -> tuple[int, int]:
    """First character shown, and the one behind the last, so that the beginning of the mark is visible."""
    reach = [0, *accumulate(_width(cell) for cell in cells)]  # columns before each character
    if reach[-1] <= widest:
        return 0, len(cells)
    room = widest - 2 * len(_CUT)
    first = 0
    if reach[end] > room:
        first = begin
        while first > 0 and reach[begin] - reach[first - 1] <= room // 2:
            first -= 1
    last = first
    while last < len(cells) and reach[last + 1] - reach[first] <= room:
        last += 1
    while last == len(cells) and first > 0 and reach[-1] - reach[first - 1] <= room:
        first -= 1
    return first, last
