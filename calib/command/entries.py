"""Told: what one analysis has to say on the terminal, and how it is printed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Literal, TypeAlias

from calib.command.terminal import count, labelled, say, table, warn
from calib.results.answer import Answer

MOST = 12
"""Rows of a table that are shown unless all are asked for."""
WARNINGS = 4
"""Warnings that are shown unless all are asked for."""
ALL = "-v shows all"


When: TypeAlias = Literal["always", "brief", "verbose"]
"""Whether an entry is shown always, only unless all is asked for, or only on request."""


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


Entry: TypeAlias = Words | Warned | Rows


@dataclass(frozen=True)
class AnalysisEntries:
    """What one analysis has to say.

    Attributes
    ----------
    verb : str
    title : str
        Line above it.
    answer : Answer or None
        None where the analysis has none of its own.
    place : Path or None
        Its report or its tables.
    entries : tuple of Entry
    """

    verb: str
    title: str
    answer: Answer | None = None
    place: Path | None = None
    entries: tuple[Entry, ...] = ()


def tell_answer(answer: Answer, place: Path | None) -> None:
    """Print an answer in four lines."""
    for label, text in answer.labelled.items():
        labelled(label, text)
    if place is not None:
        labelled("Report" if place.suffix == ".html" else "Results", str(place))


def tell_entries(entries: Sequence[Entry], verbose: bool) -> None:
    """Print warnings first, then the other entries; on request all of them."""
    warnings = [entry.text for entry in entries if isinstance(entry, Warned)]
    shown = warnings if verbose else warnings[:WARNINGS]
    for text in shown:
        warn(text)
    if len(warnings) > len(shown):
        warn(f"{count(len(warnings) - len(shown), 'further warning')}: {ALL}.")
    for entry in entries:
        if isinstance(entry, Warned) or entry.when == ("brief" if verbose else "verbose"):
            continue
        if isinstance(entry, Words):
            say(entry.text)
        elif entry.rows:
            _tell_rows(entry, verbose)


def _tell_rows(entry: Rows, verbose: bool) -> None:
    say()
    if entry.title:
        say(entry.title)
    rows = entry.rows if verbose else entry.rows[: entry.most]
    known = [k == 0 or any(row[k] for row in rows) for k in range(len(entry.heads))]  # what was not measured is empty
    table(*_columns(entry.heads, rows, known), left=entry.left)
    if len(rows) < len(entry.rows):
        say(f"{count(len(entry.rows) - len(rows), 'further row')}: {ALL}.")


def _columns(
    heads: Sequence[str], rows: Sequence[Sequence[str]], kept: Sequence[bool]
) -> tuple[list[str], list[list[str]]]:
    """The kept columns of a table."""
    return list(compress(heads, kept)), [list(compress(row, kept)) for row in rows]
