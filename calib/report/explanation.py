"""Figures of the candidate effects: evidence, visibility with these data, and collinearity."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from calib.report import style
from calib.report.numbers import fixed, flag, probability, short, significant
from calib.report.rows import name_rows, row_edges, rows_height, run_on
from calib.report.svg import hover, hover_cells, hover_points

LEAST_BAYES_FACTOR = 3.0
"""ln Bayes factor from which one explanation counts as better than another."""
COLLINEAR = 0.9
"""Correlation above which two signatures count as collinear."""
MOST = 40
"""Effects that are drawn; of more, such as generic ones, those with most evidence."""
_MATRIX = 24
"""Effects of the matrix of correlations, each with room for a name on two lines."""
_NUMBERED = 16
"""Effects of a matrix whose cells have room for a number."""
_WIDE = 60.0
"""Largest log Bayes factor that is drawn on a linear axis."""
_OVER = 44
"""Letters of a line of a name over its row."""
_LABEL = 0.12
"""Least distance of two ticks, over the width of the axis."""
_TICKS = (-3000, -1000, -300, -100, -30, 0, 10, 50, 100, 300, 1000, 3000, 10000, 30000, 100000)
"""Marks of an axis of roots."""
_NOTE_LINE = 58
"""Letters of a line of it in a column."""
_NOTE = (
    "z: score of the effect; noise alone exceeds ±2 in 5 % of cases; negative: the data ask for a negative magnitude.\n"
    "Right: an effect in the shaded range would be visible only beyond its plausible magnitude; arrow: at none."
)
_TOGETHER = "Effects named together have the evidence and the probability of the model with all of them."
_LOOKS: dict[str, dict[str, Any]] = {
    "candidates left": {"facecolor": style.ORANGE},
    "refitted": {"facecolor": style.BLUE},
    "not refitted: linear estimate": {"facecolor": "#CFE6F5", "edgecolor": style.SKY, "linewidth": 0.8},
    "not visible with these data": {"facecolor": style.REST},
}


def blank(ax: Axes, words: str) -> Axes:
    """Write into empty Axes why nothing is drawn, and return them."""
    ax.set_axis_off()
    ax.text(0.5, 0.5, words, transform=ax.transAxes, ha="center", va="center", color=style.GREY)
    return ax


def ranked(table: pd.DataFrame) -> pd.DataFrame:
    """Return the effects by decreasing ``ln_bayes``, those without a value last."""
    return table.sort_values("ln_bayes", ascending=False, kind="stable", na_position="last", ignore_index=True)


def draw_ranked_effects(table: pd.DataFrame, ax: Axes | None = None, *, legend: bool = True) -> Axes:
    """Draw the evidence for every effect.

    Parameters
    ----------
    table : DataFrame
        Columns ``name, title``, ``ln_bayes`` (against the base model), ``ln_bayes_third, ln_bayes_triple`` (the same
        with a third and three times the prior width), the flags ``refitted, credible, visible``, and ``implausible``
        (why the refitted model is implausible; empty when it is not). NaN where unknown.
    ax : Axes, optional
    legend : bool
        Whether a legend stands above the Axes.

    Returns
    -------
    Axes
        One dot per effect, the strongest evidence first, with its value, and a cross where the refitted model is
        implausible; thin lines span the prior widths.
        The dashed line is the threshold of the ln Bayes factor for one of n effects, ln n + 3; values below it stand at
        its right. The axis goes by the root, as the score does, where an absolute value exceeds 60. Labels of effects
        that are not visible are grey.
    """
    rows = ranked(table).head(MOST)
    ax = style.own_axes(ax, _height(rows))
    if rows.empty:
        return blank(ax, "no effect was tested")
    values = rows["ln_bayes"].to_numpy(dtype=float)
    looks, seen, limit = _looks(rows), _flags(rows["visible"]), threshold(len(table))
    odd_ones = [bool(words) for words in rows["implausible"].fillna("")]
    spans = rows[["ln_bayes_third", "ln_bayes", "ln_bayes_triple"]].to_numpy(dtype=float)
    ax.axvline(0.0, color=style.BLACK, linewidth=0.8)
    for row, (value, look, odd, span, visible) in enumerate(zip(values, looks, odd_ones, spans, seen, strict=True)):
        mark: dict[str, Any] = {"marker": "X" if odd else "o", "s": 62, "zorder": 4, "gid": look}
        dot = ax.scatter([value], [row], **mark, **_LOOKS[look])
        hover(dot, f"{rows['name'][row]}: evidence {fixed(value, 1)}, {look}" + (", implausible" if odd else ""))
        known = span[np.isfinite(span)]
        if len(known) > 1:
            ax.plot([known.min(), known.max()], [row, row], color=style.BLACK, linewidth=1.1, gid="prior", zorder=3)
        words = (short(value) if abs(value) >= 0.01 else "0") if math.isfinite(value) else "no value"
        # Beside its dot, but right of the threshold, which it would otherwise cover.
        end = max(0.0, *known) if len(known) else 0.0
        ax.annotate(
            words + (" implausible" if odd else ""),
            (max(end, limit), row),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
            color=style.GREY if not visible else style.VERMILLION if odd else style.BLACK,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 0.6},
            zorder=4,
        )
    ax.axvline(limit, color=style.BLACK, linestyle="--", linewidth=1.0, gid="threshold")
    everything = np.append(spans[np.isfinite(spans)], [0.0, limit])
    low, high = float(everything.min()), float(everything.max())
    label = "evidence (log Bayes factor)"
    if high > _WIDE or low < -_WIDE:
        ax.set_xscale("function", functions=(_root, _square))
        # The value and a word stand beside the largest.
        left, right = min(1.3 * low, -2.0), (4.0 if style.in_column() else 2.2) * max(high, 100.0)
        ax.set_xlim(left, right)
        ticks = _apart([t for t in _TICKS if left <= t <= right], left, right)
        ax.set_xticks(ticks, [f"{t:g}".replace("-", "−") for t in ticks])
        label += "\non a scale of square roots"
    else:
        ax.set_xlim(low - 0.03 * (high - low), high + (0.6 if style.in_column() else 0.3) * (high - low))
    _name_rows(ax, rows)
    ax.set_xlabel(label)
    if legend:
        style.legend_above(ax, _handles(rows))
    return ax


def draw_visibility(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the smallest magnitude at which these data would show each effect, over its plausible magnitude.

    Parameters
    ----------
    table : DataFrame
        Columns ``name, title, ln_bayes`` (for the order), ``z``, ``magnitude_min`` (infinite when never visible) and
        ``plausible``, both in the unit of the effect, the flag ``visible``, and ``model_probability`` (NaN where
        unknown).
    ax : Axes, optional

    Returns
    -------
    Axes
        One dot per effect on a logarithmic axis, open when the effect is not visible; an arrow at the edge where no
        magnitude would be visible. The score z and the model probability within the library stand at the right.
    """
    rows = ranked(table).head(MOST)
    ax = style.own_axes(ax, _height(rows))
    if rows.empty:
        return blank(ax, "no effect was tested")
    ratio = (rows["magnitude_min"] / rows["plausible"]).to_numpy(dtype=float)
    at, known = np.arange(len(rows)), np.isfinite(ratio) & (ratio > 0.0)
    low, high = (min(0.1, *ratio[known]), max(10.0, *ratio[known])) if known.any() else (0.1, 10.0)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.set_xlim(low / 1.6, high * 2.5)
    ax.axvline(1.0, color=style.BLACK, linewidth=1.0, gid="plausible")
    ax.axvspan(1.0, high * 2.5, color="#F2F2F2", zorder=0)
    seen = np.array(_flags(rows["visible"]))
    for visible, face in ((True, style.BLACK), (False, "white")):
        shown = known & (seen == visible)
        edge = style.BLACK if visible else style.GREY
        gid = "visible" if visible else "not visible"
        ax.plot(ratio[shown], at[shown], "o", color=edge, markerfacecolor=face, markersize=6, gid=gid, zorder=3)
    what = "smallest visible magnitude over the plausible one"
    words = [f"{n}: {what} {significant(r, 2)}" for n, r in zip(rows["name"], ratio, strict=True)]
    hover_points(ax, np.where(known, ratio, np.nan), at, words)
    never = np.isposinf(ratio)
    ax.plot(np.full(never.sum(), high * 1.9), at[never], ">", color=style.GREY, markersize=6, gid="never")
    told = [
        ("–" if pd.isna(z) else f"{z:.1f}".replace("-", "−"), probability(share))
        for z, share in zip(rows["z"], rows["model_probability"], strict=True)
    ]
    _name_rows(ax, rows, [f"z {z}, {likely}" for z, likely in told])
    if not style.in_column():
        for row, (z, likely) in enumerate(told):
            _beside(ax, row, z, likely, style.BLACK if seen[row] else style.GREY)
        _beside(ax, -0.8, "z", "probability", style.GREY)
    on_page = "smallest visible magnitude /\nplausible magnitude (–)"
    ax.set_xlabel("smallest visible\nmagnitude / plausible\nmagnitude (–)" if style.in_column() else on_page)
    return ax


def ranked_effects_figure(table: pd.DataFrame) -> Figure:
    """Draw `draw_ranked_effects` and `draw_visibility` side by side, one row per effect."""
    handles = _handles(table) if len(table) else []
    abreast, more = (1, 0.6) if style.in_column() else (2, 0.4)
    over_height, height = 0.2 * math.ceil(len(handles) / abreast), _height(ranked(table).head(MOST)) + more
    figure = style.new_figure(height + over_height)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0), height_ratios=(over_height or 0.1, height))
    over, left = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    right = figure.add_subplot(grid[1, 1], sharey=left)
    draw_ranked_effects(table, left, legend=False)
    draw_visibility(table, right)
    right.tick_params(labelleft=False)
    if style.in_column():
        run_on(left, right, len(table.head(MOST)))
    over.set_axis_off()
    over.legend(handles=handles, loc="upper left", borderaxespad=0.0, ncols=abreast)
    fewer = f"The {MOST} with most evidence of {len(table)} effects.\n" if len(table) > MOST else ""
    note = fewer + (f"{_NOTE}\n{_TOGETHER}" if _named_together(table) else _NOTE)
    if style.in_column():
        note = "\n".join(style.fill(line, _NOTE_LINE) for line in note.split("\n"))
    figure.supxlabel(note, x=0.02, ha="left", fontsize=8, color=style.GREY, linespacing=1.4)
    return figure


def _named_together(table: pd.DataFrame) -> bool:
    """Whether credible effects are several of one model, which have one evidence."""
    own = table.loc[table["credible"].map(flag).astype(bool), "ln_bayes"]
    return len(own) > 1 and bool(np.ptp(own.to_numpy(dtype=float)) == 0.0)


def draw_confounding(table: pd.DataFrame, ax: Axes | None = None, *, effects: pd.DataFrame | None = None) -> Axes:
    """Draw the correlation of the effects' signatures after projecting out the calibrated parameters.

    Parameters
    ----------
    table : DataFrame
        Column ``effect`` and one column per effect; correlations from -1 to 1, NaN where unknown.
    ax : Axes, optional
    effects : DataFrame, optional
        Columns ``name, title, unabsorbed`` (fraction of the signature that parameters cannot absorb), for the labels.

    Returns
    -------
    Axes
        A matrix of the effects, of many those with most evidence, with the values in the cells where there is room;
        off-diagonal absolute values above 0.9 are outlined. Rows are labelled with title, name and unabsorbed
        fraction, columns with the name.
    """
    names = table["effect"].astype(str).tolist()
    if len(names) > _MATRIX:
        first = names if effects is None else [n for n in ranked(effects)["name"].astype(str) if n in set(names)]
        names = first[:_MATRIX]
    count = len(names)
    titles = {} if effects is None else dict(zip(effects["name"], effects["title"], strict=True))
    unabsorbed = {} if effects is None else dict(zip(effects["name"], effects["unabsorbed"], strict=True))
    if ax is None:
        ax = style.new_figure(float(np.clip(0.36 * count, 1.2, 9.0)) + 1.9).add_subplot()
    if not names:
        return blank(ax, "no effect was tested")
    values = table.set_index("effect").reindex(index=names, columns=names).to_numpy(dtype=float)
    ax.imshow(np.ones_like(values), cmap="Greys", norm=Normalize(0.0, 7.0), aspect="auto")
    image = ax.imshow(values, cmap="RdBu_r", norm=Normalize(-1.0, 1.0), aspect="auto")
    size = 7.5 if count <= 12 else 7.5 * 12.5 / count
    for i, j in np.argwhere(np.isfinite(values)) if count <= _NUMBERED else ():
        colour = "white" if abs(values[i, j]) > 0.65 else style.BLACK
        ax.text(j, i, fixed(values[i, j], 2), ha="center", va="center", fontsize=size, color=colour)
    hover_cells(
        ax,
        [
            [f"{a}, {b}: {fixed(v, 2)}" for b, v in zip(names, row, strict=True)]
            for a, row in zip(names, values, strict=True)
        ],
    )
    style.separate_cells(ax, count, count)
    collinear = np.argwhere((np.abs(values) > COLLINEAR) & ~np.eye(count, dtype=bool))
    for i, j in collinear:
        looks: dict[str, Any] = {"fill": False, "edgecolor": style.BLACK, "linewidth": 1.8, "clip_on": False}
        ax.add_patch(Rectangle((j - 0.46, i - 0.46), 0.92, 0.92, gid="collinear", zorder=4, **looks))
    known = {name: f"γ\xa0{unabsorbed[name]:.2f}" for name in names if not pd.isna(unabsorbed.get(name, math.nan))}
    ends = {n: ", ".join([*([n] if titles.get(n, n) != n else []), *([known[n]] if n in known else [])]) for n in names}
    words = [_two_lines(str(titles.get(n, n)), f" ({ends[n]})" if ends[n] else "") for n in names]
    if style.in_column():  # rows are named by what columns are on a page, and columns numbered
        words = [f"{n}  {k}" + (f"\n{known[n]}" if n in known else "") for k, n in enumerate(names, start=1)]
        ax.set_xticks(range(count), [str(k) for k in range(1, count + 1)], fontsize=7, rotation=90 if count > 12 else 0)
    else:
        ax.set_xticks(range(count), names, rotation=90, fontsize=8)
    ax.set_yticks(range(count), words, fontsize=7.5)
    notes = [f"outlined: |ρ| > {COLLINEAR:g}, collinear"] if len(collinear) else []
    notes += ["γ: share that the parameters cannot explain"] if known else []
    at: Any = "right" if style.in_column() else "center"
    ax.set_xlabel("; ".join(notes), loc="right")  # long names leave a narrow panel right of them
    bar = style.bar_beside(ax, image, "")
    between = "\n" if style.in_column() else " "
    bar.set_label(f"correlation ρ of the{between}change patterns (–)", loc=at)
    return ax


def _two_lines(title: str, end: str = "") -> str:
    """Wrap a title, however long, to at most two lines."""
    return textwrap.fill(title + end, max(26, math.ceil(0.58 * len(title + end))), break_long_words=False)


def threshold(count: int) -> float:
    """Threshold of the ln Bayes factor for one of so many effects; the best of more effects fits better by chance."""
    return math.log(max(count, 1)) + LEAST_BAYES_FACTOR


def only_predicted(table: pd.DataFrame) -> pd.Series:
    """Which effects are above the limit of the evidence by a linear estimate only: not refitted, and not credible.

    An effect for which a collinear one was fitted has its evidence.
    """
    stood_for = {name for names in table["stands_for"].astype(str) for name in names.split(", ")}
    chosen = table["credible"].map(flag) | table["refitted"].map(flag) | table["name"].isin(stood_for)
    return ~chosen.astype(bool) & (table["ln_bayes"] > threshold(len(table)))


def _flags(column: pd.Series) -> list[bool]:
    return [flag(value) for value in column]


def _looks(rows: pd.DataFrame) -> list[str]:
    """Key in `_LOOKS` of every effect's dot."""
    credible, seen, refitted = (_flags(rows[name]) for name in ("credible", "visible", "refitted"))
    names = list(_LOOKS)
    return [
        names[0] if c else names[3] if not s else names[1] if r else names[2]
        for c, s, r in zip(credible, seen, refitted, strict=True)
    ]


def _handles(rows: pd.DataFrame) -> list[Artist]:
    """Legend entries of the evidence."""
    there = _looks(rows)
    handles: list[Artist] = [
        Line2D([], [], linestyle="none", marker="o", markersize=7.5, label=name, markerfacecolor=look["facecolor"],
               markeredgecolor=look.get("edgecolor", look["facecolor"]))
        for name, look in _LOOKS.items() if name in there
    ]  # fmt: skip
    if rows["implausible"].fillna("").astype(bool).any():
        odd: dict[str, Any] = {"marker": "X", "color": style.BLUE, "markersize": 7.5}
        handles.append(Line2D([], [], linestyle="none", label="fitted with implausible values", **odd))
    words = f"threshold ln {len(rows)} + {LEAST_BAYES_FACTOR:g} = {threshold(len(rows)):.1f}"
    handles.append(Line2D([], [], color=style.BLACK, linestyle="--", linewidth=1.0, label=words))
    if rows[["ln_bayes_third", "ln_bayes_triple"]].notna().to_numpy().any():
        handles.append(Line2D([], [], color=style.BLACK, linewidth=1.1, label="prior width ÷ 3 to × 3"))
    return handles


def _beside(ax: Axes, row: float, z: str, likely: str, colour: str) -> None:
    """Write two columns at the right of a row."""
    for words, shift in ((z, 32), (likely, 84)):
        ax.annotate(
            words.replace("-", "−"),
            (1.0, row),
            xycoords=ax.get_yaxis_transform(),
            xytext=(shift, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=8,
            color=colour,
            annotation_clip=False,
        )


def _height(rows: pd.DataFrame) -> float:
    """Height in inches of a figure with one row per effect, whose name may take two lines."""
    return 1.6 + rows_height(_row_names(rows), 0.36)


def _row_names(rows: pd.DataFrame) -> list[str]:
    """Names of the rows of a chart, long ones on two lines."""
    titles = [str(title) or str(name) for name, title in zip(rows["name"], rows["title"], strict=True)]
    return [textwrap.fill(t, _OVER) if style.in_column() else _two_lines(t) for t in titles]


def _apart(ticks: list[int], left: float, right: float) -> list[int]:
    """Ticks whose labels do not touch on an axis of roots: 0, then the largest first."""
    span, kept = float(np.ptp(_root(np.array([left, right])))), list[int]()
    for tick in sorted(ticks, key=lambda one: (one != 0, -abs(one))):
        if all(abs(_root(np.array(tick)) - _root(np.array(other))) >= _LABEL * span for other in kept):
            kept.append(tick)
    return sorted(kept)


def _root(value: np.ndarray) -> np.ndarray:
    """Root with the sign of the value."""
    return np.sign(value) * np.sqrt(np.abs(value))


def _square(root: np.ndarray) -> np.ndarray:
    return np.sign(root) * np.square(root)


def _name_rows(ax: Axes, rows: pd.DataFrame, values: Sequence[str] = ()) -> None:
    """Write the effects' names, and draw lines between the rows."""
    names = _row_names(rows)
    top, _ = row_edges(names)
    for words, visible in zip(name_rows(ax, names, values), _flags(rows["visible"]), strict=True):
        words.set(color=style.BLACK if visible else style.GREY, fontsize=7.5 if style.in_column() else 8)
    ax.set_ylim(len(rows) + top + 0.05, top - 0.05)
    ax.grid(axis="x")
    for row in range(1, len(rows)):
        ax.axhline(row + top, color="#E3E3E3", linewidth=0.6)
