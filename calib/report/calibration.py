"""Figures of the searches of a calibration: where each ended, and its convergence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report.comparison import LEAST_MAC_ERROR
from calib.report.numbers import flag, significant, with_unit
from calib.report.parameters import position
from calib.report.style import (
    CASES,
    GREY,
    VERMILLION,
    in_column,
    legend_above,
    new_figure,
    own_axes,
    plain,
    plain_ticks,
)
from calib.report.svg import hover

_BESIDE_VALUES = 38.0
"""Offset in points from the Axes of words beside the values of the bars."""
_LINE_STYLES = ("-", "-.", ":")
SEARCH, FITTED = "search", "least squares"
MOST_ENDS = 60
"""Modes or responses whose errors by case are drawn."""


def draw_searches(table: pd.DataFrame, ax: Axes | None = None, best_case: str | None = None) -> Axes:
    """Draw where the search of every case ended, between the limits, after Ribeiro et al. (2013), figure 8.

    Parameters
    ----------
    table : DataFrame
        Columns ``case, parameter, value, unit``, ``ratio`` (position between the limits, 0 to 1),
        ``on_limit`` (bool), ``spread`` (of the ratio over the cases, NaN if unknown) and ``stable`` (bool, or None).
        Optional: ``search_value`` (end of the search, before least squares) and ``search_on_limit``, ``lower``,
        ``upper``.
    ax : Axes, optional
    best_case : str, optional
        The case that is reported, for the legend.

    Returns
    -------
    Axes
        One group of horizontal bars per parameter, lengths in percent of the range between the limits, and the value
        beside each bar; a dark line separates neighbours of different units. A triangle marks a bar that ends at a
        limit; a parameter on which the searches disagree is hatched and labelled.
    """
    cases = list(dict.fromkeys(table["case"]))
    names = list(dict.fromkeys(table["parameter"]))
    step = (0.14 if in_column() else 0.125) * len(cases) + 0.1
    beside = 1.3 + 0.15 * len(cases) if in_column() else 1.0  # in a column the legend has a line for each case
    ax = own_axes(ax, beside + max(step, 0.34) * len(names))
    height = 0.8 / len(cases)
    unstable = {
        name: any(flag is False for flag in _flags(table[table["parameter"] == name], "stable")) for name in names
    }
    any_bound = False
    for k, case in enumerate(cases):
        rows = table[table["case"] == case].set_index("parameter").reindex(names)
        y = np.arange(len(names)) + (k - (len(cases) - 1) / 2) * height
        lengths = 100.0 * search_span(rows).to_numpy(dtype=float)
        bars = ax.barh(y, lengths, height * 0.92, color=CASES[k % len(CASES)], label=str(case))
        for bar, name in zip(bars, names, strict=True):
            row = rows.loc[name]
            searched_for = row.get("search_value", math.nan)
            words = f"{name}, {case}: {with_unit(row['value'], str(row['unit']), 5)}"
            hover(bar, words + ("" if pd.isna(searched_for) else f"; the search {significant(searched_for, 5)}"))
            if unstable[name]:
                bar.set_hatch("/////")
                bar.set_edgecolor("white")
        _write_bar_values(ax, rows, y)
        bound = _at_limit(rows)
        any_bound = any_bound or bool(bound.any())
        for marker, side in (("<", lengths <= 50.0), (">", lengths > 50.0)):
            at = bound & side
            ends = np.clip(lengths[at], 0.0, 100.0) + 1.6
            ax.plot(ends, y[at], marker, color="black", markersize=4.5, gid=f"on_limit {case} {marker}")
    units = table.groupby("parameter")["unit"].first().reindex(names).tolist()
    bare = [str(unit) in ("-", "") or pd.isna(unit) for unit in units]
    labels = [f"{n}" if no else f"{n} ({u})" for n, u, no in zip(names, units, bare, strict=True)]
    ax.set_ylim(len(names) - 0.45, -0.55)
    ax.set_xlim(0.0, 104.0)
    ax.set_xticks(range(0, 101, 20))
    ax.axvline(100.0, color=GREY, linewidth=0.8)
    ax.grid(axis="x")
    for i in range(1, len(names)):
        other = units[i] != units[i - 1]
        ax.axhline(i - 0.5, color=GREY if other else "#E3E3E3", linewidth=1.0 if other else 0.6)
    ax.set_xlabel("position between the lower (0) and the upper search limit (100) (%)")
    for row, name in enumerate(names):
        if unstable[name]:
            spread = table.loc[table["parameter"] == name, "spread"].max()
            text = "not stable" if math.isnan(spread) else f"not stable, spread {100.0 * spread:.0f} %"
            if in_column():  # which has no room beside the values
                labels[row] += f"\n{text}"
            else:
                _beside(ax, row, text, VERMILLION, _BESIDE_VALUES)
    ax.set_yticks(range(len(names)), labels)
    _legend(ax, cases, best_case, any(unstable.values()), any_bound)
    return ax


def _write_bar_values(ax: Axes, rows: pd.DataFrame, y: np.ndarray) -> None:
    """Write the value of every bar of a case beside the bar."""
    values = rows["value"].astype(float)
    if "search_value" in rows:
        values = rows["search_value"].astype(float).fillna(values)
    size = 7.0 if in_column() else 6.5
    for value, at in zip(values, y, strict=True):
        if not math.isnan(value):
            _beside(ax, at, plain(value).replace("-", "−"), "black", fontsize=size, gid="bar value")


def search_span(table: pd.DataFrame) -> pd.Series[float]:
    """Return the position between the limits (0 to 1) where the search ended; the final position without a search."""
    if "search_value" not in table:
        return table["ratio"].astype(float)
    found = pd.Series(position(table, table["search_value"]), index=table.index)
    return found.fillna(table["ratio"].astype(float))


def _at_limit(rows: pd.DataFrame) -> np.ndarray:
    """Whether what the bar shows is at a limit: the end of the search, or without one the final value."""
    ends = rows["on_limit"]
    if "search_on_limit" in rows:
        ends = rows["search_on_limit"].where(rows["search_on_limit"].notna(), ends)
    return np.array([flag(value) for value in ends])


def _flags(table: pd.DataFrame, column: str) -> list[bool | None]:
    """Flags of a column, None where unknown."""
    return [None if pd.isna(flag) else bool(flag) for flag in table[column]]


def _beside(ax: Axes, row: float, text: str, colour: str, far: float = 0.0, **looks: Any) -> None:
    """Write at the right of a row, so many points beside the Axes."""
    ax.annotate(
        text,
        (1.01, row),
        xycoords=("axes fraction", "data"),
        xytext=(far, 0),
        textcoords="offset points",
        va="center",
        color=colour,
        annotation_clip=False,
        **{"fontsize": 8.0, **looks},
    )


def _legend(ax: Axes, cases: list[str], best_case: str | None, any_unstable: bool, any_bound: bool) -> None:
    handles: list[Artist] = [
        Patch(color=CASES[k % len(CASES)], label=f"{case} (its fit is reported)" if case == best_case else str(case))
        for k, case in enumerate(cases)
    ]
    if any_unstable:
        handles.append(Patch(facecolor=GREY, edgecolor="white", hatch="/////", label="not stable: cases disagree"))
    if any_bound:
        handles.append(
            Line2D([], [], linestyle="none", marker=">", color="black", markersize=4.5, label="ends at a search limit")
        )
    legend_above(ax, handles)


def ends_figure(table: pd.DataFrame) -> Figure:
    """Draw the errors where every search ended and after least squares, datum by datum.

    Parameters
    ----------
    table : DataFrame
        Columns ``case, point`` (``"search"`` or ``"least squares"``), ``what``, ``error`` (signed fraction, NaN for an
        unpaired mode) and ``mac`` (0 to 1; NaN throughout without shapes).

    Returns
    -------
    Figure
        Errors in percent, open at the end of a search and filled after least squares; below them 1 − MAC on a
        logarithmic scale, where 0.001 and less are drawn as 0.001.
    """
    panels = [("error", "error, model − measured (%)")]
    panels += [("mac", "1 − MAC (–)")] if table["mac"].notna().any() else []
    figure = new_figure(0.6 + 2.6 * len(panels))
    cases, names = list(dict.fromkeys(table["case"])), list(dict.fromkeys(table["what"]))
    places = {name: place for place, name in enumerate(names)}
    for number, (column, label) in enumerate(panels):
        ax = figure.add_subplot(len(panels), 1, number + 1)
        for k, case in enumerate(cases):
            for point in (SEARCH, FITTED):
                own = table[(table["case"] == case) & (table["point"] == point)]
                values = 100.0 * own["error"] if column == "error" else (1.0 - own["mac"]).clip(lower=LEAST_MAC_ERROR)
                x = own["what"].map(places) + 0.8 * ((k + 0.5) / len(cases) - 0.5)
                colour = CASES[k % len(CASES)]
                looks: dict[str, Any] = {"markerfacecolor": "none" if point == SEARCH else colour, "markersize": 5.0}
                ax.plot(x, values, "o", color=colour, gid=f"{column} {case} {point}", **looks)
        ax.set_xticks(range(len(names)), names)
        ax.grid(axis="y")
        ax.set_ylabel(label)
        if column == "error":
            ax.axhline(0.0, color="black", linewidth=0.8)
            legend_above(ax, _ends_legend(table, cases))
        else:
            ax.set_yscale("log")
            plain_ticks(ax.yaxis)
    return figure


def _ends_legend(table: pd.DataFrame, cases: Sequence[str]) -> list[Artist]:
    """A handle for each case with both mean errors, and one for each kind of mark."""
    means = (100.0 * table["error"].abs().fillna(1.0)).groupby([table["case"], table["point"]]).mean()
    handles: list[Artist] = []
    for k, case in enumerate(cases):
        words = " → ".join(f"{means[case, point]:.2f} %" for point in (SEARCH, FITTED) if (case, point) in means)
        handles.append(Patch(color=CASES[k % len(CASES)], label=f"{case}: mean |error| {words}"))
    for words, fill in ((f"end of the {SEARCH}", "none"), (f"after {FITTED}", GREY)):
        look: dict[str, Any] = {"color": GREY, "markerfacecolor": fill, "markersize": 5.0}
        handles.append(Line2D([], [], linestyle="none", marker="o", label=words, **look))
    return handles


def search_runs(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of ``convergence.csv`` of cases that a genetic search ran: fits have no mean of a generation."""
    return table[table.groupby("case")["mean"].transform("count") > 0]


def draw_convergence(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the misfit over the generations of the search, one line per case.

    Parameters
    ----------
    table : DataFrame
        Columns ``case, generation``, ``best`` (smallest misfit so far) and ``mean`` (over the generation); values that
        are not finite, such as those of a generation without a feasible point, are gaps.
    ax : Axes, optional

    Returns
    -------
    Axes
        ``best`` as thick lines, ``mean`` as thin dashed ones; logarithmic when every value is positive.
    """
    ax = own_axes(ax, 3.6)
    cases = list(dict.fromkeys(table["case"]))
    finite = table[["best", "mean"]].astype(float).where(np.isfinite(table[["best", "mean"]].astype(float)))
    has_mean = bool(finite["mean"].notna().any())
    for k, case in enumerate(cases):
        rows = table[table["case"] == case].sort_values("generation", kind="stable")
        colour = CASES[k % len(CASES)]
        generation = rows["generation"].to_numpy(dtype=float)
        best, mean = (finite.loc[rows.index, column].to_numpy() for column in ("best", "mean"))
        line_style = _LINE_STYLES[k // len(CASES) % len(_LINE_STYLES)]
        last = best[np.isfinite(best)]
        label = f"{case} (ends at {significant(last[-1], 3)})" if len(last) else f"{case} (no feasible point)"
        marker = "o" if len(best) == 1 else ""
        looks: dict[str, Any] = {"color": colour, "linewidth": 1.9, "marker": marker, "zorder": 3}
        (line,) = ax.plot(generation, best, line_style, label=label, **looks)
        hover(line, label)
        if has_mean:
            ax.plot(generation, mean, "--", color=colour, linewidth=0.8, alpha=0.8, marker=marker, markersize=3)
    if has_mean:
        ax.plot([], [], "--", color=GREY, linewidth=0.9, label="mean of the generation")
    if finite.notna().to_numpy().any() and not (finite <= 0.0).to_numpy().any():
        ax.set_yscale("log")
        plain_ticks(ax.yaxis)
    ax.grid(which="both")
    ax.margins(x=0.02)
    ax.set_xlabel("generation")
    ax.set_ylabel("misfit (–)")
    legend_above(ax)
    return ax
