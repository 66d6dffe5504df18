"""One evaluation of the bogie on its rig, side by side: reduced basis, full order, OpenSees.

    python tests/benchmarks/speed.py [--repeats 60] [--workers 1 2]

Prints milliseconds with their ratios, all taken in turn in one run, evaluations a second for one and two worker
processes, and where the time of an evaluation goes. OpenSees solves the undamped problem only and is left out where it
cannot be loaded. One BLAS thread everywhere.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import numpy as np

from calib.loading import module_of
from calib.questions.places import open_evaluator
from calib.questions.reduction import reduction_of
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.structure.solve import solve_modes
from calib.study import Study

ROOT = Path(__file__).resolve().parents[2]


def opensees_solver() -> Callable[[dict[str, float]], object] | None:
    """A function that builds and solves the rig in OpenSees; None where that cannot be loaded."""
    conftest, oracle = (module_of(ROOT / "tests" / f"{n}.py") for n in ("conftest", "oracles/test_opensees_rig"))
    try:
        code = conftest.opensees.__wrapped__()
    except BaseException as fault:  # a skip is no Exception
        print(f"OpenSees is left out: {fault}")
        return None
    return lambda values: oracle.opensees_modes(code, oracle.bogie_on_rig().locator.frame, values, 10)


def medians(tasks: dict[str, Callable[[dict[str, float]], object]], points: list[dict[str, float]]) -> dict[str, float]:
    """Median milliseconds of every task, taken in turn at the same points."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for values in points:
        for name, task in tasks.items():
            started = time.perf_counter()
            task(values)
            times[name].append(1e3 * (time.perf_counter() - started))
    return {name: float(np.median(t)) for name, t in times.items()}


def main() -> None:
    """Time everything and print tables."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--repeats", type=int, default=60)
    arguments.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    given = arguments.parse_args()

    study = Study.load(ROOT / "studies/bogie")
    full = study.problem
    space = study.search_space
    points = [space.complete(x) for x in sample(space, given.repeats, 7).points]
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        reduction = reduction_of(study, Results(Path(folder)))
        assert reduction is not None
        print(f"off-line: basis of {reduction.basis.size} vectors in {time.perf_counter() - started:.1f} s\n")
        reduced = reduction.problem
        tasks: dict[str, Callable[[dict[str, float]], object]] = {
            "reduced, complex, paired": reduced.evaluate,
            "full order, complex, paired": full.evaluate,
            "reduced, modes only": lambda v: reduced.model.modes(v, full.mode_count),
            "full order, complex modes only": lambda v: full.model.modes(v, full.mode_count),
            "full order, real modes only": lambda v: solve_modes(*_undamped(full.model.matrices(v)), full.mode_count),
        }
        solver = opensees_solver()
        if solver is not None:
            tasks["OpenSees, real modes, with building"] = solver
        table = medians(tasks, points)
        least = table["reduced, complex, paired"]
        print(f"{'one evaluation':38s} {'median ms':>10s} {'over reduced':>13s}")
        for name, value in table.items():
            print(f"{name:38s} {value:10.2f} {value / least:13.1f}")

        print("\nevaluations a second, populations of 30:")
        for label, problem, basis in (("reduced", reduced, reduction.path), ("full order", full, None)):
            for workers in given.workers:
                with open_evaluator(study, workers, 1, problem, basis) as evaluator:
                    evaluator.evaluate(points[:2])
                    started = time.perf_counter()
                    for k in range(4):
                        evaluator.evaluate([points[(7 * k + i) % len(points)] for i in range(30)])
                    rate = 120 / (time.perf_counter() - started)
                print(f"  {label:12s} {workers} worker{'s' if workers > 1 else ' '} {rate:8.0f}")

        print("\nwhere the time of a reduced evaluation goes:")
        values = points[0]
        modes = reduced.model.modes(values, full.mode_count)
        parts: dict[str, Callable[[dict[str, float]], object]] = {
            "matrices": reduced.model.matrices,
            "matrices and modes": lambda v: reduced.model.modes(v, full.mode_count),
            "strain-energy shares": lambda v: reduced.model.energy_shares(v, modes.shapes, tuple(full.model.clusters)),
            "whole evaluation": reduced.evaluate,
        }
        for name, value in medians(parts, [values] * given.repeats).items():
            print(f"  {name:38s} {value:8.2f} ms")


def _undamped(matrices: tuple) -> tuple:
    stiffness, _, mass = matrices
    return stiffness, None, mass


if __name__ == "__main__":
    main()
