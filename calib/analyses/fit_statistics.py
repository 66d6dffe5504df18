"""Least-squares fits of a study, and their fit statistics: goodness of fit, identifiability, predictions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.analyses.uncertainty import assumed_words, in_one
from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress, silent
from calib.experiment.test import ForwardProblem
from calib.inference.agreement import Agreement, agreement
from calib.inference.cases import CaseResult
from calib.inference.constraints import ConstraintRows, Hold, constraint_rows, holds, multipliers
from calib.inference.gauss_newton import FitResult, Prior
from calib.inference.identify import Identifiability, identify, posterior, prediction_interval
from calib.inference.integers import MixedResult, fit_mixed
from calib.inference.joint_part import COLUMNS, JointPart, joint_parts, std_by_test
from calib.inference.region import InfeasibleError, active_limits
from calib.inference.rules import RULES
from calib.inference.starts import Enough, never
from calib.inference.verdicts import integer_std, parameter_verdicts
from calib.missing.goodness import goodness, misfit_factor, overall
from calib.missing.rules import RULES as MISSING
from calib.missing.suspect import suspects_table
from calib.problem.degrees_of_freedom import effective_dof
from calib.problem.joint import JointProblem
from calib.problem.problem import Counts, PairProblem
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger
from calib.study.several import AnyStudy

FitProgress = Callable[[int, int, float], None]
Profiles: TypeAlias = Mapping[str, tuple[np.ndarray, np.ndarray]]
FitProblem: TypeAlias = PairProblem[Any] | JointProblem

LEAST_SQUARES = "least squares"
"""Name of the stage of a fit."""


def fit_problem(
    study: AnyStudy,
    ledger: Ledger,
    instead: Mapping[str, ForwardProblem] = MappingProxyType({}),
    counts: Counts | None = None,
) -> FitProblem:
    """The fit problem of a study: its measurements against its models, every solved point in the ledger.

    ``instead`` holds problems that replace the study's own, for example reduced ones, by name of the test; ``counts``
    counts every requested point.
    """
    counts, several = counts or Counts(), len(study.studies) > 1
    parts = {}
    for one in study.studies:
        pair = one.experiment.residual(instead.get(one.test, one.problem))
        space = one.search_space.without(one.condition) if several else one.search_space
        parts[one.test] = PairProblem(pair, space, ledger, counts=counts)
    return JointProblem(parts) if several else next(iter(parts.values()))


@dataclass(frozen=True)
class Terms:
    """Inputs of the fit statistics beside the problem.

    Attributes
    ----------
    alpha : float
        Level of the test of the overall fit.
    held_sd : mapping from str to float
        Standard deviations of held parameters that an earlier study determined; see `identify`.
    assumed : str
        Assumed standard deviations, in words; see `calib.analyses.uncertainty.assumed_words`.
    """

    alpha: float = MISSING.suspect
    held_sd: Mapping[str, float] = field(default_factory=dict)
    assumed: str = ""

    @classmethod
    def of(cls, study: AnyStudy) -> Terms:
        """The terms of a study."""
        return cls(study.settings.explain.alpha, study.held_sd, in_one(study, assumed_words))


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """Fit statistics at one set of values.

    Attributes
    ----------
    values : dict
        All parameters, each in its own unit.
    misfit, prior_misfit : float
        Sums of squares of the whitened residual and of the priors; least squares minimise the total.
    dof : float
        Effective degrees of freedom of the residual; see `calib.problem.degrees_of_freedom.effective_dof`.
    p_fit : float
        Probability that a correctly specified model fits as badly; the same test as in an explanation, see
        `calib.missing.goodness.overall`.
    alpha : float
        Level of that test.
    birge : float
        Birge ratio: where the model does not fit, the factor on the standard deviation that brings the worst kind of
        data to its expected misfit (see `calib.missing.goodness.misfit_factor`), else 1. Parameter standard
        deviations, shares and predictions use the scaled standard deviation; unseen directions use the stated one.
    identification : Identification
    profiles : mapping from str to (numbers, misfits)
        Lowest misfit at each tried value of every integer; empty without fits.
    whole : mapping from str to float
        Standard deviations of integer parameters, from these profiles.
    complete : bool
        Whether the fit tried all neighbours of its integers.
    predictions : DataFrame
        ``mode, natural_freq, std, lower, upper``.
    fit : FitResult or None
        The least-squares fit that led here.
    ends : tuple of FitResult
        Fits from all starts, on the same problem; empty without fits.
    suspects : DataFrame
        Data without which the model fits, see `calib.missing.suspect.suspects_table`; empty without a converged fit.
    assumed : str
        Assumed standard deviations that this rests on; see `calib.analyses.uncertainty.assumed_words`.
    by_test : DataFrame
        What each of several tests alone would determine, see `calib.inference.joint_part.std_by_test`; empty for one.
    parts : mapping from str to JointPart
        What the fit says about the parameters of each of several tests, by its name; of one test only where constraints
        count as data.
    active : frozenset of str
        Parameters with an active limit, see `calib.inference.region.active_limits`.
    held_by : mapping from str to Hold
        Limits and constraints that hold parameters, see `calib.inference.constraints.holds`.
    """

    values: dict[str, float]
    misfit: float
    prior_misfit: float
    dof: float
    p_fit: float
    alpha: float
    birge: float
    identification: Identifiability
    profiles: Profiles
    whole: Mapping[str, float]
    complete: bool
    predictions: pd.DataFrame
    fit: FitResult | None
    ends: tuple[FitResult, ...]
    suspects: pd.DataFrame
    assumed: str
    by_test: pd.DataFrame
    parts: Mapping[str, JointPart]
    active: frozenset[str]
    held_by: Mapping[str, Hold]

    def verdicts(
        self, space: ParameterSpace, spread: Mapping[str, float], differing: Mapping[str, float] | None = None
    ) -> pd.DataFrame:
        """One verdict per parameter; see `calib.inference.verdicts.parameter_verdicts`."""
        table = parameter_verdicts(
            space, self.values, self.identification, spread, self.whole, self.fits, self.birge, differing, self.held_by
        )
        more = " This rests on an assumed standard deviation." if self.assumed else ""
        words = table["sentence"].where(table["std"].isna(), table["sentence"] + more)
        return table.assign(std_from=self.rests_on, sentence=words)

    def part(self, test: str) -> JointPart | None:
        """What the fit says about the parameters of one test; None where its own rows say all."""
        return self.parts.get(test, self.parts.get(""))

    def agreement(self, space: ParameterSpace) -> Agreement | None:
        """Whether the starts whose fits meet the data as well as this one agree; None for fewer than two of them."""
        good = [
            replace(CaseResult.fitted(f"start {k}", end.values, Counts(), pd.DataFrame(), 0.0), misfit=end.data_misfit)
            for k, end in enumerate(self.ends, start=1)
            if end.data_misfit <= self.misfit + RULES.equal
        ]
        return agreement(good, space, level=self.misfit + RULES.equal) if len(good) > 1 else None

    @property
    def figures(self) -> dict[str, object]:
        """Entries of ``summary.json``."""
        return {
            "whitened_misfit": self.misfit,
            "degrees_of_freedom": self.dof,
            "p_fit": self.p_fit,
            "birge": self.birge,
            "std_assumed": self.assumed,
        }

    @property
    def rests_on(self) -> str:
        """Origin of the standard deviation: ``stated`` or ``assumed``."""
        return "assumed" if self.assumed else "stated"

    @property
    def criterion(self) -> float:
        """The sum of squares that least squares minimise: data and priors."""
        return self.misfit + self.prior_misfit

    @property
    def fits(self) -> bool | None:
        """Whether the model fits within the standard deviation; None if it does with as many unknowns as data."""
        if self.p_fit <= self.alpha:
            return False
        return True if self.dof >= 1 else None

    @property
    def sentence(self) -> str:
        """Whether the model fits within the standard deviation, in words."""
        words = (
            f"Sum of squares {self.misfit:.4g} in standard deviations, {max(self.dof, 0.0):.1f} effective degrees "
            f"of freedom, p = {self.p_fit:.2g} for the worst kind of data: "
        )
        if self.fits is None:
            return words + "as many unknowns as data, so a perfect fit says nothing about the model."
        rests = f", which is assumed: {self.assumed}" if self.assumed else ""
        if self.fits:
            return words + f"the model fits within the standard deviation{rests}."
        few = "with as many unknowns as data " if self.dof < 1 else ""
        wider = f"parameter uncertainties are computed for {self.birge:.2g} times the standard deviation"
        return (
            words + f"{few}the model does not fit within the standard deviation{rests}; something is missing; {wider}."
        )


def criteria(problem: FitProblem, values: Mapping[str, float]) -> tuple[float, float]:
    """Sums of squares of data and priors at given values; infinite where the model cannot be evaluated."""
    names = [p.name for p in problem.space.free if not p.integer]
    try:
        vector = problem.residual(values)
    except EvaluationError:
        return math.inf, math.inf
    own = Prior.of(problem.space).residual(values, names)
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
        return fit_mixed(problem, problem.space, starts, refits=refits, step=step) if starts else None
    return None


def fitted(
    problem: FitProblem,
    terms: Terms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    before: FitStatistics | None = None,
    shared: Shared | None = None,
    told: Progress = silent,
    stage: str = LEAST_SQUARES,
    enough: Enough = never,
) -> FitStatistics:
    """The best least-squares fit from several starts, with the limits, constraints and priors of the problem's space.

    ``refits`` bounds the integer combinations tried from every start. ``before`` is an earlier fit that tried them, for
    a final fit that tries no more. ``shared`` holds fits of the same residual from further starts: the fit from the
    nominal values replaces the own one only if its data misfit is lower by more than `Rules.equal`, the fit from known
    points if it is better in data and priors together. ``told`` receives the progress of the stage of that name.
    ``enough`` tells after every start whether the others may be left out.
    """
    space = problem.space
    found: MixedResult = fit_mixed(
        problem, space, starts, refits=refits, progress=progress, step=partial(told, stage, total=1), enough=enough
    )
    told("identifiability")
    if shared is not None and shared.nominal is not None:
        found = found.joined(shared.nominal, RULES.equal)
    if shared is not None and shared.known is not None:
        found = found.joined(shared.known)
    if before is not None:
        profiles, complete = before.profiles, before.complete
    else:
        profiles, complete = {p.name: found.profile(p.name) for p in space.free if p.integer}, found.complete
    return _statistics(problem, terms, found.best.values, found.best, profiles, complete, found.by_start)


def fitted_at_full_order(
    exact: FitProblem,
    near: FitProblem | None,
    terms: Terms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    known: Sequence[Mapping[str, float]] = (),
    shared: Shared | None = None,
    told: Progress = silent,
    enough: Enough = never,
) -> FitStatistics:
    """Least squares as in `fitted`, first on a reduced problem if there is one, then at full order.

    The full-order fit starts from the best of the reduced fit and ``known``, so that it never ends above them.
    """
    first = exact if near is None else near
    found = fitted(first, terms, starts, refits, progress, shared=shared, told=told, enough=enough)
    if near is None:
        return found
    begin = min((found.values, *known), key=lambda values: sum(criteria(exact, values)))
    return fitted(exact, terms, [begin], 1, before=found, told=told, stage=f"{LEAST_SQUARES} at full order")


def statistics_at(problem: FitProblem, terms: Terms, values: Mapping[str, float]) -> FitStatistics:
    """Fit statistics at given values, without a fit."""
    return _statistics(problem, terms, dict(values), None, {}, True)


def _statistics(
    problem: FitProblem,
    terms: Terms,
    values: dict[str, float],
    fit: FitResult | None,
    profiles: Profiles,
    complete: bool,
    ends: tuple[FitResult, ...] = (),
) -> FitStatistics:
    space, alpha, held_sd = problem.space, terms.alpha, terms.held_sd
    names = tuple(p.name for p in space.free if not p.integer)
    if fit is not None and fit.names == names:
        vector, slope = fit.residual, fit.jacobian
    else:
        vector, slope = problem.residual(values), problem.jacobian(values, names)
    held = problem.jacobian(values, tuple(held_sd)) * list(held_sd.values()) if held_sd else None
    prior_sd = np.array([space[n].prior_width for n in names])
    constraints = constraint_rows(space, names, posterior(names, slope, prior_sd).covariance, held_sd)
    misfit, shift = float(vector @ vector), Prior.of(space).residual(values, names)
    at = _Fitted.of(vector, slope, prior_sd, constraints, fit is not None and fit.converged)
    dof = effective_dof(at.slope, at.prior_sd, sum(problem.fitted_factors.values()))
    kinds, modes = goodness(at, problem)
    p_fit, birge = overall(kinds, modes), misfit_factor(kinds, modes, alpha)
    whole = {
        name: integer_std(numbers, misfits / birge**2, space[name].value, space[name].prior_width)
        for name, (numbers, misfits) in profiles.items()
    }
    identification = identify(
        space, names, slope, values=values, held=held, birge=birge, searched=fit is None, constraints=constraints
    )
    descent = multipliers(space, names, values, -slope.T @ vector - shift / prior_sd)
    held_by = holds(
        space, names, values, identification.posterior.covariance, -slope.T @ vector - shift / prior_sd, fit is None
    )
    predictions = prediction_interval(*problem.frequencies(values, names), identification.posterior.covariance)
    suspected = suspects_table(at, problem, alpha)
    by_test, parts = pd.DataFrame(columns=list(COLUMNS)), dict[str, JointPart]()
    if isinstance(problem, JointProblem):
        by_test = std_by_test(space, names, slope, [row.test for row in problem.rows], held, birge, constraints)
    if isinstance(problem, JointProblem) or len(constraints.slope):
        parts = joint_parts(problem, names, vector, slope, prior_sd, shift, held, held_sd, constraints)
    return FitStatistics(
        values=values, misfit=misfit, prior_misfit=float(shift @ shift), dof=dof, p_fit=p_fit, alpha=alpha,
        birge=birge, identification=identification, profiles=profiles, whole=whole, complete=complete,
        predictions=predictions, fit=fit, ends=ends, suspects=suspected,
        assumed=terms.assumed, by_test=by_test, parts=parts,
        active=active_limits(space, names, values, descent), held_by=held_by,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fitted:
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    converged: bool

    @classmethod
    def of(
        cls, residual: np.ndarray, slope: np.ndarray, prior_sd: np.ndarray, constraints: ConstraintRows, converged: bool
    ) -> _Fitted:
        """The fit in parameters whose priors are independent where constraints count as data beside them."""
        if not len(constraints.slope):
            return cls(residual, slope, prior_sd, converged)
        root = la.qr(np.vstack([constraints.slope * prior_sd, np.eye(len(prior_sd))]), mode="r")[0][: len(prior_sd)]
        own = la.solve_triangular(root, (slope * prior_sd).T, trans="T").T
        return cls(residual, own, np.ones(len(prior_sd)), converged)
