"""Measured mode shapes over those of the model."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from calib.report import scene
from calib.report.mesh import (
    FACE,
    MeshTables,
    draw_pieces,
    element_corners,
    element_edges,
    motions,
    pieces,
    point_coordinates,
    seen_places,
    thickness,
)
from calib.report.style import BLUE, MEASURED, REST

_PALE, _PALE_MEASURED = "#D6E6F2", "#F7DFD0"
_AXES = ["x", "y", "z"]
_MANY = 1000
"""Elements in all panels from which they are painted as pixels in SVG and PDF, which would be large otherwise."""
_WIDTHS = np.array([0.3, 0.8, 1.2])
"""Line widths of the edges of faces, borders and lines, in points."""


def draw_mode_shape(
    shapes: pd.DataFrame, deflection: pd.DataFrame, mesh: MeshTables, ax: Axes3D | None = None, *, title: str = ""
) -> Axes3D:
    """Draw one mode in three dimensions: mesh at rest, deformed mesh, and the measured motion of every sensor.

    Parameters
    ----------
    shapes : DataFrame
        Sensors of this mode: ``direction, x, y, z`` (m), ``measured_re`` (shape amplitude). Rotations and sensors
        without coordinates or a value are not drawn.
    deflection : DataFrame
        Motions of this mode: ``point, u, v, w`` (shape amplitude, scaled to the measured shape); empty when the mode
        is not paired.
    mesh : MeshTables
    ax : Axes3D, optional
    title : str
        Written above the panel.

    Returns
    -------
    Axes3D
        Lines with the gids ``undeformed`` (lines and the borders of faces), ``measured`` (one point per place, moved
        in all directions measured there) and ``motion`` (lines from the position at rest), pieces with the gid
        ``deformed``. Model and measurement have the same scale, that of `motion_scale`.
    """
    ax = scene.new_axes(ax)
    place, measured = measured_motions(shapes)
    motion = motions(mesh, deflection) if len(deflection) else None
    _draw_mesh(ax, mesh, motion, place, measured, BLUE, _PALE, "deformed", title)
    return ax


def draw_measured_shape(
    shapes: pd.DataFrame,
    mesh: MeshTables,
    ax: Axes3D | None = None,
    *,
    expanded: pd.DataFrame | None = None,
    title: str = "",
) -> Axes3D:
    """Draw one measured mode alone: the test's wireframe at rest and moved, or its expansion to the whole mesh.

    Parameters
    ----------
    shapes : DataFrame
        Sensors of this mode, as for `draw_mode_shape`.
    mesh : MeshTables
        Tells which sensors are neighbours, and the size of the drawing.
    ax : Axes3D, optional
    expanded : DataFrame, optional
        Motions of the mesh in this mode as measured: ``point, u, v, w``. Where there are any, the mesh takes the place
        of the wireframe; its distance from the dots is what the expansion leaves unexplained.
    title : str
        Written above the panel.

    Returns
    -------
    Axes3D
        Lines with the gids ``undeformed`` and ``wireframe``, or pieces with the gid ``expanded``; dots with the gid
        ``measured``.
    """
    ax = scene.new_axes(ax)
    place, measured = measured_motions(shapes)
    if expanded is not None and len(expanded):
        motion = motions(mesh, expanded)
        _draw_mesh(ax, mesh, motion, place, measured, MEASURED, _PALE_MEASURED, "expanded", title)
        return ax
    rest = seen_places(mesh)
    lines = wireframe(mesh, place)
    at = np.concatenate([rest, place])
    moved = place + scene.motion_scale(at, measured, thickness(mesh)) * measured
    scene.plot_lines(ax, place[lines], color=REST, linewidth=0.8, gid="undeformed", zorder=1)
    scene.plot_lines(ax, moved[lines], color=MEASURED, linewidth=1.0, gid="wireframe", zorder=3)
    dots = scene.plot_coordinates(moved).T
    ax.plot(*dots, linestyle="none", marker="o", markersize=2.5, color=MEASURED, gid="measured", zorder=4)
    scene.frame_panel(ax, np.concatenate([at, moved]), title)
    return ax


def mode_shapes_figure(
    shapes: pd.DataFrame,
    deflection: pd.DataFrame,
    mesh: MeshTables,
    comparison: pd.DataFrame | None = None,
    expanded: pd.DataFrame | None = None,
) -> Figure:
    """Draw every measured mode: the test beside the model, from tables with a column ``mode``.

    Parameters
    ----------
    shapes, deflection : DataFrame
        As for `draw_mode_shape`, for all modes.
    mesh : MeshTables
    comparison : DataFrame, optional
        Columns ``mode, natural_freq_measured, natural_freq_model, mac`` for the titles of the panels.
    expanded : DataFrame, optional
        As for `draw_measured_shape`, for all modes; a mode without is drawn as the wireframe of its sensors.
    """
    modes = list(dict.fromkeys(shapes["mode"]))
    rest = seen_places(mesh)
    everything = np.concatenate([rest, shapes[scene.PLACE].dropna().to_numpy(dtype=float)])
    foot = scene.FOOT + scene.over_strip(0.3)
    figure, cells = scene.panel_grid(2 * len(modes), everything, thickness(mesh), pairs=True, foot=foot)
    facts = {} if comparison is None else {str(row["mode"]): row for row in comparison.to_dict("records")}
    for mode, left, right in zip(modes, cells[::2], cells[1::2], strict=True):
        found, (test, model) = shapes[shapes["mode"] == mode], _panel_titles(mode, facts)
        whole = None if expanded is None else expanded[expanded["mode"] == mode]
        beside = draw_measured_shape(found, mesh, figure.add_subplot(left, projection="3d"), expanded=whole, title=test)
        motion = deflection[deflection["mode"] == mode]
        ax = draw_mode_shape(found, motion, mesh, figure.add_subplot(right, projection="3d"), title=model)
        for collection in (*beside.collections, *ax.collections):
            collection.set_rasterized(len(modes) * len(mesh.elements) > _MANY)
    scene.show_axes(figure)
    scene.write_size(figure, rest)
    handles = [
        Line2D([], [], color=REST, label="at rest"),
        Line2D([], [], color=BLUE, linewidth=1.6, label="model"),
        Line2D([], [], color=MEASURED, marker="o", markersize=4, linewidth=0.8, label="measured"),
    ]
    if expanded is not None and len(expanded):
        handles[-1].set_linestyle("none")
        handles.append(Line2D([], [], color=MEASURED, linewidth=1.6, label="expanded"))
    scene.legend_in_foot(figure, handles, len(handles), columnspacing=1.2, handlelength=1.6)
    return figure


def _draw_mesh(
    ax: Axes3D,
    mesh: MeshTables,
    motion: np.ndarray | None,
    place: np.ndarray,
    measured: np.ndarray,
    colour: str,
    pale: str,
    gid: str,
    title: str,
) -> None:
    """Draw the mesh at rest and moved, with the measured motion (n_places, 3) of the sensors in the same scale."""
    rest, parts = point_coordinates(mesh), pieces(mesh)
    seen = np.unique(parts.corners)
    moves = np.zeros_like(rest) if motion is None else motion
    at = np.concatenate([rest[seen], place])
    scale = scene.motion_scale(at, np.concatenate([moves[seen], measured]), thickness(mesh))
    scene.plot_lines(ax, rest[parts.strokes], color=REST, linewidth=0.8, gid="undeformed", zorder=1)
    if motion is not None:
        is_face = (parts.kind == FACE)[:, None]
        faces = np.where(is_face, to_rgba(pale), 0.0)
        edges = np.where(is_face, to_rgba(pale), to_rgba(colour))
        draw_pieces(ax, (rest + scale * moves)[parts.corners], parts.kind, faces, edges, _WIDTHS[parts.kind], gid)
    moved = place + scale * measured
    scene.plot_lines(ax, np.stack([place, moved], axis=1), color=MEASURED, linewidth=0.8, gid="motion", zorder=3)
    ends = scene.plot_coordinates(moved).T
    ax.plot(*ends, linestyle="none", marker="o", markersize=3.0, color=MEASURED, gid="measured", zorder=4)
    scene.frame_panel(ax, np.concatenate([rest[seen], (rest + scale * moves)[seen], place, moved]), title)


def measured_motions(shapes: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the sensors, in metres, and the measured motion there as a vector, both (n_places, 3).

    Sensors at one place give one vector, so that it can be compared with the motion of the mesh; a direction that was
    not measured counts as zero. Rotations and sensors without coordinates or a value are omitted.

    Parameters
    ----------
    shapes : DataFrame
        Columns ``direction, x, y, z, measured_re``.
    """
    values = shapes[[*scene.PLACE, "measured_re"]].to_numpy(dtype=float)
    known = shapes["direction"].isin(_AXES).to_numpy() & ~np.isnan(values).any(axis=1)
    axis = np.array([_AXES.index(direction) for direction in shapes["direction"][known]], dtype=int)
    rows: dict[tuple[float, ...], int] = {}
    row = np.array([rows.setdefault(tuple(place), len(rows)) for place in values[known, :3].tolist()], dtype=int)
    total, count = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    np.add.at(total, (row, axis), values[known, 3])
    np.add.at(count, (row, axis), 1.0)
    return np.array(list(rows), dtype=float).reshape(-1, 3), total / np.maximum(count, 1.0)


def _panel_titles(mode: str, facts: dict[str, dict[Hashable, Any]]) -> tuple[str, str]:
    """Words above the test and above the model."""
    if mode not in facts:
        return mode, ""
    row = facts[mode]
    # A long mode name takes a line of its own.
    gap = "\n" if len(mode) > 14 else "   "
    test = f"{mode}{gap}{row['natural_freq_measured']:.2f} Hz"
    if math.isnan(row["natural_freq_model"]):
        return test, "not paired"
    return test, f"{row['natural_freq_model']:.2f} Hz" + ("" if math.isnan(row["mac"]) else f"   MAC {row['mac']:.2f}")


def wireframe(mesh: MeshTables, sensors: np.ndarray) -> np.ndarray:
    """Return pairs of sensors that are neighbours along the mesh.

    They are the Gabriel neighbours (Gabriel and Sokal 1969) by distances d along edges: no third sensor r has
    d(p, r)^2 + d(r, q)^2 < d(p, q)^2. So lines follow rows of sensors, no diagonal cuts a corner that has a sensor, and
    a line through the inside of a hollow body gives way to those along its walls. All sensors of a body are connected.
    A sensor counts as at its nearest point. Parts that no edge joins stay apart.

    Parameters
    ----------
    mesh : MeshTables
    sensors : ndarray (n_places, 3)
        Metres.

    Returns
    -------
    ndarray (n, 2), int
        Rows of ``sensors``, the smaller first, each pair once.
    """
    rest, same = _merged(point_coordinates(mesh))
    edges = np.unique(np.sort(same[element_edges(element_corners(mesh))], axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    if not len(sensors) or not len(edges):
        return np.zeros((0, 2), dtype=int)
    length = np.maximum(np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1), 1e-12)
    both = np.concatenate([edges, edges[:, ::-1]]).T
    weights = sp.csr_array((np.tile(length, 2), tuple(both)), shape=(len(rest), len(rest)))
    used = np.unique(edges)
    at, first = np.unique(used[cKDTree(rest[used]).query(sensors)[1]], return_index=True)
    reach = _reach(weights, edges, length, at)
    distance = np.array([dijkstra(weights, indices=one, limit=reach)[at] for one in at])
    pairs = np.argwhere(np.triu(np.isfinite(distance), 1))
    neighbours = first[pairs[_gabriel(distance, pairs)]]
    return np.unique(np.sort(neighbours, axis=1), axis=0)


def _reach(weights: sp.csr_array, edges: np.ndarray, length: np.ndarray, at: np.ndarray) -> float:
    """Distance along the mesh up to which pairs are tried: within it the sensors of each body are connected.

    Every point of the mesh belongs to its nearest sensor. The paths over the edges that join the points of two sensors
    contain the minimum spanning tree of all sensors (Mehlhorn 1988); this is the longest of the shortest such paths.
    """
    far, _, nearest = dijkstra(weights, indices=at, min_only=True, return_predecessors=True)
    owners = nearest[edges]
    between = (owners[:, 0] != owners[:, 1]) & (owners >= 0).all(axis=1)
    if not between.any():
        return 0.0
    _, which = np.unique(np.sort(owners[between], axis=1), axis=0, return_inverse=True)
    paths = np.full(which.max() + 1, np.inf)
    np.minimum.at(paths, which.reshape(-1), (length + far[edges].sum(axis=1))[between])
    return float(paths.max()) * (1 + 1e-9)


def _gabriel(distance: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Mask of the pairs (n, 2) that no third sensor separates; ``distance`` (n_at, n_at) is infinite beyond reach."""
    square = distance**2
    separates = [(square[a] + square[b] < square[a, b] * (1 - 1e-9)).any() for a, b in pairs.tolist()]
    return ~np.array(separates, dtype=bool)


def _merged(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points, and the place of each: bodies meet where points of both coincide."""
    fine = 1e-6 * float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    _, first, same = np.unique(np.round(points / fine), axis=0, return_index=True, return_inverse=True)
    return points[first], same.reshape(-1)
