"""Values that fit several tests together, and what each test says of them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import pandas as pd

from calib.errors import InputError
from calib.forward import ForwardProblem
from calib.joint import JointProblem, of_test, stacked
from calib.ledger import Ledger
from calib.problem import Counts
from calib.questions.calibrate import Calibration, Ran, chosen_cases, keep, notes_on, options_of
from calib.questions.case import SearchProgress, Starts, known_starts, least_squares, reduction_noted, reported
from calib.questions.compare import before_and_after, compare
from calib.questions.judge import FitProgress, Judgement, Terms, polished, posed
from calib.questions.record import begin_answer, write_record
from calib.questions.recorded import recorded
from calib.questions.stored import confirmed
from calib.results import Results
from calib.several import JointStudy


@dataclass(frozen=True)
class JointCalibration:
    """What fits several tests together.

    Attributes
    ----------
    tests : mapping from str to Calibration
        What each test says of it: its comparison before and after, its errors; parameters are those of all.
    """

    tests: Mapping[str, Calibration]

    @property
    def any(self) -> Calibration:
        """That of one test, for what is of all: the parameters and how well they are known."""
        return next(iter(self.tests.values()))

    def seen(self, test: str) -> Calibration:
        """What one test says of it."""
        return self.tests[test]

    @property
    def verdicts(self) -> pd.DataFrame:
        """One row a parameter: what all tests together determine."""
        return self.any.verdicts

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is identified, whether the models fit, and how far each test was off before and is after."""
        out = [*self.any.of_parameters, *self.any.of_cases]
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
    method: str | None = None,
    progress: SearchProgress = lambda case, generation, generations, best: None,
    homes: Mapping[str, Results] | None = None,
) -> JointCalibration:
    """Fit all tests of a study by least squares from several points, and tell what each of them says of the optimum.

    ``folders`` are those of the tests, by name; ``results`` takes the parameters and what is told of all tests;
    ``homes`` hold the reduced bases of the tests, by default their folders.
    """
    started = time.perf_counter()
    given, homes = study.settings.calibration, homes or folders
    if (method or (given.method if "method" in given.model_fields_set else "")) == "genetic":
        raise InputError(
            "a genetic search asks one test, and the study has several", place=study.file,
            remedy="leave the method out: several tests are fitted by least squares from several starts",
        )  # fmt: skip
    cases = chosen_cases(study, only)
    for one in study.studies:
        confirmed(one, ledger)
    asked = study.each(lambda one: recorded(one, ledger))
    before = {one.test: compare(one, folders[one.test]) for one in asked.studies}
    notes: dict[str, list[str]] = {one.test: [] for one in asked.studies}
    bases = {one.test: reduction_noted(one, homes[one.test], notes[one.test]) for one in asked.studies}
    reduced = {test: basis.problem for test, basis in bases.items() if basis is not None}
    terms, known = Terms.of(study), known_starts(study)

    def problem(instead: Mapping[str, ForwardProblem], counts: Counts) -> JointProblem:
        return JointProblem({s.test: posed(s, ledger, instead.get(s.test), counts) for s in asked.studies})

    def fit(starts: Starts, refits: int, progress: FitProgress, counts: Counts) -> Judgement:
        near = problem(reduced, counts) if reduced else None
        return polished(problem({}, counts), near, terms, starts, refits, progress, known)

    fits = [least_squares(case, asked, known, quick, progress, fit) for case in cases]
    answers, options = {}, options_of(only, method)
    for one in asked.studies:
        found = tuple(reported(one, result, judgement) for result, judgement in fits)
        told = partial(notes_on, one, ledger, homes[one.test], notes[one.test])
        ran = Ran("gauss-newton", started, quick, options, told, ledger.retried, study.search_space)
        answers[one.test] = keep(one, folders[one.test], found, before[one.test], ran)
    answer = JointCalibration(answers)
    _write(study, results, answer, time.perf_counter() - started)
    write_record(study, results, "calibrate", {c.name: c.seed for c in cases}, answer.sentences, quick, options)
    return answer


def _write(study: JointStudy, results: Results, answer: JointCalibration, seconds: float) -> None:
    """The parameters, and what all tests together know of them; what is of one test lies in its own folder."""
    best = answer.any.best
    begin_answer(results, "calibrate")
    for name, table in answer.any.tables.items():
        results.write_table(name, table)
    errors = {test: one.errors for test, one in answer.tests.items() if one.errors is not None}
    results.remove("data_errors.csv")
    if errors:
        results.write_table("data_errors", stacked(errors).assign(scatter=best.judgement.rests_on))
    results.write_json("summary", {
        "study": study.name,
        "synthetic": study.synthetic,
        "method": "gauss-newton",
        "best_case": best.name,
        **best.judgement.figures,
        "seconds": seconds,
        "tests": {test: before_and_after(one.before, one.best.answer) for test, one in answer.tests.items()},
    })  # fmt: skip
