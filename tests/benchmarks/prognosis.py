"""Metamodels of functions with known shares: errors of coefficients of prognosis, how often their intervals hold.

    python tests/benchmarks/prognosis.py [--runs 50] [--designs 200] [--beside] [--write FILE]

An input's target is its true total share of the variance times the total prognosis of the run. "Filtered" counts the
runs whose metamodel has no input that does nothing. `--beside` predicts the same 2000 fresh points by kriging of SMT
and by sparse polynomial chaos of OpenTURNS, each where it is installed.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from calib.sensitivity.prognosis import prognosis
from tests.sensitivity.known_functions import KNOWN, Known

FRESH = 2000
"""Points at which predictions are compared."""


def counted(name: str, known: Known, runs: int, designs: int) -> dict[str, Any]:
    """One row of the table of counts."""
    near, held, filtered, cops = list[float](), list[np.ndarray](), 0, list[float]()
    begin = time.process_time()
    for seed in range(runs):
        found = prognosis(known.space, *known.designs(designs, seed), seed)["y"]
        target, shares = found.cop * known.total, found.shares
        near.append(float(abs(shares["cop"] - target).max()))
        held.append(((shares["lower"] - 1e-9 <= target) & (target <= shares["upper"] + 1e-9)).to_numpy())
        filtered += all(known.total[int(own[1:])] > 0 for own in found.inputs)
        cops.append(found.cop)
    seconds = (time.process_time() - begin) / runs
    idle = int((known.total == 0).sum())
    return {
        "function": name,
        "inputs": len(known.total),
        "CoP, median": f"{np.median(cops):.3f}",
        "largest error of an input, median": f"{np.median(near):.3f}",
        "within 0.03": f"{sum(one <= 0.03 for one in near)} of {runs}",
        "intervals that hold": f"{100 * np.mean(held):.1f} %",
        "least of an input": f"{100 * np.mean(held, axis=0).min():.0f} %",
        "filtered": f"{filtered} of {runs}" if idle else "–",
        "processor time, s": f"{seconds:.2f}",
    }


def beside(name: str, known: Known, runs: int, designs: int) -> list[dict[str, Any]]:
    """Root mean square error at fresh points over the standard deviation, by each code, with seconds."""
    fresh, true = known.designs(FRESH, 10_000)
    z, y = fresh.to_numpy(), true["y"].to_numpy()
    out = []
    for code, build in CODES.items():
        if code != "calib" and find_spec(code.split()[0].lower()) is None:
            continue
        errors, seconds = [], []
        for seed in range(runs):
            begin = time.process_time()
            predict = build(known, *known.designs(designs, seed))
            errors.append(float(np.sqrt(((predict(z) - y) ** 2).mean()) / y.std()))
            seconds.append(time.process_time() - begin)
        out.append({"function": name, "code": code, "error / std, median": f"{np.median(errors):.4f}",
                    "worst": f"{max(errors):.4f}", "processor time, s": f"{np.median(seconds):.2f}"})  # fmt: skip
    return out


Build = Callable[[Known, pd.DataFrame, pd.DataFrame], Callable[[np.ndarray], np.ndarray]]


def _calib(known: Known, points: pd.DataFrame, response: pd.DataFrame) -> Callable[[np.ndarray], np.ndarray]:
    return prognosis(known.space, points, response)["y"]


def _smt(known: Known, points: pd.DataFrame, response: pd.DataFrame) -> Callable[[np.ndarray], np.ndarray]:
    from smt.surrogate_models import KRG

    model = KRG(print_global=False)
    model.set_training_values(points.to_numpy(), response.to_numpy())
    model.train()
    return lambda z: np.asarray(model.predict_values(z))[:, 0]


NORMS = (0.6, 1.0)
"""Of the hyperbolic sets of polynomials that OpenTURNS chooses from, by its leave-one-out error."""
TERMS, DEGREE = 500, 14
"""Largest number of polynomials in a set, and largest degree."""


def _openturns(known: Known, points: pd.DataFrame, response: pd.DataFrame) -> Callable[[np.ndarray], np.ndarray]:
    import openturns as ot

    ot.ResourceMap.SetAsBool("FunctionalChaosValidation-ModelSelection", True)  # else refused for a sparse one
    count = points.shape[1]
    inputs = ot.JointDistribution([ot.Uniform(-1.0, 1.0)] * count)
    chooses = ot.LeastSquaresMetaModelSelectionFactory(ot.LARS(), ot.CorrectedLeaveOneOut())
    found = []
    for norm in NORMS:
        bounded = ot.HyperbolicAnisotropicEnumerateFunction
        numbered = bounded(count, norm) if norm < 1.0 else ot.LinearEnumerateFunction(count)
        sizes = [numbered.getBasisSizeFromTotalDegree(1)]
        while sizes[-1] <= TERMS and len(sizes) < DEGREE:  # those of many inputs take minutes to count
            sizes.append(numbered.getBasisSizeFromTotalDegree(len(sizes) + 1))
        basis = ot.OrthogonalProductPolynomialFactory([ot.LegendreFactory()] * count, numbered)
        chaos = ot.FunctionalChaosAlgorithm(
            ot.Sample(points.to_numpy()), ot.Sample(response.to_numpy()), inputs,
            ot.FixedStrategy(basis, max(size for size in sizes if size <= TERMS)), ot.LeastSquaresStrategy(chooses),
        )  # fmt: skip
        chaos.run()
        result = chaos.getResult()
        found.append((ot.FunctionalChaosValidation(result).computeR2Score()[0], result.getMetaModel()))
    best = max(found, key=lambda one: float(one[0]))[1]
    return lambda z: np.asarray(best(ot.Sample(z)))[:, 0]


CODES: dict[str, Build] = {"calib": _calib, "smt (kriging)": _smt, "openturns (polynomial chaos)": _openturns}


def markdown(table: pd.DataFrame) -> str:
    """The table as Markdown."""
    lines = [list(table.columns), ["---"] * table.shape[1], *table.astype(str).to_numpy().tolist()]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--designs", type=int, default=200)
    parser.add_argument("--beside", action="store_true")
    parser.add_argument("--write", type=Path)
    given = parser.parse_args()
    rows = []
    for name, known in KNOWN.items():
        own = beside(name, known, given.runs, given.designs) if given.beside else [
            counted(name, known, given.runs, given.designs)
        ]  # fmt: skip
        rows += own
        print(pd.DataFrame(own).to_string(index=False), flush=True)
    if given.write:
        given.write.write_text(markdown(pd.DataFrame(rows)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
