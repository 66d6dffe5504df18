"""Least squares from where a search ended, and what can be told about the parameters there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.responses import response_rows
from calib.errors import EvaluationError
from calib.freedom import effective_freedom
from calib.ledger import Ledger
from calib.missing.goodness import goodness, misfit_factor, overall
from calib.missing.hypotheses import Label
from calib.missing.suspect import suspects
from calib.questions.compare import responses_at
from calib.questions.recorded import Counts, RecordedModes, recorded_problem
from calib.questions.scatter import assumed_words
from calib.space import ParameterSpace
from calib.study import Problem, Study
from calib.updating.differences import DifferencedResponses
from calib.updating.gauss_newton import FitResult, Prior
from calib.updating.identify import Identification, identify, prediction_interval
from calib.updating.verdicts import parameter_verdicts, whole_number_std
from calib.updating.whole_numbers import MixedResult, fit_mixed

FitProgress = Callable[[int, int, float], None]
Profiles: TypeAlias = Mapping[str, tuple[np.ndarray, np.ndarray]]

EQUAL = 0.1
"""Difference of sums of squares that says nothing: a third of a standard deviation of one parameter."""


@dataclass(frozen=True, eq=False)
class RecordedResidual:
    """The whitened residual of a problem; no point that the ledger knows is solved again, and every other goes into it.

    Attributes
    ----------
    problem : ModalProblem or FunctionProblem
        The study's own, or a reduced stand-in.
    ledger : Ledger
    counts : Counts
        Of what it is asked; may be shared by several residuals.
    """

    problem: Problem
    ledger: Ledger
    counts: Counts = field(default_factory=Counts)
    _inner: RecordedModes | DifferencedResponses = field(init=False, repr=False)

    def __post_init__(self) -> None:
        problem = self.problem
        inner: RecordedModes | DifferencedResponses
        if isinstance(problem, FunctionProblem):
            known = recorded_problem(problem, self.ledger, self.counts)
            inner = DifferencedResponses(partial(responses_at, known), problem.targets, problem.space)
        else:
            inner = RecordedModes(ModalResidual(problem), self.ledger, self.counts)
        object.__setattr__(self, "_inner", inner)

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,) at named values; EvaluationError where the model cannot be solved."""
        return self._inner.residual(values)

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the vector per one of each parameter's own unit, (n_rows, n_params)."""
        return self._inner.jacobian(values, names)

    @property
    def rows(self) -> Sequence[Label]:
        """What every entry compares, length n_rows."""
        return (
            response_rows(self._inner.targets)
            if isinstance(self._inner, DifferencedResponses)
            else self._inner.inner.rows
        )

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Real numbers by (mode, kind) that scale and turn shapes; they are no degrees of freedom."""
        return {} if isinstance(self._inner, DifferencedResponses) else self._inner.inner.fitted_factors

    @property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviations of each kind; infinite where they are known."""
        if isinstance(self._inner, RecordedModes):
            return self._inner.inner.scatter_freedom
        assert isinstance(self.problem, FunctionProblem)
        return self.problem.scatter_freedom

    def predictions(self, values: Mapping[str, float], names: Sequence[str], covariance: np.ndarray) -> pd.DataFrame:
        """Frequencies at named values with 95 % intervals from the scatter of the parameters; empty without modes."""
        if isinstance(self._inner, DifferencedResponses):
            return pd.DataFrame(columns=["mode", "natural_freq", "std", "lower", "upper"])
        labels, freq, slope = self._inner.freq_jacobian(values, names)
        return prediction_interval(labels, freq, slope, covariance)


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
        """One verdict a parameter; see `calib.updating.identify.parameter_verdicts`."""
        table = parameter_verdicts(space, self.values, self.identification, spread, self.whole, self.fits, self.birge)
        if not self.assumed:
            return table.assign(scatter="stated")
        words = table["sentence"].where(table["std"].isna(), table["sentence"] + " The scatter behind it is assumed.")
        return table.assign(scatter="assumed", sentence=words)

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


def criteria(study: Study, residual: RecordedResidual, values: Mapping[str, float]) -> tuple[float, float]:
    """Sums of squares of data and priors at some values; infinite where the model cannot be evaluated."""
    names = [p.name for p in study.search_space.free if not p.integer]
    try:
        vector = residual.residual(values)
    except EvaluationError:
        return math.inf, math.inf
    own = Prior.of(study.search_space).residual(values, names)
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


def fitted(
    study: Study,
    residual: RecordedResidual,
    starts: Sequence[Mapping[str, float]],
    refits: int,
    progress: FitProgress = lambda start, fits, misfit: None,
    before: Judgement | None = None,
    shared: Shared | None = None,
) -> Judgement:
    """The best least-squares fit from several starts, with the study's limits, constraints and priors.

    ``refits`` bounds the combinations of whole-number parameters tried from every start; ``before`` is an earlier fit
    that tried them, for a last one that tries no more; ``shared`` are fits of the same residual from further starts.
    The end of the own starts gives way to that of the adopted values only where the data tell them apart, by more than
    `EQUAL`; to a known one wherever that is better by data and priors together.
    """
    space = study.search_space
    found: MixedResult = fit_mixed(residual, space, starts, refits=refits, progress=progress)
    if shared is not None and shared.adopted is not None:
        found = found.joined(shared.adopted, EQUAL)
    if shared is not None and shared.known is not None:
        found = found.joined(shared.known)
    if before is not None:
        return _judged(study, residual, found.best.values, found.best, before.profiles, before.complete)
    profiles = {p.name: found.profile(p.name) for p in space.free if p.integer}
    return _judged(study, residual, found.best.values, found.best, profiles, found.complete)


def judged(study: Study, residual: RecordedResidual, values: Mapping[str, float]) -> Judgement:
    """What the data say about the parameters at given values, nothing fitted."""
    return _judged(study, residual, dict(values), None, {}, True)


def _judged(
    study: Study,
    residual: RecordedResidual,
    values: dict[str, float],
    fit: FitResult | None,
    profiles: Profiles,
    complete: bool,
) -> Judgement:
    space = study.search_space
    names = tuple(p.name for p in space.free if not p.integer)
    if fit is not None and fit.names == names:
        vector, slope = fit.residual, fit.jacobian
    else:
        vector, slope = residual.residual(values), residual.jacobian(values, names)
    taken = study.held_sd
    held = residual.jacobian(values, tuple(taken)) * list(taken.values()) if taken else None
    prior_sd, factors = np.array([space[n].prior_width for n in names]), residual.fitted_factors
    misfit, own = float(vector @ vector), Prior.of(space).residual(values, names)
    freedom = effective_freedom(slope, prior_sd, sum(factors.values()))
    converged = fit is not None and fit.converged
    at, alpha = _Fitted(vector, slope, prior_sd, converged), study.settings.explain.alpha
    kinds, modes = goodness(at, residual.rows, factors, residual.scatter_freedom)
    p_fit, birge = overall(kinds, modes), misfit_factor(kinds, modes, alpha)
    whole = {
        name: whole_number_std(numbers, misfits / birge**2, space[name].value, space[name].prior_width)
        for name, (numbers, misfits) in profiles.items()
    }
    identification = identify(space, names, slope, values=values, held=held, birge=birge)
    predictions = residual.predictions(values, names, identification.posterior.covariance)
    suspected = suspects(at, residual.rows, factors, residual.scatter_freedom, alpha)
    return Judgement(
        values=values, misfit=misfit, prior_misfit=float(own @ own), freedom=freedom, p_fit=p_fit, alpha=alpha,
        birge=birge, identification=identification, profiles=profiles, whole=whole, complete=complete,
        predictions=predictions, fit=fit, assumed=assumed_words(study),
        suspects=suspected,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fitted:
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    converged: bool
