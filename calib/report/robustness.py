"""Figure of robustness: histograms of responses over what is known of the parameters."""

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
from calib.report.style import BLACK, BLUE, ORANGE, VERMILLION, new_panels
from calib.report.svg import hover

BOUNDS = ("least", "most")
"""Columns that may be infinite."""
NUMBERS = ("fitted", "measured", "std", "q025", "q975", *BOUNDS, "samples", "outside")
_MOST = 24
"""Histograms of one figure."""
_BINS = 24


def robustness_figure(table: pd.DataFrame, samples: pd.DataFrame) -> Figure:
    """Draw a histogram of every response over the samples; of many those with limits and those that spread most.

    Parameters
    ----------
    table : DataFrame
        ``response, unit`` and `NUMBERS`, a row for each response; NaN where unknown.
    samples : DataFrame
        A column of that name for every response.

    Returns
    -------
    Figure
        In each panel the samples, the fitted value as a black line, the measured one as a dashed line, 95 % of the
        samples as a bar below, and what is outside the limits shaded, with its share in the title.
    """
    known = table[table["response"].isin(list(samples.columns)) & (table["samples"] > 1)]
    spread = (known["std"] / known["fitted"].abs()).fillna(0.0)
    order = np.lexsort([-spread, known["outside"].isna()])[:_MOST]
    shown = known.iloc[np.sort(order)]
    figure, panels = new_panels(len(shown), 1.7, 0.9)
    for ax, row in zip(panels.flat, shown.to_dict("records"), strict=False):
        _draw(ax, row, samples[row["response"]].dropna().to_numpy(dtype=float))
    for ax in panels[:, 0]:
        ax.set_ylabel("samples", fontsize=8)
    handles: list[Artist] = [
        Patch(facecolor=BLUE, alpha=0.6, label="samples"),
        Patch(facecolor=BLUE, label="95 % of them"),
        Line2D([], [], color=BLACK, linewidth=1.0, label="fitted"),
    ]
    if shown["measured"].notna().any():
        handles.append(Line2D([], [], color=ORANGE, linestyle="--", label="measured"))
    if shown["outside"].notna().any():
        handles.append(Patch(facecolor=VERMILLION, alpha=0.2, label="outside the limits"))
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), fontsize=8)
    return figure


def _draw(ax: Any, row: dict[Any, Any], drawn: np.ndarray) -> None:
    """One panel."""
    width = float(np.ptp(drawn)) or abs(float(drawn[0])) * 1e-6 or 1e-12
    low, high = float(drawn.min()) - 0.1 * width, float(drawn.max()) + 0.1 * width
    # a line far outside the samples would squeeze them: its place is told at the edge instead
    near = [v for v in (row["fitted"], row["measured"]) if low - 2 * width < v < high + 2 * width]
    low, high = min([low, *near]), max([high, *near])
    heights, edges = np.histogram(drawn, bins=_BINS)
    bars = ax.bar(edges[:-1], heights, np.diff(edges), align="edge", color=BLUE, alpha=0.6, gid="samples")
    for bar, height, left, right in zip(bars, heights, edges[:-1], edges[1:], strict=True):
        hover(bar, f"{row['response']}: {height} samples from {significant(left)} to {significant(right)}")
    top = 1.15 * float(heights.max())
    ax.barh(-0.05 * top, row["q975"] - row["q025"], 0.06 * top, left=row["q025"], color=BLUE, gid="95 %")
    ax.axvline(row["fitted"], color=BLACK, linewidth=1.0, gid="fitted")
    ax.axvline(row["measured"], color=ORANGE, linewidth=1.3, linestyle="--", gid="measured")
    for end, far in ((row["least"], low), (row["most"], high)):
        if math.isfinite(end) and (end - low) * (far - end) * (1 if far == high else -1) >= 0:
            ax.axvspan(*sorted((end, far)), color=VERMILLION, alpha=0.2, linewidth=0, gid="outside")
    ax.set(xlim=(low, high), ylim=(-0.12 * top, top))
    unit = "" if pd.isna(row["unit"]) or row["unit"] in ("", "-") else f" ({row['unit']})"
    share = "" if pd.isna(row["outside"]) else f"\n{100 * row['outside']:.3g} % outside"
    ax.set_title(f"{row['response']}{unit}{share}", fontsize=8)
    ax.tick_params(labelsize=7)
    ax.locator_params(axis="x", nbins=3)
