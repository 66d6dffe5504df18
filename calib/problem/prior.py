"""Priors of the parameters: tabulated densities, independent priors, and those that a matrix correlates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.errors.arguments import number
from calib.errors.errors import InputError

if TYPE_CHECKING:
    from calib.problem.parameter import Parameter
    from calib.problem.space import ParameterSpace

_TAIL = 1e-12
"""Least probability to either side of a value: the ends of a table are about 7 standard deviations away."""
_NARROWEST = 1e-6
"""Least local width over the range of the table."""
PLACE = "prior correlation"
_LEAST = 1e-6
"""Least eigenvalue of a matrix of correlations: below, some combination of the parameters would be known exactly."""
_SAME = 1e-9
"""Largest difference between the two entries of a pair, and of the diagonal from 1."""


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

    >>> from calib.problem.prior import Density
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
        from scipy import special

        return float(special.ndtri(min(max(self._below(value), _TAIL), 1.0 - _TAIL)))

    def width(self, value: float) -> float:
        """One over the slope of `score`: the standard deviation of the normal distribution that is like it there."""
        z, least = self.score(value), _NARROWEST * (self.values[-1] - self.values[0])
        here = self._density(value)
        if here == 0.0:
            return least
        return float(max(np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi) / here, least))


class Correlated(NamedTuple):
    """Parameters whose priors are correlated.

    Attributes
    ----------
    names : tuple of str
    matrix : ndarray (n, n)
        R, of the standard normal values of their priors, which is `Parameter.pull` (a Gaussian copula).
    share : float
        lambda, the least eigenvalue of R^-1; 1 without any.
    root : ndarray (n, n)
        Q with ``R^-1 = lambda I + Q^T Q``.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    share: float
    root: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Correlated:
        """Those of some parameters that are correlated with others of them."""
        known = {p.name: dict(p.prior_correlation) for p in parameters}
        pairs = {(a, b): r for a, own in known.items() for b, r in own.items() if b in known and known[b].get(a) == r}
        names = tuple(name for name in known if any(name == a for a, _ in pairs))
        matrix = np.array([[1.0 if a == b else pairs.get((a, b), 0.0) for b in names] for a in names])
        if not names:
            return cls((), np.eye(0), 1.0, np.eye(0))
        size, vectors = np.linalg.eigh(matrix)
        share = 1.0 / float(size[-1])
        return cls(names, matrix, share, (vectors * np.sqrt(np.maximum(1.0 / size - share, 0.0))).T)


@dataclass(frozen=True)
class Prior:
    """Priors of the parameters; see `calib.problem.parameter.Parameter`.

    With the matrix R of their correlations the pulls t add ``t^T R^-1 t`` to a sum of squares, which is
    ``lambda |t|^2 + |Q t|^2`` (see `Correlated`): independent priors, wider by ``1/sqrt(lambda)``, and rows beside the
    data. All that holds for independent priors and rows then holds for correlated ones.

    Attributes
    ----------
    of_parameter : mapping from str to Parameter
        A parameter without an entry has no prior.
    """

    of_parameter: Mapping[str, Parameter]

    @classmethod
    def of(cls, space: ParameterSpace) -> Prior:
        """Priors of the free parameters that are not integers; one that is held leaves the others as they are alone."""
        return cls({p.name: p for p in space.free if not p.integer})

    @classmethod
    def none(cls) -> Prior:
        """No prior at all."""
        return cls({})

    @cached_property
    def correlated(self) -> Correlated:
        """Those that are correlated."""
        return Correlated.of(tuple(self.of_parameter.values()))

    def share(self, name: str) -> float:
        """Lambda for a correlated parameter, else 1."""
        return self.correlated.share if name in self.correlated.names else 1.0

    def widths(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Standard deviations (n_params,) of the independent part to first order at a point, infinite without one."""
        known = self.of_parameter
        own = [known[n].prior_width_at(values[n]) / math.sqrt(self.share(n)) if n in known else math.inf for n in names]
        return np.array(own, dtype=float)

    def residual(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """``(value - centre)/sd`` of normal priors, in general `Parameter.pull`, (n_params,); 0 without a prior.

        With the standard deviations of `widths`.
        """
        known = self.of_parameter
        own = [math.sqrt(self.share(n)) * known[n].pull(values[n]) if n in known else 0.0 for n in names]
        return np.array(own, dtype=float)

    def beside(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Rows ``Q t`` of correlated priors (n_correlated,), and their derivatives (n_correlated, n_params)."""
        own, known = self.correlated, self.of_parameter
        pull = np.array([known[n].pull(values[n]) for n in own.names])
        slope = np.zeros((len(own.names), len(names)))
        for k, name in enumerate(names):
            if name in own.names:
                slope[:, k] = own.root[:, own.names.index(name)] / known[name].prior_width_at(values[name])
        return own.root @ pull, slope

    def rows(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """All that the priors add to a residual, (n,), and its derivative (n, n_params): 0 where one does not pull."""
        free = [n not in self.of_parameter or not self.of_parameter[n].pulls for n in names]
        own = np.diag(np.where(free, 0.0, 1.0 / self.widths(values, names)))
        beside, slope = self.beside(values, names)
        return np.concatenate([self.residual(values, names), beside]), np.vstack([own, slope])

    def log_density(self, values: Mapping[str, float]) -> float:
        """Logarithm of the joint density along the scales, but for a constant."""
        known = self.of_parameter
        pull = np.array([known[n].pull(values[n]) for n in self.correlated.names])
        beside = self.correlated.root @ pull
        excess = beside @ beside + (self.correlated.share - 1.0) * (pull @ pull)
        return sum(p.log_prior(values[n]) for n, p in known.items()) - 0.5 * float(excess)


def prior_correlations(
    names: Sequence[str], matrix: Sequence[Sequence[float]]
) -> dict[str, tuple[tuple[str, float], ...]]:
    """`Parameter.prior_correlation` of every named parameter, from a matrix with a row and a column for each.

    Raises
    ------
    InputError
        For a name that comes twice, and a matrix that is not square, of this size, symmetric, with 1 on the diagonal
        and positive definite.
    """
    place, rows = PLACE, [list(row) for row in matrix]
    if len(set(names)) < len(names):
        raise InputError("a parameter is named twice", place=place, remedy="give each one row and one column")
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        sizes = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
        words = f"the matrix has {sizes} numbers for {len(names)} parameters"
        raise InputError(words, place=place, remedy="give a row and a column for each, in the order of the names")
    known = np.array([[number(x, f"{place} of {a} and {b}") for b, x in zip(names, row, strict=True)]
                      for a, row in zip(names, rows, strict=True)]).reshape(len(names), len(names))  # fmt: skip
    wrong = ~(np.abs(known - known.T) <= _SAME) | ~(np.abs(known) <= 1.0 + _SAME)
    wrong |= np.eye(len(names), dtype=bool) & ~(np.abs(known - 1.0) <= _SAME)
    if wrong.any():
        k, j = np.argwhere(wrong)[0]
        words = f"{names[k]} and {names[j]} have the entries {known[k, j]:g} and {known[j, k]:g}"
        remedy = "give the same number from -1 to 1 twice for each pair, and 1 on the diagonal"
        raise InputError(words, place=place, remedy=remedy)
    least = float(np.linalg.eigvalsh(known)[0]) if len(names) else 1.0
    if least < _LEAST:
        words = f"the matrix is not positive definite: its least eigenvalue is {least:.3g}"
        raise InputError(words, place=place, remedy="lower its correlations, which contradict each other")
    return {
        a: tuple((b, float(known[k, j])) for j, b in enumerate(names) if j != k and known[k, j])
        for k, a in enumerate(names)
    }
