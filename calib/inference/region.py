"""Feasible region: limits and linear constraints in scaled parameters, and the best step within them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from calib.errors.errors import InputError
from calib.problem.space import ParameterSpace

ACTIVE = 1e-6
"""Distance to a limit, over the range, below which a step is held by it: its rounding, not what is reported."""


class InfeasibleError(InputError):
    """No point keeps the limits and constraints at the given values of fixed and integer parameters."""


@dataclass(frozen=True, eq=False)
class Region:
    """Limits and constraints over parameters scaled to 0..1 between their limits: ``rows @ x >= least``.

    Of a parameter with a logarithmic scale (``log``) ``lower`` and ``span`` are those of its logarithm. Where all free
    parameters are integers there are no names, and the region is a point.
    """

    space: ParameterSpace
    names: tuple[str, ...]
    fixed: dict[str, float]
    start: np.ndarray
    lower: np.ndarray
    span: np.ndarray
    log: np.ndarray
    rows: np.ndarray
    least: np.ndarray
    labels: tuple[str, ...]

    @classmethod
    def of(cls, space: ParameterSpace, start: dict[str, float]) -> Region:
        """Region of the free parameters that are not integers; all others stay at the start."""
        if not space.free:
            raise InputError("no parameter is free to be fitted", place="fit", remedy="free one")
        chosen = [p for p in space.free if not p.integer]
        names = tuple(p.name for p in chosen)
        log = np.array([p.is_log for p in chosen], dtype=bool)
        lower = np.array([math.log(p.lower) if p.is_log else p.lower for p in chosen])
        span = np.array([p.span_at(1.0) for p in chosen])
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
                            raise InfeasibleError("the fixed values break it", place=f"constraint {con.name}")
                        continue
                    rows.append(sign * row / size)
                    least.append(sign * (limit - shift) / size)
                    labels.append(f"{con.name} at its {word} limit")
        return cls(
            space=space,
            names=names,
            fixed={n: v for n, v in start.items() if n not in names},
            start=np.array([p.position(start[p.name]) for p in chosen]),
            lower=lower,
            span=span,
            log=log,
            rows=np.array(rows).reshape(len(rows), len(names)),
            least=np.array(least),
            labels=tuple(labels),
        )

    @cached_property
    def _inequalities(self) -> tuple[np.ndarray, np.ndarray]:
        """All limits and constraints as ``rows @ x >= least``."""
        one = np.eye(len(self.names))
        return (
            np.vstack([one, -one, self.rows]),
            np.concatenate([np.zeros(len(one)), -np.ones(len(one)), self.least]),
        )

    def values(self, x: np.ndarray) -> dict[str, float]:
        """All parameters at a point (n_params,) of the unit box, each in its own unit."""
        point = self.lower + self.span * x
        if self.log.any():
            point = np.where(self.log, np.exp(np.where(self.log, point, 0.0)), point)
            low, high = ([getattr(self.space[n], end) for n in self.names] for end in ("lower", "upper"))
            point = np.where(self.log, np.clip(point, low, high), point)  # rounding of the exponential
        return self.fixed | dict(zip(self.names, point.tolist(), strict=True))

    def span_at(self, x: np.ndarray) -> np.ndarray:
        """Derivative of the values by x at a point (n_params,)."""
        point = self.lower + self.span * x
        return self.span * np.exp(np.where(self.log, point, 0.0))

    def inside(self, x: np.ndarray) -> np.ndarray:
        """The point clipped to the limits (removes rounding)."""
        return np.clip(x, 0.0, 1.0)

    def nearest(self, x: np.ndarray) -> np.ndarray:
        """The nearest feasible point; a feasible point is returned as it is."""
        rows, least = self._inequalities
        if np.all(rows @ x >= least - 1e-12):
            return self.inside(x)
        moved = _least_distance(rows, least - rows @ x)
        if moved is None:
            self.space.require_feasible()
            raise InfeasibleError("no point keeps the limits and constraints", place="constraints")
        return self.inside(x + moved)

    def step(self, matrix: np.ndarray, right: np.ndarray, mu: float, x: np.ndarray) -> np.ndarray:
        """Minimum of ``|matrix d + right|^2 + mu |d|^2`` with x + d within all limits and constraints."""
        n = len(x)
        if not n:
            return np.zeros(0)
        ridge = max(mu, 1e-14 * float(np.max(np.sum(matrix**2, axis=0), initial=1e-300)))
        whole = np.vstack([matrix, math.sqrt(ridge) * np.eye(n)])
        q, r = np.linalg.qr(whole)
        target = -(q.T @ np.concatenate([right, np.zeros(n)]))
        rows, least = self._inequalities
        room = np.minimum(least - rows @ x, 0.0)  # the present point is feasible up to rounding
        free = np.linalg.solve(r, target)
        if np.all(rows @ free >= room):
            return free
        # With z = r d - target the problem is to find the shortest z that keeps all constraints.
        transformed = np.linalg.solve(r.T, rows.T).T
        size = np.linalg.norm(transformed, axis=1)
        z = _least_distance(transformed / size[:, None], (room - transformed @ target) / size)
        if z is None:
            return np.zeros(n)
        return np.linalg.solve(r, z + target)

    def active(self, x: np.ndarray) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Active limits and constraints, in words."""
        limits = [f"{n} at its lower limit" for n, v in zip(self.names, x, strict=True) if v < ACTIVE]
        limits += [f"{n} at its upper limit" for n, v in zip(self.names, x, strict=True) if v > 1 - ACTIVE]
        gap = self.rows @ x - self.least
        return tuple(limits), tuple(label for label, g in zip(self.labels, gap, strict=True) if g < ACTIVE)


def active_limits(
    space: ParameterSpace, names: Sequence[str], values: Mapping[str, float], descent: np.ndarray
) -> frozenset[str]:
    """Parameters with an active limit at the end of a fit: beyond it the misfit would fall.

    Parameters
    ----------
    space : ParameterSpace
    names : sequence of str
        Fitted parameters.
    values : mapping from str to float
    descent : ndarray (n_params,)
        Direction in which the misfit falls, ``G^T e - (theta - c)/s^2`` with ``G = -de/dtheta``.
    """
    held = []
    for name, down in zip(names, descent, strict=True):
        p = space[name]
        near = ACTIVE * p.span_at(values[name])
        if (down > 0 and values[name] > p.upper - near) or (down < 0 and values[name] < p.lower + near):
            held.append(name)
    return frozenset(held)


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
