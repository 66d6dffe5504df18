"""What a page is made of: sections of words, tables and figures; they know no HTML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import plotly.graph_objects as go

LONGEST = 12
"""Rows of the longest table that is shown open."""


@dataclass(frozen=True)
class Words:
    """A paragraph.

    Attributes
    ----------
    text : str
    kind : {"plain", "told", "warning", "verdict"}
        ``told`` is a sentence of the tool itself, ``verdict`` the one that matters.
    """

    text: str
    kind: Literal["plain", "told", "warning", "verdict"] = "plain"


@dataclass(frozen=True)
class Terms:
    """Names that are explained once, where they first occur: (name, what it is)."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """A table of ready words; one of more than `LONGEST` rows is folded away.

    Attributes
    ----------
    caption : str
    heads : tuple of str
        Over the columns; the first column names the rows.
    rows : tuple of tuple of str
    left : tuple of int
        Columns of words; all others hold numbers and stand at the right. The first is always words.
    grey : tuple of int
        Rows that say nothing can be seen.
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...] = ()
    grey: tuple[int, ...] = ()

    @property
    def folded(self) -> bool:
        """Whether only the caption is shown until the reader asks."""
        return len(self.rows) > LONGEST


@dataclass(frozen=True, eq=False)
class Plot:
    """An interactive figure.

    Attributes
    ----------
    name : str
        Its identifier in the page.
    caption : str
    alt : str
        What it shows, for those who cannot see it.
    figure : Figure
    """

    name: str
    caption: str
    alt: str
    figure: go.Figure


@dataclass(frozen=True, eq=False)
class Shapes:
    """Mode shapes that can be turned and animated, one mode at a time.

    Attributes
    ----------
    name, caption, alt : str
        As of a `Plot`.
    scene : mapping
        Plain numbers and words; see `calib.report.html.shapes.scene`.
    """

    name: str
    caption: str
    alt: str
    scene: Mapping[str, Any]


Block: TypeAlias = Words | Terms | Table | Plot | Shapes


@dataclass(frozen=True, eq=False)
class Section:
    """A part of the story.

    Attributes
    ----------
    name : str
        Its identifier in the page.
    title : str
    blocks : tuple of Block
    """

    name: str
    title: str
    blocks: tuple[Block, ...]
