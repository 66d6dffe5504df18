"""Pictures of designs: clouds of two columns, and all columns side by side."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter
from scipy.stats import spearmanr

from calib.errors.errors import InputError
from calib.report import style
from calib.report.numbers import fixed

_CELLS = 100
"""Cells of the density along each axis."""
_SMOOTH = 2.0
"""Standard deviation, in cells, by which the density is smoothed."""
_DENSE = 300
"""Designs from which a cloud shows its density."""
MOST_LINES = 2000
"""Designs of which each is a line; of more, the best and evenly chosen others."""


def draw_anthill(
    table: pd.DataFrame,
    x: str,
    y: str,
    ax: Axes | None = None,
    labels: Mapping[str, str] = MappingProxyType({}),
    log: Collection[str] = (),
) -> Axes:
    """Draw two columns of designs against each other: an anthill plot, coloured by the density of its points.

    Parameters
    ----------
    table : DataFrame
        One row a design; rows in which a value is missing are left out and counted.
    x, y : str
        Columns.
    ax : Axes, optional
    labels : mapping from str to str
        Labels of columns, such as with their units.
    log : collection of str
        Columns with a logarithmic axis, of whose logarithms density and correlation are.

    Returns
    -------
    Axes
        Densest points on top, darkest; the title has the number of points, and linear and rank correlation.

    Raises
    ------
    InputError
        Where a column is missing or has no two different numbers.
    """
    values = numeric_columns(table, [x, y]).to_numpy()
    known = values[np.isfinite(values).all(axis=1)]
    along = np.log10(known, where=[x in log, y in log], out=known.copy())
    ax = style.own_axes(ax, 4.2)
    looks: dict[str, Any] = {"s": 12, "linewidths": 0, "rasterized": len(known) > _DENSE, "gid": "designs"}
    if len(known) > _DENSE:
        density = _density(along)
        order = np.argsort(density, kind="stable")
        ax.scatter(known[order, 0], known[order, 1], c=density[order], cmap="viridis_r", **looks)
    else:
        ax.scatter(known[:, 0], known[:, 1], color=style.BLUE, alpha=0.8, **looks)
    left = len(values) - len(known)
    words = f"{len(known)} designs" + (f", {left} without a value" if left else "")
    if all(np.ptp(column) > 0 for column in known.T):
        linear, rank = float(np.corrcoef(along.T)[0, 1]), float(spearmanr(*known.T).statistic)
        words += f"; correlation {fixed(linear, 2, sign=True)}, of ranks {fixed(rank, 2, sign=True)}"
    ax.set_title(words, loc="left", fontsize=9)
    ax.set_xlabel(labels.get(x, x))
    ax.set_ylabel(labels.get(y, y))
    ax.set(xscale="log" if x in log else "linear", yscale="log" if y in log else "linear")
    ax.grid(True)
    return ax


def draw_parallel(
    table: pd.DataFrame,
    columns: Sequence[str],
    by: str,
    best: int,
    ax: Axes | None = None,
    labels: Mapping[str, str] = MappingProxyType({}),
    log: Collection[str] = (),
) -> Axes:
    """Draw designs as lines over parallel axes, the best ones on top.

    Parameters
    ----------
    table : DataFrame
        One row a design, the best first.
    columns : sequence of str
        One axis each, from its smallest to its largest value.
    by : str
        Column that colours the lines, the smaller the darker.
    best : int
        Designs that are drawn thick.
    ax : Axes, optional
    labels : mapping from str to str
        As in `draw_anthill`.
    log : collection of str
        Columns with a logarithmic axis.

    Raises
    ------
    InputError
        Where a column is missing.
    """
    shown = table[numeric_columns(table, [*columns, by]).notna().all(axis=1)]
    if len(shown) > MOST_LINES:
        others = np.linspace(best, len(shown) - 1, MOST_LINES - min(best, MOST_LINES)).astype(int)
        shown = shown.iloc[np.unique(np.concatenate([np.arange(min(best, MOST_LINES)), others]))]
    ax = style.own_axes(ax, 4.4)
    values = shown[list(columns)].to_numpy(dtype=float)
    along = np.log10(values, where=[name in log for name in columns], out=values.copy())
    low, high = along.min(axis=0), along.max(axis=0)
    heights = (along - low) / np.where(high > low, high - low, 1.0)
    low, high = values.min(axis=0), values.max(axis=0)
    colours = _colours(shown[by].to_numpy(dtype=float))
    places = np.arange(len(columns))
    for k in range(len(shown) - 1, -1, -1):
        thick = k < best
        ax.plot(places, heights[k], color=style.VERMILLION if thick else colours[k], linewidth=1.6 if thick else 0.5,
                alpha=1.0 if thick else 0.5, zorder=3 if thick else 1, gid=f"design {shown['design'].iloc[k]}",
                rasterized=not thick)  # fmt: skip
    for place, bottom, top in zip(places.tolist(), low, high, strict=True):
        ax.axvline(place, color=style.BLACK, linewidth=0.8)
        ax.annotate(f"{top:.4g}", (place, 1.0), (0, 3), textcoords="offset points", ha="center", fontsize=8)
        ax.annotate(f"{bottom:.4g}", (place, 0.0), (0, -11), textcoords="offset points", ha="center", fontsize=8)
    names = [labels.get(name, name) + (" (log)" if name in log else "") for name in columns]
    ax.set_xticks(places, names, rotation=35, ha="right")
    ax.tick_params(axis="x", pad=12, length=0)
    ax.set_yticks([])
    ax.set_ylim(0.0, 1.0)
    ax.spines[["left", "bottom"]].set_visible(False)
    of = f"{len(shown)} of {len(table)}" if len(shown) < len(table) else str(len(table))
    many = f"the best {best}" if best > 1 else "the best one"
    ax.set_title(f"{of} designs, darker for a smaller {by}; red: {many}", loc="left", fontsize=9, pad=16)
    return ax


def numeric_columns(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    """Columns of numbers; InputError naming one that is missing."""
    for name in columns:
        if name not in table:
            known = ", ".join(map(str, table.columns[:8]))
            raise InputError("the table of designs has no such column", place=f"column {name}",
                             remedy=f"choose among {known}, ...; --csv writes all")  # fmt: skip
    return table[list(columns)].apply(pd.to_numeric, errors="coerce")


def _density(points: np.ndarray) -> np.ndarray:
    """Relative density of points (n, 2) at each of them, from a smoothed histogram; (n,) between 0 and 1."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = np.minimum(((points - low) / np.where(high > low, high - low, 1.0) * _CELLS).astype(int), _CELLS - 1)
    counts = np.zeros((_CELLS, _CELLS))
    np.add.at(counts, tuple(cells.T), 1.0)
    smooth = gaussian_filter(counts, _SMOOTH, mode="constant")
    return np.asarray(smooth[tuple(cells.T)] / smooth.max())


def _colours(values: np.ndarray) -> np.ndarray:
    """Greys by the rank of values, the smallest the darkest."""
    rank = np.argsort(np.argsort(values, kind="stable"), kind="stable") / max(1, len(values) - 1)
    return np.repeat((0.25 + 0.6 * rank)[:, None], 3, axis=1)
