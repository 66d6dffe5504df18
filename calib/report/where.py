"""Maps of the structure: residuals at the sensors, and scores of local perturbations."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Hashable
from typing import Any, cast

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report import scene
from calib.report.numbers import fixed
from calib.report.numbers import place as place_of
from calib.report.shapes import measured_motions
from calib.report.style import BLUE, GREY, REST, VERMILLION, figure_width, in_column

PERTURBATION_KINDS = ("stiffness", "damping", "mass")


def sensor_rms(table: pd.DataFrame) -> pd.DataFrame:
    """Return the root mean square of each sensor's residual over the modes, worst first.

    Parameters
    ----------
    table : DataFrame
        Columns ``mode, sensor, direction, x, y, z`` (m), ``re, im`` (sigma; NaN where unknown).

    Returns
    -------
    DataFrame
        Columns ``sensor, direction, x, y, z, rms``; real and imaginary parts have equal weight, so that noise alone
        gives about 1.
    """
    parts = table[["re", "im"]].astype(float)
    counted = table.assign(total=(parts**2).sum(axis=1), parts=parts.notna().sum(axis=1))
    by_sensor = counted.groupby("sensor", sort=False)
    found = by_sensor.agg(
        direction=("direction", "first"),
        x=("x", "first"),
        y=("y", "first"),
        z=("z", "first"),
        total=("total", "sum"),
        parts=("parts", "sum"),
    )
    found["rms"] = np.sqrt(found.pop("total") / found.pop("parts"))
    return found.reset_index().sort_values("rms", ascending=False, kind="stable", ignore_index=True)


def misfit_tips(sensors: pd.DataFrame, points: np.ndarray) -> np.ndarray:
    """Return the ends of sticks along the sensors' directions, as long as their rms, (n, 3) in metres.

    Parameters
    ----------
    sensors : DataFrame
        As from `sensor_rms`.
    points : ndarray (n, 3)
        Points of the structure; the longest stick is a tenth of the diagonal of their box.
    """
    sticks = scene.axis_vectors(sensors["direction"]) * sensors["rms"].to_numpy(dtype=float)[:, None]
    return sensors[scene.PLACE].to_numpy(dtype=float) + scene.motion_scale(points, sticks) * sticks


def draw_sensor_misfit(
    table: pd.DataFrame, rest: np.ndarray, ax: Axes3D | None = None, *, stage: str = "base"
) -> Axes3D:
    """Draw every sensor's rms residual over all modes on the structure.

    Parameters
    ----------
    table : DataFrame
        Columns ``stage, mode, sensor, direction`` (x, y or z), ``x, y, z`` (m), ``re, im`` (sigma). Sensors without
        coordinates are not drawn.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional
    stage : str
        The rows to draw.

    Returns
    -------
    Axes3D
        Lines with the gids ``structure`` and ``direction`` (a stick along the sensor's direction, the worst a tenth of
        the structure's diagonal), circles with the gid ``rms`` at their ends, coloured and sized by the rms; the worst
        three are numbered.
    """
    ax = scene.new_axes(ax)
    sensors = sensor_rms(table[table["stage"] == stage]).dropna()
    place = sensors[scene.PLACE].to_numpy(dtype=float)
    rms = sensors["rms"].to_numpy(dtype=float)
    everything = np.concatenate([rest.reshape(-1, 3), place])
    tips = misfit_tips(sensors, everything)
    scene.plot_lines(ax, rest, color=REST, linewidth=0.8, gid="structure", zorder=1)
    scene.plot_lines(ax, np.stack([place, tips], axis=1), color=GREY, linewidth=1.0, gid="direction", zorder=2)
    scene.draw_dots(ax, tips, rms, Normalize(0.0, float(np.max(rms, initial=3.0))), "YlOrRd", "rms")
    scene.frame_panel(ax, np.concatenate([everything, tips]), f"all modes, sensors: {len(sensors)}")
    scene.number_points(ax, tips, {k: k + 1 for k in range(min(3, len(tips)))})
    return ax


def draw_mode_misfit(
    table: pd.DataFrame, rest: np.ndarray, ax: Axes3D | None = None, *, scale: float | None = None
) -> Axes3D:
    """Draw one mode's residual at the sensors as arrows.

    Parameters
    ----------
    table : DataFrame
        Rows of one mode and stage, columns as for `draw_sensor_misfit`. Sensors at one place give one arrow.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional
    scale : float, optional
        Metres per sigma; by default the longest arrow is a tenth of the structure's diagonal.

    Returns
    -------
    Axes3D
        Lines with the gids ``structure``, ``re`` and ``im`` (from the place to the tip), and ``re tip``, ``im tip``.
    """
    ax = scene.new_axes(ax)
    arrows = {part: measured_motions(table.assign(measured_re=table[part])) for part in ("re", "im")}
    everything = np.concatenate([rest.reshape(-1, 3), *[place for place, _ in arrows.values()]])
    if scale is None:
        scale = scene.motion_scale(everything, np.concatenate([motion for _, motion in arrows.values()]))
    scene.plot_lines(ax, rest, color=REST, linewidth=0.7, gid="structure", zorder=1)
    for part, colour, marker, order in (("im", BLUE, "s", 2), ("re", VERMILLION, "o", 3)):
        place, motion = arrows[part]
        tips = place + scale * motion
        scene.plot_lines(ax, np.stack([place, tips], axis=1), color=colour, linewidth=0.9, gid=part, zorder=order)
        ends = scene.plot_coordinates(tips).T
        ax.plot(*ends, marker, color=colour, markersize=2.6, gid=f"{part} tip", zorder=order)
        everything = np.concatenate([everything, tips])
    mode = str(table["mode"].iloc[0]) if len(table) else ""
    scene.frame_panel(ax, everything, f"{mode}   rms {_rms(table):.1f} σ" if mode else "no mode")
    return ax


def sensor_misfit_figure(table: pd.DataFrame, rest: np.ndarray, *, stage: str = "base") -> Figure:
    """Draw the sensors over all modes, and below them the arrows of the three worst modes on one scale.

    Parameters
    ----------
    table : DataFrame
        As for `draw_sensor_misfit`.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    stage : str
        The rows to draw.
    """
    rows = table[(table["stage"] == stage) & table[scene.PLACE].notna().all(axis=1)]
    by_mode = {str(mode): part for mode, part in rows.groupby("mode", sort=False)}
    worst = sorted(by_mode, key=lambda mode: -np.nan_to_num(_rms(by_mode[mode])))[:3]
    points = _everything(rest, rows)
    wide, high = scene.seen_size(points, scene.largest_drawn(points))
    upper = min(figure_width() * high / wide + 2 * scene.HEADING, 4.4)
    lower = min(figure_width() / 3 * high / wide + 2 * scene.HEADING, figure_width() / 3) if worst else 0.0
    foot = scene.FOOT + scene.over_strip(scene.BAR + 0.65)
    figure = scene.new_scene(upper + lower + foot, foot)
    grid = figure.add_gridspec(2 if worst else 1, 3, height_ratios=[upper, lower] if worst else None)
    main = draw_sensor_misfit(table, rest, figure.add_subplot(grid[0, :], projection="3d"), stage=stage)
    shown = [by_mode[mode] for mode in worst]
    motions = [measured_motions(t.assign(measured_re=t[part]))[1] for t in shown for part in ("re", "im")]
    scale = scene.motion_scale(points, np.concatenate(motions)) if motions else None
    for k, part in enumerate(shown):
        draw_mode_misfit(part, rest, figure.add_subplot(grid[1, k], projection="3d"), scale=scale)
    scene.show_axes(figure)
    height = float(figure.get_size_inches()[1])
    if motions:
        longest = float(np.linalg.norm(np.concatenate(motions), axis=1).max(initial=0.0))
        handles = [
            Line2D([], [], color=VERMILLION, marker="o", markersize=3.5, linewidth=0.9, label="real part"),
            Line2D([], [], color=BLUE, marker="s", markersize=3.5, linewidth=0.9, label="imaginary part"),
        ]
        at = (0.0, (scene.FOOT + scene.BAR) / height) if in_column() else (0.95 / figure_width(), 0.02 / height)
        legend = figure.legend(handles=handles, loc="lower left", bbox_to_anchor=at)
        legend.set_title(f"arrows: longest {longest:.1f} σ", FontProperties(size=8.5))
        legend.set_alignment("left")
    worst_sensors = sensor_rms(rows).head(3).itertuples()
    words = [f"{n}  {row.sensor}: {row.rms:.1f} σ" for n, row in enumerate(worst_sensors, start=1)]
    left = (1.05 if in_column() else 3.0) / figure_width()
    figure.text(left, 0.1 / height, "\n".join(["worst sensors:", *words]), fontsize=8.5, va="bottom")
    (dots,) = main.collections
    scene.colour_bar(figure, cast(ScalarMappable, dots), "rms over the modes (σ; noise alone: about 1)")
    return figure


def draw_perturbations(
    table: pd.DataFrame,
    rest: np.ndarray,
    ax: Axes3D | None = None,
    *,
    kind: str = "stiffness",
    limit: float | None = None,
    best: pd.DataFrame | None = None,
) -> Axes3D:
    """Draw the scores of local perturbations of one kind at their locations.

    Parameters
    ----------
    table : DataFrame
        Columns ``perturbation, kind, x, y, z`` (m) and ``score`` (signed, in standard deviations; NaN where the
        parameters absorb the perturbation). Perturbations without coordinates are not drawn.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional
    kind : str
        The rows to draw.
    limit : float, optional
        Score of the darkest colour; by default that of `score_limit`.
    best : DataFrame, optional
        Rows to number, as from `best_perturbations`.

    Returns
    -------
    Axes3D
        Circles with the gid ``score``, the largest at the back, and small crosses with the gid ``absorbed``.
    """
    ax = scene.new_axes(ax)
    rows = table[(table["kind"] == kind) & table[scene.PLACE].notna().all(axis=1)]
    rows = rows.iloc[np.argsort(-rows["score"].abs().to_numpy(dtype=float), kind="stable")]
    limit = score_limit(table) if limit is None else limit
    place, score = rows[scene.PLACE].to_numpy(dtype=float), rows["score"].to_numpy(dtype=float)
    known = np.isfinite(score)
    scene.plot_lines(ax, rest, color=REST, linewidth=0.8, gid="structure", zorder=1)
    absorbed = scene.plot_coordinates(place[~known]).T
    ax.plot(*absorbed, "x", color=GREY, markersize=3.0, markeredgewidth=0.7, gid="absorbed", zorder=2)
    scene.draw_dots(ax, place[known], score[known], Normalize(-limit, limit), "RdBu_r", "score")
    scene.frame_panel(ax, np.concatenate([rest.reshape(-1, 3), place]), f"{kind}, local changes: {len(rows)}")
    marked = list((best_perturbations(table) if best is None else best).index)
    scene.number_points(
        ax, place, {k: marked.index(label) + 1 for k, label in enumerate(rows.index) if label in marked}
    )
    return ax


def score_limit(table: pd.DataFrame) -> float:
    """Return the score of the darkest colour: the largest absolute score, at least 5."""
    return float(np.nanmax(np.append(table["score"].abs().to_numpy(dtype=float), 5.0)))


def best_perturbations(table: pd.DataFrame, count: int = 3) -> pd.DataFrame:
    """Return the rows with the largest absolute ``score`` among those with coordinates."""
    placed = table[table[[*scene.PLACE, "score"]].notna().all(axis=1)]
    return placed.iloc[np.argsort(-placed["score"].abs().to_numpy(dtype=float), kind="stable")[:count]]


def perturbation_map_figure(table: pd.DataFrame, rest: np.ndarray) -> Figure:
    """Draw one panel of `draw_perturbations` per kind and name the three best: places to inspect, not causes.

    Parameters
    ----------
    table : DataFrame
        As for `draw_perturbations`, and the columns ``unabsorbed`` (fraction of the signature that the parameters
        cannot absorb) and ``limit`` (absolute score that noise alone rarely exceeds anywhere; one for all).
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    """
    kinds = [
        k
        for k in (*PERTURBATION_KINDS, *sorted(set(table["kind"]) - {*PERTURBATION_KINDS}))
        if (table["kind"] == k).any()
    ]
    kinds = kinds or [PERTURBATION_KINDS[0]]
    shown = _everything(rest, table)
    wide, high = scene.seen_size(shown, 0.3 * scene.largest_drawn(shown))
    # A long low structure is shown best with the panels above one another.
    columns = 1 if high < 0.28 * wide or len(kinds) == 1 else min(len(kinds), 2)
    count = math.ceil(len(kinds) / columns)
    panel = figure_width() / columns
    best = best_perturbations(table)
    named = [_in_words(n, row) for n, row in enumerate(best.to_dict("records"), start=1)]
    heading = "largest scores (γ: not explained):"
    words = "\n".join([heading, *named]) if named else "No local stiffness or mass change has a score"
    words += "\n×  explained by parameters" if table["score"].isna().any() else ""
    # The list stands above the colour bar, in the place of a panel where one is free.
    free = count * columns > len(kinds) and not in_column()
    strip = scene.FOOT + scene.over_strip(scene.BAR)
    foot = strip + (0.0 if free else 0.1 + 0.15 * (words.count("\n") + 1))
    figure = scene.new_scene(count * min(panel * high / wide + 3 * scene.HEADING, panel, 4.4) + foot, foot)
    grid = figure.add_gridspec(count, columns)
    limit = score_limit(table)
    for k, kind in enumerate(kinds):
        ax = figure.add_subplot(grid[k // columns, k % columns], projection="3d")
        draw_perturbations(table, rest, ax, kind=kind, limit=limit, best=best)
    scene.show_axes(figure)
    height = float(figure.get_size_inches()[1])
    left = (0.1 if in_column() else 4.5) / figure_width()
    figure.text(left, (strip + 0.02) / height, words, fontsize=8.5, va="bottom")
    colours = ScalarMappable(Normalize(-limit, limit), "RdBu_r")
    noise = f"; noise alone: within ±{fixed(table['limit'].iloc[0], 1)}" if len(table) else ""
    scene.colour_bar(figure, colours, f"score z (–{noise})")
    return figure


def _everything(rest: np.ndarray, placed: pd.DataFrame) -> np.ndarray:
    """Ends of the mesh's lines and the coordinates in a table."""
    return np.concatenate([rest.reshape(-1, 3), placed[scene.PLACE].dropna().to_numpy(dtype=float)])


def _in_words(number: int, row: dict[Hashable, Any]) -> str:
    """Name, kind, score, unabsorbed fraction and place of a perturbation, on as many lines as needed."""
    name = textwrap.fill(f"{number}  {row['perturbation']}", 46, subsequent_indent="     ")
    facts = f"{row['kind']}, z = {fixed(row['score'], 1, sign=True)}, γ = {row.get('unabsorbed', math.nan):.2f}"
    at = place_of([float(row[axis]) for axis in scene.PLACE])
    return f"{name}\n     {facts.replace('-', '−')}\n     x, y, z = {at} m"


def _rms(table: pd.DataFrame) -> float:
    """Root mean square of the known real and imaginary parts; NaN without any."""
    parts = table[["re", "im"]].to_numpy(dtype=float)
    parts = parts[np.isfinite(parts)]
    return math.sqrt(float(np.mean(parts**2))) if parts.size else math.nan
