"""Which parameter values fit, and how far they can be trusted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.errors import EvaluationError, InputError
from calib.ledger import Ledger
from calib.questions.compare import Answer, answer_at, compare, write_answer
from calib.questions.places import QUICK_GENERATIONS, QUICK_POPULATION, open_evaluator
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.study import Study
from calib.updating.cases import Case, CaseResult, agreement, convergence_table, parameters_table, run_case
from calib.updating.genetic import GeneticSettings
from calib.updating.objective import FrequencyMacObjective, ResponseObjective

Objective: TypeAlias = FrequencyMacObjective | ResponseObjective


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    cases : tuple of CaseResult
    best : CaseResult
        Of the lowest misfit.
    before, after : Answer
        At the adopted values and at the best case's.
    parameters : DataFrame
        ``parameters.csv``.
    agreement : str
        Whether the cases agree on one solution, in a sentence.
    """

    cases: tuple[CaseResult, ...]
    best: CaseResult
    before: Answer
    after: Answer
    parameters: pd.DataFrame
    agreement: str


def objective_of(study: Study) -> Objective:
    """What the search makes small."""
    settings = study.settings.calibration
    if isinstance(study.problem, FunctionProblem):
        return ResponseObjective({name: value for name, (value, _) in study.problem.targets.items()})
    measured = study.problem.measured
    return FrequencyMacObjective(
        modes=measured.names,
        natural_freq=dict(zip(measured.names, measured.natural_freq.tolist(), strict=True)),
        weight_freq=settings.weight_freq,
        weight_mac=settings.weight_mac,
        use_mac=measured.has_shapes,
    )


def genetic_settings(study: Study, quick: bool) -> GeneticSettings:
    """Settings of the genetic algorithm, smaller for a quick look."""
    given = study.settings.calibration
    return GeneticSettings(
        population=min(given.population, QUICK_POPULATION) if quick else given.population,
        generations=min(given.generations, QUICK_GENERATIONS) if quick else given.generations,
        crossover=given.crossover,
        mutation=given.mutation,
        sigma_start=given.sigma_start,
        sigma_end=given.sigma_end,
    )


def chosen_cases(study: Study, only: str | None) -> tuple[Case, ...]:
    """All cases of the study, or the one named; InputError for an unknown name."""
    cases = tuple(Case(c.name, c.seed) for c in study.settings.calibration.cases)
    if only is None:
        return cases
    for case in cases:
        if case.name == only:
            return (case,)
    raise InputError(
        f"there is no case {only!r}", place=study.file, remedy=f"the cases are {', '.join(c.name for c in cases)}"
    )


def calibrate(
    study: Study,
    results: Results,
    ledger: Ledger,
    workers: int | None = None,
    only: str | None = None,
    quick: bool = False,
    progress: Callable[[str, int, int, float], None] = lambda case, generation, generations, best: None,
) -> Calibration:
    """Search every case, compare before and after, write all tables and ``summary.json``."""
    started = time.perf_counter()
    settings, objective, space = genetic_settings(study, quick), objective_of(study), study.search_space
    cases = chosen_cases(study, only)
    before = compare(study, results)
    found = []
    with open_evaluator(study, workers, settings.population * settings.generations) as evaluator:
        for case in cases:
            initial = sample(space, settings.population, case.seed).points
            try:
                result = run_case(
                    case, space, objective, settings, evaluator, ledger, study.problem.fingerprint, initial,
                    progress=partial(progress, case.name),
                )  # fmt: skip
            except EvaluationError as fault:
                raise InputError(
                    str(fault), place=study.file, remedy="check the model over the search limits"
                ) from None
            found.append(result)
    best = min(found, key=lambda r: r.misfit)
    after = answer_at(study, best.values)
    parameters = parameters_table(found, space)
    verdict = agreement(found, space, expected_misfit(study, before))
    write_answer(results, after, "after")
    results.write_table("parameters", parameters)
    results.write_table("convergence", convergence_table(found))
    seconds = time.perf_counter() - started
    results.write_json("summary", _summary(study, found, best, before, after, seconds))
    return Calibration(tuple(found), best, before, after, parameters, verdict.sentence)


def expected_misfit(study: Study, answer: Answer) -> float:
    """Misfit that a perfect model would show on average from the measurement's scatter alone; 0 where unknown."""
    settings = study.settings.calibration
    if isinstance(study.problem, FunctionProblem):
        return float(sum((std or 0.0) / abs(value) for value, std in study.problem.targets.values()) * _MEAN_ABSOLUTE)
    measured = study.problem.measured
    relative = np.nan_to_num(measured.freq_std / measured.natural_freq)
    total = settings.weight_freq * _MEAN_ABSOLUTE * float(relative.sum())
    if measured.has_shapes and answer.comparison is not None:
        total += settings.weight_mac * float(np.nansum(1.0 - answer.comparison.noise_mac()))
    return total


_MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean absolute value of a standard normal variate."""


def _summary(
    study: Study,
    cases: Sequence[CaseResult],
    best: CaseResult,
    before: Answer,
    after: Answer,
    seconds: float,
) -> dict[str, object]:
    def figures(result: CaseResult, answer: Answer) -> dict[str, object]:
        return {
            "misfit": result.misfit,
            "mean_freq_error_before": before.mean_freq_error,
            "mean_freq_error_after": answer.mean_freq_error,
            "mean_mac_before": before.mean_mac,
            "mean_mac_after": answer.mean_mac,
            "evaluations": result.asked,
            "solved": result.solved,
            "reused": result.reused,
            "infeasible": result.infeasible,
            "failed": result.failed,
            "seconds": result.seconds,
        }

    counts = {
        key: sum(getattr(r, name) for r in cases)
        for key, name in (
            ("evaluations", "asked"),
            ("solved", "solved"),
            ("reused", "reused"),
            ("infeasible", "infeasible"),
            ("failed", "failed"),
        )
    }
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "best_case": best.name,
        "mean_freq_error_before": before.mean_freq_error,
        "mean_freq_error_after": after.mean_freq_error,
        "mean_mac_before": before.mean_mac,
        "mean_mac_after": after.mean_mac,
        "noise_mac": after.noise_mac,
        **counts,
        "seconds": seconds,
        "withheld_modes": list(study.settings.withheld.modes),
        "withheld_sensors": list(study.settings.withheld.sensors),
        "cases": {r.name: figures(r, after if r is best else answer_at(study, r.values)) for r in cases},
    }
