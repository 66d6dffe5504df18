"""Values that fit several tests together, and what each test says of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.errors import InputError, ToleranceError
from calib.inference.cases import Case, CaseResult
from calib.inference.verdicts import identified_sentence
from calib.joint import JointProblem, of_test
from calib.ledger import Ledger
from calib.outcome import answered
from calib.problem import Counts
from calib.questions.calibrate import Calibration, Ran, best_of, chosen_cases, keep, why_failed
from calib.questions.case import FITTED, QUICK_STARTS, REFITS, CaseFound, SearchProgress, Steps, objective_of, told
from calib.questions.compare import answer_at, compare
from calib.questions.judge import Judgement, Terms, fitted, posed
from calib.questions.record import begin_answer, write_record
from calib.questions.recorded import recorded
from calib.questions.reduction import reduction_of
from calib.questions.scatter import assumed_words
from calib.questions.stored import confirmed
from calib.results import Results
from calib.sampling import sample
from calib.several import JointStudy
from calib.study import ForwardProblem, Study


@dataclass(frozen=True)
class JointCalibration:
    """What fits several tests together.

    Attributes
    ----------
    tests : mapping from str to Calibration
        What each test says of it: its comparison before and after, its errors; parameters are those of all.
    judgement : Judgement
        What all tests together know of the parameters.
    """

    tests: Mapping[str, Calibration]
    judgement: Judgement

    @property
    def verdicts(self) -> pd.DataFrame:
        """One row a parameter: what all tests together determine."""
        return next(iter(self.tests.values())).verdicts

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is identified, whether the models fit, and how far each test was off before and is after."""
        first = next(iter(self.tests.values()))
        out = [identified_sentence(self.verdicts), *self.judgement.identification.sentences()]
        out += [self.judgement.sentence, first.agreement.sentence]
        for test, answer in self.tests.items():
            before, after = answer.before.mean_freq_error, answer.best.answer.mean_freq_error
            out.append(of_test(test, f"mean absolute error {100 * before:.2f} % before, {100 * after:.2f} % after."))
            out += [of_test(test, words) for words in (*answer.contradictions, *answer.notes)]
        return tuple(out)


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
    given = study.settings.calibration
    if (method or (given.method if "method" in given.model_fields_set else "")) == "genetic":
        raise InputError(
            "a genetic search asks one test, and the study has several", place=study.file,
            remedy="leave the method out: several tests are fitted by least squares from several starts",
        )  # fmt: skip
    cases = chosen_cases(study, only)
    studies = {}
    for one in study.studies:
        confirmed(one, ledger)
        studies[one.test] = recorded(one, ledger)
    before = {test: compare(one, folders[test]) for test, one in studies.items()}
    reduced, notes = _reduced(studies, homes or folders)
    finder = _Finder(study, studies, reduced, ledger, quick, progress)
    fits = [finder.case(case) for case in cases]
    answers = {}
    for test, one in studies.items():
        home = (homes or folders)[test]

        def told_of(one: Study = one, home: Results = home, test: str = test) -> list[str]:
            return [note for note in (notes.get(test, ""), why_failed(one, ledger, home)) if note]

        found = tuple(_seen(one, result, judgement) for result, judgement in fits)
        options = ("--case", only) if only else ()
        ran = Ran("gauss-newton", started, quick, options, told_of, ledger.retried, study.search_space)
        answers[test] = keep(one, folders[test], found, before[test], ran)
    best = best_of(next(iter(answers.values())).cases)
    answer = JointCalibration(answers, best.judgement)
    _write(study, results, answer, best, time.perf_counter() - started)
    write_record(study, results, "calibrate", {c.name: c.seed for c in cases}, answer.sentences, quick)
    return answer


def _reduced(
    studies: Mapping[str, Study], homes: Mapping[str, Results]
) -> tuple[dict[str, ForwardProblem], dict[str, str]]:
    """Stand-ins on reduced bases where tests have some, and why others have none although they should."""
    found, notes = dict[str, ForwardProblem](), dict[str, str]()
    for test, one in studies.items():
        try:
            reduction = reduction_of(one, homes[test])
        except ToleranceError as fault:
            notes[test] = f"Fitted at full order: {fault.problem}."
        else:
            if reduction is not None:
                found[test] = reduction.problem
    return found, notes


@dataclass(frozen=True, eq=False)
class _Finder:
    """Fits all tests together, on reduced bases first where they have some."""

    study: JointStudy
    studies: Mapping[str, Study]
    reduced: Mapping[str, ForwardProblem]
    ledger: Ledger
    quick: bool
    progress: SearchProgress

    def case(self, case: Case) -> tuple[CaseResult, Judgement]:
        """Least squares from the adopted values and from further points, those of the case's seed."""
        started, counts, space = time.perf_counter(), Counts(), self.study.search_space
        given = self.study.settings.calibration
        count = min(given.starts, QUICK_STARTS) if self.quick else given.starts
        known = [space.complete({n: v for n, v in given.begin_at.items() if n in space})] if given.begin_at else []
        drawn = [space.complete(x) for x in sample(space, count, case.seed).points]
        starts = [*known, space.values, *drawn][: max(count, len(known) + 1)]
        steps = Steps(case.name, count, self.progress)
        with told(self.study):
            judgement = self._fitted(starts, steps, counts)
            self.progress(case.name, count, count, judgement.misfit)
        result = CaseResult(
            name=case.name, values=judgement.values, misfit=np.nan, responses={}, convergence=steps.table(),
            asked=counts.asked, solved=counts.solved, reused=counts.reused, infeasible=0, failed=counts.failed,
            seconds=time.perf_counter() - started,
        )  # fmt: skip
        return result, judgement

    def _fitted(self, starts: Sequence[dict[str, float]], steps: Steps, counts: Counts) -> Judgement:
        """On reduced bases from all starts, then at full order from the best."""
        exact = self._posed({}, counts)
        held = {name: sd for one in self.study.studies for name, sd in one.held_sd.items()}
        assumed = [of_test(one.test, words) for one in self.study.studies if (words := assumed_words(one))]
        terms = Terms(self.study.settings.explain.alpha, held, "; ".join(assumed))
        near = fitted(self._posed(self.reduced, counts), terms, starts, REFITS, steps)
        return fitted(exact, terms, [near.values], 1, before=near) if self.reduced else near

    def _posed(self, instead: Mapping[str, ForwardProblem], counts: Counts) -> JointProblem:
        return JointProblem(
            {test: posed(one, self.ledger, instead.get(test), counts) for test, one in self.studies.items()}
        )


def _seen(study: Study, result: CaseResult, judgement: Judgement) -> CaseFound:
    """One case as one test sees it: its responses and its comparison; the fit is that of all tests."""
    own = {name: value for name, value in judgement.values.items() if name in study.model.space}
    responses = answered(study.problem.evaluate, own)
    final = replace(result, misfit=objective_of(study)(responses), responses=responses)
    point = (final.name, FITTED, final.misfit, judgement.misfit, judgement.prior_misfit, judgement.criterion)
    columns = ["case", "point", "objective", "sum_of_squares", "prior", "total"]
    table = pd.DataFrame([point], columns=columns)
    return CaseFound(final, None, float("nan"), judgement, answer_at(study, own), table)


def _write(study: JointStudy, results: Results, answer: JointCalibration, best: CaseFound, seconds: float) -> None:
    """The parameters, and what all tests together know of them; what is of one test lies in its own folder."""
    first, judgement = next(iter(answer.tests.values())), answer.judgement
    begin_answer(results, "calibrate")
    results.write_table("parameters", first.parameters)
    results.write_table("verdicts", first.verdicts)
    results.write_table("suspects_calibrated", judgement.suspects)
    results.write_table("confounded", judgement.identification.confounded)
    results.write_table("unseen_directions", judgement.identification.directions)
    rests = "assumed" if judgement.assumed else "stated"
    results.write_table("predictions", judgement.predictions.assign(scatter=rests))
    errors = [
        one.errors.assign(test=test, scatter=rests) for test, one in answer.tests.items() if one.errors is not None
    ]
    results.remove("data_errors.csv")
    if errors:
        results.write_table("data_errors", pd.concat(errors, ignore_index=True))
    results.write_json(
        "summary",
        {
            "study": study.name,
            "synthetic": study.synthetic,
            "method": "gauss-newton",
            "best_case": best.name,
            "whitened_misfit": judgement.misfit,
            "degrees_of_freedom": judgement.freedom,
            "p_fit": judgement.p_fit,
            "birge": judgement.birge,
            "scatter_assumed": judgement.assumed,
            "seconds": seconds,
            "tests": {
                test: {
                    "mean_freq_error_before": one.before.mean_freq_error,
                    "mean_freq_error_after": one.best.answer.mean_freq_error,
                    "mean_mac_before": one.before.mean_mac,
                    "mean_mac_after": one.best.answer.mean_mac,
                }
                for test, one in answer.tests.items()
            },
        },
    )
