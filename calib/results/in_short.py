"""Measured data as they print: a line, or a short table, in a notebook too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

MOST = 12
"""Names or rows that are shown; of more, the first and how many there are."""


class Short:
    """What shows itself as `str` has it."""

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """As notebooks show it."""
        printer.text(str(self))


def names_in_line(names: Sequence[str]) -> str:
    """Names in a line; of many the first and the last."""
    first = names if len(names) <= MOST else [*names[: MOST - 2], "...", names[-1]]
    return ", ".join(first)


def aligned_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first row is its heading, columns to the right."""
    shown = rows if len(rows) <= MOST + 1 else rows[: MOST + 1]
    widths = [max(len(row[k]) for row in shown) for k in range(len(rows[0]))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in shown]
    return lines + [f"... {len(rows) - len(shown)} more"] * (len(shown) < len(rows))


def marked(synthetic: bool) -> str:
    """The mark of computed data."""
    return " (synthetic)" if synthetic else ""
