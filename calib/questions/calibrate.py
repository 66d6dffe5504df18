"""Which parameter values fit, and how far they can be trusted."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.errors import EvaluationError, InputError
from calib.evaluate import Outcome
from calib.ledger import Ledger
from calib.questions.compare import Answer, answer_at, compare, responses_at, write_answer, write_model_modes
from calib.questions.every_mode import all_stages, every_mode
from calib.questions.judge import FitProgress, Judgement, RecordedResidual, fitted, judged
from calib.questions.places import QUICK_GENERATIONS, QUICK_POPULATION, open_evaluator
from calib.questions.reduction import Reduction, reduction_of
from calib.questions.verify import errors_at
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.space import ParameterSpace
from calib.study import Study
from calib.updating.cases import Agreement, Case, CaseResult, agreement, convergence_table, parameters_table, run_case
from calib.updating.genetic import GeneticSettings
from calib.updating.objective import FrequencyMacObjective, ResponseObjective

Objective: TypeAlias = FrequencyMacObjective | ResponseObjective
Method: TypeAlias = Literal["genetic", "gauss-newton"]
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


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    cases : tuple of CaseFound
    best : CaseFound
        Of the lowest misfit.
    before : Answer
        At the adopted values.
    parameters, verdicts : DataFrame
        ``parameters.csv``, ``verdicts.csv``.
    agreement : Agreement
        Whether the cases agree on one solution.
    search_agreement : Agreement or None
        The same of the genetic searches before least squares, which know no priors; None without either.
    method : {"genetic", "gauss-newton"}
    modes : DataFrame or None
        ``modes.csv``; None for plain responses.
    """

    cases: tuple[CaseFound, ...]
    best: CaseFound
    before: Answer
    parameters: pd.DataFrame
    verdicts: pd.DataFrame
    agreement: Agreement
    search_agreement: Agreement | None
    method: Method
    modes: pd.DataFrame | None = None


def fingerprint(study: Study) -> str:
    """Changes with everything that a calibration's answer depends on: model, measurement, limits, settings."""
    given = study.settings
    told = (
        study.problem.fingerprint, study.targets, study.search_space, given.calibration.model_dump(),
        given.reduction.model_dump(),
    )  # fmt: skip
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]


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
    method: Method | None = None,
    progress: SearchProgress = lambda case, generation, generations, best: None,
    home: Results | None = None,
) -> Calibration:
    """Search every case, judge its parameters, compare before and after; write all tables and ``summary.json``.

    ``home`` holds the reduced basis, which whole, quick and single-case runs share; by default it is ``results``.
    """
    started = time.perf_counter()
    chosen: Method = method or study.settings.calibration.method
    cases = chosen_cases(study, only)
    before = compare(study, results)
    finder = _Finder(study, home or results, ledger, workers, quick, progress)
    found = tuple((finder.by_search if chosen == "genetic" else finder.by_least_squares)(cases))
    best = min(found, key=lambda case: case.result.misfit)
    reported = [case.result for case in found]
    searched = [case.search for case in found if case.search is not None]
    parameters = _parameters(study, found, searched)
    spread = dict(zip(parameters["parameter"], parameters["spread"], strict=True))
    verdicts = _without_whole(best.judgement.verdicts(study.search_space, spread), study.search_space)
    level = expected_misfit(study, before)
    verdict = agreement(reported, study.search_space, level)
    raw = agreement(searched, study.search_space, level) if searched and study.settings.calibration.polish else None
    write_answer(results, best.answer, "after")
    results.write_table("parameters", parameters)
    results.write_table("verdicts", verdicts)
    results.write_table("confounded", best.judgement.identification.confounded)
    results.write_table("unseen_directions", best.judgement.identification.directions)
    results.write_table("predictions", best.judgement.predictions)
    results.write_table("convergence", convergence_table(reported))
    results.remove("modes.csv")
    modes = None
    if before.comparison is not None and best.answer.comparison is not None:
        with suppress(EvaluationError):
            stages = all_stages(study, before.comparison, best.answer.comparison)
            modes = every_mode(study, stages)
            results.write_table("modes", modes)
            for stage, comparison in stages.items():
                write_model_modes(results, comparison, stage)
    results.remove("data_errors.csv")
    with suppress(EvaluationError):  # a model that fails beside the optimum has no errors to tell
        results.write_table("data_errors", errors_at(study, best.judgement.values))
    summary = _summary(study, chosen, found, best, before, time.perf_counter() - started)
    results.write_json("summary", summary)
    return Calibration(found, best, before, parameters, verdicts, verdict, raw, chosen, modes)


@dataclass(frozen=True, eq=False)
class _Finder:
    """Finds one case after the other.

    Attributes
    ----------
    study : Study
    home : Results
        Where the reduced basis is kept.
    ledger : Ledger
    workers : int or None
    quick : bool
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

    def by_search(self, cases: Sequence[Case]) -> Iterator[CaseFound]:
        """Genetic algorithm, then least squares from its best point unless the study does without."""
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
                        judgement = self.polished(reduction, [search.values], POLISH_REFITS)
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
            starts = [space.complete(x) for x in sample(space, count, case.seed).points]
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
        return fitted(self.study, self.exact, [near.values], 1, whole=near.whole)


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


def _parameters(study: Study, found: Sequence[CaseFound], searched: Sequence[CaseResult]) -> pd.DataFrame:
    """``parameters.csv``: reported values, how far the searches spread, and what the data determine.

    ``spread`` and ``stable`` are those of the genetic searches before any least squares, or of the fits without one.
    """
    space = study.search_space
    table = parameters_table([case.result for case in found], space)
    if searched:
        raw = parameters_table(searched, space)
        table["spread"], table["stable"], table["search_value"] = raw["spread"], raw["stable"], raw["value"]
    else:
        table["search_value"] = np.nan
    each = [case.judgement.verdicts(space, {}).assign(case=case.name) for case in found]
    known = _without_whole(pd.concat(each), space)
    columns = ["case", "parameter", "std", "identified"]
    table = table.merge(known[columns], on=columns[:2], how="left")
    order = ["value", "unit", "lower", "upper", "ratio", "on_bound", "spread", "stable", "std", "identified"]
    return table[["case", "parameter", *order, "search_value"]]


def _without_whole(table: pd.DataFrame, space: ParameterSpace) -> pd.DataFrame:
    """The table without standard deviations of whole numbers, of which only whole steps mean anything."""
    whole = table["parameter"].isin([p.name for p in space.free if p.integer])
    std = [column for column in ("std", "std_of_range") if column in table]
    return table.assign(**{column: table[column].mask(whole) for column in std})


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
    study: Study, method: Method, found: Sequence[CaseFound], best: CaseFound, before: Answer, seconds: float
) -> dict[str, object]:
    counts = {"evaluations": "asked", **{name: name for name in ("solved", "reused", "infeasible", "failed")}}

    def figures(case: CaseFound) -> dict[str, object]:
        return {
            "misfit": case.result.misfit,
            "search_misfit": None if case.search is None else case.search.misfit,
            "search_misfit_full_order": case.search_full_order,
            "mean_freq_error_before": before.mean_freq_error,
            "mean_freq_error_after": case.answer.mean_freq_error,
            "mean_mac_before": before.mean_mac,
            "mean_mac_after": case.answer.mean_mac,
            **{key: getattr(case.result, name) for key, name in counts.items()},
            "seconds": case.result.seconds,
        }

    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "fingerprint": fingerprint(study),
        "method": method,
        "best_case": best.name,
        "mean_freq_error_before": before.mean_freq_error,
        "mean_freq_error_after": best.answer.mean_freq_error,
        "mean_mac_before": before.mean_mac,
        "mean_mac_after": best.answer.mean_mac,
        "noise_mac": best.answer.noise_mac,
        "whitened_misfit": best.judgement.misfit,
        "degrees_of_freedom": best.judgement.freedom,
        **{key: sum(getattr(case.result, name) for case in found) for key, name in counts.items()},
        "seconds": seconds,
        "withheld_modes": list(study.settings.withheld.modes),
        "withheld_sensors": list(study.settings.withheld.sensors),
        "cases": {case.name: figures(case) for case in found},
    }
