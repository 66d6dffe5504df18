"""Entries of a line of a CSV table: what separates them, and where each one stands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calib.errors.place import Place

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
