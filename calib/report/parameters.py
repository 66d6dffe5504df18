"""Figure of the calibrated parameters: limits, prior and posterior of each in one row."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report.numbers import fixed, significant, with_unit
from calib.report.rows import name_rows, row_edges, rows_height
from calib.report.style import BLACK, BLUE, GREY, ORANGE, VERMILLION, in_column, legend_above, own_axes
from calib.report.svg import hover, hover_points
from calib.results.answer import with_std

_PRIOR = "#E8E8E8"
_INTERVAL = 1.96
"""Half-width of an interval of 95 % in standard deviations."""
_APART = 0.01
"""Distance over the search range from which a cross is seen beside the dot."""


def draw_parameters(
    table: pd.DataFrame,
    ax: Axes | None = None,
    best_case: str | None = None,
    prior: pd.DataFrame | None = None,
    with_misfit: pd.DataFrame | None = None,
) -> Axes:
    """Draw prior and posterior of every calibrated parameter between its limits.

    Parameters
    ----------
    table : DataFrame
        Columns ``case, parameter, value, unit``, ``ratio`` (position between the limits, 0 to 1) and ``on_limit``.
        Optional: ``lower, upper`` (the limits), ``scale`` (``log`` where positions are along logarithms), ``std``
        (posterior standard deviation, NaN if unknown), ``low, high`` (interval of 95 %; by default 1.96 of it to both
        sides) and ``identified`` (bool, or None).
    ax : Axes, optional
    best_case : str, optional
        The case that is reported; by default the first.
    prior : DataFrame, optional
        Columns ``parameter, value`` (nominal), ``prior_sd``, in the same units; NaN where unknown.
    with_misfit : DataFrame, optional
        Columns ``parameter, low_unexplained, high_unexplained``: intervals that know of the misfit of a rejected model.

    Returns
    -------
    Axes
        In each row, from the lower limit at 0 to the upper at 1: a grey band of two prior standard deviations about the
        nominal value (an open diamond), the reported value with its 95 % interval, filled where it is identified, and
        small crosses at the values of the other cases. The value and its standard deviation stand at the right,
        in a column over the row.
    """
    names, cases = list(dict.fromkeys(table["parameter"])), list(dict.fromkeys(table["case"]))
    best_case = best_case if best_case in cases else cases[0]
    best = table[table["case"] == best_case].set_index("parameter").reindex(names)
    named = [f"{name} (log)" if log else str(name) for name, log in zip(names, _logs(best), strict=True)]
    top, _ = row_edges(named)
    ax = own_axes(ax, 1.3 + rows_height(named, 0.36))
    rows, place = np.arange(len(names)), best["ratio"].to_numpy(dtype=float)
    std = best["std"].to_numpy(dtype=float) if "std" in best else np.full(len(names), np.nan)
    reach = _INTERVAL * _share(best, best["value"], std)
    known = [_flag(value) for value in best["identified"]] if "identified" in best else [None] * len(names)
    nominal = _draw_prior(ax, best, prior)
    has = np.isfinite(reach)
    low, high = place - reach, place + reach
    if "low" in best and "lower" in best:
        low, high = (position(best, best[end]) for end in ("low", "high"))
    low, high = (np.clip(end[has], 0.0, 1.0) for end in (low, high))
    ax.hlines(rows[has], low, high, color=BLUE, linewidth=2.6, gid="posterior", zorder=3)
    wide = _draw_with_misfit(ax, best, with_misfit)
    dot: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": BLUE, "markersize": 7.5, "markeredgewidth": 1.6}
    for flag, face in ((True, BLUE), (False, "white"), (None, BLUE)):
        some = [value is flag for value in known]
        ax.plot(place[some], rows[some], gid=f"identified {flag}", zorder=5, **{**dot, "markerfacecolor": face})
    others = table[table["case"] != best_case]
    at = others["parameter"].map({name: row for row, name in enumerate(names)})
    ax.plot(others["ratio"], at, "x", color=GREY, markersize=5, markeredgewidth=1.2, gid="other cases", zorder=4)
    bound = np.array([_flag(value) is True for value in best["on_limit"]])
    edge = np.where(place[bound] > 0.5, 1.02, -0.02)
    (marks,) = ax.plot(edge, rows[bound], "d", color=VERMILLION, markersize=6, gid="on_limit", clip_on=False, zorder=5)
    marks.set_in_layout(bool(bound.any()))  # without any it would need room at the origin
    texts, words, beside = list[str](), [], 1.05  # clear of the marks at the limits
    for row, (name, value) in enumerate(best.iterrows()):
        unit, width = str(value["unit"]), std[row]
        text = with_std(value["value"], width, "" if unit == "-" else f" {unit}").replace("-", "−")
        text = with_unit(value["value"], unit) if math.isnan(width) else text
        colour = GREY if known[row] is False else BLACK
        if not in_column():
            ax.text(beside, row, text, va="center", fontsize=8, color=colour)
        texts.append(text)
        words.append(f"{name}, {best_case}: {text}, at {fixed(place[row], 2)} of its search range")
        if row:
            ax.axhline(row + top, color="#E3E3E3", linewidth=0.6)
    hover_points(ax, place, rows, words)
    name_rows(ax, named, texts)
    ax.set(xlim=(-0.03, 1.03), ylim=(len(names) + top + 0.05, top - 0.05))
    ax.set_xticks(np.linspace(0.0, 1.0, 6))
    ax.set_xlabel("position between the lower (0) and the upper search limit (1)")
    for side in (0.0, 1.0):
        ax.axvline(side, color=BLACK, linewidth=0.9)
    ax.grid(axis="x")
    handles: list[Any] = []
    label = f"{best_case}: value and 95 % interval" if len(cases) > 1 else "value and 95 % interval"
    label = label if has.any() else str(best_case)
    any_known = any(value is not False for value in known)
    if not any_known:
        label += ", not identified"
    handles.append(
        Line2D([], [], label=label, **{**dot, "linestyle": "-", "markerfacecolor": BLUE if any_known else "white"})
    )
    if any_known and False in known:
        handles.append(Line2D([], [], label="not identified", **{**dot, "markerfacecolor": "white"}))
    if wide:
        handles.append(Line2D([], [], color=ORANGE, linewidth=1.4, label="95 % interval with the misfit"))
    if nominal:
        look: dict[str, Any] = {"linestyle": "none", "marker": "D", "color": GREY, "markerfacecolor": "white"}
        handles += [Patch(color=_PRIOR, label="prior ± 2 std"), Line2D([], [], label="nominal value", **look)]
    if (np.abs(others["ratio"] - place[at.to_numpy(dtype=int)]) > _APART).any():
        handles.append(Line2D([], [], linestyle="none", marker="x", color=GREY, label="other cases"))
    if bound.any():
        handles.append(Line2D([], [], linestyle="none", marker="d", color=VERMILLION, label="at a search limit"))
    legend_above(ax, handles)
    return ax


def position(limits: pd.DataFrame, values: pd.Series[float]) -> np.ndarray:
    """Places of values between the limits along the scale, (n,).

    Parameters
    ----------
    limits : DataFrame (n, ...)
        Columns ``lower, upper``, and ``scale`` where one may be logarithmic.
    values : Series (n,)
    """
    log = _logs(limits)
    low, high, at = (column.to_numpy(dtype=float) for column in (limits["lower"], limits["upper"], values))
    with np.errstate(invalid="ignore", divide="ignore"):
        low, high, at = (np.where(log, np.log(np.where(log, x, 1.0)), x) for x in (low, high, at))
        return np.asarray((at - low) / (high - low))


def _logs(limits: pd.DataFrame) -> np.ndarray:
    """Which rows have a logarithmic scale, (n,)."""
    return (limits["scale"] == "log").to_numpy() if "scale" in limits else np.zeros(len(limits), dtype=bool)


def _share(limits: pd.DataFrame, values: pd.Series[float], change: np.ndarray) -> np.ndarray:
    """Small changes at some values as a share of the way between the limits, (n,); NaN without limits."""
    if "upper" not in limits:
        return np.full(len(limits), np.nan)
    lower, upper = (limits[end].to_numpy(dtype=float) for end in ("lower", "upper"))
    with np.errstate(invalid="ignore", divide="ignore"):
        whole = np.where(_logs(limits), values.to_numpy(dtype=float) * np.log(upper / lower), upper - lower)
    return np.asarray(change / whole)


def _draw_prior(ax: Axes, best: pd.DataFrame, prior: pd.DataFrame | None) -> bool:
    """Draw band and nominal value of each row; whether there are any."""
    if prior is None:
        return False
    known = prior.set_index("parameter").reindex(best.index)
    nominal = position(best, known["value"])
    reach = 2.0 * _share(best, known["value"], known["prior_sd"].to_numpy(dtype=float))
    rows = np.arange(len(best))
    has = np.isfinite(nominal) & np.isfinite(reach)
    low, high = np.clip(nominal[has] - reach[has], 0.0, 1.0), np.clip(nominal[has] + reach[has], 0.0, 1.0)
    bands = ax.barh(rows[has], high - low, 0.4 if in_column() else 0.6, left=low, color=_PRIOR, gid="prior", zorder=1)
    for band, (name, row) in zip(bands, known[has].iterrows(), strict=True):
        words = f"nominal {significant(row['value'])}, prior standard deviation {significant(row['prior_sd'])}"
        hover(band, f"{name}: {words}")
    ax.plot(nominal, rows, "D", color=GREY, markerfacecolor="white", markersize=4.5, gid="nominal", zorder=2)
    return bool(np.isfinite(nominal).any())


def _draw_with_misfit(ax: Axes, best: pd.DataFrame, table: pd.DataFrame | None) -> bool:
    """Draw the interval with the misfit of each row; whether there are any."""
    if table is None or "lower" not in best:
        return False
    known, rows = table.set_index("parameter").reindex(best.index), np.arange(len(best))
    low, high = (position(best, known[f"{end}_unexplained"]) for end in ("low", "high"))
    has = np.isfinite(low) & np.isfinite(high)
    ends = (np.clip(end[has], 0.0, 1.0) for end in (low, high))
    ax.hlines(rows[has] + 0.22, *ends, color=ORANGE, linewidth=1.4, gid="with the misfit", zorder=3)
    return bool(has.any())


def _flag(value: Any) -> bool | None:
    """A flag; None where unknown."""
    return None if value is None or pd.isna(value) else bool(value)
