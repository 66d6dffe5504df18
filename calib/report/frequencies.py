"""Damped frequencies of every measured mode before and after a calibration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from calib.report.style import AFTER, BEFORE, BLACK, GREY, own_axes

_COLUMNS = (
    ("damped_freq_measured", "measured", "{:.3f}", 52),
    ("damped_freq_before", "before", "{:.3f}", 92),
    ("damped_freq_after", "after", "{:.3f}", 132),
    ("mac_before", "before", "{:.3f}", 176),
    ("mac_after", "after", "{:.3f}", 212),
)
"""Column of the table, its heading, how it is written, and where it ends, in points from the Axes."""


def draw_frequencies(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the error of every damped frequency before and after, and write frequencies and MAC beside it.

    Parameters
    ----------
    table : DataFrame
        Columns ``mode``, ``withheld`` (bool), ``damped_freq_measured, damped_freq_before, damped_freq_after`` (Hz),
        ``error_before, error_after`` (signed fractions), ``mac_before, mac_after``; NaN where a mode is not paired.
    ax : Axes, optional

    Returns
    -------
    Axes
        A dot a mode and stage with the gids ``before`` and ``after``, in percent; the names of withheld modes are grey.
    """
    count = len(table)
    ax = own_axes(ax, 0.27 * count + 1.2)
    rows = np.arange(count)
    errors = {stage: 100.0 * table[f"error_{stage}"].to_numpy(dtype=float) for stage in ("before", "after")}
    ax.hlines(rows, errors["before"], errors["after"], color=GREY, linewidth=1.0, zorder=2)
    ax.axvline(0.0, color=BLACK, linewidth=0.8, zorder=1)
    for stage, colour, marker in (("before", BEFORE, "s"), ("after", AFTER, "o")):
        ax.plot(errors[stage], rows, marker, color=colour, markersize=6, gid=stage, zorder=3)
    withheld = table["withheld"].astype(bool).to_numpy()
    names = [f"{mode} (withheld)" if held else str(mode) for mode, held in zip(table["mode"], withheld, strict=True)]
    ax.set_yticks(rows, names)
    for label, held in zip(ax.get_yticklabels(), withheld, strict=True):
        label.set_color(GREY if held else BLACK)
    for column, heading, number, x in _COLUMNS:
        _beside(ax, -0.5, heading, (x, 3.0), color=GREY, va="bottom")
        for row, value in enumerate(table[column].astype(float)):
            _beside(ax, row, "–" if math.isnan(value) else number.format(value), (x, 0.0), gid=column)
    for x, words in ((132, "damped frequency (Hz)"), (212, "MAC (–)")):
        _beside(ax, -0.5, words, (x, 15.0), va="bottom")
    for line in range(1, count):
        ax.axhline(line - 0.5, color="#E3E3E3", linewidth=0.6)
    ax.set_ylim(count - 0.5, -0.5)
    ax.margins(x=0.08)
    ax.grid(axis="x")
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("error of the damped frequency, model − measured (%)")
    means = {stage: np.nanmean(np.abs(e)) if np.isfinite(e).any() else math.nan for stage, e in errors.items()}
    handles = [
        Line2D([], [], linestyle="none", color=colour, marker=marker, markersize=6, label=f"{stage}: mean |error| "
               + ("unknown" if math.isnan(means[stage]) else f"{means[stage]:.1f} %"))
        for stage, colour, marker in (("before", BEFORE, "s"), ("after", AFTER, "o"))
    ]  # fmt: skip
    # In one column, so that it stays clear of the headings at the right.
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    return ax


def _beside(ax: Axes, row: float, words: str, shift: tuple[float, float], va: str = "center", **looks: Any) -> None:
    """Write at the right of a row, ending at a shift in points from the corner of the Axes."""
    ax.annotate(
        words, (1.0, row), xycoords=("axes fraction", "data"), xytext=shift, textcoords="offset points", ha="right",
        va=va, fontsize=8, annotation_clip=False, **looks,
    )  # fmt: skip
