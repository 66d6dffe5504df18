"""Mode shapes: what the sensors measured over what the model computes."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any, cast

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.axes3d import Axes3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from calib.report.style import BLUE, DPI, MEASURED, REST, WIDTH

_AXES = ["x", "y", "z"]
_ELEVATION, _AZIMUTH = 24.0, -58.0
_FOOT = 0.75
"""Height in inches of the strip that explains the panels."""
_FILLED, _HEADING = 0.94, 0.2
_LARGEST_MOTION = 0.1
"""Drawn size of the largest motion, as a fraction of the diagonal of the model's box."""


def plot_coordinates(points: np.ndarray) -> np.ndarray:
    """Turn (x longitudinal, y up, z transverse) into the plot's (x, -z, y), which keeps right-handed axes right-handed.

    Parameters
    ----------
    points : ndarray (..., 3)
    """
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def draw_mode_shape(
    shapes: pd.DataFrame,
    deflection: pd.DataFrame,
    ax: Axes3D | None = None,
    *,
    mesh: pd.DataFrame | None = None,
    title: str = "",
) -> Axes3D:
    """Draw one mode in three dimensions: mesh at rest, deformed mesh, and the measured motion of every sensor.

    Parameters
    ----------
    shapes : DataFrame
        Sensors of this mode: ``direction, x, y, z`` (m), ``measured_re`` (shape amplitude). Rotations and sensors
        without a place or a value are not drawn.
    deflection : DataFrame
        Lines of this mode: ends ``x1..z1, x2..z2`` (m) and motions ``u1..w1, u2..w2`` (shape amplitude, scaled to the
        measured shape); empty when no model mode is paired.
    ax : Axes3D, optional
    mesh : DataFrame, optional
        Lines at rest for a mode that has no deflection.
    title : str
        Written over the panel.

    Returns
    -------
    Axes3D
        Lines with the gids ``undeformed``, ``deformed``, ``measured`` (one point a place, moved in all the directions
        measured there) and ``motion`` (threads from the rest place). The largest motion is drawn as a tenth of the
        model's diagonal; the same scale holds for model and measurement.
    """
    if ax is None:
        figure = Figure(figsize=(5.0, 4.2), dpi=DPI)
        ax = cast(Axes3D, figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d"))
    lines = deflection if len(deflection) or mesh is None else mesh
    rest = ends(lines).reshape(-1, 2, 3)
    motion = deflection[["u1", "v1", "w1", "u2", "v2", "w2"]].to_numpy(dtype=float).reshape(-1, 2, 3)
    place, measured = measured_motions(shapes)
    scale = motion_scale(
        np.concatenate([rest.reshape(-1, 3), place]), np.concatenate([motion.reshape(-1, 3), measured])
    )

    plot_lines(ax, rest, color=REST, linewidth=0.8, gid="undeformed", zorder=1)
    if len(deflection):
        plot_lines(ax, rest + scale * motion, color=BLUE, linewidth=1.2, gid="deformed", zorder=2)
    moved = place + scale * measured
    plot_lines(ax, np.stack([place, moved], axis=1), color=MEASURED, linewidth=0.8, gid="motion", zorder=3)
    ax.plot(
        *plot_coordinates(moved).T,
        linestyle="none",
        marker="o",
        markersize=3.0,
        color=MEASURED,
        gid="measured",
        zorder=4,
    )
    everything = np.concatenate(
        [rest.reshape(-1, 3), (rest + scale * motion).reshape(-1, 3) if len(motion) else place, moved]
    )
    frame_scene(ax, plot_coordinates(everything), heading=_HEADING)
    ax.text2D(0.5, 1.0, title, transform=ax.transAxes, ha="center", va="top", fontsize=8.5)
    return ax


def mode_shapes_figure(
    shapes: pd.DataFrame, deflection: pd.DataFrame, comparison: pd.DataFrame | None = None
) -> Figure:
    """Draw a grid of panels, one for every mode, from tables with a column ``mode``.

    Parameters
    ----------
    shapes, deflection : DataFrame
        As for `draw_mode_shape`, for all modes.
    comparison : DataFrame, optional
        Columns ``mode, natural_freq_measured, natural_freq_model, mac`` for the titles of the panels.
    """
    modes = list(dict.fromkeys([*shapes["mode"], *deflection["mode"]]))
    columns = 1 if len(modes) == 1 else 2 if len(modes) in (2, 4) else 3
    rows = math.ceil(len(modes) / columns)
    panel = WIDTH / columns
    everything = np.concatenate([ends(deflection), shapes[_AXES].dropna().to_numpy(dtype=float)])
    wide, high = np.ptp(plot_coordinates(everything) @ view_directions().T, axis=0)
    room = 2 * _LARGEST_MOTION * float(np.linalg.norm(np.ptp(everything, axis=0)))
    ratio = max((high + room) / (wide + room), 0.3) if wide + room > 0.0 else 1.0
    # A 3-D panel draws in a square from its top edge only as long as it is not taller than wide.
    height = rows * min(panel * ratio + 2 * _HEADING, panel) + _FOOT
    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    figure.subplots_adjust(left=0.0, right=1.0, top=1.0, bottom=_FOOT / height, wspace=0.0, hspace=0.0)
    grid = figure.add_gridspec(rows, columns)
    first = deflection[deflection["mode"] == deflection["mode"].iloc[0]] if len(deflection) else deflection
    facts = {} if comparison is None else {str(row["mode"]): row for row in comparison.to_dict("records")}
    for k, mode in enumerate(modes):
        ax = figure.add_subplot(grid[k // columns, k % columns], projection="3d")
        draw_mode_shape(
            shapes[shapes["mode"] == mode],
            deflection[deflection["mode"] == mode],
            ax,
            mesh=first,
            title=_panel_title(mode, facts),
        )
    _explain(figure, deflection if len(deflection) else None)
    return figure


def ends(lines: pd.DataFrame) -> np.ndarray:
    """Return the ends of the lines, (2 * n_lines, 3) in metres, from columns ``x1..z1, x2..z2``."""
    return lines[["x1", "y1", "z1", "x2", "y2", "z2"]].to_numpy(dtype=float).reshape(-1, 3)


def measured_motions(shapes: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the sensors, in metres, and the measured motion there as a vector, both (n_places, 3).

    Sensors at one place give one vector, so that it can be compared with the motion of the mesh; a direction that was
    not measured counts as none. Rotations and sensors without a place or a value are left out.

    Parameters
    ----------
    shapes : DataFrame
        Columns ``direction, x, y, z, measured_re``.
    """
    known = shapes["direction"].isin(_AXES) & shapes[["x", "y", "z", "measured_re"]].notna().all(axis=1)
    vectors = shapes[known].pivot_table(
        index=["x", "y", "z"], columns="direction", values="measured_re", aggfunc="mean", sort=False
    )
    places = np.array(list(vectors.index), dtype=float).reshape(-1, 3)
    return places, vectors.reindex(columns=_AXES).fillna(0.0).to_numpy(dtype=float)


def motion_scale(points: np.ndarray, motions: np.ndarray) -> float:
    """Return the factor that draws the largest motion as a tenth of the diagonal of the points' box.

    Parameters
    ----------
    points, motions : ndarray (n, 3)
        Metres, and shape amplitude.
    """
    largest = float(np.linalg.norm(motions, axis=1).max(initial=0.0))
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return _LARGEST_MOTION * (diagonal or 1.0) / largest if largest > 0.0 else 0.0


def plot_lines(ax: Axes3D, segments: np.ndarray, **looks: object) -> None:
    """Segments (n, 2, 3) as one line with gaps, which draws quickly and whose data can be read back."""
    gap = np.full((len(segments), 1, 3), np.nan)
    path = plot_coordinates(np.concatenate([segments, gap], axis=1).reshape(-1, 3))
    ax.plot(*path.T, **looks)


def view_directions() -> np.ndarray:
    """Return the plot directions that the view shows to the right and upwards, (2, 3)."""
    azimuth, elevation = math.radians(_AZIMUTH), math.radians(_ELEVATION)
    return np.array(
        [
            [-math.sin(azimuth), math.cos(azimuth), 0.0],
            [-math.sin(elevation) * math.cos(azimuth), -math.sin(elevation) * math.sin(azimuth), math.cos(elevation)],
        ]
    )


def frame_scene(ax: Axes3D, points: np.ndarray, heading: float = 0.0) -> None:
    """Parallel view with equal scale on all axes that fills the panel below a heading of that height in inches."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 0.02 * float((high - low).max() or 1.0))
    seen = view_directions()
    off_centre = (seen @ points.T).max(axis=1) / 2 + (seen @ points.T).min(axis=1) / 2 - seen @ (low + high) / 2
    middle = (low + high) / 2 + off_centre @ seen
    for set_limits, m, s in zip((ax.set_xlim, ax.set_ylim, ax.set_zlim), middle, size, strict=True):
        set_limits(m - s / 2, m + s / 2)
    ax.set_proj_type("ortho")
    ax.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    ax.set_axis_off()
    ax.set_box_aspect(size)
    # Measure the view at this zoom in the square that a 3-D panel draws in, then fill the panel itself.
    x, y, _ = proj_transform(*points.T, ax.get_proj())
    filled = np.ptp(ax.transAxes.inverted().transform(ax.transData.transform(np.column_stack([x, y]))), axis=0)
    panel = ax.get_position(original=True)
    width, height = np.array([panel.width, panel.height]) * ax.figure.get_size_inches()
    room = np.array([width, height - 2 * heading]) / min(width, height)
    ax.set_box_aspect(size, zoom=_FILLED * float((room / np.maximum(filled, 1e-9)).min()))
    for line in ax.lines:
        line.set_clip_on(False)


def _explain(figure: Figure, deflection: pd.DataFrame | None) -> None:
    """Write under the panels what the lines are, where the axes point and how large the model is."""
    height = float(figure.get_size_inches()[1])
    handles = [
        Line2D([], [], color=REST, label="at rest"),
        Line2D([], [], color=BLUE, linewidth=1.6, label="model"),
        Line2D([], [], color=MEASURED, marker="o", markersize=4, linewidth=0.8, label="measured"),
    ]
    figure.legend(handles=handles, loc="lower right", bbox_to_anchor=(0.99, 0.06 / height), ncols=3, borderaxespad=0.0)
    corner: Axes3D = figure.add_axes((0.1 / WIDTH, 0.04 / height, 0.75 / WIDTH, 0.68 / height), projection="3d")
    arrows = np.eye(3)
    plot_lines(corner, np.stack([0.0 * arrows, arrows], axis=1), color="black", linewidth=1.0)
    for name, (x, y, z) in zip("xyz", plot_coordinates(1.35 * arrows), strict=True):
        corner.text(x, y, z, name, fontsize=8.5, ha="center", va="center")
    frame_scene(corner, plot_coordinates(1.4 * np.concatenate([0.0 * arrows, arrows])))
    if deflection is not None:
        size = " × ".join(f"{s:.3g}" for s in np.ptp(ends(deflection), axis=0))
        figure.text(1.05 / WIDTH, 0.09 / height, f"model {size} m (x × y × z)", fontsize=8.5, va="bottom")


def _panel_title(mode: str, facts: dict[str, dict[Hashable, Any]]) -> str:
    if mode not in facts:
        return mode
    row = facts[mode]
    if math.isnan(row["natural_freq_model"]):
        return f"{mode}   {row['natural_freq_measured']:.2f} Hz   not paired"
    frequencies = f"{row['natural_freq_measured']:.2f}/{row['natural_freq_model']:.2f} Hz"
    # A long mode name takes a line of its own.
    gap = "\n" if len(mode) > 14 else "   "
    return f"{mode}{gap}{frequencies}" + ("" if math.isnan(row["mac"]) else f"   MAC {row['mac']:.2f}")
