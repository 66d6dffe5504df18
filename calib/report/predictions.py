"""Figure of the predictions of held-out data, with and without an unexplained misfit."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report.explanation import blank
from calib.report.numbers import flag, significant
from calib.report.style import AFTER, BLACK, GREY, SKY, VERMILLION, legend_above, own_axes
from calib.report.svg import hover
from calib.report.verification import GROUPS

NUMBERS = ["value", "predicted", "low", "high", "low_unexplained", "high_unexplained"]
"""Columns of numbers of ``unexplained_predictions.csv``."""
_MOST = 240
"""Values in one figure."""
_LINEAR = 4.0
"""Distance, in half intervals, from which the axis is logarithmic."""


def draw_predictions(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw measured held-out values between the intervals of their predictions.

    Parameters
    ----------
    table : DataFrame
        Columns ``group, mode, sensor, kind, part`` (of FRFs ``freq``), `NUMBERS` and ``inside_unexplained`` (bool).
    ax : Axes, optional

    Returns
    -------
    Axes
        One dot per measured value at its distance from the prediction of the fit, over the half interval of the fit
        alone, so that a grey band from -1 to 1 is this interval; behind it a bar, the interval with the unexplained
        misfit. Dots outside their bar are red. Groups stand side by side; of many values evenly spaced ones.
    """
    ax = own_axes(ax, 3.8)
    if table.empty:
        return blank(ax, "there are no validation data")
    table = table[np.isfinite(table[NUMBERS].to_numpy(float)).all(axis=1)]
    if table.empty:
        return blank(ax, "no prediction has a finite interval")
    step = -(-len(table) // _MOST)
    parts = [own.iloc[::step] for _, own in table.groupby("group", sort=False)]
    shown = pd.concat(parts, ignore_index=True)
    x = np.arange(len(shown))
    low, high = (_distance(shown, f"{end}_unexplained") for end in ("low", "high"))
    value = _distance(shown, "value")
    inside = np.array([flag(one) for one in shown["inside_unexplained"]])
    ax.axhspan(-1.0, 1.0, color="#D9D9D9", zorder=1, gid="alone")
    bars = ax.vlines(x, low, high, color=SKY, linewidth=max(1.0, 3.6 - len(x) / 60), zorder=2, gid="unexplained")
    hover(bars, *_words(shown))
    for group, color, gid in ((inside, AFTER, "inside"), (~inside, VERMILLION, "outside")):
        ax.plot(x[group], value[group], "o", color=color, markersize=3.5, zorder=4, gid=gid)
    ax.axhline(0.0, color=GREY, linewidth=0.8, zorder=3)
    ends = np.cumsum([len(one) for one in parts])
    for end in ends[:-1]:
        ax.axvline(end - 0.5, color=BLACK, linewidth=0.8)
    names = [str(one["group"].iloc[0]) for one in parts]
    middles = ends - np.array([len(one) for one in parts]) / 2 - 0.5
    ax.set_xticks(middles, [textwrap.fill(GROUPS.get(name, name), 18) for name in names])
    ax.set_xlim(-0.8, len(shown) - 0.2)
    scale = ""
    if np.abs(np.concatenate([low, high, value])).max() > 5 * _LINEAR:
        ax.set_yscale("symlog", linthresh=_LINEAR)
        ax.yaxis.set_major_formatter("{x:g}")
        scale = f" (linear up to {_LINEAR:g})"
    less = f"; one value in {step} is shown" if step > 1 else ""
    ax.set_ylabel(f"measured less predicted value,\nin half intervals of the fit alone{scale}")
    ax.set_xlabel(f"validation values{less}")
    ax.tick_params(axis="x", length=0)
    handles = [
        Patch(color="#D9D9D9", label="95 % interval of the fit alone"),
        Patch(color=SKY, label="with the unexplained misfit"),
        Line2D([], [], linestyle="none", marker="o", color=AFTER, label="measured"),
    ]
    if not inside.all():
        handles.append(Line2D([], [], linestyle="none", marker="o", color=VERMILLION, label="measured, outside"))
    legend_above(ax, list(handles))
    return ax


def _distance(table: pd.DataFrame, column: str) -> np.ndarray:
    """Distance of a column from the prediction, over the half interval of the fit alone on that side."""
    away = (table[column] - table["predicted"]).to_numpy(dtype=float)
    above, below = (table["high"] - table["predicted"], table["predicted"] - table["low"])
    return away / np.where(away >= 0, above, below)


def _words(table: pd.DataFrame) -> list[str]:
    """What each bar tells under the mouse."""
    out = []
    for r in table.to_dict("records"):
        freq = f"{float(r['freq']):.4g} Hz" if r.get("freq") else ""
        what = " ".join(filter(None, (str(r[name]) for name in ("mode", "kind", "sensor", "part")))) + f" {freq}"
        ends = [
            f"[{significant(r[f'low{end}'], 4)}, {significant(r[f'high{end}'], 4)}]" for end in ("", "_unexplained")
        ]
        out.append(
            f"{what.strip()}: measured {significant(r['value'], 4)}, predicted {significant(r['predicted'], 4)} "
            f"{ends[0]}; with the unexplained misfit {ends[1]}"
        )
    return out
