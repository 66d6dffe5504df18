"""Hundreds of sensors and modes: what a comparison and a fit of a model given as matrices take, and how that grows.

    python tests/benchmarks/many_sensors.py [--sensors 125 250 500] [--modes 100] [--side 26] [--write FILE]

The structure is a grillage of beams on springs, in ten zones of unknown bending stiffness; its measurement is
its own, with other stiffnesses and noise. Processor seconds of the steps are printed for each number of sensors, with
the exponent of their growth, and the time of the search for faulty sensors over that of a pairing of all modes.
"""

from __future__ import annotations

import argparse
import resource
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from page import Page
from stopwatch import Spent, exponent, short, spent

import calib
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.sensors import suspicious_sensors
from calib.measurement.modal import MeasuredModes, Sensor

ZONES = 10
SPACING = (0.5, 0.37)
"""Between neighbouring nodes along and across, m: on a square plate modes come in pairs."""
BENDING, TORSION, MASS, SPRING = 2.1e6, 8e5, 40.0, 5e5
"""EI and GJ, Nm^2; of a beam, kg/m; under each node of the edge, N/m."""
WANTED = {"compare": 10.0, "calibrate": 120.0}
"""Seconds for 500 sensors and 100 modes at 2,000 degrees of freedom."""
FREQ_NOISE, SHAPE_NOISE = 0.002, 0.02


def main() -> None:
    """One row a number of sensors."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--sensors", type=int, nargs="+", default=[125, 250, 500])
    arguments.add_argument("--modes", type=int, default=100)
    arguments.add_argument("--side", type=int, default=26, help="nodes along a side, of three degrees of freedom each")
    arguments.add_argument("--write", type=Path, help="append the table to this file")
    given = arguments.parse_args()
    page = Page(given.write)
    page.begin("Many sensors and modes")
    model = grillage(given.side)
    page.say(f"{model}; {given.modes} measured modes")
    rows: list[list[str]] = []
    taken: dict[str, list[Spent]] = {"compare": [], "calibrate": []}
    for number in given.sensors:
        problem = calib.Problem(model, calib.ModalTest(measured(model, number, given.modes)))
        for step in taken:
            taken[step].append(spent(lambda step=step, problem=problem: getattr(problem, step)()))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        ratio = search_over_pairing(model, measured(model, number, given.modes))
        times = [short(kind) for step in taken for kind in taken[step][-1]]
        rows.append([str(number), *times, short(ratio), f"{peak:.0f}"])
    if len(given.sensors) > 1:
        grown = [exponent(given.sensors, some) for some in taken.values()]
        rows.append(["exponent", *(short(kind) for both in grown for kind in both), "", ""])
    steps = [f"{step}, {kind} s" for step in taken for kind in ("wall", "processor")]
    page.table(("sensors", *steps, "search for faulty sensors over a pairing", "peak MB so far"), rows)
    page.say(f"Wanted of 500 sensors: {', '.join(f'{step} {most:g} s' for step, most in WANTED.items())}, below 2 GB.")


def grillage(side: int) -> calib.StructuralModel:
    """A model of ``3 side**2`` degrees of freedom, from matrices: deflection and both slopes at each node."""
    stiffness: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(ZONES)]
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
                zone = min(ends[0][0] * 5 // side, 4) + 5 * (ends[0][1] * 2 // side)
                stiffness[zone].append((dofs[order], stiff))
                mass.append((dofs[order], heavy))
    size = 3 * side**2
    edge = [r * side + c for r in range(side) for c in range(side) if {r, c} & {0, side - 1}]
    springs = [(np.array([3 * node]), np.array([[SPRING * (1 + node % 7 / 20)]])) for node in edge]
    names = [f"zone_{k + 1}" for k in range(ZONES)]
    return calib.StructuralModel.from_matrices(
        stiffness={name: _sum(some, size) for name, some in zip(names, stiffness, strict=True)}
        | {"springs": _sum(springs, size)},
        mass=_sum(mass, size),
        dofs=[(node + 1, direction) for node in range(side**2) for direction in ("z", "rx", "ry")],
        parameters=[calib.Parameter(name, 1.0, 0.5, 2.0, "-", prior_sd=0.2) for name in names],
        name="grillage",
    )


def _sum(parts: list[tuple[np.ndarray, np.ndarray]], size: int) -> sp.csr_array:
    rows = np.concatenate([np.repeat(dofs, len(dofs)) for dofs, _ in parts])
    columns = np.concatenate([np.tile(dofs, len(dofs)) for dofs, _ in parts])
    values = np.concatenate([matrix.ravel() for _, matrix in parts])
    return sp.coo_array((values, (rows, columns)), shape=(size, size)).tocsr()


def measured(model: calib.StructuralModel, n_sensors: int, n_modes: int) -> MeasuredModes:
    """Modes of the same grillage with other stiffnesses, and noise."""
    rng = np.random.default_rng(n_sensors)
    values = {name: float(value) for name, value in zip(model.space.names, rng.uniform(0.8, 1.25, ZONES), strict=True)}
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


def search_over_pairing(model: calib.StructuralModel, modes: MeasuredModes) -> float:
    """Processor time of the search for faulty sensors, over that of a pairing of all modes."""
    problem = ModalProblem(model, modes, mode_count=modes.n_modes + 20)
    found = problem.compare(model.space.values)
    shares = problem.energy_shares(found.values, found.modes)
    pairing = spent(lambda: problem.pair(modes.shapes, found.sensor_shapes, shares, found.modes))
    return spent(lambda: suspicious_sensors(problem, found)).cpu / pairing.cpu


if __name__ == "__main__":
    main()
