"""Fitted models with effects, and the tests of one of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import pandas as pd

from calib.missing.evidence import at_lower
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.score import Scores
from calib.missing.screened import Screened
from calib.problem import degrees_of_freedom
from calib.problem.candidate import Candidate


@dataclass(frozen=True, eq=False)
class AdequacyTests:
    """Tests of one fitted model.

    Attributes
    ----------
    named, perturbations : Scores
        Of the effects and of the local perturbations that the model lacks.
    p_named, p_perturbations : float
        Family-wise p-values of the largest score.
    kinds, modes : DataFrame
        Goodness of fit by kind, and by mode and kind.
    p_fit : float
        Of the goodness of fit as a whole.
    sensors : DataFrame
        Misfit by sensor, worst first.
    faults : Scores or None
        Of the faults of the measurement; None where the test has none.
        Those of pairs are in ``pairs``.
    p_faults : float
        Family-wise p-value of the largest score of all faults: that of these, and that of pairs, each over its share
        of the probability of a false alarm (weighted Bonferroni; `DecisionRules.pairs_share`).
    pairs : Screened or None
        The largest scores of the faults of pairs; None where the test has none.
    overstated : bool
        Whether the standard deviations are larger than independent errors of data without modes would allow. An
        accuracy that neighbouring lines share makes them so; scores then prove nothing: the goodness of fit decides.
    """

    named: Scores
    perturbations: Scores
    p_named: float
    p_perturbations: float
    kinds: pd.DataFrame
    modes: pd.DataFrame
    p_fit: float
    sensors: pd.DataFrame = field(default_factory=pd.DataFrame)
    faults: Scores | None = None
    p_faults: float = 1.0
    pairs: Screened | None = None
    overstated: bool = False

    @property
    def suspects(self) -> Scores | None:
        """Scores of all faults, of pairs the largest; None where the test has none."""
        if self.faults is None or self.pairs is None:
            return self.faults
        return self.faults.joined(self.pairs.scores)

    @property
    def p_family(self) -> float:
        """Family-wise p-value of the largest score among named effects, local perturbations and faults (Bonferroni)."""
        families = [self.p_named, self.p_perturbations, *([] if self.faults is None else [self.p_faults])]
        return min(1.0, len(families) * min(families))

    @property
    def dof(self) -> float:
        """Effective degrees of freedom left by the fit."""
        return float(self.kinds["dof"].sum())

    @property
    def can_tell(self) -> bool:
        """Whether enough degrees of freedom are left to reject the fit."""
        return self.dof >= degrees_of_freedom.RULES.least

    def passes(self, alpha: float) -> bool:
        """Whether nothing seems missing."""
        return (self.overstated or self.p_family > alpha) and self.p_fit > alpha

    def adequate(self, alpha: float) -> bool:
        """Whether no systematic misfit is left after an effect has been added.

        Goodness of fit is an unspecific test: it must be far off to reject an effect that explains the data.
        """
        return (self.overstated or self.p_family > alpha) and self.p_fit > alpha / 10


@dataclass(frozen=True, eq=False)
class CandidateFit:
    """A model with effects, fitted.

    Attributes
    ----------
    effects : tuple of Candidate
    fit : LinearisedFit
    ln_evidence : float
    implausible : str
        Why it is physically implausible although it may fit; empty when it is plausible.
    """

    effects: tuple[Candidate, ...]
    fit: LinearisedFit
    ln_evidence: float
    implausible: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(e.name for e in self.effects)

    @property
    def is_possible(self) -> bool:
        """Whether its values allow its effects to be named: plausible, and none of the effects at zero."""
        return not self.implausible and not any(at_lower(self.fit, e) for e in self.effects)

    def magnitude(self, name: str) -> tuple[float, float]:
        """Fitted magnitude of an effect and its linearised standard deviation."""
        return self.fit.values[name], float(self.fit.std[self.fit.names.index(name)])


@dataclass(frozen=True, eq=False)
class WrongDatum:
    """The base model with one datum taken as wrong by an unknown amount.

    Attributes
    ----------
    what : str
        Such as ``frequency of 2B``.
    kind : {"value", "shape", "mode", "sensor"}
    ln_evidence : float
        As that of a fitted model, see `calib.missing.evidence.ln_evidence`.
    p_fit : float
        Of the goodness of fit to all other data.
    """

    what: str
    kind: str
    ln_evidence: float
    p_fit: float

    @property
    def in_words(self) -> str:
        """In words, such as ``a wrong frequency of 2B``."""
        return f"a wrong {self.what}" if self.kind in ("value", "shape") else f"a wrong measurement of {self.what}"
