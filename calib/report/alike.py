"""Local perturbations that change the data as an effect does: they tell where it acts on the structure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report.numbers import fixed
from calib.report.numbers import places as listed
from calib.report.scene import (
    BAR,
    FOOT,
    HEADING,
    PLACE,
    colour_bar,
    draw_dots,
    frame_panel,
    new_axes,
    new_scene,
    number_points,
    over_strip,
    plot_coordinates,
    plot_lines,
    seen_size,
    show_axes,
)
from calib.report.style import BLACK, REST, YELLOW, figure_width
from calib.report.why import change_words, wrapped

ALIKE = 0.5
"""Absolute correlation of two signatures from which a local perturbation tells where an effect acts."""
CORRELATION, TICKS = Normalize(-1.0, 1.0), (-1.0, -0.5, 0.0, 0.5, 1.0)
STAR: dict[str, Any] = {"marker": "*", "color": YELLOW, "markersize": 13, "markeredgecolor": BLACK}


_HIGHEST = 4.6
"""Height in inches of the picture of a structure."""
_LINE = 0.17
"""Height in inches of a line of words above a panel."""
_NAMED = 3
_TOGETHER = 0.02
"""Distance over the size of the structure within which marks cover each other."""


def most_alike(places: pd.DataFrame, effect: str) -> pd.Series | None:
    """Return the row of the local perturbation whose signature is most like the effect's; None where none is alike.

    Parameters
    ----------
    places : DataFrame
        Columns ``effect, perturbation, kind, x, y, z, correlation``; perturbations without coordinates do not count.
    effect : str
    """
    own = located_rows(places, effect)
    if own.empty or not own["correlation"].abs().max() >= ALIKE:
        return None
    return own.iloc[int(np.argmax(own["correlation"].abs()))]


def draw_alike(
    places: pd.DataFrame,
    rest: np.ndarray,
    ax: Axes3D | None = None,
    *,
    effect: str,
    acts: pd.DataFrame | None = None,
) -> Axes3D:
    """Draw where local perturbations change the data as the effect does, and where it acts on the model.

    Parameters
    ----------
    places : DataFrame
        Columns ``effect, perturbation, kind, x, y, z`` (m) and ``correlation`` of both signatures, -1 to 1.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional
    effect : str
        The rows to draw.
    acts : DataFrame, optional
        Columns ``effect, x, y, z`` (m): where each effect acts.

    Returns
    -------
    Axes3D
        Circles with the gid ``correlation``, the largest at the back; the perturbation of `most_alike` is numbered.
        Stars with the gid ``acts``.
    """
    ax = new_axes(ax)
    rows = located_rows(places, effect)
    rows = rows.iloc[np.argsort(-rows["correlation"].abs().to_numpy(dtype=float), kind="stable")]
    place, best = rows[PLACE].to_numpy(dtype=float), most_alike(places, effect)
    plot_lines(ax, rest, color=REST, linewidth=0.8, gid="structure", zorder=1)
    draw_dots(ax, place, rows["correlation"].to_numpy(dtype=float), CORRELATION, "RdBu_r", "correlation")
    stars = acting(acts, effect)
    if len(stars):
        ax.plot(*plot_coordinates(stars).T, linestyle="none", gid="acts", zorder=6, clip_on=False, **STAR)
    frame_panel(ax, np.concatenate([rest.reshape(-1, 3), place, stars]), "")
    number_points(ax, place, {} if best is None else {list(rows.index).index(best.name): 1})
    return ax


def alike_figure(
    places: pd.DataFrame,
    rest: np.ndarray,
    *,
    effects: pd.DataFrame | None = None,
    acts: pd.DataFrame | None = None,
    attempt: bool = False,
) -> Figure:
    """Draw where each effect acts, and what is alike on the structure, see `draw_alike`.

    Parameters
    ----------
    places, rest, acts
        As for `draw_alike`.
    effects : DataFrame, optional
        Columns ``name, title, unit, magnitude``, for the headings.
    attempt : bool
        Whether the effects are a rejected attempt.
    """
    names = [name for name in dict.fromkeys(places["effect"]) if len(located_rows(places, name))]
    headings = [wrapped(_sentences(places, name, effects, acts, attempt)) for name in names]
    wide, high = seen_size(rest.reshape(-1, 3), 0.1)
    panel = min(figure_width() * high / wide + 2 * HEADING, _HIGHEST)
    heights = [x for words in headings for x in (0.2 + _LINE * (words.count("\n") + 1), panel)]
    foot = FOOT + over_strip(BAR)
    figure = new_scene(sum(heights) + foot, foot)
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    for k, (name, words) in enumerate(zip(names, headings, strict=True)):
        over = figure.add_subplot(grid[2 * k], label="heading")
        over.set_axis_off()
        over.text(0.1 / figure_width(), 1.0, words, transform=over.transAxes, fontsize=8.5, va="top", linespacing=1.3)
        draw_alike(places, rest, figure.add_subplot(grid[2 * k + 1], projection="3d"), effect=name, acts=acts)
    show_axes(figure)
    colours = ScalarMappable(CORRELATION, "RdBu_r")
    colour_bar(figure, colours, "ρ with local stiffness or mass changes (–; area: |ρ|)", TICKS)
    if any(len(acting(acts, name)) for name in names):
        star = Line2D([], [], linestyle="none", label="where it acts", **STAR)
        height = float(figure.get_size_inches()[1])
        figure.legend(
            handles=[star], loc="lower left", bbox_to_anchor=(1.05 / figure_width(), 0.06 / height), borderaxespad=0.0
        )
    return figure


def _sentences(
    places: pd.DataFrame, name: str, effects: pd.DataFrame | None, acts: pd.DataFrame | None, attempt: bool
) -> list[str]:
    """The effect, where it acts by the list, and what is most alike by the data, with marks that cover it."""
    out, stars, best = [change_words(name, effects, attempt)], acting(acts, name), most_alike(places, name)
    if len(stars):
        out.append(f"By the list, not by the data, it acts at (m, marked by a star): {listed(stars.tolist(), _NAMED)}.")
    where = alike_words(places, name)
    out.append(where if best is None else f"Most alike among the local stiffness or mass changes, marked 1: {where}")
    if best is not None and (covered := coinciding(places, name)):
        others = ", ".join(covered[:_NAMED]) + (f" and {len(covered) - _NAMED} more" if len(covered) > _NAMED else "")
        out.append(f"At the same place, drawn over it: {others}.")
    return out


def coinciding(places: pd.DataFrame, effect: str) -> list[str]:
    """Names and correlations of the perturbations whose marks lie on that of `most_alike`."""
    best, rows = most_alike(places, effect), located_rows(places, effect)
    if best is None:
        return []
    at = rows[PLACE].to_numpy(dtype=float)
    near = _TOGETHER * (float(np.linalg.norm(np.ptp(at, axis=0))) or math.inf)
    off = np.linalg.norm(at - best[PLACE].to_numpy(dtype=float), axis=1)
    same = rows[(off <= near) & (rows.index != best.name)]
    return [f"{r['perturbation']} (ρ = {fixed(r['correlation'], 2, sign=True)})" for r in same.to_dict("records")]


def alike_words(places: pd.DataFrame, effect: str) -> str:
    """Name the local perturbation of `most_alike`; empty where no perturbation has coordinates."""
    best = most_alike(places, effect)
    if best is None:
        none = "No local stiffness or mass change changes the data as it does"
        return "" if located_rows(places, effect).empty else none
    return f"{best['perturbation']} ({best['kind']}, ρ = {fixed(best['correlation'], 2, sign=True)})"


def located_rows(places: pd.DataFrame, effect: str) -> pd.DataFrame:
    """Rows of an effect whose perturbations have coordinates and a correlation."""
    return places[(places["effect"] == effect) & places[[*PLACE, "correlation"]].notna().all(axis=1)]


def acting(acts: pd.DataFrame | None, effect: str) -> np.ndarray:
    """Where an effect acts, (n, 3) in metres."""
    return np.empty((0, 3)) if acts is None else acts.loc[acts["effect"] == effect, PLACE].to_numpy(dtype=float)
