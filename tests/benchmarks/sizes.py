"""What a matrix model of so many degrees of freedom takes: minutes of processor time and gigabytes of each step.

    python tests/benchmarks/sizes.py [--sizes 10000 30000 100000] [--steps compare calibrate explain] [--write FILE]

The structure is the grillage of ``many_sensors.py``: ten unknown zones of stiffness, ten measured modes at 40 sensors.
Every size runs in a process of its own, so that the memory is its own; a step includes what the ones before it need.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
from pathlib import Path

from many_sensors import grillage, measured
from page import Page
from stopwatch import short, spent

import calib

MODES, SENSORS = 10, 40
STEPS = ("compare", "calibrate", "explain")


def main() -> None:
    """One row a size."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--sizes", type=int, nargs="+", default=[10_000, 30_000, 100_000])
    arguments.add_argument("--steps", choices=STEPS, nargs="+", default=list(STEPS))
    arguments.add_argument("--only", type=int, metavar="SIZE", help="print the figures of one size, used by the script")
    arguments.add_argument("--write", type=Path, help="append the table to this file")
    given = arguments.parse_args()
    if given.only is not None:
        print(json.dumps(taken(given.only, given.steps)), flush=True)
        return
    page = Page(given.write)
    page.begin("Sizes of models")
    rows = []
    for size in given.sizes:
        own = [sys.executable, __file__, "--only", str(size), "--steps", *given.steps]
        found = json.loads(subprocess.run(own, capture_output=True, check=True, text=True).stdout.splitlines()[-1])
        rows.append(
            [f"{found['size']:.0f}", *(short(found[step] / 60) for step in given.steps), f"{found['peak']:.1f}"]
        )
        page.say(f"{rows[-1]}")
    minutes = [f"{step}, processor minutes" for step in given.steps]
    page.table(("degrees of freedom", *minutes, "peak GB"), rows)


def taken(size: int, steps: list[str]) -> dict[str, float]:
    """Processor seconds of each step, and the largest memory in GB, of a model of about so many degrees of freedom."""
    model = grillage(math.ceil(math.sqrt(size / 3)))
    problem = calib.Problem(model, calib.ModalTest(measured(model, SENSORS, MODES)))
    found: dict[str, float] = {"size": float(model.n_dof)}
    results: dict[str, object] = {}
    work = {
        "compare": lambda: results.setdefault("compared", problem.compare()),
        "calibrate": lambda: results.setdefault("fit", problem.calibrate(starts=1)),
        "explain": lambda: results["fit"].explain(),  # type: ignore[attr-defined]
    }
    for step in steps:
        found[step] = spent(work[step]).cpu
    found["peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    return found


if __name__ == "__main__":
    main()
