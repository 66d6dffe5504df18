"""The case that a calibration reports, and whether all cases and their starts found one solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.analyses.case import CaseFound
from calib.inference.agreement import Agreement
from calib.inference.cases import CaseResult
from calib.inference.rules import RULES
from calib.problem.space import ParameterSpace


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
