"""Proposals: compositions of local perturbations that were fitted to explain a misfit, ranked by their evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from calib.missing.candidate_fit import AdequacyTests, CandidateFit, WrongDatum
from calib.missing.profile import profile_interval
from calib.missing.rules import RULES
from calib.problem.candidate import Candidate


class Composed(Protocol):
    """An effect composed of local perturbations, such as `calib.structure.effects.composition.Composition`."""

    @property
    def effect(self) -> Candidate:
        """What is fitted."""
        ...

    @property
    def kind(self) -> str:
        """In words, such as ``added mass``."""
        ...

    @property
    def at(self) -> str:
        """Parts or sensors, in words."""
        ...

    @property
    def places(self) -> tuple[tuple[float, float, float], ...]:
        """Of everything that changes together, m; empty where none is known."""
        ...

    @property
    def place(self) -> tuple[float, float, float]:
        """Their middle, m; NaN where none is known."""
        ...

    @property
    def family(self) -> tuple[str, bool]:
        """Compositions among which it was chosen."""
        ...


def composition_words(composed: Composed) -> str:
    """A composition in words, such as ``mass of floor 4`` or ``hung mass at sensor 3y``."""
    if composed.kind.endswith("between"):
        return f"{composed.kind} {composed.at}"
    at = "at" if composed.kind.endswith((" mass", "ground", "rotational spring", "soft joint")) else "of"
    return f"{composed.kind} {at} {composed.at}"


@dataclass(frozen=True)
class Lost:
    """A composition that could not be tried, although the data may be of it.

    Attributes
    ----------
    title : str
        What it is, in words.
    reason : str
        Why.
    """

    title: str
    reason: str


@dataclass(frozen=True, eq=False)
class Proposal:
    """A fitted composition.

    Attributes
    ----------
    composed : Composed
    candidate_fit : CandidateFit
    score : float
        At the base model.
    ln_bayes : float
        Against the base model.
    choices : int
        Compositions of its kind among which it was chosen.
    low, high : float
        95 % profile-likelihood interval of its magnitude; NaN where it was not asked for.
    alike : tuple of Composed
        Compositions with the same signature, which these data do not tell from it.
    """

    composed: Composed
    candidate_fit: CandidateFit
    score: float
    ln_bayes: float
    choices: int
    low: float = math.nan
    high: float = math.nan
    alike: tuple[Composed, ...] = ()

    @property
    def evidence(self) -> float:
        """Log Bayes factor less the logarithm of the choices: what the ranking goes by."""
        return self.ln_bayes - math.log(self.choices)

    @property
    def value(self) -> float:
        """Fitted magnitude."""
        return self.candidate_fit.fit.values[self.composed.effect.name]


@dataclass(frozen=True, eq=False)
class Proposals:
    """Result of a search for proposals.

    Attributes
    ----------
    base : CandidateFit
        The model, with the effects beside which the proposals were fitted.
    ranked : tuple of Proposal
        Best first; empty where nothing can be proposed.
    p_family : float
        Family-wise p-value of the largest score among all compositions and local perturbations.
    tested : int
        Number of compositions.
    adequacy : AdequacyTests or None
        Tests of the model with the first proposal.
    fault : CandidateFit or None
        The fault of the measurement that explains as well as the first proposal, or better.
    datum : WrongDatum or None
        The wrong datum that explains about as well, or better.
    scale : float
        Factor on the standard deviation.
    alpha : float
        Family-wise level of every test.
    evaluations : int
    lost : tuple of Lost
        Compositions that could not be solved.
    """

    base: CandidateFit
    ranked: tuple[Proposal, ...]
    p_family: float
    tested: int
    adequacy: AdequacyTests | None
    fault: CandidateFit | None
    datum: WrongDatum | None
    scale: float
    alpha: float
    evaluations: int
    lost: tuple[Lost, ...] = ()

    @property
    def close(self) -> tuple[Proposal, ...]:
        """Proposals that explain about as well as the first one, itself included."""
        return tuple(p for p in self.ranked if p.evidence > self.ranked[0].evidence - RULES.equal)

    @property
    def measurement(self) -> bool:
        """Whether the measurement is the suspect instead of the model; a wrong datum must explain better for that."""
        if self.datum is not None and self.datum.ln_evidence > self.ranked[0].candidate_fit.ln_evidence:
            return True
        return self.fault is not None

    def settled(self, count: int) -> Proposals:
        """The first so many, with the profile intervals of their magnitudes."""
        ends = [profile_interval(p.candidate_fit.fit, p.composed.effect.name) for p in self.ranked[:count]]
        kept = [replace(p, low=low, high=high) for p, (low, high) in zip(self.ranked[:count], ends, strict=True)]
        return replace(self, ranked=tuple(kept))
