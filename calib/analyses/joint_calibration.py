"""Joint calibration: parameters fitted to several tests together."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import pandas as pd

from calib.analyses.answers import of_fit
from calib.analyses.best_case import best_of, summed, with_starts
from calib.analyses.calibrate import (
    CHECKING,
    Calibration,
    CalibrationRun,
    Method,
    chosen_cases,
    expected_misfit,
    keep,
    notes_on,
    options_of,
)
from calib.analyses.case import reduction_noted, reported
from calib.analyses.case_starts import Starts, evaluable, known_starts, least_squares, until_agreed
from calib.analyses.compare import before_and_after, compare
from calib.analyses.fit_statistics import FitProgress, FitStatistics, Terms, posed, refined
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.recorded import recorded
from calib.analyses.provenance.stored import confirmed
from calib.errors.errors import InputError
from calib.execution.stage import Progress, named, unheard
from calib.experiment import ForwardProblem
from calib.hypotheses.linear_start import linear_starts
from calib.inference.agreement import agreement
from calib.inference.cases import Case, CaseResult
from calib.inference.starts import Enough, UntilAgreed, never
from calib.problem.joint import JointProblem, of_test, stacked
from calib.problem.problem import Counts
from calib.results.answer import Answer
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.several import JointStudy


@dataclass(frozen=True)
class JointCalibration:
    """Result of a joint calibration.

    Attributes
    ----------
    tests : mapping from str to Calibration
        The results for each test: its comparisons before and after, and its errors. The parameters are joint.
    notes : tuple of str
        How many starts agreed.
    """

    tests: Mapping[str, Calibration]
    notes: tuple[str, ...] = ()

    @property
    def any(self) -> Calibration:
        """The results for one test, for what all share: the parameters and their fit statistics."""
        return next(iter(self.tests.values()))

    def seen(self, test: str) -> Calibration:
        """The results for one test."""
        return self.tests[test]

    @property
    def verdicts(self) -> pd.DataFrame:
        """One row per parameter, from all tests together."""
        return self.any.verdicts

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        pairs = {test: (one.before, one.best.answer) for test, one in self.tests.items()}
        against = tuple(of_test(test, words) for test, one in self.tests.items() for words in one.contradictions)
        return of_fit(self.any.best.statistics, self.verdicts, pairs, against, self.any.agreement.verdict)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Identified parameters, goodness of fit, and the errors of each test before and after."""
        out = [*self.any.parameter_sentences, *self.any.case_sentences, *self.notes]
        for test, answer in self.tests.items():
            before, after = answer.before.mean_freq_error, answer.best.answer.mean_freq_error
            out.append(of_test(test, f"mean absolute error {100 * before:.2f} % before, {100 * after:.2f} % after."))
            out += [of_test(test, words) for words in (*answer.contradictions, *answer.notes)]
        return tuple(out)


Fitted: TypeAlias = Calibration | JointCalibration


def calibrate_jointly(
    study: JointStudy,
    folders: Mapping[str, Results],
    results: Results,
    ledger: Ledger,
    only: str | None = None,
    quick: bool = False,
    method: Method | None = None,
    progress: Progress = unheard,
    homes: Mapping[str, Results] | None = None,
) -> JointCalibration:
    """Fit all tests of a study by least squares from several starting points; write all tables.

    ``folders`` are those of the tests, by name; ``results`` takes the parameters and the tables on all tests;
    ``homes`` hold the reduced bases of the tests, by default their folders.
    """
    started = time.perf_counter()
    homes = homes or folders
    chosen: Method = method or study.settings.calibration.method
    if chosen == "genetic":
        raise InputError(
            "a genetic search takes one test, and the study has several", place=study.file,
            remedy="leave the method out: several tests are fitted by least squares from several starts",
        )  # fmt: skip
    cases = chosen_cases(study, only)
    for one in study.studies:
        confirmed(one, ledger)
    behind_ledger = study.each(lambda one: recorded(one, ledger))
    before = {one.test: compare(one, folders[one.test]) for one in behind_ledger.studies}
    notes: dict[str, list[str]] = {one.test: [] for one in behind_ledger.studies}
    bases = {
        one.test: reduction_noted(one, homes[one.test], notes[one.test], progress) for one in behind_ledger.studies
    }
    reduced = {test: basis.problem for test, basis in bases.items() if basis is not None}
    terms = Terms.of(study)

    def problem(instead: Mapping[str, ForwardProblem], counts: Counts) -> JointProblem:
        return JointProblem({s.test: posed(s, ledger, instead.get(s.test), counts) for s in behind_ledger.studies})

    known = (*linear_starts(problem({}, Counts()), study.search_space.values), *known_starts(study))

    def fit(
        told: Progress, enough: Enough, starts: Starts, refits: int, steps: FitProgress, counts: Counts
    ) -> FitStatistics:
        near = problem(reduced, counts) if reduced else None
        return refined(problem({}, counts), near, terms, starts, refits, steps, known, told=told, enough=enough)

    def of_case(case: Case) -> tuple[CaseResult, FitStatistics]:
        told = named(progress, case.name)
        if chosen != "auto":
            return least_squares(case, behind_ledger, known, quick, partial(fit, told, never))
        until = UntilAgreed(len(known) + 1)
        with evaluable(behind_ledger):
            found = until_agreed(case, behind_ledger, known, quick, partial(fit, told, until))
        agreeing.append(f"{case.name}: {until.optima.sentence}.")
        return found

    agreeing: list[str] = []
    fits = [of_case(case) for case in cases]
    progress(CHECKING)
    found = {s.test: [reported(s, *case) for case in fits] for s in behind_ledger.studies}
    answers, options, best = {}, options_of(only, method), best_of(list(found.values()))
    levels = (expected_misfit(one, before[one.test]) for one in behind_ledger.studies)
    agreed = agreement(summed(list(found.values())), study.search_space, sum(levels))
    agreed = with_starts(agreed, next(iter(found.values())), study.search_space)
    used: Method = "auto" if chosen == "auto" else "gauss-newton"
    for one in behind_ledger.studies:
        noted = partial(notes_on, one, ledger, homes[one.test], notes[one.test])
        ran = CalibrationRun(used, started, quick, options, noted, ledger.retried, study.search_space)
        answers[one.test] = keep(one, folders[one.test], found[one.test], best, before[one.test], ran, agreed)
    answer = JointCalibration(answers, tuple(agreeing))
    _write(study, results, answer, used, time.perf_counter() - started)
    seeds = {c.name: c.seed for c in cases}
    write_record(study, results, "calibrate", seeds, answer.sentences, quick, options, answer.answer)
    return answer


def _write(study: JointStudy, results: Results, answer: JointCalibration, method: Method, seconds: float) -> None:
    """Write the parameters and the tables on all tests together; those on one test are in its own folder."""
    best = answer.any.best
    begin_analysis(results, "calibrate")
    for name, table in answer.any.tables.items():
        results.write_table(name, table)
    errors = {test: one.errors for test, one in answer.tests.items() if one.errors is not None}
    results.remove("data_errors.csv")
    if errors:
        results.write_table("data_errors", stacked(errors).assign(std_from=best.statistics.rests_on))
    results.write_json("summary", {
        "study": study.name,
        "synthetic": study.synthetic,
        "method": method,
        "best_case": best.name,
        **best.statistics.figures,
        "seconds": seconds,
        "tests": {test: before_and_after(one.before, one.best.answer) for test, one in answer.tests.items()},
    })  # fmt: skip
