"""Measures of the table of speeds, taken in a process of its own with the code of one checkout.

    PYTHONPATH=CHECKOUT python tests/benchmarks/measures.py GROUP
    PYTHONPATH=CHECKOUT python tests/benchmarks/measures.py commands "explain studies/hidden_bogie" [...]
    PYTHONPATH=CHECKOUT python tests/benchmarks/measures.py finer studies/hidden_effect refine=1 [refine=4 ...]

The last line is a JSON object: by name the seconds of wall clock and of processor time, worker processes included, with
the peak of the memory; a sentence where a code is not installed. Studies are those of this checkout.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import json
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from unittest import mock

import numpy as np
import scipy.sparse as sp
from child import report
from stopwatch import Spent, exponent, median, spent
from subject import ROOT, study_of

from calib.analyses.provenance import places
from calib.correlation.basis import BasisRequirements
from calib.hypotheses.library import local_perturbations
from calib.problem.sampling import sample
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near
from calib.study.study import LoadedStudy

POINTS, SEED, MODES = 7, 7, 40
REPEATS = 3
ABSENT = "not installed"

Taken = dict[str, Spent | float | str]


def main() -> None:
    """Take the measures of one group."""
    group, *more = sys.argv[1:]
    groups: dict[str, Callable[..., Taken]] = {
        "vehicle": of_vehicle, "effects": of_effects, "opensees": of_opensees,
        "calculix": of_calculix, "commands": ran, "finer": of_finer, "auto": by_auto, "matrices": of_matrices,
        "sensors": of_sensors,
    }  # fmt: skip
    report(**groups[group](*more))


def of_vehicle() -> Taken:
    """The basis of the vehicle's search, an evaluation on it, modes at full order by refinement and directly."""
    study = study_of("vehicle")
    taken, basis = trained(study)
    problem, count = study.problem.reduced(basis), study.problem.mode_count
    points = [study.search_space.complete(x) for x in sample(study.search_space, POINTS, SEED).points]
    reduced = problem.model
    return {
        "basis": taken,
        "evaluation": usual(problem.evaluate, points),
        "refined": usual(lambda v: modes_near(reduced, v, count), points[:4]),
        "direct": usual(lambda v: study.model.modes(v, count), points[:4]),
    }


def of_effects() -> Taken:
    """The basis of all effects and local perturbations of the vehicle, from that of its search."""
    study = LoadedStudy.load(ROOT / "studies/hidden_effect")
    problem, settings, space = study.problem, study.settings.reduction, study.search_space
    local = local_perturbations(problem.model, [problem.measured], space.values)
    search, basis = trained(study)

    def widened() -> None:
        with shared():
            wanted = BasisRequirements.of(problem, settings.tolerance, settings.seed)
            wanted.with_effects(problem.model, basis, space, study.candidates, local)

    return {"effects": spent(widened), "effects_search": search}


def of_opensees() -> Taken:
    """The same modes by OpenSees with SuperLU, its fastest system here: the model built before, and built anew.

    It assembles its matrices within its solution, which is in both.
    """
    vehicle = compared_vehicle()
    import opensees_code
    from opensees_vehicle import Twin

    try:
        code = opensees_code.load()
    except ImportError:
        return {"solved": ABSENT, "anew": ABSENT}
    solved = []
    for _ in range(REPEATS):
        twin = Twin(code, vehicle)
        solved.append(spent(lambda twin=twin: twin.solve(MODES, "SparseGEN")))
    anew = [spent(lambda: Twin(code, vehicle).solve(MODES, "SparseGEN")) for _ in range(REPEATS)]
    return {"solved": median(solved), "anew": median(anew)}


def of_calculix() -> Taken:
    """The same modes by CalculiX, which reads and assembles anew; and a single mode, for what that takes at most."""
    vehicle = compared_vehicle()
    import calculix
    import calculix_vehicle

    if calculix.COMMAND is None:
        return {"anew": ABSENT, "one": ABSENT}
    deck = calculix_vehicle.deck_of(vehicle)
    with tempfile.TemporaryDirectory() as folder:
        taken = {
            name: median([spent(lambda text=text: calculix.run(text, Path(folder))) for _ in range(REPEATS)])
            for name, text in (("anew", deck.text(MODES)), ("one", deck.text(1)))
        }
    return {**taken}


SIDE, ZONES, FEW_SENSORS, FEW_MODES = 58, 8, 30, 10
"""Nodes along a side of the grillage, of three degrees of freedom each, its free parameters, sensors and modes."""
STRIP = 295
"""Nodes of its damped strip."""


def of_matrices() -> Taken:
    """A model of 10,092 degrees of freedom given as matrices: one solution, derivatives, a fit of 8 parameters.

    And the static vectors of a basis where a strip of 885 degrees of freedom has material damping.
    """
    import grillage
    import scipy.stats  # noqa: F401  # its import is no part of a fit

    import calib
    from calib.structure.eigenproblem.derivatives import mode_derivatives

    model = grillage.grillage(SIDE)
    names = [f"zone_{k + 1}" for k in range(ZONES)]
    test = calib.ModalTest(grillage.measured(model, FEW_SENSORS, FEW_MODES))
    rows = model.sensor_rows(test.modes.sensors)
    one = usual(lambda v: model.modes(v, 2 * FEW_MODES), [{names[0]: 1.1 + 0.01 * k} for k in range(REPEATS)])
    modes = model.modes({}, 2 * FEW_MODES)
    slopes = usual(lambda _: mode_derivatives(model, {}, modes, names, range(FEW_MODES), rows), [{}] * REPEATS)
    with nothing_kept():
        fitted = spent(lambda: calib.Problem(model, test).keep(names).calibrate(progress=False))
    taken, vectors = of_strip(model)
    return {
        "one": one, "slopes": slopes, "calibrate": fitted, "solutions": Spent(*(fitted[k] / one[k] for k in (0, 1))),
        "strip": taken, "strip_vectors": vectors,
    }  # fmt: skip


def of_strip(model) -> tuple[Spent, float]:
    """The static vectors of a basis whose model has material damping on a strip: what they take, and their number."""
    import calib
    from calib.structure.reduction.growth import Growth, reference_modes

    stiffness = {term.name: term.matrix for term in model.stiffness.terms}
    inside = sp.diags_array((np.arange(model.n_dof) // 3 < STRIP).astype(float))
    whole = sum(stiffness.values(), sp.csr_array((model.n_dof, model.n_dof)))
    damped = calib.StructuralModel.from_matrices(
        stiffness=stiffness, mass=model.mass.terms[0].matrix, damping={"c": 1e-4 * (inside @ whole @ inside)},
        dofs=list(zip(model.dofs.node + 1, model.dofs.direction + 1, strict=True)),
        parameters=[*model.space.parameters, calib.Parameter("c", 1.0, 0.0, 2.0)], name="damped strip",
    )  # fmt: skip
    nominal = np.array(list(damped.space.values.values()))
    basis = Basis(
        np.zeros((damped.n_dof, 0)), damped.fingerprint, damped.space.names, nominal, nominal, nominal, 0.0,
        2 * FEW_MODES, np.inf, 0.95, 1e-5, np.zeros((0, len(nominal))), np.zeros((0, 4)), 1,
    )  # fmt: skip
    growth = Growth(damped, basis, reference_modes(damped, damped.space.values))
    found: list[int] = []
    taken = spent(lambda: found.append(growth.statics(np.zeros((damped.n_dof, 0))).shape[1]))
    return taken, float(found[0])


def of_sensors() -> Taken:
    """500 sensors and 100 modes of a model of 2,028 degrees of freedom given as matrices, 10 parameters."""
    import grillage
    import scipy.stats  # noqa: F401  # its import is no part of a fit

    import calib

    model = grillage.grillage(26)
    problem = calib.Problem(model, calib.ModalTest(grillage.measured(model, 500, 100)))
    with nothing_kept():
        return {
            "compare": spent(problem.compare),
            "calibrate": spent(lambda: problem.calibrate(progress=False)),
        }


@contextmanager
def nothing_kept() -> Iterator[None]:
    """No trained basis of an earlier run is found."""
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, {"CALIB_CACHE": folder}):
        yield


def compared_vehicle():
    """The vehicle without seats in the form that other codes take; its folder is found by imports from now on."""
    sys.path.insert(0, str(ROOT / "tests/oracles"))
    from simple_vehicle import simple_vehicle

    return simple_vehicle()


def ran(*commands: str) -> Taken:
    """Commands of calib in turn, into one folder without anything kept."""
    with tempfile.TemporaryDirectory() as folder:
        kept = ["--results", folder, "--cache", f"{folder}/cache"]

        def every() -> None:
            for command in commands:
                words = [sys.executable, "-m", "calib", *command.split(), *kept]
                subprocess.run(words, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        return {"seconds": spent(every)}


def by_auto() -> Taken:
    """Both phases where each study's own method is ``auto``, by one case, which is the default, and by all of theirs.

    The vehicle adopts what is found of the bogie.
    """
    taken = {}
    for name in ("one", "four"):
        with tempfile.TemporaryDirectory() as home:
            for study in ("bogie", "vehicle"):
                shutil.copytree(ROOT / "studies" / study, Path(home) / study)
                file = Path(home) / study / "study.toml"
                text = re.sub(r'^method = "genetic"', 'method = "auto"', file.read_text("utf-8"), flags=re.MULTILINE)
                if name == "one":
                    text = re.sub(r"^cases = \[\n(?:    .*\n)*\]\n", "", text, flags=re.MULTILINE)
                file.write_text(text, "utf-8")
                given = tomllib.loads(text)["calibration"]
                assert given["method"] == "auto" and ("cases" in given) == (name == "four")
            taken[name] = ran(f"calibrate {home}/vehicle")["seconds"]
    return taken


def of_finer(study: str, *options: str) -> Taken:
    """``calib explain`` of a study at some options of its model, such as ``refine=4``, without its finer mesh.

    Of the last one is told what it takes, with its degrees of freedom; of several the exponent of growth too.
    """
    sizes, taken = list[float](), list[Spent]()
    with tempfile.TemporaryDirectory() as home:
        for option in options:
            folder = Path(home) / option / Path(study).name
            shutil.copytree(ROOT / study, folder)
            with_option(folder / "study.toml", option)
            sizes.append(float(LoadedStudy.load(folder).model.n_dof))
            seconds = ran(f"explain {folder}")["seconds"]
            assert isinstance(seconds, Spent)
            taken.append(seconds)
    grown = {} if len(options) < 2 else {"growth": exponent(sizes, taken)}
    return {"seconds": taken[-1], "n_dof": sizes[-1], **grown}


def with_option(file: Path, option: str) -> None:
    """Write an option of the model into a study's file, and take the finer mesh out."""
    text = file.read_text("utf-8")
    key, _, value = option.partition("=")
    given = {**tomllib.loads(text).get("model_options", {}), key: json.loads(value)}
    line = "model_options = { " + ", ".join(f"{name} = {json.dumps(one)}" for name, one in given.items()) + " }"
    text = re.sub(r"^(model_options|finer_options) = .*\n", "", text, flags=re.MULTILINE)
    file.write_text(re.sub(r"^(model = .*)$", rf"\1\n{line}", text, count=1, flags=re.MULTILINE), "utf-8")


def trained(study: LoadedStudy) -> tuple[Spent, Basis]:
    """A basis at the tolerance of the study, and what it takes."""
    settings, made = study.settings.reduction, []

    def train() -> None:
        with shared():
            wanted = BasisRequirements.of(study.problem, settings.tolerance, settings.seed)
            made.append(wanted.trained(study.model, study.search_space))

    taken = spent(train)
    ReducedModel(study.model, made[0])
    return taken, made[0]


def shared():
    """As the commands of this checkout do it by themselves."""
    return places.tasks_shared(None) if hasattr(places, "tasks_shared") else nullcontext()


def usual(task: Callable, points: list) -> Spent:
    """Median of what a task takes at some points, after one call that warms up."""
    task(points[0])
    return median([spent(lambda point=point: task(point)) for point in points])


if __name__ == "__main__":
    main()
