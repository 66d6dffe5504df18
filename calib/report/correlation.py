"""Figure of correlations between parameters: every pair of a few in a matrix, of many the strongest pairs as bars."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from calib.report.explanation import blank
from calib.report.numbers import counted, fixed
from calib.report.style import BLACK, BLUE, GREY, VERMILLION, bar_beside, new_figure, own_axes
from calib.report.svg import hover, hover_cells

POSTERIOR = "posterior correlation ρ (–)"
INPUTS = "rank correlation of the sampled parameters (–)"
STRONG = 0.5
"""Absolute posterior correlation from which a pair of many parameters has a bar."""
INDUCED = 0.25
"""Absolute rank correlation from which a pair of sampled parameters has a bar."""
MOST_IN_MATRIX = 8
"""Parameters up to which the posterior correlation of every pair is shown."""
_MOST_BARS = 20
_INSIDE = 0.7
"""Absolute correlation above which a bar has its value inside: beside it, it may cover the name of the pair."""


def correlated_pairs(table: pd.DataFrame) -> pd.DataFrame:
    """Return every pair of a correlation matrix once.

    Parameters
    ----------
    table : DataFrame
        Column ``parameter`` and one column per parameter, in the same order; NaN where unknown.

    Returns
    -------
    DataFrame
        ``parameter_a, parameter_b, value``, the largest absolute value first, unknown ones last.

    Raises
    ------
    ValueError
        Rows and columns do not name the same parameters.
    """
    names, values = _square(table)
    a, b = np.triu_indices(len(names), 1)
    found = pd.DataFrame(
        {"parameter_a": [names[k] for k in a], "parameter_b": [names[k] for k in b], "value": values[b, a]}
    )
    return found.sort_values("value", key=np.abs, ascending=False, kind="stable", ignore_index=True)


def strongest(table: pd.DataFrame, threshold: float) -> pd.DataFrame:
    """Return the `correlated_pairs` whose absolute value exceeds a threshold, at most 20."""
    found = correlated_pairs(table)
    return found[found["value"].abs() > threshold].head(_MOST_BARS)


def others(table: pd.DataFrame, threshold: float) -> str:
    """Describe the pairs that `strongest` leaves out; empty where there are none."""
    found = correlated_pairs(table)
    rest = found["value"].abs().iloc[len(strongest(table, threshold)) :]
    known, unknown = rest.dropna(), int(rest.isna().sum())
    words = []
    if len(known):
        which = "all" if len(rest) == len(found) else "all other"
        limit = fixed(max(threshold, float(known.max())), 2)  # more than the threshold where bars are left out
        words.append(f"{which} {counted(len(known), 'pair')}: |value| ≤ {limit}")
    return "; ".join(words + ([f"{counted(unknown, 'pair')} without a value"] if unknown else []))


def draw_correlation(
    table: pd.DataFrame, ax: Axes | None = None, *, threshold: float, label: str, most_in_matrix: int = 0
) -> Axes:
    """Draw the correlation between parameters.

    Parameters
    ----------
    table : DataFrame
        As for `correlated_pairs`.
    ax : Axes, optional
    threshold : float
        Absolute value that a pair must exceed for a bar.
    label : str
        Name of the value.
    most_in_matrix : int
        Number of parameters up to which every pair is shown, as the lower half of a matrix with the values in the
        cells.

    Returns
    -------
    Axes
        Horizontal bars of the pairs beyond the threshold, the strongest first and at most 20; words below count the
        other pairs.

    Raises
    ------
    ValueError
        Rows and columns do not name the same parameters.
    """
    if 1 < len(table) <= most_in_matrix:
        return _draw_matrix(table, ax, label)
    rows, rest = strongest(table, threshold), others(table, threshold)
    ax = own_axes(ax, 1.1 + 0.3 * max(len(rows), 1))
    if rows.empty:
        return blank(ax, rest or "no pair of parameters")
    at, values = np.arange(len(rows)), rows["value"].to_numpy(dtype=float)
    names = [f"{a}, {b}" for a, b in zip(rows["parameter_a"], rows["parameter_b"], strict=True)]
    bars = ax.barh(at, values, 0.68, color=[VERMILLION if v > 0 else BLUE for v in values])
    for row, (bar, name, value) in enumerate(zip(bars, names, values, strict=True)):
        hover(bar, f"{name}: {fixed(value, 2)}")
        inside = abs(value) > _INSIDE
        side = (1 if value > 0 else -1) * (-1 if inside else 1)
        ax.annotate(fixed(value, 2, sign=True), (value, row), xytext=(4 * side, 0), textcoords="offset points",
                    va="center", ha="left" if side > 0 else "right", fontsize=8,
                    color="white" if inside else BLACK)  # fmt: skip
    ax.axvline(0.0, color=BLACK, linewidth=0.8)
    ax.set_yticks(at, names)
    ax.tick_params(axis="y", length=0)
    # Room for the values beside bars of full length.
    ax.set(xlim=(-1.15, 1.15), ylim=(len(rows) - 0.4, -0.6), xlabel=f"{label}\n{rest}" if rest else label)
    ax.grid(axis="x")
    return ax


def _draw_matrix(table: pd.DataFrame, ax: Axes | None, label: str) -> Axes:
    """Draw the lower half of the matrix without its diagonal."""
    names, values = _square(table)
    count = len(names)
    if ax is None:
        ax = new_figure(float(np.clip(0.34 * count, 1.2, 4.0)) + 1.4).add_subplot()
    below = np.tril(np.ones((count, count), dtype=bool), -1)[1:, :-1]
    shown = np.where(below, values[1:, :-1], np.nan)
    image = ax.imshow(shown, cmap="RdBu_r", norm=Normalize(-1.0, 1.0), aspect="auto")
    for i, j in np.argwhere(below):
        colour = "white" if abs(shown[i, j]) > 0.65 else GREY if np.isnan(shown[i, j]) else BLACK
        ax.text(j, i, fixed(shown[i, j], 2), ha="center", va="center", fontsize=8.0, color=colour)
        ax.plot([j - 0.5, j + 0.5, j + 0.5, j - 0.5, j - 0.5], [i - 0.5, i - 0.5, i + 0.5, i + 0.5, i - 0.5],
                color="#D0D0D0", linewidth=0.6, clip_on=False)  # fmt: skip
    hover_cells(
        ax,
        [[f"{names[i + 1]}, {names[j]}: {fixed(shown[i, j], 2)}" for j in range(i + 1)] for i in range(count - 1)],
    )
    ax.set_xticks(range(count - 1), names[:-1], rotation=90 if count > 4 else 0)
    ax.set_yticks(range(count - 1), names[1:])
    ax.set(xlim=(-0.5, count - 1.5), ylim=(count - 1.5, -0.5))
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    bar_beside(ax, image, label, aspect=25)
    return ax


def _square(table: pd.DataFrame) -> tuple[list[str], np.ndarray]:
    names = table["parameter"].astype(str).tolist()
    if [c for c in table.columns if c != "parameter"] != names:
        raise ValueError("rows and columns do not name the same parameters")
    return names, table[names].to_numpy(dtype=float)
