"""Figure of the worst comparisons of model and measurement, in standard deviations."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calib.report.style import AFTER, BEFORE, BLACK, REST, WITH, legend_above, own_axes, plain, stage_words
from calib.report.svg import hover

SHOWN = 15
"""Comparisons that are drawn."""
NOISE = "noise: 1 standard deviation"
"""Label of the line at 1."""
_MARKS = {"before": ("s", BEFORE), "after": ("o", AFTER), "added": ("D", WITH)}


def draw_worst(
    before: pd.DataFrame | None,
    after: pd.DataFrame | None = None,
    ax: Axes | None = None,
    *,
    added: pd.DataFrame | None = None,
    effects: str = "",
) -> Axes:
    """Draw the largest disagreements, worst first.

    Parameters
    ----------
    before, after, added, ax, effects
        As for `calib.report.comparison.draw_frequency_error`. Columns ``kind, what`` and ``in_std``, the difference of
        model and measurement in standard deviations, positive; NaN where no standard deviation is known.

    Returns
    -------
    Axes
        A mark for each stage on a logarithmic axis, joined by a line, in the order of the first stage that has a
        value; the dashed line at 1 is the average of a correctly specified model.
    """
    found = {
        stage: table.set_index([table["kind"] + " " + table["what"]])["in_std"].astype(float)
        for stage, table in (("before", before), ("after", after), ("added", added))
        if table is not None
    }
    first = pd.concat(found, axis=1).bfill(axis=1).iloc[:, 0].dropna() if found else pd.Series(dtype=float)
    names = list(first.sort_values(ascending=False, kind="stable").index[:SHOWN])
    ax = own_axes(ax, 1.3 + 0.26 * max(len(names), 1))
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    places = np.arange(len(names))
    ends = np.array([values.reindex(names).to_numpy(dtype=float) for values in found.values()])
    if len(ends) > 1:
        known = np.isfinite(ends).any(axis=0)
        ax.hlines(
            places[known], np.nanmin(ends[:, known], axis=0), np.nanmax(ends[:, known], axis=0),
            color=REST, linewidth=1.5, zorder=1,
        )  # fmt: skip
    for stage, sizes in zip(found, ends, strict=True):
        known = np.flatnonzero(sizes > 0)
        mark, colour = _MARKS[stage]
        words = stage_words(stage, effects)
        dots = ax.scatter(sizes[known], places[known], s=36, marker=mark, color=colour, label=words, zorder=3)
        hover(dots, *(f"{names[k]}, {words}: {plain(sizes[k])} standard deviations" for k in known))
    ax.axvline(1.0, color=BLACK, linestyle="--", linewidth=1.0, label=NOISE, gid="noise")
    ax.set_yticks(places, names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="both")
    ax.set_xlabel("difference of model and measurement (standard deviations)")
    legend_above(ax)
    return ax
