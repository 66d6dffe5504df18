"""Least-squares fits of a study, from several starts and at full order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

from calib.analyses.fit_statistics import FitProblem, FitStatistics, Near, ObjectiveTerms, statistics_of
from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress, silent
from calib.hypotheses.modal_start import modal_leap
from calib.inference.even_weights import EvenWeights
from calib.inference.gauss_newton import DEFAULT, FitSettings
from calib.inference.integers import MixedResult, fit_mixed
from calib.inference.region import InfeasibleError
from calib.inference.rules import RULES
from calib.inference.starts import Enough, never
from calib.problem.prior import Prior

FitProgress = Callable[[int, int, float], None]

LEAST_SQUARES = "least squares"
"""Name of the stage of a fit."""
_POLISHED = FitSettings(gain=1e-4)
"""Of the fit at full order: a step that lowers the sum of squares by less, one of a hundredth of a posterior standard
deviation, is not worth another solution."""
_WIDENED = 6
"""Times that a basis may grow where fits end; the fit at full order goes on from there."""
_OPTIMA = 2
"""Lowest optima at which a basis must be accurate."""


def criteria(problem: FitProblem, values: Mapping[str, float]) -> tuple[float, float]:
    """Sums of squares of data and priors at given values; infinite where the model cannot be evaluated."""
    names = [p.name for p in problem.space.free if not p.integer]
    try:
        vector = problem.residual(values)
    except EvaluationError:
        return math.inf, math.inf
    own = Prior.of(problem.space).rows(values, names)[0]
    return float(vector @ vector), float(own @ own)


@dataclass(frozen=True, eq=False)
class Shared:
    """Fits from starting points that all cases share; None where there is none, or it cannot be evaluated.

    Attributes
    ----------
    nominal : MixedResult or None
        From the nominal values.
    known : MixedResult or None
        From points that are known to fit.
    """

    nominal: MixedResult | None
    known: MixedResult | None


def ended(
    problem: FitProblem, starts: Sequence[Mapping[str, float]], refits: int, told: Progress = silent
) -> MixedResult | None:
    """Best least-squares fit from some starts; None without one, or where none can be evaluated or is feasible."""
    with suppress(EvaluationError, InfeasibleError):
        step = partial(told, LEAST_SQUARES, total=1)
        first = EvenWeights.of(problem, modal_leap(problem))
        return fit_mixed(problem, problem.space, starts, refits=refits, step=step, first=first) if starts else None
    return None


def fitted(
    problem: FitProblem,
    terms: ObjectiveTerms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    before: FitStatistics | None = None,
    shared: Shared | None = None,
    told: Progress = silent,
    stage: str = LEAST_SQUARES,
    enough: Enough = never,
    near: Near | None = None,
    settings: FitSettings = DEFAULT,
) -> FitStatistics:
    """The best least-squares fit from several starts, with the limits, constraints and priors of the problem's space.

    ``refits`` bounds the integer combinations tried from every start. ``before`` is an earlier fit that tried them, for
    a final fit that tries no more. ``shared`` holds fits of the same residual from further starts: the fit from the
    nominal values replaces the own one only if its data misfit is lower by more than `Rules.equal`, the fit from known
    points if it is better in data and priors together. ``told`` receives the progress of the stage of that name.
    ``enough`` tells after every start whether the others may be left out. ``near`` as in
    `calib.analyses.fit_statistics.statistics_of`.
    """
    space = problem.space
    first = None if before else EvenWeights.of(problem, modal_leap(problem))
    found: MixedResult = fit_mixed(
        problem, space, starts, settings=settings, refits=refits, progress=progress,
        step=partial(told, stage, total=1), enough=enough, first=first,
    )  # fmt: skip
    told("identifiability")
    if shared is not None and shared.nominal is not None:
        found = found.joined(shared.nominal, RULES.equal)
    if shared is not None and shared.known is not None:
        found = found.joined(shared.known)
    if before is not None:
        profiles, complete = before.profiles, before.complete
    else:
        profiles, complete = {p.name: found.profile(p.name) for p in space.free if p.integer}, found.complete
    return statistics_of(problem, terms, found.best.values, found.best, profiles, complete, found.by_start, near)


def fitted_at_full_order(
    exact: FitProblem,
    reduced: FitProblem | None,
    terms: ObjectiveTerms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    known: Sequence[Mapping[str, float]] = (),
    shared: Shared | None = None,
    told: Progress = silent,
    enough: Enough = never,
    near: Callable[[], Near | None] = lambda: None,
    widened: Callable[[Sequence[Mapping[str, float]]], FitProblem | None] = lambda points: None,
) -> FitStatistics:
    """Least squares as in `fitted`, first on a reduced problem if there is one, then at full order.

    Where the reduced problem is not accurate at the lowest ends of its fits, one that is goes on from there:
    ``widened`` makes it, and gives None where it is accurate. The full-order fit starts from the best of the reduced
    fit and ``known``, so that it never ends above them. ``near`` is asked at the end.
    """
    if reduced is None:
        return fitted(exact, terms, starts, refits, progress, shared=shared, told=told, enough=enough, near=near())
    exactly = replace(terms, held_sd={}, mesh_sd=None)  # whose statistics nobody asks for
    found = fitted(reduced, exactly, starts, refits, progress, shared=shared, told=told, enough=enough)
    for _ in range(_WIDENED):
        lowest = _lowest(found)
        wider = widened(lowest)
        if wider is None:
            break
        found = fitted(wider, exactly, lowest, 1, before=found, told=told)
    begin = min((found.values, *known), key=lambda values: sum(criteria(exact, values)))
    stage = f"{LEAST_SQUARES} at full order"
    return fitted(exact, terms, [begin], 1, before=found, told=told, stage=stage, near=near(), settings=_POLISHED)


def _lowest(found: FitStatistics) -> list[Mapping[str, float]]:
    """The values of a fit, and the other optima next to its lowest."""
    ends = sorted((end for end in found.ends if end.converged), key=lambda end: end.misfit)
    apart = [low for low, high in pairwise(ends) if high.misfit - low.misfit > RULES.equal] + ends[-1:]
    others = [end.values for end in apart if abs(end.misfit - found.criterion) > RULES.equal]
    return [found.values, *others[: _OPTIMA - 1]]
