"""Parts of a page, without HTML: sections of paragraphs, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

LONGEST = 12
"""Rows of the longest table that is shown unfolded."""


@dataclass(frozen=True)
class Words:
    """A paragraph.

    Attributes
    ----------
    text : str
    kind : {"plain", "reported", "warning", "verdict"}
        ``reported`` is a sentence that an analysis reported, ``verdict`` its conclusion.
    """

    text: str
    kind: Literal["plain", "reported", "warning", "verdict"] = "plain"


@dataclass(frozen=True)
class Terms:
    """Definitions of terms, given where they first occur: (term, definition)."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """A table of formatted cells; one of more than `LONGEST` rows is folded, unless it is to stay open.

    Attributes
    ----------
    caption : str
    heads : tuple of str
        Column headings; the first column names the rows.
    rows : tuple of tuple of str
    left : tuple of int
        Columns of text, aligned left; the others hold numbers, aligned right. The first column is always text.
    grey : tuple of int
        Rows of effects that are not visible, in grey.
    unfolded : bool
        Whether it stays open however long it is.
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...] = ()
    grey: tuple[int, ...] = ()
    unfolded: bool = False

    @property
    def folded(self) -> bool:
        """Whether only the caption is shown until the reader unfolds the table."""
        return len(self.rows) > LONGEST and not self.unfolded


@dataclass(frozen=True)
class Picture:
    """A figure of the folder.

    Attributes
    ----------
    name : str
        Its name in `calib.report.draw.plan`, and its identifier in the page.
    caption : str
    alt : str
        Text alternative for readers who cannot see the figure.
    tables : tuple of str
        The tables that it shows, without suffix; each is offered as a file.
    folded : str
        What is shown until the reader unfolds the figure; empty for one that is open.
    """

    name: str
    caption: str
    alt: str
    tables: tuple[str, ...]
    folded: str = ""


@dataclass(frozen=True, eq=False)
class Viewer:
    """The model in space, which can be turned: mode shapes that move, sensors, misfit and scores, one at a time.

    Attributes
    ----------
    name, caption, alt : str
        As in `Picture`.
    scene : mapping
        Values for JSON; see `calib.report.html.space.scene`.
    """

    name: str
    caption: str
    alt: str
    scene: Mapping[str, Any]


Block: TypeAlias = Words | Terms | Table | Picture | Viewer


@dataclass(frozen=True, eq=False)
class Section:
    """A section of the page.

    Attributes
    ----------
    name : str
        Identifier in the page.
    title : str
    blocks : tuple of Block
    """

    name: str
    title: str
    blocks: tuple[Block, ...]
