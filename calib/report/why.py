"""Figure that shows why an effect is named: the residual of the base model beside the signature of the effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calib.report.numbers import counted, fixed, percent, significant, with_unit
from calib.report.scene import new_scene
from calib.report.style import AFTER, BLACK, DENSE, GREY, WITH, figure_width, fill, in_column, legend_above, own_axes
from calib.report.svg import hover, hover_points
from calib.results.answer import in_prose

MANY = {"shape": "shape", "frf": "FRFs"}
"""Kinds with too many rows for bars, in words."""
PRIOR = "prior"
"""Kind of the rows that are no data."""
BY_TEST = "reduction_by_test"
"""Table of what the effects take from the sum of squares of each of several tests."""
RESPONSES = "responses"
"""Heading of the bars of scalar responses, whatever their kinds."""
_NAMED = 3
_LINE_OF_WORDS = 0.06
"""Height of a name over that of its panel."""
_WORTH_WORDS = 2.0
"""Standard deviations from which a dot of a dense cloud has words under the mouse."""
_LINE = 0.17
"""Height in inches of a line of words above a panel."""
_LEVEL = 8
"""Bars whose names still stand level below the axis, if they are short."""


def share(table: pd.DataFrame) -> float:
    """Share of the sum of squares of ``residual`` that is not in ``left``; negative where the signature adds to it."""
    total = float((table["residual"] ** 2).sum())
    return 1.0 - float((table["left"] ** 2).sum()) / total if total > 0.0 else float("nan")


def explained_words(table: pd.DataFrame, by_test: pd.DataFrame | None = None) -> str:
    """What the effects of a fit explain, in words.

    Parameters
    ----------
    table : DataFrame
        All rows of one effect of the fit, as for `why_figure`.
    by_test : DataFrame, optional
        As for `why_figure`. A fit of several tests lowers the sum of squares of all of them; of one test among several
        a share of its own sum would tell nothing, so that its share of the whole decrease is told.
    """
    together = str(table["effects"].iloc[0])
    verb = "explain" if together != str(table["effect"].iloc[0]) else "explains"
    of_fit = [] if by_test is None else by_test[by_test["effects"] == together].to_dict("records")
    if not of_fit:
        part = percent(share(table), 0)
        return f"By linear estimate {in_prose(together)} {verb} {part} % of the sum of squares of data and priors"
    (row,) = of_fit
    way = "falls" if row["after"] <= row["before"] else "rises"
    change = f"{way} from {significant(row['before'], 3)} to {significant(row['after'], 3)}"
    data = counted(int(row["rows"]), "value")
    words = f"With {in_prose(together)} fitted, the sum of squares of this test's data ({data}) {change}"
    return f"{words}: {percent(row['share'], 0)} % of the decrease over all tests" if row["share"] > 0 else words


def draw_bars(
    table: pd.DataFrame,
    ax: Axes | None = None,
    *,
    names: Sequence[str] | None = None,
    attempt: bool = False,
    legend: bool = True,
) -> Axes:
    """Draw residual, signature and what is left, in a group for each mode or scalar response.

    Parameters
    ----------
    table : DataFrame
        Rows of one effect and one kind, or of scalar responses; columns ``mode`` (empty for a response), ``sensor``,
        ``residual, signature, left`` in standard deviations.
    ax : Axes, optional
    names : sequence of str, optional
        Modes or responses in their order; by default those of the table.
    attempt : bool
        Whether the effect is a rejected attempt, drawn in grey.
    legend : bool
        Whether a legend stands above the Axes.

    Returns
    -------
    Axes
        A wide bar for the residual, a narrow one over it for the signature, a dot for what is left.
    """
    ax = own_axes(ax, 3.2)
    own = _names(table)
    names = own if names is None else list(names)
    at = np.array([names.index(name) for name in own])
    for column, width, order, look in (("residual", 0.8, 2, _RESIDUAL), ("signature", 0.36, 3, _signature(attempt))):
        values = table[column].to_numpy(dtype=float)
        for bar, name, value in zip(ax.bar(at, values, width, zorder=order, **look), own, values, strict=True):
            bar.set_gid(column)
            hover(bar, f"{name}, {column}: {fixed(value, 1, sign=True)} σ")
    left = table["left"].to_numpy(dtype=float)
    ax.plot(at, left, gid="left", zorder=4, **_LEFT)
    hover_points(ax, at, left, [f"{n}, left: {fixed(v, 1, sign=True)} σ" for n, v in zip(own, left, strict=True)])
    ax.axhline(0.0, color=BLACK, linewidth=0.8)
    level = len(names) <= _LEVEL and max(map(len, names), default=0) <= 4
    ax.set_xticks(
        range(len(names)), names, rotation=0 if level else 90, fontsize=float(np.clip(340 / len(names), 5, 8.5))
    )
    ax.set_xlim(-0.6, len(names) - 0.4)
    ax.tick_params(axis="x", length=0)
    ax.set_ylabel("σ", rotation=0)
    ax.grid(axis="y")
    if legend:
        legend_above(ax, _handles(attempt))
    return ax


def draw_shapes(table: pd.DataFrame, ax: Axes | None = None, *, attempt: bool = False) -> Axes:
    """Draw the residual of every shape row over the effect's signature in it.

    Parameters
    ----------
    table : DataFrame
        Rows of one effect, columns ``mode, sensor, part`` (``re`` or ``im``), ``residual, signature`` in standard
        deviations.
    ax : Axes, optional
    attempt : bool
        Whether the effect is a rejected attempt, drawn in grey.

    Returns
    -------
    Axes
        Dots, those of imaginary parts open, the three largest signatures with mode and sensor; on the line the effect
        explains all of the residual, on the horizontal axis nothing of it is there.
    """
    ax = own_axes(ax, 4.0)
    x, y = (table[name].to_numpy(dtype=float) for name in ("signature", "residual"))
    imaginary = (table["part"] == "im").to_numpy(dtype=bool)
    names = [
        f"{_mode_label(r['mode'])} {r['sensor']}" + (" im" if r["part"] == "im" else "")
        for r in table.to_dict("records")
    ]
    reach = 1.12 * float(np.max(np.abs([*x, *y]), initial=1.0))
    ax.plot([-reach, reach], [-reach, reach], color=BLACK, linewidth=0.9, linestyle="--", gid="equal", zorder=2)
    for gid, some in (("re", ~imaginary), ("im", imaginary)):
        colour = GREY if attempt else WITH
        face = colour if gid == "re" else "white"
        ax.plot(x[some], y[some], "o", color=colour, markerfacecolor=face, markersize=3.6, alpha=0.8, gid=gid,
                zorder=3, rasterized=len(x) > DENSE)  # fmt: skip
    words = [
        f"{n}: change pattern {fixed(a, 1)} σ, residual {fixed(b, 1)} σ" for n, a, b in zip(names, x, y, strict=True)
    ]
    large = np.maximum(np.abs(x), np.abs(y)) >= (_WORTH_WORDS if len(x) > DENSE else 0.0)
    hover_points(ax, x[large], y[large], [text for text, shown in zip(words, large, strict=True) if shown])
    _name_largest(ax, x, y, names)
    for line in (ax.axhline, ax.axvline):
        line(0.0, color=GREY, linewidth=0.6)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), xlabel="change pattern (σ)")
    ax.set_ylabel("residual, measured − model (σ)")
    ax.set_aspect("equal", adjustable="box", anchor="N")
    return ax


def _mode_label(mode: str) -> str:
    """A mode's name, or a line of an FRF in four digits."""
    freq = mode.removesuffix(" Hz")
    return f"{float(freq):.4g} Hz" if freq != mode else mode


def _name_largest(ax: Axes, x: np.ndarray, y: np.ndarray, names: Sequence[str]) -> None:
    """Name the largest signatures in the corners that dots on the diagonal leave empty, each with a line to its dot."""
    largest = np.argsort(-np.abs(x), kind="stable")[:_NAMED]
    for above in (True, False):
        rows = sorted((k for k in largest.tolist() if (y[k] >= 0) == above), key=lambda k: -abs(y[k]))
        for n, k in enumerate(rows):
            at = (0.02, 0.97 - _LINE_OF_WORDS * n) if above else (0.98, 0.03 + _LINE_OF_WORDS * n)
            ax.annotate(names[k], (x[k], y[k]), xytext=at, textcoords="axes fraction", fontsize=7, color=GREY,
                        ha="left" if above else "right", va="top" if above else "bottom",
                        arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 2},
                        )  # fmt: skip


def why_figure(
    table: pd.DataFrame,
    *,
    effects: pd.DataFrame | None = None,
    parameters: pd.DataFrame | None = None,
    by_test: pd.DataFrame | None = None,
    attempt: bool = False,
) -> Figure:
    """Draw for each effect the bars of `draw_bars` by kind, and the dots of `draw_shapes`.

    Parameters
    ----------
    table : DataFrame
        Columns ``effects`` (those of the fit), ``effect, kind, mode, sensor, part, residual, signature, left``.
    effects : DataFrame, optional
        Columns ``name, title, unit, magnitude``, for the headings.
    parameters : DataFrame, optional
        Columns ``effect, parameter, description, unit, value``: of each effect its fitted parameters, for the headings.
    by_test : DataFrame, optional
        For one of several tests: ``effects, rows, before, after, share`` of `calib.missing.pattern.reduction_table`.
    attempt : bool
        Whether the effects are a rejected attempt.
    """
    names = list(dict.fromkeys(table["effect"]))
    shapes = bool(_of_shapes(table).any())
    bars = table[~_of_shapes(table) & (table["kind"] != PRIOR)]
    headings = [_heading(table[table["effect"] == n], effects, parameters, attempt, by_test) for n in names]
    shares = by_test is None
    top = 0.34 + _LINE * max(words.count("\n") + 1 for words in headings)
    below = max(0.5, 0.14 + 0.075 * max(map(len, _names(bars)), default=0))
    handles = [*(_handles(attempt) if len(bars) else []), *(_dots(table["part"], attempt) if shapes else [])]
    abreast = 1 if in_column() else len(handles) if len(handles) <= _ABREAST else math.ceil(len(handles) / 2)
    foot = 0.2 * math.ceil(len(handles) / abreast) + (0.1 if in_column() else 0.2)
    panel = _PANEL * 2 + _GAP if in_column() and shapes and len(bars) else _PANEL
    figure = new_scene(len(names) * (top + panel + below) + foot, foot)
    grid = figure.add_gridspec(3 * len(names), 1, height_ratios=[top, panel, below] * len(names))
    for k, (name, heading) in enumerate(zip(names, headings, strict=True)):
        own = table[table["effect"] == name]
        over = figure.add_subplot(grid[3 * k], label="heading")
        over.set_axis_off()
        over.text(0.1 / figure_width(), 1.0, heading, transform=over.transAxes, fontsize=8.5, va="top", linespacing=1.3)
        cells = _cells(grid[3 * k + 1], not bars.empty, shapes)
        if "bars" in cells:
            _draw_kinds(figure, cells["bars"], own[own.index.isin(bars.index)], attempt, shares)
        if "shapes" in cells:
            rows = own[_of_shapes(own)]
            title = _explained(rows, MANY[str(rows["kind"].iloc[0])], shares)
            draw_shapes(rows, figure.add_subplot(cells["shapes"]), attempt=attempt).set_title(title)
    height = float(figure.get_size_inches()[1])
    place = (0.1 / figure_width(), 0.06 / height)
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=place, ncols=abreast, borderaxespad=0.0)
    return figure


_PANEL = 2.5
"""Height in inches of the panels of an effect."""
_ABREAST = 5
"""Most entries of the legend on a line."""
_GAP = 0.75
"""Height in inches between those that stand over each other in a column, for labels and a title."""
_RESIDUAL: dict[str, Any] = {"facecolor": AFTER, "alpha": 0.4}
_LEFT: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": BLACK, "markersize": 4.0}


def _signature(attempt: bool) -> dict[str, Any]:
    return {"facecolor": GREY if attempt else WITH}


def _handles(attempt: bool) -> list[Artist]:
    return [
        Patch(label="residual (measured − model)", **_RESIDUAL),
        Patch(label="change pattern", **_signature(attempt)),
        Line2D([], [], label="remaining", **_LEFT),
    ]


def _dots(parts: pd.Series[str], attempt: bool) -> list[Artist]:
    """What stands in the panels of shapes and FRFs: the diagonal, and open dots where there are imaginary parts."""
    out: list[Artist] = [Line2D([], [], color=BLACK, linewidth=0.9, linestyle="--", label="equal")]
    if (parts == "im").any():
        look: dict[str, Any] = {
            "linestyle": "none",
            "marker": "o",
            "color": GREY if attempt else WITH,
            "markersize": 3.6,
        }
        out += [Line2D([], [], label="real", **look)] if (parts == "re").any() else []
        out.append(Line2D([], [], label="imaginary", **{**look, "markerfacecolor": "white"}))
    return out


def _names(table: pd.DataFrame) -> list[str]:
    """Mode of every row, or the scalar response."""
    return [str(r["mode"] or r["sensor"]) for r in table.to_dict("records")]


def _explained(table: pd.DataFrame, kind: str, shares: bool) -> str:
    """Title of a panel, with the share of its sum of squares that the effect explains, if it is to be told."""
    if not shares:
        return kind
    explained = share(table)
    return f"{kind}: {percent(explained, 0)} % explained" if explained > 0 else f"{kind}: not explained"


def further_parameters(parameters: pd.DataFrame | None, effect: str) -> list[str]:
    """What an effect has beside its magnitude, such as the natural frequency of a hung unit, as fitted."""
    if parameters is None:
        return []
    rows = parameters[(parameters["effect"] == effect) & (parameters["parameter"] != effect)]
    return [
        f"{r['parameter']} = {with_unit(r['value'], str(r['unit']))} as fitted"
        + (f"; in the list: {about}" if (about := r["description"]) else "")
        for r in rows.to_dict("records")
    ]


def change_words(name: str, effects: pd.DataFrame | None, attempt: bool) -> str:
    """An effect with its title and magnitude, where its row of ``effects`` is known, and whether it is believed."""
    words = name
    if effects is not None and name in set(effects["name"]):
        row = effects[effects["name"] == name].to_dict("records")[0]
        words = f"{row['title']} ({name}), {with_unit(row['magnitude'], str(row['unit']))}"
    return words + (": best attempt, not believed" if attempt else "")


def wrapped(sentences: Sequence[str]) -> str:
    """Lines over a panel that is as wide as the figure."""
    return "\n".join(fill(line, 54 if in_column() else 112, subsequent_indent="    ") for line in sentences)


def _heading(
    own: pd.DataFrame,
    effects: pd.DataFrame | None,
    parameters: pd.DataFrame | None,
    attempt: bool,
    by_test: pd.DataFrame | None,
) -> str:
    """Effect with its magnitude and further parameters, and the share that it explains."""
    name = str(own["effect"].iloc[0])
    sentences = [change_words(name, effects, attempt), *further_parameters(parameters, name)]
    sentences.append(f"{explained_words(own, by_test)}.")
    return wrapped(sentences)


def _cells(spec: SubplotSpec, bars: bool, shapes: bool) -> dict[str, SubplotSpec]:
    """Cells of the panels of one effect, over each other in a column; empty columns between them hold the labels."""
    label, end = 0.6, 0.1
    if in_column():
        heights = [_PANEL, _GAP, _PANEL] if bars and shapes else [_PANEL]
        ratios = [label, figure_width() - label - end, end]
        over = spec.subgridspec(len(heights), 3, width_ratios=ratios, height_ratios=heights, wspace=0.0, hspace=0.0)
        return {**({"bars": over[0, 1]} if bars else {}), **({"shapes": over[len(heights) - 1, 1]} if shapes else {})}
    beside = {"labels": 0.65, "shapes": 2.4} if shapes else {}
    rest = figure_width() - label - end - sum(beside.values())
    widths = {"label": label, **({"bars": rest} if bars else {}), **beside, "end": end if bars else end + rest}
    grid = spec.subgridspec(1, len(widths), width_ratios=list(widths.values()), wspace=0.0)
    return {name: grid[0, k] for k, name in enumerate(widths) if name in ("bars", "shapes")}


def _draw_kinds(figure: Figure, spec: SubplotSpec, table: pd.DataFrame, attempt: bool, shares: bool) -> None:
    """Draw the bars of every kind above one another, over the same modes; scalar responses are of one kind."""
    panels = table["kind"].where(table["mode"].astype(bool), RESPONSES)
    kinds, names = list(dict.fromkeys(panels)), list(dict.fromkeys(_names(table)))
    grid = spec.subgridspec(len(kinds), 1, hspace=0.35)
    for k, kind in enumerate(kinds):
        rows = table[panels == kind]
        ax = draw_bars(rows, figure.add_subplot(grid[k, 0]), names=names, attempt=attempt, legend=False)
        ax.set_title(_explained(rows, kind, shares))
        ax.tick_params(labelbottom=k == len(kinds) - 1)


def _of_shapes(table: pd.DataFrame) -> pd.Series:
    """Whether a row is one of a mode shape or an FRF, of which there are too many for bars."""
    return table["kind"].isin(MANY) & table["mode"].astype(bool)
