"""Figure of a Pareto front: two errors against each other, the knee, the fit, and the weights of the objective."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from calib.report.numbers import significant
from calib.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION, own_axes
from calib.report.svg import hover_points

MARKS: dict[str, dict[str, Any]] = {
    "knee": {"marker": "D", "color": GREEN, "markersize": 8, "label": "knee"},
    "lowest": {"marker": "s", "color": ORANGE, "markersize": 8, "label": "lowest objective of the search"},
    "fit": {"marker": "*", "color": VERMILLION, "markersize": 13, "label": "fit by least squares"},
}
_BEYOND = 0.06
"""Margin of the axes, over the range of what is drawn."""


def draw_pareto(table: pd.DataFrame, objectives: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the front of two objectives.

    Parameters
    ----------
    table : DataFrame
        ``kind`` ("front" or "least squares"), ``design, first, second, objective, knee, lowest``.
    objectives : DataFrame
        ``name, of`` ("error" or "1 - MAC"), ``weight``: the two, in the order of the axes.
    ax : Axes, optional

    Returns
    -------
    Axes
        The front as a stepped line through its designs: what lies above it is reached. The dashed line joins points of
        the objective that the best design has, by the weights of a search.
    """
    ax = own_axes(ax, 4.2)
    scales = [1.0 if of == "1 - MAC" else 100.0 for of in objectives["of"]]
    points = table[["first", "second"]].to_numpy(dtype=float) * scales
    front, fit = (table["kind"] == "front").to_numpy(), (table["kind"] == "least squares").to_numpy()
    ax.plot(*points[front].T, drawstyle="steps-post", color=BLUE, linewidth=0.9, alpha=0.6)
    ax.plot(*points[front].T, "o", color=BLUE, markersize=4.5, label="front", gid="front")
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _BEYOND * np.where(high > low, high - low, np.maximum(high, 1e-12))
    (best,) = points[table["lowest"].to_numpy(dtype=bool)]
    slopes = objectives["weight"].to_numpy(dtype=float) / scales
    if slopes[1] > 0:
        along = np.array([low[0] - margin[0], high[0] + margin[0]])
        words = " : ".join(f"{weight:g}" for weight in objectives["weight"])
        ax.plot(along, best[1] - slopes[0] / slopes[1] * (along - best[0]), "--", color=GREY, linewidth=1.0,
                label=f"equal objective, weights {words}", gid="weights")  # fmt: skip
    for name, rows in (("lowest", table["lowest"]), ("knee", table["knee"]), ("fit", fit)):
        for point in points[np.asarray(rows, dtype=bool)]:
            ax.plot(*point, linestyle="", markeredgecolor=BLACK, markeredgewidth=0.7, zorder=3, gid=name, **MARKS[name])
    ax.set_xlim(low[0] - margin[0], high[0] + margin[0])
    ax.set_ylim(low[1] - margin[1], high[1] + margin[1])
    for axis, row in zip((ax.xaxis, ax.yaxis), objectives.to_dict("records"), strict=True):
        axis.set_label_text(f"{row['name']}: mean {'of 1 − MAC' if row['of'] == '1 - MAC' else 'error (%)'}")
    names = [
        f"{name} {{}}{'' if scale == 1.0 else ' %'}" for name, scale in zip(objectives["name"], scales, strict=True)
    ]
    told = [
        f"design {design}: " + ", ".join(form.format(significant(v)) for form, v in zip(names, point, strict=True))
        for design, point in zip(table["design"], points, strict=True)
    ]
    hover_points(ax, points[:, 0], points[:, 1], told)
    ax.grid(True)
    ax.legend(loc="upper right", fontsize=8)
    return ax
