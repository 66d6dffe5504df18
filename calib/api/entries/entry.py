"""Entries: the paragraphs, warnings and tables that an analysis has to say, and how they are laid out as text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import compress
from typing import Literal, TypeAlias

from calib.results.answer import signed

MOST = 12
"""Rows of a table that are shown unless all are asked for."""
WARNINGS = 4
"""Warnings that are shown unless all are asked for."""
WIDTH = 120
"""Columns of tables that do not go to a terminal."""
NARROWEST = 40
"""Columns below which a line is not wrapped further."""

When: TypeAlias = Literal["always", "brief", "verbose"]
"""Whether an entry is shown always, only unless all is asked for, or only on request."""
Style: TypeAlias = Literal["bold", "yellow"] | None
"""Style of a line on a terminal."""


@dataclass(frozen=True)
class Words:
    """A paragraph.

    Attributes
    ----------
    text : str
    when : {"always", "brief", "verbose"}
    """

    text: str
    when: When = "verbose"


@dataclass(frozen=True)
class Warned:
    """A paragraph that must not be missed; of many, some are shown on request only."""

    text: str


@dataclass(frozen=True)
class Rows:
    """A table.

    Attributes
    ----------
    title : str
        Line above it; may be empty.
    heads : tuple of str
    rows : tuple of tuple of str
        The most important first, where ``most`` is less than all.
    left : tuple of str
        Left-aligned columns besides the first.
    when : {"always", "brief", "verbose"}
    most : int
        Rows that are shown without a request.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[str, ...] = ()
    when: When = "always"
    most: int = MOST

    @classmethod
    def of(
        cls,
        title: str,
        heads: Sequence[str],
        rows: Iterable[Sequence[str]],
        left: Sequence[str] = (),
        when: When = "always",
        most: int = MOST,
    ) -> Rows:
        """A table of any sequences."""
        return cls(title, tuple(heads), tuple(map(tuple, rows)), tuple(left), when, most)

    def shown(self, verbose: bool) -> Rows:
        """The table as it is shown: rows up to ``most`` unless all are asked for, without empty columns."""
        rows = self.rows if verbose else self.rows[: self.most]
        known = [k == 0 or any(row[k] for row in rows) for k in range(len(self.heads))]
        cells = tuple(tuple(compress(row, known)) for row in rows)
        return Rows(self.title, tuple(compress(self.heads, known)), cells, self.left, self.when, self.most)


Entry: TypeAlias = Words | Warned | Rows


def lines_of(entries: Sequence[Entry], verbose: bool, all_at: str, width: int = WIDTH) -> Iterator[tuple[str, Style]]:
    """The lines of entries, warnings first, each with its style; paragraphs are one line each.

    Parameters
    ----------
    entries : sequence of Entry
    verbose : bool
        Whether all entries, rows and warnings are asked for.
    all_at : str
        Where all of them are, as a sentence ends: ``"-v shows all"``.
    width : int
        Columns of a table.
    """
    warnings = [entry.text for entry in entries if isinstance(entry, Warned)]
    first = warnings if verbose else warnings[:WARNINGS]
    for text in first:
        yield text, "yellow"
    if len(warnings) > len(first):
        yield f"{count(len(warnings) - len(first), 'further warning')}: {all_at}.", "yellow"
    for entry in _on_show(entries, verbose):
        if isinstance(entry, Words):
            yield entry.text, None
            continue
        yield "", None
        if entry.title:
            yield entry.title, None
        table = entry.shown(verbose)
        yield from table_lines(table.heads, table.rows, table.left, width)
        if len(table.rows) < len(entry.rows):
            yield f"{count(len(entry.rows) - len(table.rows), 'further row')}: {all_at}.", None


def html_of(entries: Sequence[Entry], all_at: str) -> str:
    """The same for a notebook, without what is shown on request only."""
    parts = [f"<p>{escape(entry.text)}</p>" for entry in entries if isinstance(entry, Warned)]
    for entry in _on_show(entries, False):
        if isinstance(entry, Words):
            parts.append(f"<p>{escape(entry.text)}</p>")
            continue
        table = entry.shown(False)
        heads = "".join(f"<th>{escape(head)}</th>" for head in table.heads)
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in table.rows)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(f"<p>{escape(entry.title)}</p>" * bool(entry.title))
        parts.append(f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>")
        if len(table.rows) < len(entry.rows):
            parts.append(f"<p>{count(len(entry.rows) - len(table.rows), 'further row')}: {escape(all_at)}.</p>")
    return "".join(parts)


def _on_show(entries: Sequence[Entry], verbose: bool) -> Iterator[Words | Rows]:
    """Paragraphs and tables that are shown, empty tables left out."""
    for entry in entries:
        if isinstance(entry, Warned) or entry.when == ("brief" if verbose else "verbose"):
            continue
        if isinstance(entry, Words) or entry.rows:
            yield entry


def table_lines(
    heads: Sequence[str], rows: Iterable[Sequence[str]], left: Sequence[str] = (), width: int = WIDTH
) -> Iterator[tuple[str, Style]]:
    """The lines of a table; the first column and those in ``left`` are left-aligned.

    Cells wrap between words. Where even that is too wide, each row is told in a paragraph.
    """
    cells = [list(row) for row in rows]
    columns = [[head, *(row[k] for row in cells)] for k, head in enumerate(heads)]
    least = [max(len(word) for cell in column for word in cell.split() or [""]) for column in columns]
    room = width - 2 * (len(heads) - 1)
    if sum(least) > room:
        for first, *others in cells:
            remainder = "; ".join(f"{head} {cell}" for head, cell in zip(heads[1:], others, strict=True) if cell)
            yield f"{heads[0]} {first}: {remainder}", None
        return
    widths = [max(map(len, column)) for column in columns]
    while sum(widths) > room:
        widest = max((k for k in range(len(widths)) if widths[k] > least[k]), key=lambda k: widths[k])
        widths[widest] -= 1
    sides = [str.ljust if k == 0 or name in left else str.rjust for k, name in enumerate(heads)]
    for number, row in enumerate([heads, *cells]):
        parts = [wrapped_lines(cell, size) for cell, size in zip(row, widths, strict=True)]
        for k in range(max(map(len, parts))):
            line = [side(part[k] if k < len(part) else "", size)
                    for part, side, size in zip(parts, sides, widths, strict=True)]  # fmt: skip
            yield "  ".join(line).rstrip(), "bold" if number == 0 else None


def wrapped_lines(text: str, width: int) -> list[str]:
    """Text broken between words; a word longer than the width has a line to itself."""
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


def count(number: int, thing: str) -> str:
    """A number of things, singular or plural."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def decimals(value: float, digits: int) -> str:
    """A number with the given number of decimals, never -0; empty for NaN."""
    return "" if math.isnan(value) else f"{value:z.{digits}f}"


def off(share: float) -> str:
    """An error in percent with its sign; empty for NaN."""
    return "" if math.isnan(share) else f"{signed(100.0 * share, 2)} %"
