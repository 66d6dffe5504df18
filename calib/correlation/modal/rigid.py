"""Why measured modes have no partner: rigid-body motion, or nodes of the same number at other places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.rules import RULES
from calib.measurement.mac import mac
from calib.measurement.modal import DIRECTIONS, Sensor

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("mode", "natural_freq", "rigid_share", "sensors", "looks_rigid")


def rigid_motions(sensors: Sequence[Sensor]) -> np.ndarray:
    """The six rigid-body motions at sensors: translations and rotations about the middle, (n_sensors, 6).

    NaN for a sensor without coordinates. Rotations are scaled to move the farthest point by 1.
    """
    points = np.array([s.point or (np.nan,) * 3 for s in sensors], dtype=float).reshape(-1, 3)
    if not np.isfinite(points).any():
        return np.full((len(sensors), 6), np.nan)
    arm = points - np.nanmean(points, axis=0)
    size = float(np.nanmax(np.linalg.norm(arm, axis=1))) or 1.0
    out = np.full((len(sensors), 6), np.nan)
    for k, sensor in enumerate(sensors):
        d = DIRECTIONS.index(sensor.direction)
        axis = np.eye(3)[d % 3]
        if np.isfinite(arm[k]).all():
            # e . (t + w x r) = e . t + w . (r x e)
            turned = np.cross(arm[k] / size, axis)
            out[k] = [*axis, *turned] if d < 3 else [*np.zeros(3), *(axis / size)]
    return out


def rigid_share(shapes: np.ndarray, sensors: Sequence[Sensor]) -> tuple[np.ndarray, np.ndarray]:
    """Share of each measured shape's power that rigid-body motion explains, and whether the shape is rigid.

    Least squares on the six motions, over measured sensors with coordinates. With p distinguishable motions at n
    sensors, a shape counts as rigid when ``(1 - share) n/(n - p)`` is at most `RULES.rigid_left`: a random
    shape gives about 1.

    Parameters
    ----------
    shapes : ndarray (n_sensors, n_modes)
        Real or complex; NaN where not measured.
    sensors : sequence of Sensor

    Returns
    -------
    share : ndarray (n_modes,)
        NaN for a mode without a shape.
    looks : ndarray (n_modes,), bool
    """
    motions = rigid_motions(sensors)
    share, looks = np.full(shapes.shape[1], np.nan), np.zeros(shapes.shape[1], dtype=bool)
    for i, shape in enumerate(shapes.T):
        known = np.isfinite(shape) & np.isfinite(motions).all(axis=1)
        total = float(np.sum(np.abs(shape[known]) ** 2))
        if not total > 0:
            continue
        u, s, _ = np.linalg.svd(motions[known], full_matrices=False)
        basis = u[:, s > 1e-6 * s[0]]
        share[i] = float(np.sum(np.abs(basis.T @ shape[known]) ** 2)) / total
        n, p = basis.shape
        looks[i] = n - p >= RULES.rigid_spare and (1 - share[i]) * n / (n - p) <= RULES.rigid_left
    return share, looks


def unpaired_table(found: Comparison) -> pd.DataFrame:
    """Measured modes without a partner: `COLUMNS`; ``sensors`` is the number measured in the mode."""
    import pandas as pd

    measured = found.measured
    rows = found.pairing.unpaired_measured
    share, looks = rigid_share(measured.shapes[:, rows], measured.sensors)
    columns = {
        "mode": [measured.names[i] for i in rows],
        "natural_freq": measured.natural_freq[rows],
        "rigid_share": share,
        "sensors": np.isfinite(measured.shapes[:, rows]).sum(axis=0),
        "looks_rigid": looks,
    }
    return pd.DataFrame(columns, columns=list(COLUMNS))


def unpaired_sentence(table: pd.DataFrame, model: str) -> str:
    """Summary of `unpaired_table` in words; empty without unpaired modes."""
    if table.empty:
        return ""
    modes = ", ".join(f"{r['mode']} ({r['natural_freq']:.2f} Hz)" for r in table.to_dict("records"))
    words = f"{model} has no partner for {modes}."
    rigid = table[table["looks_rigid"]]
    if len(rigid):
        least = math.floor(100 * rigid["rigid_share"].min())
        words += (
            f" At the sensors {', '.join(rigid['mode'])} move{'s' if len(rigid) == 1 else ''} like a rigid body "
            f"(at least {least} % of the power): check how the structure is supported."
        )
    return words


def numbers_hints(found: Comparison) -> tuple[str, ...]:
    """A sentence where most measured modes have no partner and numbers of nodes decide, as places are not known."""
    measured, n = found.measured, found.measured.n_modes
    lost = n - len(found.pairing.paired)
    if 2 * lost <= n or not measured.has_shapes:
        return ()
    placed = getattr(found.model, "whole", found.model).mesh.placed
    sides = [("measured nodes", "sensors, --sensors", any(s.point is not None for s in measured.sensors)),
             ("nodes of the model", "coordinates, --coordinates", len(placed) > 0 and placed.all())]  # fmt: skip
    lacking = [(side, option) for side, option, known in sides if not known]
    if not lacking:
        return ()
    return (
        f"{lost} of {n} measured modes have no partner, and nodes are matched by number, since "
        f"{' and '.join(side for side, _ in lacking)} have no places. Give these "
        f"({' and '.join(option for _, option in lacking)}) unless a number is the same place on both sides.",
    )


class BothMeshes(NamedTuple):
    """Comparisons of both meshes with one measurement, at the point of their `MeshError`.

    Attributes
    ----------
    here, there : Comparison
        Of the fitted mesh and of the finer one, with the same pairs.
    lost : frozenset of str
        Measured modes whose partner the finer mesh lacks.
    """

    here: Comparison
    there: Comparison
    lost: frozenset[str]


def both_meshes(problem: ModalProblem) -> BothMeshes:
    """Comparisons of both meshes of the problem's `MeshError`.

    Partners on the finer mesh are the modes that are those of the fitted mesh by MAC at the sensors; without shapes
    they are paired as those of any model.
    """
    mesh = problem.mesh
    assert mesh is not None
    exact = replace(problem, model=mesh.coarse, mesh=None, base=None)
    coarse, finer = mesh.modes(problem.mode_count)
    here = exact.compare(mesh.own(mesh.coarse), coarse)
    there = replace(exact, model=mesh.finer).compare(mesh.own(mesh.finer), finer)
    return _matched(here, there) if problem.measured.has_shapes else BothMeshes(here, there, frozenset())


def _matched(here: Comparison, there: Comparison) -> BothMeshes:
    """The same with the partners of the fitted mesh.

    Modes of nearly the same frequency are turned into each other by any small change: what counts as the finer one is
    the part of the mode that such a group of modes forms.
    """
    from scipy.optimize import linear_sum_assignment

    pairs, freq, shapes = here.pairing, there.modes.natural_freq, there.sensor_shapes
    coarse = here.sensor_shapes[:, pairs.model_index[pairs.paired]]
    similar = mac(coarse, shapes)
    whole, parts = similar.copy(), np.repeat(shapes[None], len(similar), axis=0)
    for j, f in enumerate(freq):
        group = np.flatnonzero(np.abs(freq - f) <= RULES.mesh_near * f)
        if len(group) > 1:
            part = shapes[:, group] @ np.linalg.lstsq(shapes[:, group], coarse, rcond=None)[0]
            parts[:, :, j], whole[:, j] = part.T, np.diag(mac(coarse, part))
    own, which = linear_sum_assignment(-(whole + similar))  # of equal ones the mode that is less turned
    names = [here.measured.names[i] for i in pairs.paired[own]]
    lost = frozenset(n for n, i, j in zip(names, own, which, strict=True) if whole[i, j] < RULES.mesh_mac)
    index, turned = np.full(len(pairs.model_index), -1), shapes.copy()
    index[pairs.paired[own]] = which
    turned[:, which] = parts[own, :, which].T
    there = replace(there, pairing=replace(pairs, model_index=index), sensor_shapes=turned)
    return BothMeshes(here, there, lost)
