"""Model against measurement: frequency errors, MAC, CoMAC."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from calib.report import style
from calib.report.numbers import fixed
from calib.report.svg import hover, hover_cells, hover_points

_LOOKS: dict[str, dict[str, Any]] = {
    "before": {"color": style.BEFORE, "hatch": "////", "edgecolor": "white"},
    "after": {"color": style.AFTER},
    "added": {"color": style.WITH, "hatch": "....", "edgecolor": "white"},
}
MARKS = {"before": ("s", style.BEFORE), "after": ("o", style.AFTER), "added": ("D", style.WITH)}
_ROOM = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.3}
"""Ground of a number over a line that crosses it."""
STILL = 0.1
"""Motion over the largest one of a mode, rms over the modes, below which a sensor hardly moves."""
LEAST_MAC_ERROR = 1e-3
"""Smallest 1 − MAC that is drawn apart."""
_HIGH = 0.5
"""1 − MAC above which a number stands below its mark."""
_MAX_SENSORS = 40
_LABEL_ROOM = 105
"""Characters that fit side by side under the bars."""
_MOST_VALUES = 24
"""Bars that still have their values written above them."""
_MANY_MACS = 14
"""Marks from which those of a mode stand further apart, so that their labels do not touch."""
_MOST_MACS = 18
"""Marks that still have their MAC, of three digits, beside them."""


def has_mac(*tables: pd.DataFrame | None) -> bool:
    """Whether any of the comparison tables has a MAC value; there is none without measured shapes."""
    return any(t is not None and bool(t["mac"].notna().any()) for t in tables)


def draw_frequency_error(
    before: pd.DataFrame | None,
    after: pd.DataFrame | None = None,
    ax: Axes | None = None,
    *,
    added: pd.DataFrame | None = None,
    effects: str = "",
) -> Axes:
    """Draw the signed frequency error of every mode as bars, after Ribeiro et al. (2013), figure 9.

    Parameters
    ----------
    before, after, added : DataFrame or None
        Of the model before and after calibration, and calibrated with added effects. Columns ``mode,
        natural_freq_measured`` (Hz) and ``freq_error`` (signed fraction, NaN for an unpaired mode).
    ax : Axes, optional
    effects : str
        Names of the added effects, for the legend.

    Returns
    -------
    Axes
        Bar heights in percent; the legend has the mean absolute error over the paired modes.
    """
    ax = style.own_axes(ax, 3.2)
    series = by_stage({"before": before, "after": after, "added": added})
    values = {stage: 100.0 * table["freq_error"] for stage, table in series.items()}
    labels = {
        stage: f"{style.stage_words(stage, effects)}: mean |error| {_mean(errors.abs(), '{:.2f} %')}{_paired(errors)}"
        for stage, errors in values.items()
    }
    ax.axhline(0.0, color="black", linewidth=0.8)
    stage_words = {stage: style.stage_words(stage, effects) for stage in values}
    _bars(ax, values, labels, stage_words, "{:+.1f}", lambda value: f"{fixed(value, 2, sign=True)} %")
    modes = next(iter(values.values())).index
    frequencies = pd.concat([t["natural_freq_measured"] for t in series.values()]).groupby(level=0, sort=False).first()
    names = [f"{mode}\n{frequencies[mode]:.2f} Hz" for mode in modes]
    ax.set_xticks(range(len(modes)), names)
    _crowded(ax, names)
    ax.set_xlabel("mode, measured natural frequency")
    ax.set_ylabel("frequency error, model − measured (%)")
    ax.margins(y=0.14)
    return ax


def draw_mac(
    before: pd.DataFrame | None,
    after: pd.DataFrame | None = None,
    ax: Axes | None = None,
    *,
    noise_mac: float = math.nan,
    added: pd.DataFrame | None = None,
    effects: str = "",
) -> Axes:
    """Draw 1 − MAC of every mode and its model mode, after Ribeiro et al. (2013), figure 9.

    Parameters
    ----------
    before, after, added, ax, effects
        As for `draw_frequency_error`; columns ``mode`` and ``mac`` (0 to 1, NaN for an unpaired mode).
    noise_mac : float
        Mean MAC of a perfect model with this noise, drawn as a dashed line; NaN where unknown.

    Returns
    -------
    Axes
        Marks on a logarithmic scale, where 0.001 and less are drawn as 0.001, with the MAC beside each.
    """
    ax = style.own_axes(ax, 2.6)
    series = by_stage({"before": before, "after": after, "added": added})
    modes = list(next(iter(series.values())).index)
    width = (0.9 if len(modes) * len(series) > style.room(_MANY_MACS) else 0.8) / len(series)
    for k, (stage, table) in enumerate(series.items()):
        mac = table["mac"].astype(float)
        words, (mark, colour) = style.stage_words(stage, effects), MARKS[stage]
        x = np.arange(len(mac)) + (k - (len(series) - 1) / 2) * width
        heights = (1.0 - mac).clip(lower=LEAST_MAC_ERROR).to_numpy()
        label = f"{words}: mean MAC {_mean(mac, '{:.3f}')}{_paired(mac)}"
        ax.plot(x, heights, mark, color=colour, markersize=6.5, label=label, zorder=3)
        hover_points(ax, x, heights, [f"{m}, {words}: MAC {fixed(v, 3)}" for m, v in zip(modes, mac, strict=True)])
        for place, height, value in zip(x, heights, mac, strict=True):
            if math.isnan(value):
                _not_paired(ax, place, ax.get_xaxis_transform())
            elif len(modes) * len(series) <= style.room(_MOST_MACS):
                is_high, size = height > _HIGH, 7 if style.in_column() else 6.5
                ax.annotate(
                    f"{value:.3f}", (place, height), xytext=(0, -6 if is_high else 6), textcoords="offset points",
                    ha="center", va="top" if is_high else "bottom", fontsize=size, zorder=4, bbox=_ROOM,
                )  # fmt: skip
    if not math.isnan(noise_mac):
        level = max(1.0 - noise_mac, LEAST_MAC_ERROR)
        ax.axhline(level, color=style.GREY, linestyle="--", linewidth=1.0, label="mean that noise allows", zorder=1)
    ax.set_xticks(range(len(modes)), modes)
    _crowded(ax, [str(mode) for mode in modes])
    ax.set_xlim(-0.6, len(modes) - 0.4)
    ax.set_yscale("log")
    ax.set_ylim(LEAST_MAC_ERROR / 1.5, 1.5)
    ax.set_yticks([1.0, 0.1, 0.01, 0.001], ["1", "0.1", "0.01", "0.001"])
    ax.grid(axis="y")
    ax.set_xlabel("mode")
    ax.set_ylabel("1 − MAC (–)")
    style.legend_above(ax)
    return ax


def comparison_figure(
    before: pd.DataFrame | None,
    after: pd.DataFrame | None = None,
    noise_mac: float = math.nan,
    *,
    added: pd.DataFrame | None = None,
    effects: str = "",
) -> Figure:
    """Draw frequency errors above MAC; without measured shapes there is no MAC panel."""
    third: dict[str, Any] = {"added": added, "effects": effects}
    more = 0.0 if added is None else 0.5  # for the legend, which names three models on as many lines
    if not has_mac(before, after, added):
        figure = style.new_figure(3.6 + more)
        draw_frequency_error(before, after, figure.add_subplot(), **third)
        return figure
    figure = style.new_figure(6.2 + 2 * more)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.25, 1.0))
    draw_frequency_error(before, after, upper, **third)
    draw_mac(before, after, lower, noise_mac=noise_mac, **third)
    upper.text(-0.08, 1.06, "(a)", transform=upper.transAxes, fontweight="bold")
    lower.text(-0.08, 1.06, "(b)", transform=lower.transAxes, fontweight="bold")
    return figure


_MODEL_MODES = 30
"""Model modes in a matrix of MAC: more cannot be read."""


def draw_mac_matrix(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the MAC of every measured mode with every model mode as a matrix with the values in the cells.

    Parameters
    ----------
    table : DataFrame
        Column ``mode`` and one column for every model mode, headed like ``1 (10.83 Hz)``; cells 0 to 1.
        Of more than `_MODEL_MODES` those are drawn that have the largest MAC with a measured one.
    ax : Axes, optional
    """
    values = table.drop(columns="mode").to_numpy(dtype=float)
    total = values.shape[1]
    if total > _MODEL_MODES:
        kept = np.sort(np.argsort(-np.nan_to_num(values).max(axis=0), kind="stable")[:_MODEL_MODES])
        table, values = table[["mode", *table.columns.drop("mode")[kept]]], values[:, kept]
    rows, columns = values.shape
    ax = style.own_axes(ax, style.matrix_height(rows, columns))
    image = ax.imshow(values, cmap="Blues", norm=Normalize(0.0, 1.0), aspect="auto")
    size = 8.0 if columns <= 14 else max(4.5, 8.0 * 14 / columns)
    for i, j in np.argwhere(np.isfinite(values)):
        value = values[i, j]
        shade = "white" if value > 0.6 else "black" if value >= 0.2 else style.GREY
        ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=size, color=shade)
    ax.set_xticks(range(columns), [str(c) for c in table.columns if c != "mode"], rotation=90 if columns > 6 else 0)
    ax.set_yticks(range(rows), table["mode"].astype(str))
    ax.set_xlabel(
        "model mode" if columns == total else f"model mode, the {columns} of {total} most like a measured one"
    )
    ax.set_ylabel("measured mode")
    names = [str(c) for c in table.columns if c != "mode"]
    hover_cells(
        ax,
        [
            [f"{mode}, model mode {name}: {fixed(value, 3)}" for name, value in zip(names, row, strict=True)]
            for mode, row in zip(table["mode"], values, strict=True)
        ],
    )
    style.separate_cells(ax, rows, columns)
    style.bar_beside(ax, image, "MAC (–)")
    return ax


def draw_comac(
    before: pd.DataFrame | None, after: pd.DataFrame | None = None, ax: Axes | None = None, *, effects: str = ""
) -> Axes:
    """Draw CoMAC of the sensors, sorted by the newest table, the worst first.

    Parameters
    ----------
    before, after : DataFrame or None
        Columns ``sensor`` and ``comac`` (0 to 1, NaN for a sensor without a value); optional ``motion``, the amplitude
        of the sensor over the largest one of each mode (rms over the modes).
    ax : Axes, optional
    effects : str
        Names of effects that were added after this calibration, for the legend.

    Returns
    -------
    Axes
        One dot per sensor and table; of more than 40 sensors (18 in a column) the worst, as the axis label then states.
        The name of a sensor that hardly moves is grey, with its motion: its CoMAC is mostly noise.
    """
    ax = style.own_axes(ax, 3.6)
    series = by_stage({"before": before, "after": after}, key="sensor")
    values = {stage: table["comac"] for stage, table in series.items()}
    newest = list(values.values())[-1]
    order = newest.sort_values(kind="stable", na_position="last").index
    most = int(style.room(_MAX_SENSORS))
    shown = order[:most]
    x = np.arange(len(shown))
    heights = {name: v[shown].to_numpy(dtype=float) for name, v in values.items()}
    if len(heights) == 2:
        ax.vlines(x, heights["before"], heights["after"], color="#B5B5B5", linewidth=1.2, zorder=1)
    for name, height in heights.items():
        colour = style.BEFORE if name == "before" else style.AFTER
        ax.plot(
            x,
            height,
            linestyle="none",
            marker="o",
            markersize=5.5,
            markerfacecolor="white" if name == "before" else colour,
            markeredgewidth=1.4,
            color=colour,
            label=f"{style.stage_words(name, effects)}: mean CoMAC {_mean(values[name], '{:.3f}')}",
        )
        stage_words = style.stage_words(name, effects)
        hover_points(ax, x, height, [f"{s}, {stage_words}: {fixed(v, 3)}" for s, v in zip(shown, height, strict=True)])
    lowest = min((float(np.nanmin(h)) for h in heights.values() if np.isfinite(h).any()), default=0.0)
    ax.set_ylim(max(0.0, np.floor(10.0 * lowest - 0.5) / 10.0), 1.03)
    ax.set_xlim(-0.7, len(shown) - 0.3)
    motion = list(series.values())[-1].get("motion", pd.Series(dtype=float))
    still = (motion.reindex(shown) < STILL).to_numpy()
    names = [f"{s} ({fixed(100 * motion[s], 0)} %)" if k else str(s) for s, k in zip(shown, still, strict=True)]
    ax.set_xticks(x, names, rotation=90 if len(shown) > 12 or still.any() else 0)
    for label, grey in zip(ax.get_xticklabels(), still, strict=True):
        label.set_color(style.GREY if grey else style.BLACK)
    ax.grid(axis="both")
    note = f"sensor (node and direction), the {most} worst of {len(order)}" if len(order) > most else ""
    note = note or "sensor (node and direction), worst first"
    hint = "\ngrey: hardly moves (in brackets: of the mode's largest motion, rms), so that noise alone lowers its CoMAC"
    ax.set_xlabel(note + (hint if still.any() else ""))
    ax.set_ylabel("CoMAC (–)")
    style.legend_above(ax)
    return ax


def by_stage(tables: Mapping[str, pd.DataFrame | None], key: str = "mode") -> dict[str, pd.DataFrame]:
    """The tables that exist, by stage, on a common index: the rows of the first, then those that only others have."""
    found = {stage: t.set_index(key) for stage, t in tables.items() if t is not None}
    index = list(dict.fromkeys(label for t in found.values() for label in t.index))
    return {stage: t.reindex(index) for stage, t in found.items()}


def _bars(
    ax: Axes,
    values: dict[str, pd.Series],
    labels: dict[str, str],
    stage_words: dict[str, str],
    number: str,
    words: Callable[[float], str],
) -> None:
    """Draw grouped bars with their values, stage and ``words`` of each under the mouse; missing ones are labelled."""
    width = 0.8 / len(values)
    for k, (name, series) in enumerate(values.items()):
        x = np.arange(len(series)) + (k - (len(values) - 1) / 2) * width
        heights = series.to_numpy(dtype=float)
        missing = np.isnan(heights)
        bars = ax.bar(x, heights, width * 0.94, label=labels[name], **_LOOKS[name])
        for bar, (mode, height) in zip(bars, series.items(), strict=True):
            hover(bar, f"{mode}, {stage_words[name]}: {words(height)}")
        if len(series) * len(values) <= style.room(_MOST_VALUES):
            texts = ["" if gone else _signed(h, number) for h, gone in zip(heights, missing, strict=True)]
            ax.bar_label(
                bars, texts, fontsize=7 if len(values) < 3 or style.in_column() else 6.5, padding=2, bbox=_ROOM
            )
        for position in x[missing]:
            _not_paired(ax, position, "data")
    ax.set_xlim(-0.6, len(next(iter(values.values()))) - 0.4)
    ax.grid(axis="y")
    style.legend_above(ax)


def _not_paired(ax: Axes, x: float, coordinates: Any) -> None:
    """Label a mode without a partner, upwards from 0 of the coordinates."""
    ax.annotate(
        "not paired", (x, 0.0), xycoords=coordinates, xytext=(0, 4), textcoords="offset points", rotation=90,
        ha="center", va="bottom", fontsize=7.5, color=style.GREY,
    )  # fmt: skip


def _signed(value: float, number: str) -> str:
    """Format a number; one that rounds to zero has no sign."""
    text = number.format(value)
    return (text if float(text) else number.format(0.0).lstrip("+")).replace("-", "−")


def _crowded(ax: Axes, labels: list[str]) -> None:
    """Turn the labels under the bars upright where they would touch."""
    longest = max(len(line) for label in labels for line in label.split("\n"))
    if (longest + 2) * len(labels) > style.room(_LABEL_ROOM):
        ax.tick_params(axis="x", rotation=90)


def _mean(values: pd.Series, number: str) -> str:
    return number.format(values.mean()) if values.notna().any() else "unknown"


def _paired(values: pd.Series) -> str:
    paired = int(values.notna().sum())
    return "" if paired == len(values) else f", {paired} of {len(values)} paired"
