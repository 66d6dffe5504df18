"""Independent runs (cases) of the genetic search, and their tables."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, raised_anew
from calib.execution.evaluate import BatchEvaluator, Recorder
from calib.execution.outcome import Individual, Outcome, failure, point_key
from calib.inference.objective import Objective
from calib.inference.rules import RULES
from calib.problem.problem import Counts
from calib.problem.space import ParameterSpace

if TYPE_CHECKING:
    from calib.inference.genetic import GeneticSettings

FAILED = 1e12
"""Violation of a point that could not be evaluated: behind every point that merely breaks a constraint."""


@dataclass(frozen=True)
class Case:
    """One run of the search, identified by its seed."""

    name: str
    seed: int


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Result of one case.

    Attributes
    ----------
    name : str
    values : dict
        All parameters at the best point, each in its own unit.
    misfit : float
    responses : dict
        At the best point.
    convergence : DataFrame
        ``generation``, ``best`` (misfit so far), ``mean`` (over the generation) and ``feasible`` (number of individuals
        that kept the constraints and could be evaluated; the mean is over them); NaN where undefined.
    asked, solved, reused, infeasible, failed : int
        Individuals of a search, the same after an interruption; for least squares the points requested in this call,
        those of derivatives included. ``asked`` is the sum of the others.
    seconds : float
        Duration of this call.
    run : str
        Name of the search in the history; empty for least squares alone.
    """

    name: str
    values: dict[str, float]
    misfit: float
    responses: dict[str, float]
    convergence: pd.DataFrame
    asked: int
    solved: int
    reused: int
    infeasible: int
    failed: int
    seconds: float
    run: str = ""

    @classmethod
    def fitted(
        cls, name: str, values: dict[str, float], counts: Counts, convergence: pd.DataFrame, seconds: float
    ) -> CaseResult:
        """Where least squares ended, without misfit and responses of an objective."""
        return cls(
            name=name, values=values, misfit=math.nan, responses={}, convergence=convergence, asked=counts.asked,
            solved=counts.solved, reused=counts.reused, infeasible=0, failed=counts.failed, seconds=seconds,
        )  # fmt: skip


def run_id(
    case: Case,
    space: ParameterSpace,
    objective: Objective,
    settings: GeneticSettings,
    fingerprint: str,
    initial: np.ndarray,
) -> str:
    """Name of a run in the history: case, seed, and a hash over everything else that determines it."""
    numbers = [(p.name, p.value, p.lower, p.upper, p.distribution, p.integer) for p in space.parameters]
    digest = hashlib.sha256(repr((numbers, space.constraints, objective.identity, settings, fingerprint)).encode())
    digest.update(np.ascontiguousarray(initial, dtype=float).tobytes())
    return f"{case.name}:{case.seed}:{digest.hexdigest()[:16]}"


def run_case(
    case: Case,
    space: ParameterSpace,
    objective: Objective,
    settings: GeneticSettings,
    evaluator: BatchEvaluator,
    ledger: Recorder,
    fingerprint: str,
    initial: np.ndarray,
    progress: Callable[[float, int, float], None] = lambda generation, generations, best: None,
    certify: Callable[[Outcome], Outcome] = lambda outcome: outcome,
) -> CaseResult:
    """Run one case. After an interruption it resumes from the ledger and ends with the same result.

    Individuals that break a limit or constraint are never evaluated. All others of a generation are looked up in the
    ledger, the new ones evaluated as one batch and added before the generation is recorded.

    Parameters
    ----------
    case : Case
    space : ParameterSpace
        Its free parameters are searched.
    objective : Objective
    settings : GeneticSettings
    evaluator : BatchEvaluator
    ledger : Recorder
    fingerprint : str
        Of model and measurement.
    initial : ndarray (population, n_free)
        Initial population.
    progress : callable
        Called with generation, number of generations and best misfit so far (infinite before there is one); within a
        generation with a fraction of it.
    certify : callable
        Called for every individual that would become the best one. Returns the outcome, or a more accurate one of the
        same point (of a full-order model, say) to replace it. The result must depend on the outcome alone.

    Raises
    ------
    EvaluationError
        When no individual could be evaluated; with the last error.
    InputError
        From ledger, evaluator or objective.
    """
    from calib.inference.genetic import GeneticSearch

    started = time.perf_counter()
    run = run_id(case, space, objective, settings, fingerprint, initial)
    search = GeneticSearch(space, settings, initial, case.seed)
    best: Outcome | None = None
    best_misfit = math.inf
    certified: dict[str, Outcome] = {}
    last_fault, evaluated = EvaluationError("every individual broke a limit or constraint"), 0
    convergence = []
    while not search.done:
        generation = search.generation
        points = search.ask()
        violation = scaled_violation(space, points)
        values = [space.complete(x) for x in points]
        feasible = np.flatnonzero(violation == 0)
        told = partial(_within, progress, generation, settings.generations, best_misfit, len(feasible))
        outcomes = ledger.evaluate(fingerprint, [values[k] for k in feasible], evaluator, told)
        misfit = np.full(len(points), np.nan)
        keys = [point_key(v) for v in values]
        known = {k: certified.get(keys[k], o) for k, o in zip(feasible.tolist(), outcomes, strict=True)}
        for k, outcome in known.items():
            misfit[k] = _misfit(objective, outcome)
        while np.any(misfit < best_misfit):
            k = int(np.nanargmin(misfit))
            if keys[k] in certified:
                best, best_misfit = known[k], float(misfit[k])
            else:
                certified[keys[k]] = known[k] = certify(known[k])
                misfit[k] = _misfit(objective, known[k])
        for k, outcome in known.items():
            if math.isnan(misfit[k]):
                violation[k] = FAILED
                last_fault = failure(outcome) if outcome.error else EvaluationError("the misfit is not finite")
        individuals = []
        for k in range(len(points)):
            broken: Literal["failed", "infeasible"] = "failed" if violation[k] == FAILED else "infeasible"
            individuals.append(Individual(keys[k], "ok" if violation[k] == 0 else broken, float(misfit[k])))
        ledger.record(run, fingerprint, generation, individuals)
        evaluated += len(feasible)
        if best is None and evaluated >= settings.population:
            break  # a whole population failed: the model is broken, further generations would only cost time
        search.tell(misfit, violation)
        good = misfit[violation == 0]
        mean = float(good.mean()) if len(good) else math.nan
        convergence.append((generation, best_misfit if best is not None else math.nan, mean, len(good)))
        progress(generation, settings.generations, best_misfit)
    if best is None:
        raise raised_anew(last_fault, f"case {case.name}: no individual could be evaluated ({last_fault})")
    status = ledger.history(run)["status"].value_counts()
    return CaseResult(
        name=case.name,
        values=best.values,
        misfit=best_misfit,
        responses=best.responses,
        convergence=pd.DataFrame(convergence, columns=["generation", "best", "mean", "feasible"]),
        asked=int(status.sum()),
        solved=int(status.get("solved", 0)),
        reused=int(status.get("reused", 0)),
        infeasible=int(status.get("infeasible", 0)),
        failed=int(status.get("failed", 0)),
        seconds=time.perf_counter() - started,
        run=run,
    )


def _within(
    progress: Callable[[float, int, float], None], generation: int, generations: int, best: float, size: int, done: int
) -> None:
    """Tell how far a generation is; its end is told when its best individual is known."""
    if done < size:
        progress(generation - 1 + done / size, generations, best)


def _misfit(objective: Objective, outcome: Outcome) -> float:
    """Misfit of an outcome, NaN where there is none."""
    number = objective(outcome.responses) if outcome.status == "ok" else math.nan
    return number if math.isfinite(number) else math.nan


def scaled_violation(space: ParameterSpace, points: np.ndarray) -> np.ndarray:
    """Constraint violation of points, comparable between constraints of different units.

    Parameters
    ----------
    points : ndarray (n, n_free)

    Returns
    -------
    ndarray (n,)
        Sum of the violations, each over the span that its weighted sum has between the parameters' limits; exactly 0
        for a feasible point and positive for every other.
    """
    reach = dict(zip(space.free_names, (space.upper - space.lower).tolist(), strict=True))
    spans = [sum(abs(c) * reach.get(name, 0.0) for name, c in con.coefficients) or 1.0 for con in space.constraints]
    total = (space.violation(points) / np.array(spans)).sum(axis=1) if spans else np.zeros(len(points))
    return np.where(space.feasible(points), 0.0, np.maximum(total, np.finfo(float).tiny))


# -- tables ------------------------------------------------------------------------------------------------------------


def ratios(results: Sequence[CaseResult], space: ParameterSpace) -> np.ndarray:
    """Position between the limits, 0 to 1, shape (n_cases, n_free)."""
    values = np.array([[r.values[name] for name in space.free_names] for r in results]).reshape(len(results), -1)
    return space.position(values)


def parameters_table(results: Sequence[CaseResult], space: ParameterSpace) -> pd.DataFrame:
    """Best value of every free parameter at the end of every search.

    Returns
    -------
    DataFrame
        ``case, parameter, value, unit, lower, upper, scale``; ``ratio`` (position between the limits, 0 to 1);
        ``on_limit`` (see `calib.problem.parameter.limit_at`); ``spread`` (largest minus smallest ratio over the cases)
        and ``stable`` (spread of at most 0.10; Ribeiro et al. 2013). Both are missing when there is one case only.
    """
    position = ratios(results, space)
    spread = np.ptp(position, axis=0) if len(results) > 1 else np.full(len(space.free), np.nan)
    rows = []
    for result, row in zip(results, position.tolist(), strict=True):
        for parameter, ratio, width in zip(space.free, row, spread.tolist(), strict=True):
            rows.append(
                {
                    "case": result.name,
                    "parameter": parameter.name,
                    "value": result.values[parameter.name],
                    "unit": parameter.unit,
                    "lower": parameter.lower,
                    "upper": parameter.upper,
                    "scale": parameter.scale,
                    "ratio": ratio,
                    "on_limit": parameter.limit_at(result.values[parameter.name], searched=True) is not None,
                    "spread": width,
                    "stable": None if math.isnan(width) else width <= RULES.stable,
                }
            )
    columns = ["case", "parameter", "value", "unit", "lower", "upper", "scale", "ratio", "on_limit", "spread", "stable"]
    return pd.DataFrame(rows, columns=columns)


def convergence_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """Misfit over the generations of every case: ``case, generation, best, mean, feasible``."""
    columns = ["case", "generation", "best", "mean", "feasible"]
    tables = [r.convergence.assign(case=r.name)[columns] for r in results]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns)
