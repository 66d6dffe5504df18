"""Figure of the worst comparisons of model and measurement, in standard deviations."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calib.report.style import AFTER, BEFORE, BLACK, REST, legend_above, own_axes, plain
from calib.report.svg import hover

SHOWN = 15
"""Comparisons that are drawn."""
_MARKS = {"before": ("o", BEFORE), "after": ("D", AFTER)}


def draw_worst(before: pd.DataFrame | None, after: pd.DataFrame | None = None, ax: Axes | None = None) -> Axes:
    """Draw the largest disagreements, worst first.

    Parameters
    ----------
    before, after : DataFrame, optional
        Columns ``kind, what`` and ``in_std``, the difference of model and measurement in standard deviations, positive;
        NaN where no standard deviation is known.
    ax : Axes, optional

    Returns
    -------
    Axes
        A mark for each stage on a logarithmic axis, joined by a line; the dashed line at 1 is the average of a
        correctly specified model.
    """
    found = {
        stage: table.set_index([table["kind"] + " " + table["what"]])["in_std"].astype(float)
        for stage, table in (("before", before), ("after", after))
        if table is not None
    }
    first = next(iter(found.values()), pd.Series(dtype=float)).dropna()
    names = list(first.sort_values(ascending=False, kind="stable").index[:SHOWN])
    ax = own_axes(ax, 1.3 + 0.26 * max(len(names), 1))
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    places = np.arange(len(names))
    ends = np.array([values.reindex(names).to_numpy(dtype=float) for values in found.values()])
    if len(ends) > 1:
        ax.hlines(places, ends.min(axis=0), ends.max(axis=0), color=REST, linewidth=1.5, zorder=1)
    for stage, sizes in zip(found, ends, strict=True):
        known = np.flatnonzero(sizes > 0)
        mark, colour = _MARKS[stage]
        dots = ax.scatter(
            sizes[known], places[known], s=36, marker=mark, color=colour, label=f"{stage} calibration", zorder=3
        )
        hover(dots, *(f"{names[k]}, {stage}: {plain(sizes[k])} standard deviations" for k in known))
    ax.axvline(1.0, color=BLACK, linestyle="--", linewidth=1.0)
    ax.set_yticks(places, names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="both")
    ax.set_xlabel("difference of model and measurement (standard deviations)")
    legend_above(ax)
    return ax
