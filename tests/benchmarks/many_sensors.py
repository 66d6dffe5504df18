"""Hundreds of sensors and modes: what a comparison and a fit of a model given as matrices take, and how that grows.

    python tests/benchmarks/many_sensors.py [--sensors 125 250 500] [--modes 100] [--side 26] [--write FILE]

The structure is the grillage of ``grillage.py``, in ten zones of unknown bending stiffness; its measurement is
its own, with other stiffnesses and noise. Processor seconds of the steps are printed for each number of sensors, with
the exponent of their growth, and the time of the search for faulty sensors over that of a pairing of all modes.
"""

from __future__ import annotations

import argparse
import resource
from pathlib import Path

from grillage import grillage, measured
from page import Page
from stopwatch import Spent, exponent, short, spent

import calib
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.sensors import suspicious_sensors
from calib.measurement.modal import MeasuredModes

WANTED = {"compare": 10.0, "calibrate": 120.0}
"""Seconds for 500 sensors and 100 modes at 2,000 degrees of freedom."""


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


def search_over_pairing(model: calib.StructuralModel, modes: MeasuredModes) -> float:
    """Processor time of the search for faulty sensors, over that of a pairing of all modes."""
    problem = ModalProblem(model, modes, mode_count=modes.n_modes + 20)
    found = problem.compare(model.space.values)
    shares = problem.energy_shares(found.values, found.modes)
    pairing = spent(lambda: problem.pair(modes.shapes, found.sensor_shapes, shares, found.modes))
    return spent(lambda: suspicious_sensors(problem, found)).cpu / pairing.cpu


if __name__ == "__main__":
    main()
