"""Formats of the templates: of one value, or of a column of a table, row by row."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import repeat
from typing import Any

import pandas as pd
from markupsafe import Markup

from calib.report import numbers
from calib.report.numbers import flag
from calib.report.verification import GROUPS


class TextCells(list[str]):
    """Cells of words, aligned left; those of other lists are numbers, aligned right."""


def by_row(formatted: Callable[..., str], cells: type[list[str]] = list) -> Callable[..., Any]:
    """Return a format that takes a column too, and then returns its cells; arguments may be columns or one value."""

    def of(values: Any, *arguments: Any, **looks: Any) -> Any:
        if not isinstance(values, pd.Series | list):
            return formatted(values, *arguments, **looks)
        each = (own if isinstance(own, pd.Series | list) else repeat(own) for own in arguments)
        return cells(formatted(value, *own, **looks) for value, *own in zip(values, *each, strict=False))

    return of


def filled(pattern: str, *columns: Any) -> list[str]:
    """Fill the places ``{}`` of a pattern from columns, row by row; one that is no column stands in each."""
    return [str(cell) for cell in by_row(lambda first, *more: pattern.format(first, *more))(*columns)]


def flagged(table: pd.DataFrame, column: str) -> pd.DataFrame:
    """Rows in which a flag holds; unknown counts as no."""
    return table[table[column].map(flag).astype(bool)]


def group_words(group: str) -> str:
    """A group of data in words."""
    return GROUPS.get(group, group)


def rows(columns: Sequence[tuple[str, Sequence[str]]]) -> list[tuple[str, ...]]:
    """Rows of a table of the page from its columns, each a heading and its cells."""
    return list(zip(*(cells for _, cells in columns), strict=True))


def tidy(words: str) -> str:
    """Words without line breaks and room at their ends; what is escaped stays so."""
    tidied = " ".join(words.split())
    return Markup(tidied) if isinstance(words, Markup) else tidied


def arrows(words: str) -> str:
    """Words of an analysis with true arrows."""
    return words.replace(" -> ", " → ")


def _paired(freq: float) -> str:
    return "not paired" if math.isnan(freq) else numbers.fixed(freq, 3)


def _between(lower: float, upper: float) -> str:
    """Limits in the unit of the nominal value; held where there are none."""
    return "held" if math.isnan(lower) else f"{numbers.significant(lower)} to {numbers.significant(upper)}"


def _until(lower: float, upper: float) -> str:
    """An interval of shares."""
    return numbers.UNKNOWN if math.isnan(lower) else f"{numbers.fixed(lower, 2)} to {numbers.fixed(upper, 2)}"


def _yes_if(value: Any, words: tuple[str, str] = ("yes", "no")) -> str:
    """A flag that counts as no where it is unknown."""
    return numbers.yes(flag(value), words)


def _marked(value: Any, mark: str) -> str:
    return mark if flag(value) else ""


FILTERS: dict[str, Callable[..., Any]] = {
    **{
        name: by_row(getattr(numbers, name))
        for name in ("fixed", "percent", "significant", "p_in_words", "probability")
    },
    "yes": by_row(numbers.yes, TextCells),
    "with_unit": by_row(numbers.with_unit),
    "text": by_row(str, TextCells),
    "number": by_row(str),
    "group": by_row(group_words, TextCells),
    "paired": by_row(_paired),
    "between": by_row(_between),
    "until": by_row(_until),
    "yes_if": by_row(_yes_if, TextCells),
    "marked": by_row(_marked, TextCells),
    "counted": numbers.counted,
    "flagged": flagged,
    "rows": rows,
    "tidy": tidy,
    "arrows": arrows,
}
"""Filters of the templates by name."""


def is_words(cells: Iterable[str]) -> bool:
    """Whether a column holds words."""
    return isinstance(cells, TextCells)
