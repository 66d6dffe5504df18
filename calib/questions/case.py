"""How one case is found: by a search and least squares after it, or by least squares alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.errors import EvaluationError, InputError
from calib.ledger import Ledger
from calib.outcome import Outcome
from calib.questions.compare import Answer, answer_at, responses_at
from calib.questions.judge import FitProgress, Judgement, RecordedResidual, fitted, judged
from calib.questions.places import QUICK_GENERATIONS, QUICK_POPULATION, open_evaluator
from calib.questions.reduction import Reduction, reduction_of
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.study import Study
from calib.updating.cases import Case, CaseResult, run_case
from calib.updating.genetic import GeneticSettings
from calib.updating.objective import FrequencyMacObjective, ResponseObjective

Objective: TypeAlias = FrequencyMacObjective | ResponseObjective
SearchProgress = Callable[[str, int, int, float], None]

QUICK_STARTS = 2

REFITS, POLISH_REFITS = 25, 12
"""Combinations of whole numbers fitted from a start, and after a search: its own and their nearest neighbours."""


@dataclass(frozen=True, eq=False)
class CaseFound:
    """One case from its search to what is reported of it.

    Attributes
    ----------
    result : CaseResult
        Reported values, with the misfit of the objective there; counts and time of the whole case.
    search : CaseResult or None
        Where the genetic algorithm ended; None without one.
    search_full_order : float
        Misfit of the objective there at full order, whatever the search worked on; NaN without a search.
    judgement : Judgement
        What is known about the parameters at the reported values.
    answer : Answer
        Model against measurement there.
    """

    result: CaseResult
    search: CaseResult | None
    search_full_order: float
    judgement: Judgement
    answer: Answer

    @property
    def name(self) -> str:
        """Name of the case."""
        return self.result.name


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


@dataclass(frozen=True, eq=False)
class CaseFinder:
    """Finds one case after the other.

    Attributes
    ----------
    study : Study
    home : Results
        Where the reduced basis is kept.
    ledger : Ledger
    workers : int or None
        Worker processes of a search; None for one a core where that pays.
    quick : bool
        A smaller search for a first look.
    progress : SearchProgress
    """

    study: Study
    home: Results
    ledger: Ledger
    workers: int | None
    quick: bool
    progress: SearchProgress

    @property
    def exact(self) -> RecordedResidual:
        """The residual at full order."""
        return RecordedResidual(self.study.problem, self.ledger)

    @property
    def known(self) -> tuple[dict[str, float], ...]:
        """Where the study says that least squares begins too."""
        given = self.study.settings.calibration.begin_at
        return (self.study.search_space.complete(given),) if given else ()

    def by_search(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """Genetic algorithm, then least squares from its best point and from `known`, where the study wants them."""
        study, space = self.study, self.study.search_space
        settings, objective = genetic_settings(study, self.quick), objective_of(study)
        reduction = reduction_of(study, self.home)
        remaining = list(cases)
        while remaining:
            problem = study.problem if reduction is None else reduction.problem
            basis = None if reduction is None else reduction.path
            certify = _as_it_is if reduction is None else reduction.certifier(self.ledger)
            count = settings.population * settings.generations
            with open_evaluator(study, self.workers, count, problem, basis) as evaluator, _told(study):
                while remaining:
                    case = remaining.pop(0)
                    initial = sample(space, settings.population, case.seed).points
                    search = run_case(
                        case, space, objective, settings, evaluator, self.ledger, problem.fingerprint, initial,
                        progress=partial(self.progress, case.name), certify=certify,
                    )  # fmt: skip
                    if study.settings.calibration.polish:
                        judgement = self.polished(reduction, [search.values, *self.known], POLISH_REFITS)
                    else:
                        judgement = judged(study, self.exact, search.values)
                    yield _reported(study, objective, search, search, judgement)
                    before = reduction
                    reduction = None if reduction is None else reduction.after_case(search.values, self.home)
                    if reduction is not before:
                        break  # the next cases work on the next version of the basis

    def by_least_squares(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """Least squares from several starting points, the cases' own."""
        study, space = self.study, self.study.search_space
        reduction = reduction_of(study, self.home)
        given = study.settings.calibration.starts
        count = min(given, QUICK_STARTS) if self.quick else given
        for case in cases:
            started = time.perf_counter()
            starts = [*self.known, *(space.complete(x) for x in sample(space, count, case.seed).points)][:count]
            steps = _Steps(case.name, count, self.progress)
            with _told(study):
                judgement = self.polished(reduction, starts, REFITS, steps)
                self.progress(case.name, count, count, judgement.misfit)
            asked = len(steps.lowest)
            here = CaseResult(
                name=case.name, values=judgement.values, misfit=np.nan, responses={}, convergence=steps.table(),
                asked=asked, solved=asked, reused=0, infeasible=0, failed=0, seconds=time.perf_counter() - started,
            )  # fmt: skip
            yield _reported(study, objective_of(study), here, None, judgement)

    def polished(
        self,
        reduction: Reduction | None,
        starts: Sequence[dict[str, float]],
        refits: int,
        progress: FitProgress = lambda start, fits, misfit: None,
    ) -> Judgement:
        """Least squares from some points; first on a reduced basis where there is one, then at full order."""
        if reduction is None:
            return fitted(self.study, self.exact, starts, refits, progress)
        near = fitted(self.study, RecordedResidual(reduction.problem, self.ledger), starts, refits, progress)
        return fitted(self.study, self.exact, [near.values], 1, before=near)


def _as_it_is(outcome: Outcome) -> Outcome:
    return outcome


@dataclass(frozen=True)
class _Steps:
    """Writes down the lowest misfit after every fit of a case, and passes it on as progress."""

    name: str
    starts: int
    progress: SearchProgress
    lowest: list[float] = field(default_factory=list)

    def __call__(self, start: int, fits: int, misfit: float) -> None:
        self.lowest.append(misfit)
        self.progress(self.name, start, self.starts, misfit)

    def table(self) -> pd.DataFrame:
        """As the convergence of a search: fits instead of generations."""
        numbers = range(1, len(self.lowest) + 1)
        return pd.DataFrame({"generation": numbers, "best": self.lowest, "mean": np.nan, "feasible": 1})


@contextmanager
def _told(study: Study) -> Iterator[None]:
    """A case in which no point at all can be evaluated is the user's to mend."""
    try:
        yield
    except EvaluationError as fault:
        raise InputError(str(fault), place=study.file, remedy="check the model over the search limits") from None


def _reported(
    study: Study, objective: Objective, result: CaseResult, search: CaseResult | None, judgement: Judgement
) -> CaseFound:
    """The case at its final values, solved at full order whatever the search worked on."""
    answer = answer_at(study, judgement.values)
    responses = responses_at(study.problem, judgement.values)
    final = replace(result, values=judgement.values, misfit=objective(responses), responses=responses)
    full = float("nan") if search is None else objective(responses_at(study.problem, search.values))
    return CaseFound(final, search, full, judgement, answer)
