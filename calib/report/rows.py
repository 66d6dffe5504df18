"""Charts of rows, such as bars or intervals: named at the left, and in a column, which is narrow, over each row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.text import Text

from calib.report.style import in_column

_LINE = 0.15
"""Height in inches of a line of words in a column."""
_MARKS = 0.23
"""Height in inches of the marks of a row below its name."""


def rows_height(names: Sequence[str], page: float) -> float:
    """Height in inches of the rows of a chart, each that high on a page; in a column below their names."""
    return max(len(names), 1) * (_MARKS + _line_over(names) if in_column() else page)


def row_edges(names: Sequence[str]) -> tuple[float, float]:
    """Upper and lower end of row 0 of a chart whose marks stand at 0; in a column its name is above them."""
    lower = 0.5 * _MARKS / (_MARKS + _line_over(names)) if in_column() else 0.5
    return lower - 1.0, lower


def _line_over(names: Sequence[str]) -> float:
    """Height in inches of the names over the rows."""
    return _LINE * max((name.count("\n") + 1 for name in names), default=1)


def name_rows(ax: Axes, names: Sequence[str], values: Sequence[str] = ()) -> list[Text]:
    """Name the rows 0, 1, ... of a chart at its left; in a column over each, with values at the right.

    Return the names.
    """
    ax.tick_params(axis="y", length=0)
    if not in_column():
        ax.set_yticks(range(len(names)), names)
        return list(ax.get_yticklabels())
    ax.set_yticks([])
    where: dict[str, Any] = {"xycoords": ax.get_yaxis_transform(), "textcoords": "offset points", "va": "bottom"}
    room: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.3}
    _, mark = row_edges(names)
    looks = {"fontsize": 7.5, "zorder": 6, "in_layout": False, "bbox": room, **where}
    for row, words in enumerate(values):
        ax.annotate(words, (1.0, row - mark), xytext=(-1, 0), ha="right", **looks)
    return [ax.annotate(name, (0.0, row - mark), xytext=(3, 0), **looks) for row, name in enumerate(names)]


def run_on(left: Axes, right: Axes, rows: int) -> None:
    """Let the names over the rows of a panel run on over those of the panel at its right, which has the same rows."""
    for name in right.texts[-rows:]:
        name.remove()
    left.set_zorder(1)
    left.patch.set_visible(False)
