"""Figures of prediction errors with and without the missing effect, and of recommended measurements."""

from __future__ import annotations

import re
import textwrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report import style
from calib.report.explanation import LEAST_BAYES_FACTOR, blank
from calib.report.numbers import fixed, p_in_words, short
from calib.report.rows import name_rows, row_edges, rows_height, run_on
from calib.report.svg import hover, hover_points
from calib.results.answer import in_prose

GROUPS = {
    "fit": "used in the fit",
    "left_out": "left out in turn (leave-one-out)",
    "held_out_sensors": "validation sensors",
    "held_out_modes": "validation modes",
    "held_out_responses": "validation responses",
    "held_out_references": "validation references",
    "held_out_bands": "validation bands",
}
_STAGES: dict[str, dict[str, Any]] = {
    "before": {"color": style.AFTER, "marker": "o"},
    "after": {"color": style.WITH, "marker": "D"},
    "attempt": {"color": style.GREY, "marker": "X"},
}
_KINDS = {
    "sensor": ("further sensor", style.SKY),
    "mode": ("further mode", style.ORANGE),
    "reference": ("further force", style.AFTER),
    "held out": ("validation data", style.YELLOW),
    "repeats": ("more repeats", style.GREEN),
    "bench": ("bench test", style.PURPLE),
}
STEP_ERRORS = "error_by_step"
"""Name of the figure of `draw_error_steps`."""
WORTHWHILE = 1.2
"""Gain from which a measurement is recommended."""
_MEASURED = ", validation data so far"
"""End of the name of a measurement that there is already."""
_RANGE = 20.0
"""Ratio of the largest to the smallest error above which the axis is logarithmic."""
_SHOWN = 10
_WORDS = 30.0
"""Height in points of the two lines of an error and the gap to its dot."""
_UPRIGHT = 65.0
"""The same of upright words."""


def draw_errors(table: pd.DataFrame, ax: Axes | None = None, *, name: str = "") -> Axes:
    """Draw the error before and after adding an effect, in data used in the fit and in data held out.

    Parameters
    ----------
    table : DataFrame
        Columns ``group, stage`` (``before``, ``after``, or ``attempt`` for an effect that is not believed), ``rms``
        (sigma), ``expected`` (for a correctly specified model, sigma) and ``p``; NaN where unknown.
    ax : Axes, optional
    name : str
        Names of the added effects; empty when unknown.

    Returns
    -------
    Axes
        Dots at the rms, of which a thin line joins those of a group, and a black line at the expected value;
        logarithmic when errors differ by a factor above 20.
    """
    groups = _groups(table)
    ax = style.own_axes(ax, 3.6)
    letters, room = (11, 1.9) if style.in_column() else (18, 1.2)
    if not groups:
        return blank(ax, "no error is known")
    stages = [stage for stage in _STAGES if (table["stage"] == stage).any()]
    width = 0.76 / len(stages)
    handles: list[Artist] = []
    ends: list[tuple[np.ndarray, np.ndarray]] = []
    told: list[tuple[np.ndarray, ...]] = []
    for k, stage in enumerate(stages):
        rows = table[table["stage"] == stage].set_index("group").reindex(groups)
        x = np.arange(len(groups)) + (k - (len(stages) - 1) / 2) * width
        rms, expected, p = (rows[name].to_numpy(dtype=float) for name in ("rms", "expected", "p"))
        looks = _STAGES[stage]
        label = style.added("base" if stage == "before" else stage, name)
        ends.append((x, rms))
        (dots,) = ax.plot(x, rms, linestyle="none", markersize=9, label=label, gid=stage, zorder=5, **looks)
        words = [
            f"{GROUPS.get(group, group)}, {label}: {fixed(r, 2)} σ; expected {fixed(e, 2)}; p {p_in_words(q)}"
            for group, r, e, q in zip(groups, rms, expected, p, strict=True)
        ]
        hover_points(ax, x, rms, words)
        told.append((x, rms, expected, p))
        floor = np.isfinite(expected)
        reach = (x[floor] - 0.4 * width, x[floor] + 0.4 * width)
        ax.hlines(expected[floor], *reach, color=style.BLACK, linewidth=1.6, gid=f"expected {stage}", zorder=4)
        handles.append(dots)
    if len(ends) == 2:
        (x_first, first), (x_last, last) = ends
        ax.plot([x_first, x_last], [first, last], color=style.REST, linewidth=1.2, zorder=2)
    handles.append(Line2D([], [], color=style.BLACK, linewidth=1.6, label="expected for a correct model"))
    _scale(ax, table, room)
    for values in told:
        _write_errors(ax, *values)
    ax.set_xticks(range(len(groups)), [textwrap.fill(GROUPS.get(g, g), letters) for g in groups])
    ax.set_xlim(-0.6, len(groups) - 0.4)
    ax.grid(axis="y")
    ax.set_ylabel("rms error (σ)")
    style.legend_above(ax, handles)
    return ax


def _write_errors(ax: Axes, x: np.ndarray, rms: np.ndarray, expected: np.ndarray, p: np.ndarray) -> None:
    """Write each error above its dot, and clear of the line of the expected value: below the dot, or over the line.

    In a column, where groups are narrow, the words stand upright.
    """
    for at, r, e, q in zip(x, rms, expected, p, strict=True):
        if np.isfinite(r):
            own, line = (float(ax.transData.transform((at, v))[1]) for v in (r, e if np.isfinite(e) else r))
            foot = float(ax.transAxes.transform((0.0, 0.0))[1])
            below, above = ((one - two) * 72.0 / ax.figure.dpi for one, two in ((own, foot), (line, own)))
            words, upright = _error_words(r, q), style.in_column()
            crossed = 0.0 < above < (_UPRIGHT if upright else _WORDS)
            down = crossed and below > _WORDS and not upright
            ax.annotate(
                words.replace("\n", ", ") if upright else words,
                (at, e if crossed and not down else r), xytext=(0, -7 if down else 7), textcoords="offset points",
                ha="center", va="top" if down else "bottom", fontsize=7.5, rotation=90 if upright else 0,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.3},
            )  # fmt: skip


def draw_error_steps(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the error in every group of data over the steps of a search for several effects.

    Parameters
    ----------
    table : DataFrame
        Columns ``step``, ``effects`` (names in the model; ``none`` for the base model), ``group``, ``rms`` and
        ``expected`` (sigma; NaN where unknown).
    ax : Axes, optional

    Returns
    -------
    Axes
        As those of `draw_error_versions`.
    """
    steps = table.rename(columns={"step": "version"}).replace({"effects": {"none": "calibrated base model"}})
    steps["effects"] = steps["effects"].map(in_prose).str.replace(" + ", "\n+ ", regex=False)
    ax = draw_error_versions(steps, ax)
    ax.set_xlabel("step, and the effects in the model")
    return ax


def draw_error_versions(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the error in every group of data over the versions of a model.

    Parameters
    ----------
    table : DataFrame
        Columns ``version`` (number, in order), ``effects`` (names in the model, empty for the base model), ``group``,
        ``rms`` and ``expected`` (sigma; NaN where unknown).
    ax : Axes, optional

    Returns
    -------
    Axes
        One line per group, dashed lines at the expected values; logarithmic when errors differ by a factor above 20.
    """
    groups, versions = _groups(table), sorted(set(table["version"]))
    ax = style.own_axes(ax, 3.8)
    if not groups:
        return blank(ax, "no version of the model is known")
    x = np.arange(len(versions))
    for k, group in enumerate(groups):
        rows = table[table["group"] == group].groupby("version")[["rms", "expected"]].first().reindex(versions)
        looks: dict[str, Any] = {
            "color": style.CASES[k % len(style.CASES)],
            "marker": "osD^v"[k % 5],
            "markersize": 5.5,
            "linewidth": 1.6,
        }
        ax.plot(x, rows["rms"].to_numpy(dtype=float), label=GROUPS.get(group, group), gid=group, zorder=3, **looks)
        expected = rows["expected"].to_numpy(dtype=float)
        points = zip(versions, rows["rms"], expected, strict=True)
        words = [
            f"{GROUPS.get(group, group)}, version {v:g}: {fixed(r, 2)} σ; expected {fixed(e, 2)}" for v, r, e in points
        ]
        hover_points(ax, x, rows["rms"], words)
        ends = [np.repeat(expected, 2), np.ravel(np.column_stack([x - 0.2, x + 0.2]))]
        ends = [np.insert(end, np.arange(2, len(end), 2), np.nan) for end in ends]
        ax.plot(ends[1], ends[0], "--", color=looks["color"], linewidth=1.1, gid=f"expected {group}")
    _scale(ax, table, 1.1)
    effects = table.groupby("version")["effects"].first().reindex(versions).fillna("")
    width = max(12, int(100 / len(versions)) - 4)
    words = ["\n".join(textwrap.fill(line, width) for line in (str(e) or "base model").split("\n")) for e in effects]
    ax.set_xticks(x, [f"{version:g}\n{text}" for version, text in zip(versions, words, strict=True)])
    ax.set_xlim(-0.5, len(versions) - 0.5)
    ax.grid(axis="y")
    ax.set_xlabel("version of the model, and its added effects")
    ax.set_ylabel("rms error (σ)")
    handles: list[Artist] = list(ax.get_legend_handles_labels()[0])
    handles.append(
        Line2D([], [], color=style.GREY, linestyle="--", linewidth=1.1, label="expected for a correct model")
    )
    style.legend_above(ax, handles)
    return ax


def best_candidates(table: pd.DataFrame, count: int = _SHOWN) -> pd.DataFrame:
    """Return the best candidate measurements, best first, each with the effect whose score it raises most.

    They are those for the effects that the recommendation is about, where a column ``told`` says which these are, and
    of these what is not measured yet and worthwhile, where anything is. They are ranked by ``ln_bayes`` where any is
    known, otherwise by ``gain``.
    """
    new = table[~table["measurement"].astype(str).str.endswith(_MEASURED)]
    table = new if len(new) else table
    if "told" in table and (about := table["told"].fillna(False).astype(bool)).any():
        table = table[about]
    key = ["ln_bayes", "gain"] if table["ln_bayes"].notna().any() else ["gain"]
    worthwhile = table[table[key[0]] >= (WORTHWHILE if key[0] == "gain" else LEAST_BAYES_FACTOR)]
    table = worthwhile if len(worthwhile) else table
    rows = table.sort_values("gain", ascending=False, kind="stable").drop_duplicates("measurement")
    return rows.sort_values(key, ascending=False, kind="stable", ignore_index=True).head(count)


def draw_next_measurement(
    table: pd.DataFrame, ax: Axes | None = None, *, measure: str = "gain", legend: bool = True
) -> Axes:
    """Draw the expected gain of the ten best candidate measurements.

    Parameters
    ----------
    table : DataFrame
        Columns ``measurement, kind`` (sensor, mode, repeats or bench), ``effect`` (whose score grows), ``gain`` (factor
        in the expected score z) and ``ln_bayes`` (expected ln Bayes factor between the two leading effects; NaN when
        one leads). Both are means, with ``_low`` and ``_high``, between which 8 of 10 cases lie: drawn as lines.
    ax : Axes, optional
    measure : str
        ``gain``, drawn from 1 (no gain), or ``ln_bayes``, drawn from 0.
    legend : bool
        Whether a legend stands above the Axes.
    """
    rows = best_candidates(table)
    ax = style.own_axes(ax, _next_height(rows))
    if rows.empty:
        return blank(ax, "no further measurement was considered")
    at = np.arange(len(rows))
    values = rows[measure].to_numpy(dtype=float)
    start = 1.0 if measure == "gain" else 0.0
    colours = [_KINDS.get(kind, (kind, style.GREY))[1] for kind in rows["kind"].astype(str)]
    words = ["–" if np.isnan(v) else f"× {v:.2f}" if measure == "gain" else f"{v:.1f}" for v in values]
    values = np.where(np.isfinite(values), values, start)
    bars = ax.barh(at, values - start, 0.4 if style.in_column() else 0.66, left=start, color=colours, gid=measure)
    for bar, name, word in zip(bars, rows["measurement"], words, strict=True):
        hover(bar, f"{name}: {word}")
    ax.bar_label(bars, [w.replace("-", "−").replace("inf", "∞") for w in words], fontsize=8, padding=3)
    ax.axvline(start, color=style.BLACK, linewidth=0.8)
    low, high = (rows[f"{measure}_{end}"].to_numpy(dtype=float) for end in ("low", "high"))
    wide = np.isfinite(low) & np.isfinite(high)
    ax.hlines(at[wide] + 0.2, low[wide], high[wide], color=style.BLACK, linewidth=1.0, gid="range")
    known = np.concatenate([values, low[wide], high[wide]])
    known = np.append(known, [start, 2.0 if measure == "gain" else LEAST_BAYES_FACTOR])
    span = float(known.max() - known.min())
    ax.set_xlim(known.min() - 0.02 * span, known.max() + 0.24 * span)
    ranges = "lines: 8 of 10 cases; " if (high[wide] > low[wide]).any() else ""
    if measure == "ln_bayes":
        ax.axvline(LEAST_BAYES_FACTOR, color=style.BLACK, linestyle="--", linewidth=1.0, gid="threshold")
        ax.set_xlabel(f"expected log Bayes factor of the\ntrue effect (–; {ranges}dashed: {LEAST_BAYES_FACTOR:g})")
    else:
        ax.set_xlabel(f"expected gain in the score z of the effect\n(–; {ranges}1: no gain)")
    names = _measurement_labels(rows)
    top, _ = row_edges(names)
    for name in name_rows(ax, names):
        name.set_fontsize(7.5 if style.in_column() else 8)
    ax.set_ylim(len(rows) + top + 0.05, top - 0.05)
    ax.grid(axis="x")
    if legend:
        # The labels are so wide that the legend has room for two columns at most.
        ax.legend(handles=_kind_handles(rows), loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, ncols=2)
    return ax


def next_measurement_figure(table: pd.DataFrame) -> Figure:
    """Draw `draw_next_measurement`, and beside it the expected ln Bayes factor where two effects compete."""
    rows = best_candidates(table)
    figure = style.new_figure(_next_height(rows))
    if not table["ln_bayes"].notna().any():
        draw_next_measurement(table, figure.add_subplot())
        return figure
    grid = figure.add_gridspec(2, 2, height_ratios=(0.2, _next_height(rows) - 0.2))
    over, left = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    right = figure.add_subplot(grid[1, 1], sharey=left)
    draw_next_measurement(table, left, legend=False)
    draw_next_measurement(table, right, measure="ln_bayes", legend=False)
    right.tick_params(labelleft=False)
    if style.in_column():
        run_on(left, right, len(rows))
    over.set_axis_off()
    abreast = 2 if style.in_column() else 4
    over.legend(handles=_kind_handles(rows), loc="upper left", borderaxespad=0.0, ncols=abreast)
    return figure


def _groups(table: pd.DataFrame) -> list[str]:
    """Groups of data in their order, without those whose error is unknown."""
    known = set(table["group"][table["rms"].notna()])
    return [*(g for g in GROUPS if g in known), *sorted(known - set(GROUPS))]


def _scale(ax: Axes, table: pd.DataFrame, room: float) -> None:
    """Set a logarithmic axis for errors that differ much, otherwise one from 0; with room above the highest."""
    values = table[["rms", "expected"]].to_numpy(dtype=float)
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    if low > 0.0 and high > _RANGE * low:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
        bottom = 0.5 * low
        ax.set_ylim(bottom, high * (high / bottom) ** (room - 1.0))
    else:
        ax.set_ylim(0.0, (high or 1.0) * room)


def _error_words(rms: float, p: float) -> str:
    if np.isnan(rms):
        return ""
    words = p_in_words(p)
    chance = "" if np.isnan(p) else f"\np {words}" if words[0] in "<>" else f"\np = {words}"
    return f"{fixed(rms, 2) if rms < 10 else short(rms)}{chance}"


def _kind_handles(rows: pd.DataFrame) -> list[Artist]:
    looks = [_KINDS.get(kind, (kind, style.GREY)) for kind in dict.fromkeys(rows["kind"].astype(str))]
    return [Patch(facecolor=colour, label=words) for words, colour in looks]


def _measurement_labels(rows: pd.DataFrame) -> list[str]:
    named = zip(rows["measurement"], rows["effect"].fillna(""), strict=True)
    return [
        style.fill(f"{_true_minus(name)} (for {in_prose(str(effect))})" if effect else _true_minus(name), 52)
        for name, effect in named
    ]


def _true_minus(words: object) -> str:
    """The name of a measurement with the signs of its coordinates."""
    return re.sub(r"(?<=[( ])-(?=\d)", "−", str(words))


def _next_height(rows: pd.DataFrame) -> float:
    if style.in_column():
        return 1.6 + rows_height(_measurement_labels(rows), 0.3)
    lines = [label.count("\n") + 1 for label in _measurement_labels(rows)] if len(rows) else [1]
    return 1.3 + sum(max(0.3, 0.17 * n + 0.06) for n in lines)
