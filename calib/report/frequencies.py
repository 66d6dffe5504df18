"""Frequencies of every measured mode at each stage of a calibration."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from calib.report.numbers import fixed
from calib.report.style import AFTER, BEFORE, BLACK, GREY, PURPLE, WITH, broken, in_column, own_axes, stage_words
from calib.report.svg import hover_points


class Marker(NamedTuple):
    """Marker and colour of a stage, its heading above the numbers, and its words in the legend."""

    marker: str
    colour: str
    heading: str
    words: str


STAGE_LOOKS = {
    "initial": Marker("D", PURPLE, "initial", "before any calibration"),
    "before": Marker("s", BEFORE, "before", stage_words("before")),
    "after": Marker("o", AFTER, "after", stage_words("after")),
}
"""Stages of ``modes.csv``."""


def stages_of_added(effects: str) -> dict[str, Marker]:
    """Stages of ``added_modes.csv``, where effects of these names were added."""
    return {
        "initial": Marker("s", BEFORE, "nominal", stage_words("before", effects)),
        "before": Marker("o", AFTER, "without", stage_words("after", effects)),
        "after": Marker("D", WITH, "with", stage_words("added", effects)),
    }


_WIDE, _NARROW, _GAP = 42.0, 36.0, 12.0
"""Widths of a column of frequencies and of MAC, and the gap between the two, in points."""


def draw_frequencies(table: pd.DataFrame, ax: Axes | None = None, *, looks: Mapping[str, Marker] = STAGE_LOOKS) -> Axes:
    """Draw the error of every frequency at every stage, with frequencies and MAC written beside it.

    Parameters
    ----------
    table : DataFrame
        Columns ``mode``, ``held_out`` (bool), ``freq_kind`` (``natural`` or ``damped``), ``freq_measured`` (Hz) and,
        for ``before``, ``after`` and optionally ``initial``, ``freq_`` (Hz), ``error_`` (signed fraction) and ``mac_``;
        NaN where a mode is not paired.
    ax : Axes, optional
    looks : mapping from stage to Look
        The stages that the table may have.

    Returns
    -------
    Axes
        One marker per mode and stage, in percent, with the stage as gid; the names of held-out modes are grey. In a
        column the measured frequencies alone stand beside it.
    """
    count = len(table)
    ax = own_axes(ax, 0.27 * count + 1.3)
    stages = [stage for stage in looks if f"error_{stage}" in table]
    errors = 100.0 * table[[f"error_{stage}" for stage in stages]].to_numpy(dtype=float)
    ax.axvline(0.0, color=BLACK, linewidth=0.8, zorder=1)
    for row, of_mode in enumerate(errors):
        ax.plot(of_mode, np.full(len(stages), row), color=GREY, linewidth=1.0, zorder=2)
    handles = []
    for stage, of_stage in zip(stages, errors.T, strict=True):
        look = looks[stage]
        dot: dict[str, Any] = {"linestyle": "none", "marker": look.marker, "color": look.colour, "markersize": 6}
        ax.plot(of_stage, np.arange(count), gid=stage, zorder=3, **dot)
        points = zip(table["mode"], table[f"freq_{stage}"], of_stage, strict=True)
        words = [
            f"{mode}, {look.words}: {fixed(freq, 3)} Hz, {fixed(error, 2, sign=True)} %" for mode, freq, error in points
        ]
        hover_points(ax, of_stage, np.arange(count), words)
        handles.append(Line2D([], [], label=look.words, **dot))  # no means: those are over the fitted modes alone
    held_out = table["held_out"].astype(bool).to_numpy()
    names = [f"{mode} (validation)" if held else str(mode) for mode, held in zip(table["mode"], held_out, strict=True)]
    ax.set_yticks(range(count), names)
    for label, held in zip(ax.get_yticklabels(), held_out, strict=True):
        label.set_color(GREY if held else BLACK)
    heads = {stage: looks[stage].heading for stage in stages}
    kind = f"{table['freq_kind'].iloc[0]} frequency"
    if in_column():  # of the numbers it has room for those that were measured
        heads = {}
    title = f"{kind} (Hz)" if heads else "(Hz)"
    edge = _columns(ax, table, "freq", {"measured": "measured"} | heads, title, _GAP, _WIDE)
    if heads and table[[f"mac_{stage}" for stage in stages]].notna().to_numpy().any():
        _columns(ax, table, "mac", heads, "MAC (–)", edge + _GAP, _NARROW)
    for line in range(1, count):
        ax.axhline(line - 0.5, color="#E3E3E3", linewidth=0.6)
    ax.set_ylim(count - 0.5, -0.5)
    ax.margins(x=0.08)
    ax.grid(axis="x")
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel(f"error of the {kind}, model − measured (%)")
    # In one column, so that it stays clear of the headings at the right.
    words = [broken(looks[stage].words, 24) for stage in stages]
    ax.legend(handles, words, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
    return ax


def _columns(
    ax: Axes, table: pd.DataFrame, kind: str, headings: dict[str, str], title: str, start: float, width: float
) -> float:  # fmt: skip
    """Write the columns of stages under their headings and a title, so many points beside the Axes; return the end."""
    for k, (stage, heading) in enumerate(headings.items()):
        end = start + (k + 1) * width
        _beside(ax, -0.5, heading, (end, 3.0), color=GREY, va="bottom")
        for row, value in enumerate(table[f"{kind}_{stage}"].astype(float)):
            _beside(ax, row, "–" if math.isnan(value) else f"{value:.3f}", (end, 0.0), gid=f"{kind}_{stage}")
    end = start + len(headings) * width
    _beside(ax, -0.5, title, (end, 15.0), va="bottom")
    return end


def _beside(ax: Axes, row: float, words: str, shift: tuple[float, float], va: str = "center", **looks: Any) -> None:
    """Write at the right of a row, ending at a shift in points from the corner of the Axes."""
    ax.annotate(
        words, (1.0, row), xycoords=("axes fraction", "data"), xytext=shift, textcoords="offset points", ha="right",
        va=va, fontsize=8, annotation_clip=False, **looks,
    )  # fmt: skip
