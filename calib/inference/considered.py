"""Considered parameters: held ones whose values are uncertain, and what they add to the uncertainty of fitted ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.inference.constraints import ConstraintRows, std_of_sum
from calib.inference.gauss_newton import FitSettings, fit
from calib.inference.identify import posterior
from calib.inference.region import InfeasibleError
from calib.inference.rules import RULES
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.results.answer import with_std

COLUMNS = ("parameter", "value", "unit", "std", "adds_to", "std_without", "std_with", "matters", "words")


class Fittable(Protocol):
    """A problem that can be fitted again with a held parameter elsewhere."""

    @property
    def space(self) -> ParameterSpace:
        """Its free parameters are fitted."""
        ...

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """See `calib.inference.gauss_newton.LeastSquares`."""
        ...

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """See `calib.inference.gauss_newton.LeastSquares`."""
        ...


class At(NamedTuple):
    """A fit at its end.

    Attributes
    ----------
    names : tuple of str
        Fitted parameters.
    values : mapping from str to float
    residual : ndarray (n_rows,)
        Whitened.
    slope : ndarray (n_rows, n_params)
        Its derivative.
    prior_sd : ndarray (n_params,)
    fitted : bool
        Whether least squares ended there, so that a fit elsewhere can be compared with it.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    fitted: bool


class HeldChanges(NamedTuple):
    """Changes of the whitened residual by one standard deviation of each held parameter, (n_rows, n_held).

    Attributes
    ----------
    of_rows : ndarray
        H: those of the data.
    of_estimates : ndarray
        The H of which ``B = -V G^T H`` is how the estimates shift: the same where that is linear.
    """

    of_rows: np.ndarray
    of_estimates: np.ndarray


Nearby: TypeAlias = Callable[[Sequence[Mapping[str, float]]], Fittable]
"""Makes a problem that is accurate at given values too, where one of lower order is not by itself."""


def changes_by_held(
    problem: Fittable, at: At, held_sd: Mapping[str, float], nearby: Nearby | None = None
) -> HeldChanges:
    """Changes of the whitened residual by one standard deviation of each held parameter.

    The shift of the estimates that follows, ``B = -V G^T H``, is linear. Whether that holds is seen from the residual
    at one standard deviation to either side (sigma points; Julier and Uhlmann 2004), within the limits, with the
    estimates moved along: where it differs from the linear one by what moves them further than `Rules.linear`, or the
    points break a constraint by as much, H is taken from these points, and after a fit B from new fits there.

    Parameters
    ----------
    problem : Fittable
        It may be of lower order than the one that was fitted.
    at : At
    held_sd : mapping from str to float
        Standard deviations of the held parameters.
    nearby : callable, optional
        For a problem of lower order, which may not represent what a held parameter changes: it is asked only where that
        is not linear.
    """
    if not held_sd:
        none = np.zeros((len(at.residual), 0))
        return HeldChanges(none, none)
    covariance = posterior(at.names, at.slope, at.prior_sd).covariance
    linear = problem.jacobian(at.values, tuple(held_sd)) * list(held_sd.values())
    centre = problem.residual(at.values)
    every = [
        _SigmaPoints.of(problem, at, centre, covariance, name, sd, linear[:, k])
        for k, (name, sd) in enumerate(held_sd.items())
    ]
    bent = [k for k, one in enumerate(every) if one is not None and not one.is_linear]
    if bent and nearby is not None:
        names = tuple(held_sd)
        problem = nearby([point for k in bent for point in every[k].points])  # type: ignore[union-attr]
        centre = problem.residual(at.values)
        sharper = problem.jacobian(at.values, [names[k] for k in bent])
        for k, column in zip(bent, sharper.T, strict=True):
            linear[:, k] = column * held_sd[names[k]]
            every[k] = _SigmaPoints.of(problem, at, centre, covariance, names[k], held_sd[names[k]], linear[:, k])
    shifting = linear.copy()
    for k, one in enumerate(every):
        if one is not None and not one.is_linear:
            linear[:, k] = one.secant
            shifting[:, k] = one.refitted(problem) if at.fitted else one.secant
    return HeldChanges(linear, shifting)


@dataclass(frozen=True, eq=False)
class _SigmaPoints:
    """A held parameter at one standard deviation to either side, with the estimates moved along as far as is linear.

    Attributes
    ----------
    at : At
    covariance : ndarray (n_params, n_params)
        Of the estimates, without held parameters.
    name : str
        The held parameter.
    sd : float
        Its standard deviation.
    linear : ndarray (n_rows,)
        Change of the residual by one standard deviation, by the derivative.
    points : pair of dict
        Values, low and high.
    off : ndarray (n_rows, 2)
        What the residual there has beyond the linear one.
    cut : ndarray (n_params, 2)
        What limits leave out of the move of the estimates.
    width : float
        Distance of the points, in standard deviations: less than two at a limit.
    broken : bool
        Whether a point breaks a constraint by what counts.
    """

    at: At
    covariance: np.ndarray
    name: str
    sd: float
    linear: np.ndarray
    points: tuple[dict[str, float], dict[str, float]]
    off: np.ndarray
    cut: np.ndarray
    width: float
    broken: bool

    @classmethod
    def of(
        cls,
        problem: Fittable,
        at: At,
        centre: np.ndarray,
        covariance: np.ndarray,
        name: str,
        sd: float,
        linear: np.ndarray,
    ) -> _SigmaPoints | None:
        """The two points; None where there is no room, or the model cannot be evaluated there."""
        p, value = problem.space[name], at.values[name]
        ends = [_within(p, value, way * sd) for way in (-1, 1)]
        width = (ends[1] - ends[0]) / sd
        if not width > 0 or not np.all(np.isfinite(covariance)):
            return None
        shift, points, off, cut = -covariance @ (at.slope.T @ linear), [], [], []
        for end in ends:
            far = (end - value) / sd
            wanted = dict(zip(at.names, far * shift, strict=True))
            moved = {n: _within(problem.space[n], at.values[n], by) for n, by in wanted.items()}
            points.append({**at.values, **moved, name: end})
            by = np.array([moved[n] - at.values[n] for n in at.names])
            try:
                there = problem.residual(points[-1])
            except EvaluationError:
                return None
            off.append(there - centre - at.slope @ by - far * linear)
            cut.append(far * shift - by)
        pair = points[0], points[1]
        broken = any(_breaks(constraint, at.names, covariance, shift, pair) for constraint in problem.space.constraints)
        return cls(at, covariance, name, sd, linear, pair, np.column_stack(off), np.column_stack(cut), width, broken)

    @property
    def is_linear(self) -> bool:
        """Whether neither what is beyond the linear change nor a limit moves an estimate by over `Rules.linear`."""
        if self.broken:
            return False
        linear, *further = (self.covariance @ (self.at.slope.T @ np.column_stack([self.linear, self.off]))).T
        size = RULES.linear * np.hypot(np.sqrt(np.diag(self.covariance)), linear)
        return bool(np.all(np.abs([*further, *self.cut.T]) <= size))

    @property
    def secant(self) -> np.ndarray:
        """The change by one standard deviation, from the two points, (n_rows,)."""
        return np.asarray(self.linear + (self.off[:, 1] - self.off[:, 0]) / self.width)

    def refitted(self, problem: Fittable) -> np.ndarray:
        """The change that shifts the estimates as fits at the two points do; that of the points where these fail."""
        at = self.at
        try:
            ends = [fit(problem, problem.space, point, settings=_ROUGH).values for point in self.points]
        except (EvaluationError, InfeasibleError):
            return self.secant
        shift = self._shift(problem.space, np.array([[end[n] for n in at.names] for end in ends]))
        # Of all H with this B the one that differs from the secant within the columns of G.
        std = np.sqrt(np.diag(self.covariance))
        scale = np.where(std > 0, std, 1.0)
        g = at.slope * scale
        wanted = g.T @ self.secant + (g.T @ g + np.diag((scale / at.prior_sd) ** 2)) @ (shift / scale)
        return np.asarray(self.secant - g @ np.linalg.lstsq(g.T @ g, wanted, rcond=1e-10)[0])

    def _shift(self, space: ParameterSpace, ends: np.ndarray) -> np.ndarray:
        """Shift of the estimates by one standard deviation, (n_params,), from the fits at both points (2, n_params).

        The interval has two sides and the truth lies on either: where the shifts differ, as where a limit stops an
        estimate at one point, the larger counts. That of an estimate which is stopped at both is at least the linear
        one, which knows no limit.
        """
        names, centre = self.at.names, self.at.values
        far = np.array([(point[self.name] - centre[self.name]) / self.sd for point in self.points])
        moved = ends - np.array([centre[n] for n in names])
        sides = [by / way for by, way in zip(moved, far.tolist(), strict=True) if way]
        stopped = [[space[n].limit_at(v) is not None for n, v in zip(names, end, strict=True)] for end in ends.tolist()]
        free = -self.covariance @ (self.at.slope.T @ self.linear)
        every = np.array([*sides, np.where(np.all(stopped, axis=0), free, 0.0)])
        return np.asarray(every[np.argmax(np.abs(every), axis=0), np.arange(len(names))])


def _within(p: Parameter, value: float, change: float) -> float:
    """A value changed within the limits of its parameter, or not beyond itself where it is outside."""
    return min(max(value + change, min(p.lower, value)), max(p.upper, value))


def _breaks(
    constraint: LinearConstraint,
    names: Sequence[str],
    covariance: np.ndarray,
    shift: np.ndarray,
    points: Sequence[Mapping[str, float]],
) -> bool:
    """Whether a point breaks a constraint, which does not count as data, by over `Rules.linear` of its sum's std."""
    weights = dict(constraint.coefficients)
    c = np.array([weights.get(name, 0.0) for name in names])
    std = std_of_sum(c, covariance)
    if (constraint.upper - constraint.lower) / math.sqrt(12.0) <= RULES.narrow * std or not c.any():
        return False
    size = RULES.linear * math.hypot(std, float(c @ shift))
    sums = [sum(weight * point[name] for name, weight in weights.items()) for point in points]
    return any(not constraint.lower - size <= total <= constraint.upper + size for total in sums)


_ROUGH = FitSettings(iterations=10, gain=1e-2)
"""A tenth of a standard deviation is enough of a shift."""


def considered_table(
    space: ParameterSpace,
    at: At,
    held: np.ndarray,
    held_sd: Mapping[str, float],
    constraints: ConstraintRows,
    birge: float = 1.0,
    mesh_sd: float | None = None,
    shared: int = 0,
    equations: int = 0,
) -> pd.DataFrame:
    """What each held parameter adds to the standard deviation of the fitted one that it affects most.

    Parameters
    ----------
    space : ParameterSpace
    at : At
    held : ndarray (n_rows, n_held + n_meshes + n_equations + n_shared)
        `HeldChanges.of_estimates`, and changes by one standard deviation of the errors of meshes, of what a linear
        estimate errs by beyond least squares, and of those that rows share.
    held_sd : mapping from str to float
    constraints : ConstraintRows
    birge : float
        As in `calib.inference.identify.identify`.
    mesh_sd : float, optional
        Standard deviation of the errors of meshes, over the change to a finer mesh.
    shared : int
        Number of errors that rows share; they are told together.
    equations : int
        Number of directions in which a linear estimate errs more than least squares; told together too.

    Returns
    -------
    DataFrame
        `COLUMNS`; those that matter first, by the share of the variance that they add. ``std_without`` and ``std_with``
        are those of ``adds_to`` without and with this parameter alone; it ``matters`` where it gives at least
        `Rules.considered` of that variance.
    """
    rows = []
    slope = np.vstack([at.slope / birge, constraints.slope])
    alone = posterior(at.names, slope, at.prior_sd)
    single = held.shape[1] - shared - equations
    meshes = [(MESH_ERROR, mesh_sd or 0.0)] * (single - len(held_sd))
    each = [(name, sd, slice(k, k + 1)) for k, (name, sd) in enumerate([*held_sd.items(), *meshes])]
    for name, begin, count in ((EQUATION_ERRORS, single, equations), (SHARED_ERRORS, single + equations, shared)):
        each += [(name, 1.0, slice(begin, begin + count))] * (count > 0)
    for k, (name, sd, own) in enumerate(each):
        h = np.vstack([held[:, own] / birge, constraints.held[:, own]])
        shift = np.sqrt(np.sum((alone.covariance @ (slope.T @ h)) ** 2, axis=1))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.nan_to_num(shift**2 / (shift**2 + alone.std**2))
        if not len(share):
            continue
        most = int(np.argmax(share))
        to = at.names[most]
        without, with_it = float(alone.std[most]), float(np.hypot(alone.std[most], shift[most]))
        matters = bool(share[most] >= RULES.considered)
        others = [at.names[j] for j in np.argsort(-share)[1:] if share[j] >= RULES.considered]
        also = f" (and adds to {', '.join(others)})" if others else ""
        grows = f"takes the standard deviation of {to} from {without:.3g} to {with_it:.3g}{_unit(space[to].unit)}{also}"
        if k < len(held_sd):
            value, unit = at.values[name], space[name].unit
            words = f"{name} is held at {with_std(value, sd, _unit(unit))}, which {grows}: select it, or state how "
            words += "sure its value is."
        elif k < single:
            value, unit = 0.0, "-"
            words = f"The error of the mesh, ± {sd:.3g} times the change to a finer one, {grows}: refine the mesh."
        elif name == EQUATION_ERRORS:
            value, unit = 0.0, "-"
            words = f"That the cross-model equations weigh data otherwise than least squares {grows}: continue with "
            words += 'least squares (method = "gauss-newton").'
        else:
            value, unit = 0.0, "-"
            words = f"The accuracy that is claimed, where all lines share it at a resonance, {grows}: fit it along, as "
            words += "a nuisance (resonance)."
        rows.append((share[most], (name, value, unit, sd, to, without, with_it, matters, words)))
    rows.sort(key=lambda row: -row[0])
    return pd.DataFrame([row for _, row in rows], columns=list(COLUMNS))


MESH_ERROR = "mesh_error"
"""What the table calls the error of a mesh."""
EQUATION_ERRORS = "equation_errors"
"""What the table calls the errors of a linear estimate that least squares do not have."""
SHARED_ERRORS = "resonance_errors"
"""What the table calls the errors that rows share."""


def _unit(unit: str) -> str:
    return "" if unit == "-" else f" {unit}"
