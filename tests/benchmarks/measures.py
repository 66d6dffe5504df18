"""Measures of the table of speeds, taken in a process of its own with the code of one checkout.

    PYTHONPATH=CHECKOUT python tests/benchmarks/measures.py vehicle|effects|modes|explain|phases [...]

The last line is a JSON object of names and seconds, with the peak of the memory. Studies are those of this checkout.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext

import numpy as np
import scipy.sparse as sp
from child import report
from subject import ROOT, study_of

from calib.analyses import places
from calib.analyses.library import local_perturbations
from calib.analyses.reduction import Wanted
from calib.sampling import sample
from calib.structure.basis import Basis
from calib.structure.reduced import ReducedModel
from calib.structure.refinement import modes_near
from calib.study import Study

POINTS, SEED, MODES = 7, 7, 40


def main() -> None:
    """Take the measures of one group."""
    group, *more = sys.argv[1:]
    report(**{"vehicle": of_vehicle, "effects": of_effects, "modes": of_modes}[group]() if not more else ran(*more))


def of_vehicle() -> dict[str, float]:
    """The basis of the vehicle's search, an evaluation on it, modes at full order by refinement and directly."""
    study = study_of("vehicle")
    taken, basis = trained(study)
    problem, count = study.problem.reduced(basis), study.problem.mode_count
    points = [study.search_space.complete(x) for x in sample(study.search_space, POINTS, SEED).points]
    reduced = problem.model
    return {
        "basis": taken,
        "evaluation": median(problem.evaluate, points),
        "refined": median(lambda v: modes_near(reduced, v, count), points[:4]),
        "direct": median(lambda v: study.model.modes(v, count), points[:4]),
    }


def of_effects() -> dict[str, float]:
    """The basis of all effects and local perturbations of the vehicle, from that of its search."""
    study = Study.load(ROOT / "studies/hidden_effect")
    problem, settings, space = study.problem, study.settings.reduction, study.search_space
    local = local_perturbations(problem.model, [problem.measured], space.values)
    search, basis = trained(study)
    with shared():
        began = time.perf_counter()
        wanted = Wanted.of(problem, settings.tolerance, settings.seed)
        wanted.with_effects(problem.model, basis, space, study.candidates, local)
        return {"effects": time.perf_counter() - began, "effects_search": search}


def of_modes() -> dict[str, float]:
    """Undamped modes of the vehicle without seats: matrices at hand, assembled anew, and by SciPy's eigsh alone."""
    sys.path.insert(0, str(ROOT / "tests/oracles"))
    from simple_vehicle import simple_vehicle

    vehicle = simple_vehicle()
    stiffness, mass = vehicle.matrices()
    turns = [{}] * 3
    return {
        "own": median(lambda _: vehicle.modes(stiffness, mass, MODES), turns),
        "own_anew": median(lambda _: vehicle.modes(*vehicle.matrices(), MODES), turns),
        "eigsh": median(lambda _: by_eigsh(stiffness, mass), turns),
        "eigsh_anew": median(lambda _: by_eigsh(*vehicle.matrices()), turns),
    }


def by_eigsh(stiffness: sp.csc_array, mass: sp.csc_array) -> np.ndarray:
    """As its manual has it: shift-invert, by a small negative shift since there may be rigid-body motions."""
    squares = sp.linalg.eigsh(sp.csc_matrix(stiffness), MODES, sp.csc_matrix(mass), sigma=-1.0)[0]
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)


def ran(*commands: str) -> dict[str, float]:
    """Commands of calib in turn, into one folder without anything kept, by the wall clock."""
    with tempfile.TemporaryDirectory() as folder:
        kept = ["--results", folder, "--cache", f"{folder}/cache"]
        began = time.perf_counter()
        for command in commands:
            words = [sys.executable, "-m", "calib", *command.split(), *kept]
            subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return {"seconds": time.perf_counter() - began}


def trained(study: Study) -> tuple[float, Basis]:
    """A basis at the tolerance of the study, and the seconds that it takes."""
    settings, began = study.settings.reduction, time.perf_counter()
    with shared():
        wanted = Wanted.of(study.problem, settings.tolerance, settings.seed)
        basis = wanted.trained(study.model, study.search_space)
    taken = time.perf_counter() - began
    ReducedModel(study.model, basis)
    return taken, basis


def shared():
    """As the commands of this checkout do it by themselves."""
    return places.tasks_shared(None) if hasattr(places, "tasks_shared") else nullcontext()


def median(task: Callable, points: list) -> float:
    """Of the seconds at some points, after one call that warms up."""
    task(points[0])
    seconds = []
    for point in points:
        began = time.perf_counter()
        task(point)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


if __name__ == "__main__":
    main()
