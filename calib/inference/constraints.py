"""What linear constraints and limits tell of fitted parameters: constraints that count as data, and those that hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import special

from calib.inference.rules import RULES, WIDE
from calib.problem.parameter import limit_at
from calib.problem.space import LinearConstraint, ParameterSpace

_NONE: Mapping[str, float] = MappingProxyType({})
_EXACT = 1e-4
"""Standard deviation of an equality, over that of its sum without it: far below what any verdict tells apart."""
_LEVEL = 0.05
"""Probability outside an interval of 95 %."""


class ConstraintRows(NamedTuple):
    """Rows of a whitened residual beside the data: constraints that count as data, and correlated priors.

    Attributes
    ----------
    slope : ndarray (n, n_params)
        Per unit of each fitted parameter.
    held : ndarray (n, n_held)
        Change by one standard deviation of each held parameter.
    constraints : tuple of LinearConstraint
        Those that count; their rows are the last ones, and 0 where they are kept.
    of_priors : ndarray (n_correlated,)
        The first rows, see `calib.problem.prior.Prior.beside`.
    """

    slope: np.ndarray
    held: np.ndarray
    constraints: tuple[LinearConstraint, ...] = ()
    of_priors: np.ndarray = np.zeros(0)

    @property
    def residual(self) -> np.ndarray:
        """The rows themselves, (n,)."""
        return np.pad(self.of_priors, (0, len(self.slope) - len(self.of_priors)))

    @staticmethod
    def none(n_params: int, n_held: int = 0) -> ConstraintRows:
        """No constraint."""
        return ConstraintRows(np.zeros((0, n_params)), np.zeros((0, n_held)))

    def beside(self, n: int) -> ConstraintRows:
        """The same beside ``n`` more held quantities that no constraint contains."""
        return self._replace(held=np.hstack([self.held, np.zeros((len(self.held), n))]))


def constraint_rows(
    space: ParameterSpace, names: Sequence[str], covariance: np.ndarray, held_sd: Mapping[str, float] = _NONE
) -> ConstraintRows:
    """Equalities and narrow constraints of both sides as data.

    A sum between two limits has the standard deviation ``(upper - lower)/sqrt(12)``, that of the uniform distribution,
    as a parameter between its limits has. The constraint counts where this is at most `Rules.narrow` of the standard
    deviation that the sum has without it; a wider one tells nothing until it is reached.

    Parameters
    ----------
    space : ParameterSpace
    names : sequence of str
        Fitted parameters.
    covariance : ndarray (n_params, n_params)
        Of the fitted parameters, without constraints; may be infinite on the diagonal.
    held_sd : mapping from str to float
        Standard deviations of held parameters that are uncertain.
    """
    rows, counted = [], []
    for constraint in space.constraints:
        if not (math.isfinite(constraint.lower) and math.isfinite(constraint.upper)):
            continue
        c, weights = _weights(constraint, names), dict(constraint.coefficients)
        std = std_of_sum(c, covariance)
        width = (constraint.upper - constraint.lower) / math.sqrt(12.0)
        if not std > 0 or width > RULES.narrow * std:
            continue
        finite = std if math.isfinite(std) else float(np.abs(c) @ [space[n].upper - space[n].lower for n in names])
        beside = [weights.get(name, 0.0) * sd for name, sd in held_sd.items()]
        rows.append(np.concatenate([c, beside]) / max(width, _EXACT * finite))
        counted.append(constraint)
    every = np.array(rows).reshape(len(rows), len(names) + len(held_sd))
    return ConstraintRows(every[:, : len(names)], every[:, len(names) :], tuple(counted))


def std_of_sum(weights: np.ndarray, covariance: np.ndarray) -> float:
    """Standard deviation of a weighted sum; infinite where that of one of its parameters is."""
    taken = np.flatnonzero(weights)
    own = weights[taken] @ covariance[np.ix_(taken, taken)] @ weights[taken]
    return math.sqrt(own) if own >= 0 else 0.0


def _weights(constraint: LinearConstraint, names: Sequence[str]) -> np.ndarray:
    given = dict(constraint.coefficients)
    return np.array([given.get(name, 0.0) for name in names])


class Hold(NamedTuple):
    """A limit or constraint that holds a parameter.

    Attributes
    ----------
    by : str
        Name of the constraint; empty for a limit of the parameter.
    side : int
        1 where the parameter would grow without it, -1 where it would fall.
    beyond : float
        How far the optimum lies beyond it, in standard deviations of the sum that it limits.
    part : float
        Absolute correlation of the parameter with that sum; 1 for a limit.
    beside : str
        The limit of another parameter, or the constraint of others, in words; empty where the parameter takes part.
    """

    by: str
    side: int
    beyond: float
    part: float
    beside: str = ""

    def interval(self, std: float) -> tuple[float, float]:
        """Ends of the interval of 95 %, less the value, on the allowed side: of a normal distribution, truncated.

        What of the parameter does not depend on the sum has an interval of both sides, and so has a parameter beside
        what is held.
        """
        if self.beside:
            return -WIDE * std, WIDE * std
        # P(t > q) = Phi(-beyond - q)/Phi(-beyond) for the distance t from the limit.
        tail = float(special.log_ndtr(-self.beyond)) + math.log(_LEVEL)
        reach = self.part * std * (-float(special.ndtri_exp(tail)) - self.beyond)
        free = WIDE * std * math.sqrt(max(1 - self.part**2, 0.0))
        inward, outward = math.hypot(reach, free), free
        return (-inward, outward) if self.side > 0 else (-outward, inward)


def holds(
    space: ParameterSpace,
    names: Sequence[str],
    values: Mapping[str, float],
    covariance: np.ndarray,
    descent: np.ndarray,
    as_data: Sequence[LinearConstraint] = (),
    searched: bool = False,
    held_sd: Mapping[str, float] = _NONE,
    shift: np.ndarray | None = None,
) -> dict[str, Hold]:
    """Fitted parameters that a limit or a constraint holds.

    A constraint holds parameters where their sum is on it (see `calib.problem.parameter.limit_at`), unless it counts
    as data: of its parameters those that it informs more than all else does, or that would move by more than one
    standard deviation without it. A constraint holds nothing where held parameters leave its sum more uncertain than
    the fitted ones do. A limit holds its parameter. Other parameters, beside a limit or a constraint, are held where
    they would move by more than one standard deviation without it.

    Parameters
    ----------
    space : ParameterSpace
    names : sequence of str
        Fitted parameters.
    values : mapping from str to float
        At the end of the fit.
    covariance : ndarray (n_params, n_params)
        Without those constraints that do not count as data, and without held parameters.
    descent : ndarray (n_params,)
        Direction in which the misfit falls; see `calib.inference.region.active_limits`.
    as_data : sequence of LinearConstraint
        Constraints that count as data; see `constraint_rows`.
    searched : bool
        See `calib.inference.identify.Identifiability`.
    held_sd : mapping from str to float
        Standard deviations of held parameters that are uncertain.
    shift : ndarray (n_params, n_held), optional
        Of the estimates, by one standard deviation of each of these, and of further errors.
    """
    shift = np.zeros((len(names), len(held_sd))) if shift is None else shift
    std, found = np.sqrt(np.diag(covariance) + np.sum(shift**2, axis=1)), dict[str, Hold]()
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    for constraint in space.constraints:
        c = _weights(constraint, names)
        alone = std_of_sum(c, covariance)
        unsure = math.hypot(*(weight * held_sd.get(name, 0.0) for name, weight in constraint.coefficients))
        if constraint in as_data or not alone > unsure:
            continue
        own = math.hypot(alone, float(np.linalg.norm(shift.T @ c)))
        total = sum(weight * values[name] for name, weight in constraint.coefficients)
        at = limit_at(total, constraint.lower, constraint.upper, own, searched)
        if at is None:
            continue
        side = 1 if at == "upper" else -1
        by_data = finite @ c
        along, push = by_data + shift @ (shift.T @ c), max(side * float(by_data @ descent), 0.0)
        beyond = push / own if math.isfinite(own) else 0.0
        for k in range(len(names)):
            part, moved = 1.0, beyond
            if math.isfinite(own * std[k]) and std[k] > 0:
                part, moved = abs(float(along[k])) / (own * std[k]), abs(float(by_data[k])) * push / (alone**2 * std[k])
            way = int(side * np.sign(by_data[k] or c[k]))
            if c[k] and (part**2 >= RULES.by_data or moved >= 1.0):
                found[names[k]] = Hold(constraint.name, way, beyond, min(part, 1.0))
            elif moved >= 1.0 and std[k] > 0 and math.isfinite(own * std[k]):
                found.setdefault(names[k], Hold("", way, moved, 1.0, f"the constraint {constraint.name!r}"))
    on = dict[int, int]()
    for k, name in enumerate(names):
        at = space[name].limit_at(values[name], float(std[k]), searched)
        if at is not None:
            on[k] = side = 1 if at == "upper" else -1
            moved = side * float(finite[k] @ descent) / std[k] if 0 < std[k] < math.inf else 0.0
            found[name] = Hold("", side, max(moved, 0.0), 1.0)
    pushed = {k: side for k, side in on.items() if side * descent[k] > 0}
    moves = finite[:, list(pushed)] * descent[list(pushed)]  # of each parameter, without the limit of each of those
    for k in np.flatnonzero(np.abs(moves.sum(axis=1)) >= std).tolist():
        if names[k] not in found and std[k] > 0:
            most = int(np.argmax(np.abs(moves[k])))
            way, moved = int(np.sign(moves[k].sum())), float(abs(moves[k].sum()) / std[k])
            found[names[k]] = Hold("", way, moved, 1.0, f"the limit of {names[list(pushed)[most]]}")
    return found


def multipliers(
    space: ParameterSpace, names: Sequence[str], values: Mapping[str, float], descent: np.ndarray
) -> np.ndarray:
    """The direction in which the misfit falls, without what active constraints take up, (n_params,).

    At an optimum it is a sum of the gradients of constraints that are reached and of limits that are reached.
    """
    active = []
    for constraint in space.constraints:
        total = sum(weight * values[name] for name, weight in constraint.coefficients)
        size = sum(abs(weight) * (space[name].upper - space[name].lower) for name, weight in constraint.coefficients)
        if min(abs(total - constraint.lower), abs(total - constraint.upper)) <= 1e-6 * size:
            active.append(_weights(constraint, names))
    free = np.array([space[name].limit_at(values[name]) is None for name in names], dtype=bool)
    matrix = np.array(active).reshape(len(active), len(names)).T
    if not active or not free.any():
        return descent
    span = np.array([space[name].upper - space[name].lower for name in names])
    scaled, right = matrix * span[:, None], descent * span
    factor = np.linalg.lstsq(scaled[free], right[free], rcond=None)[0]
    return (right - scaled @ factor) / span
