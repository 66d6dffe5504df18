"""Place in a file of the user: the file, the line and what stands there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
