"""Figure of profile likelihoods: one panel a parameter."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report.numbers import significant
from calib.report.style import BLACK, BLUE, GREY, VERMILLION, new_panels
from calib.report.svg import hover_points

_TOP = 4.0
"""Largest root of the rise that is drawn, in standard deviations."""


def profiles_figure(curves: pd.DataFrame, intervals: pd.DataFrame) -> Figure:
    """Draw the root of the rise of the sum of squares along each parameter, all others fitted.

    Parameters
    ----------
    curves : DataFrame
        ``parameter, value, rise, rise_data, interval_at``, a row for each point.
    intervals : DataFrame
        ``parameter, unit, value, lower, upper, linear_lower, linear_upper``; NaN for a side that nothing excludes.

    Returns
    -------
    Figure
        In each panel a blue line with the prior and a grey one from the data alone: straight lines to both sides where
        the model is linear. Between the crossings of the dashed level lies the interval of 95 %, drawn on the axis; the
        open bar below it is the linearised one.
    """
    names = list(dict.fromkeys(curves["parameter"]))
    figure, panels = new_panels(len(names), 1.75, 0.8)
    known = intervals.set_index("parameter")
    for ax, name in zip(panels.flat, names, strict=False):
        own, row = curves[curves["parameter"] == name], known.loc[name]
        at, level = own["value"].to_numpy(dtype=float), math.sqrt(float(own["interval_at"].iloc[0]))
        for column, color, gid, width in (("rise_data", GREY, "data alone", 1.2), ("rise", BLUE, "with prior", 1.6)):
            root = np.sqrt(own[column].to_numpy(dtype=float))
            ax.plot(at, root, "-", color=color, linewidth=width, marker=".", markersize=4, gid=gid)
        ax.axhline(level, color=BLACK, linewidth=0.8, linestyle="--")
        ax.axvline(float(row["value"]), color=BLACK, linewidth=0.6)
        ends = at.min(), at.max()
        for pair, height, face in (
            (("lower", "upper"), -0.28, VERMILLION),
            (("linear_lower", "linear_upper"), -0.58, "white"),
        ):
            inside = [float(row[key]) if math.isfinite(row[key]) else end for key, end in zip(pair, ends, strict=True)]
            ax.barh(height, inside[1] - inside[0], 0.2, inside[0], facecolor=face, edgecolor=VERMILLION, linewidth=0.8)
        unit = "" if row["unit"] == "-" else f" ({row['unit']})"
        ax.set_title(f"{name}{unit}", fontsize=8)
        ax.set_ylim(-0.8, _TOP)
        ax.tick_params(labelsize=7)
        ax.locator_params(axis="x", nbins=3)
        words = [
            f"{name} = {significant(v)}: sum of squares higher by {r:.3g}" for v, r in zip(at, own["rise"], strict=True)
        ]
        hover_points(ax, at, np.sqrt(own["rise"].to_numpy(dtype=float)), words)
    line: dict[str, Any] = {"marker": ".", "markersize": 4}
    handles: list[Artist] = [
        Line2D([], [], color=BLUE, label="with the prior", **line),
        Line2D([], [], color=GREY, label="data alone", **line),
        Patch(facecolor=VERMILLION, label="95 % interval"),
        Patch(facecolor="white", edgecolor=VERMILLION, label="linearised interval"),
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), fontsize=8)
    for ax in panels[:, 0]:
        ax.set_ylabel("root of the rise (σ)", fontsize=8)
    return figure
