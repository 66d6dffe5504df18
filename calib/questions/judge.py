"""Least squares from where a search ended, and what can be told about the parameters there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.errors import EvaluationError
from calib.forward import ForwardProblem
from calib.freedom import effective_freedom
from calib.inference.gauss_newton import FitResult, Prior
from calib.inference.identify import Identification, identify, prediction_interval
from calib.inference.region import InfeasibleError
from calib.inference.verdicts import parameter_verdicts, whole_number_std
from calib.inference.whole_numbers import MixedResult, fit_mixed
from calib.joint import JointProblem
from calib.ledger import Ledger
from calib.missing.goodness import goodness, misfit_factor, overall
from calib.missing.suspect import LEVEL, suspects
from calib.problem import Counts, Pair, Problem
from calib.questions.scatter import assumed_words, in_one
from calib.several import AnyStudy
from calib.space import ParameterSpace
from calib.study import Study

FitProgress = Callable[[int, int, float], None]
Profiles: TypeAlias = Mapping[str, tuple[np.ndarray, np.ndarray]]
Asked: TypeAlias = Problem[Pair] | JointProblem

EQUAL = 0.1
"""Difference of sums of squares that says nothing: a third of a standard deviation of one parameter."""


def posed(
    study: Study, ledger: Ledger, problem: ForwardProblem | None = None, counts: Counts | None = None
) -> Problem[Pair]:
    """What a study's fits ask: its measurement against its model, every solved point in the ledger.

    ``problem`` is a reduced stand-in for the study's own; ``counts`` is told every point that is asked.
    """
    asked = study.problem if problem is None else problem
    pair: Pair = ResponseResidual(asked) if isinstance(asked, FunctionProblem) else ModalResidual(asked)
    return Problem(pair, study.search_space.without(study.condition), ledger, counts=counts or Counts())


@dataclass(frozen=True)
class Terms:
    """What a fit is judged by, beside its problem.

    Attributes
    ----------
    alpha : float
        Level of the test of the fit as a whole.
    held_sd : mapping from str to float
        Standard deviations of parameters that are held and were found earlier; see `identify`.
    assumed : str
        Standard deviations that nobody stated; see `calib.questions.scatter.assumed_words`.
    """

    alpha: float = LEVEL
    held_sd: Mapping[str, float] = field(default_factory=dict)
    assumed: str = ""

    @classmethod
    def of(cls, study: AnyStudy) -> Terms:
        """Those of a study."""
        return cls(study.settings.explain.alpha, study.held_sd, in_one(study, assumed_words))


@dataclass(frozen=True, eq=False)
class Judgement:
    """What is known at one set of values.

    Attributes
    ----------
    values : dict
        All parameters, each in its own unit.
    misfit, prior_misfit : float
        Sums of squares of the whitened residual and of the priors'; least squares make their sum small.
    freedom : float
        Effective degrees of freedom of the residual; see `calib.freedom.effective_freedom`.
    p_fit : float
        Chance of a right model fitting as badly; the test of an explanation, see `calib.missing.goodness.overall`.
    alpha : float
        Level of that test.
    birge : float
        Factor on the scatter with which the worst kind of data would be as a right model has it, where the model does
        not fit (see `calib.missing.goodness.misfit_factor`), else 1; standard deviations, shares and predictions hold
        for the scatter so scaled, what the data see of combined changes for the scatter as stated.
    identification : Identification
    profiles : mapping from str to (numbers, misfits)
        Lowest misfit of each whole number that was tried; empty without fits.
    whole : mapping from str to float
        Standard deviations of whole-number parameters, from those.
    complete : bool
        Whether the fit tried all neighbours of its whole numbers.
    predictions : DataFrame
        ``mode, natural_freq, std, lower, upper``.
    fit : FitResult or None
        The least-squares fit that led here.
    suspects : DataFrame
        Data without which everything fits, see `calib.missing.suspect.suspects`; empty without a converged fit.
    assumed : str
        Standard deviations that nobody stated and this rests on; see `calib.questions.scatter.assumed_words`.
    """

    values: dict[str, float]
    misfit: float
    prior_misfit: float
    freedom: float
    p_fit: float
    alpha: float
    birge: float
    identification: Identification
    profiles: Profiles
    whole: Mapping[str, float]
    complete: bool
    predictions: pd.DataFrame
    fit: FitResult | None
    suspects: pd.DataFrame
    assumed: str = ""

    def verdicts(self, space: ParameterSpace, spread: Mapping[str, float]) -> pd.DataFrame:
        """One verdict a parameter; see `calib.inference.verdicts.parameter_verdicts`."""
        table = parameter_verdicts(space, self.values, self.identification, spread, self.whole, self.fits, self.birge)
        more = " The scatter behind it is assumed." if self.assumed else ""
        words = table["sentence"].where(table["std"].isna(), table["sentence"] + more)
        return table.assign(scatter=self.rests_on, sentence=words)

    @property
    def figures(self) -> dict[str, object]:
        """What ``summary.json`` tells of it."""
        return {
            "whitened_misfit": self.misfit,
            "degrees_of_freedom": self.freedom,
            "p_fit": self.p_fit,
            "birge": self.birge,
            "scatter_assumed": self.assumed,
        }

    @property
    def rests_on(self) -> str:
        """Whether the scatter behind it is ``stated`` or ``assumed``."""
        return "assumed" if self.assumed else "stated"

    @property
    def criterion(self) -> float:
        """What least squares make small: data and priors."""
        return self.misfit + self.prior_misfit

    @property
    def fits(self) -> bool | None:
        """Whether the model fits within the scatter; None when there are as many unknowns as data and it does."""
        if self.p_fit <= self.alpha:
            return False
        return True if self.freedom >= 1 else None

    @property
    def sentence(self) -> str:
        """Whether the model fits within the scatter, in words."""
        told = (
            f"Sum of squares {self.misfit:.4g} in units of the scatter, {max(self.freedom, 0.0):.1f} effective degrees "
            f"of freedom, p = {self.p_fit:.2g} for the worst kind of data: "
        )
        if self.fits is None:
            return told + "as many unknowns as data, so a perfect fit says nothing about the model."
        rests = f", which is assumed: {self.assumed}" if self.assumed else ""
        if self.fits:
            return told + f"the model fits within the scatter{rests}."
        few = "with as many unknowns as data " if self.freedom < 1 else ""
        wider = f"standard deviations of parameters are told for {self.birge:.2g} times the scatter"
        return told + f"{few}the model does not fit within the scatter{rests}; something is missing; {wider}."


def criteria(problem: Asked, values: Mapping[str, float]) -> tuple[float, float]:
    """Sums of squares of data and priors at some values; infinite where the model cannot be evaluated."""
    names = [p.name for p in problem.space.free if not p.integer]
    try:
        vector = problem.residual(values)
    except EvaluationError:
        return math.inf, math.inf
    own = Prior.of(problem.space).residual(values, names)
    return float(vector @ vector), float(own @ own)


@dataclass(frozen=True, eq=False)
class Shared:
    """Fits from points that all cases have in common; None where there is no such point, or it cannot be evaluated.

    Attributes
    ----------
    adopted : MixedResult or None
        From the adopted values.
    known : MixedResult or None
        From points that are known to fit.
    """

    adopted: MixedResult | None
    known: MixedResult | None


def ended(problem: Asked, starts: Sequence[Mapping[str, float]], refits: int) -> MixedResult | None:
    """Where least squares end from some starts; None without one, or where none can be evaluated or kept."""
    with suppress(EvaluationError, InfeasibleError):
        return fit_mixed(problem, problem.space, starts, refits=refits) if starts else None
    return None


def fitted(
    problem: Asked,
    terms: Terms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    before: Judgement | None = None,
    shared: Shared | None = None,
) -> Judgement:
    """The best least-squares fit from several starts, with the limits, constraints and priors of the problem's space.

    ``refits`` bounds the combinations of whole-number parameters tried from every start; ``before`` is an earlier fit
    that tried them, for a last one that tries no more; ``shared`` are fits of the same residual from further starts.
    The end of the own starts gives way to that of the adopted values only where the data tell them apart, by more than
    `EQUAL`; to a known one wherever that is better by data and priors together.
    """
    space = problem.space
    found: MixedResult = fit_mixed(problem, space, starts, refits=refits, progress=progress)
    if shared is not None and shared.adopted is not None:
        found = found.joined(shared.adopted, EQUAL)
    if shared is not None and shared.known is not None:
        found = found.joined(shared.known)
    if before is not None:
        return _judged(problem, terms, found.best.values, found.best, before.profiles, before.complete)
    profiles = {p.name: found.profile(p.name) for p in space.free if p.integer}
    return _judged(problem, terms, found.best.values, found.best, profiles, found.complete)


def polished(
    exact: Asked,
    near: Asked | None,
    terms: Terms,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    known: Sequence[Mapping[str, float]] = (),
    shared: Shared | None = None,
) -> Judgement:
    """Least squares as of `fitted`; first on a reduced stand-in where there is one, then at full order.

    Full order begins at the best of what the stand-in has found and of ``known``, so that it never ends above those.
    """
    found = fitted(exact if near is None else near, terms, starts, refits, progress, shared=shared)
    if near is None:
        return found
    begin = min((found.values, *known), key=lambda values: sum(criteria(exact, values)))
    return fitted(exact, terms, [begin], 1, before=found)


def judged(problem: Asked, terms: Terms, values: Mapping[str, float]) -> Judgement:
    """What the data say about the parameters at given values, nothing fitted."""
    return _judged(problem, terms, dict(values), None, {}, True)


def _judged(
    problem: Asked,
    terms: Terms,
    values: dict[str, float],
    fit: FitResult | None,
    profiles: Profiles,
    complete: bool,
) -> Judgement:
    space, alpha, taken = problem.space, terms.alpha, terms.held_sd
    names = tuple(p.name for p in space.free if not p.integer)
    if fit is not None and fit.names == names:
        vector, slope = fit.residual, fit.jacobian
    else:
        vector, slope = problem.residual(values), problem.jacobian(values, names)
    held = problem.jacobian(values, tuple(taken)) * list(taken.values()) if taken else None
    prior_sd = np.array([space[n].prior_width for n in names])
    misfit, own = float(vector @ vector), Prior.of(space).residual(values, names)
    freedom = effective_freedom(slope, prior_sd, sum(problem.fitted_factors.values()))
    converged = fit is not None and fit.converged
    at = _Fitted(vector, slope, prior_sd, converged)
    kinds, modes = goodness(at, problem)
    p_fit, birge = overall(kinds, modes), misfit_factor(kinds, modes, alpha)
    whole = {
        name: whole_number_std(numbers, misfits / birge**2, space[name].value, space[name].prior_width)
        for name, (numbers, misfits) in profiles.items()
    }
    identification = identify(space, names, slope, values=values, held=held, birge=birge)
    predictions = prediction_interval(*problem.frequencies(values, names), identification.posterior.covariance)
    suspected = suspects(at, problem, alpha)
    return Judgement(
        values=values, misfit=misfit, prior_misfit=float(own @ own), freedom=freedom, p_fit=p_fit, alpha=alpha,
        birge=birge, identification=identification, profiles=profiles, whole=whole, complete=complete,
        predictions=predictions, fit=fit, suspects=suspected,
        assumed=terms.assumed,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fitted:
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    converged: bool
