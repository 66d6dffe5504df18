"""One case of a calibration: what a genetic search and least squares found for every test of a study."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeAlias

from calib.analyses.case_found import CaseFound, reported
from calib.analyses.case_starts import (
    Starts,
    Steps,
    evaluable,
    from_further_starts,
    initial_population,
    known_starts,
    least_squares,
    until_agreed,
)
from calib.analyses.explained_fit import explained_fit
from calib.analyses.fit_statistics import (
    FitProblem,
    FitStatistics,
    Near,
    ObjectiveTerms,
    fit_problem,
    mesh_doubt,
    statistics_at,
)
from calib.analyses.joint_responses import Responses, own_values
from calib.analyses.least_squares import FitProgress, Shared, criteria, ended, fitted_at_full_order
from calib.analyses.provenance.places import QUICK_GENERATIONS, QUICK_POPULATION, Workers, open_evaluator, tasks_shared
from calib.analyses.provenance.stored import confirm
from calib.analyses.reduction import Reduction, reduction_near, reduction_noted
from calib.correlation.modal.problem import ModalProblem
from calib.errors.errors import EvaluationError, InputError
from calib.execution.evaluate import BatchEvaluator
from calib.execution.outcome import Outcome, named_responses, point_key
from calib.execution.stage import Progress, silent, with_prefix
from calib.experiment.test import ForwardProblem
from calib.hypotheses.linear_start import estimate_by_equations, linear_starts
from calib.inference.cases import Case, CaseResult, run_case
from calib.inference.integers import combinations
from calib.inference.linear_estimate import LinearEstimate
from calib.inference.objective import Objective
from calib.inference.rules import RULES
from calib.inference.starts import Enough, UntilAgreed, never
from calib.problem.joint import JointProblem
from calib.problem.problem import Counts
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

if TYPE_CHECKING:
    from calib.inference.genetic import GeneticSettings

Homes: TypeAlias = Mapping[str, Results]
"""Folders that keep the reduced bases of the tests, by name of the test; those of a study in memory have none."""

_SEARCHED = " A genetic search followed."
"""End of the sentence on starts that do not agree."""


def objective_of(study: AnyStudy) -> Objective:
    """Objective that a search minimises: that of the only test, or the sum over all."""
    return Responses.of(study).objective(study.settings.calibration)


def genetic_settings(study: AnyStudy, quick: bool) -> GeneticSettings:
    """Settings of the genetic algorithm, smaller for a quick run."""
    from calib.inference.genetic import GeneticSettings

    own = {one.name for one in fields(GeneticSettings)}
    given = GeneticSettings(**study.settings.calibration.model_dump(include=own))
    if not quick:
        return given
    population, generations = min(given.population, QUICK_POPULATION), min(given.generations, QUICK_GENERATIONS)
    return replace(given, population=population, generations=generations)


@dataclass(frozen=True, eq=False)
class CaseFinder:
    """Runs one case after the other; each gives one result a test.

    Attributes
    ----------
    study : Study or JointStudy
        Its functions behind the ledger.
    ledger : Ledger
    homes : mapping from str to Results
        Where the reduced basis of each test is kept.
    workers : int, Injected or None
        Who evaluates a search; see `calib.analyses.provenance.places.Workers`.
    quick : bool
        A smaller search for a quick run.
    progress : Progress
    seconds : float or None
        Duration of one evaluation of the only test (s), where known.
    reduction_notes : mapping from str to list of str
        Where a search deviated from the study's settings, by name of the test.
    agreeing : list of str
        How many starts of each case agreed.
    """

    study: AnyStudy
    ledger: Ledger
    homes: Homes = field(default_factory=dict)
    workers: Workers = None
    quick: bool = False
    progress: Progress = silent
    seconds: float | None = None
    reduction_notes: dict[str, list[str]] = field(init=False, repr=False, default_factory=dict)
    agreeing: list[str] = field(init=False, repr=False, default_factory=list)
    _shared: dict[str, Shared] = field(init=False, repr=False, default_factory=dict)

    def found(self, method: str, cases: Sequence[Case]) -> Iterator[tuple[CaseFound, ...]]:
        """The cases by one method: ``auto``, ``genetic``, ``gauss-newton`` or ``cmcf``."""
        by = {
            "auto": self.by_agreement, "genetic": self.by_search, "gauss-newton": self.by_least_squares,
            "cmcf": self.by_equations if self._only else self.by_least_squares,
        }  # fmt: skip
        yield from by[method](cases)

    @property
    def _only(self) -> LoadedStudy | None:
        """The only test; None for several."""
        return self.study.studies[0] if len(self.study.studies) == 1 else None

    @property
    def _has_many_minima(self) -> bool:
        return any(one.experiment.many_minima for one in self.study.studies)

    @property
    def exact(self) -> FitProblem:
        """The problem that is fitted, at full order."""
        return fit_problem(self.study, self.ledger)

    @cached_property
    def _terms(self) -> ObjectiveTerms:
        """Of all cases: a finer mesh is built once."""
        return ObjectiveTerms.of(self.study)

    @cached_property
    def known(self) -> tuple[dict[str, float], ...]:
        """Further starting points: linear ones, those of the study, the fit of the same model by an explanation."""
        linear = linear_starts(self.exact, self.study.search_space.values)
        home = self.homes.get(self.study.test)
        explained = [] if self._only is None or home is None else [explained_fit(self.study, home)]
        return (*linear, *known_starts(self.study, self.ledger, *explained))

    def reductions(self, followed: bool = False) -> dict[str, Reduction]:
        """The reduced bases of the tests whose models are large, by name of the test.

        Where least squares are ``followed``, those of modes grow where they lead.
        """
        out = {}
        with tasks_shared(self.workers):
            for one in self.study.studies:
                if followed and isinstance(one.problem, ModalProblem):
                    found = reduction_near(one)
                else:
                    notes = self.reduction_notes.setdefault(one.test, [])
                    found = reduction_noted(one, self.homes.get(one.test), notes, self.progress)
                if found is not None:
                    out[one.test] = found
        return out

    def by_agreement(self, cases: Sequence[Case]) -> Iterator[tuple[CaseFound, ...]]:
        """Least squares from sampled points until the starts agree; where they do not, a genetic search from there too.

        The search goes first where the study states the weights of its objective, or forbids least squares after it,
        and where integer parameters have more combinations than a start may fit: each start would end wherever its
        fits are used up. Several tests are searched for their integers only; else least squares alone report their
        best fit.
        """
        given, only = self.study.settings.calibration, self._only
        stated = only and (not given.refine or {"weight_freq", "weight_mac"} & given.model_fields_set)
        if stated or combinations(self.study.search_space) > RULES.refits:
            yield from self.by_search(cases)
            return
        reductions = self.reductions(followed=True)
        for case in cases:
            until, found = UntilAgreed(len(self.known) + 1), None
            fit = partial(self.refined, reductions, told=with_prefix(self.progress, case.name), enough=until)
            copes = suppress(EvaluationError) if only else evaluable(self.study)  # a search copes with failed points
            with copes:
                found = self.reported(*until_agreed(case, self.study, self.known, self.quick, fit))
            searched = only is not None and not until.agree
            self.agreeing.append(f"{case.name}: {until.optima.sentence}.{_SEARCHED * searched}")
            if found is not None and not searched:
                yield found
            else:
                yield from self.by_search([case], () if found is None else [found[0].result.values])

    def by_search(self, cases: Sequence[Case], also: Starts = ()) -> Iterator[tuple[CaseFound, ...]]:
        """Genetic search, refined where requested by least squares from its best point, `known` and the nominal values.

        Fits from starting points that all cases share are run once. ``also`` are further starts. The solution of the
        search is reported unless the data prefer the one from the nominal values: solutions that only the priors
        distinguish remain several.
        """
        study, space = self.study, self.study.search_space
        settings, objective = genetic_settings(study, self.quick), objective_of(study)
        reductions = self.reductions()
        remaining = list(cases)
        while remaining:
            responses = Responses.of(study, {test: one.problem for test, one in reductions.items()})
            count = settings.population * settings.generations
            with self.evaluator(responses, reductions, count) as evaluator, evaluable(study):
                while remaining:
                    case = remaining.pop(0)
                    told = with_prefix(self.progress, case.name)
                    initial = initial_population(study, self.ledger, settings.population, case.seed)
                    search = run_case(
                        case, space, objective, settings, evaluator, self.ledger, responses.fingerprint, initial,
                        progress=partial(told, "genetic search"), certify=self._certifier(reductions),
                    )  # fmt: skip
                    if study.settings.calibration.refine:
                        statistics = self.refined(
                            reductions, [search.values, *also], RULES.refits_after_search, shared=True, told=told
                        )
                    else:
                        statistics = self.statistics_at(search.values)
                    told("checking at full order")
                    yield self._searched(objective, search, statistics)
                    before = reductions
                    reductions = self._after_case(reductions, search.values)
                    if reductions is not before:
                        break  # the next cases work on the next version of the basis

    def evaluator(
        self, responses: Responses, reductions: Mapping[str, Reduction], count: int
    ) -> AbstractContextManager[BatchEvaluator]:
        """Evaluator of a search: of one test in worker processes where that pays, of several in this one."""
        if self._only is None:
            return responses.evaluator(self.study, self.workers)
        reduction = reductions.get(self._only.test)
        problem = self._only.problem if reduction is None else reduction.problem
        basis, seconds = (None, self.seconds) if reduction is None else (reduction.path, None)
        return open_evaluator(self._only, self.workers, count, problem, basis, seconds)

    def statistics_at(self, values: Mapping[str, float], estimate: LinearEstimate | None = None) -> FitStatistics:
        """The fit statistics at given values, without a fit; of a linear ``estimate`` where they come from one."""
        near = near_of(self.study, self.reductions()) if self.study.held_sd else None
        return statistics_at(self.exact, self._terms, values, near, estimate)

    def mesh_doubt(self, found: FitStatistics) -> str:
        """See `calib.analyses.fit_statistics.mesh_doubt`; empty for a quick run."""
        return "" if self.quick else mesh_doubt(self.exact, self._terms, found)

    def _certifier(self, reductions: Mapping[str, Reduction]) -> Any:
        """Callback that checks every would-be best point of one test; several are checked where a case ended."""
        reduction = reductions.get(self._only.test) if self._only else None
        return _as_it_is if reduction is None else reduction.certifier(self.ledger)

    def _after_case(self, reductions: dict[str, Reduction], values: Mapping[str, float]) -> dict[str, Reduction]:
        """The same reductions, or those whose bases missed their tolerance at the end of a case enriched."""
        new = {}
        for one in self.study.studies:
            if one.test in reductions:
                own = values if self._only else own_values(one, values)
                new[one.test] = reductions[one.test].after_case(own, self.homes.get(one.test))
        return reductions if all(new[test] is reductions[test] for test in new) else new

    def by_least_squares(self, cases: Sequence[Case]) -> Iterator[tuple[CaseFound, ...]]:
        """Least squares from several starting points of each case."""
        reductions = self.reductions(followed=True)
        for case in cases:
            fit = partial(self.refined, reductions, told=with_prefix(self.progress, case.name))
            found = least_squares(case, self.study, self.known, self.quick, fit)
            if found[1].fits is False and not self.quick and self._has_many_minima:
                found, note = from_further_starts(case, self.study, *found, fit)
                self.agreeing.extend([note] if note else [])
            yield self.reported(*found)

    def by_equations(self, cases: Sequence[Case]) -> Iterator[tuple[CaseFound, ...]]:
        """The solution of the linear cross-model equations of FRFs, not refined, as the first case.

        Raises
        ------
        InputError
            Where they cannot be posed.
        """
        started, study, exact = time.perf_counter(), self.study, self.exact
        found = estimate_by_equations(exact, study.search_space.values)
        if found is None:
            raise InputError(
                "the cross-model equations cannot be posed, or have no solution",
                place=study.place("calibration", "method"),
                remedy="measure FRFs with a response at the place of every force, or choose another method",
            )
        statistics, steps = self.statistics_at(found.values, found), Steps()
        steps(1, 1, sum(criteria(self.exact, found.values)))
        seconds = time.perf_counter() - started
        result = CaseResult.fitted(cases[0].name, statistics.values, self.exact.counts, steps.table(), seconds)
        yield self.reported(result, statistics)

    def refined(
        self,
        reductions: Mapping[str, Reduction],
        starts: Starts,
        refits: int,
        progress: FitProgress = lambda start, fits, misfit: None,
        counts: Counts | None = None,
        shared: bool = False,
        told: Progress = silent,
        enough: Enough = never,
    ) -> FitStatistics:
        """See `calib.analyses.least_squares.fitted_at_full_order`.

        ``shared`` adds the starting points that all cases share. ``counts`` counts every requested point. ``enough``
        tells after every start whether the others may be left out.
        """
        study, counts = self.study, counts or Counts()
        exact, grown = fit_problem(study, self.ledger, counts=counts), dict(reductions)

        def on_basis() -> FitProblem:
            reduced: dict[str, ForwardProblem] = {test: one.problem for test, one in grown.items()}
            kept = study.in_memory or all(one.path for one in grown.values())  # else nobody could name its points
            return fit_problem(study, self.ledger if kept else None, reduced, counts)

        def widened(points: Starts) -> FitProblem | None:
            before = dict(grown)
            for one in study.studies:
                if one.test in grown:
                    grown[one.test] = grown[one.test].covering(_own(one, study, points))
            return None if all(grown[test] is before[test] for test in grown) else on_basis()

        reduced = on_basis() if reductions else None
        common = self._in_common(exact if reduced is None else reduced, refits, told) if shared else None
        return fitted_at_full_order(
            exact, reduced, self._terms, starts, refits, progress, self.known, common, told, enough,
            lambda: near_of(study, grown), widened,
        )  # fmt: skip

    def _in_common(self, problem: FitProblem, refits: int, told: Progress) -> Shared:
        """Fits from the starting points that all cases share, run once per basis."""
        parts = problem.parts.values() if isinstance(problem, JointProblem) else (problem,)
        key = " ".join(part.pair.problem.fingerprint for part in parts)
        if key not in self._shared:
            nominal = ended(problem, [self.study.search_space.values], refits, told)
            self._shared[key] = Shared(nominal, known=ended(problem, self.known, refits, told))
        return self._shared[key]

    def _searched(self, objective: Objective, search: CaseResult, statistics: FitStatistics) -> tuple[CaseFound, ...]:
        """A case that a search began, with both criteria at its end, at full order."""
        if (only := self._only) is None:
            full = objective(named_responses(Responses.of(self.study).at, search.values))
            return self.reported(search, statistics, search, (full, *criteria(self.exact, search.values)))
        problem, exact = only.problem, self.exact
        if problem.user_function is not None and not only.in_memory:
            key = point_key(search.values)
            confirm(only, self.ledger, self.ledger.lookup(problem.ledger_key, [key])[key])
        known = not isinstance(exact, JointProblem) and exact.pair.told_by_responses
        there = search.responses if known else named_responses(problem.evaluate, search.values)
        return self.reported(search, statistics, search, (objective(there), *criteria(exact, search.values)), there)

    def reported(
        self,
        result: CaseResult,
        statistics: FitStatistics,
        search: CaseResult | None = None,
        before: tuple[float, float, float] = (math.nan, math.nan, math.nan),
        at_search: Mapping[str, float] | None = None,
    ) -> tuple[CaseFound, ...]:
        """A case at its final values, for every test; see `reported`."""
        return tuple(reported(one, result, statistics, search, before, at_search) for one in self.study.studies)


def near_of(study: AnyStudy, reductions: Mapping[str, Reduction]) -> Near | None:
    """The study on its reduced bases, by name of the test, for changes by held parameters; None where it has none.

    A basis is trained over the parameters of the search, and enriched in memory where others leave what it represents.
    """
    if not reductions:
        return None

    def at(points: Sequence[Mapping[str, float]]) -> FitProblem:
        instead: dict[str, ForwardProblem] = {}
        for one in study.studies:
            if one.test in reductions:
                instead[one.test] = reductions[one.test].covering(_own(one, study, points)).problem
        return fit_problem(study, None, instead)

    return Near(at(()), at)


def _own(one: LoadedStudy, study: AnyStudy, points: Starts) -> Starts:
    """The values of one of several tests at some points."""
    return [own_values(one, point) for point in points] if len(study.studies) > 1 else points


def _as_it_is(outcome: Outcome) -> Outcome:
    return outcome
