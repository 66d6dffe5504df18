"""Agreement: whether independent searches, or fits from several starts, found one solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from calib.inference.cases import CaseResult, convergence_table, parameters_table, ratios
from calib.inference.identify import needed_std
from calib.inference.rules import RULES
from calib.problem.space import ParameterSpace

_NAMED = 3
"""Parameters that a sentence names as differing; the table has all."""


@dataclass(frozen=True)
class Agreement:
    """Whether the cases found one solution.

    Attributes
    ----------
    verdict : {"one case", "one solution", "several solutions", "not settled"}
    solutions : tuple of tuple of str
        Cases that fit as well as the best one, grouped by solution, best first.
    worse : tuple of str
        Cases that fit less well and therefore say nothing about uniqueness.
    differing : mapping from str to float
        Parameters by which the solutions differ, and their largest differences over the range, largest first.
    sentence : str
    """

    verdict: Literal["one case", "one solution", "several solutions", "not settled"]
    solutions: tuple[tuple[str, ...], ...]
    worse: tuple[str, ...]
    differing: Mapping[str, float]
    sentence: str

    @property
    def remedy(self) -> str:
        """What to do where a better solution may be left; empty otherwise."""
        return "Give the search more generations or more cases." if self.verdict == "not settled" else ""


def agreement(results: Sequence[CaseResult], space: ParameterSpace, level: float = 0.0) -> Agreement:
    """Compare the parameters of cases that fit equally well; where they differ, the data do not determine them.

    Two cases fit equally well when both misfits are below the level that the measurement uncertainty allows, or within
    `Rules.nearly_equal` of the best one. They are different solutions when a parameter differs by more than the
    standard deviation that is needed of it; see `calib.inference.identify.needed_std`.

    Parameters
    ----------
    results : sequence of CaseResult
        At least one.
    space : ParameterSpace
    level : float
        Misfit that the measurement uncertainty alone would allow; 0 where unknown.
    """
    order = sorted(range(len(results)), key=lambda k: results[k].misfit)
    limit = max(level, results[order[0]].misfit * (1 + RULES.nearly_equal))
    good = [k for k in order if results[k].misfit <= limit]
    worse = tuple(results[k].name for k in order if k not in good)
    position = ratios(results, space)
    needed = np.array([needed_std(p) / p.span_at(p.value) for p in space.free])
    groups = _solutions(position, good, needed)
    solutions = tuple(tuple(results[k].name for k in group) for group in groups)
    spread = np.ptp(position[good], axis=0)
    apart = sorted(np.flatnonzero(spread > needed).tolist(), key=lambda j: -spread[j])
    differing = {space.free_names[j]: float(spread[j]) for j in apart}

    def described(group: Sequence[int]) -> str:
        names = ", ".join(results[k].name for k in group)
        misfits = [results[k].misfit for k in group]
        low, high = f"{min(misfits):.4g}", f"{max(misfits):.4g}"
        return f"{names} (misfit {low if low == high else f'{low} to {high}'})"

    verdict: Literal["one case", "one solution", "several solutions", "not settled"]
    left = f" {described([k for k in order if k not in good])} ended at a higher misfit." if worse else ""
    if len(results) == 1:
        verdict = "one case"
        sentence = "Only one case was run, so whether its solution is unique was not tested."
    elif len(groups) > 1:
        verdict = "several solutions"
        ways = " and ".join(described(group) for group in groups)
        widths = [f"{name} by {100 * width:.0f} %" for name, width in differing.items()]
        more = f" and {len(widths) - _NAMED} more by less" * (len(widths) > _NAMED)
        sentence = (
            f"The solution is not unique: {len(groups)} sets of parameters fit equally well, {ways}. These data do not "
            f"determine what differs between them: {', '.join(widths[:_NAMED])}{more} of the search range.{left}"
        )
    elif len(good) > 1:
        verdict = "one solution"
        sentence = (
            f"The cases {described(good)} agree on one solution: their parameters differ by "
            f"{_at_most(float(spread.max()))} of the search range.{left}"
        )
    else:
        verdict = "not settled"
        sentence = f"Only {described(good)} reaches the lowest misfit.{left}"
    return Agreement(verdict, solutions, worse, differing, sentence)


def _solutions(position: np.ndarray, good: Sequence[int], needed: np.ndarray) -> list[list[int]]:
    """Cases in the order given, grouped so that no two of a group differ by more than ``needed``, over the range."""
    groups: list[list[int]] = []
    for k in good:
        for group in groups:
            if np.all(np.abs(position[group] - position[k]) <= needed):
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _at_most(share: float) -> str:
    return "less than 0.1 %" if share < 0.001 else f"at most {100 * share:.1f} %"


def agreement_sentences(own: Agreement | None, searched: Agreement | None) -> tuple[str, ...]:
    """Whether fits or searches agree, in words.

    Parameters
    ----------
    own : Agreement or None
        Of what is reported; None where fewer than two starts of a fit met the data equally well.
    searched : Agreement or None
        Of the searches before least squares; None without these.
    """
    if own is None and searched is None:
        return ()
    if own is None:
        assert searched is not None
        return (_alone(searched), searched.remedy) if searched.remedy else (_alone(searched),)
    out = [own.sentence]
    if searched is not None:
        out = [f"After least squares, which also weighs the priors, {_going_on(own.sentence)}", _before(searched, own)]
    return (*out, own.remedy) if own.remedy else tuple(out)


def _before(searched: Agreement, own: Agreement) -> str:
    if (searched.verdict, own.verdict) != ("several solutions", "one solution"):
        return _alone(searched)
    name, width = next(iter(searched.differing.items()))
    return (
        f"The searches alone had ended in {len(searched.solutions)} places, up to {100 * width:.0f} % of the "
        f"search range apart ({name}); least squares led from all of them to that solution."
    )


def _alone(searched: Agreement) -> str:
    return f"In the searches alone, {_going_on(searched.sentence)}"


def _going_on(sentence: str) -> str:
    """A sentence behind the beginning of another."""
    return f"{sentence[:1].lower()}{sentence[1:]}"


@dataclass(frozen=True, eq=False)
class Searched:
    """Independent runs of a genetic search, before any least squares.

    Attributes
    ----------
    space : ParameterSpace
        The searched space.
    cases : tuple of CaseResult
        One per seed.
    """

    space: ParameterSpace
    cases: tuple[CaseResult, ...]

    @property
    def agreement(self) -> Agreement:
        """Whether the cases found one solution."""
        return agreement(self.cases, self.space)

    @property
    def best(self) -> tuple[CaseResult, ...]:
        """The cases sorted by their misfit, the lowest first."""
        return tuple(sorted(self.cases, key=lambda case: case.misfit))

    @property
    def table(self) -> pd.DataFrame:
        """One row per case: ``case, misfit, asked, solved, reused, infeasible, failed``; see `CaseResult`."""
        columns = ["name", "misfit", "asked", "solved", "reused", "infeasible", "failed"]
        rows = [[getattr(case, column) for column in columns] for case in self.cases]
        return pd.DataFrame(rows, columns=["case", *columns[1:]])

    @property
    def parameters(self) -> pd.DataFrame:
        """Where each case ended; see `calib.inference.cases.parameters_table`."""
        return parameters_table(self.cases, self.space)

    @property
    def convergence(self) -> pd.DataFrame:
        """Misfit over the generations; see `calib.inference.cases.convergence_table`."""
        return convergence_table(self.cases)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Whether the cases agree."""
        return agreement_sentences(self.agreement, None)
