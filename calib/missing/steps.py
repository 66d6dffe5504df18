"""Steps of a stepwise search for several effects, and the further effects that were tried and rejected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.problem.candidate import Candidate

Rejected: TypeAlias = Literal[
    "weaker", "evidence", "left_out", "dof", "no_longer_needed", "collinear", "as_good", "local_perturbation", "fault"
]
"""Why an effect was not taken in: another one gained more; too little evidence; the error of data left out rose; too
few degrees of freedom are left; it lost its evidence once another one was in. Or why one that was taken in is not
named: a collinear one in its place explains as well (both are named), or any other one, a local perturbation or a
fault of the measurement."""

Stopped: TypeAlias = Literal["adequate", "implausible", "doubtful", "rejected", "most", "returned", "budget"]
"""Why a search stopped: nothing systematic is left; the same, but a value is implausible; the same, but something else
explains as well as one of the effects, or data left out are predicted worse; every further effect was rejected;
`DecisionRules.most_effects` are in; a model came up again; the evaluations are used up."""


@dataclass(frozen=True, eq=False)
class Step:
    """One model of a stepwise search.

    Attributes
    ----------
    candidate_fit : CandidateFit
    adequacy : AdequacyTests
    left_out : float
        Rms of the leave-one-out error, in standard deviations.
    """

    candidate_fit: CandidateFit
    adequacy: AdequacyTests
    left_out: float


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect that was fitted beside others and rejected.

    Attributes
    ----------
    beside : tuple of str
        The other effects of the model.
    what : Candidate
    ln_bayes : float
        Log Bayes factor of the model with it against that without; for a competing one, against the model of the last
        step.
    left_out : float
        Rms of the leave-one-out error with it, in standard deviations.
    why : str
        One of `Rejected`.
    """

    beside: tuple[str, ...]
    what: Candidate
    ln_bayes: float
    left_out: float
    why: Rejected


@dataclass(frozen=True, eq=False)
class StepwiseSearch:
    """A stepwise search.

    Attributes
    ----------
    steps : tuple of Step
        The base model, then every model that was taken in.
    trials : tuple of Trial
    stopped : str
        One of `Stopped`.
    competing : tuple of (str, str)
        An effect of the last model, and one collinear with it that explains about as well in its place.
    """

    steps: tuple[Step, ...]
    trials: tuple[Trial, ...] = ()
    stopped: Stopped = "adequate"
    competing: tuple[tuple[str, str], ...] = ()

    @property
    def last(self) -> Step:
        """The model at which the search ended."""
        return self.steps[-1]

    @property
    def explains(self) -> bool:
        """Whether the last model has several effects and may be named."""
        return self.stopped == "adequate" and len(self.last.candidate_fit.names) > 1
