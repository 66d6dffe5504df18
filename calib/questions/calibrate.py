"""Which parameter values fit, and how far they can be trusted."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.correlation.scatter import known_scatter
from calib.errors import EvaluationError, InputError
from calib.inference.cases import Agreement, Case, CaseResult, agreement, convergence_table, parameters_table
from calib.inference.verdicts import identified_sentence
from calib.ledger import Ledger
from calib.missing.suspect import sentence as suspect_sentence
from calib.questions.case import CaseFinder, CaseFound, SearchProgress
from calib.questions.compare import Answer, before_and_after, compare, write_answer, write_model_modes
from calib.questions.contradiction import contradictions, every_response
from calib.questions.every_mode import all_stages, every_mode
from calib.questions.failures import reasons_sentence, stored_reasons
from calib.questions.judge import EQUAL, Judgement
from calib.questions.places import Workers
from calib.questions.record import begin_answer, write_record
from calib.questions.recorded import recorded
from calib.questions.reduction import fingerprints
from calib.questions.scatter import accuracy_words
from calib.questions.state import ADDED
from calib.questions.stored import confirmed
from calib.questions.user_function import modes_kept_under
from calib.questions.verify import errors_at
from calib.results import Results
from calib.space import ParameterSpace
from calib.study import Study
from calib.study_file import StudyFile

Method: TypeAlias = Literal["genetic", "gauss-newton"]


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    cases : tuple of CaseFound
    best : CaseFound
        Of the lowest sum of squares where least squares were fitted, of the lowest misfit else and among equals.
    before : Answer
        At the adopted values.
    tables : mapping from str to DataFrame
        See `tables_of`.
    agreement : Agreement
        Whether the cases agree on one solution.
    search_agreement : Agreement or None
        The same of the genetic searches before least squares, which know no priors; None without either.
    modes : DataFrame or None
        ``modes.csv``; None for plain responses.
    errors : DataFrame or None
        ``data_errors.csv``; None for a model that fails beside the optimum.
    responses : DataFrame or None
        ``responses.csv``; None where none is withheld.
    notes : tuple of str
        Why evaluations failed, and what a search worked on other than told.
    retried : int
        Points asked again since the command began; see `calib.ledger.Ledger`. No part of the answer, which does not
        depend on it.
    """

    cases: tuple[CaseFound, ...]
    best: CaseFound
    before: Answer
    tables: Mapping[str, pd.DataFrame]
    agreement: Agreement
    search_agreement: Agreement | None
    modes: pd.DataFrame | None = None
    errors: pd.DataFrame | None = None
    responses: pd.DataFrame | None = None
    notes: tuple[str, ...] = ()
    retried: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cases."""
        return tuple(case.name for case in self.cases)

    def seen(self, test: str) -> Calibration:
        """What the only test says of it."""
        return self

    @property
    def parameters(self) -> pd.DataFrame:
        """``parameters.csv``."""
        return self.tables["parameters"]

    @property
    def verdicts(self) -> pd.DataFrame:
        """``verdicts.csv``."""
        return self.tables["verdicts"]

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What withheld data say against it."""
        each = self.modes if self.responses is None else self.responses
        return () if self.errors is None else contradictions(self.errors, each, self.best.judgement.assumed)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is identified, whether the model fits, whether the cases agree, and what happened on the way."""
        worsened = [_worsened(case) for case in self.cases if case.worsened]
        return (
            *self.before.scatter, *self.of_parameters, *self.contradictions, *worsened, *self.of_cases, *self.notes
        )  # fmt: skip

    @property
    def of_parameters(self) -> tuple[str, ...]:
        """What is identified, and whether the model fits."""
        judgement = self.best.judgement
        whole = ", ".join(judgement.whole)
        out = [identified_sentence(self.verdicts), *judgement.identification.sentences()]
        if whole:
            out.append(f"Whole numbers, judged by how much worse their neighbours fit: {whole}.")
        if not judgement.complete:
            out.append("Not all neighbours of these whole numbers were tried: another combination may fit better.")
        return (*out, *filter(None, [judgement.sentence, suspect_sentence(judgement.suspects)]))

    @property
    def of_cases(self) -> tuple[str, ...]:
        """Whether the cases agree."""
        out = [self.agreement.sentence]
        if self.search_agreement is not None:
            out = [
                f"The searches alone: {self.search_agreement.sentence}",
                f"After least squares, which also weighs the priors: {self.agreement.sentence}",
            ]
        if self.agreement.verdict == "several solutions":
            out.append("Identified therefore means: around the reported solution; the others are just as good.")
        return tuple(out)


def fingerprint(study: Study) -> str:
    """Changes with everything that a calibration's answer depends on: model, measurement, limits, settings."""
    given = study.settings
    told = (
        study.problem.fingerprint, study.targets, study.search_space, given.calibration.model_dump(),
        given.reduction.model_dump(),
    )  # fmt: skip
    return hashlib.sha256(repr(told).encode()).hexdigest()[:16]


def chosen_cases(study: StudyFile, only: str | None) -> tuple[Case, ...]:
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
    workers: Workers = None,
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
    seconds = confirmed(study, ledger)
    study = recorded(study, ledger)
    before = compare(study, results)
    finder = CaseFinder(study, home or results, ledger, workers, quick, progress, seconds)
    found = tuple((finder.by_search if chosen == "genetic" else finder.by_least_squares)(cases))
    notes = partial(notes_on, study, ledger, finder.home, finder.notes)
    options = options_of(only, method)
    return keep(
        study, results, found, before, Ran(chosen, started, quick, options, notes, ledger.retried, study.search_space)
    )


def options_of(only: str | None, method: str | None) -> tuple[str, ...]:
    """Options of the command that asked, as they are typed."""
    return (*(("--case", only) if only else ()), *(("--method", method) if method else ()))


def notes_on(study: Study, ledger: Ledger, home: Results, first: Sequence[str]) -> list[str]:
    """Some notes, then the commonest reasons why points of a study have failed."""
    kept = set(modes_kept_under(study.problem, study.library_digest))  # what fails there has no responses either
    answering = [one for one in fingerprints(study, home) if one not in kept]
    why = reasons_sentence(study.sensitivity_space, *stored_reasons(ledger, answering))
    return [*first, *([why] if why else [])]


@dataclass(frozen=True)
class Ran:
    """How a calibration was made, for what is written about it.

    Attributes
    ----------
    method : {"genetic", "gauss-newton"}
    started : float
        When, in seconds of `time.perf_counter`.
    quick : bool
    options : tuple of str
        Of the command, as they are typed.
    notes : callable
        Gives those of `Calibration.notes`; asked at the end, since what is told of the optimum may fail too.
    retried : int
    space : ParameterSpace
        What was fitted: the study's search, or that of all tests together.
    """

    method: Method
    started: float
    quick: bool
    options: tuple[str, ...]
    notes: Callable[[], Sequence[str]]
    retried: int
    space: ParameterSpace


def keep(study: Study, results: Results, found: Sequence[CaseFound], before: Answer, ran: Ran) -> Calibration:
    """Everything that is told of cases that were found; writes all tables and ``summary.json``."""
    best, space = best_of(found), ran.space
    reported = [case.result for case in found]
    searched = [case.search for case in found if case.search is not None]
    tables = tables_of(space, [(case.result, case.judgement) for case in found], best.judgement, searched)
    level = expected_misfit(study, before)
    verdict = agreement(reported, space, level)
    raw = agreement(searched, space, level) if searched and study.settings.calibration.polish else None
    begin_answer(results, "calibrate")
    write_answer(results, best.answer, "after")
    for name, table in tables.items():
        results.write_table(name, table)
    results.write_table("points", pd.concat([case.points for case in found], ignore_index=True))
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
    results.remove("data_errors.csv", "responses.csv", *ADDED)
    errors = responses = None
    values = {name: value for name, value in best.judgement.values.items() if name in study.model.space}
    with suppress(EvaluationError):  # a model that fails beside the optimum has no errors to tell
        errors = errors_at(study, values)
        results.write_table("data_errors", errors.assign(scatter=best.judgement.rests_on))
        if study.settings.withheld.responses:
            responses = every_response(study, study.model.space.values, values)
            results.write_table("responses", responses)
    answer = Calibration(tuple(found), best, before, tables, verdict, raw, modes, errors, responses,
                         tuple(ran.notes()), ran.retried)  # fmt: skip
    summary = _summary(study, ran.method, found, best, before, time.perf_counter() - ran.started)
    summary["contradictions"] = list(answer.contradictions)
    cases = {case.name: case.seed for case in study.settings.calibration.cases if case.name in answer.names}
    results.write_json("summary", summary)
    seeds = {**cases, "reduction": study.settings.reduction.seed}
    write_record(study, results, "calibrate", seeds, answer.sentences, ran.quick, ran.options)
    return answer


def best_of(found: Sequence[CaseFound]) -> CaseFound:
    """The case that is reported; see `Calibration.best`."""
    fitted = [case for case in found if case.judgement.fit is not None] or list(found)
    lowest = min(case.judgement.criterion for case in fitted)
    alike = [case for case in fitted if case.judgement.criterion <= lowest + EQUAL]
    if fitted[0].judgement.fit is None:
        alike = fitted
    return min(alike, key=lambda case: case.result.misfit)


def _worsened(case: CaseFound) -> str:
    """What least squares have done to what the search had made small."""
    before, after = case.points.set_index("point").loc[["search", "least squares"]].to_dict("records")
    return (
        f"In {case.name} least squares raised the misfit that the search makes small from {before['objective']:.3g} to "
        f"{after['objective']:.3g}: they weigh by the scatter, damping and priors too, and lowered their own sum of "
        f"squares from {before['total']:.4g} to {after['total']:.4g}. The search's values are in parameters.csv; "
        "polish = false reports them."
    )


def tables_of(
    space: ParameterSpace,
    found: Sequence[tuple[CaseResult, Judgement]],
    best: Judgement,
    searched: Sequence[CaseResult] = (),
) -> dict[str, pd.DataFrame]:
    """What is known of the parameters after some cases, by the name of its file."""
    parameters = _parameters(space, found, searched)
    spread = dict(zip(parameters["parameter"], parameters["spread"], strict=True))
    return {
        "parameters": parameters,
        "verdicts": _without_whole(best.verdicts(space, spread), space),
        "suspects_calibrated": best.suspects,
        "confounded": best.identification.confounded,
        "unseen_directions": best.identification.directions,
        "predictions": best.predictions.assign(scatter=best.rests_on),
    }


def _parameters(
    space: ParameterSpace, found: Sequence[tuple[CaseResult, Judgement]], searched: Sequence[CaseResult]
) -> pd.DataFrame:
    """``parameters.csv``: reported values, how far the searches spread, and what the data determine.

    ``spread`` and ``stable`` are those of the genetic searches before any least squares, or of the fits without one;
    ``search_value`` is told where least squares followed a search.
    """
    table = parameters_table([result for result, _ in found], space)
    table["search_value"] = np.nan
    if searched:
        raw = parameters_table(searched, space)
        table["spread"], table["stable"] = raw["spread"], raw["stable"]
        if any(judgement.fit is not None for _, judgement in found):
            table["search_value"] = raw["value"]
    each = [judgement.verdicts(space, {}).assign(case=result.name) for result, judgement in found]
    known = _without_whole(pd.concat(each), space)
    columns = ["case", "parameter", "std", "identified", "scatter"]
    table = table.merge(known[columns], on=columns[:2], how="left")
    order = ["value", "unit", "lower", "upper", "ratio", "on_bound", "spread", "stable", "std", "identified"]
    return table[["case", "parameter", *order, "search_value", "scatter"]]


def _without_whole(table: pd.DataFrame, space: ParameterSpace) -> pd.DataFrame:
    """The table without standard deviations of whole numbers, of which only whole steps mean anything."""
    whole = table["parameter"].isin([p.name for p in space.free if p.integer])
    std = [column for column in ("std", "std_of_range") if column in table]
    return table.assign(**{column: table[column].mask(whole) for column in std})


def expected_misfit(study: Study, answer: Answer) -> float:
    """Misfit that a perfect model would show on average from the measurement's scatter alone; 0 where unknown."""
    settings = study.settings.calibration
    errors = float(np.nan_to_num(_noise_errors(study)).sum())
    if isinstance(study.problem, FunctionProblem):
        return errors
    measured, total = study.problem.measured, settings.weight_freq * errors
    if measured.has_shapes and answer.comparison is not None:
        total += settings.weight_mac * float(np.nansum(1.0 - answer.comparison.noise_mac()))
    return total


_MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean absolute value of a standard normal variate."""


def _noise_errors(study: Study) -> np.ndarray:
    """Mean relative error of each frequency or plain response that the scatter alone leaves a perfect model.

    It is the scatter that calibration weighs by, accuracy and floors included; NaN where it would be assumed.
    """
    if isinstance(study.problem, FunctionProblem):
        targets = study.problem.targets.values()
        return _MEAN_ABSOLUTE * np.array([std / abs(value) if std else np.nan for value, std in targets])
    return _MEAN_ABSOLUTE * known_scatter(study.problem.measured).freq


def _summary(
    study: Study, method: Method, found: Sequence[CaseFound], best: CaseFound, before: Answer, seconds: float
) -> dict[str, object]:
    counts = {"evaluations": "asked", **{name: name for name in ("solved", "reused", "infeasible", "failed")}}

    def figures(case: CaseFound) -> dict[str, object]:
        return {
            "misfit": case.result.misfit,
            "search_misfit": None if case.search is None else case.search.misfit,
            "search_misfit_full_order": case.search_full_order,
            **before_and_after(before, case.answer),
            **{key: getattr(case.result, name) for key, name in counts.items()},
            "seconds": case.result.seconds,
        }

    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "fingerprint": fingerprint(study),
        "method": method,
        "best_case": best.name,
        **before_and_after(before, best.answer),
        "noise_freq_error": float(np.mean(_noise_errors(study))),
        "noise_mac": best.answer.noise_mac,
        **best.judgement.figures,
        "accuracy": accuracy_words(study),
        **{key: sum(getattr(case.result, name) for case in found) for key, name in counts.items()},
        "seconds": seconds,
        "withheld_modes": list(study.settings.withheld.modes),
        "withheld_sensors": list(study.settings.withheld.sensors),
        "withheld_responses": list(study.settings.withheld.responses),
        "cases": {case.name: figures(case) for case in found},
    }
