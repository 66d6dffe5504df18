"""Bounded Levenberg-Marquardt with priors under linear constraints."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, raised_anew
from calib.inference.region import Region
from calib.problem.prior import Prior
from calib.problem.space import ParameterSpace


class LeastSquares(Protocol):
    """Whitened residual of a measurement, and its Jacobian."""

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,) at named values, each in its own unit; EvaluationError where the evaluation fails."""
        ...

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the vector per unit of each parameter, (n_rows, n_params)."""
        ...


@dataclass(frozen=True)
class FitSettings:
    """Termination criteria of a fit.

    Attributes
    ----------
    iterations : int
        Largest number of accepted steps.
    gain, relative : float
        Converged when the predicted decrease of the sum of squares (whitened: 1e-4 is a hundredth of a posterior
        standard deviation) by the undamped step is below ``gain``, or below ``relative`` times the sum of squares.
    damping : float
        Initial damping over the largest curvature.
    rejections : int
        Largest number of consecutive steps that fail to lower the sum of squares.
    noise, noisy_rejections : float, int
        Predicted decrease over the sum of squares up to which such a failure counts as noise of the model, as of a
        solver that prints seven digits: the fit has converged, and after ``noisy_rejections`` no more are tried.
    evaluations : float
        Number of residuals after which no further step is tried.
    costly : float
        Factor of ``gain`` and ``noise``, of the latter twice for failures, where each derivative costs evaluations
        (assumed). Such a fit has converged, too, when a step promises no more than ``noise`` times the sum of squares,
        or when a step from evaluated derivatives lowers it by no more.
    evaluated_end : bool
        Whether derivatives are evaluated at the end where they were updated: standard deviations need that, a ranking
        does not. With ``near_end`` they may be those evaluated near it, which is enough for a verdict.
    beaten : float
        Sum of squares of a better fit from another start. Where each derivative costs evaluations a fit ends, without
        having converged, when a step promises less than a thousandth of what it is above that.
    """

    iterations: int = 50
    gain: float = 1e-5
    relative: float = 1e-9
    damping: float = 1e-3
    rejections: int = 20
    noise: float = 1e-6
    noisy_rejections: int = 4
    evaluations: float = math.inf
    costly: float = 100.0
    evaluated_end: bool = True
    near_end: bool = False
    beaten: float = math.inf


DEFAULT = FitSettings()
_POOR = 0.25
"""Actual over predicted decrease below which derivatives that were updated are evaluated again."""
_SAME = 0.1
"""Part of a step that failed by which another must differ to be worth an evaluation."""
_NEAR = 0.01
"""Part of the range within which derivatives that were evaluated hold: a step that fails so near to them, where a mode
loses its partner, fails whatever they are (assumed)."""
_HOPELESS = 1e-3
"""Part of the way to a better fit below which what a step promises will not lead there (assumed)."""
_HERE = 1e-3
"""Part of the range; a shorter step says more about the rounding of a solver than about derivatives (assumed)."""

Step = Callable[[float], None]


def unstepped(share: float) -> None:
    """Nobody asks how far a fit is."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of one fit.

    Attributes
    ----------
    names : tuple of str
        Parameters that were fitted.
    values : dict
        All parameters, each in its own unit.
    data_misfit, prior_misfit : float
        Sums of squares of the residual and of the prior.
    iterations, evaluations, jacobians : int
        Numbers of accepted steps, residuals and Jacobians.
    converged : bool
    reason : str
        Why the fit ended, in words.
    active_limits, active_constraints : tuple of str
        Such as ``K_primary at its upper limit``.
    steps : tuple of tuple
        Rows of `history`, which few ask for and which takes longer to make than a small model to solve.
    residual : ndarray (n_rows,)
    jacobian : ndarray (n_rows, n_params)
        At the end, for `calib.inference.identify`.
    evaluated : bool
        Whether it was evaluated there or near, and not updated; see `FitSettings`.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    data_misfit: float
    prior_misfit: float
    iterations: int
    evaluations: int
    jacobians: int
    converged: bool
    reason: str
    active_limits: tuple[str, ...]
    active_constraints: tuple[str, ...]
    steps: tuple[tuple[float, ...], ...]
    residual: np.ndarray
    jacobian: np.ndarray
    evaluated: bool = True

    @property
    def misfit(self) -> float:
        """Sum of squares that was minimised."""
        return self.data_misfit + self.prior_misfit

    @property
    def history(self) -> pd.DataFrame:
        """``iteration, misfit, data_misfit, prior_misfit, step, damping``; a step over the range, its largest."""
        columns = ["iteration", "misfit", "data_misfit", "prior_misfit", "step", "damping"]
        return pd.DataFrame(list(self.steps), columns=columns)


T = TypeVar("T")
Request = tuple[Mapping[str, float], tuple[str, ...]]
"""What a fit evaluates next: the residual at named values, or with names the derivatives by them."""


def requested(problem: LeastSquares, request: Request) -> np.ndarray:
    """The residual, or the derivatives, that a fit asks for next."""
    values, names = request
    return problem.jacobian(values, names) if names else problem.residual(values)


def fit(
    problem: LeastSquares,
    space: ParameterSpace,
    start: Mapping[str, float] | None = None,
    prior: Prior | None = None,
    settings: FitSettings = DEFAULT,
    step: Step = unstepped,
    slope: np.ndarray | None = None,
    exact: bool = False,
) -> FitResult:
    """Minimise ``|residual|^2 + sum ((theta - centre)/sd)^2`` within limits and linear constraints.

    Priors other than normal ones add the square of their pull. Levenberg-Marquardt in the position of each parameter
    between its limits, along its scale; the damping follows the ratio of actual to predicted decrease (Nielsen 1999).
    Where a problem says that derivatives are differences (``by_differences``), each of which costs evaluations, the
    Jacobian is updated after every step by what the residual there says (Broyden 1965). It is evaluated at the start,
    where a step fails or gains much less than predicted (near a point where that was done it is taken from there), and
    at the end. Every step is the exact minimum of the damped quadratic model within all limits and constraints (least
    distance programming, Lawson and Hanson 1974, ch. 23), so every point tried is feasible. Integer parameters stay at
    their start.

    Parameters
    ----------
    problem : LeastSquares
    space : ParameterSpace
        Its free parameters that are not integers are fitted; without any the start is evaluated.
    start : mapping, optional
        Named values, default the nominal ones. A start outside the limits or constraints is moved to the nearest
        feasible point.
    prior : Prior, optional
        Default `Prior.of(space)`; `Prior.none()` switches it off.
    settings : FitSettings
    step : callable
        Called before every step with the share of the way to convergence that is behind.
    slope : ndarray (n_rows, n_params), optional
        An estimate of the Jacobian at the start, such as that of a model with one effect less: where derivatives cost
        evaluations the fit begins with it; ``exact`` says that it is no estimate.

    Raises
    ------
    InputError
        When nothing is free, or no point keeps the constraints.
    EvaluationError
        When the start cannot be evaluated.
    """
    return finished(fit_steps(problem, space, start, prior, settings, step, slope, exact))


def finished(steps: Generator[Request, None, T]) -> T:
    """The result of steps such as `fit_steps`, done one after the other."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            found: T = end.value
            return found


def fit_steps(
    problem: LeastSquares,
    space: ParameterSpace,
    start: Mapping[str, float] | None = None,
    prior: Prior | None = None,
    settings: FitSettings = DEFAULT,
    step: Step = unstepped,
    slope: np.ndarray | None = None,
    exact: bool = False,
) -> Generator[Request, None, FitResult]:
    """`fit`, which stops before every evaluation and tells it, so that several fits can be evaluated together."""
    region = Region.of(space, space.complete(dict(start or {})))
    prior = Prior.of(space) if prior is None else prior
    search = _Search(problem, region, prior)
    first_x = region.nearest(region.start)
    yield region.values(first_x), ()
    here = search.at(first_x)
    if here is None:
        raise raised_anew(search.fault, f"the fit cannot start: {search.fault}")
    mu, growth = 0.0, 2.0
    costly = bool(getattr(problem, "by_differences", False))
    rows: list[tuple[float, ...]] = [(0, here.misfit, here.data, here.prior, 0.0, math.nan)]
    iteration, rejected, reason, converged, poor, little = 0, 0, "", False, False, False
    first = math.nan
    updated = costly and slope is not None
    known = (here.x, slope) if slope is not None and updated and exact else None
    updated = updated and not exact
    if slope is None or not costly:
        yield here.values, region.names
        slope = search.slope(here)
        known = here.x, slope
    while True:
        matrix, right = search.system(here, slope)
        free_step = region.step(matrix, right, 0.0, here.x)
        promised = _promise(matrix, right, free_step)
        least = max(settings.gain, settings.relative * here.misfit)
        if costly:
            least = max(least, settings.costly * DEFAULT.gain, settings.noise * here.misfit)
        enough = promised <= least or little
        last = iteration >= settings.iterations or search.evaluations >= settings.evaluations
        if costly and promised < _HOPELESS * (here.misfit - settings.beaten):
            reason = f"another start ends at {settings.beaten:.4g}, and no step promises to come near it"
            break
        # An end rests on derivatives, and so does a step that must be better.
        if updated and (poor or ((enough or last) and settings.evaluated_end)):
            within = _NEAR if poor or settings.near_end else 0.0
            if known is None or float(np.max(np.abs(here.x - known[0]))) > within:
                yield here.values, region.names
                known = here.x, search.slope(here)
            slope, updated = known[1], False
            continue
        if enough:
            reason, converged = "no step promises to lower the misfit", True
            break
        if last:
            reason = f"stopped after {iteration} iterations, before it converged"
            break
        first = promised if math.isnan(first) else max(first, promised)
        step(_behind(first, promised, least))
        mu = mu or settings.damping * float(np.max(np.sum(matrix**2, axis=0)))
        there = None
        move = region.step(matrix, right, mu, here.x)
        factor = settings.costly if costly else 1.0
        noise = settings.noise * factor
        noisy, failed = promised <= factor * noise * here.misfit, 0
        poor = False
        while there is None and rejected < settings.rejections and search.evaluations < settings.evaluations:
            if noisy and failed == settings.noisy_rejections:
                break
            there_x = region.inside(here.x + move)
            yield region.values(there_x), ()
            trial = search.at(there_x)
            if trial is not None and trial.misfit < here.misfit:
                ratio = (here.misfit - trial.misfit) / max(_promise(matrix, right, move), 1e-300)
                if not (costly and failed):  # where a longer step has just failed the next one is not longer
                    mu *= max(1 / 10, 1 - (2 * ratio - 1) ** 3)
                growth = 2.0
                there, rejected, poor = trial, 0, ratio < _POOR
            elif updated:
                poor = True
                break
            else:
                tried, failed = move, failed + 1
                other = False
                while not other and rejected < settings.rejections:
                    mu, growth, rejected = mu * growth, 2 * growth, rejected + 1
                    move = region.step(matrix, right, mu, here.x)
                    other = bool(np.linalg.norm(move - tried) > _SAME * np.linalg.norm(tried))
        if there is None and poor:
            continue
        if there is None:
            converged = noisy
            reason = f"no step lowers the misfit further (one promised {promised:.2g} of {here.misfit:.4g})"
            break
        iteration += 1
        size = float(np.max(np.abs(there.x - here.x)))
        rows.append((iteration, there.misfit, there.data, there.prior, size, mu))
        if costly:
            little = not updated and here.misfit - there.misfit <= max(least, noise * here.misfit if failed else 0.0)
            slope = search.updated(slope, here, there) if size > _HERE else slope
            here, updated = there, not (little and size <= _HERE)
            continue
        yield there.values, region.names
        here, slope = there, search.slope(there)
    limits, constraints = region.active(here.x)
    return FitResult(
        names=region.names, values=here.values, data_misfit=here.data, prior_misfit=here.prior, iterations=iteration,
        evaluations=search.evaluations, jacobians=search.jacobians, converged=converged, reason=reason,
        active_limits=limits, active_constraints=constraints, steps=tuple(rows), residual=here.residual,
        jacobian=slope, evaluated=not updated,
    )  # fmt: skip


def _behind(first: float, promised: float, enough: float) -> float:
    """Share of the decades from the first predicted decrease to one that is enough."""
    whole = math.log(first / enough) if first > enough > 0 else 0.0
    return min(max(math.log(first / promised) / whole, 0.0), 1.0) if whole > 0 else 0.0


def _promise(matrix: np.ndarray, right: np.ndarray, step: np.ndarray) -> float:
    """Predicted decrease of ``|matrix step + right|^2`` by a step from 0."""
    moved = matrix @ step
    return float(-(moved @ moved + 2 * moved @ right))


@dataclass(frozen=True, eq=False)
class _Point:
    x: np.ndarray
    values: dict[str, float]
    residual: np.ndarray
    data: float
    prior: float

    @property
    def misfit(self) -> float:
        return self.data + self.prior


class _Search:
    """Evaluates the problem and counts the evaluations."""

    def __init__(self, problem: LeastSquares, region: Region, prior: Prior):
        self.problem, self.region, self.prior = problem, region, prior
        self.evaluations, self.jacobians, self.fault = 0, 0, EvaluationError()

    def at(self, x: np.ndarray) -> _Point | None:
        """The point, or None where it cannot be evaluated."""
        values = self.region.values(x)
        self.evaluations += 1
        try:
            residual = np.asarray(self.problem.residual(values), dtype=float)
        except EvaluationError as fault:
            self.fault = raised_anew(fault)
            return None
        if not np.all(np.isfinite(residual)):
            self.fault = EvaluationError("the residual is not finite")
            return None
        own = self.prior.rows(values, self.region.names)[0]
        return _Point(x, values, residual, float(residual @ residual), float(own @ own))

    def slope(self, point: _Point) -> np.ndarray:
        self.jacobians += 1
        return np.asarray(self.problem.jacobian(point.values, self.region.names), dtype=float)

    def updated(self, slope: np.ndarray, before: _Point, point: _Point) -> np.ndarray:
        """Jacobian at a point from that at an earlier one: the least change that explains the residual there."""
        step = point.x - before.x
        here, there = self.region.span_at(before.x), self.region.span_at(point.x)
        scaled = slope * here
        left = point.residual - before.residual - scaled @ step
        return np.asarray((scaled + np.outer(left, step) / float(step @ step)) / there)

    def system(self, point: _Point, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right-hand side of the linearised problem over scaled parameters, prior included, in few rows."""
        span = self.region.span_at(point.x)
        own, prior = self.prior.rows(point.values, self.region.names)
        rows = np.column_stack([np.vstack([slope, prior]) * span, np.concatenate([point.residual, own])])
        few = np.asarray(np.linalg.qr(rows, mode="r"))  # of the same sums of squares, and solved for every damping
        return few[:, :-1], few[:, -1]
