"""What an explanation finds: models that were fitted, their tests, and the verdict."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from calib.effect import Effect
from calib.freedom import LEAST_FREEDOM
from calib.missing.alike import Group
from calib.missing.score import Scores
from calib.missing.state import State
from calib.missing.suspect import COLUMNS


@dataclass(frozen=True, eq=False)
class Check:
    """Tests of one fitted model.

    Attributes
    ----------
    named, atoms : Scores
    p_named, p_atoms : float
        Family-wise.
    kinds, modes : DataFrame
        Goodness of fit.
    p_fit : float
    sensors : DataFrame
        Misfit by sensor, worst first.
    """

    named: Scores
    atoms: Scores
    p_named: float
    p_atoms: float
    kinds: pd.DataFrame
    modes: pd.DataFrame
    p_fit: float
    sensors: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def p_family(self) -> float:
        """Of the largest score among named effects and local changes."""
        return min(1.0, 2 * min(self.p_named, self.p_atoms))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom that the fit leaves."""
        return float(self.kinds["freedom"].sum())

    @property
    def can_tell(self) -> bool:
        """Whether enough data are left to speak against the fit."""
        return self.freedom >= LEAST_FREEDOM

    def passes(self, alpha: float) -> bool:
        """Whether nothing seems missing."""
        return self.p_family > alpha and self.p_fit > alpha

    def adequate(self, alpha: float) -> bool:
        """Whether nothing organised is left once something has been added.

        Goodness of fit looks nowhere in particular; to speak against an effect that explains it must be far off.
        """
        return self.p_family > alpha and self.p_fit > alpha / 10


@dataclass(frozen=True, eq=False)
class Trial:
    """A model with effects, fitted.

    Attributes
    ----------
    effects : tuple of Effect
    state : State
    ln_evidence : float
    implausible : str
        Why it is not believable although it may fit; empty when it is.
    """

    effects: tuple[Effect, ...]
    state: State
    ln_evidence: float
    implausible: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(e.name for e in self.effects)

    def strength(self, name: str) -> tuple[float, float]:
        """Fitted strength of an effect and its linearised standard deviation."""
        k = self.state.names.index(name)
        return self.state.values[name], float(np.sqrt(self.state.covariance[k, k]))


@dataclass(frozen=True, eq=False)
class WrongDatum:
    """The model without any effect, one datum wrong by whatever it takes.

    Attributes
    ----------
    what : str
        Such as ``frequency of 2B``.
    kind : {"value", "shape", "mode", "sensor"}
    ln_evidence : float
        As that of a fitted model, see `calib.missing.evidence.ln_evidence`.
    p_fit : float
        Of goodness of fit of all other data.
    """

    what: str
    kind: str
    ln_evidence: float
    p_fit: float

    @property
    def told(self) -> str:
        """Such as ``a wrong frequency of 2B``."""
        return f"a wrong {self.what}" if self.kind in ("value", "shape") else f"a wrong measurement of {self.what}"


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything an explanation found.

    Attributes
    ----------
    verdict : str
        ``nothing_detectable``, ``effect``, ``indistinguishable``, ``two_effects``, ``unconfirmed`` (what would be named
        fits, but withheld data contradict it or it had no unnamed rival), ``partial``, ``none_explains``,
        ``misfit_unlocated`` (the fit is bad, and no effect or local change stands out) or ``noise_underestimated``.
    base : Trial
        Without effects.
    base_check : Check
    groups : tuple of Group
        Candidates, those that the signal at hand does not tell apart taken together.
    trials : tuple of Trial
        Every effect and pair that was fitted, best first among the single ones, then pairs.
    atom : Trial or None
        The best unnamed local change.
    chosen : Trial or None
        The explanation: one effect or two; the best attempt when none explains.
    chosen_check : Check or None
    credible : tuple of str
        Effects that explain about as well as the best; of two, with those that look the same as either.
    noise_scale : float
        Factor on the scatter that was used: 1 unless it was found understated.
    measured_scale : float
        What the shapes ask for at the best fit.
    evaluations : int
    alpha : float
        Level of the tests.
    begun_anew : bool
        Whether single effects were fitted from the adopted values too, and not from the base fit alone.
    fault : Trial or None
        The fault of the measurement that explains about as well as the best effect of an ``indistinguishable`` answer.
    datum : WrongDatum or None
        The single datum whose being wrong explains about as well as that effect, or better; None beside a fault.
    suspects : DataFrame
        Data without which the base model fits, see `calib.missing.suspect.suspects`.
    """

    verdict: str
    base: Trial
    base_check: Check
    groups: tuple[Group, ...]
    trials: tuple[Trial, ...]
    atom: Trial | None
    chosen: Trial | None
    chosen_check: Check | None
    credible: tuple[str, ...]
    noise_scale: float
    measured_scale: float
    evaluations: int
    alpha: float = 0.01
    begun_anew: bool = False
    fault: Trial | None = None
    datum: WrongDatum | None = None
    suspects: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(COLUMNS)))

    def ln_bayes(self, trial: Trial | WrongDatum) -> float:
        """Log Bayes factor of a trial, or of a wrong datum, against the base model."""
        return trial.ln_evidence - self.base.ln_evidence

    @property
    def refused(self) -> str:
        """Why the best attempt is not named, the first that holds; empty where something is.

        ``implausible``, ``freedom`` (too few effective degrees of freedom are left, so that what little a fit leaves is
        no reason either), ``misfit``, ``local_change`` (one fits better) or ``evidence`` (there is too little).
        """
        trial, check = self.chosen, self.chosen_check
        if trial is None or check is None or self.verdict not in ("none_explains", "misfit_unlocated", "partial"):
            return ""
        if trial.implausible:
            return "implausible"
        if not check.can_tell:
            return "freedom"
        if not check.adequate(self.alpha):
            return "misfit"
        better = self.atom is not None and self.atom.ln_evidence > trial.ln_evidence
        return "local_change" if better else "evidence"

    @property
    def names_something(self) -> bool:
        """Whether the verdict names what is missing."""
        return self.verdict in ("effect", "indistinguishable", "two_effects")

    @property
    def unrivalled(self) -> bool:
        """Whether no unnamed local change could be told from the parameters, so that a wrong name would not show."""
        return not (self.base_check.atoms.size > 0).any()

    def unconfirmed(self) -> Findings:
        """The same without a name: what fits is the best attempt."""
        return replace(self, verdict="unconfirmed", credible=(), fault=None, datum=None)

    @property
    def untold(self) -> tuple[str, ...]:
        """Effects, and what may be wrong with the measurement, that explain about as well as the best."""
        fault = () if self.fault is None else self.fault.names
        return (*self.credible, *fault, *(() if self.datum is None else (self.datum.told,)))

    @property
    def singles(self) -> tuple[Trial, ...]:
        """Trials with one named effect, best first."""
        return tuple(t for t in self.trials if len(t.effects) == 1)

    @property
    def believed(self) -> tuple[Trial, ...]:
        """Models that may be the truth: what is named, the two best that cannot be told apart, else the base model."""
        if not self.names_something or self.chosen is None:
            return (self.base,)
        rivals = [t for t in self.singles if t.names[0] in self.credible][:2]
        return tuple(rivals) if self.verdict == "indistinguishable" and len(rivals) > 1 else (self.chosen,)
