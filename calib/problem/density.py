"""A tabulated density, such as a prior that an earlier analysis or a supplier's histogram gives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from calib.errors.arguments import number
from calib.errors.errors import InputError

_TAIL = 1e-12
"""Least probability to either side of a value: the ends of a table are about 7 standard deviations away."""
_NARROWEST = 1e-6
"""Least local width over the range of the table."""


@dataclass(frozen=True)
class Density:
    """Density over values, straight between tabulated points and 0 beyond them, whatever the common factor.

    Attributes
    ----------
    values, densities : tuple of float
        Ascending values, and densities that are positive between the ends.

    Examples
    --------
    A triangle over 0 to 2:

    >>> from calib.problem.density import Density
    >>> triangle = Density((0.0, 1.0, 2.0), (0.0, 1.0, 0.0))
    >>> triangle.score(1.0), round(triangle.std, 4)
    (0.0, 0.4082)
    """

    values: tuple[float, ...]
    densities: tuple[float, ...]

    @classmethod
    def of(cls, pairs: Any, place: str) -> Density:
        """The density of pairs of a value and its density; InputError where they are none."""
        try:
            rows = [tuple(pair) for pair in pairs]
        except TypeError:
            rows = []
        if len(rows) < 2 or any(len(row) != 2 for row in rows):
            remedy = "give at least two pairs [value, density]"
            raise InputError("a tabulated prior is no list of pairs", place=place, remedy=remedy)
        x, y = (tuple(number(row[k], f"{place}, prior") for row in rows) for k in (0, 1))
        if not (np.isfinite([x, y]).all() and np.all(np.diff(x) > 0)):
            raise InputError("the values of a tabulated prior do not ascend", place=place, remedy="sort the pairs")
        if min(y) < 0 or not all(d > 0 for d in y[1:-1]) or not max(y) > 0:
            remedy = "give positive densities; at the ends they may be 0"
            raise InputError("a tabulated prior has a density that is not positive", place=place, remedy=remedy)
        return cls(x, y)

    def __iter__(self) -> Iterator[tuple[float, float]]:
        """The pairs."""
        return zip(self.values, self.densities, strict=True)

    def require(self, lower: float, upper: float, place: str) -> None:
        """InputError where limits are outside the table."""
        low, high = self.values[0], self.values[-1]
        slack = 1e-9 * (high - low)
        if lower < low - slack or upper > high + slack:
            raise InputError(
                f"the limits {lower:g} to {upper:g} go beyond the tabulated prior, which goes from {low:g} to {high:g}",
                place=place, remedy="narrow the limits, or tabulate more",
            )  # fmt: skip

    @cached_property
    def _sums(self) -> np.ndarray:
        """Integral of the densities up to each value."""
        x, y = np.array(self.values), np.array(self.densities)
        return np.concatenate([[0.0], np.cumsum(np.diff(x) * (y[1:] + y[:-1]) / 2)])

    def _density(self, value: float) -> float:
        return float(np.interp(value, self.values, self.densities, left=0.0, right=0.0)) / float(self._sums[-1])

    def _below(self, value: float) -> float:
        """Probability of a smaller value."""
        x = min(max(value, self.values[0]), self.values[-1])
        k = min(int(np.searchsorted(self.values, x, side="right")), len(self.values) - 1) - 1
        here = float(np.interp(x, self.values, self.densities))
        part = (x - self.values[k]) * (self.densities[k] + here) / 2
        return float((self._sums[k] + part) / self._sums[-1])

    @cached_property
    def std(self) -> float:
        """Standard deviation."""
        moments = []
        for power in (1, 2):
            total = 0.0
            for (a, p), (b, q) in zip(list(self)[:-1], list(self)[1:], strict=True):
                # Simpson's rule is exact for the cubic value^2 * density
                middle = (a + b) / 2
                ends = a**power * p + 4 * middle**power * (p + q) / 2 + b**power * q
                total += (b - a) / 6 * ends
            moments.append(total / float(self._sums[-1]))
        return float(np.sqrt(moments[1] - moments[0] ** 2))

    def score(self, value: float) -> float:
        """The standard normal value of the same probability."""
        return float(special.ndtri(min(max(self._below(value), _TAIL), 1.0 - _TAIL)))

    def width(self, value: float) -> float:
        """One over the slope of `score`: the standard deviation of the normal distribution that is like it there."""
        z, least = self.score(value), _NARROWEST * (self.values[-1] - self.values[0])
        here = self._density(value)
        if here == 0.0:
            return least
        return float(max(np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) / here, least))
