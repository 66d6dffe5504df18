"""The modes of a model alone, coloured by amplitude."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from calib.report import scene
from calib.report.mesh import (
    BORDER,
    FACE,
    MeshTables,
    Pieces,
    bodies,
    draw_pieces,
    motions,
    pieces,
    point_coordinates,
    thickness,
)
from calib.report.style import REST, in_column

PANELS = 8
"""Largest number of modes in one figure."""

AMPLITUDE = ListedColormap(colormaps["viridis_r"](np.linspace(0.14, 0.8, 256)))
"""Colours from zero to the largest motion, without the ends: invisible on white paper and beside dark borders."""
_NEAR = 0.2
"""Fraction of its diagonal by which a body's box is widened to find neighbouring bodies."""
_BORDER = "#101010"
_WIDTHS = np.array([0.3, 0.5, 1.8])
"""Line widths of the edges of faces, borders and lines, in points."""


def pages(modes: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Distribute a table of modes evenly over figures of at most eight; the keys are the figures' suffixes.

    The suffixes are ``_1, _2, ...``, or empty where one figure holds all modes.
    """
    count = math.ceil(len(modes) / PANELS)
    size = math.ceil(len(modes) / max(count, 1))
    return {f"_{k + 1}" if count > 1 else "": modes.iloc[k * size : (k + 1) * size] for k in range(count)}


def views(parts: Pieces, rest: np.ndarray, motion: np.ndarray) -> list[np.ndarray]:
    """Return the views of a mode: all pieces, or each small part of a large structure that dominates the motion.

    Bodies longer than half the structure are large; the others form one part where their boxes nearly meet. A mode
    whose largest motion lies in a part that is small against the structure (a quarter of its diagonal) has one view of
    each such part that moves at least half as much, from the lower end of the longest axis to the upper.

    Parameters
    ----------
    parts : Pieces
    rest, motion : ndarray (n_points, 3)
        Coordinates in metres, and shape amplitude.

    Returns
    -------
    list of ndarray (n_pieces,), bool
    """
    if not len(parts.kind):
        return [np.ones(0, dtype=bool)]
    body = bodies(parts, len(rest))
    boxes = np.array([_box(rest, parts.corners[body == k]) for k in range(body.max() + 1)])
    extent = np.ptp(_box(rest, parts.corners), axis=0)
    small = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1) < np.linalg.norm(extent) / 2
    reach = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)[:, None] * _NEAR
    low, high = boxes[:, 0] - reach, boxes[:, 1] + reach
    meet = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
    cluster = connected_components(coo_array(meet & small & small[:, None]), directed=False)[1][body]
    amplitude = np.linalg.norm(motion, axis=1)[parts.corners].max(axis=1)
    lively = np.unique(cluster[amplitude >= amplitude.max() / 2])
    found = [cluster == k for k in lively if small[body[cluster == k][0]]]
    sizes = [float(np.linalg.norm(np.ptp(_box(rest, parts.corners[part]), axis=0))) for part in found]
    led = any(part[amplitude.argmax()] for part in found)
    if not led or max(sizes) > np.linalg.norm(extent) / 4:
        return [np.ones(len(parts.kind), dtype=bool)]
    axis = int(np.argmax(extent))
    return sorted(found, key=lambda part: float(rest[parts.corners[part], axis].mean()))


def draw_model_mode(
    deflection: pd.DataFrame,
    mesh: MeshTables,
    ax: Axes3D | None = None,
    *,
    chosen: np.ndarray | None = None,
    scale: float | None = None,
    title: str = "",
) -> Axes3D:
    """Draw one mode of the model: the deformed mesh coloured by amplitude, and the mesh at rest in grey.

    Parameters
    ----------
    deflection : DataFrame
        Motions of this mode: ``point, u, v, w`` (shape amplitude).
    mesh : MeshTables
    ax : Axes3D, optional
    chosen : ndarray (n_pieces,), bool, optional
        The pieces to draw, as from `views`; all by default.
    scale : float, optional
        Metres per unit of amplitude; by default the largest motion is a tenth of the diagonal of the drawn pieces.
    title : str
        Written above the panel.

    Returns
    -------
    Axes3D
        A line with the gid ``undeformed`` and pieces with the gid ``deformed``; the colour is the mean amplitude at a
        piece's corners over the largest of the mode.
    """
    ax = scene.new_axes(ax)
    parts, rest, motion = pieces(mesh), point_coordinates(mesh), motions(mesh, deflection)
    amplitude = np.linalg.norm(motion, axis=1)
    largest = float(amplitude[parts.corners].max(initial=0.0)) or 1.0
    shown = parts if chosen is None else parts.some(chosen)
    seen = np.unique(shown.corners)
    scale = scene.motion_scale(rest[seen], motion[seen], thickness(mesh)) if scale is None else scale
    moved = rest + scale * motion
    colours = AMPLITUDE(amplitude[shown.corners].mean(axis=1) / largest)
    kind = shown.kind[:, None]
    faces = np.where(kind == FACE, colours, 0.0)
    edges = np.where(kind == BORDER, to_rgba(_BORDER), colours)
    scene.plot_lines(ax, rest[shown.strokes], color=REST, linewidth=0.5, gid="undeformed", zorder=1)
    draw_pieces(ax, moved[shown.corners], shown.kind, faces, edges, _WIDTHS[shown.kind], "deformed")
    scene.frame_panel(ax, np.concatenate([rest[seen], moved[seen]]), title, _lines())
    return ax


def model_modes_figure(modes: pd.DataFrame, deflection: pd.DataFrame, mesh: MeshTables) -> Figure:
    """Draw one panel per mode; a mode that moves small parts of a large structure alone is shown at these parts.

    Parameters
    ----------
    modes : DataFrame
        Columns ``mode, damped_freq`` (Hz) and ``damping_ratio``, for the titles of the panels.
    deflection : DataFrame
        As for `draw_model_mode`, with a column ``mode``.
    mesh : MeshTables
    """
    parts, rest = pieces(mesh), point_coordinates(mesh)
    all_seen = rest[np.unique(parts.corners)]
    axis = int(np.argmax(np.ptp(all_seen, axis=0)))
    figure, cells = scene.panel_grid(
        len(modes), all_seen, thickness(mesh), foot=scene.FOOT + scene.over_strip(scene.BAR), lines=_lines()
    )
    for row, cell in zip(modes.to_dict("records"), cells, strict=True):
        rows = deflection[deflection["mode"] == row["mode"]]
        motion = motions(mesh, rows)
        looks = views(parts, rest, motion)
        seen = [np.unique(parts.corners[chosen]) for chosen in looks]
        scale = min(scene.motion_scale(rest[k], motion[np.concatenate(seen)], thickness(mesh)) for k in seen)
        within = cell.subgridspec(1, len(looks))
        for k, chosen in enumerate(looks):
            draw_model_mode(
                rows, mesh, figure.add_subplot(within[0, k], projection="3d"), chosen=chosen, scale=scale
            )  # fmt: skip
            if len(looks) > 1:
                middle = (rest[seen[k], axis].min() + rest[seen[k], axis].max()) / 2
                words = f"at {'xyz'[axis]} = {middle:.1f} m".replace("-", "−")
                over = figure.add_subplot(within[0, k], label="place")  # a panel in space is a square in its cell
                over.set_axis_off()
                _write_over(over, words, *((-24.0, 7.5) if in_column() else (-13.0, 8.5)))
        _write_title(figure, cell, row)
    scene.show_axes(figure)
    scene.write_size(figure, all_seen)
    scene.colour_bar(
        figure, ScalarMappable(Normalize(0.0, 1.0), AMPLITUDE), "amplitude over the largest of the mode (–)"
    )
    return figure


def _lines() -> int:
    """Lines of the title of a panel."""
    return 2 if in_column() else 1


def _box(rest: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Lowest and highest coordinates of the points at some corners, (2, 3)."""
    points = rest[corners.ravel()]
    return np.array([points.min(axis=0), points.max(axis=0)])


def _write_title(figure: Figure, cell: SubplotSpec, row: dict[Hashable, Any]) -> None:
    """Write name, damped frequency and damping above a cell, however many views it has."""
    ax = figure.add_subplot(cell, label="title")
    ax.set_axis_off()
    words = str(row["mode"]) + ("\n" if in_column() else "   ") + f"{row['damped_freq']:.2f} Hz"
    words += "" if not row["damping_ratio"] > 0.0 else f"   damping {100.0 * row['damping_ratio']:.1f} %"
    _write_over(ax, words)


def _write_over(ax: Axes, words: str, shift: float = 0.0, size: float = 8.5) -> None:
    """Write at the top of a panel, shifted by so many points, in that size."""
    ax.annotate(
        words, (0.5, 1.0), xycoords="axes fraction", xytext=(0.0, shift), textcoords="offset points", ha="center",
        va="top", fontsize=size, annotation_clip=False,
    )  # fmt: skip
