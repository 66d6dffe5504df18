"""Figures of the misfit: its significance by mode and kind of response, and the pulls of the parameters."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from calib.report import style
from calib.report.explanation import blank
from calib.report.numbers import fixed, flag, p_in_words, short, significant, with_unit
from calib.report.rows import name_rows, row_edges, rows_height
from calib.report.svg import hover, hover_cells, hover_points
from calib.results.answer import in_prose

KINDS = ("frequency", "damping", "shape")
FITS = ("base", "explained", "attempt")
_LEAST_DOF = 0.5
"""Fewest degrees of freedom for which chi2 per degree of freedom is written."""
_UNNAMED = "responses"
"""Row name in a table that has no modes."""
_WORDS = {"freq": "frequency", "frf": "FRFs"}
_MOST = 16.0
"""Upper end of the colour scale of -log10 p."""
_TITLE, _TITLE_COLUMN = 36, 19
"""Letters of a line above one of two panels, on a page and in a column."""
_COLOURS = (style.AFTER, style.WITH, style.PURPLE, style.ORANGE, style.SKY)


def draw_where_it_fails(
    table: pd.DataFrame, ax: Axes | None = None, *, stage: str = "base", bar: bool = True, name: str = ""
) -> Axes:
    """Draw the significance of the misfit, against noise alone, for every mode and kind of response.

    Parameters
    ----------
    table : DataFrame
        Columns ``stage`` (``base``, ``explained`` or ``attempt``), ``mode, kind``, ``chi2`` (sum of squared residuals
        in sigma), ``dof`` (effective degrees of freedom) and ``p``; NaN where unknown.
    ax : Axes, optional
    stage : str
        The rows to draw.
    bar : bool
        Whether a colour bar is added.
    name : str
        Effects that the model of the stage adds to the base model; empty when unknown.

    Returns
    -------
    Axes
        Colours are -log10 p, at most 16; the cells hold chi2 over its degrees of freedom, where there is at least half
        a degree. A cell without p is grey; the cells of an attempt are hatched.
    """
    table = table.replace({"kind": _WORDS})
    modes = list(dict.fromkeys(table["mode"]))
    present = list(dict.fromkeys(table["kind"]))
    kinds = [*(k for k in KINDS if k in present), *(k for k in present if k not in KINDS)]
    ax = style.own_axes(ax, style.matrix_height(len(modes), len(kinds)))
    if not kinds:
        return blank(ax, "no mode was compared")
    rows = table[table["stage"] == stage].set_index(["mode", "kind"])
    everywhere = pd.MultiIndex.from_product([modes, kinds])
    chi2, dof, p = (
        rows[name].astype(float).reindex(everywhere).to_numpy().reshape(len(modes), len(kinds))
        for name in ("chi2", "dof", "p")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        unlikely = np.minimum(-np.log10(p), _MOST) + 0.0
        ratio = np.where(dof >= _LEAST_DOF, chi2 / dof, np.nan)
    ax.imshow(np.ones_like(unlikely), cmap="Greys", norm=Normalize(0.0, 7.0), aspect="auto")
    image = ax.imshow(unlikely, cmap="OrRd", norm=Normalize(0.0, _MOST), aspect="auto", gid="unlikely")
    is_attempt = stage == "attempt"
    for i, j in np.ndindex(ratio.shape):
        words = "< 0.001" if ratio[i, j] < 1e-3 else short(float(ratio[i, j]))
        colour = "white" if unlikely[i, j] > 0.6 * _MOST and not is_attempt else style.BLACK
        ax.text(j, i, words, ha="center", va="center", fontsize=8, color=colour)
    hover_cells(
        ax,
        [
            [
                f"{m}, {kind}: χ²/ν {significant(r, 3)}, p {p_in_words(q)}"
                for kind, r, q in zip(kinds, line, chances, strict=True)
            ]
            for m, line, chances in zip(modes, ratio, p, strict=True)
        ],
    )
    ax.set_xticks(range(len(kinds)), kinds, rotation=90 if style.in_column() else 0)
    ax.set_yticks(range(len(modes)), [_row_name(table, str(mode)) for mode in modes])
    style.separate_cells(ax, len(modes), len(kinds))
    title = style.added(stage, name).replace(": ", ":\n")
    width = _TITLE_COLUMN if style.in_column() else _TITLE
    title = "\n".join(textwrap.fill(line, width) for line in title.splitlines())
    ax.set_title(title, color=style.GREY if is_attempt else style.BLACK)
    if is_attempt:
        for text in ax.texts:
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8})
        whole = Rectangle(
            (-0.5, -0.5), len(kinds), len(modes), fill=False, hatch="//", edgecolor=style.REST, linewidth=0.0
        )
        whole.set_gid("attempt")
        ax.add_patch(whole)
    if not style.in_column():  # where the colour bar tells it
        ax.set_xlabel("in the cells: χ² / degrees of freedom")
    ax.set_ylabel("" if modes == [_UNNAMED] or _WORDS["frf"] in kinds else "mode")
    if bar:
        _unlikely_bar(image, [ax])
    return ax


def _row_name(table: pd.DataFrame, mode: str) -> str:
    """A mode, or what a row without one holds: responses or FRFs, ``run 2: responses`` of one of several tests."""
    only_frfs = set(table.loc[table["mode"] == mode, "kind"]) == {_WORDS["frf"]}
    return f"{mode.removesuffix(_UNNAMED)}{_WORDS['frf']}" if only_frfs and mode.endswith(_UNNAMED) else mode


def where_it_fails_figure(table: pd.DataFrame, *, name: str = "") -> Figure:
    """Draw panels of `draw_where_it_fails`: the base model and, where there is one, the explained or attempted model.

    Parameters
    ----------
    table : DataFrame
        As for `draw_where_it_fails`.
    name : str
        Effects that the other model adds to the base model; empty when unknown.
    """
    stages = [stage for stage in FITS if (table["stage"] == stage).any()] or ["base"]
    beside = 1.3 if style.in_column() else 0.2
    figure = style.new_figure(beside + style.matrix_height(table["mode"].nunique(), len(KINDS)))
    panels = list(np.atleast_1d(figure.subplots(1, len(stages), sharey=True)))
    for ax, stage in zip(panels, stages, strict=True):
        draw_where_it_fails(table, ax, stage=stage, bar=False, name=name)
    for ax in panels[1:]:
        ax.set_ylabel("")
    if panels[0].images:
        _unlikely_bar(panels[0].images[-1], panels)
    return figure


def _unlikely_bar(image: ScalarMappable, panels: list[Axes]) -> None:
    bar = style.bar_beside(panels, image, "colour: −log₁₀ p (number: χ²/ν)", 30)
    bar.set_ticks([0, 4, 8, 12, 16], labels=["0", "4", "8", "12", "≥ 16"])


_MOST_PULLS = 24
"""Parameters in one figure of pulls."""


def draw_pulls(table: pd.DataFrame, ax: Axes | None = None, *, attempt: bool = False) -> Axes:
    """Draw the pull of each parameter: its standardised shift from the nominal value.

    Parameters
    ----------
    table : DataFrame
        Columns ``model`` (``base``, or the names of the added effects), ``parameter, unit, nominal, value``,
        ``standardised`` (shift over the root of prior less posterior variance), ``limit`` (of the normal distribution,
        after Bonferroni) and ``pulled`` (bool, or None).
    ax : Axes, optional
    attempt : bool
        Whether the models with effects are rejected attempts; their dots are then hollow and grey.

    Returns
    -------
    Axes
        One dot per parameter and model, dashed lines at the limits, and a ring round the dot of a pulled parameter. At
        the right stand the nominal value and that of each model in turn. Of many parameters those that are pulled most.
    """
    models, every = list(dict.fromkeys(table["model"])), list(dict.fromkeys(table["parameter"]))
    names = _most_pulled(table, every)
    ax = style.own_axes(ax, 1.2 + rows_height(names, 0.38))
    if not names:
        return blank(ax, "no parameter was calibrated")
    dot = {"marker": "o", "linestyle": "none", "markersize": 11}
    ring: dict[str, Any] = {
        **dot,
        "markerfacecolor": "none",
        "markeredgewidth": 1.6,
        "markeredgecolor": style.VERMILLION,
    }
    top, low = row_edges(names)
    step = 2.0 * low * min(0.3, 0.7 / len(models))
    handles: list[Artist] = []
    for k, model in enumerate(models):
        rows = table[table["model"] == model].set_index("parameter").reindex(names)
        y = np.arange(len(names)) + (k - (len(models) - 1) / 2) * step
        shift = rows["standardised"].to_numpy(dtype=float)
        is_attempt = attempt and model != "base"
        stage = "base" if model == "base" else "attempt" if is_attempt else "explained"
        label = style.added(stage, "" if model == "base" else in_prose(model))
        looks: dict[str, Any] = (
            {"color": style.GREY, "markerfacecolor": "white"} if is_attempt else {"color": _COLOURS[k % len(_COLOURS)]}
        )
        handles += ax.plot(
            shift, y, "osD^v"[k % 5], markersize=5.5, label=label, gid=f"shift {model}", zorder=3, **looks
        )
        values = [with_unit(v, str(u), 4) for v, u in zip(rows["value"], rows["unit"], strict=True)]
        texts = [
            f"{n}, {label}: {v}, shift {fixed(z, 1, sign=True)}" for n, v, z in zip(names, values, shift, strict=True)
        ]
        hover_points(ax, shift, y, texts)
        ringed = np.array([flag(value) for value in rows["pulled"]])
        ax.plot(shift[ringed], y[ringed], gid=f"pulled {model}", zorder=4, **ring)
    limits = sorted(set(table["limit"].astype(float).dropna().round(3)))
    for limit in limits:
        for side in (-limit, limit):
            ax.axvline(side, color=style.BLACK, linestyle="--", linewidth=0.9, gid="limit")
    ax.axvline(0.0, color=style.GREY, linewidth=0.8)
    values = [_values(table[table["parameter"] == name], models) for name in names]
    name_rows(ax, names, values)
    for row, words in enumerate(values):
        if not style.in_column():
            ax.text(1.02, row, words, transform=ax.get_yaxis_transform(), va="center", fontsize=8)
        if row:
            ax.axhline(row + top, color="#E3E3E3", linewidth=0.6)
    size = np.abs([*table["standardised"].astype(float), *limits, 3.0])
    reach = 1.12 * float(size[np.isfinite(size)].max())
    ax.set(ylim=(len(names) + top + 0.1, top - 0.1), xlim=(-reach, reach))
    ax.grid(axis="x")
    left = f"; {len(every) - len(names)} parameters with smaller shifts are left out" if len(names) < len(every) else ""
    label = f"shift from the nominal value over its expected deviation,\nthat in a correct model (–){left}"
    words = " → ".join(["nominal", *("base" if model == "base" else f"with {in_prose(model)}" for model in models)])
    if style.in_column():
        label += f"\nvalues: {words}"
    else:
        words = textwrap.fill(words, 40, break_long_words=False)
        ax.text(1.02, -0.02, words, transform=ax.transAxes, va="top", fontsize=8, color=style.GREY)
    ax.set_xlabel(label)
    if limits:
        label = "limit ± " + ", ".join(f"{limit:.2f}" for limit in limits)
        handles.append(Line2D([], [], color=style.BLACK, linestyle="--", linewidth=0.9, label=label))
    if any(map(flag, table["pulled"])):
        handles.append(Line2D([], [], label="shifted too far", **ring))
    style.legend_above(ax, handles)
    return ax


def _most_pulled(table: pd.DataFrame, names: list[str]) -> list[str]:
    """Of many parameters those with the largest pulls, in the order of the table."""
    if len(names) <= _MOST_PULLS:
        return names
    size = table["standardised"].astype(float).abs().groupby(table["parameter"]).max().fillna(0.0)
    most = set(size.reindex(names).sort_values(ascending=False, kind="stable").index[:_MOST_PULLS])
    return [name for name in names if name in most]


def _values(rows: pd.DataFrame, models: list[str]) -> str:
    """Nominal value and that of each model, with the unit."""
    by_model = rows.set_index("model")
    values = [rows["nominal"].iloc[0], *by_model["value"].reindex(models)]
    unit = str(rows["unit"].iloc[0])
    text = " → ".join("–" if pd.isna(value) else style.plain(value).replace("-", "−") for value in values)
    return text if unit in ("", "-", "–") else f"{text} {unit}"


LOOKS = {
    "gain": ("o", style.BLUE), "delay": ("s", style.SKY), "rotation": ("^", style.GREEN), "place": ("D", style.ORANGE),
    "cross-talk": ("v", style.PURPLE), "set-up": ("P", style.YELLOW), "damping": ("X", style.GREY),
    "exchange": ("d", style.VERMILLION), "axes": (">", style.VERMILLION), "mixed": ("p", style.PURPLE),
    "modulus": ("*", style.BLACK), "mass": ("h", style.GREY), "phase": ("<", style.GREEN),
}  # fmt: skip
"""Marker and colour of every kind of fault; others are grey dots."""
_SAID = {"place": "position"}
"""Kinds of fault whose word in a legend is another."""
WHOLE = "whole test"
"""Label of the faults that concern no single sensor."""
MOST = 30
"""Sensors drawn, those of the largest scores."""


def draw_suspects(table: pd.DataFrame, ax: Axes | None = None) -> Axes:
    """Draw the score of every fault of the measurement over the sensor it concerns.

    Parameters
    ----------
    table : DataFrame
        Columns ``fault, kind, sensor`` (empty for the whole test), ``score``, ``limit`` that noise alone exceeds in 1 %
        of all cases, another one for faults of pairs, ``blamed`` whether the verdict names it, ``told`` what its fit
        means.
    ax : Axes, optional

    Returns
    -------
    Axes
        Dots with the gid of their kind, rings with the gid ``blamed``, lines with the gid ``limit``.
    """
    rows = table.assign(at=table["sensor"].where(table["sensor"].astype(str) != "", WHOLE)).dropna(subset=["score"])
    largest = rows.assign(size=rows["score"].abs()).groupby("at", sort=False)["size"].max()
    chosen = set(largest.sort_values(ascending=False, kind="stable").index[:MOST])
    names = [name for name in largest.index if name in chosen]
    place = {name: k for k, name in enumerate(sorted(names, key=_natural))}
    rows = rows[rows["at"].isin(chosen)]
    ax = style.own_axes(ax, max(2.4, 0.9 + 0.19 * len(place)))
    limit, *others = sorted(set(rows["limit"].round(9)))
    for one, line in zip((limit, *others), ("--", *(":" for _ in others)), strict=True):
        for side in (-one, one):
            ax.axvline(side, color=style.BLACK, linewidth=0.8, linestyle=line, gid="limit")
    ax.axvline(0.0, color=style.GREY, linewidth=0.8)
    for kind in dict.fromkeys(rows["kind"]):
        own = rows[rows["kind"] == kind]
        marker, colour = LOOKS.get(str(kind), ("o", style.GREY))
        heights = [place[name] for name in own["at"]]
        dots = ax.scatter(
            own["score"],
            heights,
            s=22,
            marker=marker,
            c=colour,
            label=_SAID.get(str(kind), str(kind)),
            gid=str(kind),
            zorder=3,
        )
        hover(dots, *(_words(r) for r in own.to_dict("records")))
    blamed = rows[[flag(b) for b in rows["blamed"]]]
    if len(blamed):
        heights = [place[name] for name in blamed["at"]]
        ring: dict[str, Any] = {"s": 110, "facecolors": "none", "edgecolors": style.VERMILLION, "linewidths": 1.6}
        ax.scatter(blamed["score"], heights, label="named by the verdict", gid="blamed", zorder=4, **ring)
    ax.set_yticks(range(len(place)), list(place))
    ax.set_ylim(len(place) - 0.4, -0.6)
    pairs = "".join(f", of pairs within ± {fixed(one, 1)}," for one in others)
    ax.set_xlabel(
        f"score of the measurement error (noise alone stays within ± {fixed(limit, 1)}{pairs} in 99 % of all cases)"
    )
    ax.grid(axis="y")
    style.legend_above(ax)
    return ax


def _words(row: dict[str, object]) -> str:
    words = f": {row['told']}" if row.get("told") else ""
    return f"{row['fault']}, score {fixed(float(np.asarray(row['score'])), 1)}{words}"


def _natural(name: str) -> tuple[bool, int, str]:
    """Order of sensors: by the number of the node, the whole test last."""
    digits = "".join(c for c in name if c.isdigit())
    return name == WHOLE, int(digits) if digits else 0, name
