"""Pictures of what designs have in common: correlations, histograms, the way of searches, and the range of the best."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from calib.report import style
from calib.report.designs import numeric_columns
from calib.report.parameters import position

_BINS = 30
MOST_PANELS = 24
"""Histograms of one figure."""


def correlations(
    table: pd.DataFrame, rows: Sequence[str], columns: Sequence[str], log: Collection[str] = ()
) -> dict[str, pd.DataFrame]:
    """Correlation of columns of designs: linear, of ranks, and quadratic.

    Parameters
    ----------
    table : DataFrame
        One row a design; of every pair the rows that have both values count.
    rows, columns : sequence of str
    log : collection of str
        Columns of whose decimal logarithms the linear and the quadratic one are.

    Returns
    -------
    dict of str to DataFrame
        ``linear``, ``rank`` and ``quadratic``, each with the column ``parameter`` (the rows) and ``columns``. The
        quadratic one is the root of the share of the variance of a column that a parabola in the row explains, 0 to 1.
        NaN where fewer than 4 designs have both, or one of them never changes.
    """
    names = list(dict.fromkeys([*rows, *columns]))
    values = numeric_columns(table, names)
    for name in set(log) & set(names):
        values[name] = np.log10(values[name])
    out = {kind: np.full((len(rows), len(columns)), np.nan) for kind in ("linear", "rank", "quadratic")}
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            x, y = values.loc[values[[row, column]].notna().all(axis=1), [row, column]].to_numpy(dtype=float).T
            if len(x) < 4 or np.ptp(x) == 0 or np.ptp(y) == 0:
                continue
            z = (x - x.mean()) / x.std()
            fitted = np.polyval(np.polyfit(z, y, 2), z)
            out["linear"][i, j] = np.corrcoef(x, y)[0, 1]
            out["rank"][i, j] = stats.spearmanr(x, y).statistic
            out["quadratic"][i, j] = math.sqrt(max(0.0, 1.0 - float(((y - fitted) ** 2).sum() / (y.var() * len(y)))))
    known = {kind: pd.DataFrame(matrix, columns=list(columns)) for kind, matrix in out.items()}
    for matrix in known.values():
        matrix.insert(0, "parameter", list(rows))
    return known


def nearest_density(values: np.ndarray) -> tuple[str, Any]:
    """Name and frozen distribution, of normal, log-normal and uniform, that is nearest to values (n,).

    Each has the moments, or ends, of the values; the smallest distance of the distribution functions decides
    (Kolmogorov).
    """
    found: dict[str, Any] = {"normal": stats.norm(values.mean(), values.std() or 1e-300)}
    if values.min() > 0:
        logs = np.log(values)
        found["log-normal"] = stats.lognorm(logs.std() or 1e-300, scale=math.exp(logs.mean()))
    found["uniform"] = stats.uniform(values.min(), np.ptp(values) or 1e-300)
    ordered, n = np.sort(values), len(values)

    def distance(name: str) -> float:
        below = found[name].cdf(ordered)
        return float(max(np.max(np.arange(1, n + 1) / n - below), np.max(below - np.arange(n) / n)))

    best = min(found, key=distance)
    return best, found[best]


def histograms_figure(
    table: pd.DataFrame,
    columns: Sequence[str],
    labels: Mapping[str, str] = MappingProxyType({}),
    log: Collection[str] = (),
) -> Figure:
    """Draw a histogram of each column with the nearest density, see `nearest_density`.

    Parameters
    ----------
    table : DataFrame
        One row a design; missing values are left out.
    columns : sequence of str
        Those that change, at most `MOST_PANELS`, are drawn.
    labels, log
        As in `calib.report.designs.draw_anthill`; of a logarithmic axis the cells are equally wide on it.
    """
    values = {name: numeric_columns(table, [name])[name].dropna().to_numpy(dtype=float) for name in columns}
    shown = [name for name, own in values.items() if len(own) > 1 and np.ptp(own) > 0][:MOST_PANELS]
    figure, panels = style.new_panels(len(shown), 1.8, 0.6)
    for ax, name in zip(panels.flat, shown, strict=False):
        own = values[name]
        ends = own.min(), own.max()
        edges = np.geomspace(*ends, _BINS + 1) if name in log else np.linspace(*ends, _BINS + 1)
        ax.hist(own, edges, density=True, color=style.BLUE, alpha=0.6, gid="designs")
        kind, density = nearest_density(own)
        at = np.geomspace(*ends, 200) if name in log else np.linspace(*ends, 200)
        ax.plot(at, density.pdf(at), color=style.VERMILLION, linewidth=1.3, gid=kind)
        ax.set(xscale="log" if name in log else "linear", yticks=[])
        ax.set_title(f"{labels.get(name, name)}\n{len(own)} designs, line: {kind}", fontsize=8, loc="left")
        ax.tick_params(labelsize=7)
        if name not in log:
            ax.locator_params(axis="x", nbins=3)
    return figure


def draw_history(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the objective over the generations of every search: the best so far, and the middle half of each generation.

    Parameters
    ----------
    table : DataFrame
        Columns ``case, generation, objective``; designs of no generation are left out.
    ax : Axes, optional
    """
    known = numeric_columns(table, ["generation", "objective"]).assign(case=table["case"].astype(str)).dropna()
    ax = style.own_axes(ax, 3.6)
    for k, (case, own) in enumerate(known.groupby("case", sort=True)):
        by = own.groupby("generation")["objective"]
        best, low, high = by.min().cummin(), by.quantile(0.25), by.quantile(0.75)
        colour = style.CASES[k % len(style.CASES)]
        ax.fill_between(low.index, low, high, color=colour, alpha=0.2, linewidth=0, gid=f"spread {case}")
        ax.plot(best.index, best, color=colour, linewidth=1.5, label=f"{case}: best so far", gid=f"best {case}")
    ax.set(xlabel="generation", ylabel="objective", yscale="log" if (known["objective"] > 0).all() else "linear")
    ax.set_title("line: best so far; band: middle half of the generation", loc="left", fontsize=9)
    if len(known):
        ax.legend(fontsize=8)
    ax.grid(True)
    return ax


def draw_box(table: pd.DataFrame, limits: pd.DataFrame, best: int, ax: Axes | None = None) -> Axes:
    """Draw the ranges of all designs and of the best ones between the limits of each parameter, as boxes.

    Parameters
    ----------
    table : DataFrame
        One row a design, the best first, with a column for every parameter.
    limits : DataFrame
        Columns ``parameter, lower, upper, scale``.
    best : int
        Designs of the second box.
    ax : Axes, optional

    Returns
    -------
    Axes
        Boxes hold the middle half with the median, whiskers reach to the least and the largest.
    """
    names = [name for name in limits["parameter"] if name in table]
    rows = limits.set_index("parameter").loc[names].reset_index()
    values = numeric_columns(table, names).dropna()
    place = np.column_stack([
        position(rows.iloc[[k] * len(values)], values[name]) for k, name in enumerate(names)
    ])  # fmt: skip
    ax = style.own_axes(ax, 1.2 + 0.5 * len(names))
    for shift, data, colour, label in (
        (-0.18, place, style.GREY, f"all {len(values)} designs"),
        (0.18, place[:best], style.VERMILLION, f"the best {min(best, len(values))}"),
    ):
        rows_at = np.arange(len(names)) + shift
        least, low, middle, high, most = np.quantile(data, [0.0, 0.25, 0.5, 0.75, 1.0], axis=0)
        ax.hlines(rows_at, least, most, color=colour, linewidth=1.2, gid=f"reach of {label}")
        ax.barh(rows_at, high - low, 0.28, left=low, facecolor="white", edgecolor=colour, linewidth=1.2, zorder=2)
        ax.plot(middle, rows_at, "|", color=colour, markersize=10, markeredgewidth=2.0, label=label, zorder=3)
    log = rows["scale"] == "log"
    ax.set_yticks(range(len(names)), [f"{n} (log)" if one else n for n, one in zip(names, log, strict=True)])
    ax.set(xlim=(-0.03, 1.03), ylim=(len(names) - 0.4, -0.6))
    ax.set_xlabel("position between the lower (0) and the upper search limit (1)")
    ax.grid(axis="x")
    style.legend_above(ax)
    return ax
