"""Figure of what is proposed and where: places of the best compositions on the model, with their evidence."""

from __future__ import annotations

import textwrap
from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report import scene
from calib.report.numbers import counted, fixed, flag
from calib.report.style import BLUE, REST, figure_width, in_column

BEST = 3
"""Proposals that are drawn in any case; of the others those that are as good as the first one."""
_WIDE = 62
"""Letters in a line of the key."""
_MOST_LINES = 3
"""Lines for one proposal in the key."""


def placed_proposals(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of the best three proposals, of the ones as good as the first, and of compositions like the first.

    Parameters
    ----------
    table : DataFrame
        As for `draw_proposals`.
    """
    own = table["fitted"].map(flag)
    best = own & ((table["rank"] <= BEST) | table["close"].map(flag))
    return table[(best | (~own & (table["rank"] == 1))) & table[scene.PLACE].notna().all(axis=1)]


def draw_proposals(table: pd.DataFrame, rest: np.ndarray, ax: Axes3D | None = None) -> Axes3D:
    """Draw the places of the proposals that `placed_proposals` selects.

    Parameters
    ----------
    table : DataFrame
        Columns ``rank, kind, at, fitted, close, evidence, x, y, z`` (m), one row for each place of a proposal, or of a
        composition that was not fitted since its signature is like that of the proposal of this rank. Places without
        coordinates are not drawn.
    rest : ndarray (n, 2, 3)
        Lines of the mesh, in metres.
    ax : Axes3D, optional

    Returns
    -------
    Axes3D
        Circles with the gid ``evidence``, numbered by rank, and small open squares with the gid ``alike``.
    """
    ax = scene.new_axes(ax)
    rows = placed_proposals(table)
    fitted = rows["fitted"].map(flag)
    scene.plot_lines(ax, rest, color=REST, linewidth=0.8, gid="structure", zorder=1)
    alike = rows[~fitted][scene.PLACE].to_numpy(dtype=float)
    ax.plot(
        *scene.plot_coordinates(alike).T, "s", markerfacecolor="none", color=BLUE, markersize=5, gid="alike", zorder=5,
        clip_on=False,
    )  # fmt: skip
    own = rows[fitted].iloc[::-1]  # the best on top
    place, evidence = own[scene.PLACE].to_numpy(dtype=float), own["evidence"].to_numpy(dtype=float)
    scene.draw_dots(ax, place, np.maximum(evidence, 0.0), Normalize(0.0, _largest(table)), "YlOrRd", "evidence")
    scene.frame_panel(ax, np.concatenate([rest.reshape(-1, 3), place, alike]), "")
    ranks: dict[tuple[float, ...], list[int]] = {}
    for at, rank in zip(place.round(6).tolist(), own["rank"], strict=True):
        ranks.setdefault(tuple(at), []).append(int(rank))
    points = np.array(list(ranks)).reshape(-1, 3)
    scene.number_points(ax, points, {k: ", ".join(map(str, sorted(set(own)))) for k, own in enumerate(ranks.values())})
    return ax


def proposals_figure(table: pd.DataFrame, rest: np.ndarray) -> Figure:
    """Draw `draw_proposals`, and below it what each number is: a place to inspect, not a cause."""
    rows = placed_proposals(table)
    fitted = rows["fitted"].map(flag)
    own = rows[fitted].drop_duplicates("rank").sort_values("rank")
    lines = [line for row in own.to_dict("records") for line in _in_words(row)]
    like = rows[~fitted].drop_duplicates(["kind", "at"])
    if len(like):
        lines.append(f"□  {counted(len(like), 'composition')} like the first, which these data cannot discriminate")
    points = np.concatenate([rest.reshape(-1, 3), rows[scene.PLACE].to_numpy(dtype=float)])
    wide, high = scene.seen_size(points, scene.largest_drawn(points))
    foot = scene.FOOT + scene.over_strip(scene.BAR) + 0.25 + 0.15 * len(lines)
    figure = scene.new_scene(min(figure_width() * high / wide + 2 * scene.HEADING, 4.4) + foot, foot)
    draw_proposals(table, rest, figure.add_subplot(projection="3d"))
    scene.show_axes(figure)
    height = float(figure.get_size_inches()[1])
    figure.text(
        (0.1 if in_column() else 1.0) / figure_width(),
        (foot - 0.05) / height,
        "\n".join(lines),
        fontsize=8.5,
        va="top",
        linespacing=1.25,
    )
    scene.colour_bar(
        figure, ScalarMappable(Normalize(0.0, _largest(table)), "YlOrRd"), "evidence less ln of the choices"
    )
    return figure


def _largest(table: pd.DataFrame) -> float:
    return float(np.nanmax(np.append(placed_proposals(table)["evidence"].to_numpy(dtype=float), 3.0)))


def _in_words(row: Mapping[Hashable, Any]) -> list[str]:
    """Rank, kind, place and evidence of a proposal, on as many lines as needed."""
    equal = ", as good as the first" if flag(row["close"]) and row["rank"] > 1 else ""
    words = f"{row['kind']}: {row['at']}"
    text = textwrap.wrap(words, _WIDE - 16 * in_column(), max_lines=_MOST_LINES, placeholder=" …")
    first, *others = (*text[:-1], f"{text[-1]} ({fixed(row['evidence'], 1)}{equal})")
    return [f"{row['rank']:.0f}  {first}", *(f"    {line}" for line in others)]
