"""Calibration: fitted parameter values, their identifiability, and the model before and after."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd

from calib.analyses.calibration import WITH_MISFIT, Calibration, Fitted, JointCalibration, best_of, summed, with_starts
from calib.analyses.calibration_tables import noise_errors, tables_of, write_calibration, write_jointly
from calib.analyses.case import CaseFinder
from calib.analyses.case_found import CaseFound
from calib.analyses.compare import ComparisonResult, compare, nominal_comparison
from calib.analyses.every_mode import all_stages, errors_at, every_mode, every_response
from calib.analyses.explain import has_misfit_intervals, misfit_intervals
from calib.analyses.failures import reasons_sentence, stored_reasons
from calib.analyses.fit_statistics import FitProblem
from calib.analyses.hypotheses_of_study import require_usable
from calib.analyses.joint_responses import Responses, own_values
from calib.analyses.provenance.places import Workers
from calib.analyses.provenance.record import write_record
from calib.analyses.provenance.recorded import ledger_keys_of_modes, recorded
from calib.analyses.provenance.stored import confirmed
from calib.analyses.reduction import fingerprints
from calib.analyses.sensitivity import wide_sentence_of
from calib.correlation.modal.comparison import Comparison
from calib.errors.errors import EvaluationError, InputError
from calib.execution.stage import Progress, silent
from calib.inference.agreement import Agreement, agreement
from calib.inference.between import LEAST_TESTS, between_tests, tests_that_free
from calib.inference.cases import Case
from calib.missing.settings import too_few
from calib.problem.joint import JointProblem
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile

CHECKING = "leave-one-out and validation errors"
"""Name of the stage that follows all cases."""
Method: TypeAlias = Literal["auto", "genetic", "gauss-newton", "cmcf"]


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


@dataclass(frozen=True)
class CalibrationRun:
    """What a calibration works with besides the study.

    Attributes
    ----------
    ledger : Ledger
    homes : mapping from str to Results
        They hold the reduced basis of each test, which full, quick and single-case runs share; none for a study in
        memory.
    workers : int, Injected or None
        See `calib.analyses.provenance.places.Workers`.
    only : str or None
        Name of the only case to run.
    quick : bool
    method : str or None
        Instead of that of the study.
    progress : callable
    """

    ledger: Ledger
    homes: Mapping[str, Results] = field(default_factory=dict)
    workers: Workers = None
    only: str | None = None
    quick: bool = False
    method: Method | None = None
    progress: Progress = silent

    @property
    def options(self) -> tuple[str, ...]:
        """Options of the command, as they are typed."""
        return (*(("--case", self.only) if self.only else ()), *(("--method", self.method) if self.method else ()))


def calibrated(
    study: AnyStudy,
    run: CalibrationRun,
    compared: Callable[[LoadedStudy], ComparisonResult] = nominal_comparison,
) -> Fitted:
    """Run every case, assess its parameters, compare before and after, for one test or several; nothing is written.

    ``compared`` compares a test before the calibration.
    """
    chosen: Method = run.method or study.settings.calibration.method
    _require_one_test(study, chosen)
    if has_misfit_intervals(study):  # which rest on the effects, when everything else is done
        require_usable(study, composed=False)
    cases, ledger, progress = chosen_cases(study, run.only), run.ledger, run.progress
    seconds = [confirmed(one, ledger) for one in study.studies]
    study = study.each(lambda one: recorded(one, ledger, run.workers))
    progress("solving the model")
    before = {one.test: compared(one) for one in study.studies}
    finder = CaseFinder(study, ledger, run.homes, run.workers, run.quick, progress, seconds[0])
    varies = _varying(study, finder.exact)
    found = tuple(finder.found(chosen, cases))
    progress(CHECKING)
    by_test = {one.test: [case[k] for case in found] for k, one in enumerate(study.studies)}
    every, space = list(by_test.values()), study.search_space
    level = sum(expected_misfit(one, before[one.test]) for one in study.studies)
    agreed = with_starts(agreement(summed(every), space, level), every[0], space)
    best, only = best_of(every), len(study.studies) == 1
    told: dict[str, Any] = {"mesh": finder.mesh_doubt(every[0][best].statistics), "between": None}
    if varies and isinstance(finder.exact, JointProblem) and not run.quick:
        progress("how much parameters vary between the tests")
        told["between"] = between_tests(finder.exact, varies, every[0][best].statistics.values)
    for cases_of_test in every if any(told.values()) else ():
        ended = cases_of_test[best]
        cases_of_test[best] = replace(ended, statistics=replace(ended.statistics, **told))
    parts, few = {}, too_few(finder.exact.rows, len(space.free))
    for one in study.studies:
        home = run.homes.get(one.test)
        noted = [*finder.reduction_notes.get(one.test, ()), *(finder.agreeing if only else ())]
        why = partial(why_failed_in, one, ledger, home)
        parts[one.test] = _assembled(one, by_test[one.test], best, before[one.test], agreed, noted, why, ledger.retried)
    contradicted = any(part.contradictions for part in parts.values())  # which also casts doubt on joint parameters
    wide = None
    if every[0][best].statistics.fits is False:
        wide = misfit_intervals(study, every[0][best].statistics.values, progress, run.homes)
    parts = {test: replace(_with_tables(part, space, contradicted, wide), too_few=few) for test, part in parts.items()}
    if only:
        return next(iter(parts.values()))
    failed = reasons_sentence(space, *stored_reasons(ledger, [Responses.of(study).fingerprint]))
    return JointCalibration(parts, (*finder.agreeing, *([failed] if failed else [])), failed)


def calibrate(
    study: AnyStudy,
    results: Results,
    ledger: Ledger,
    workers: Workers = None,
    only: str | None = None,
    quick: bool = False,
    method: Method | None = None,
    progress: Progress = silent,
    folders: Mapping[str, Results] = MappingProxyType({}),
    homes: Mapping[str, Results] = MappingProxyType({}),
) -> Fitted:
    """Calibrate a study; write all tables and ``summary.json``.

    ``folders`` take the results of each of several tests, by its name; ``homes`` hold their reduced bases, by default
    the same folders. The rest as in `CalibrationRun`.
    """
    started, own_folder = time.perf_counter(), {one.test: folders.get(one.test, results) for one in study.studies}
    run = CalibrationRun(ledger, homes or own_folder, workers, only, quick, method, progress)
    answer = calibrated(study, run, lambda one: compare(one, own_folder[one.test]))
    chosen: Method = run.method or study.settings.calibration.method
    seeds = {case.name: case.seed for case in chosen_cases(study, run.only)}
    reduction = {"reduction": study.settings.reduction.seed}
    for one in study.studies:
        own, folder = answer.seen(one.test), own_folder[one.test]
        write_calibration(one, folder, own, chosen, time.perf_counter() - started)
        ran = {name: seed for name, seed in seeds.items() if name in own.names} | reduction
        write_record(one, folder, "calibrate", ran, own.sentences, run.quick, run.options, own.answer)
    if isinstance(answer, JointCalibration):
        write_jointly(study, results, answer, chosen, time.perf_counter() - started)
        write_record(study, results, "calibrate", seeds, answer.sentences, run.quick, run.options, answer.answer)
    return answer


def _require_one_test(study: AnyStudy, method: Method) -> None:
    """InputError for the cross-model equations of several tests: they are posed for the FRFs of one."""
    if method == "cmcf" and len(study.studies) > 1:
        raise InputError(
            f"method 'cmcf' solves the cross-model equations of one FRF test; there are {len(study.studies)} tests",
            place=study.place("calibration", "method"),
            remedy="choose 'gauss-newton', which starts from the solutions for each test, or calibrate one test alone",
        )


def _varying(study: AnyStudy, problem: FitProblem) -> tuple[str, ...]:
    """Parameters with own values in each test; InputError for one that is not fitted, or of fewer than three tests."""
    varies = study.settings.calibration.varies
    fitted = [p.name for p in problem.space.free if not p.integer]
    for name in varies:
        tests = len(tests_that_free(problem, name)) if isinstance(problem, JointProblem) else 1
        if name not in fitted or tests < LEAST_TESTS:
            words = f"{tests} tests leave it free" if name in fitted else f"fitted are {', '.join(fitted)}"
            raise InputError(
                f"{name!r} cannot vary between the tests: {words}", place=study.place("calibration", "varies"),
                remedy=f"name fitted parameters of {LEAST_TESTS} tests or more",
            )  # fmt: skip
    return varies


def why_failed_in(study: LoadedStudy, ledger: Ledger, home: Results | None) -> str:
    """The commonest reasons why points of a study failed; empty where none did."""
    # Failures of a function of modes are counted once, at its responses: a point without modes has none either.
    modes = set(ledger_keys_of_modes(study.problem, study.library_digest))
    answering = [one for one in fingerprints(study, home) if one not in modes]
    return reasons_sentence(study.sensitivity_space, *stored_reasons(ledger, answering))


def _assembled(
    study: LoadedStudy,
    found: Sequence[CaseFound],
    number: int,
    before: ComparisonResult,
    agreed: Agreement,
    notes: Sequence[str],
    why_failed: Callable[[], str],
    retried: int,
) -> Calibration:
    """The calibration of a test from its cases, of which one is the best; without tables.

    ``agreed`` tells whether the cases found one solution: of several tests, both are for all of them together.
    ``why_failed`` is called last, since evaluations at the optimum may fail too.
    """
    best = found[number]
    searched = [case.search for case in found if case.search is not None]
    refined = bool(searched) and study.settings.calibration.refine
    raw = agreement(searched, study.search_space, expected_misfit(study, before)) if refined else None
    stages, modes, errors, responses = dict[str, Comparison](), None, None, None
    if before.comparison is not None and best.answer.comparison is not None:
        with suppress(EvaluationError):
            stages = all_stages(study, before.comparison, best.answer.comparison)
            modes = every_mode(study, stages)
    values = own_values(study, best.statistics.values)
    with suppress(EvaluationError):  # errors are unknown where the model fails near the optimum
        errors = errors_at(study, values, best.statistics)
        responses = every_response(study, study.model.space.values, values)
    why = why_failed()
    told = (*notes, *filter(None, [wide_sentence_of(study, study.search_space), why]))
    return Calibration(
        tuple(found), best, before, {}, agreed, raw, stages, modes, errors, responses, told, retried, why
    )


def _with_tables(
    part: Calibration, space: ParameterSpace, contradicted: bool, wide: pd.DataFrame | None
) -> Calibration:
    """A calibration with the tables on its parameters; ``contradicted`` where held-out data of any test contradict.

    ``wide`` are the intervals with the misfit of a rejected model.
    """
    fits = [(case.result, case.statistics) for case in part.cases]
    searched = [case.search for case in part.cases if case.search is not None]
    tables = tables_of(space, fits, part.best.statistics, searched, part.agreement.differing, contradicted)
    return replace(part, tables=tables if wide is None or wide.empty else tables | {WITH_MISFIT: wide})


def expected_misfit(study: LoadedStudy, answer: ComparisonResult) -> float:
    """Mean misfit of a perfect model, due to the measurement's standard deviation alone; 0 where unknown."""
    settings = study.settings.calibration
    errors = float(np.nan_to_num(noise_errors(study)).sum())
    if answer.comparison is None:  # only frequencies and MAC have weights
        return errors
    total = settings.weight_freq * errors
    if answer.comparison.measured.has_shapes:
        total += settings.weight_mac * float(np.nansum(1.0 - answer.comparison.noise_mac()))
    return total
