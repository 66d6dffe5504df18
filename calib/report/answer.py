"""The answer of an explanation in one picture: the place, and an error without and with what is missing."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report import scene
from calib.report.numbers import fixed, places, significant
from calib.report.style import AFTER, BLACK, GREY, MEASURED, REST, VERMILLION, WITH, figure_width, fill, in_column
from calib.report.svg import hover

_DATA = {
    "held_out_sensors": "at sensors that\nno fit has seen",
    "held_out_references": "at references that\nno fit has seen",
    "held_out_modes": "in modes that\nno fit has seen",
    "held_out_responses": "in responses that\nno fit has seen",
    "held_out_bands": "in bands that\nno fit has seen",
    "left_out": "in data left out\nin turn",
    "fit": "in the data used",
}
"""Groups of data whose error may be drawn, the most telling first: those that no fit has seen."""
_STAR: dict[str, Any] = {"marker": "*", "color": VERMILLION, "markeredgecolor": BLACK, "markersize": 19}
_DATA_ALONE: dict[str, Any] = {"marker": "D", "color": "none", "markeredgecolor": BLACK, "markersize": 9}
_SHOWS_MOST: dict[str, Any] = {"marker": "o", "color": "none", "markeredgecolor": MEASURED, "markersize": 14}
_UNDER, _AROUND = 0.03, 22
"""Distance from a star, of the diagonal of the model, at which it would hide the diamond, and its size around it."""
_LOOKS = {"star": _STAR, "diamond": _DATA_ALONE, "ring": _SHOWS_MOST}
_IN_LEGEND = 11
"""Largest mark of the legend, points."""
_SENSOR: dict[str, Any] = {"marker": "o", "color": GREY, "markersize": 4}
_LINES = {"linestyle": "none", "clip_on": False}
_BESIDE_BARS = 64
"""Characters of a line of the legend that end before the labels of the bars."""
_LETTERS = 50
"""Those of one in a column."""
_BELOW, _LABELS = 2.9, 0.85
"""Heights in inches of the bars below the model in a column, and of the labels below them."""
_NAME = 14
"""Characters of a line below a bar."""
_PLACES = 2
"""Places of effects that are written."""
_PANEL = 0.72
"""Width of the model's panel over that of the figure, beside the bars."""


@dataclass(frozen=True, eq=False)
class AnsweredPlace:
    """Where an explanation points.

    Attributes
    ----------
    acts : ndarray (n, 3)
        Where the named effects act, m; empty where only the data point somewhere.
    sensor : str
        Sensor at which the shapes show it most; empty where that is not known.
    sensor_at : ndarray (3,)
    alone : str
        Local change that fits best by itself; empty where none stands out.
    alone_at : ndarray (3,)
    away : float
        Its distance from where the effects act, m; NaN where either is unknown, and for a change of a whole part.
    alone_sensor : str
        Sensor of that change; empty for a change of a whole part.
    """

    acts: np.ndarray
    sensor: str
    sensor_at: np.ndarray
    alone: str
    alone_at: np.ndarray
    away: float
    alone_sensor: str = ""

    def marks(self, what: str) -> dict[str, str]:
        """What each mark of the picture stands for, by ``star``, ``diamond`` and ``ring``; ``what`` for the effects."""
        out = {}
        if len(self.acts):
            first = places(self.acts[:_PLACES].tolist(), _PLACES)
            more = len(self.acts) - _PLACES
            also = f" and {more} more place{'s' if more > 1 else ''}" if more > 0 else ""
            out["star"] = f"{what},\nat {first} m{also},\nas the list of causes assumes"
        if self.alone:
            away = "" if np.isnan(self.away) else f", {significant(self.away, 2)} m from the star"
            best = f"of single masses or springs anywhere,\n{self.alone} fits best"
            out["diamond"] = f"{best}{away}" if len(self.acts) else f"the data point to\n{self.alone}"
        if self.sensor:
            out["ring"] = f"sensor {self.sensor},\nwhose motion the cause changes most"
        return out


def answered_place(
    sensors: pd.DataFrame | None,
    acts: pd.DataFrame | None,
    pattern: pd.DataFrame | None,
    perturbations: pd.DataFrame | None,
    attempt: bool = False,
) -> AnsweredPlace | None:
    """Where an explanation points; None where neither an effect with a place nor the data point anywhere.

    Beside a named effect the data point at the local change with the largest score, where noise does not explain it;
    without one, or beside an ``attempt``, at the place that the verdict tells, if any.

    Parameters
    ----------
    sensors : DataFrame, optional
        Columns ``sensor, x, y, z`` (m).
    acts : DataFrame, optional
        Columns ``effect, x, y, z`` (m), of every effect of the list.
    pattern : DataFrame, optional
        Columns ``effect, sensor, signature``, of the named effects.
    perturbations : DataFrame, optional
        Columns ``perturbation, sensor`` (empty for a part), ``x, y, z`` (m), ``score, limit, told``.
    attempt : bool
        Whether the effects of the pattern are not named: something like them is missing.
    """
    nowhere: np.ndarray = np.full(3, np.nan)
    names = [] if pattern is None else list(dict.fromkeys(pattern["effect"]))
    own: np.ndarray = np.zeros((0, 3))
    if acts is not None:
        own = acts.loc[acts["effect"].isin(names), scene.PLACE].to_numpy(dtype=float)
    sensor, sensor_at, alone, alone_at, away, alone_sensor = "", nowhere, "", nowhere, math.nan, ""
    if sensors is not None and pattern is not None:
        placed = sensors.dropna(subset=scene.PLACE).set_index("sensor")
        size = (pattern["signature"] ** 2).groupby(pattern["sensor"].fillna("")).sum()
        size = size[[name in placed.index for name in size.index]]
        if len(size):
            sensor = str(size.idxmax())
            sensor_at = placed[scene.PLACE].to_numpy(dtype=float)[placed.index.get_loc(sensor)]
    if perturbations is not None and (pattern is None or attempt):
        told = perturbations["told"] if "told" in perturbations else pd.Series(False, perturbations.index)
        perturbations = perturbations[told.eq(True)]
    if perturbations is not None and perturbations["score"].notna().any():
        best = perturbations.iloc[int(np.nanargmax(perturbations["score"].abs().to_numpy(dtype=float)))]
        at = best[scene.PLACE].to_numpy(dtype=float)
        if abs(best["score"]) > best["limit"] and np.isfinite(at).all():
            alone, alone_at, alone_sensor = str(best["perturbation"]), at, str(best["sensor"] or "")
            if best["sensor"] and len(own):
                away = float(np.linalg.norm(own - at, axis=1).min())
    if not len(own) and not alone:
        return None
    return AnsweredPlace(own, sensor, sensor_at, alone, alone_at, away, alone_sensor)


def most_telling_error(errors: pd.DataFrame | None) -> pd.DataFrame | None:
    """Rows of the group of data whose error is drawn, by stage: ``rms, expected``; None without an error after."""
    if errors is None or not {"before", "after"} <= set(errors["stage"]):
        return None
    for group in _DATA:
        rows = errors[errors["group"] == group].set_index("stage")
        if {"before", "after"} <= set(rows.index) and rows.loc[["before", "after"], "rms"].notna().all():
            return rows.loc[["before", "after"]]
    return None


def answer_figure(
    rest: np.ndarray,
    found: AnsweredPlace,
    what: Sequence[str],
    sizes: Mapping[str, str] = MappingProxyType({}),
    sensors: pd.DataFrame | None = None,
    errors: pd.DataFrame | None = None,
) -> Figure:
    """Draw the place on the model, and the error without and with what is missing.

    Parameters
    ----------
    rest : ndarray (n, 2, 3)
        Lines of the model, m.
    found : AnsweredPlace
    what : sequence of str
        What is missing, as the labels name it.
    sizes : mapping from str to str
        Magnitude of each of them in words, where it is known.
    sensors : DataFrame, optional
        Columns ``sensor, x, y, z`` (m).
    errors : DataFrame, optional
        Columns ``group, stage, rms, expected``, in standard deviations.

    Returns
    -------
    Figure
        Marks with the gids ``acts``, ``alone``, ``shows`` and ``sensors``; bars with the gid of their stage.
    """
    bars = most_telling_error(errors)
    narrow = in_column()
    wide = _PANEL if bars is not None and not narrow else 1.0
    points = rest.reshape(-1, 3)
    width, high = scene.seen_size(points, 0.1)
    marks = found.marks(",\n".join(f"{one}, {sizes[one]}" if sizes.get(one) else one for one in what))
    if bars is not None or narrow:  # whose labels stand beside
        marks = {mark: _folded(text, _LETTERS if narrow else _BESIDE_BARS) for mark, text in marks.items()}
    foot = max(0.15 + 0.2 * sum(1 + text.count("\n") for text in marks.values()), 0.8) + scene.over_strip(scene.FOOT)
    below = _BELOW if narrow and bars is not None else 0.0
    height = min(max(wide * figure_width() * high / width, 2.2), 4.6) + foot + below
    figure = scene.new_scene(height, foot)
    if below:
        panels = figure.add_gridspec(2, 1, height_ratios=(height - foot - below, below))
    else:
        panels = figure.add_gridspec(1, 2, width_ratios=(wide, max(1.0 - wide, 1e-3)))
    ax: Axes3D = scene.new_axes(figure.add_subplot(panels[0], projection="3d"))
    scene.plot_lines(ax, rest, color=REST, linewidth=2.0, gid="model")
    if sensors is not None:
        placed = sensors.dropna(subset=scene.PLACE)
        _mark(ax, placed[scene.PLACE].to_numpy(dtype=float), "sensors", _SENSOR, 3)
        scene.hover_places(ax, placed[scene.PLACE].to_numpy(dtype=float), placed["sensor"].astype(str).tolist())
    if found.sensor:
        _mark(ax, found.sensor_at[None], "shows", {**_SHOWS_MOST, "markeredgewidth": 2.0}, 5)
    if found.alone:
        apart = np.linalg.norm(found.acts - found.alone_at, axis=1).min(initial=np.inf)
        under = apart < _UNDER * float(np.linalg.norm(np.ptp(points, axis=0)))
        size = {"markersize": _AROUND} if under else {}
        _mark(ax, found.alone_at[None], "alone", {**_DATA_ALONE, "markeredgewidth": 1.6, **size}, 5)
    if len(found.acts):
        _mark(ax, found.acts, "acts", _STAR, 6)
    named = [(found.sensor, found.sensor_at), (found.alone_sensor, found.alone_at)]
    named = [(name, at) for name, at in dict(named).items() if name]
    alone = [found.alone_at[None]] if found.alone else []
    sides = scene.side_arrows(points)
    known = np.concatenate([points, *(at[None] for _, at in named), *alone, found.acts, *sides.values()])
    radii = np.zeros(len(known))
    radii[len(known) - len(found.acts) - 2 * len(sides) :] = _STAR["markersize"] / 2
    scene.frame_panel(ax, known, "")
    scene.number_points(ax, known, {len(points) + k: name for k, (name, _) in enumerate(named)}, radii)
    scene.mark_sides(ax, sides)
    handles = [Line2D([], [], linestyle="none", label=text, **_LOOKS[mark]) for mark, text in marks.items()]
    for handle in handles:
        handle.set_markersize(min(handle.get_markersize(), _IN_LEGEND))
    if sensors is not None and len(placed):
        handles.append(Line2D([], [], linestyle="none", label="sensors", **_SENSOR))
    at = (0.1 / figure_width(), scene.FOOT / height) if narrow else (1.05 / figure_width(), 0.02)
    figure.legend(handles=handles, loc="lower left", bbox_to_anchor=at, borderaxespad=0.0, labelspacing=0.7)
    scene.show_axes(figure)
    if bars is not None:
        above = 0.65  # inches of the title, which the panel of the model does not have
        free = (above, below - above - _LABELS, _LABELS) if below else (above, height - foot - above)
        around = panels[1].subgridspec(len(free), 3, width_ratios=(0.3, 1.0, 0.04), height_ratios=free, hspace=0.0)
        _draw_pair(figure.add_subplot(around[1, 1]), bars, what)
    return figure


def _folded(text: str, letters: int) -> str:
    return "\n".join(fill(line, letters) for line in text.splitlines())


def _mark(ax: Axes3D, points: np.ndarray, gid: str, look: dict[str, Any], order: int) -> None:
    ax.plot(*scene.plot_coordinates(points).T, gid=gid, zorder=order, **_LINES, **look)


def _draw_pair(ax: Axes, bars: pd.DataFrame, what: Sequence[str]) -> None:
    """One pair of bars, and lines at what a correct model would reach with this noise."""
    values, expected = (bars[name].to_numpy(dtype=float) for name in ("rms", "expected"))
    without, with_it = (
        ("without\nthem", "with\nthem")
        if len(what) > 1
        else ("\n".join(["without", *(textwrap.fill(one, _NAME) for one in what)]), "with it")
    )
    for k, (stage, colour, label) in enumerate((("before", AFTER, "without"), ("after", WITH, with_it))):
        (bar,) = ax.bar([k], [values[k]], 0.62, color=colour, gid=stage)
        hover(bar, f"{' '.join(label.split())}: {fixed(values[k], 2)} σ")
        ax.annotate(
            fixed(values[k], 2),
            (k, np.nanmax([values[k], expected[k]])),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
        )
        ax.hlines(expected[k], k - 0.42, k + 0.42, color=BLACK, linewidth=1.6, gid=f"expected {stage}")
    ax.set_xticks([0, 1], [without, with_it])
    ax.set_xlim(-0.6, 1.6)
    ax.set_ylim(0.0, 1.15 * float(np.nanmax([*values, *expected])))
    group = str(bars["group"].iloc[0]) if "group" in bars else "fit"
    ax.set_title(f"error {_DATA[group]}\n(standard deviations)", fontsize=8.5)
    ax.set_xlabel("lines: a correct model\nwith this noise", fontsize=8)
    ax.grid(axis="y")
