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
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from other_methods import answers
from rates_outcome import magnitude, outcome
from rates_scenarios import Scenario
from rates_subject import CHAIN, ROOT, Subject
from rates_table import methods_file, report_methods
from rates_world import digest_of

from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.hypotheses.function_perturbations import function_hypotheses
from calib.missing.decision import Settings, decide
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.function_model import FunctionModel
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

FOLDER = ROOT / "studies/five_mass_chain"
TWIN: Any = module_of(FOLDER / "make_twin.py")
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
    arguments.add_argument("--write", type=Path, help="docs/rates_chain.csv: other methods, to rates_chain_methods.csv")
    given = arguments.parse_args()
    hidden = [e.name for e in TWIN.chain_effects() if e.name not in TWIN.INVISIBLE]
    hidden = [*hidden, *FAULTS] if given.outside else ["", *hidden]
    asked = chain(given.bare)
    print(f"{'hidden':20s}" + "".join(f"{c:>25s}" for c in COLUMNS) + f"{'calls (mean)':>14s}{'(most)':>8s}")
    rows: list[dict[str, Any]] = []
    for name in hidden:
        own = [one(asked, name, seed, given.outside) for seed in range(given.runs)]
        counts = Counter(_outcome(row["verdict"], row["untold"], truth_of(name)) for row in own)
        calls = [row["evaluations"] for row in own]
        cells = "".join(f"{counts[c]:25d}" for c in COLUMNS)
        print(f"{name or 'nothing':20s}{cells}{np.mean(calls):14.0f}{max(calls):8d}", flush=True)
        rows += own
    report_methods(rows, methods_file(given.write), date.today().isoformat())


class Chain(NamedTuple):
    """The model that is asked, its library and its free parameters."""

    model: FunctionModel
    library: tuple[Effect, ...]
    space: ParameterSpace
    repeats: Any


def chain(is_bare: bool = False) -> Chain:
    """That of the study, or one that declares no parameter fixed."""
    study = LoadedStudy.load(FOLDER)
    model, space = study.model, study.search_space
    if is_bare:
        model, space = bare(model, space)
    return Chain(model, study.candidates, space, study.settings.measurement.repeats)


@dataclass(frozen=True)
class Hidden:
    """One effect with its true values, as `rates_outcome.Truth`; a measurement error is no effect."""

    values: Mapping[str, float]
    hidden: tuple[str, ...]


def one(asked: Chain, name: str, seed: int, outside: bool = False, reading: str = "") -> dict[str, Any]:
    """Draw a chain, measure it, and ask what its model lacks: a row with what other methods answer beside.

    ``reading`` is a fault of the sensors, see `misread`.
    """
    rng, started = np.random.default_rng([seed, *(reading or name).encode()]), time.perf_counter()
    truth = TWIN.draw(rng, "" if name in FAULTS else name)
    exact = TWIN.twin_responses(truth)
    targets = TWIN.measure(misread(faulty(exact, name, rng), reading, rng), rng)
    library = tuple(e for e in asked.library if not (outside and e.name == name))
    pair = ResponseResidual(FunctionProblem(asked.model.space, asked.model.function, targets, "", asked.repeats))
    hypotheses, _ = function_hypotheses(asked.model, pair, library, asked.space)
    found = decide(hypotheses, Settings(budget=np.inf))
    seconds = round(time.perf_counter() - started, 3)
    hidden = Hidden(truth, (name,) if name and name not in FAULTS else ())
    row = outcome(found, hidden)
    if row["outcome"] == "right" and len(hidden.hidden) == 1:
        row |= magnitude(found, hidden)
    group = "fault" if name in FAULTS or reading else "removed" if name and outside else "single" if name else "nothing"
    seen = [round(visible(hypotheses.fit_problem(()), truth, exact, targets, name), 2)] if hidden.hidden else []
    return {
        "code": digest_of(CHAIN.sources), "scenario": reading or name or "nothing", "number": seed, "group": group,
        "hidden": list(hidden.hidden), "magnitudes": {n: truth[n] for n in hidden.hidden}, "visible": seen,
        "untold": list(found.equally_good), "seconds": seconds,
    } | row | answers(found, hypotheses, hidden)  # fmt: skip


def visible(
    base: Any, truth: Mapping[str, float], exact: Mapping[str, float], targets: Mapping[str, Any], name: str
) -> float:
    """Length of the change of the exact responses by the effect that no parameter absorbs, in standard deviations."""
    library = {e.name: e for e in TWIN.chain_effects()}
    plain = TWIN.twin_responses({n: v for n, v in truth.items() if n not in library[name].names})
    change = [(exact[n] - plain[n]) / std for n, (_, std) in targets.items()]
    names = [p.name for p in base.space.free]
    values = base.space.complete({n: v for n, v in truth.items() if n in names})
    slope = base.jacobian(values, names) * [base.space[n].prior_width for n in names]
    basis = np.linalg.qr(np.vstack([slope, np.eye(len(names))]))[0]  # the prior counts as data
    direction = np.concatenate([change, np.zeros(len(names))])
    return float(np.linalg.norm(direction - basis @ (basis.T @ direction)))


def faulty(exact: Mapping[str, float], fault: str, rng: np.random.Generator) -> dict[str, float]:
    """Responses with a measurement error; as they are for any other name."""
    kind, low, high = FAULTS.get(fault, ("", 0.0, 0.0))
    off = rng.uniform(low, high) if kind else 0.0
    return {name: value + off * (name.split("_")[0] == kind) for name, value in exact.items()}


def misread(exact: Mapping[str, float], fault: str, rng: np.random.Generator) -> dict[str, float]:
    """Responses as read with a fault of one sensor or set-up; as they are for an empty name."""
    mass, sign = int(rng.integers(1, 6)) if fault else 0, -1.0 if fault and rng.random() < 0.5 else 1.0
    size = rng.uniform(0.1, 0.3) if fault else 0.0
    out = dict(exact)
    for name in exact if fault else ():
        kind, *where = name.split("_")
        if kind != "shape":
            continue
        mode, at = where
        beside = exact.get(f"shape_{mode}_{at_other(int(at))}", 0.0)
        if fault == "fault/gain" and int(at) == mass:
            out[name] *= 1 + sign * size
        elif fault == "fault/cross-talk" and int(at) == mass:
            out[name] += size * beside
        elif fault == "fault/set-up factor" and int(at) > 3:
            out[name] *= 1 + sign * size / 2
    return out


def at_other(mass: int) -> int:
    """The mass whose channel lies beside that of another."""
    return mass - 1 if mass > 1 else 2


@dataclass(frozen=True, eq=False)
class ChainWorld:
    """Chains by a plan of their own, see `rates_world.World`; each effect also left out of the library, and faults.

    A place, a rotation and an odd repeat have no meaning for responses in one direction that are given as means.
    """

    subject: Subject
    folder: Path
    code: str

    @cached_property
    def asked(self) -> Chain:
        """The model and its library."""
        return chain()

    def settle(self) -> None:
        """Load the model."""
        _ = self.asked

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """What may be hidden or wrong."""
        names = [e.name for e in TWIN.chain_effects() if e.name not in TWIN.INVISIBLE]
        return (
            Scenario("nothing", "nothing", each=6), *(Scenario(n, "single", (n,), each=2) for n in names),
            *(Scenario(f"without/{n}", "removed", (n,), removed=True) for n in names),
            *(Scenario(f"fault/{f}", "fault") for f in ("gain", "cross-talk", "set-up factor")),
        )  # fmt: skip

    def run(self, scenario: Scenario, number: int) -> dict[str, Any]:
        """One chain."""
        name = scenario.effects[0] if scenario.effects else ""
        reading = scenario.name if scenario.group == "fault" else ""
        row = one(self.asked, name, number + 10_000 * scenario.removed, scenario.removed, reading)
        return row | {"code": self.code, "scenario": scenario.name, "number": number}


def truth_of(hidden: str) -> str:
    """What a right answer names: the hidden effect, or the fault as calib calls it."""
    return f"offset of {FAULTS[hidden][0]}" if hidden in FAULTS else hidden


def bare(model: FunctionModel, space: ParameterSpace) -> tuple[FunctionModel, ParameterSpace]:
    """The same function of the fitted parameters alone, and their space."""
    held = {p.name: p.value for p in space.parameters if p.distribution == "fixed"}
    own = ParameterSpace(space.free)
    return replace(model, space=own, function=lambda values: model.function(held | dict(values))), own


def _outcome(verdict: str, untold: Sequence[str], hidden: str) -> str:
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
