"""Bounded Levenberg-Marquardt with Gaussian priors under linear constraints; whole numbers by coordinate search."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from calib.errors import EvaluationError, InputError
from calib.space import ParameterSpace

ACTIVE = 1e-6
"""Distance to a limit, over the range, below which it is active."""


class LeastSquares(Protocol):
    """Whitened differences between a measurement and anything that answers it."""

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,) at named values, each in its own unit; EvaluationError where there is none."""
        ...

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the vector per one of each parameter's own unit, (n_rows, n_params)."""
        ...


@dataclass(frozen=True)
class Prior:
    """Independent Gaussian knowledge about parameters before the measurement.

    Attributes
    ----------
    centre, sd : mapping from str to float
        Each in the parameter's own unit; a parameter without an entry in ``sd`` has no prior.
    """

    centre: Mapping[str, float]
    sd: Mapping[str, float]

    @classmethod
    def of(cls, space: ParameterSpace) -> Prior:
        """Adopted values and prior widths of the free parameters that are not whole numbers."""
        chosen = [p for p in space.free if not p.integer]
        return cls({p.name: p.value for p in chosen}, {p.name: p.prior_width for p in chosen})

    @classmethod
    def none(cls) -> Prior:
        """No prior at all."""
        return cls({}, {})

    def widths(self, names: Sequence[str]) -> np.ndarray:
        """Standard deviations (n_params,), infinite where there is no prior."""
        return np.array([self.sd.get(name, math.inf) for name in names], dtype=float)

    def residual(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """``(value - centre)/sd``, (n_params,), 0 where there is no prior."""
        return np.array([(values[n] - self.centre[n]) / self.sd[n] if n in self.sd else 0.0 for n in names])


@dataclass(frozen=True)
class FitSettings:
    """When a fit ends.

    Attributes
    ----------
    iterations : int
        Accepted steps at most.
    gain : float
        Converged when the undamped step promises to lower the sum of squares by less than this (it is in units of the
        scatter: 1e-4 is a hundredth of a posterior standard deviation), or by less than 1e-9 of it.
    damping : float
        First damping over the largest curvature.
    rejections : int
        Steps in a row that may fail to lower the sum of squares.
    """

    iterations: int = 50
    gain: float = 1e-5
    damping: float = 1e-3
    rejections: int = 20


@dataclass(frozen=True, eq=False)
class FitResult:
    """Where one fit ended.

    Attributes
    ----------
    names : tuple of str
        Parameters that were fitted.
    values : dict
        All parameters, each in its own unit.
    data_misfit, prior_misfit : float
        Sums of squares of the residual and of the prior's.
    iterations, evaluations, jacobians : int
        Accepted steps; residuals and Jacobians that were asked for.
    converged : bool
    reason : str
        Why it ended, in words.
    active_limits, active_constraints : tuple of str
        Such as ``K_primary at its upper limit``.
    history : DataFrame
        ``iteration, misfit, data_misfit, prior_misfit, step, damping``; ``step`` is the largest change over the range.
    residual : ndarray (n_rows,)
    jacobian : ndarray (n_rows, n_params)
        At the end, for `calib.updating.identify`.
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
    history: pd.DataFrame
    residual: np.ndarray
    jacobian: np.ndarray

    @property
    def misfit(self) -> float:
        """Sum of squares that was made small."""
        return self.data_misfit + self.prior_misfit


def fit(
    problem: LeastSquares,
    space: ParameterSpace,
    start: Mapping[str, float] | None = None,
    prior: Prior | None = None,
    settings: FitSettings = FitSettings(),
) -> FitResult:
    """Make ``|residual|^2 + sum ((theta - centre)/sd)^2`` small within limits and linear constraints.

    Levenberg-Marquardt in parameters scaled by their range; the damping follows the ratio of actual to promised
    decrease (Nielsen 1999). Every step is the exact minimum of the damped quadratic model within all limits and
    constraints (least distance programming, Lawson and Hanson 1974, ch. 23), so every point tried is feasible. Whole
    numbers stay at their start.

    Parameters
    ----------
    problem : LeastSquares
    space : ParameterSpace
        Its free parameters that are not whole numbers are fitted.
    start : mapping, optional
        Named values, default the adopted ones. A start outside the limits or constraints is moved to the nearest
        feasible point.
    prior : Prior, optional
        Default `Prior.of(space)`; `Prior.none()` switches it off.
    settings : FitSettings

    Raises
    ------
    InputError
        When nothing is free, or no point keeps the constraints.
    EvaluationError
        When the start cannot be evaluated.
    """
    region = _Region.of(space, space.complete(dict(start or {})))
    prior = Prior.of(space) if prior is None else prior
    search = _Search(problem, region, prior)
    here = search.at(region.nearest(region.start))
    if here is None:
        raise EvaluationError(f"the fit cannot start: {search.fault}")
    rows, mu, growth = [], 0.0, 2.0
    rows.append((0, here.misfit, here.data, here.prior, 0.0, math.nan))
    iteration, rejected, reason, converged = 0, 0, "", False
    slope = search.slope(here)
    while True:
        matrix, right = search.system(here, slope)
        free_step = region.step(matrix, right, 0.0, here.x)
        promised = _promise(matrix, right, free_step)
        if promised <= max(settings.gain, 1e-9 * here.misfit):
            reason, converged = "no step promises to lower the misfit", True
            break
        if iteration >= settings.iterations:
            reason = f"stopped after {iteration} iterations, before it converged"
            break
        mu = mu or settings.damping * float(np.max(np.sum(matrix**2, axis=0)))
        there = None
        while there is None and rejected < settings.rejections:
            step = region.step(matrix, right, mu, here.x)
            trial = search.at(region.inside(here.x + step))
            if trial is not None and trial.misfit < here.misfit:
                ratio = (here.misfit - trial.misfit) / max(_promise(matrix, right, step), 1e-300)
                mu, growth = mu * max(1 / 10, 1 - (2 * ratio - 1) ** 3), 2.0
                there, rejected = trial, 0
            else:
                mu, growth, rejected = mu * growth, 2 * growth, rejected + 1
        if there is None:
            # The model may be rough below this; whether that matters is told by what was promised.
            converged = promised <= 1e-6 * here.misfit
            reason = f"no step lowers the misfit further (one promised {promised:.2g} of {here.misfit:.4g})"
            break
        iteration += 1
        size = float(np.max(np.abs(there.x - here.x)))
        rows.append((iteration, there.misfit, there.data, there.prior, size, mu))
        here, slope = there, search.slope(there)
    columns = ["iteration", "misfit", "data_misfit", "prior_misfit", "step", "damping"]
    limits, constraints = region.active(here.x)
    return FitResult(
        names=region.names,
        values=here.values,
        data_misfit=here.data,
        prior_misfit=here.prior,
        iterations=iteration,
        evaluations=search.evaluations,
        jacobians=search.jacobians,
        converged=converged,
        reason=reason,
        active_limits=limits,
        active_constraints=constraints,
        history=pd.DataFrame(rows, columns=columns),
        residual=here.residual,
        jacobian=slope,
    )


def _promise(matrix: np.ndarray, right: np.ndarray, step: np.ndarray) -> float:
    """Decrease of ``|matrix step + right|^2`` by a step from 0."""
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
    """Asks the problem and counts."""

    def __init__(self, problem: LeastSquares, region: _Region, prior: Prior):
        self.problem, self.region, self.prior = problem, region, prior
        self.evaluations, self.jacobians, self.fault = 0, 0, ""

    def at(self, x: np.ndarray) -> _Point | None:
        """The point, or None where it cannot be evaluated."""
        values = self.region.values(x)
        self.evaluations += 1
        try:
            residual = np.asarray(self.problem.residual(values), dtype=float)
        except EvaluationError as fault:
            self.fault = str(fault)
            return None
        if not np.all(np.isfinite(residual)):
            self.fault = "the residual is not finite"
            return None
        own = self.prior.residual(values, self.region.names)
        return _Point(x, values, residual, float(residual @ residual), float(own @ own))

    def slope(self, point: _Point) -> np.ndarray:
        self.jacobians += 1
        return np.asarray(self.problem.jacobian(point.values, self.region.names), dtype=float)

    def system(self, point: _Point, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right-hand side of the linearised problem over scaled parameters, prior included."""
        names, span = self.region.names, self.region.span
        prior = np.diag(span / self.prior.widths(names))
        own = self.prior.residual(point.values, names)
        return np.vstack([slope * span, prior]), np.concatenate([point.residual, own])


@dataclass(frozen=True, eq=False)
class _Region:
    """Limits and constraints over parameters scaled to 0..1 between their limits: ``rows @ x >= least``."""

    space: ParameterSpace
    names: tuple[str, ...]
    fixed: dict[str, float]
    start: np.ndarray
    lower: np.ndarray
    span: np.ndarray
    rows: np.ndarray
    least: np.ndarray
    labels: tuple[str, ...]

    @classmethod
    def of(cls, space: ParameterSpace, start: dict[str, float]) -> _Region:
        chosen = [p for p in space.free if not p.integer]
        if not chosen:
            raise InputError("no parameter is free to be fitted", place="fit", remedy="free one (not a whole number)")
        names = tuple(p.name for p in chosen)
        lower = np.array([p.lower for p in chosen])
        span = np.array([p.upper - p.lower for p in chosen])
        rows, least, labels = [], [], []
        for con in space.constraints:
            weights = dict(con.coefficients)
            row = np.array([weights.get(n, 0.0) for n in names])
            shift = sum(c * start[n] for n, c in con.coefficients if n not in names) + float(row @ lower)
            row = row * span
            size = float(np.linalg.norm(row))
            for sign, limit, word in ((1.0, con.lower, "lower"), (-1.0, con.upper, "upper")):
                if math.isfinite(limit):
                    if size == 0:
                        if sign * (shift - limit) < -1e-9 * max(1.0, abs(limit)):
                            raise InputError("the fixed values break it", place=f"constraint {con.name}")
                        continue
                    rows.append(sign * row / size)
                    least.append(sign * (limit - shift) / size)
                    labels.append(f"{con.name} at its {word} limit")
        return cls(
            space=space,
            names=names,
            fixed={n: v for n, v in start.items() if n not in names},
            start=(np.array([start[n] for n in names]) - lower) / span,
            lower=lower,
            span=span,
            rows=np.array(rows).reshape(-1, len(names)),
            least=np.array(least),
            labels=tuple(labels),
        )

    @property
    def _walls(self) -> tuple[np.ndarray, np.ndarray]:
        """All limits and constraints."""
        one = np.eye(len(self.names))
        return (
            np.vstack([one, -one, self.rows]),
            np.concatenate([np.zeros(len(one)), -np.ones(len(one)), self.least]),
        )

    def values(self, x: np.ndarray) -> dict[str, float]:
        return self.fixed | dict(zip(self.names, (self.lower + self.span * x).tolist(), strict=True))

    def inside(self, x: np.ndarray) -> np.ndarray:
        """The point without the rounding that would leave the limits."""
        return np.clip(x, 0.0, 1.0)

    def nearest(self, x: np.ndarray) -> np.ndarray:
        """The feasible point nearest to a given one, which is itself where it is feasible."""
        rows, least = self._walls
        if np.all(rows @ x >= least - 1e-12):
            return self.inside(x)
        moved = _least_distance(rows, least - rows @ x)
        if moved is None:
            self.space.require_feasible()
            raise InputError("no point keeps the limits and constraints", place="constraints")
        return self.inside(x + moved)

    def step(self, matrix: np.ndarray, right: np.ndarray, mu: float, x: np.ndarray) -> np.ndarray:
        """Minimum of ``|matrix d + right|^2 + mu |d|^2`` with x + d within all limits and constraints."""
        n = len(x)
        ridge = max(mu, 1e-14 * float(np.max(np.sum(matrix**2, axis=0), initial=1e-300)))
        whole = np.vstack([matrix, math.sqrt(ridge) * np.eye(n)])
        q, r = np.linalg.qr(whole)
        target = -(q.T @ np.concatenate([right, np.zeros(n)]))
        rows, least = self._walls
        room = np.minimum(least - rows @ x, 0.0)  # the present point is feasible up to rounding
        # With z = r d - target the problem is to find the shortest z behind all walls.
        turned = np.linalg.solve(r.T, rows.T).T
        size = np.linalg.norm(turned, axis=1)
        z = _least_distance(turned / size[:, None], (room - turned @ target) / size)
        if z is None:
            return np.zeros(n)
        return np.linalg.solve(r, z + target)

    def active(self, x: np.ndarray) -> tuple[tuple[str, ...], tuple[str, ...]]:
        limits = [f"{n} at its lower limit" for n, v in zip(self.names, x, strict=True) if v < ACTIVE]
        limits += [f"{n} at its upper limit" for n, v in zip(self.names, x, strict=True) if v > 1 - ACTIVE]
        gap = self.rows @ x - self.least
        return tuple(limits), tuple(label for label, g in zip(self.labels, gap, strict=True) if g < ACTIVE)


def _least_distance(rows: np.ndarray, least: np.ndarray) -> np.ndarray | None:
    """The shortest z with ``rows @ z >= least``, or None when there is none (Lawson and Hanson 1974, ch. 23)."""
    if np.all(least <= 0):
        return np.zeros(rows.shape[1])
    scale = float(np.max(least))  # distances of all sizes are solved alike
    matrix = np.vstack([rows.T, least / scale])
    goal = np.zeros(len(matrix))
    goal[-1] = 1.0
    try:
        weights, _ = nnls(matrix, goal, maxiter=50 * matrix.shape[1])
    except RuntimeError:
        return None
    rest = matrix @ weights - goal
    if abs(rest[-1]) < 1e-12:
        return None
    return -scale * rest[:-1] / rest[-1]


# -- whole numbers -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MixedResult:
    """Best fit over whole-number parameters and starts.

    Attributes
    ----------
    best : FitResult
    by_start : tuple of FitResult
        Where every start ended; the best one of each.
    combinations : DataFrame
        One row a fit: ``start``, every whole-number parameter, ``misfit``, ``converged``.
    exhausted : tuple of int
        Starts that used up their refits before all neighbours were tried.
    """

    best: FitResult
    by_start: tuple[FitResult, ...]
    combinations: pd.DataFrame
    exhausted: tuple[int, ...]

    def profile(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Whole numbers tried and the lowest misfit of each, the other whole numbers being free, both (n,)."""
        lowest = self.combinations.groupby(name)["misfit"].min()
        return lowest.index.to_numpy(dtype=float), lowest.to_numpy(dtype=float)


def fit_mixed(
    problem: LeastSquares,
    space: ParameterSpace,
    starts: Sequence[Mapping[str, float]] = ({},),
    prior: Prior | None = None,
    settings: FitSettings = FitSettings(),
    refits: int = 40,
    progress: Callable[[int, int, float], None] = lambda start, fits, misfit: None,
) -> MixedResult:
    """Fit from several starts, whole-number parameters by coordinate search around each continuous optimum.

    From the start's whole numbers the search goes to the best neighbour (one parameter up or down by one), refitting
    the others from where they are, until no neighbour is better; then to neighbours that differ in two parameters.
    Failed combinations count as infinitely bad. All neighbours of an end have been tried unless it is told otherwise.

    Parameters
    ----------
    problem, space, prior, settings
        As in `fit`.
    starts : sequence of mapping
        Named values, such as Latin hypercube points; what is left out takes its adopted value.
    refits : int
        Fits at most for every start.
    progress : callable
        Called after every fit with start, number of fits of this start and lowest misfit so far.

    Raises
    ------
    EvaluationError
        When no start can be evaluated.
    """
    if not starts:
        raise InputError("no start is given", place="fit", remedy="give at least one point")
    whole = tuple(p.name for p in space.free if p.integer)
    rows: list[dict[str, float | bool]] = []
    ends, exhausted, fault = [], [], ""
    lowest = math.inf
    for k, start in enumerate(starts):
        walk = _Walk(problem, space, prior, settings, refits, whole)
        here = walk.fit(space.complete(dict(start)))
        if here is not None:
            lowest = min(lowest, here.misfit)
        while here is not None:
            progress(k, len(walk.tried), lowest)
            better = walk.better(here)
            if better is None:
                break
            here = better
            lowest = min(lowest, here.misfit)
        fault = walk.fault or fault
        rows += [{"start": k, **dict(zip(whole, key, strict=True)), "misfit": m, "converged": c}
                 for key, (m, c) in walk.tried.items()]  # fmt: skip
        if here is not None:
            ends.append(here)
            if walk.exhausted:
                exhausted.append(k)
    if not ends:
        raise EvaluationError(f"the fit cannot start anywhere: {fault}")
    table = pd.DataFrame(rows, columns=["start", *whole, "misfit", "converged"])
    return MixedResult(min(ends, key=lambda r: r.misfit), tuple(ends), table, tuple(exhausted))


@dataclass(eq=False)
class _Walk:
    """Coordinate search over whole numbers from one start."""

    problem: LeastSquares
    space: ParameterSpace
    prior: Prior | None
    settings: FitSettings
    refits: int
    whole: tuple[str, ...]
    tried: dict[tuple[int, ...], tuple[float, bool]] = field(default_factory=dict)
    fault: str = ""
    exhausted: bool = False

    def fit(self, values: Mapping[str, float]) -> FitResult | None:
        key = tuple(round(values[n]) for n in self.whole)
        try:
            found = fit(self.problem, self.space, values, self.prior, self.settings)
        except EvaluationError as fault:
            self.fault = str(fault)
            self.tried[key] = (math.inf, False)
            return None
        self.tried[key] = (found.misfit, found.converged)
        return found

    def better(self, here: FitResult) -> FitResult | None:
        """The best untried neighbour if it is better, single changes first; None at the optimum."""
        for changed in (1, 2):
            best = None
            for names in itertools.combinations(self.whole, min(changed, len(self.whole))):
                if len(names) < changed:
                    return None
                for signs in itertools.product((-1, 1), repeat=changed):
                    values = dict(here.values)
                    for name, sign in zip(names, signs, strict=True):
                        values[name] += sign
                    if not all(self.space[n].lower <= values[n] <= self.space[n].upper for n in names):
                        continue
                    if tuple(round(values[n]) for n in self.whole) in self.tried:
                        continue
                    if len(self.tried) >= self.refits:
                        self.exhausted = True
                        return best
                    found = self.fit(values)
                    if found is not None and found.misfit < (here if best is None else best).misfit:
                        best = found
            if best is not None:
                return best
        return None


# -- problems without matrices -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DifferencedResponses:
    """Least squares of plain responses, with derivatives by central differences.

    Attributes
    ----------
    evaluate : callable
        Named values to named responses, such as ``FunctionProblem.evaluate``.
    targets : mapping from response name to (value, std or None)
        Measured; the residual is (measured - model)/std.
    space : ParameterSpace
        Differences stay within its limits and are one-sided at them.
    step : float
        Half the difference, over the range.
    unknown_std : float
        Standard deviation where none is known, over the size of the value.
    """

    evaluate: Callable[[Mapping[str, float]], Mapping[str, float]]
    targets: Mapping[str, tuple[float, float | None]]
    space: ParameterSpace
    step: float = 1e-4
    unknown_std: float = 0.01

    def __post_init__(self) -> None:
        if not self.targets:
            raise InputError("no target is given", place="targets", remedy="name at least one measured response")
        for name, (value, std) in self.targets.items():
            if not std and value == 0:
                raise InputError(
                    f"the target {name!r} is 0 and its standard deviation unknown", place="targets", remedy="give one"
                )

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """(measured - model)/std of every target; EvaluationError for a response that is missing or not finite."""
        answer = self.evaluate(values)
        out = np.empty(len(self.targets))
        for k, (name, (value, std)) in enumerate(self.targets.items()):
            response = float(answer.get(name, math.nan))
            if not math.isfinite(response):
                raise EvaluationError(f"the response {name!r} is {response}")
            out[k] = (value - response) / (std or self.unknown_std * abs(value))
        return out

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Central differences, two evaluations a parameter; whole-number parameters count as fixed."""
        return central_jacobian(self.residual, self.space, values, names, self.step)


def central_jacobian(
    residual: Callable[[Mapping[str, float]], np.ndarray],
    space: ParameterSpace,
    values: Mapping[str, float],
    names: Sequence[str],
    step: float = 1e-4,
) -> np.ndarray:
    """Derivative of a vector by central differences, per one of each parameter's own unit, shape (n_rows, n_params).

    Parameters
    ----------
    residual : callable
    space : ParameterSpace
        Both points are kept within its limits.
    values : mapping
    names : sequence of str
    step : float
        Over the range between the limits.
    """
    complete = space.complete(dict(values))
    columns = []
    for name in names:
        p = space[name]
        half = step * (p.upper - p.lower)
        if p.integer or half == 0:
            columns.append(np.zeros_like(np.asarray(residual(complete), dtype=float)))
            continue
        high, low = min(complete[name] + half, p.upper), max(complete[name] - half, p.lower)
        ends = [np.asarray(residual({**complete, name: v}), dtype=float) for v in (high, low)]
        columns.append((ends[0] - ends[1]) / (high - low))
    return np.column_stack(columns)
