"""Mass-orthogonality of the measured shapes, to those of the model and among themselves."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from calib.report.numbers import fixed
from calib.report.style import (
    GREY,
    VERMILLION,
    bar_beside,
    legend_above,
    matrix_height,
    new_figure,
    own_axes,
    room,
    separate_cells,
)
from calib.report.svg import hover_cells

KEPT, LEAK = 0.9, 0.1
"""The usual reading of values with two decimals: pairs reach the first, others stay within the second."""
_LABEL = "orthogonality (–)"
_BESIDE = 9
"""Columns up to which both matrices stand beside each other."""
_SHORT = 14
"""Characters of a mode's name up to which they do."""
_CHARACTER = 0.075
"""Width of a character of a label, inches."""


def draw_cross_orthogonality(table: pd.DataFrame, ax: Axes | None = None, *, key: bool = True) -> Axes:
    """Draw the cross-orthogonality of measured and model modes as a matrix with the values in the cells.

    Parameters
    ----------
    table : DataFrame
        Columns ``mode``, ``model_mode`` (number of the partner; NaN without one) and one for every model mode, headed
        like ``1 (10.83 Hz)``; cells 0 to 1.
    ax : Axes, optional
    key : bool
        Whether to explain colours and frames.

    Returns
    -------
    Axes
        Pairs below `KEPT` and others above `LEAK` have a frame with the gid ``fails``.
    """
    heads = [str(c) for c in table.columns if c not in ("mode", "model_mode")]
    partner = table["model_mode"].to_numpy(dtype=float)
    paired = np.array([[head.split(" ")[0] == f"{number:.0f}" for head in heads] for number in partner], dtype=bool)
    return _draw(table, heads, paired.reshape(len(table), len(heads)), "model mode", ax, key)


def draw_self_orthogonality(table: pd.DataFrame, ax: Axes | None = None, *, key: bool = True) -> Axes:
    """Draw the orthogonality of the measured shapes among themselves, likewise.

    Parameters
    ----------
    table : DataFrame
        Column ``mode`` and one for every measured mode, in the same order; cells 0 to 1.
    ax : Axes, optional
    key : bool
    """
    heads = [str(c) for c in table.columns if c != "mode"]
    return _draw(
        table, heads, table["mode"].astype(str).to_numpy()[:, None] == np.array(heads), "measured mode", ax, key
    )


def orthogonality_figure(cross: pd.DataFrame, own: pd.DataFrame) -> Figure:
    """Draw both matrices, beside each other while they are small."""
    columns = max(cross.shape[1] - 2, own.shape[1] - 1)
    longest = max((len(str(mode)) for mode in cross["mode"]), default=0)
    height = matrix_height(len(cross), _BESIDE) + 0.35  # room for upright labels
    beside = columns <= room(_BESIDE) and longest <= room(_SHORT)
    figure = new_figure(height if beside else 2 * height)
    axes = figure.subplots(1, 2) if beside else figure.subplots(2, 1)
    draw_cross_orthogonality(cross, axes[0], key=False)
    draw_self_orthogonality(own, axes[1], key=False)
    if beside:
        axes[1].set_ylabel("")
    for ax, letter, what in zip(axes, "ab", ("to the model", "among themselves"), strict=True):
        ax.set_title(f"({letter}) {what}")
    bar_beside(axes, axes[0].images[0], _LABEL)
    if any(map(_fails, axes)):
        figure.legend(handles=[_frame()], loc="outside lower right")
    return figure


def _draw(table: pd.DataFrame, heads: list[str], paired: np.ndarray, across: str, ax: Axes | None, key: bool) -> Axes:
    values = table[heads].to_numpy(dtype=float)
    rows, columns = values.shape
    ax = own_axes(ax, matrix_height(rows, columns))
    image = ax.imshow(values, cmap="Blues", norm=Normalize(0.0, 1.0), aspect="auto")
    width = ax.get_position().width * float(ax.get_figure(root=True).get_size_inches()[0])  # type: ignore[union-attr]
    size = float(np.clip(18.0 * width / max(columns, 1), 4.5, 8.0))
    separate_cells(ax, rows, columns)
    for i, j in np.argwhere(np.isfinite(values)):
        value = values[i, j]
        fails = round(value, 2) < KEPT if paired[i, j] else round(value, 2) > LEAK
        shade = "white" if value > 0.6 else "black" if value >= 0.2 or fails else GREY
        weight = "bold" if fails else "normal"
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=size, color=shade, fontweight=weight)
        if fails:
            ax.add_patch(
                Rectangle(
                    (j - 0.46, i - 0.44), 0.92, 0.88, fill=False, edgecolor=VERMILLION, linewidth=1.4, gid="fails"
                )
            )
    wide = _CHARACTER * sum(len(head) + 2 for head in heads) > width
    ax.set_xticks(range(columns), heads, rotation=90 if wide else 0)
    ax.set_yticks(range(rows), table["mode"].astype(str))
    ax.set_xlabel(across)
    ax.set_ylabel("measured mode")
    words = [
        [f"{mode}, {across} {head}: {fixed(value, 3)}" for head, value in zip(heads, row, strict=True)]
        for mode, row in zip(table["mode"], values, strict=True)
    ]
    hover_cells(ax, words)
    if key:
        bar_beside(ax, image, _LABEL)
    if key and _fails(ax):
        legend_above(ax, [_frame()])
    return ax


def _fails(ax: Axes) -> bool:
    """Whether a cell is framed."""
    return any(patch.get_gid() == "fails" for patch in ax.patches)


def _frame() -> Artist:
    """Entry of the legend for cells that fail."""
    words = f"pair below {KEPT:g}, or other above {LEAK:g}"
    return Patch(fill=False, edgecolor=VERMILLION, linewidth=1.4, label=words)
