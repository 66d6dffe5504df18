"""Results of a calibration: fitted values, their identifiability, and the models before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import pandas as pd

from calib.analyses.answers import UNTRIED, of_fit
from calib.analyses.case_found import FITTED, SEARCH, CaseFound
from calib.analyses.compare import ComparisonResult
from calib.analyses.every_mode import contradictions
from calib.correlation.modal.comparison import Comparison
from calib.inference.agreement import Agreement, agreement_sentences
from calib.inference.cases import CaseResult
from calib.inference.rules import RULES
from calib.inference.verdicts import identified_sentence
from calib.missing.discrepancy import parameters_sentence
from calib.missing.suspect import suspect_sentence
from calib.problem.joint import of_test
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer

WITH_MISFIT = "unexplained_calibrated"
"""Name of the table of intervals that know of the misfit of a rejected model."""
_UNHELD = "The model does not fit, so that the standard deviations do not hold: what is missing may have pulled values."


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
    stages : mapping from str to Comparison
        Of all measured modes, before and after; see `calib.analyses.every_mode.all_stages`. Empty without modes.
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
    why_failed : str
        Why evaluations failed, which is among the notes too; empty where none did.
    too_few : str
        Why an explanation would refuse the data; empty where it would not.
    """

    cases: tuple[CaseFound, ...]
    best: CaseFound
    before: ComparisonResult
    tables: Mapping[str, pd.DataFrame]
    agreement: Agreement
    search_agreement: Agreement | None
    stages: Mapping[str, Comparison] = field(default_factory=dict)
    modes: pd.DataFrame | None = None
    errors: pd.DataFrame | None = None
    responses: pd.DataFrame | None = None
    notes: tuple[str, ...] = ()
    retried: int = 0
    why_failed: str = ""
    too_few: str = ""

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
    def with_misfit(self) -> pd.DataFrame | None:
        """``unexplained_calibrated.csv``: intervals that know of the misfit of a rejected model; None without them."""
        return self.tables.get(WITH_MISFIT)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences on held-out data that contradict the calibrated model."""
        each = self.modes if self.responses is None else self.responses
        return () if self.errors is None else contradictions(self.errors, each, self.best.statistics.assumed)

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        pairs = {"": (self.before, self.best.answer)}
        return of_fit(
            self.best.statistics,
            self.verdicts,
            pairs,
            self.contradictions,
            self.agreement.verdict,
            _searched(self.cases),
            too_few=self.too_few,
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """Doubts about the measurement, identified parameters, fit, contradictions, agreement of cases, notes."""
        worsened = [_worsened(case) for case in self.cases if case.worsened]
        return (
            *self.doubts, *self.before.std_notes, *self.parameter_sentences, *self.contradictions, *worsened,
            *self.case_sentences, *self.notes,
        )  # fmt: skip

    @property
    def doubts(self) -> tuple[str, ...]:
        """What looks wrong in the measurement itself, seen before the calibration or else after it."""
        return self.before.doubts or self.best.answer.doubts

    @property
    def parameter_sentences(self) -> tuple[str, ...]:
        """What is identified, and whether the model fits."""
        statistics = self.best.statistics
        whole, held = ", ".join(statistics.whole), statistics.considered
        out = [identified_sentence(self.verdicts), *held.loc[held["matters"].astype(bool), "words"]]
        out += statistics.identification.sentences()
        if whole:
            out.append(f"Integers, assessed by how much worse their neighbours fit: {whole}.")
        if not statistics.complete:
            out.append(UNTRIED)
        if statistics.fits is False:
            with_misfit = self.with_misfit
            out.append(_UNHELD if with_misfit is None else parameters_sentence(with_misfit))
        return (*out, *filter(None, [statistics.mesh, statistics.sentence, suspect_sentence(statistics.suspects)]))

    @property
    def case_sentences(self) -> tuple[str, ...]:
        """Whether the cases agree."""
        return agreement_sentences(self.agreement, self.search_agreement)


def _searched(cases: Sequence[CaseFound]) -> str:
    """Errors where the best of the searches ended, which least squares followed; empty where none did."""
    both = [case for case in cases if case.search is not None and case.statistics.fit is not None]
    if not both:
        return ""
    best = min(both, key=lambda case: case.search_full_order)
    (end,) = best.points[best.points["point"] == SEARCH].to_dict("records")
    mac = "" if pd.isna(end["mean_mac"]) else f", mean MAC {end['mean_mac']:.3f}"
    return f"the best search, {best.name}, had ended at a mean error of {100 * end['mean_error']:.2f} %{mac}"


def _worsened(case: CaseFound) -> str:
    """Says that least squares raised the misfit that the search minimised."""
    before, after = case.points.set_index("point").loc[[SEARCH, FITTED]].to_dict("records")
    return (
        f"In {case.name} least squares raised the misfit that the search minimises from {before['objective']:.3g} to "
        f"{after['objective']:.3g}: they weight by standard deviations and include damping and priors, and lowered "
        f"their own sum of squares from {before['total']:.4g} to {after['total']:.4g}. The search's values are in "
        "parameters.csv; refine = false reports them."
    )


@dataclass(frozen=True)
class JointCalibration:
    """Result of a joint calibration.

    Attributes
    ----------
    tests : mapping from str to Calibration
        The results for each test: its comparisons before and after, and its errors. The parameters are joint.
    notes : tuple of str
        How many starts agreed, and why evaluations failed.
    why_failed : str
        The latter alone; empty where none did.
    """

    tests: Mapping[str, Calibration]
    notes: tuple[str, ...] = ()
    why_failed: str = ""

    @property
    def any(self) -> Calibration:
        """The results for one test, for what all share: the parameters and their fit statistics."""
        return next(iter(self.tests.values()))

    def seen(self, test: str) -> Calibration:
        """The results for one test."""
        return self.tests[test]

    @property
    def too_few(self) -> str:
        """Why an explanation would refuse the data; empty where it would not."""
        return self.any.too_few

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Tables on the parameters, from all tests together."""
        return self.any.tables

    @property
    def doubts(self) -> tuple[str, ...]:
        """What looks wrong in the measurements themselves, test by test."""
        return tuple(of_test(test, words) for test, one in self.tests.items() for words in one.doubts)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Sentences on held-out data that contradict the calibrated models."""
        return tuple(of_test(test, words) for test, one in self.tests.items() for words in one.contradictions)

    @property
    def verdicts(self) -> pd.DataFrame:
        """One row per parameter, from all tests together."""
        return self.any.verdicts

    @property
    def answer(self) -> Answer:
        """What was found, how sure that is, and what to do next."""
        pairs = {test: (one.before, one.best.answer) for test, one in self.tests.items()}
        one = self.any
        return of_fit(
            one.best.statistics,
            self.verdicts,
            pairs,
            self.contradictions,
            one.agreement.verdict,
            too_few=one.too_few,
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """Identified parameters, goodness of fit, and the errors of each test before and after."""
        out = [*self.doubts, *self.any.parameter_sentences, *self.any.case_sentences, *self.notes]
        for test, answer in self.tests.items():
            before, after = answer.before.mean_freq_error, answer.best.answer.mean_freq_error
            of = "" if answer.before.comparison is None else " of natural frequencies"
            out.append(
                of_test(test, f"mean absolute error{of} {100 * before:.2f} % before, {100 * after:.2f} % after.")
            )
            out += [of_test(test, words) for words in (*answer.contradictions, *answer.notes)]
        return tuple(out)


Fitted: TypeAlias = Calibration | JointCalibration


# -- the case that is reported -----------------------------------------------------------------------------------------


def with_starts(agreed: Agreement, cases: Sequence[CaseFound], space: ParameterSpace) -> Agreement:
    """Agreement of the cases, or of the starts of the first case whose own starts already end in several solutions.

    Cases that each report the best of the same solutions agree without the solution being unique.
    """
    if agreed.verdict == "several solutions":
        return agreed
    for case in cases:
        within = case.statistics.agreement(space)
        if within is not None and within.verdict == "several solutions":
            return replace(within, sentence=f"Starts of case {case.name}: {within.sentence}")
    return agreed


def best_of(tests: Sequence[Sequence[CaseFound]]) -> int:
    """Number of the case that is reported, see `Calibration.best`; of several tests the same for all.

    ``tests`` holds the cases of each test. Their statistics are joint; their misfits add up.
    """
    every = [case.statistics for case in tests[0]]
    equal = [k for k, statistics in enumerate(every) if statistics.fit is not None]
    if equal:
        lowest = min(every[k].criterion for k in equal)
        equal = [k for k in equal if every[k].criterion <= lowest + RULES.equal]
    return min(equal or range(len(every)), key=lambda k: sum(cases[k].result.misfit for cases in tests))


def summed(tests: Sequence[Sequence[CaseFound]]) -> list[CaseResult]:
    """The cases with the misfits of all tests added up: together the tests discriminate where one does not."""
    every = zip(*tests, strict=True)
    return [replace(each[0].result, misfit=sum(one.result.misfit for one in each)) for each in every]
