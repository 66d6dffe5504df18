"""The case that a calibration reports, and whether all cases and their starts found one solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.analyses.case import CaseFound
from calib.analyses.fit_statistics import EQUAL
from calib.inference.cases import Agreement, CaseResult
from calib.space import ParameterSpace


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
        equal = [k for k in equal if every[k].criterion <= lowest + EQUAL]
    return min(equal or range(len(every)), key=lambda k: sum(cases[k].result.misfit for cases in tests))


def summed(tests: Sequence[Sequence[CaseFound]]) -> list[CaseResult]:
    """The cases with the misfits of all tests added up: together the tests discriminate where one does not."""
    every = zip(*tests, strict=True)
    return [replace(each[0].result, misfit=sum(one.result.misfit for one in each)) for each in every]


def agreement_sentences(own: Agreement, searched: Agreement | None) -> tuple[str, ...]:
    """Whether the cases agree, in words; ``searched`` is the agreement of the searches before least squares."""
    out = [own.sentence]
    if searched is not None:
        out = [f"After least squares, which also weighs the priors, {_going_on(own.sentence)}", _before(searched, own)]
    return (*out, own.remedy) if own.remedy else tuple(out)


def _before(searched: Agreement, own: Agreement) -> str:
    if (searched.verdict, own.verdict) != ("several solutions", "one solution"):
        return f"In the searches alone, {_going_on(searched.sentence)}"
    name, width = next(iter(searched.differing.items()))
    return (
        f"The searches alone had ended in {len(searched.solutions)} places, up to {100 * width:.0f} % of the range "
        f"apart ({name}); least squares led from all of them to that solution."
    )


def _going_on(sentence: str) -> str:
    """A sentence behind the beginning of another."""
    return f"{sentence[:1].lower()}{sentence[1:]}"
