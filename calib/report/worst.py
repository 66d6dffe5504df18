"""The largest disagreements of a model and a measurement, from stage to stage, and what has grown."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calib.report import style
from calib.report.comparison import MARKS, by_stage
from calib.report.svg import hover

SHOWN = 15
"""Comparisons that are drawn."""
_MUCH = 1.1
"""Ratio beyond which a comparison has grown."""
_GROWN = 5
"""Further ones, of those that have grown."""
NOISE = "noise: 1 standard deviation"
"""Label of the line at 1."""


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
        value; the dashed line at 1 is the average of a correctly specified model. Below a line the largest of what has
        grown beyond 1 in the last stage; what has joins in red.
    """
    stages = {"before": before, "after": after, "added": added}
    named = {k: None if t is None else t.assign(name=t["kind"] + " " + t["what"]) for k, t in stages.items()}
    found = {stage: table["in_std"].astype(float) for stage, table in by_stage(named, "name").items()}
    every = pd.DataFrame(found).dropna(how="all")
    largest = list(every.bfill(axis=1).iloc[:, 0].sort_values(ascending=False, kind="stable").index[:SHOWN])
    # What the last model has made worse shows too, wherever it stood before.
    grown = every.iloc[:, -1][_has_grown(every.to_numpy()) & ~every.index.isin(largest)]
    names = [*largest, *grown.sort_values(ascending=False, kind="stable").index[:_GROWN]]
    ax = style.own_axes(ax, 1.3 + 0.26 * max(len(names), 1))
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    places = np.arange(len(names))
    ends = every.loc[names].to_numpy().T
    if len(ends) > 1:
        known = np.isfinite(ends).any(axis=0)
        ax.hlines(
            places[known], np.nanmin(ends[:, known], axis=0), np.nanmax(ends[:, known], axis=0),
            color=np.where(_has_grown(ends[:, known].T), style.VERMILLION, style.REST), linewidth=1.5, zorder=1,
        )  # fmt: skip
    if len(names) > len(largest):
        ax.axhline(len(largest) - 0.5, color=style.GREY, linewidth=0.8, gid="grown")
        ax.text(0.99, len(largest) - 0.45, "below: grown", transform=ax.get_yaxis_transform(), ha="right", va="top",
                fontsize=7.5, color=style.GREY)  # fmt: skip
    for stage, sizes in zip(found, ends, strict=True):
        known = np.flatnonzero(sizes > 0)
        mark, colour = MARKS[stage]
        words = style.stage_words(stage, effects)
        dots = ax.scatter(sizes[known], places[known], s=36, marker=mark, color=colour, label=words, zorder=3)
        hover(dots, *(f"{names[k]}, {words}: {style.plain(sizes[k])} standard deviations" for k in known))
    ax.axvline(1.0, color=style.BLACK, linestyle="--", linewidth=1.0, label=NOISE, gid="noise")
    ax.set_yticks(places, names)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(axis="both")
    ax.set_xlabel("difference of model and measurement (standard deviations)")
    style.legend_above(ax)
    return ax


def _has_grown(sizes: np.ndarray) -> np.ndarray:
    """Whether each row (n, n_stages) exceeds 1 in its last stage, and by a tenth what it was before, (n,)."""
    return (
        (sizes[:, -1] > np.fmax(_MUCH * sizes[:, -2], 1.0)) if sizes.shape[1] > 1 else np.zeros(len(sizes), dtype=bool)
    )
