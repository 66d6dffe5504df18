"""Figures of scalar responses: errors of the model, and residuals after a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.container import BarContainer

from calib.report.numbers import percent, with_unit
from calib.report.style import AFTER, ATTEMPT, BEFORE, BLACK, WITH, added, legend_above, own_axes, plain, stage_words
from calib.report.svg import hover

_LOOKS = {
    "before": {"facecolor": BEFORE, "hatch": "////", "edgecolor": "white"},
    "after": {"facecolor": AFTER},
    "added": {"facecolor": WITH, "hatch": "....", "edgecolor": "white"},
    "attempt": ATTEMPT,
}
_MOST_VALUES = 30
"""Bars that still have their values beside them."""
_MOST_UPRIGHT = 6
"""Responses whose bars stand side by side, their names level below; more lie one below the other."""
_HIGHEST = 9.0
"""Height of the figure of very many responses, in inches."""


def draw_responses(
    before: pd.DataFrame | None,
    after: pd.DataFrame | None = None,
    ax: Axes | None = None,
    *,
    added: pd.DataFrame | None = None,
    effects: str = "",
) -> Axes:
    """Draw the error of every scalar response, before and after calibration, with its value and error in percent.

    Parameters
    ----------
    before, after, added : DataFrame, optional
        Columns ``response, measured, model``, ``error`` (relative to the response) and ``error_in_std`` (NaN where no
        standard deviation is known); optional ``unit``.
    ax : Axes, optional
    effects : str
        Names of effects that were added after this calibration, for the legend.

    Returns
    -------
    Axes
        Bars in standard deviations where any are known, otherwise in percent of the response. Beside each bar stand the
        model's value and its error in percent, beside the name what was measured, both in the response's unit, where
        there is room for them. Bars of
        more than six responses lie.
    """
    stages = {"before": before, "after": after, "added": added}
    tables = {stage: table.set_index("response") for stage, table in stages.items() if table is not None}
    in_std = any(table["error_in_std"].notna().any() for table in tables.values())
    column, factor = ("error_in_std", 1.0) if in_std else ("error", 100.0)
    label = "error, model − measured " + ("(standard deviations)" if in_std else "(%)")
    bars = {stage_words(stage, effects): (stage, factor * table[column]) for stage, table in tables.items()}
    ax = _bars(bars, label, ax)
    values = {stage_words(stage, effects): table for stage, table in tables.items()}
    if sum(map(len, values.values())) <= _MOST_VALUES:
        _write_values(ax, values)
    return ax


def _write_values(ax: Axes, tables: Mapping[str, pd.DataFrame]) -> None:
    """Write model value and error in percent beside every bar, and the measured value beside the name."""
    names = list(dict.fromkeys(name for table in tables.values() for name in table.index))
    level = len(names) <= _MOST_UPRIGHT
    apart = "\n" if level else ", "
    units = {name: unit for table in tables.values() for name, unit in _units(table).items()}
    for bars, table in zip(ax.containers, tables.values(), strict=True):
        known = table.reindex(names)
        texts = [
            "" if pd.isna(value) else f"{with_unit(value, units[name], 4)}{apart}{percent(error, 1, sign=True)} %"
            for name, value, error in zip(names, known["model"], known["error"], strict=True)
        ]
        ax.bar_label(cast(BarContainer, bars), texts, fontsize=6.5, padding=3)
    measured = pd.concat([table["measured"] for table in tables.values()]).groupby(level=0, sort=False).first()
    shown = [f"{name}{apart}measured {with_unit(measured[name], units[name], 4)}" for name in names]
    (ax.set_xticks if level else ax.set_yticks)(range(len(names)), shown)
    if level:
        ax.margins(y=0.16)
    else:
        ax.margins(x=0.3)


def _units(table: pd.DataFrame) -> dict[str, str]:
    """Unit of each response, empty for one without."""
    units = table["unit"].fillna("") if "unit" in table else [""] * len(table)
    return {str(name): str(unit) for name, unit in zip(table.index, units, strict=True)}


def draw_response_misfit(table: pd.DataFrame, ax: Axes | None = None, *, name: str = "") -> Axes:
    """Draw the residual of every response after the fit.

    Parameters
    ----------
    table : DataFrame
        Columns ``stage`` (``base``, ``explained`` or ``attempt``), ``response``, ``residual`` in standard deviations.
    ax : Axes, optional
    name : str
        The effects in the extended model, for the legend.
    """
    looks = {"base": "after", "explained": "added", "attempt": "attempt"}
    bars = {
        added(stage, name): (look, table[table["stage"] == stage].set_index("response")["residual"])
        for stage, look in looks.items()
        if (table["stage"] == stage).any()
    }
    return _bars(bars, "residual, measured − model (standard deviations)", ax)


def _bars(series: dict[str, tuple[str, pd.Series]], label: str, ax: Axes | None) -> Axes:
    """Bars of each series beside each other, of many responses one below the other; NaN has no bar."""
    names = list(dict.fromkeys(name for _, values in series.values() for name in values.index))
    level = len(names) <= _MOST_UPRIGHT
    below = (0.12 + 0.13 * len(series)) * len(names)
    ax = own_axes(ax, 3.0 if level else float(np.clip(1.0 + below, 3.0, _HIGHEST)))
    width = 0.8 / max(len(series), 1)
    for k, (words, (look, values)) in enumerate(series.items()):
        own = values.reindex(names)
        at = np.arange(len(names)) + (k - (len(series) - 1) / 2) * width
        bars = (ax.bar if level else ax.barh)(at, own, width, label=words, **_LOOKS[look])
        for bar, (name, value) in zip(bars, own.items(), strict=True):
            hover(bar, f"{name}, {words}: {plain(value)}")
    ends = (-0.6, max(len(names), 1) - 0.4)
    if level:
        ax.axhline(0.0, color=BLACK, linewidth=0.8)
        ax.set_xticks(range(len(names)), names)
        ax.set(xlim=ends, ylabel=label.replace(" (", "\n("))
    else:
        ax.axvline(0.0, color=BLACK, linewidth=0.8)
        ax.set_yticks(range(len(names)), names)
        ax.set(ylim=ends[::-1], xlabel=label)
    ax.grid(axis="y" if level else "x")
    ax.tick_params(axis="x" if level else "y", length=0)
    legend_above(ax)
    return ax
