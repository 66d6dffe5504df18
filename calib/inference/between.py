"""How much a parameter varies between several tests, such as specimens: its mean, its spread, and each test's value."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from calib.errors.errors import EvaluationError
from calib.inference.gauss_newton import fit
from calib.inference.rules import WIDE
from calib.problem.apart import ApartProblem
from calib.problem.joint import JointProblem
from calib.problem.prior import Prior

COLUMNS = ("parameter", "unit", "what", "value", "low", "high", "p")
MEAN, SPREAD = "mean of the tests", "spread between the tests"
"""Rows beside those of the tests, whose names hold no blanks."""
LEAST_TESTS = 3
"""Of two tests one difference is known, which says next to nothing about a spread."""
_GRID, _LEAST = 160, 1e-4
"""Spreads that are tried, evenly in their logarithm, and the smallest over the largest, as good as none."""
_TURNS, _SETTLED = 6, 0.02
"""Fits at most, and the relative change of the spread below which no more follow."""


@dataclass(frozen=True)
class Between:
    """Parameters with a value of their own in each test, fitted together with all that the tests share.

    Attributes
    ----------
    table : DataFrame
        `COLUMNS`: 95 % intervals; ``p`` of a spread is the p-value of none.
    misfit, shared_misfit : float
        Sum of squares with own values, and with shared ones.
    p_fit : float
        p-value of the former, with the degrees of freedom that the own values leave.
    failed : str
        Why the fit ended early; empty where it did not.
    """

    table: pd.DataFrame
    misfit: float
    shared_misfit: float
    p_fit: float = float("nan")
    failed: str = ""

    @property
    def sentence(self) -> str:
        """Mean and spread of each parameter in words."""
        words = [f"The spread between the tests is unknown: {self.failed}."] if self.failed else []
        for name, own in self.table.groupby("parameter", sort=False):
            rows = {str(row["what"]): row for row in own.to_dict("records")}
            mean, spread = rows[MEAN], rows[SPREAD]
            words.append(
                f"{name} varies between {len(own) - 2} tests with a standard deviation of {_interval(spread)} about "
                f"{_interval(mean)} (p = {spread['p']:.2g} if it did not)."
            )
        if len(self.table):
            words.append(
                f"With own values the sum of squares is {self.misfit:.4g} (p = {self.p_fit:.2g}), with shared ones "
                f"{self.shared_misfit:.4g}."
            )
        return " ".join(words)


def _interval(row: Mapping[Hashable, Any]) -> str:
    unit = "" if row["unit"] == "-" else f" {row['unit']}"
    return f"{row['value']:.4g}{unit} (95 %: {row['low']:.4g} to {row['high']:.4g})"


@dataclass(frozen=True)
class _Linear:
    """The problem to first order: ``|data + slope u|^2 + |pull + u / width|^2``, u being steps and own values.

    The first columns are parameters that tests share, then come differences of each varying parameter, then errors that
    rows share.
    """

    data: np.ndarray
    slope: np.ndarray
    pull: np.ndarray
    precision: np.ndarray
    blocks: tuple[np.ndarray, ...]

    def solved(self, spreads: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Logarithm of the likelihood of the spreads, u marginalised; u, and its covariance.

        Source: Gaussian integral over u; for flat priors that of restricted maximum likelihood (Patterson and Thompson
        1971).
        """
        precision = self.precision.copy()
        for own, spread in zip(self.blocks, spreads, strict=True):
            precision[own] = 1 / spread**2
        normal = self.slope.T @ self.slope + np.diag(precision)
        right = self.slope.T @ self.data + self.pull * np.sqrt(self.precision)
        factor = np.linalg.cholesky(normal)
        half = np.linalg.solve(factor, right)
        inverse = np.linalg.inv(factor)
        count = sum(len(own) * 2 * np.log(spread) for own, spread in zip(self.blocks, spreads, strict=True))
        likelihood = -0.5 * (count + 2 * np.log(np.diag(factor)).sum() - half @ half)
        return float(likelihood), -inverse.T @ half, inverse.T @ inverse


def tests_that_free(problem: JointProblem, name: str) -> list[str]:
    """Tests in which a parameter is free: those that neither lack it nor hold it at a value of their own."""
    return [test for test, part in problem.parts.items() if name in (p.name for p in part.space.free)]


def between_tests(problem: JointProblem, varies: Sequence[str], values: Mapping[str, float]) -> Between:
    """Fit some parameters with a value of their own in each test about a common mean, and estimate their spread.

    Differences from the mean are normal with the spread as standard deviation, which has a uniform prior up to the
    parameter's own prior width. Where several parameters vary, the spreads of the others are at their most probable
    values. Errors that rows of a test share count. Source: a hierarchical model, Gelman et al. 2013, ch. 5, to first
    order at the fit.

    Parameters
    ----------
    problem : JointProblem
    varies : sequence of str
        Fitted parameters of at least three tests; see `tests_that_free`.
    values : mapping from str to float
        Of the fit with shared values.
    """
    acting = {name: tests_that_free(problem, name) for name in varies}
    chosen = [(name, test) for name in varies for test in acting[name]]
    reach = np.array([problem.space[name].prior_width for name in varies])
    before_fit = problem.residual(values)
    spreads, at = reach / 3, dict(values)  # the spread is fitted anew in every turn, wherever it begins
    for _ in range(_TURNS):
        apart = ApartProblem(problem, chosen, dict(zip(varies, spreads, strict=True)))
        try:
            at = fit(apart, apart.space, at).values
        except EvaluationError as fault:
            return Between(
                pd.DataFrame(columns=list(COLUMNS)), float("nan"), float(before_fit @ before_fit), failed=str(fault)
            )
        names = tuple(p.name for p in apart.space.free if not p.integer)
        linear, residual = _linearised(apart, names, at, varies, problem.shared_errors)
        grids, levels = _levels(linear, reach, spreads)
        before, spreads = (
            spreads,
            np.array([_quantile(grid, level, 0.5) for grid, level in zip(grids, levels, strict=True)]),
        )
        if np.all(np.abs(spreads / before - 1) < _SETTLED):
            break
    rows: list[tuple[object, ...]] = []
    for k, name in enumerate(varies):
        unit = problem.space[name].unit
        shared = names.index(name)
        middle, std = _mixed(linear, spreads, k, shared, grids[k], _weights(grids[k], levels[k]))
        mean, wide = at[name] + middle[shared], WIDE * std[0]
        drop = 2 * (levels[k].max() - levels[k][0])
        ends = [_quantile(grids[k], levels[k], q) for q in (0.5, 0.025, 0.975)]
        rows.append((name, unit, MEAN, mean, mean - wide, mean + wide, np.nan))
        rows.append((name, unit, SPREAD, *ends, float(0.5 * special.chdtrc(1, max(drop, 0.0)))))
        for j, test in enumerate(acting[name]):
            value, reach_of = mean + middle[linear.blocks[k][j]], WIDE * std[1 + j]
            rows.append((name, unit, test, value, value - reach_of, value + reach_of, np.nan))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    _, _, covariance = linear.solved(spreads)
    measured = linear.slope[: len(residual)]  # without rows of correlated priors
    dof = len(residual) - float(np.sum(covariance * (measured.T @ measured)))
    misfit = float(residual @ residual)
    return Between(table, misfit, float(before_fit @ before_fit), float(special.chdtrc(max(dof, 1.0), misfit)))


def _linearised(
    apart: ApartProblem, names: Sequence[str], at: Mapping[str, float], varies: Sequence[str], errors: np.ndarray
) -> tuple[_Linear, np.ndarray]:
    residual, slope = apart.residual(at), apart.jacobian(at, names)
    blocks = tuple(
        np.array([k for k, label in enumerate(names) if label in apart.own and apart.own[label][0] == name])
        for name in varies
    )
    own = np.concatenate(blocks)
    prior = Prior.of(apart.space)
    pulls, rows = prior.rows(at, names)
    (pull, beside), more = np.split(pulls, [len(names)]), rows[len(names) :]
    weight = np.diag(rows[: len(names)]).copy()
    weight[own] = pull[own] = 0.0
    data = residual - slope[:, own] @ np.array([at[names[k]] for k in own])
    count = errors.shape[1]
    all_rows = np.block([[slope, errors], [more, np.zeros((len(more), count))]])
    return _Linear(
        np.concatenate([data, beside]), all_rows, np.concatenate([pull, np.zeros(count)]),
        np.concatenate([weight**2, np.ones(count)]), blocks,
    ), residual  # fmt: skip


def _levels(linear: _Linear, reach: np.ndarray, start: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Spreads that are tried for each parameter, and their log-likelihood with the others at the most probable ones."""
    grids = [np.geomspace(_LEAST * one, one, _GRID) for one in reach]
    best = np.array(start, dtype=float)
    levels = [np.zeros(_GRID) for _ in grids]
    for _ in range(1 if len(grids) == 1 else 3):
        for k, grid in enumerate(grids):
            tried = np.tile(best, (_GRID, 1))
            tried[:, k] = grid
            levels[k] = np.array([linear.solved(one)[0] for one in tried])
            best[k] = grid[int(np.argmax(levels[k]))]
    return grids, levels


def _weights(grid: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Probability of each spread that was tried, under a uniform prior."""
    density = np.exp(level - level.max()) * grid
    density[[0, -1]] /= 2
    return density / density.sum()


def _quantile(grid: np.ndarray, level: np.ndarray, share: float) -> float:
    weight = _weights(grid, level)
    return float(np.exp(np.interp(share, np.cumsum(weight) - weight / 2, np.log(grid))))


def _mixed(
    linear: _Linear, spreads: np.ndarray, k: int, shared: int, grid: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean of u over the spreads of one parameter; standard deviations of its mean and of each test's value.

    ``shared`` is the column of the parameter's mean.
    """
    own = linear.blocks[k]
    means, squares = [], []
    pick = np.zeros((1 + len(own), linear.slope.shape[1]))
    pick[:, shared] = 1.0
    pick[np.arange(1, 1 + len(own)), own] = 1.0
    for spread in grid:
        tried = spreads.copy()
        tried[k] = spread
        _, middle, covariance = linear.solved(tried)
        means.append(middle)
        squares.append(np.einsum("ij,jk,ik->i", pick, covariance, pick))
    middle = weight @ np.array(means)
    scatter = weight @ (np.array(means) @ pick.T - middle @ pick.T) ** 2
    return middle, np.sqrt(weight @ np.array(squares) + scatter)
