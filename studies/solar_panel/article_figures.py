"""Figures of `article.py`, each drawn from its table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from calib.report.style import AFTER, BEFORE, BLACK, CASES, GREY, PURPLE, legend_above, new_figure, own_axes
from calib.study.loading import module_of

figure_set = module_of(Path(__file__).resolve().parent.parent / "figure_set.py")

COLOURS = {"proposed": AFTER, "traditional": PURPLE}
LEVELS = {0: "0 (Guyan)", 1: "1 (IRS)"}
ROUNDING = 2e-7
"""Error in % below which the eigensolver's rounding shows; such errors are not drawn."""


def draw_reduction(ax: Axes | None, table: pd.DataFrame) -> Axes:
    """Frequency error of the reduced model by order, one line a level (`reduction`)."""
    ax = own_axes(ax, 2.9)
    for (level, own), colour in zip(table.groupby("level"), CASES, strict=False):
        seen = own["error"].where(own["error"] > ROUNDING)
        ax.plot(own["order"], seen, "o-", color=colour, markersize=4, label=LEVELS.get(level, str(level)))
    ax.set(yscale="log", xlabel="order of the natural frequency", ylabel="frequency error (%)", ylim=(ROUNDING, 10))
    ax.set_xticks(sorted(table["order"].unique()))
    ax.grid(axis="y")
    legend_above(ax)
    lost = table["error"].le(ROUNDING).sum()
    words = f"not drawn: {lost} errors below 2 × 10⁻⁷ %, which is rounding"
    ax.text(0.01, 0.03, words, transform=ax.transAxes, fontsize=8, color=GREY)
    return ax


def convergence_figure(table: pd.DataFrame) -> Figure:
    """Frequency errors of six orders at the start and after each step: median and largest of the seeds."""
    figure = new_figure(4.1)
    panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    for ax, (order, own) in zip(panels, table.groupby("order"), strict=False):
        for iteration, colour in COLOURS.items():
            one = own[own["iteration"] == iteration]
            ax.plot(one["step"], one["median"], "-", color=colour, label=f"{iteration}, median")
            ax.plot(one["step"], one["worst"], ":", color=colour, label=f"{iteration}, worst")
        ax.set_title(f"order {order}")
        ax.set_xticks([0, 5, 10, 15])
        ax.grid(axis="y")
    panels[0].set(yscale="log", ylim=(0.5, 25))
    panels[0].yaxis.set_major_locator(FixedLocator([0.5, 1, 2, 5, 10, 20]))
    panels[0].yaxis.set_minor_locator(NullLocator())
    panels[0].yaxis.set_major_formatter(ScalarFormatter())
    figure.supxlabel("step of the iteration, 0: before", fontsize=9)
    figure.supylabel("frequency error (%)", fontsize=9)
    panels[0].legend(loc="upper right", labelspacing=0.2)
    return figure


def draw_factors(ax: Axes | None, runs: pd.DataFrame) -> Axes:
    """Factor of each Young's modulus that each seed gives, and the true one (`runs` of one offset, `factors`)."""
    ax = own_axes(ax, 3.0)
    groups = [column for column in runs if column.startswith("E_")]
    for shift, (iteration, colour) in zip((-0.2, 0.2), COLOURS.items(), strict=True):
        own = runs[(runs["iteration"] == iteration)].sort_values("seed")
        aside = shift + np.linspace(-0.12, 0.12, len(own))
        for k, group in enumerate(groups):
            ax.plot(k + aside, own[group], "o", color=colour, markersize=2.6, label=iteration if k == 0 else None)
    ax.set(yscale="log", ylabel="factor of the Young's modulus", xlim=(-0.5, len(groups) - 0.5))
    ax.yaxis.set_major_locator(FixedLocator([0.5, 0.7, 1, 1.5, 2, 3, 4]))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(ScalarFormatter())
    ax.set_xticks(range(len(groups)), [group[2:].replace("_", " ") for group in groups])
    ax.grid(axis="y")
    return ax


def draw_true_factors(ax: Axes, factors: pd.DataFrame) -> Axes:
    """True factors as lines across each group, and the legend (`factors`)."""
    true = factors.drop_duplicates("parameter")["true"]
    ax.hlines(true, np.arange(len(true)) - 0.42, np.arange(len(true)) + 0.42, color=BLACK, linewidth=1, label="true")
    legend_above(ax)
    return ax


def functions_figure(table: pd.DataFrame) -> Figure:
    """|H(1, 12)| of the experiment and of the model, above before and below after updating (`functions`)."""
    figure = new_figure(4.6)
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    upper.plot(table["freq"], table["experiment"], color=GREY, linewidth=2.2, label="experiment")
    upper.plot(table["freq"], table["before"], color=BEFORE, linewidth=1, label="initial model")
    lower.plot(table["freq"], table["experiment"], color=GREY, linewidth=2.2, label="experiment")
    for iteration, look in (("traditional", {"color": PURPLE, "linestyle": "--"}), ("proposed", {"color": AFTER})):
        if iteration in table:
            lower.plot(table["freq"], table[iteration], linewidth=1, label=f"updated model, {iteration}", **look)
    for ax in (upper, lower):
        ax.set(yscale="log", ylabel="|H(1, 12)| (m/N)", xlim=(0, table["freq"].max()))
        ax.grid(axis="y")
        legend_above(ax)
    lower.set_xlabel("frequency (Hz)")
    return figure


def _factors_of(folder: Path) -> Figure:
    runs, factors = _read(folder, "runs"), _read(folder, "factors")
    runs = runs[runs["offset"] == runs["offset"].iloc[0]]
    return draw_true_factors(draw_factors(None, runs), factors).figure


FIGURES: dict[str, tuple[str, Callable[[Path], Figure]]] = {
    "reduction": ("error of the reduction by its level", lambda f: draw_reduction(None, _read(f, "reduction")).figure),
    "convergence": ("frequency errors under noise", lambda f: convergence_figure(_read(f, "convergence"))),
    "factors": ("factors under noise", _factors_of),
    "functions": (
        "H(1, 12) before and after, median draws",
        lambda f: functions_figure(_read(f, "functions")),
    ),
}
"""Caption and drawing of each figure, from a folder of tables."""
MEASURED = ("convergence", "factors", "functions")
"""Figures that show a synthetic measurement; the others are of the model alone."""
SET = figure_set.FigureSet("Example of Li and Hong (2012)", FIGURES, "functions", MEASURED)


def _read(folder: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / f"{name}.csv")
