"""Figures of sensitivity: matrix, and selection of parameters."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import blended_transform_factory

from calib.report.numbers import fixed, significant, with_unit
from calib.report.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    SKY,
    bar_beside,
    in_column,
    legend_above,
    matrix_height,
    own_axes,
    separate_cells,
)
from calib.report.svg import hover, hover_cells

RESPONSE_KINDS = {
    "natural_freq_": "natural frequency",
    "damped_freq_": "damped frequency",
    "damping_ratio_": "damping ratio",
    "emac_": "EMAC",
    "mac_": "MAC",
    "frac ": "FRAC",
    "amplitude ": "amplitude of FRFs",
}
"""Prefix of a response's name, and the heading of its group of columns."""
_OF_MODES = "_"
"""End of the prefixes of a mode's responses."""


def draw_sensitivity(
    table: pd.DataFrame,
    ax: Axes | None = None,
    threshold: float = 0.25,
    label: str = "rank correlation (–)",
    *,
    signed: bool = True,
    space: pd.DataFrame | None = None,
    partial: pd.DataFrame | None = None,
) -> Axes:
    """Draw the sensitivity of responses to parameters as a matrix, after Ribeiro et al. (2013), figure 7.

    Parameters
    ----------
    table : DataFrame
        Column ``parameter`` and one column for every response, such as ``natural_freq_1BT`` or ``mac_1BT``; cells are
        -1 to 1, or NaN for a response that never changes.
    ax : Axes, optional
    threshold : float
        Cells whose absolute value does not exceed it stay blank.
    label : str
        Label of the colour bar.
    signed : bool
        Whether values have a sign; the scale of others begins at 0.
    space : DataFrame, optional
        Columns ``parameter, unit, lower, upper``: the range over which each was varied, beside its name. A wide one
        outranks a narrow one of more effect.
    partial : DataFrame, optional
        The same cells, controlled for all other parameters. A value above the threshold whose own is at most half of
        it, or of the other sign, stands in brackets: other parameters lend it, which a constraint or prior correlates.
    """
    responses = [c for c in table.columns if c != "parameter"]
    kinds = list(dict.fromkeys(_kind(r)[0] for r in responses))
    responses.sort(key=lambda r: kinds.index(_kind(r)[0]))
    values = table[responses].to_numpy(dtype=float)
    rows, columns = values.shape
    ax = own_axes(ax, matrix_height(rows, columns) + 0.3)
    shown = np.where(np.abs(values) > threshold, values, np.nan)
    image = ax.imshow(np.isnan(values), cmap="Greys", norm=Normalize(0.0, 7.0), aspect="auto")
    colours, lowest = ("RdBu_r", -1.0) if signed else ("Blues", 0.0)
    image = ax.imshow(shown, cmap=colours, norm=Normalize(lowest, 1.0), aspect="auto")
    lent = np.zeros_like(values, dtype=bool)
    if partial is not None:
        own = partial.set_index("parameter").reindex(table["parameter"]).reindex(columns=responses)
        lent = own.to_numpy(dtype=float) * np.sign(values) <= 0.5 * threshold
    size = float(np.clip(8.0 * 13.0 / columns, 4.5, 8.0))
    for i, j in np.argwhere(np.isfinite(shown)):
        colour = "white" if abs(shown[i, j]) > 0.65 else "black"
        text = f"{shown[i, j]:.2f}".replace("-", "−")
        # Of seven letters for five: no wider than the others.
        words, own_size = (f"({text.replace('0.', '.')})", 0.9 * size) if lent[i, j] else (text, size)
        ax.text(j, i, words, ha="center", va="center", fontsize=own_size, color=colour)
    names = [_kind(r)[1] for r in responses]
    ax.set_xticks(range(columns), names, rotation=90 if columns > 10 or max(map(len, names)) > 7 else 0)
    # The names alone in a column: the ranges stand in parameter_space.csv.
    ranges = {} if space is None or in_column() else {str(r["parameter"]): _range(r) for r in space.to_dict("records")}
    ax.set_yticks(range(rows), [p + ranges.get(p, "") for p in table["parameter"].astype(str)])
    hover_cells(
        ax,
        [
            [f"{p}, {' '.join(_kind(r))}: {fixed(v, 2)}" for r, v in zip(responses, row, strict=True)]
            for p, row in zip(table["parameter"], values, strict=True)
        ],
    )
    separate_cells(ax, rows, columns)
    ax.grid(which="minor", color="#D0D0D0", linewidth=0.6)
    _name_groups(ax, [_kind(r)[0] for r in responses])
    blank = f"blank: |value| ≤ {threshold:g}" + ("; grey: no value" if np.isnan(values).any() else "")
    if (lent & np.isfinite(shown)).any():
        blank += ";\nin brackets: lent by other parameters, through a constraint or prior"
    modal = any(r.startswith(prefix) for r in responses for prefix in RESPONSE_KINDS if prefix.endswith(_OF_MODES))
    ax.set_xlabel(f"{'response of mode' if modal else 'response'} ({blank})")
    bar_beside(ax, image, label)
    return ax


def _range(row: Mapping[Hashable, Any]) -> str:
    """The limits of a parameter, in words."""
    low, high = float(row["lower"]), float(row["upper"])
    if not low < high:
        return ""
    return f"  {significant(low, 3)} – {with_unit(high, str(row['unit']))}"


MEASURES = {
    "spearman": ("Spearman's rank correlation", SKY),
    "partial": ("partial rank correlation", ORANGE),
    "variance_share": ("variance share (square root)", BLUE),
}
"""Measure, its name in the legend, and its colour."""


def draw_selection(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the largest value of each measure for every parameter, its noise floor, and the selection.

    Parameters
    ----------
    table : DataFrame
        Columns ``parameter``, ``max_spearman``, ``max_partial``, ``max_variance_share`` (drawn as absolute values),
        the noise floor of each (``spearman_floor`` and so on), and the flags ``measured`` and ``selected``. A value
        below its floor is drawn hollow, an unknown one not at all.
    ax : Axes, optional
    """
    count, height = len(table), 0.26
    ax = own_axes(ax, 0.42 * count + 1.0)
    rows = np.arange(count)
    for k, (measure, (label, colour)) in enumerate(MEASURES.items()):
        size = np.abs(table[f"max_{measure}"].to_numpy(dtype=float))
        floor = table[f"{measure}_floor"].to_numpy(dtype=float)
        at = rows + (k - 1) * height
        passed = size >= floor
        bars = ax.barh(
            at, size, 0.86 * height, color=[colour if p else "white" for p in passed], edgecolor=colour, lw=0.9
        )
        for bar, name, value, least in zip(bars, table["parameter"], size, floor, strict=True):
            hover(bar, f"{name}, {label}: {fixed(value, 2)} (noise floor {fixed(least, 2)})")
        at, floor = at[np.isfinite(floor)], floor[np.isfinite(floor)]
        ax.vlines(floor, at - 0.5 * height, at + 0.5 * height, color=BLACK, linewidth=1.3)
    for row, (measured, selected) in enumerate(zip(table["measured"], table["selected"], strict=True)):
        words = ("selected" if measured else "kept by the study") if selected else ""
        words = words or ("left out by the study" if measured else "–")
        ax.text(1.02, row, words, va="center", fontsize=8.5, color=BLACK if selected else GREY)
        if row:
            ax.axhline(row - 0.5, color="#E3E3E3", linewidth=0.6)
    ax.set_yticks(rows, table["parameter"].astype(str))
    ax.tick_params(axis="y", length=0)
    ax.set(ylim=(count - 0.5, -0.5), xlim=(0.0, 1.0), xlabel="largest absolute value over all responses (–)")
    ax.grid(axis="x")
    handles = [Patch(facecolor=colour, edgecolor=colour, label=label) for label, colour in MEASURES.values()]
    floor_mark = Line2D([], [], color=BLACK, marker="|", linestyle="", markersize=9, label="noise floor (hollow below)")
    legend_above(ax, [*handles, floor_mark])
    return ax


def _name_groups(ax: Axes, kinds: list[str]) -> None:
    """Write the kind of response above each group of columns, where they are known, and a line between the groups."""
    if set(kinds) == {_OTHER}:
        return
    above = blended_transform_factory(ax.transData, ax.transAxes)
    start = 0
    for kind, members in groupby(kinds):
        end = start + len(list(members))
        ax.plot([start - 0.4, end - 0.6], [1.012, 1.012], transform=above, color="black", linewidth=1.2, clip_on=False)
        ax.annotate(
            kind,
            ((start + end - 1) / 2, 1.012),
            xycoords=above,
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            va="bottom",
        )
        if start:
            ax.axvline(start - 0.5, color="black", linewidth=1.2)
        start = end


_OTHER = "other"
"""Group of responses of no known kind."""


def _kind(response: str) -> tuple[str, str]:
    """Group and mode of a response."""
    for beginning, kind in RESPONSE_KINDS.items():
        if response.startswith(beginning):
            return kind, response.removeprefix(beginning)
    return _OTHER, response
