"""A grillage of beams on springs given as matrices, in zones of unknown bending stiffness, and modes measured on it.

It needs the front door of calib alone, so that earlier commits can be timed with it.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sp

import calib
from calib.measurement.modal import MeasuredModes, Sensor

ZONES = (5, 2)
"""Of unknown bending stiffness, along and across."""
SPACING = (0.5, 0.37)
"""Between neighbouring nodes along and across, m: on a square plate modes come in pairs."""
BENDING, TORSION, MASS, SPRING = 2.1e6, 8e5, 40.0, 5e5
"""EI and GJ, Nm^2; of a beam, kg/m; under each node of the edge, N/m."""
LOSS = 2e-4
"""Damping of a damped zone over its stiffness, s."""
FREQ_NOISE, SHAPE_NOISE = 0.002, 0.02


def grillage(side: int, zones: tuple[int, int] = ZONES, damped: bool = False) -> calib.StructuralModel:
    """A model of ``3 side**2`` degrees of freedom, from matrices: deflection and both slopes at each node.

    ``damped`` gives its last zone damping in proportion to its stiffness.
    """
    stiffness: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(math.prod(zones))]
    mass = []
    for across in (False, True):
        for line in range(side):
            for k in range(side - 1):
                ends = [(line, k), (line, k + 1)] if across else [(k, line), (k + 1, line)]
                dofs = np.concatenate([3 * (row * side + column) + np.arange(3) for row, column in ends])
                order = [0, 2, 3, 5, 1, 4] if across else [0, 1, 3, 4, 2, 5]  # bending, then torsion
                stiff, heavy = np.zeros((6, 6)), np.zeros((6, 6))
                n = SPACING[across]
                stiff[:4, :4] = BENDING / n**3 * np.array([
                    [12, 6 * n, -12, 6 * n], [6 * n, 4 * n**2, -6 * n, 2 * n**2],
                    [-12, -6 * n, 12, -6 * n], [6 * n, 2 * n**2, -6 * n, 4 * n**2],
                ])  # fmt: skip
                stiff[4:, 4:] = TORSION / n * np.array([[1, -1], [-1, 1]])
                heavy[:4, :4] = MASS * n / 420 * np.array([
                    [156, 22 * n, 54, -13 * n], [22 * n, 4 * n**2, 13 * n, -3 * n**2],
                    [54, 13 * n, 156, -22 * n], [-13 * n, -3 * n**2, -22 * n, 4 * n**2],
                ])  # fmt: skip
                heavy[4:, 4:] = MASS * n * 0.02 * np.eye(2)
                zone = ends[0][0] * zones[0] // side + zones[0] * (ends[0][1] * zones[1] // side)
                stiffness[zone].append((dofs[order], stiff))
                mass.append((dofs[order], heavy))
    size = 3 * side**2
    edge = [r * side + c for r in range(side) for c in range(side) if {r, c} & {0, side - 1}]
    springs = [(np.array([3 * node]), np.array([[SPRING * (1 + node % 7 / 20)]])) for node in edge]
    names = [f"zone_{k + 1}" for k in range(len(stiffness))]
    lossy = {"damping": {"loss": LOSS * _sum(stiffness[-1], size)}} if damped else {}
    loss = [calib.Parameter("loss", 1.0, 0.0, 3.0, "-", prior_sd=0.5)] if damped else []
    return calib.StructuralModel.from_matrices(
        stiffness={name: _sum(some, size) for name, some in zip(names, stiffness, strict=True)}
        | {"springs": _sum(springs, size)},
        mass=_sum(mass, size),
        dofs=[(node + 1, direction) for node in range(side**2) for direction in ("z", "rx", "ry")],
        parameters=[calib.Parameter(name, 1.0, 0.5, 2.0, "-", prior_sd=0.2) for name in names] + loss,
        name="grillage", **lossy,
    )  # fmt: skip


def _sum(parts: list[tuple[np.ndarray, np.ndarray]], size: int) -> sp.csr_array:
    return assembled(np.array([dofs for dofs, _ in parts]), np.array([matrix for _, matrix in parts]), size)


def assembled(rows: np.ndarray, blocks: np.ndarray, size: int) -> sp.csr_array:
    """Matrix (size, size) of element matrices (n, k, k) at their rows (n, k)."""
    k = rows.shape[1]
    where = (np.repeat(rows, k, axis=1).ravel(), np.tile(rows, (1, k)).ravel())
    return sp.coo_array((blocks.ravel(), where), shape=(size, size)).tocsr()


def measured(model: calib.StructuralModel, n_sensors: int, n_modes: int) -> MeasuredModes:
    """Modes of the same grillage with other stiffnesses, and noise."""
    rng = np.random.default_rng(n_sensors)
    drawn = rng.uniform(0.8, 1.25, len(model.space.names)).tolist()
    values = dict(zip(model.space.names, drawn, strict=True))
    modes = model.modes(values, n_modes)
    nodes = np.sort(rng.choice(len(model.labels), n_sensors, replace=False))
    sensors = tuple(Sensor(model.labels[k], "z") for k in nodes)
    shapes = (model.sensor_rows(sensors) @ modes.shapes).astype(complex)
    shapes = shapes / np.abs(shapes).max(axis=0)
    shapes += SHAPE_NOISE * (rng.normal(size=shapes.shape) + 1j * rng.normal(size=shapes.shape)) / np.sqrt(2)
    freq = modes.natural_freq * (1 + FREQ_NOISE * rng.normal(size=n_modes))
    nothing = np.full(n_modes, np.nan)
    names = tuple(f"mode_{k + 1}" for k in range(n_modes))
    return MeasuredModes(
        names, freq, freq, FREQ_NOISE * freq, nothing, nothing, sensors, shapes, np.full(shapes.shape, SHAPE_NOISE)
    )
