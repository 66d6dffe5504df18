"""Bogie and vehicle fitted together, beside the staged way: the bogie first, then the car on what was found.

    python tests/benchmarks/joint_fit.py [--bogie studies/bogie] [--vehicle studies/vehicle] [--table FILE]

Both ways are least squares at full order with the same measurements, limits and priors; integers are those of the
bogie's own fit. The staged one holds the bogie's parameters at what that fit has found, and tells standard deviations
that include what it left open; the joint one begins at the nominal values. Standard deviations of both count what the
studies do not select, within its limits. Values that the synthetic measurements were made from stand beside both, and
enter neither.
"""

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from calib.correlation.modal.residual import ModalResidual
from calib.inference.considered import At, changes_by_held
from calib.inference.gauss_newton import fit
from calib.inference.identify import Posterior, posterior
from calib.inference.integers import fit_mixed
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem
from calib.problem.space import ParameterSpace
from calib.study.study import LoadedStudy
from calib.study.study_text import read_settings

ROOT = Path(__file__).resolve().parents[2]
TRUTH = ROOT / "tests/truth"


def problem_of(study: LoadedStudy) -> PairProblem[ModalResidual]:
    """A study's measurement against its model."""
    return PairProblem(ModalResidual(study.problem), study.search_space)


def fitted(
    problem: PairProblem[ModalResidual] | JointProblem, held: dict[str, float]
) -> tuple[dict[str, float], Posterior]:
    """All values at the optimum, and what is known there; ``held`` are the standard deviations of parameters held."""
    found = fit(problem, problem.space, {})
    widths = np.array([problem.space[n].prior_width for n in found.names])
    at = At(found.names, found.values, found.residual, found.jacobian, widths, False)  # no new fits at full order
    spread = changes_by_held(problem, at, held).of_estimates
    print(
        f"  {len(problem.rows)} rows, {len(found.names)} parameters: {found.data_misfit:.1f}, {found.reason}",
        flush=True,
    )
    return found.values, posterior(found.names, found.jacobian, widths, spread)


def told(way: str, values: dict[str, float], known: Posterior, space: ParameterSpace, truth: dict[str, float]) -> list:
    """One row a fitted parameter."""
    return [
        (n, space[n].unit, way, values[n], s, truth[n], (values[n] - truth[n]) / s)
        for n, s in zip(known.names, known.std, strict=True)
        if n in truth
    ]


def main() -> None:
    """Both ways, and a table of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bogie", type=Path, default=ROOT / "studies/bogie")
    parser.add_argument("--vehicle", type=Path, default=ROOT / "studies/vehicle")
    parser.add_argument("--table", type=Path, help="CSV file for the result")
    given = parser.parse_args()
    truth = {
        name: value
        for study in ("bogie", "vehicle")
        for name, value in json.loads((TRUTH / f"{study}.json").read_text("utf-8"))["parameters"].items()
    }
    study = LoadedStudy.load(given.bogie)
    bogie, left_out = problem_of(study), study.held_sd
    best = fit_mixed(bogie, bogie.space).best.values
    bogie = replace(bogie, space=bogie.space.freeze({p.name: best[p.name] for p in bogie.space.free if p.integer}))
    names = read_settings(given.vehicle / "study.toml").adopted.parameters
    print("staged")
    values, known = fitted(bogie, left_out)
    rows = told("staged", values, known, bogie.space, truth)
    std = dict(zip(known.names, known.std.tolist(), strict=True))
    taken = {n: std[n] for n in names}
    study = LoadedStudy.load(given.vehicle, adopted={n: values[n] for n in names}, adopted_sd=taken)
    car = problem_of(study)
    rows += told("staged", *fitted(car, study.held_sd), car.space, truth)
    print("joint")
    start = bogie.space.values
    car = problem_of(LoadedStudy.load(given.vehicle, adopted={n: start[n] for n in names}))
    joint = JointProblem({"bogie": bogie, "vehicle": car})
    both_sd = left_out | {n: sd for n, sd in study.held_sd.items() if n not in names}
    rows += told("joint", *fitted(joint, both_sd), joint.space, truth)
    table = pd.DataFrame(rows, columns=["parameter", "unit", "way", "value", "std", "truth", "off_in_std"])
    both = table.pivot(index=["parameter", "unit", "truth"], columns="way", values=["value", "std", "off_in_std"])
    print(both.reindex(table["parameter"].unique(), level=0).to_string(float_format="%.4g"))
    if given.table:
        table.to_csv(given.table, index=False)


if __name__ == "__main__":
    main()
