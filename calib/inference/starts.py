"""When enough starts of least squares were tried: optima found so far, and the share that is likely not found yet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise
from typing import ClassVar, Protocol, TypeAlias

from calib.inference.gauss_newton import FitResult
from calib.inference.rules import RULES

Enough: TypeAlias = Callable[[Sequence[FitResult | None]], bool]
"""Whether the starts tried so far suffice, from the end of each; None for one that cannot be evaluated."""


class Ended(Protocol):
    """The end of a fit."""

    @property
    def misfit(self) -> float:
        """Sum of squares."""
        ...

    @property
    def converged(self) -> bool:
        """Whether it is an optimum."""
        ...


@dataclass(frozen=True)
class Optima:
    """Optima that random starts of least squares found.

    Attributes
    ----------
    starts : int
        Starts tried.
    found : int
        Different sums of squares among their ends, more than `Rules.equal` apart. A fit that did not converge, or that
        could not begin, counts as one of its own.
    lowest : int
        Starts that ended at the lowest of them.
    """

    starts: int
    found: int
    lowest: int

    @classmethod
    def of(cls, ends: Sequence[Ended | None]) -> Optima:
        """Count them."""
        ended = sorted(end.misfit for end in ends if end is not None and end.converged)
        apart = [k for k, (low, high) in enumerate(pairwise(ended), 1) if high - low > RULES.equal]
        lowest = apart[0] if apart else len(ended)
        return cls(len(ends), len(apart) + bool(ended) + len(ends) - len(ended), lowest)

    @property
    def unseen(self) -> float:
        """Expected share of the search space from which least squares would lead to an optimum not found yet.

        Of n starts that found w optima: w (w + 1) / (n (n - 1)), from equal prior probabilities of all partitions of
        the space (Boender and Rinnooy Kan 1987, Mathematical Programming 37, 59-80).
        """
        n, w = self.starts, self.found
        return min(w * (w + 1) / (n * (n - 1)), 1.0) if n > 1 else 1.0

    @property
    def agree(self) -> bool:
        """Whether two starts or more reached the lowest optimum and the unseen share is small."""
        return self.lowest > 1 and self.unseen <= RULES.unseen

    @property
    def sentence(self) -> str:
        """The counts in words."""
        optima = "1 optimum" if self.found == 1 else f"{self.found} optima"
        return (
            f"{self.lowest} of {self.starts} starts of least squares reached their lowest sum of squares, all together "
            f"{optima}; a further start would find another one with a probability of about {100 * self.unseen:.0f} %"
        )


@dataclass
class UntilAgreed:
    """Stops as soon as the random starts agree and no start before them ended lower; see `Optima.agree`.

    Attributes
    ----------
    given : int
        Starts before the random ones, which say nothing about the others.
    optima : Optima
        Of the random starts so far.
    agree : bool
        Whether they agree.
    """

    given: int = 0
    agree: bool = False
    optima: Optima = field(default_factory=lambda: Optima.of(()))

    @property
    def least(self) -> int:
        """Starts without which they cannot agree: all of those that are given, and so many random ones."""
        return self.given + next(n for n in count(2) if 2 / (n * (n - 1)) <= RULES.unseen)

    def __call__(self, ends: Sequence[FitResult | None]) -> bool:
        """Whether the starts agree."""
        random = ends[self.given :]
        self.optima = Optima.of(random)
        self.agree = self.optima.agree and _lowest(random) <= _lowest(ends[: self.given]) + RULES.equal
        return self.agree


def _lowest(ends: Sequence[FitResult | None]) -> float:
    return min((end.misfit for end in ends if end is not None), default=math.inf)


@dataclass
class UntilLowestTwice:
    """Stops as soon as two starts ended at the lowest sum of squares.

    Attributes
    ----------
    tried : int
        Starts so far.
    """

    tried: int = 0
    least: ClassVar[int] = 2
    """Starts without which it cannot stop."""

    def __call__(self, ends: Sequence[FitResult | None]) -> bool:
        """Whether two did."""
        self.tried, most = len(ends), _lowest(ends) + RULES.equal
        return sum(end is not None and end.converged and end.misfit <= most for end in ends) >= self.least


def never(ends: Sequence[FitResult | None]) -> bool:
    """Try all starts."""
    return False
