"""What a matrix model of so many degrees of freedom takes: minutes of processor time and gigabytes of each step.

    python tests/benchmarks/sizes.py [--sizes 10000 30000 100000] [--of beams shells solids]
                                     [--steps compare calibrate explain] [--limit 45] [--write FILE]

The structures are the grillage of ``grillage.py``, and the roof of shells and block of solids of ``continua.py``: ten
unknown zones of stiffness, ten measured modes at 40 sensors.
Every size runs in a process of its own, so that the memory is its own; a step includes what the ones before it need.
A size that has taken ``--limit`` minutes of processor time is ended; the steps that it did not complete are told.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

from continua import block, roof
from grillage import grillage, measured
from page import Page
from stopwatch import short, spent

import calib

MODES, SENSORS = 10, 40
STEPS = ("compare", "calibrate", "explain")
STRUCTURES = {"beams": lambda size: grillage(math.ceil(math.sqrt(size / 3))), "shells": roof, "solids": block}


def main() -> None:
    """One row a size of a structure."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--sizes", type=int, nargs="+", default=[10_000, 30_000, 100_000])
    arguments.add_argument("--of", choices=STRUCTURES, nargs="+", default=["beams"], help="what the model is made of")
    arguments.add_argument("--steps", choices=STEPS, nargs="+", default=list(STEPS))
    arguments.add_argument("--only", type=int, metavar="SIZE", help="print the figures of one size, used by the script")
    arguments.add_argument("--limit", type=float, default=math.inf, help="processor minutes after which a size ends")
    arguments.add_argument("--write", type=Path, help="append the table to this file")
    given = arguments.parse_args()
    if given.only is not None:
        take(given.of[0], given.only, given.steps, given.limit)
        return
    page = Page(given.write)
    page.begin("Sizes of models")
    rows = []
    for of, size in itertools.product(given.of, given.sizes):
        rows.append([of, *row(of, size, given.steps, given.limit)])
        page.say(f"{rows[-1]}")
    minutes = [f"{step}, processor minutes" for step in given.steps]
    page.table(("of", "degrees of freedom", *minutes, "peak GB"), rows)


def row(of: str, size: int, steps: list[str], limit: float) -> list[str]:
    """What a size took, in a process of its own, which ends after ``limit`` minutes of processor time."""
    own = [sys.executable, __file__, "--of", of, "--only", str(size), "--limit", str(limit), "--steps", *steps]
    with subprocess.Popen(own, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        found: dict[str, float] = {}
        for line in run.stdout:
            found |= json.loads(line)
        _, status, usage = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
    if run.returncode not in (0, -signal.SIGXCPU):
        raise SystemExit(f"{' '.join(own)} ended with {run.returncode}")
    taken = [short(found[step] / 60) if step in found else f"not ended after {limit:g}" for step in steps]
    return [f"{found['size']:.0f}", *taken, f"{usage.ru_maxrss / 1024**2:.1f}"]  # Linux counts it in kB


def take(of: str, size: int, steps: list[str], limit: float) -> None:
    """Print the processor seconds of each step, one JSON line a step.

    The structure has about ``size`` degrees of freedom; the process is ended after ``limit`` minutes of processor time.
    """
    if math.isfinite(limit):
        seconds = math.ceil(60 * limit)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 60))
    model = STRUCTURES[of](size)
    problem = calib.Problem(model, calib.ModalTest(measured(model, SENSORS, MODES)))
    results: dict[str, object] = {}
    work = {
        "compare": lambda: results.setdefault("compared", problem.compare()),
        "calibrate": lambda: results.setdefault("fit", problem.calibrate(starts=1)),
        "explain": lambda: results["fit"].explain(),  # type: ignore[attr-defined]
    }
    print(json.dumps({"size": model.n_dof}), flush=True)
    for step in steps:
        print(json.dumps({step: spent(work[step]).cpu}), flush=True)


if __name__ == "__main__":
    main()
