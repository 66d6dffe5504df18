"""Model evaluations that a decision may spend on fits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from calib.missing.hypotheses import Hypotheses


class Allowance:
    """What one decision may still ask of the model.

    It counts from where it was made. A decision must depend neither on what was asked before it nor on what something
    beside it asks within `uncharged`.

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

    @property
    def used(self) -> int:
        """Evaluations charged so far."""
        return self._hypotheses.evaluations - self._begun

    @property
    def left(self) -> float:
        """Evaluations that are left; negative where more than allowed were needed."""
        return self.most - self.used

    def spent(self, part: float = 1.0) -> bool:
        """Whether that part is used up."""
        return self.used > part * self.most

    def ensure(self, least: float) -> None:
        """See to it that so many evaluations are left, whatever was spent before."""
        self.most = max(self.most, self.used + least)

    @contextmanager
    def uncharged(self) -> Iterator[None]:
        """Within it, evaluations are charged to nothing here."""
        before = self.used
        try:
            yield
        finally:
            self._begun += self.used - before
