"""Least squares in which every measured shape counts as one number, for a first fit from a distant start.

Each sensor adds a row, so that hundreds of them outweigh the frequencies by far. Shapes of close modes turn into each
other within a small change of a parameter, where one frequency veers away from the other: full weights then have many
minima in which some of these modes are exchanged or mixed, and a fit ends in the next one. Frequencies change evenly,
and lead to where the shapes agree.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np

from calib.inference.gauss_newton import LeastSquares
from calib.problem.labels import Label

Leap: TypeAlias = Callable[[Mapping[str, float]], dict[str, float]]
"""Leads from named values to others that are likely nearer; EvaluationError where the model fails on the way."""
MANY = 100
"""Rows of one shape from which a first fit weighs them evenly: fewer do not outweigh its frequency by much."""
LIMIT = 3.0
"""Limit of the other rows, over their median size or their standard deviation."""


class LabelledLeastSquares(LeastSquares, Protocol):
    """Least squares whose rows say what they are."""

    @property
    def rows(self) -> Sequence[Label]:
        """Labels of the rows, length n_rows."""
        ...


@dataclass(frozen=True, eq=False)
class EvenWeights:
    """A problem whose rows are weighted and limited.

    Attributes
    ----------
    problem : LeastSquares
    weights : ndarray (n_rows,)
        Of the residual and its derivatives.
    shapes : ndarray (n_rows,), bool
        Whether a row is one of a shape.
    most : float
        Limit of the other rows, beyond which an error costs no more: one mode that finds no partner on the way must
        not outweigh what all others gain.
    leap : callable, optional
        What is tried first.
    """

    problem: LeastSquares
    weights: np.ndarray
    shapes: np.ndarray
    most: float = math.inf
    leap: Leap | None = None

    @classmethod
    def of(cls, problem: LabelledLeastSquares, leap: Leap | None = None) -> EvenWeights | None:
        """The weights that make the rows of each shape count as one; None where no shape has `MANY`."""
        shapes = [(getattr(row, "test", ""), row.mode) if row.kind == "shape" else None for row in problem.rows]
        number = Counter(filter(None, shapes))
        if max(number.values(), default=0) < MANY:
            return None
        weights = np.array([1 / math.sqrt(number[shape]) if shape else 1.0 for shape in shapes])
        return cls(problem, weights, np.array([shape is not None for shape in shapes]), leap=leap)

    def limited(self, residual: np.ndarray) -> EvenWeights:
        """The same, limited by the usual size of the rows of a residual (n_rows,) of the problem."""
        others = residual[~self.shapes]
        if not len(others):
            return self
        usual = float(np.median(np.abs(others)))
        return replace(self, most=LIMIT * max(usual, 1.0))

    @property
    def by_differences(self) -> bool:
        """Whether derivatives of the problem cost evaluations; see `calib.inference.gauss_newton.fit`."""
        return bool(getattr(self.problem, "by_differences", False))

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Weighted residual at named values, (n_rows,); EvaluationError where the evaluation fails."""
        rows = self.problem.residual(values)
        return np.where(self._beyond(rows), np.copysign(self.most, rows), self.weights * rows)

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Its derivative per unit of each parameter, (n_rows, n_params)."""
        slope = self.weights[:, None] * self.problem.jacobian(values, names)
        return np.where(self._beyond(self.problem.residual(values))[:, None], 0.0, slope)

    def _beyond(self, rows: np.ndarray) -> np.ndarray:
        return ~self.shapes & (np.abs(rows) > self.most)
