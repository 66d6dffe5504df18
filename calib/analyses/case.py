"""One case of a calibration: a genetic search refined by least squares, or least squares alone."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TypeAlias

import pandas as pd

from calib.analyses.case_starts import Starts, Steps, evaluable, known_starts, least_squares, until_agreed
from calib.analyses.compare import ComparisonResult, comparison_at
from calib.analyses.explained_fit import explained_fit
from calib.analyses.fit_statistics import (
    FitProgress,
    FitStatistics,
    Shared,
    Terms,
    criteria,
    ended,
    posed,
    refined,
    statistics_at,
)
from calib.analyses.provenance.places import QUICK_GENERATIONS, QUICK_POPULATION, Workers, open_evaluator, tasks_shared
from calib.analyses.provenance.stored import confirm
from calib.analyses.reduction import Reduction, reduction_of
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import EvaluationError, InputError, ToleranceError
from calib.execution.outcome import Outcome, answered, key_of
from calib.execution.stage import Progress, named, unheard
from calib.experiment import ForwardProblem
from calib.hypotheses.linear_start import linear_starts
from calib.inference.cases import Case, CaseResult, run_case
from calib.inference.genetic import GeneticSettings
from calib.inference.objective import FrequencyMacObjective, ResponseObjective
from calib.inference.rules import RULES
from calib.inference.starts import Enough, UntilAgreed, never
from calib.problem.problem import Counts, Pair, Problem
from calib.problem.sampling import sample
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import Study

Objective: TypeAlias = FrequencyMacObjective | ResponseObjective

SEARCH, FITTED = "search", "least squares"
"""Names of the points of a case."""

_SEARCHED = " A genetic search followed."
"""End of the sentence on starts that do not agree."""


@dataclass(frozen=True, eq=False)
class CaseFound:
    """Result of one case, from its search to the reported values.

    Attributes
    ----------
    result : CaseResult
        Reported values, with the misfit of the objective there; counts and time of the search, or of least squares
        where nothing was searched.
    search : CaseResult or None
        Where the genetic algorithm ended; None without one.
    statistics : FitStatistics
        Fit statistics at the reported values.
    answer : ComparisonResult
        Model against measurement there.
    points : DataFrame
        Both criteria at the ends of the search and of least squares, at full order: ``case, point, objective,
        sum_of_squares, prior, total``. The search minimises ``objective``, least squares minimise ``total``. One row
        for each of the two that ran.
    """

    result: CaseResult
    search: CaseResult | None
    statistics: FitStatistics
    answer: ComparisonResult
    points: pd.DataFrame

    @property
    def name(self) -> str:
        """Name of the case."""
        return self.result.name

    @property
    def search_full_order(self) -> float:
        """Misfit of the objective where the search ended, at full order whatever it worked on; NaN without a search."""
        own = self.points.loc[self.points["point"] == SEARCH, "objective"]
        return float(own.iloc[0]) if len(own) else math.nan

    @property
    def worsened(self) -> bool:
        """Whether least squares raised the misfit that the search minimised by more than one percent."""
        return self.result.misfit > 1.01 * self.search_full_order  # NaN without a search


def objective_of(study: Study) -> Objective:
    """Objective that the search minimises."""
    return objective_for(study.problem, study.settings.calibration.weight_freq, study.settings.calibration.weight_mac)


def objective_for(problem: ForwardProblem, weight_freq: float = 1.0, weight_mac: float = 1.0) -> Objective:
    """The same for a model against its measurement."""
    if not isinstance(problem, ModalProblem):
        return ResponseObjective(problem.search_targets)
    measured = problem.measured
    return FrequencyMacObjective(
        modes=measured.names,
        natural_freq=dict(zip(measured.names, measured.natural_freq.tolist(), strict=True)),
        weight_freq=weight_freq,
        weight_mac=weight_mac,
        use_mac=measured.has_shapes,
    )


def genetic_settings(study: Study, quick: bool) -> GeneticSettings:
    """Settings of the genetic algorithm, smaller for a quick run."""
    own = {one.name for one in fields(GeneticSettings)}
    given = GeneticSettings(**study.settings.calibration.model_dump(include=own))
    if not quick:
        return given
    population, generations = min(given.population, QUICK_POPULATION), min(given.generations, QUICK_GENERATIONS)
    return replace(given, population=population, generations=generations)


@dataclass(frozen=True, eq=False)
class CaseFinder:
    """Runs one case after the other.

    Attributes
    ----------
    study : Study
    home : Results
        Where the reduced basis is kept.
    ledger : Ledger
    workers : int, Injected or None
        Who evaluates a search; see `calib.analyses.provenance.places.Workers`.
    quick : bool
        A smaller search for a quick run.
    progress : Progress
    seconds : float or None
        Duration of one evaluation of the study's problem (s), where known.
    notes : list of str
        Where a search deviated from the study's settings, and how many starts agreed.
    """

    study: Study
    home: Results
    ledger: Ledger
    workers: Workers
    quick: bool
    progress: Progress
    seconds: float | None = None
    notes: list[str] = field(init=False, repr=False, default_factory=list)
    _shared: dict[str, Shared] = field(init=False, repr=False, default_factory=dict)

    @property
    def exact(self) -> Problem[Pair]:
        """The problem that is fitted, at full order."""
        return posed(self.study, self.ledger)

    @cached_property
    def known(self) -> tuple[dict[str, float], ...]:
        """Further starting points: linear ones, those of the study, the fit of the same model by an explanation."""
        linear = linear_starts(self.exact, self.study.search_space.values)
        return (*linear, *known_starts(self.study, explained_fit(self.study, self.home)))

    def _reduction(self) -> Reduction | None:
        with tasks_shared(self.workers):
            return reduction_noted(self.study, self.home, self.notes, self.progress)

    def by_agreement(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """Least squares from sampled points until the starts agree; where they do not, a genetic search from there too.

        The search goes first where the study states the weights of its objective, or forbids least squares after it.
        """
        given = self.study.settings.calibration
        if not given.refine or {"weight_freq", "weight_mac"} & given.model_fields_set:
            yield from self.by_search(cases)
            return
        reduction = self._reduction()
        for case in cases:
            until, found = UntilAgreed(len(self.known) + 1), None
            fit = partial(self.refined, reduction, told=named(self.progress, case.name), enough=until)
            with suppress(EvaluationError):  # the search copes with points that fail
                found = reported(self.study, *until_agreed(case, self.study, self.known, self.quick, fit))
            self.notes.append(f"{case.name}: {until.optima.sentence}.{_SEARCHED * (not until.agree)}")
            if found is not None and until.agree:
                yield found
            else:
                yield from self.by_search([case], () if found is None else [found.result.values])

    def by_search(self, cases: Sequence[Case], also: Starts = ()) -> Iterator[CaseFound]:
        """Genetic search, refined where requested by least squares from its best point, `known` and the nominal values.

        Fits from starting points that all cases share are run once. ``also`` are further starts. The solution of the
        search is reported unless the data prefer the one from the nominal values: solutions that only the priors
        distinguish remain several.
        """
        study, space = self.study, self.study.search_space
        settings, objective = genetic_settings(study, self.quick), objective_of(study)
        reduction = self._reduction()
        remaining = list(cases)
        while remaining:
            problem = study.problem if reduction is None else reduction.problem
            basis = None if reduction is None else reduction.path
            certify = _as_it_is if reduction is None else reduction.certifier(self.ledger)
            count = settings.population * settings.generations
            seconds = self.seconds if reduction is None else None
            with open_evaluator(study, self.workers, count, problem, basis, seconds) as evaluator, evaluable(study):
                while remaining:
                    case = remaining.pop(0)
                    told = named(self.progress, case.name)
                    initial = sample(space, settings.population, case.seed).points
                    search = run_case(
                        case, space, objective, settings, evaluator, self.ledger, problem.fingerprint, initial,
                        progress=partial(told, "genetic search"), certify=certify,
                    )  # fmt: skip
                    if study.settings.calibration.refine:
                        statistics = self.refined(
                            reduction, [search.values, *also], RULES.refits_after_search, shared=True, told=told
                        )
                    else:
                        statistics = statistics_at(self.exact, Terms.of(study), search.values)
                    told("checking at full order")
                    yield self._searched(objective, search, statistics)
                    before = reduction
                    reduction = None if reduction is None else reduction.after_case(search.values, self.home)
                    if reduction is not before:
                        break  # the next cases work on the next version of the basis

    def by_least_squares(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """Least squares from several starting points of each case."""
        reduction = self._reduction()
        for case in cases:
            fit = partial(self.refined, reduction, told=named(self.progress, case.name))
            yield reported(self.study, *least_squares(case, self.study, self.known, self.quick, fit))

    def by_equations(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """The solution of the linear cross-model equations of FRFs, not refined, as the first case.

        Raises
        ------
        InputError
            Where they cannot be posed.
        """
        started, study = time.perf_counter(), self.study
        found = linear_starts(self.exact, study.search_space.values)
        if not found:
            raise InputError(
                "the cross-model equations cannot be posed",
                place=study.place("calibration", "method"),
                remedy="measure FRFs with a response at the place of every force, or choose another method",
            )
        statistics, steps = statistics_at(self.exact, Terms.of(study), found[0]), Steps()
        steps(1, 1, sum(criteria(self.exact, found[0])))
        seconds = time.perf_counter() - started
        result = CaseResult.fitted(cases[0].name, statistics.values, self.exact.counts, steps.table(), seconds)
        yield reported(study, result, statistics)

    def refined(
        self,
        reduction: Reduction | None,
        starts: Starts,
        refits: int,
        progress: FitProgress = lambda start, fits, misfit: None,
        counts: Counts | None = None,
        shared: bool = False,
        told: Progress = unheard,
        enough: Enough = never,
    ) -> FitStatistics:
        """See `calib.analyses.fit_statistics.refined`.

        ``shared`` adds the starting points that all cases share. ``counts`` counts every requested point. ``enough``
        tells after every start whether the others may be left out.
        """
        study, counts = self.study, counts or Counts()
        exact = posed(study, self.ledger, counts=counts)
        near = None if reduction is None else posed(study, self.ledger, reduction.problem, counts)
        common = self._in_common(exact if near is None else near, refits, told) if shared else None
        return refined(exact, near, Terms.of(study), starts, refits, progress, self.known, common, told, enough)

    def _in_common(self, problem: Problem[Pair], refits: int, told: Progress) -> Shared:
        """Fits from the starting points that all cases share, run once per basis."""
        key = problem.pair.problem.fingerprint
        if key not in self._shared:
            nominal = ended(problem, [self.study.search_space.values], refits, told)
            self._shared[key] = Shared(nominal, known=ended(problem, self.known, refits, told))
        return self._shared[key]

    def _searched(self, objective: Objective, search: CaseResult, statistics: FitStatistics) -> CaseFound:
        """A case that a search began, with both criteria at its end, at full order."""
        problem = self.study.problem
        if problem.user_function is not None:
            key = key_of(search.values)
            confirm(self.study, self.ledger, self.ledger.lookup(problem.ledger_key, [key])[key])
        known = self.exact.pair.told_by_responses
        full = objective(search.responses if known else answered(problem.evaluate, search.values))
        return reported(self.study, search, statistics, search, (full, *criteria(self.exact, search.values)))


def reported(
    study: Study,
    result: CaseResult,
    statistics: FitStatistics,
    search: CaseResult | None = None,
    before: tuple[float, float, float] = (math.nan, math.nan, math.nan),
) -> CaseFound:
    """The case at its final values for one test, solved at full order even if the search was reduced.

    ``before`` holds the objective and the sums of squares of data and priors at the end of a search.
    """
    values = {name: value for name, value in statistics.values.items() if name in study.problem.space}
    responses = answered(study.problem.evaluate, values)
    final = replace(result, values=statistics.values, misfit=objective_of(study)(responses), responses=responses)
    points = [] if search is None else [(final.name, SEARCH, *before)]
    if statistics.fit is not None:
        points.append((final.name, FITTED, final.misfit, statistics.misfit, statistics.prior_misfit))
    table = pd.DataFrame(points, columns=["case", "point", "objective", "sum_of_squares", "prior"])
    table["total"] = table["sum_of_squares"] + table["prior"]
    return CaseFound(final, search, statistics, comparison_at(study, values), table)


def reduction_noted(study: Study, home: Results, notes: list[str], progress: Progress = unheard) -> Reduction | None:
    """The reduced basis of a study's search; None where it misses its tolerance, which is added to the notes."""
    try:
        return reduction_of(study, home, progress)
    except ToleranceError as fault:
        words = f"Searched at full order: {fault.problem}."
        notes.extend([] if words in notes else [words])
        return None


def _as_it_is(outcome: Outcome) -> Outcome:
    return outcome
