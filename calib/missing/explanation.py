"""Result of an explanation: the verdict, with the fitted models and tests behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import pandas as pd

from calib.missing.candidate_fit import AdequacyTests, CandidateFit, WrongDatum
from calib.missing.collinear import Group
from calib.missing.rules import RULES
from calib.missing.steps import StepwiseSearch
from calib.missing.suspect import COLUMNS
from calib.problem.candidate import Candidate

SEVERAL = ("two_effects", "several_effects")
"""Verdicts that name several effects together."""
NAMED = ("effect", *SEVERAL)
"""Verdicts that name effects, all of which the model lacks."""
UNEXPLAINED = ("partial", "none_explains", "misfit_unlocated")
"""Verdicts that leave a misfit which nothing explains fully."""
OPEN = (*UNEXPLAINED, "unconfirmed")
"""Verdicts after which something that nobody listed may be missing."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Result of an explanation.

    Attributes
    ----------
    verdict : str
        ``nothing_detectable``, ``effect``, ``indistinguishable``, ``two_effects``, ``several_effects`` (three or four),
        ``measurement`` (a fault of the measurement explains the misfit), ``unconfirmed`` (an effect fits, but held-out
        data contradict it or it had no unnamed competing model), ``partial``, ``none_explains``, ``misfit_unlocated``
        (the fit is bad, and no effect or local perturbation stands out) or ``noise_underestimated``.
    base : CandidateFit
        Without effects.
    base_adequacy : AdequacyTests
    groups : tuple of Group
        Candidates, collinear ones in one group.
    candidate_fits : tuple of CandidateFit
        Every fitted effect, best first, then every fitted pair.
    perturbation : CandidateFit or None
        The best unnamed local perturbation.
    place : CandidateFit or None
        The same where it may be told as a place to look at; see `calib.missing.place.told_place`. Of the verdict
        ``measurement`` the one that cannot be told from the fault.
    chosen : CandidateFit or None
        The explanation by one effect or two; the best attempt when none explains.
    chosen_adequacy : AdequacyTests or None
    credible : tuple of str
        Effects that explain about as well as the best; for a pair, both and those collinear with either.
    noise_scale : float
        Factor applied to the standard deviation: 1 unless it was found understated.
    measured_scale : float
        Factor on the standard deviation that the shapes call for at the best fit.
    evaluations : int
    alpha : float
        Significance level of the tests.
    begun_anew : bool
        Whether single effects were also fitted from the nominal values, beside the base fit.
    fault : CandidateFit or None
        The measurement fault of the verdict ``measurement``, or the one that explains about as well as the best effect
        of an ``indistinguishable`` result.
    datum : WrongDatum or None
        The wrong datum that explains about as well as that effect, or better; None beside a fault.
    suspects : DataFrame
        Data left out in turn, see `calib.missing.suspect.suspects_table`.
    faults : tuple of CandidateFit
        Fitted faults of the measurement, best first.
    fault_adequacy : AdequacyTests or None
        Tests of the fault of the verdict ``measurement``, or of one that cannot be told from an effect.
    base_starts : int
        Further points from which the base model was fitted, because it was rejected or pulled.
    granted : tuple of Candidate
        Faults of the measurement that the verdict tells beside its effects, or beside its fault: their magnitudes are
        among the parameters of every fit.
    mistakable : tuple of (str, str)
        A fault that is told, and an effect or another fault: in its place it explains about as well.
    minor : tuple of str
        Further effects that would leave nothing over beside the chosen one, too small to be named; see
        `calib.missing.partial.minor_beside`.
    odds_against_datum : float
        Log odds of what is named against the wrong datum that was fitted; NaN where none was.
    steps : StepwiseSearch or None
        The stepwise search for several effects; None where one was enough or where none had strong evidence.
    """

    verdict: str
    base: CandidateFit
    base_adequacy: AdequacyTests
    groups: tuple[Group, ...]
    candidate_fits: tuple[CandidateFit, ...]
    perturbation: CandidateFit | None
    chosen: CandidateFit | None
    chosen_adequacy: AdequacyTests | None
    credible: tuple[str, ...]
    noise_scale: float
    measured_scale: float
    evaluations: int
    alpha: float
    begun_anew: bool = False
    fault: CandidateFit | None = None
    datum: WrongDatum | None = None
    suspects: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(COLUMNS)))
    faults: tuple[CandidateFit, ...] = ()
    fault_adequacy: AdequacyTests | None = None
    steps: StepwiseSearch | None = None
    place: CandidateFit | None = None
    base_starts: int = 0
    granted: tuple[Candidate, ...] = ()
    mistakable: tuple[tuple[str, str], ...] = ()
    minor: tuple[str, ...] = ()
    odds_against_datum: float = math.nan

    @property
    def every(self) -> tuple[CandidateFit, ...]:
        """Every fit that it tells."""
        steps = () if self.steps is None else tuple(step.candidate_fit for step in self.steps.steps)
        single = (self.base, self.perturbation, self.place, self.chosen, self.fault)
        return (*filter(None, single), *self.candidate_fits, *self.faults, *steps)

    def ln_bayes(self, candidate_fit: CandidateFit | WrongDatum) -> float:
        """Log Bayes factor of a candidate fit, or of a wrong datum, against the base model."""
        return candidate_fit.ln_evidence - self.base.ln_evidence

    @property
    def refused(self) -> str:
        """First reason why the best attempt is not named; empty when an effect is named.

        ``implausible``, ``dof`` (too few effective degrees of freedom are left to test the fit), ``misfit``,
        ``local_perturbation`` (one fits better) or ``evidence`` (it is too weak).
        """
        candidate_fit, adequacy = self.chosen, self.chosen_adequacy
        if candidate_fit is None or adequacy is None or self.verdict not in UNEXPLAINED:
            return ""
        return self.against(candidate_fit, adequacy) or "evidence"

    def against(self, candidate_fit: CandidateFit, adequacy: AdequacyTests) -> str:
        """First reason beside its evidence why a fit is not believed, as in `refused`; empty without one."""
        if candidate_fit.implausible:
            return "implausible"
        if not adequacy.can_tell:
            return "dof"
        if not adequacy.adequate(self.alpha):
            return "misfit"
        better = self.perturbation is not None and self.perturbation.ln_evidence > candidate_fit.ln_evidence
        return "local_perturbation" if better else ""

    @property
    def names_something(self) -> bool:
        """Whether the verdict names an effect."""
        return self.verdict in (*NAMED, "indistinguishable")

    @property
    def uncontested(self) -> bool:
        """Whether the parameters absorb every local perturbation and fault, so that a wrong name would not show."""
        faults = self.base_adequacy.suspects
        return not (
            (self.base_adequacy.perturbations.size > 0).any() or (faults is not None and (faults.size > 0).any())
        )

    @property
    def blamed(self) -> tuple[CandidateFit, ...]:
        """Faults of the verdict ``measurement``, best first: all that explain about as well; empty for another one."""
        if self.verdict != "measurement" or self.fault is None:
            return ()
        if self.granted:
            return (self.fault,)
        near = self.fault.ln_evidence - RULES.credible
        return tuple(t for t in self.faults if t.ln_evidence > near and (t is self.fault or not t.implausible))

    @property
    def remains(self) -> bool:
        """Whether something is left besides the fault of the measurement that the verdict tells."""
        tests = self.fault_adequacy
        return tests is not None and not (tests.adequate(self.alpha) and tests.can_tell)

    def unconfirmed(self) -> Explanation:
        """The same with nothing named: what fits is the best attempt."""
        return replace(self, verdict="unconfirmed", credible=(), fault=None, datum=None)

    @property
    def equally_good(self) -> tuple[str, ...]:
        """Effects and measurement faults that explain about as well as the best, in words."""
        fault = () if self.fault is None else self.fault.names
        return (*self.credible, *fault, *(() if self.datum is None else (self.datum.in_words,)))

    @property
    def last(self) -> CandidateFit:
        """The fit that the verdict rests on: with what is named, with the fault that is told, or of the base model."""
        if self.names_something and self.chosen is not None:
            return self.chosen
        return self.fault if self.verdict == "measurement" and self.fault is not None else self.base

    @property
    def faulty(self) -> tuple[tuple[Candidate, CandidateFit], ...]:
        """Faults of the measurement that the verdict holds for certain, each with the fit that gives its magnitude."""
        return (*((e, self.last) for e in self.granted), *((t.effects[0], t) for t in self.blamed))

    @property
    def singles(self) -> tuple[CandidateFit, ...]:
        """Candidate fits with one named effect, best first."""
        return tuple(t for t in self.candidate_fits if len(t.effects) == 1)

    @property
    def believed(self) -> tuple[CandidateFit, ...]:
        """Models taken as true: what is named, the two best indistinguishable ones, or else the base model."""
        if not self.names_something or self.chosen is None:
            return (self.base,)
        competing = [t for t in self.singles if t.names[0] in self.credible][:2]
        return tuple(competing) if self.verdict == "indistinguishable" and len(competing) > 1 else (self.chosen,)
