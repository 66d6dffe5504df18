"""How often the search for a missing effect is right on the five-mass chain, a model without matrices.

    python tests/benchmarks/chain_rates.py --runs 200
    python tests/benchmarks/chain_rates.py --runs 40 --bare
    python tests/benchmarks/chain_rates.py --runs 40 --bare --outside

Every run draws springs, damping, the magnitude of the hidden effect and the standard deviation anew; seeds are fixed.
With --bare masses and single dampers are inside the function and no parameter is declared fixed, as in most functions
of users. With --outside the hidden effect is taken out of the library, or nothing is hidden and the measurement is at
fault: whatever effect is named then is wrong; "competing model left in" says that the fault is told beside it.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from rates_subject import ROOT

from calib.analyses.function_hypotheses import function_hypotheses
from calib.correlation.function_problem import FunctionProblem
from calib.correlation.response_residual import ResponseResidual
from calib.function import FunctionModel
from calib.loading import module_of
from calib.missing.explain import Settings, explain
from calib.space import ParameterSpace
from calib.study import Study

FOLDER = ROOT / "studies/five_mass_chain"
NAMING = ("effect", "indistinguishable", "two_effects", "several_effects")
FAULTS: dict[str, tuple[str, float, float]] = {
    "damping too high": ("damping", 0.003, 0.010),
    "frequency too high": ("freq", 0.05, 0.20),
}
"""Kind of response that is off by a constant, and the range of it."""
COLUMNS = ("right", "with a false one", "competing model left in", "none or partial", "nothing", "wrong")


def main() -> None:
    """Run and print the table."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("--runs", type=int, default=200, help="runs of each row (default 200)")
    arguments.add_argument("--bare", action="store_true", help="no parameter is declared fixed")
    arguments.add_argument("--outside", action="store_true", help="the hidden effect is in no library")
    given = arguments.parse_args()
    study, twin = Study.load(FOLDER), module_of(FOLDER / "make_twin.py")
    hidden = [e.name for e in twin.chain_effects() if e.name not in twin.INVISIBLE]
    hidden = [*hidden, *FAULTS] if given.outside else ["", *hidden]
    model, space = study.model, study.search_space
    if given.bare:
        model, space = bare(model, space)
    print(f"{'hidden':20s}" + "".join(f"{c:>25s}" for c in COLUMNS) + f"{'calls (mean)':>14s}{'(most)':>8s}")
    for name in hidden:
        counts: Counter[str] = Counter()
        calls = []
        for seed in range(given.runs):
            rng = np.random.default_rng([seed, *name.encode()])
            exact = twin.twin_responses(twin.draw(rng, "" if name in FAULTS else name))
            targets = twin.measure(faulty(exact, name, rng), rng)
            repeats = study.settings.measurement.repeats
            library = tuple(e for e in study.candidates if not (given.outside and e.name == name))
            pair = ResponseResidual(FunctionProblem(model.space, model.function, targets, "", repeats))
            asked, _ = function_hypotheses(model, pair, library, space)
            found = explain(asked, Settings(budget=np.inf))
            counts[_outcome(found.verdict, found.untold, truth_of(name))] += 1
            calls.append(found.evaluations)
        cells = "".join(f"{counts[c]:25d}" for c in COLUMNS)
        print(f"{name or 'nothing':20s}{cells}{np.mean(calls):14.0f}{max(calls):8d}", flush=True)


def faulty(exact: Mapping[str, float], fault: str, rng: np.random.Generator) -> dict[str, float]:
    """Responses with a fault of the measurement; as they are for any other name."""
    kind, low, high = FAULTS.get(fault, ("", 0.0, 0.0))
    off = rng.uniform(low, high) if kind else 0.0
    return {name: value + off * (name.split("_")[0] == kind) for name, value in exact.items()}


def truth_of(hidden: str) -> str:
    """What a right answer names: the hidden effect, or the fault as calib calls it."""
    return f"offset of {FAULTS[hidden][0]}" if hidden in FAULTS else hidden


def bare(model: FunctionModel, space: ParameterSpace) -> tuple[FunctionModel, ParameterSpace]:
    """The same function of the fitted parameters alone, and their space."""
    held = {p.name: p.value for p in space.parameters if p.distribution == "fixed"}
    own = ParameterSpace(space.free)
    return replace(model, space=own, function=lambda values: model.function(held | dict(values))), own


def _outcome(verdict: str, untold: tuple[str, ...], hidden: str) -> str:
    if verdict == "nothing_detectable":
        return "nothing"
    if verdict not in NAMING:
        return "none or partial"
    if hidden not in untold:
        return "wrong"
    if len(untold) == 1:
        return "right"
    return "with a false one" if verdict in ("two_effects", "several_effects") else "competing model left in"


if __name__ == "__main__":
    main()
