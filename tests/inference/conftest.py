"""A search over a scalar function in which points are solved, reused, infeasible and failed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import EvaluationError
from calib.execution.outcome import Outcome, attempt
from calib.inference.cases import Case, CaseResult, run_case, run_id
from calib.inference.genetic import GeneticSettings
from calib.inference.objective import ResponseObjective
from calib.problem.sampling import sample
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.results.ledger import Ledger

SPACE = ParameterSpace(
    (
        Parameter("k", 2.0, 1.0, 4.0, "kN/m"),
        Parameter("m", 0.5, 0.0, 1.0, "t"),
        Parameter("place", 2, 1, 3, integer=True),
        Parameter("g", 9.81, 9.0, 10.0, distribution="fixed"),
    ),
    (LinearConstraint("sum", (("k", 1.0), ("m", 2.0), ("g", 1.0)), 11.5, 14.0),),
)


def model(values: Mapping[str, float]) -> dict[str, float]:
    if 2.5 < values["k"] < 2.9:
        raise EvaluationError("no convergence")
    return {"a": values["k"] * values["place"] / 2, "b": 2.0 * values["m"] + 0.0 * values["g"]}


class Serial:
    """An evaluator in this process that records its requests."""

    isolated = False

    def __init__(self, function: Callable[[Mapping[str, float]], Mapping[str, float]] = model, pause: float = 0.0):
        self.function, self.pause, self.points, self.batches = function, pause, [], 0

    def evaluate(
        self, points: Sequence[Mapping[str, float]], arrived: Callable[[Outcome], None] = lambda outcome: None
    ) -> list[Outcome]:
        self.points += [dict(p) for p in points]
        self.batches += 1
        time.sleep(self.pause)
        outcomes = [attempt(self.function, p) for p in points]
        for outcome in outcomes:
            arrived(outcome)
        return outcomes


@dataclass(frozen=True)
class Search:
    """A search problem with its settings; every case starts from its own Latin hypercube."""

    space: ParameterSpace
    objective: ResponseObjective
    settings: GeneticSettings
    cases: tuple[Case, ...]
    model = staticmethod(model)
    evaluator = Serial

    def initial(self, case: Case) -> np.ndarray:
        return sample(self.space, self.settings.population, case.seed).points

    def run(self, case: Case, ledger: Ledger, evaluator: Any, **more: Any) -> CaseResult:
        start = more.pop("initial", self.initial(case))
        return run_case(case, self.space, self.objective, self.settings, evaluator, ledger, "f", start, **more)

    def run_id(self, case: Case, **changes: Any) -> str:
        given = {"space": self.space, "objective": self.objective, "settings": self.settings, "fingerprint": "f"}
        return run_id(case, initial=changes.pop("initial", self.initial(case)), **(given | changes))


@pytest.fixture(scope="session")
def search() -> Search:
    cases = (Case("C1", 1), Case("C2", 2))
    return Search(SPACE, ResponseObjective({"a": 3.0, "b": 1.0}), GeneticSettings(population=8, generations=9), cases)


@pytest.fixture(scope="session")
def assert_equal() -> Callable[[CaseResult, CaseResult], None]:
    """Fails when two results of a case differ in more than their times."""

    def equal(one: CaseResult, other: CaseResult) -> None:
        pd.testing.assert_frame_equal(one.convergence, other.convergence, check_exact=True)
        names = ("name", "values", "misfit", "responses", "asked", "solved", "reused", "infeasible", "failed")
        assert [getattr(one, n) for n in names] == [getattr(other, n) for n in names]

    return equal
