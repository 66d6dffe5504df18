"""The mesh of a model by group, with its sensors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.axes3d import Axes3D

from calib.report import scene
from calib.report.mesh import FACE, LINE, MeshTables, draw_pieces, pieces, point_coordinates, seen_places
from calib.report.style import BLACK, GREEN, GREY, MEASURED, ORANGE, PURPLE, SKY, YELLOW, figure_width, in_column

OTHER_LINES = "lines"
"""Group of lines that belong to no set."""
COLOURS = (SKY, ORANGE, GREEN, PURPLE, YELLOW, GREY)
_ABREAST = 4
"""Legend entries per row."""
_BORDER = "#303030"
_SHADE = 0.35
"""Fraction of a face's brightness that depends on its orientation."""
_STICK = 0.02
"""Length of a sensor's stick, as a fraction of the diagonal of the model's box."""
_FORCE: dict[str, Any] = {
    "marker": "*", "linestyle": "none", "color": BLACK, "markersize": 12, "markeredgecolor": "white",
}  # fmt: skip
"""Look of a place that was excited."""
_WIDTHS = np.array([0.25, 0.9, 1.3])
"""Line widths of the edges of faces, borders and lines, in points."""


def draw_model(
    mesh: MeshTables, sensors: pd.DataFrame | None = None, ax: Axes3D | None = None, forces: pd.DataFrame | None = None
) -> Axes3D:
    """Draw the mesh, faces coloured by group (lines where there are no faces), and the sensors on it.

    Parameters
    ----------
    mesh : MeshTables
    sensors : DataFrame, optional
        Columns ``direction, x, y, z`` (m); a translational sensor gets a stick along its direction; one without
        coordinates is not drawn.
    ax : Axes3D, optional
    forces : DataFrame, optional
        The same columns where the structure was excited.

    Returns
    -------
    Axes3D
        Pieces with the gid ``model``, lines with the gids ``sensors`` (one dot a place), ``directions`` and ``forces``.
    """
    ax = scene.new_axes(ax)
    parts, rest = pieces(mesh), point_coordinates(mesh)
    names = coloured_groups(mesh)
    vertices = rest[parts.corners]
    own = np.array([to_rgba(COLOURS[names.index(g) % len(COLOURS)]) if g in names else (0.0,) * 4 for g in parts.group])
    own = own.reshape(-1, 4) * np.column_stack(
        [np.repeat(_light(vertices)[:, None], 3, axis=1), np.ones(len(vertices))]
    )
    kind = parts.kind[:, None]
    faces = np.where(kind == FACE, own, 0.0)
    edges = np.where(kind == FACE, 0.85 * own + 0.15 * np.array([0.0, 0.0, 0.0, 1.0]), to_rgba(_BORDER))
    named = (kind == LINE) & np.isin(parts.group, names)[:, None]
    edges = np.where(named, own, np.where(kind == LINE, to_rgba(BLACK), edges))
    draw_pieces(ax, vertices, parts.kind, faces, edges, _WIDTHS[parts.kind], "model")
    seen = rest[np.unique(parts.corners)]
    if sensors is not None:
        placed = sensors[sensors[scene.PLACE].notna().all(axis=1)]
        place = placed[scene.PLACE].to_numpy(dtype=float)
        tips = sensor_tips(placed, np.concatenate([seen, place]))
        scene.plot_lines(ax, np.stack([place, tips], axis=1), color=MEASURED, linewidth=1.2, gid="directions", zorder=3)
        dots = scene.plot_coordinates(np.unique(place, axis=0)).T
        ax.plot(*dots, "o", color=MEASURED, markeredgecolor="white", markeredgewidth=0.5, markersize=4.5,
                gid="sensors", zorder=4)  # fmt: skip
        seen = np.concatenate([seen, place, tips])
    if forces is not None:
        place = forces.loc[forces[scene.PLACE].notna().all(axis=1), scene.PLACE].to_numpy(dtype=float)
        ax.plot(*scene.plot_coordinates(np.unique(place, axis=0)).T, gid="forces", zorder=5, **_FORCE)
    scene.frame_panel(ax, seen, "")
    return ax


def sensor_tips(sensors: pd.DataFrame, points: np.ndarray) -> np.ndarray:
    """Return the ends of the sensors' sticks, (n, 3) in metres.

    Parameters
    ----------
    sensors : DataFrame
        Columns ``direction, x, y, z`` (m); the stick of a rotational sensor has no length.
    points : ndarray (n, 3)
        Points of the structure, whose box gives the length of a stick.
    """
    length = _STICK * float(np.linalg.norm(np.ptp(points, axis=0)))
    return sensors[scene.PLACE].to_numpy(dtype=float) + length * scene.axis_vectors(sensors["direction"])


def face_groups(mesh: MeshTables) -> list[str]:
    """Groups that have faces, in the order of the table."""
    elements = mesh.elements
    return list(dict.fromkeys(elements.loc[elements["c"].notna(), "group"].astype(str)))


def coloured_groups(mesh: MeshTables) -> list[str]:
    """Groups that colours tell apart: those of faces, else of lines where there are few, such as the sets of a deck."""
    names = list(dict.fromkeys(mesh.elements["group"].astype(str)))
    of_lines = [name for name in names if name != OTHER_LINES] if 1 < len(names) <= len(COLOURS) else []
    return face_groups(mesh) or of_lines


def model_figure(mesh: MeshTables, sensors: pd.DataFrame | None = None, forces: pd.DataFrame | None = None) -> Figure:
    """Draw the model with a legend; for the arguments see `draw_model`."""
    rest = seen_places(mesh)
    names = coloured_groups(mesh)
    handles: list[Artist] = [
        Patch(facecolor=COLOURS[k % len(COLOURS)], edgecolor=_BORDER, linewidth=0.5, label=name)
        for k, name in enumerate(names)
    ]
    lines = mesh.elements[mesh.elements["c"].isna()]
    if not set(lines["group"].astype(str)) <= set(names):
        handles.append(Line2D([], [], color=BLACK, linewidth=1.3, label="beams and other lines"))
    if sensors is not None:
        words = f"sensors used ({len(sensors)}) and their directions"
        handles.append(Line2D([], [], color=MEASURED, marker="o", markersize=4.5, linewidth=1.2, label=words))
    if forces is not None:
        handles.append(Line2D([], [], label=f"excited ({len(forces)})", **_FORCE))
    wide, high = scene.seen_size(rest, 0.06 * float(np.linalg.norm(np.ptp(rest, axis=0))))
    foot, abreast = max(scene.FOOT, 0.4 + 0.2 * math.ceil(len(handles) / _ABREAST)), _ABREAST
    if in_column():
        foot, abreast = scene.FOOT + 0.2 * len(handles), 1
    figure = scene.new_scene(min(figure_width() * high / wide, 6.0) + scene.over_strip(2 * scene.HEADING) + foot, foot)
    draw_model(mesh, sensors, figure.add_subplot(projection="3d"), forces)
    scene.legend_in_foot(figure, handles, abreast, 0.34)
    scene.show_axes(figure)
    scene.write_size(figure, rest)
    return figure


def _light(vertices: np.ndarray) -> np.ndarray:
    """Brightness of each face (n, 4, 3), (n,): largest from above, whichever side is visible."""
    normal = np.cross(vertices[:, 2] - vertices[:, 0], vertices[:, 3] - vertices[:, 1])
    length = np.linalg.norm(normal, axis=1)
    upward = np.divide(np.abs(normal @ np.array([0.1, 0.8, 0.59])), length, out=np.ones(len(length)), where=length > 0)
    return 1.0 - _SHADE * (1.0 - upward)
