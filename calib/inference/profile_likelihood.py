"""Profile likelihood: intervals and classes of parameters that assume no linear model."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import FitSettings, LeastSquares, fit
from calib.inference.identify import Posterior
from calib.inference.region import InfeasibleError
from calib.inference.rules import RULES, WIDE
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace

ProfileClass: TypeAlias = Literal["two-sided", "one-sided", "unbounded"]

_REFIT = FitSettings(iterations=12, gain=1e-3)
"""The others follow from the neighbouring point; a misfit to 1e-3 suffices for a rise of 3.84."""

_AIM = 0.5
"""Rise of the root that a step aims at."""

_CORRECTIONS = 3
"""Most points added at one end of an interval."""

_CLOSE = 0.01
"""Relative distance of the root of the rise from that at an end, within which a point is the end."""

_MOST = 16
"""Points on each side: steps double where the data say nothing, and so reach any limit."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Lowest sum of squares at each value of one parameter, all others fitted.

    Attributes
    ----------
    parameter : Parameter
    at : ndarray (n_points,)
        Values tried, ascending, in the parameter's unit; the fitted one among them.
    data, total : ndarray (n_points,)
        Sum of squares at each, without and with the parameter's own prior. Priors of other parameters are in both.
    values : tuple of dict, n_points
        All parameters at each.
    ends : frozenset of {"lower", "upper"}
        Sides on which the scan reached the limit of the parameter.
    failed : tuple of float
        Values at which the model could not be solved.
    """

    parameter: Parameter
    at: np.ndarray
    data: np.ndarray
    total: np.ndarray
    values: tuple[dict[str, float], ...]
    ends: frozenset[str]
    failed: tuple[float, ...]

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval with the prior; NaN on a side where no value in the limits is excluded."""
        return _crossings(self.parameter, self.at, self.total)

    @property
    def data_interval(self) -> tuple[float, float]:
        """The same from the data alone, without the parameter's own prior."""
        return _crossings(self.parameter, self.at, self.data)

    @property
    def kind(self) -> ProfileClass:
        """How many ends of `data_interval` exist within the limits.

        With both Raue et al. (2009) call a parameter identifiable, else practically non-identifiable, and structurally
        so where the profile is flat. Here it counts as identified only where the model fits too, see
        `calib.inference.verdicts.parameter_verdicts`.
        """
        ends = int(np.count_nonzero(np.isfinite(self.data_interval)))
        return "two-sided" if ends == 2 else "one-sided" if ends == 1 else "unbounded"

    @property
    def frame(self) -> pd.DataFrame:
        """``parameter, value, rise, rise_data, interval_at``: rises are those of the sum of squares."""
        return pd.DataFrame(
            {
                "parameter": self.parameter.name,
                "value": self.at,
                "rise": self.total - np.min(self.total),
                "rise_data": self.data - np.min(self.data),
                "interval_at": WIDE**2,
            }
        )


def profile_likelihood(
    problem: LeastSquares,
    space: ParameterSpace,
    best: Mapping[str, float],
    known: Posterior,
    name: str,
    step: Callable[[], None] = lambda: None,
) -> Profile:
    """Follow the optimum of all other parameters while one is moved away from its fitted value, to either side.

    Parameters
    ----------
    problem : LeastSquares
    space : ParameterSpace
        Free parameters that are not integers are refitted; integers keep their best values.
    best : mapping
        Fitted values, each in its own unit.
    known : Posterior
        Linearised about the fitted values; the first step and the way the others follow come from its covariance.
    name : str
        A free parameter that is not an integer.
    step : callable
        Called before every point.

    Raises
    ------
    InputError
        When the parameter is not free, or is an integer.
    """
    if name not in known.names:
        raise InputError(
            f"{name} has no profile", place="profile likelihood",
            remedy=f"the fitted parameters are {', '.join(known.names)}",
        )  # fmt: skip
    p, centre, k = space[name], float(best[name]), known.names.index(name)
    std = float(known.std[k])
    with np.errstate(invalid="ignore"):  # of an infinite variance nothing follows
        follow = dict(zip(known.names, np.nan_to_num(known.covariance[:, k] / std**2).tolist(), strict=True))
    integers = {q.name: best[q.name] for q in space.free if q.integer}
    scan = _Scan(problem, space, dict(best), follow, integers, name, step, Prior.of(space))
    there = scan.at(centre, best)
    if there is None:
        raise InputError(f"the model cannot be solved at the fitted {name}", place="profile likelihood")
    points, reached = [there], set[str]()
    first = (_AIM * std if math.isfinite(std) else 0.05 * p.span_at(centre)) / (centre if p.is_log else 1.0)
    for side, limit in (("lower", p.lower), ("upper", p.upper)):
        more, at_limit = scan.side(there, limit, first)
        points += more
        reached |= {side} if at_limit else set()
    _sharpen(points, scan, p)
    at, data, total = _sums(points, p)
    return Profile(
        p, at, data, total, tuple(one.values for one in points), frozenset(reached), tuple(scan.failed),
    )  # fmt: skip


def profile_table(
    profiles: Sequence[Profile], best: Mapping[str, float], std: Mapping[str, float], misfit: float
) -> pd.DataFrame:
    """Intervals by the profile beside the linearised ones, and what the data alone say.

    Parameters
    ----------
    profiles : sequence of Profile
    best, std : mapping
        Fitted values and standard deviations, each in the parameter's own unit.
    misfit : float
        Sum of squares of data and priors at the fitted values.

    Returns
    -------
    DataFrame
        ``parameter, value, unit, lower, upper, linear_lower, linear_upper, data_lower, data_upper, kind, differs,
        lower_misfit_at, sentence``. NaN is a side on which no value within the limits is excluded. ``lower_misfit_at``
        is a value at which the sum of squares is lower than at the fitted one by more than `Rules.equal`, else NaN.
    """
    rows = []
    for one in profiles:
        p, value = one.parameter, float(best[one.parameter.name])
        linear = tuple(
            end if p.lower < end < p.upper else math.nan
            for end in (p.moved(value, s * WIDE * std[p.name]) for s in (-1.0, 1.0))
        )
        lowest = int(np.argmin(one.total))
        found = one.total[lowest] < misfit - RULES.equal
        differs = _differs(p, one.interval, linear, std[p.name] / p.span_at(value))
        elsewhere = float(one.at[lowest]) if found else math.nan
        rows.append(
            {
                "parameter": p.name,
                "value": value,
                "unit": p.unit,
                "lower": one.interval[0],
                "upper": one.interval[1],
                "linear_lower": linear[0],
                "linear_upper": linear[1],
                "data_lower": one.data_interval[0],
                "data_upper": one.data_interval[1],
                "kind": one.kind,
                "differs": differs,
                "lower_misfit_at": elsewhere,
                "sentence": _sentence(one, linear, differs, elsewhere),
            }
        )
    return pd.DataFrame(rows)


# -- one scan ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Point:
    value: float
    data: float
    """Sum of squares without the parameter's own prior."""
    values: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Scan:
    problem: LeastSquares
    space: ParameterSpace
    best: dict[str, float]
    follow: Mapping[str, float]
    integers: Mapping[str, float]
    name: str
    step: Callable[[], None]
    prior: Prior

    failed: list[float] = field(default_factory=list)

    def at(self, value: float, start: Mapping[str, float]) -> _Point | None:
        """The optimum of all others at one value; None where the model fails or a constraint excludes it."""
        self.step()
        space = self.space.freeze({**self.integers, self.name: value})
        try:
            if not space.free:
                vector = self.problem.residual({**self.best, self.name: value})
                return _Point(value, float(vector @ vector), {**self.best, self.name: value})
            found = fit(self.problem, space, {**start, self.name: value}, self.prior, _REFIT)
        except (EvaluationError, InfeasibleError):
            self.failed.append(value)
            return None
        # Of a correlated prior that of the parameter alone is taken out; the others follow given its value.
        own = (self.prior.share(self.name) - 1.0) * self.space[self.name].pull(value) ** 2
        return _Point(value, found.misfit + own, dict(found.values))

    def side(self, centre: _Point, limit: float, first: float) -> tuple[list[_Point], bool]:
        """Points from the optimum to a limit, or until the data exclude what lies beyond; steps along the scale."""
        p, sign = self.space[self.name], math.copysign(1.0, limit - centre.value)
        found, here, size, lowest = list[_Point](), centre, first, centre.data
        while len(found) < _MOST:
            left = abs(p.coordinate(limit) - p.coordinate(here.value))
            if abs(limit - here.value) <= 1e-9 * max(abs(limit), abs(centre.value), 1e-300):
                return found, True
            # The last points go to the limit whatever the step: it is part of the answer.
            size = left if len(found) == _MOST - 1 else min(size, left)
            value = limit if size >= 0.999 * left else p.of_coordinate(p.coordinate(here.value) + sign * size)
            moved = value - here.value
            start = {n: self.space[n].moved(here.values[n], self.follow[n] * moved) for n in self.follow}
            there = self.at(value, {**here.values, **start})
            if there is None:
                size /= 4
                if size < 1e-3 * first:
                    return found, False
                continue
            found.append(there)
            lowest = min(lowest, there.data)
            root = math.sqrt(max(there.data - lowest, 0.0))
            grown = root - math.sqrt(max(here.data - lowest, 0.0))
            if grown > 3 * _AIM and len(found) < _MOST:  # too far for the curve between: go there in shorter steps
                size *= max(_AIM / grown, 0.1)
                continue
            if root > 1.3 * WIDE:
                return found, False
            size *= min(max(_AIM / max(abs(grown), 1e-12), 0.5), 2.0)
            here = there
        return found, False


def _sums(points: list[_Point], p: Parameter) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values in ascending order, and their sums of squares without and with the parameter's prior."""
    points.sort(key=lambda point: point.value)
    at = np.array([one.value for one in points])
    data = np.array([one.data for one in points])
    return at, data, data + np.array([p.pull(value) for value in at.tolist()]) ** 2


def _sharpen(points: list[_Point], scan: _Scan, p: Parameter) -> None:
    """Add points at the ends of the intervals until one lies there: steps are coarse where a model is curved."""
    for which, end, _ in itertools.product((1, 2), (0, 1), range(_CORRECTIONS)):
        sums = _sums(points, p)
        value = _crossings(p, sums[0], sums[which])[end]
        if math.isnan(value):
            continue
        nearest = int(np.argmin(np.abs(sums[0] - value)))
        root = math.sqrt(sums[which][nearest] - sums[which].min())
        if abs(root / WIDE - 1) < _CLOSE:
            continue
        there = scan.at(value, points[nearest].values)
        points += [] if there is None else [there]


def _crossings(p: Parameter, at: np.ndarray, misfit: np.ndarray) -> tuple[float, float]:
    """Where the root of the rise passes `WIDE` on either side of the lowest point; NaN where it does not."""
    lowest = int(np.argmin(misfit))
    root = np.sqrt(np.maximum(misfit - misfit[lowest], 0.0))
    ends, along = [], np.array([p.coordinate(value) for value in at.tolist()])
    for part in (slice(lowest, None, -1), slice(lowest, None, 1)):
        x, r = along[part], root[part]
        beyond = np.flatnonzero(r >= WIDE)
        if not len(beyond):
            ends.append(math.nan)
            continue
        k = int(beyond[0])  # linear in the root between two points: exact where the model is linear
        end = x[k - 1] + (x[k] - x[k - 1]) * (WIDE - r[k - 1]) / (r[k] - r[k - 1])
        ends.append(p.of_coordinate(float(end)))
    return ends[0], ends[1]


def _differs(p: Parameter, found: tuple[float, float], linear: Sequence[float], std: float) -> bool:
    """Whether an end of the interval is elsewhere by more than `Rules.profile_differs` of the half-width.

    ``std`` is a share of the way between the limits.
    """
    for end, straight in zip(found, linear, strict=True):
        if math.isfinite(end) != math.isfinite(straight):
            return True
        far = RULES.profile_differs * WIDE * std
        if math.isfinite(end) and abs(p.position(end) - p.position(straight)) > far:
            return True
    return False


def _sentence(one: Profile, linear: Sequence[float], differs: bool, elsewhere: float) -> str:
    p = one.parameter
    scale = "" if p.unit == "-" else f" {p.unit}"

    def between(ends: Sequence[float]) -> str:
        lower, upper = ends
        if math.isfinite(lower) and math.isfinite(upper):
            return f"{lower:.4g} to {upper:.4g}{scale}"
        if math.isfinite(lower):
            return f"above {lower:.4g}{scale}"
        return f"below {upper:.4g}{scale}" if math.isfinite(upper) else "all values within the limits"

    if one.kind == "two-sided":
        words = [f"The data exclude values on both sides: 95 % interval {between(one.interval)}."]
    elif one.kind == "one-sided":
        words = [f"The data bound it on one side only: {between(one.data_interval)}."]
    else:
        words = ["The data exclude no value within its limits."]
    if one.kind != "two-sided" and np.isfinite(one.interval).all():
        words.append(f"With its prior: {between(one.interval)}.")
    if differs:
        words.append(f"The linearised interval differs: {between(linear)}; use this one.")
    if math.isfinite(elsewhere):
        words.append(f"The model fits better at {elsewhere:.4g}{scale}: calibrate again from there.")
    if one.failed:
        words.append(f"The model could not be solved at {len(one.failed)} of the values tried.")
    return " ".join(words)
