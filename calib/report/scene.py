"""Three-dimensional panels of a structure: its lines, circles at places, numbers, and what explains them."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.shapes import frame_scene, plot_coordinates, plot_lines, view_directions
from calib.report.style import BLACK, DPI, WIDTH

PLACE = ["x", "y", "z"]
FOOT = 0.8
"""Height in inches of the strip that explains the panels."""
HEADING = 0.2
"""Height in inches of the title over a panel."""
_LEADER = 16.0
"""Length in points of the line to a number."""


def segments(structure: pd.DataFrame) -> np.ndarray:
    """Return the lines of the mesh, (n, 2, 3) in metres, from columns ``x0..z0, x1..z1``."""
    return structure[["x0", "y0", "z0", "x1", "y1", "z1"]].to_numpy(dtype=float).reshape(-1, 2, 3)


def new_figure(height: float, foot: float = FOOT) -> Figure:
    """Return an empty figure whose panels fill it above a foot, both heights in inches."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    figure.subplots_adjust(left=0.0, right=1.0, top=1.0, bottom=foot / height, wspace=0.0, hspace=0.0)
    return figure


def new_axes(ax: Axes3D | None) -> Axes3D:
    """Return the given Axes, or the only ones of a new figure, ready for circles over lines."""
    if ax is None:
        figure = Figure(figsize=(5.0, 4.2), dpi=DPI)
        ax = cast(Axes3D, figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d"))
    # Otherwise all lines are drawn over all circles.
    ax.computed_zorder = False
    return ax


def draw_dots(ax: Axes3D, points: np.ndarray, values: np.ndarray, norm: Normalize, colours: str, gid: str) -> None:
    """Draw circles whose area grows with the size of the value, and which are coloured by it.

    Parameters
    ----------
    ax : Axes3D
    points : ndarray (n, 3)
        Metres.
    values : ndarray (n,)
    norm : Normalize
        Values of the ends of the colour map.
    colours : str
        Name of the colour map.
    gid : str
        By which the circles are found again.
    """
    area = 8.0 + 110.0 * np.abs(values) / max(abs(norm.vmin or 0.0), abs(norm.vmax or 0.0))
    looks = {"edgecolors": BLACK, "linewidths": 0.5, "depthshade": False, "clip_on": False, "zorder": 4}
    ax.scatter(*plot_coordinates(points).T, c=values, s=area, cmap=colours, norm=norm, gid=gid, **looks)


def frame_panel(ax: Axes3D, points: np.ndarray, title: str) -> None:
    """Fill the panel with the view of points (n, 3), in metres, and write the title over it."""
    frame_scene(ax, plot_coordinates(points) if len(points) else np.zeros((1, 3)), heading=HEADING)
    ax.text2D(0.5, 1.0, title, transform=ax.transAxes, ha="center", va="top", fontsize=8.5)


def number_points(ax: Axes3D, points: np.ndarray, numbers: dict[int, int]) -> None:
    """Number some of the points, each towards the side where there is most room inside the panel.

    Parameters
    ----------
    ax : Axes3D
        Framed already.
    points : ndarray (n, 3)
        Everything that a number must not cover, metres.
    numbers : dict from int to int
        Row of `points`, and what is written beside it.
    """
    if not numbers:
        return
    ax.apply_aspect()
    x, y, _ = proj_transform(*plot_coordinates(points).T, ax.get_proj())
    flat = np.column_stack([x, y])
    seen = ax.transData.transform(flat)
    turns = np.arange(12) * math.pi / 6.0
    offsets = _LEADER * np.column_stack([np.cos(turns), np.sin(turns)])
    box = ax.get_position(original=True).transformed(ax.get_figure(root=True).transFigure).padded(-8.0)
    taken = seen
    for k, number in numbers.items():
        ends = seen[k] + offsets * DPI / 72.0
        room = np.linalg.norm(ends[:, None] - taken, axis=2).min(axis=1)
        best = int(np.argmax(room - 1e3 * np.array([not box.contains(*end) for end in ends])))
        taken = np.vstack([taken, ends[best]])
        ax.annotate(
            str(number),
            flat[k],
            xytext=offsets[best],
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8.5,
            fontweight="bold",
            zorder=6,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "linewidth": 0.7, "shrinkA": 1.0, "shrinkB": 2.0},
        )


def seen_size(structure: pd.DataFrame, placed: pd.DataFrame, margin: float) -> tuple[float, float]:
    """Return width and height of what the view shows, in metres, with a margin as a fraction of the diagonal."""
    points = np.concatenate([segments(structure).reshape(-1, 3), placed[PLACE].dropna().to_numpy(dtype=float)])
    if not len(points):
        return 1.0, 0.5
    wide, high = np.ptp(plot_coordinates(points) @ view_directions().T, axis=0)
    room = margin * float(np.linalg.norm(np.ptp(points, axis=0)))
    return float(wide + room) or 1.0, float(high + room)


def show_axes(figure: Figure) -> None:
    """Draw the directions of the axes in the lower left corner."""
    height = float(figure.get_size_inches()[1])
    corner = cast(Axes3D, figure.add_axes((0.1 / WIDTH, 0.04 / height, 0.75 / WIDTH, 0.68 / height), projection="3d"))
    arrows = np.eye(3)
    plot_lines(corner, np.stack([0.0 * arrows, arrows], axis=1), color=BLACK, linewidth=1.0)
    for name, (x, y, z) in zip("xyz", plot_coordinates(1.35 * arrows), strict=True):
        corner.text(x, y, z, name, fontsize=8.5, ha="center", va="center")
    frame_scene(corner, plot_coordinates(1.4 * np.concatenate([0.0 * arrows, arrows])))


def colour_bar(figure: Figure, colours: ScalarMappable, label: str) -> None:
    """Draw a colour bar in the lower right corner."""
    height = float(figure.get_size_inches()[1])
    ax = figure.add_axes((4.9 / WIDTH, 0.5 / height, 2.9 / WIDTH, 0.12 / height), label="colours")
    figure.colorbar(colours, cax=ax, orientation="horizontal", label=label)
