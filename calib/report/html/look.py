"""Style of the interactive figures: one font, one palette, the same colours as in the PNG figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.io import to_json

FONT = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
GRID = "#E3E3E3"
PATTERNS = {"before": "/", "after": "", "attempt": "x"}
"""Hatches of the stages."""


def new(height: int, **layout: Any) -> go.Figure:
    """Return an empty figure of that height in pixels, as wide as the page."""
    return go.Figure(
        layout={
            "template": go.layout.Template(),
            "height": height,
            "font": {"family": FONT, "size": 13, "color": "#1A1A1A"},
            "margin": {"l": 60, "r": 20, "t": 64, "b": 50},
            "paper_bgcolor": "white",
            "plot_bgcolor": "white",
            "hoverlabel": {"font": {"family": FONT, "size": 13}, "align": "left"},
            "legend": {"orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom", "font": {"size": 13}},
            **layout,
        }
    )


def number_axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis of numbers."""
    look = {"gridcolor": GRID, "zerolinecolor": "#8A8A8A", "automargin": True}
    return {"title": titled(title), **look, **more}


def titled(words: str) -> dict[str, Any]:
    """Return a title in the size of the other text."""
    return {"text": shown(words), "font": {"size": 13}}


def name_axis(names: Sequence[str], title: str = "", reverse: bool = False, **more: Any) -> dict[str, Any]:
    """Return an axis of names at 0, 1, 2...; names that look like numbers stay names."""
    count = len(names)
    span = [count - 0.5, -0.5] if reverse else [-0.5, count - 0.5]
    return {
        "title": {**titled(title), "standoff": 12},
        "ticks": "",
        "tickmode": "array",
        "tickvals": list(range(count)),
        "ticktext": [shown(name) for name in names],
        "range": span,
        "showgrid": False,
        "zeroline": False,
        "automargin": True,
        **more,
    }


def shown(words: object) -> str:
    """Escape text so that a figure shows it literally."""
    return escape(str(words), quote=False)


def filled(colour: str, pattern: str = "") -> dict[str, Any]:
    """Return the style of bars; hatches distinguish them without colours."""
    return {"color": colour, "pattern": {"shape": pattern, "bgcolor": colour, "fgcolor": "white", "size": 7}}


def wrapped(words: str, width: int = 34) -> str:
    """Wrap text to lines of about that width."""
    lines, line = [], ""
    for word in words.split():
        if line and len(line) + len(word) >= width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "<br>".join(shown(part) for part in [*lines, line])


def add_matrix(
    figure: go.Figure,
    values: np.ndarray,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Sequence[Sequence[str]],
    *,
    colours: str,
    span: tuple[float, float],
    label: str,
    hover: Sequence[Sequence[str]] | None = None,
    bar: bool = True,
    **more: Any,
) -> None:
    """Add coloured cells with text in them.

    Parameters
    ----------
    figure : Figure
    values : ndarray (n_rows, n_columns)
        NaN leaves a cell grey.
    rows, columns : sequence of str
    cells : nested sequence of str
        Text of the cells.
    colours : str
        Name of the colour scale.
    span : tuple of float
        Values at the ends of the colour scale.
    label : str
        Label of the colour bar.
    hover : nested sequence of str, optional
        Text shown over a cell by the mouse; by default row, column and cell text.
    bar : bool
        Whether a colour bar is drawn.
    """
    hover = hover or [
        [f"{r}, {c}: {cell or 'no value'}" for c, cell in zip(columns, line, strict=True)]
        for r, line in zip(rows, cells, strict=True)
    ]
    size = 12 if len(columns) <= 14 else 10 if len(columns) <= 22 else 8
    figure.add_heatmap(
        z=values,
        x=list(range(len(columns))),
        y=list(range(len(rows))),
        text=[[shown(cell) for cell in line] for line in cells],
        hovertext=[[shown(words) for words in line] for line in hover],
        hoverinfo="text",
        texttemplate="%{text}",
        textfont={"size": size},
        colorscale=colours,
        zmin=span[0],
        zmax=span[1],
        xgap=1,
        ygap=1,
        showscale=bar,
        colorbar={"title": {**titled(label), "side": "right"}, "thickness": 14},
        **more,
    )


def as_json(figure: go.Figure) -> str:
    """Return data and layout of a figure as text that is safe in a script element."""
    return embedded(to_json(figure, validate=True))


def scalar_json(content: object) -> str:
    """Return plain values as text that is safe in a script element."""
    return embedded(json.dumps(content, allow_nan=False, separators=(",", ":")))


def embedded(text: str) -> str:
    """Return JSON escaped so that nothing in it can end a script element."""
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
