"""Settings of an explanation, and whether the data are enough for one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from calib.errors.errors import InputError
from calib.missing.hypotheses import Hypotheses
from calib.missing.rules import RULES
from calib.problem.labels import Label


@dataclass(frozen=True)
class Settings:
    """Settings of an explanation.

    Attributes
    ----------
    alpha : float
        Family-wise level of every test.
    refits : int
        Number of effects that are fitted, best first.
    merge : float
        Correlation of signatures from which two effects are grouped, unless the data tell them apart.
    seed : int
        Of the samples behind family-wise p-values.
    budget : float
        Model evaluations of one decision, after which no further effect or pair of effects is tried.
    begin : mapping from str to float, optional
        Values from which the base fit begins, such as those of a stored calibration; by default the nominal ones.
    """

    alpha: float = 0.01
    refits: int = 6
    merge: float = 0.98
    seed: int = 1
    budget: float = 115.0
    begin: Mapping[str, float] | None = None


DEFAULT = Settings()


def require_enough(rows: Iterable[Label], free: int) -> None:
    """Raise InputError for too few measured modes, or responses beside the fitted parameters, to name an effect.

    Parameters
    ----------
    rows : iterable of Label
        Labels of the rows of the residual, of all tests.
    free : int
        Number of fitted parameters.
    """
    modes, responses = set[str](), 0
    for row in rows:
        modes |= {row.mode} if row.mode else set()
        responses += not row.mode
    count, least = len(modes) + responses, RULES.least_modes
    if modes and count < least:
        raise InputError(
            f"{count} measured modes cannot tell a missing effect from a parameter",
            place="explain",
            remedy=f"measure at least {least}, or hold out fewer",
        )
    least = max(RULES.least_responses, free + 2)
    if not modes and count < least:
        raise InputError(
            f"{count} measured responses cannot tell a missing effect from the {free} fitted parameters",
            place="explain",
            remedy=f"measure at least {least}, hold out fewer or fit fewer parameters",
        )


def too_few(rows: Iterable[Label], free: int) -> str:
    """Why `require_enough` refuses the data, with what to do, in words; empty where they are enough."""
    try:
        require_enough(rows, free)
    except InputError as fault:
        return f"{fault.problem}: {fault.remedy}"
    return ""


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
    beyond : float
        Evaluations that may be spent within `continuing` beside them.
    """

    def __init__(self, hypotheses: Hypotheses, most: float, beyond: float = 0.0) -> None:
        self._hypotheses, self._begun = hypotheses, hypotheses.evaluations
        self.most = most
        self._beyond = beyond
        self._entered: int | None = None

    @property
    def used(self) -> int:
        """Evaluations charged so far."""
        return self._hypotheses.evaluations - self._begun

    @property
    def remaining(self) -> float:
        """Evaluations left, within `continuing` of those beyond the budget; negative when more were needed."""
        if self._entered is None:
            return self.most - self.used
        return self._beyond - (self._hypotheses.evaluations - self._entered)

    def spent(self, part: float = 1.0) -> bool:
        """Whether that part of the budget is used up."""
        return self.used > part * self.most

    def ensure(self, least: float) -> None:
        """Raise the budget, if need be, so that at least so many evaluations are left."""
        self.most = max(self.most, self.used + least)

    @contextmanager
    def continuing(self) -> Iterator[None]:
        """Evaluations within this context are charged to those beyond the budget, which alone limit fits within it."""
        self._entered = self._hypotheses.evaluations
        try:
            with self.uncharged():
                yield
        finally:
            self._beyond -= self._hypotheses.evaluations - self._entered
            self._entered = None

    @contextmanager
    def uncharged(self) -> Iterator[None]:
        """Evaluations within this context are not charged."""
        before = self.used
        try:
            yield
        finally:
            self._begun += self.used - before
