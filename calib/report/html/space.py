"""Three-dimensional figures: a structure with values at its points, and animated mode shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from calib.report.html.look import FONT, new, shown
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.mesh import FACE, Mesh, motions, pieces, places, read_mesh, thickness
from calib.report.numbers import fixed
from calib.report.scene import motion_scale, plot_coordinates, view_directions
from calib.report.shapes import measured_motions
from calib.report.style import BLUE, MEASURED, REST

AXES_NOTE = "x runs along, y up, z across."
_HEIGHT = 460
_ROOM = (3.3, 1.5)
"""Width and height of a figure's view in Plotly's own unit, which a parallel view does not scale."""
_DIGITS = 5


def new_space(lines: np.ndarray | None, points: np.ndarray) -> go.Figure:
    """Return a figure of lines at rest (n, 2, 3) with named axes; the view holds ``points`` (n, 3) too."""
    everything = points if lines is None else np.concatenate([lines.reshape(-1, 3), points])
    tips = directions(everything)
    look = scene_layout(plot_coordinates(np.concatenate([everything, tips])))
    figure = new(_HEIGHT, margin={"l": 0, "r": 0, "t": 30, "b": 0}, scene=look)
    if lines is not None:
        add_lines(figure, lines, REST, "model at rest")
    add_directions(figure, tips)
    return figure


def scene_layout(points: np.ndarray) -> dict[str, Any]:
    """Return a parallel view filled by points (n, 3) of the plot, with equal scales and no box."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-3 * float(np.linalg.norm(high - low)) or 1e-3)
    spans = np.column_stack([low + high - size, low + high + size]).tolist()
    axes = [{"visible": False, "range": [a / 2, b / 2]} for a, b in spans]
    right, up = view_directions()
    seen = [float(np.ptp(points @ side)) for side in (right, up)]
    scale = min(room / max(s, 1e-9) for room, s in zip(_ROOM, seen, strict=True))
    eye = dict(zip("xyz", (2.0 * np.cross(right, up)).tolist(), strict=True))
    return {
        **{f"{name}axis": axis for name, axis in zip("xyz", axes, strict=True)},
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (scale * size).tolist(), strict=True)),
        "camera": {"projection": {"type": "orthographic"}, "eye": eye},
        "dragmode": "orbit",
    }


def add_lines(figure: go.Figure, lines: np.ndarray, colour: str, name: str, width: float = 3) -> None:
    """Add lines (n, 2, 3) in metres as one trace with gaps."""
    gap = np.full((len(lines), 1, 3), np.nan)
    x, y, z = plot_coordinates(np.concatenate([lines, gap], axis=1).reshape(-1, 3)).T
    look = {"color": colour, "width": width}
    figure.add_scatter3d(x=x, y=y, z=z, mode="lines", line=look, name=name, hoverinfo="skip", connectgaps=False)


def directions(points: np.ndarray) -> np.ndarray:
    """Return the ends of three short arrows along the axes, beside points (n, 3): (4, 3), the common end first."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = 0.1 * float(np.linalg.norm(high - low)) or 1.0
    corner = np.array([low[0] - size, low[1], high[2] + size])
    return np.vstack([corner, corner + size * np.eye(3)])


def add_directions(figure: go.Figure, ends: np.ndarray) -> None:
    """Add the arrows of `directions` with their names."""
    corner, *tips = ends
    places = np.concatenate([[corner, tip, [np.nan] * 3] for tip in tips])
    x, y, z = plot_coordinates(places).T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="lines+text", text=["", "x", "", "", "y", "", "", "z", ""], hoverinfo="skip",
        line={"color": "black", "width": 3}, textfont={"size": 14}, showlegend=False,
    )  # fmt: skip


def add_dots(figure: go.Figure, points: np.ndarray, words: Sequence[str], name: str, marker: dict[str, Any]) -> None:
    """Add markers at points (n, 3) in metres, each with a hover text."""
    x, y, z = plot_coordinates(points).T
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers", name=name, marker=marker, hoverinfo="text", text=[shown(w) for w in words]
    )


def scene(results: StudyResults) -> dict[str, Any] | None:
    """Return the data of the mode-shape viewer; None without measured or without computed shapes.

    Returns
    -------
    dict
        ``stages``: of each its ``name``, the ``view`` that holds all motion, ``points`` of the mesh at rest (n, 3),
        its ``lines`` (pairs of points), ``triangles`` of its shells (three rows of points), and ``modes``:
        ``name, words, paired, scale``, ``motion`` of the points, ``places`` of the sensors and their ``measured``
        motion. Coordinates are those of the plot, in metres; ``scale`` converts motion to drawn metres.
    """
    mesh = read_mesh(results.folder)
    if mesh is None:
        return None
    stages = [found for stage in STAGES if (found := _stage(results, mesh, stage)) is not None]
    if not stages:
        return None
    look = {"model": BLUE, "measured": MEASURED, "rest": REST}
    return {"stages": stages, "colours": look, "height": _HEIGHT, "font": {"family": FONT, "size": 13}}


def _stage(results: StudyResults, mesh: Mesh, stage: str) -> dict[str, Any] | None:
    shapes = results.table(f"shapes_{stage}", ["mode", "direction"], ["x", "y", "z", "measured_re"])
    columns = ["point", "u", "v", "w"]
    moves = results.table(f"deflection_{stage}", ["mode"], columns, complete=columns)
    if shapes is None or moves is None:
        return None
    known = results.compared(stage)
    facts = {} if known is None else {str(r["mode"]): r for r in known.to_dict("records")}
    parts = pieces(mesh)
    seen = np.unique(parts.corners)
    row = np.zeros(len(mesh.points), dtype=int)
    row[seen] = np.arange(len(seen))
    faces = row[parts.corners[parts.kind == FACE]]
    points = places(mesh)[seen]
    out, reached = [], [plot_coordinates(points)]
    for mode in dict.fromkeys(shapes["mode"]):
        own = moves[moves["mode"] == mode]
        motion = motions(mesh, own)[seen]
        at, measured = measured_motions(shapes[shapes["mode"] == mode])
        scale = motion_scale(np.concatenate([points, at]), np.concatenate([motion, measured]), thickness(mesh))
        reached += [
            plot_coordinates(p + side * scale * m) for p, m in ((points, motion), (at, measured)) for side in (-1, 1)
        ]
        out.append(
            {
                "name": mode,
                "words": _words(mode, facts),
                "paired": len(own) > 0,
                "scale": round(scale, 9),
                "motion": _numbers(motion),
                "places": _numbers(at),
                "measured": _numbers(measured),
            }
        )
    return {
        "name": f"{stage} calibration",
        "modes": out,
        "view": scene_layout(np.concatenate(reached)),
        "points": _numbers(points),
        "lines": row[parts.strokes].tolist(),
        "triangles": np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]]).T.tolist(),
    }


def _numbers(values: np.ndarray) -> list[list[float]]:
    rounded: list[list[float]] = np.round(plot_coordinates(values), _DIGITS).tolist()
    return rounded


def _words(mode: str, facts: dict[str, Any]) -> str:
    if mode not in facts:
        return mode
    row = facts[mode]
    measured = f"{mode}: measured {fixed(row['natural_freq_measured'], 2)} Hz"
    if np.isnan(row["natural_freq_model"]):
        return f"{measured}, not paired with a model mode"
    return f"{measured}, model {fixed(row['natural_freq_model'], 2)} Hz, MAC {fixed(row['mac'], 3)}"
