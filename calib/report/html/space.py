"""Data of the viewer: the model in space, mode shapes that move, and dots with names: sensors, misfit, scores."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.colors import to_hex

from calib.report.html.study_results import STAGES, StudyResults
from calib.report.mesh import FACE, MeshTables, motions, pieces, point_coordinates, read_mesh, thickness
from calib.report.model import sensor_tips
from calib.report.numbers import counted, fixed, flag
from calib.report.scene import PLACE, motion_scale, plot_coordinates, upright, view_directions
from calib.report.shapes import measured_motions
from calib.report.style import BLACK, BLUE, MEASURED, REST, SKY, VERMILLION
from calib.report.where import misfit_tips, sensor_rms

_FINEST = 32767
"""Steps on each side of 0 in which `packed_numbers` numbers are counted."""
_SMALL, _LARGE = 6.0, 18.0
"""Diameters of the smallest and of the largest dots, in pixels."""


def scene(results: StudyResults) -> dict[str, Any] | None:
    """Return the data of the viewer; None where there is nothing to show on the model.

    Returns
    -------
    dict
        ``view``: `framed` so that it holds everything. ``colours``. ``points`` of the mesh at rest (n, 3), its
        ``lines`` (pairs of points, one after another), ``faces`` (four points each) and ``lone`` points without a line.
        ``sites``: places of the sensors of the mode shapes and their ``words``. ``stages``: of each its ``name`` and
        ``modes``: ``name, words``, ``motion`` of the points (none where the mode is not paired), ``measured`` motion at
        the sites with the numbers ``at``, and the ``scale`` that converts motion to drawn metres. ``layers``: dots, see
        `_layer`. Coordinates are those of the model in metres, as `packed_numbers` numbers.
    """
    mesh = read_mesh(results.folder)
    structure = _Structure(mesh)
    stages, sites, moved = _stages(results, mesh, structure)
    found = (_sensors(results, structure), _misfit(results, structure), _effects(results), *_perturbations(results))
    made = [layer for layer in found if layer is not None]
    layers, dots = [data for data, _ in made], [moved, *(points for _, points in made)]
    if not stages and not layers:
        return None
    with upright(str(results.record.get("axes", ""))):
        view = framed(np.concatenate([structure.points, *dots]))
    return {
        "view": view,
        "colours": {"rest": REST, "model": BLUE, "measured": MEASURED, "axes": BLACK},
        "points": packed_numbers(structure.points),
        "lines": structure.lines.ravel().tolist(),
        "faces": structure.faces.ravel().tolist(),
        "lone": structure.lone.tolist(),
        "sites": sites,
        "stages": stages,
        "layers": layers,
    }


def packed_numbers(values: np.ndarray) -> dict[str, Any]:
    """Return numbers as whole multiples of a ``step``, 16 bits each, little-endian in base64.

    A step is 1/32767 of the largest number, far less than a pixel shows, at a third of the size of decimal digits.
    """
    step = float(np.abs(values).max(initial=0.0)) / _FINEST or 1.0
    counts = np.round(values / step).astype("<i2")
    return {"step": step, "numbers": b64encode(counts.tobytes()).decode("ascii")}


def framed(points: np.ndarray) -> dict[str, Any]:
    """Return the parallel view of points (n, 3) in metres that the figures have.

    Returns
    -------
    dict
        ``centre``, the point in the middle of the view; ``eye``, the direction towards the viewer; ``up``, the
        vertical; ``size``, width and
        height in metres, wide enough to turn about the vertical; ``radius`` of a ball about the centre that holds all.
    """
    right, up = view_directions() @ plot_coordinates(np.eye(3)).T
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    seen = points @ np.array([right, up]).T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    centre = centre + (middle - np.array([right, up]) @ centre) @ np.array([right, up])
    radius = float(np.linalg.norm(points - centre, axis=1).max()) or 1.0
    vertical = plot_coordinates(np.eye(3))[:, 2]
    around = 2 * float(np.linalg.norm((points - centre)[:, vertical == 0], axis=1).max())
    size = np.maximum([max(around, np.ptp(seen[:, 0])), np.ptp(seen[:, 1])], 1e-3 * radius)
    return {
        "centre": centre.tolist(),
        "eye": np.cross(right, up).tolist(),
        "up": vertical.tolist(),
        "size": size.tolist(),
        "radius": radius,
    }


class _Structure:
    """The mesh without points that no piece has; everything is empty without a mesh.

    Attributes
    ----------
    seen : ndarray (n,), int
        Rows of the table of points that are shown.
    points : ndarray (n, 3)
        Metres.
    lines, faces, lone : ndarray (n, 2), (n, 4), (n,), int
        Rows of ``points``.
    """

    def __init__(self, mesh: MeshTables | None) -> None:
        if mesh is None:
            self.seen = self.lone = np.zeros(0, dtype=int)
            self.points = np.zeros((0, 3))
            self.lines, self.faces = np.zeros((0, 2), dtype=int), np.zeros((0, 4), dtype=int)
            return
        parts = pieces(mesh)
        self.seen = np.unique(parts.corners)
        row = np.zeros(len(mesh.points), dtype=int)
        row[self.seen] = np.arange(len(self.seen))
        self.points = point_coordinates(mesh)[self.seen]
        self.faces = row[parts.corners[parts.kind == FACE]]
        strokes = row[parts.strokes]
        alone = strokes[:, 0] == strokes[:, 1]
        self.lines, self.lone = strokes[~alone], strokes[alone, 0]


def _stages(
    results: StudyResults, mesh: MeshTables | None, structure: _Structure
) -> tuple[list[dict[str, Any]], dict[str, Any], np.ndarray]:
    """Stages, the sites of their sensors, and all points reached by a motion in metres (n, 3)."""
    known, found, reached = _Sites(), [], [np.zeros((0, 3))]
    for stage in STAGES:
        shapes = results.table(f"shapes_{stage}")
        moves = results.table(f"deflection_{stage}")
        if mesh is None or shapes is None or moves is None:
            continue
        compared = results.compared(stage)
        facts = {} if compared is None else {str(r["mode"]): r for r in compared.to_dict("records")}
        modes = []
        for mode in dict.fromkeys(shapes["mode"]):
            own, measured_here = moves[moves["mode"] == mode], shapes[shapes["mode"] == mode]
            motion = motions(mesh, own)[structure.seen]
            at, measured = measured_motions(measured_here)
            rest, motion_of_all = np.concatenate([structure.points, at]), np.concatenate([motion, measured])
            scale = motion_scale(rest, motion_of_all, thickness(mesh))
            reached += [rest + side * scale * motion_of_all for side in (-1, 1)]
            modes.append(
                {
                    "name": mode,
                    "words": _words(mode, facts),
                    "scale": scale,
                    "motion": packed_numbers(motion) if len(own) else None,
                    "at": known.numbers(at, measured_here),
                    "measured": packed_numbers(measured),
                }
            )
        found.append({"name": f"{stage} calibration", "modes": modes})
    return found, known.data(), np.concatenate(reached)


class MeshMotion:
    """Motions of a mesh as the viewer draws them; see ``motion`` of `scene`.

    Parameters
    ----------
    mesh : MeshTables
    """

    def __init__(self, mesh: MeshTables):
        self._mesh, self._seen = mesh, _Structure(mesh).seen

    def packed(self, moves: pd.DataFrame) -> dict[str, Any] | None:
        """`packed_numbers` of one motion, from columns ``point, u, v, w``; None for an empty table."""
        return packed_numbers(motions(self._mesh, moves)[self._seen]) if len(moves) else None


def model_motions(results: StudyResults) -> dict[str, dict[str, dict[str, Any] | None]]:
    """Motion of the points of `scene` in the modes of the model, by stage and number of the mode.

    A mode that is paired moves in scale and phase of the measured shape.
    """
    mesh, found = read_mesh(results.folder), dict[str, dict[str, dict[str, Any] | None]]()
    drawn = None if mesh is None else MeshMotion(mesh)
    for stage in STAGES:
        moves, compared = results.table(f"deflection_{stage}"), results.compared(stage)
        if drawn is None or moves is None:
            continue
        paired = {} if compared is None else dict(zip(compared["mode"], compared["model_mode"], strict=True))
        for mode, own in moves.groupby("mode", sort=False):
            number = paired.get(str(mode), float(str(mode)) if str(mode).isdigit() else np.nan)
            if not np.isnan(number):
                found.setdefault(f"{stage} calibration", {})[f"{number:.0f}"] = drawn.packed(own)
    return found


class _Sites:
    """Places with sensors, each once, in the order in which they are met."""

    def __init__(self) -> None:
        self._names: dict[tuple[float, ...], dict[str, None]] = {}

    def numbers(self, points: np.ndarray, shapes: pd.DataFrame) -> list[int]:
        """Numbers of places (n, 3), whose sensors are named in a table of shapes."""
        for name, *place in shapes[["sensor", *PLACE]].dropna().itertuples(index=False):
            self._names.setdefault(tuple(map(float, place)), {})[str(name)] = None
        row = {place: k for k, place in enumerate(self._names)}
        return [row[tuple(place)] for place in points.tolist()]

    def data(self) -> dict[str, Any]:
        """The places, and names of the sensors there."""
        return {
            "points": packed_numbers(np.array(list(self._names)).reshape(-1, 3)),
            "words": [", ".join(names) for names in self._names.values()],
        }


def _words(mode: str, facts: dict[str, Any]) -> str:
    if mode not in facts:
        return mode
    row = facts[mode]
    measured = f"{mode}: measured {fixed(row['natural_freq_measured'], 2)} Hz"
    if np.isnan(row["natural_freq_model"]):
        return f"{measured}, not paired with a model mode"
    return f"{measured}, model {fixed(row['natural_freq_model'], 2)} Hz, MAC {fixed(row['mac'], 3)}"


def _layer(
    name: str,
    title: str,
    words: str,
    dots: np.ndarray,
    feet: np.ndarray | None,
    sizes: np.ndarray,
    colours: Sequence[str],
    names: Sequence[str],
    key: Sequence[tuple[str, str]],
) -> tuple[dict[str, Any], np.ndarray]:
    """Return a layer of dots, largest first, and its points in metres (n, 3).

    Parameters
    ----------
    name, title : str
        In the data, and in the choice of layers.
    words : str
        What the layer shows.
    dots, feet : ndarray (n, 3)
        Dots in metres, and where the sticks that carry them begin, if they have any.
    sizes : ndarray (n,)
        From 0 (smallest dot) to 1 (largest).
    colours, names : sequence of str
        Of each dot; the name appears under the mouse.
    key : sequence of (str, str)
        Colours and what they mean.
    """
    order = np.argsort(-sizes, kind="stable")
    data = {
        "name": name,
        "title": title,
        "words": words,
        "points": packed_numbers(dots[order]),
        "feet": None if feet is None else packed_numbers(feet[order]),
        "sizes": np.round(_SMALL + (_LARGE - _SMALL) * sizes[order], 1).tolist(),
        "colours": [colours[k] for k in order],
        "names": [names[k] for k in order],
        "key": [{"colour": colour, "words": meaning} for colour, meaning in key],
    }
    return data, dots if feet is None else np.concatenate([dots, feet])


def _sensors(results: StudyResults, structure: _Structure) -> tuple[dict[str, Any], np.ndarray] | None:
    table = results.sensors
    placed = None if table is None else table.dropna(subset=PLACE)
    if placed is None or placed.empty:
        return None
    feet = placed[PLACE].to_numpy(dtype=float)
    held = [flag(value) for value in placed["held_out"]]
    looks = {False: (BLUE, "fitted"), True: (MEASURED, "validation")}
    names = [
        f"{r['sensor']}, direction {r['direction']}{', validation' if h else ''}"
        for r, h in zip(placed.to_dict("records"), held, strict=True)
    ]
    words = f"{counted(len(placed), 'sensor')}, {sum(held)} of them for validation"
    tips = sensor_tips(placed, np.concatenate([structure.points, feet]))
    colours = [looks[h][0] for h in held]
    sizes = np.full(len(placed), 0.2)
    return _layer("sensors", "Sensors", words, tips, feet, sizes, colours, names, [looks[h] for h in sorted(set(held))])


def _misfit(results: StudyResults, structure: _Structure) -> tuple[dict[str, Any], np.ndarray] | None:
    table = results.table("sensor_misfit")
    found = None if table is None else sensor_rms(table[table["stage"] == "base"]).dropna()
    if found is None or found.empty:
        return None
    feet, rms = found[PLACE].to_numpy(dtype=float), found["rms"].to_numpy(dtype=float)
    largest = float(np.max(rms, initial=3.0))
    scale = colormaps["YlOrRd"]
    key = [(to_hex(scale(v / largest)), f"{fixed(v, 1)} σ") for v in np.linspace(0.0, largest, 4)]
    names = [f"{r['sensor']}: {fixed(r['rms'], 2)} σ" for r in found.to_dict("records")]
    words = f"rms over all modes, calibrated base model; the worst is {names[0]}; noise alone gives about 1 σ"
    tips = misfit_tips(found, np.concatenate([structure.points, feet]))
    colours = [to_hex(scale(v / largest)) for v in rms]
    return _layer("misfit", "Misfit at the sensors", words, tips, feet, rms / largest, colours, names, key)


def _effects(results: StudyResults) -> tuple[dict[str, Any], np.ndarray] | None:
    """Where each effect of the library acts, those of the credible set marked."""
    acts, ranked = results.table("effect_places"), results.table("effects")
    if acts is None or ranked is None:
        return None
    facts = {str(r["name"]): r for r in ranked.to_dict("records")}
    acts = acts[acts["effect"].astype(str).isin(list(facts))]
    if acts.empty:
        return None
    credible = [flag(facts[str(name)]["credible"]) for name in acts["effect"]]
    looks = {True: (VERMILLION, "candidates left"), False: (SKY, "other effects of the list")}
    names = [f"{name}: {facts[str(name)]['title']}" for name in acts["effect"]]
    words = f"{counted(acts['effect'].nunique(), 'effect')}: places by the list of possible causes, not by the data"
    sizes = np.where(credible, 1.0, 0.3)
    dots, key = acts[PLACE].to_numpy(dtype=float), [looks[k] for k in sorted(set(credible), reverse=True)]
    colours = [looks[k][0] for k in credible]
    return _layer("effects", "Where effects act", words, dots, None, sizes, colours, names, key)


def parameter_layers(results: StudyResults) -> list[dict[str, Any]]:
    """A layer of dots for each parameter that scales or moves something of the model: what, and where it is."""
    places = results.table("model_places")
    if places is None:
        return []
    scaled = places.assign(parameter=places["parameters"].str.split(";")).explode("parameter")
    scaled = scaled.assign(parameter=scaled["parameter"].str.strip()).dropna(subset=[*PLACE, "parameter"])
    found = []
    for parameter, own in scaled[scaled["parameter"] != ""].groupby("parameter", sort=False):
        names = [f"{r['name']}, {r['form']}" for r in own.to_dict("records")]
        dots, sizes = own[PLACE].to_numpy(dtype=float), np.full(len(own), 0.5)
        words = f"{parameter} acts at {counted(len(own), 'place')}"
        looks = [(VERMILLION, str(parameter))]
        layer, _ = _layer(
            str(parameter), str(parameter), words, dots, None, sizes, [VERMILLION] * len(own), names, looks
        )
        found.append(layer)
    return found


def _perturbations(results: StudyResults) -> list[tuple[dict[str, Any], np.ndarray]]:
    """A layer for each kind: perturbations of stiffness and of mass are often at one place."""
    table = results.table("perturbations")
    if table is None or table.empty:
        return []
    limit, largest = float(table["limit"].iloc[0]), float(table["score"].abs().max()) or 1.0
    key = [(VERMILLION, f"|z| > {fixed(limit, 2)}"), (SKY, "smaller")]
    layers = []
    for kind, placed in table.dropna(subset=[*PLACE, "score"]).groupby("kind", sort=False):
        size = placed["score"].abs().to_numpy(dtype=float)
        beyond = size > limit
        names = [f"{r['perturbation']}: z {fixed(r['score'], 1, sign=True)}" for r in placed.to_dict("records")]
        words = (
            f"{beyond.sum()} of {len(placed)} scores exceed {fixed(limit, 2)}, the limit for noise alone in all kinds; "
            "places to inspect, not causes"
        )
        colours = [VERMILLION if b else SKY for b in beyond]
        dots, title = placed[PLACE].to_numpy(dtype=float), f"Local stiffness or mass changes of {kind}"
        layers.append(_layer(f"perturbations of {kind}", title, words, dots, None, size / largest, colours, names, key))
    return layers
