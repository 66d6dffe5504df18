"""Calibration: fitted parameter values, their identifiability, and the model before and after."""

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

from calib.analyses.answers import UNTRIED, of_fit
from calib.analyses.best_case import best_of, with_starts
from calib.analyses.calibration_tables import tables_of
from calib.analyses.case import CaseFinder, CaseFound
from calib.analyses.compare import ComparisonResult, before_and_after, compare, write_comparison, write_model_modes
from calib.analyses.contradiction import contradictions, every_response
from calib.analyses.every_mode import all_stages, errors_at, every_mode
from calib.analyses.failures import reasons_sentence, stored_reasons
from calib.analyses.provenance.places import Workers
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.state import ADDED
from calib.analyses.provenance.stored import confirmed
from calib.analyses.provenance.user_function import ledger_keys_of_modes
from calib.analyses.reduction import fingerprints
from calib.analyses.uncertainty import accuracy_words
from calib.errors.errors import EvaluationError, InputError
from calib.execution.stage import Progress, unheard
from calib.inference.agreement import Agreement, agreement, agreement_sentences
from calib.inference.cases import Case, convergence_table
from calib.inference.verdicts import identified_sentence
from calib.missing.suspect import suspect_sentence
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import Study
from calib.study.study_file import StudyFile

CHECKING = "leave-one-out and held-out errors"
"""Name of the stage that follows all cases."""
Method: TypeAlias = Literal["auto", "genetic", "gauss-newton", "cmcf"]


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes
    ----------
    cases : tuple of CaseFound
    best : CaseFound
        The case of the lowest sum of squares; the lowest misfit decides between equals and without least squares.
    before : ComparisonResult
        At the nominal values.
    tables : mapping from str to DataFrame
        See `tables_of`.
    agreement : Agreement
        Whether the cases agree on one solution.
    search_agreement : Agreement or None
        The same for the genetic searches before least squares, which use no priors; None unless both ran.
    modes : DataFrame or None
        ``modes.csv``; None for scalar responses.
    errors : DataFrame or None
        ``data_errors.csv``; None where the model cannot be evaluated near the optimum.
    responses : DataFrame or None
        ``responses.csv``; None where no response is held out.
    notes : tuple of str
        Why evaluations failed, and where a search deviated from the settings.
    retried : int
        Points evaluated again since the command began; see `calib.results.ledger.Ledger`. The results do not depend on
        it.
    """

    cases: tuple[CaseFound, ...]
    best: CaseFound
    before: ComparisonResult
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
        """The results for one test: the calibration itself, which has only one."""
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
        """Sentences on held-out data that contradict the calibrated model."""
        each = self.modes if self.responses is None else self.responses
        return () if self.errors is None else contradictions(self.errors, each, self.best.statistics.assumed)

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        pairs = {"": (self.before, self.best.answer)}
        return of_fit(self.best.statistics, self.verdicts, pairs, self.contradictions, self.agreement.verdict)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Identified parameters, goodness of fit, contradictions, agreement of the cases, and notes."""
        worsened = [_worsened(case) for case in self.cases if case.worsened]
        return (
            *self.before.std_notes, *self.parameter_sentences, *self.contradictions, *worsened, *self.case_sentences,
            *self.notes,
        )  # fmt: skip

    @property
    def parameter_sentences(self) -> tuple[str, ...]:
        """What is identified, and whether the model fits."""
        statistics = self.best.statistics
        whole = ", ".join(statistics.whole)
        out = [identified_sentence(self.verdicts), *statistics.identification.sentences()]
        if whole:
            out.append(f"Integers, assessed by how much worse their neighbours fit: {whole}.")
        if not statistics.complete:
            out.append(UNTRIED)
        return (*out, *filter(None, [statistics.sentence, suspect_sentence(statistics.suspects)]))

    @property
    def case_sentences(self) -> tuple[str, ...]:
        """Whether the cases agree."""
        return agreement_sentences(self.agreement, self.search_agreement)


def fingerprint(study: Study) -> str:
    """Digest of everything a calibration depends on: model, measurement, limits, settings."""
    given = study.settings
    parts = (
        study.problem.fingerprint, study.targets, study.search_space, given.calibration.model_dump(),
        given.reduction.model_dump(),
    )  # fmt: skip
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


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
    progress: Progress = unheard,
    home: Results | None = None,
) -> Calibration:
    """Run every case, assess its parameters, compare before and after; write all tables and ``summary.json``.

    ``home`` holds the reduced basis, which full, quick and single-case runs share; by default it is ``results``.
    """
    started = time.perf_counter()
    chosen: Method = method or study.settings.calibration.method
    cases = chosen_cases(study, only)
    seconds = confirmed(study, ledger)
    study = recorded(study, ledger)
    progress("solving the model")
    before = compare(study, results)
    finder = CaseFinder(study, home or results, ledger, workers, quick, progress, seconds)
    by = {
        "auto": finder.by_agreement, "genetic": finder.by_search, "gauss-newton": finder.by_least_squares,
        "cmcf": finder.by_equations,
    }  # fmt: skip
    found = tuple(by[chosen](cases))
    progress(CHECKING)
    notes = partial(notes_on, study, ledger, finder.home, finder.notes)
    options = options_of(only, method)
    ran = CalibrationRun(chosen, started, quick, options, notes, ledger.retried, study.search_space)
    agreed = agreement([case.result for case in found], ran.space, expected_misfit(study, before))
    agreed = with_starts(agreed, found, ran.space)
    return keep(study, results, found, best_of([found]), before, ran, agreed)


def options_of(only: str | None, method: str | None) -> tuple[str, ...]:
    """Options of the command, as they are typed."""
    return (*(("--case", only) if only else ()), *(("--method", method) if method else ()))


def notes_on(study: Study, ledger: Ledger, home: Results, first: Sequence[str]) -> list[str]:
    """The given notes, then the commonest reasons why points of a study failed."""
    # Failures of a function of modes are counted once, at its responses: a point without modes has none either.
    modes = set(ledger_keys_of_modes(study.problem, study.library_digest))
    answering = [one for one in fingerprints(study, home) if one not in modes]
    why = reasons_sentence(study.sensitivity_space, *stored_reasons(ledger, answering))
    return [*first, *([why] if why else [])]


@dataclass(frozen=True)
class CalibrationRun:
    """How a calibration was run, for its record.

    Attributes
    ----------
    method : {"auto", "genetic", "gauss-newton", "cmcf"}
    started : float
        When, in seconds of `time.perf_counter`.
    quick : bool
    options : tuple of str
        Of the command, as they are typed.
    notes : callable
        Returns `Calibration.notes`; called last, since evaluations at the optimum may fail too.
    retried : int
    space : ParameterSpace
        The search space: the study's, or that of all tests together.
    """

    method: Method
    started: float
    quick: bool
    options: tuple[str, ...]
    notes: Callable[[], Sequence[str]]
    retried: int
    space: ParameterSpace


def keep(
    study: Study,
    results: Results,
    found: Sequence[CaseFound],
    number: int,
    before: ComparisonResult,
    ran: CalibrationRun,
    agreed: Agreement,
) -> Calibration:
    """Assemble the calibration of a test from its cases, of which one is the best; writes its tables and summary.

    ``agreed`` tells whether the cases found one solution; of several tests, for all of them together.
    """
    best, space = found[number], ran.space
    reported = [case.result for case in found]
    searched = [case.search for case in found if case.search is not None]
    fits = [(case.result, case.statistics) for case in found]
    tables = tables_of(space, fits, best.statistics, searched, agreed.differing)
    refined = bool(searched) and study.settings.calibration.refine
    raw = agreement(searched, space, expected_misfit(study, before)) if refined else None
    begin_analysis(results, "calibrate")
    results.remove("std_by_test.csv")
    write_comparison(results, best.answer, "after")
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
    values = {name: value for name, value in best.statistics.values.items() if name in study.problem.space}
    with suppress(EvaluationError):  # errors are unknown where the model fails near the optimum
        ended = best.statistics
        errors = errors_at(study, values, ended.parts.get(study.test), ended.active)
        results.write_table("data_errors", errors.assign(std_from=best.statistics.rests_on))
        if study.settings.held_out.responses:
            responses = every_response(study, study.model.space.values, values)
            results.write_table("responses", responses)
    answer = Calibration(tuple(found), best, before, tables, agreed, raw, modes, errors, responses,
                         tuple(ran.notes()), ran.retried)  # fmt: skip
    summary = _summary(study, ran.method, found, best, before, time.perf_counter() - ran.started)
    summary["contradictions"] = list(answer.contradictions)
    cases = {case.name: case.seed for case in study.settings.calibration.cases if case.name in answer.names}
    results.write_json("summary", summary)
    seeds = {**cases, "reduction": study.settings.reduction.seed}
    write_record(study, results, "calibrate", seeds, answer.sentences, ran.quick, ran.options, answer.answer)
    return answer


def _worsened(case: CaseFound) -> str:
    """Says that least squares raised the misfit that the search minimised."""
    before, after = case.points.set_index("point").loc[["search", "least squares"]].to_dict("records")
    return (
        f"In {case.name} least squares raised the misfit that the search minimises from {before['objective']:.3g} to "
        f"{after['objective']:.3g}: they weight by standard deviations and include damping and priors, and lowered "
        f"their own sum of squares from {before['total']:.4g} to {after['total']:.4g}. The search's values are in "
        "parameters.csv; refine = false reports them."
    )


def expected_misfit(study: Study, answer: ComparisonResult) -> float:
    """Mean misfit of a perfect model, due to the measurement's standard deviation alone; 0 where unknown."""
    settings = study.settings.calibration
    errors = float(np.nan_to_num(_noise_errors(study)).sum())
    if answer.comparison is None:  # only frequencies and MAC have weights
        return errors
    total = settings.weight_freq * errors
    if answer.comparison.measured.has_shapes:
        total += settings.weight_mac * float(np.nansum(1.0 - answer.comparison.noise_mac()))
    return total


_MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
"""Mean absolute value of a standard normal variate."""


def _noise_errors(study: Study) -> np.ndarray:
    """Mean relative error of each frequency or scalar response of a perfect model, due to the standard deviation alone.

    The standard deviation is the one that calibration weights by, accuracy and floors included; NaN where it would be
    assumed.
    """
    return _MEAN_ABSOLUTE * study.problem.relative_std


def _summary(
    study: Study, method: Method, found: Sequence[CaseFound], best: CaseFound, before: ComparisonResult, seconds: float
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
        **best.statistics.figures,
        "accuracy": accuracy_words(study) or "none",
        **{key: sum(getattr(case.result, name) for case in found) for key, name in counts.items()},
        "seconds": seconds,
        **{f"held_out_{kind}": list(names) for kind, names in study.settings.held_out.model_dump().items()},
        "cases": {case.name: figures(case) for case in found},
    }
