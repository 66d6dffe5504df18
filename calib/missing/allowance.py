"""Evaluation budget of one decision."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from calib.missing.hypotheses import Hypotheses


class Allowance:
    """Evaluation budget of one decision.

    Counting starts when the object is made, so that a decision depends neither on earlier evaluations nor on those
    within `uncharged`.

    Parameters
    ----------
    hypotheses : Hypotheses
        Counts the evaluations.
    most : float
        Evaluations that may be spent.
    """

    def __init__(self, hypotheses: Hypotheses, most: float) -> None:
        self._hypotheses, self._begun = hypotheses, hypotheses.evaluations
        self.most = most
        self._limited = True

    @property
    def used(self) -> int:
        """Evaluations charged so far."""
        return self._hypotheses.evaluations - self._begun

    @property
    def left(self) -> float:
        """Evaluations left; negative when more than allowed were needed; infinite within `unlimited`."""
        return self.most - self.used if self._limited else math.inf

    def spent(self, part: float = 1.0) -> bool:
        """Whether that part of the budget is used up."""
        return self.used > part * self.most

    def ensure(self, least: float) -> None:
        """Raise the budget, if need be, so that at least so many evaluations are left."""
        self.most = max(self.most, self.used + least)

    @contextmanager
    def unlimited(self) -> Iterator[None]:
        """As `uncharged`; nor do fits within this context end early, though `spent` goes on telling what is used."""
        limited, self._limited = self._limited, False
        try:
            with self.uncharged():
                yield
        finally:
            self._limited = limited

    @contextmanager
    def uncharged(self) -> Iterator[None]:
        """Evaluations within this context are not charged."""
        before = self.used
        try:
            yield
        finally:
            self._begun += self.used - before
