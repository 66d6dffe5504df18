"""Proposals: effects that nobody listed, composed from local perturbations and ranked by their evidence."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from calib.candidate import Candidate
from calib.errors import EvaluationError
from calib.missing.adequacy import adequacy_of, beside
from calib.missing.candidate_fit import AdequacyTests, CandidateFit, WrongDatum
from calib.missing.evidence import at_lower, ln_bayes_linear
from calib.missing.hypotheses import FitProblem, Hypotheses
from calib.missing.linearised_fit import LinearisedFit, nearest_whole
from calib.missing.profile import profile_interval
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores, family_p, scored, scores
from calib.missing.suspect import suspects
from calib.missing.wrong_datum import wrong_datum

_DAMPED = 0.1
"""Damping ratio of the hung masses whose signatures are derived from those of fixed ones: peaks at neighbouring natural
frequencies overlap, so that none falls between them."""
_FREQS = 15
"""Natural frequencies of these."""


def hung_over_fixed(freqs: np.ndarray, natural: np.ndarray) -> np.ndarray:
    """How a mass on a spring acts at given frequencies, over the same mass held fast.

    ``Re 1/(1 - (f/f0)^2 + 2 i zeta f/f0)``: above 1 below its natural frequency, where it moves more than its carrier,
    negative above it, where it moves against it, and towards 0 far above (Den Hartog 1956).

    Parameters
    ----------
    freqs : ndarray (n,)
        Hz.
    natural : ndarray (m,)
        Natural frequencies f0 of the mass on its spring, Hz.

    Returns
    -------
    ndarray (n, m)
    """
    ratio = freqs[:, None] / natural
    return np.real(1 / (1 - ratio**2 + 2j * _DAMPED * ratio))


class Composed(Protocol):
    """An effect composed of local perturbations, such as `calib.structure.compositions.Composition`."""

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
    def place(self) -> tuple[float, float, float]:
        """Its place, m; NaN where none is known."""
        ...

    @property
    def family(self) -> tuple[str, bool]:
        """Compositions among which it was chosen."""
        ...


@dataclass(frozen=True, eq=False)
class HungBy:
    """A hung mass, and the local perturbation that is the same mass held fast.

    Attributes
    ----------
    composed : Composed
    fixed : str
        Name of the perturbation.
    """

    composed: Composed
    fixed: str


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
    left : AdequacyTests or None
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
    """

    base: CandidateFit
    ranked: tuple[Proposal, ...]
    p_family: float
    tested: int
    left: AdequacyTests | None
    fault: CandidateFit | None
    datum: WrongDatum | None
    scale: float
    alpha: float
    evaluations: int

    @property
    def close(self) -> tuple[Proposal, ...]:
        """Proposals that explain about as well as the first one, itself included."""
        return tuple(p for p in self.ranked if p.evidence > self.ranked[0].evidence - RULES.credible)

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


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the composition that explains a misfit best.

    Attributes
    ----------
    fits : Refits
        Its hypotheses have all compositions as effects.
    composed : sequence of Composed
        Without degrees of freedom of their own.
    hung : sequence of HungBy
    freqs : mapping from str to float
        Measured frequency of each mode, Hz; empty for other data, for which no mass is hung.
    """

    fits: Refits
    composed: Sequence[Composed]
    hung: Sequence[HungBy]
    freqs: Mapping[str, float]

    @property
    def hypotheses(self) -> Hypotheses:
        """The models with any of the compositions."""
        return self.fits.hypotheses

    def proposals(self, names: tuple[str, ...], start: Mapping[str, float]) -> Proposals:
        """Search beside some effects of the library, from fitted values."""
        fits, h, alpha = self.fits, self.hypotheses, self.fits.settings.alpha
        fits.tell("fitting the model")
        begin = nearest_whole(fits.fit_problem(names), dict(start))
        base = fits.finished(fits.beside_whole(fits.candidate_fit(names, begin, whole=1)))
        fits.tell("testing every composition")
        # Magnitudes of the effects at hand are as free as they can be, so that proposals are not their leftovers.
        fit = base.fit.granting(names) if names else base.fit
        found = scores(fit, [c.effect for c in self.composed], {})
        local = fits.scores(fit, h.perturbations)
        p = min(1.0, 2 * min(family_p(one, h, fits.settings.seed) for one in (found, local)))
        tested = len(self.composed) + len(self.hung)
        if p > alpha:
            return self._none(base, p, tested)
        choices = Counter(c.family for c in (*self.composed, *(one.composed for one in self.hung)))
        leading = self._leading(found, choices)
        hung = self._hung(fit, local)
        at_grid = scores(fit, [c.effect for c in hung], {c.effect.name: self._problem(base, c) for c in hung})
        ranked: list[Proposal] = []
        for composed, own in (*((c, found) for c in leading), *((c, at_grid) for c in hung)):
            proposal = self._fitted(base, composed, own, choices[composed.family])
            ranked += [] if proposal is None else [proposal]
        ranked.sort(key=lambda one: -one.evidence)
        ranked = self._refined(base, ranked, found)
        if not ranked or ranked[0].evidence <= 0:
            return self._none(base, p, tested)
        best = ranked[0].candidate_fit
        left = adequacy_of(fits, best, beside(fits, best, []))
        fault, datum = self._suspect(base, ranked[0])
        return Proposals(base, tuple(ranked), p, tested, left, fault, datum, fits.scale, alpha, h.evaluations)

    def _none(self, base: CandidateFit, p: float, tested: int) -> Proposals:
        scale, alpha = self.fits.scale, self.fits.settings.alpha
        return Proposals(base, (), p, tested, None, None, None, scale, alpha, self.hypotheses.evaluations)

    def _problem(self, base: CandidateFit, composed: Composed) -> FitProblem:
        return self.fits.fit_problem((*base.names, composed.effect.name))

    # -- which are fitted ----------------------------------------------------------------------------------------------

    def _leading(self, found: Scores, choices: Mapping[tuple[str, bool], int]) -> list[Composed]:
        """Those of the largest predicted evidence, a few of a kind, none collinear with a better one of its kind."""
        plausible = np.array([c.effect.plausible for c in self.composed])
        counts = np.log([choices[c.family] for c in self.composed])
        predicted = ln_bayes_linear(found.magnitude, found.size, plausible) - counts
        chosen: list[int] = []
        of_kind = Counter[str]()
        for k in np.argsort(-predicted, kind="stable").tolist():
            composed = self.composed[k]
            if len(chosen) == RULES.proposed or predicted[k] <= 0:
                break
            twin = any(
                abs(found.unit[:, k] @ found.unit[:, j]) > RULES.same and self.composed[j].kind == composed.kind
                for j in chosen
            )
            if of_kind[composed.kind] < RULES.proposed_of_a_kind and not twin:
                chosen.append(k)
                of_kind[composed.kind] += 1
        return [self.composed[k] for k in chosen]

    def _hung(self, fit: LinearisedFit, local: Scores) -> list[Composed]:
        """Hung masses of the largest scores, which follow from those of the same masses held fast.

        A mass m on a spring acts at a frequency f as ``m/(1 - (f/f0)^2)`` does, so that the signature of a fixed one,
        mode by mode times this factor, is that of a hung one to first order.
        """
        rows = [self.freqs.get(row.mode, math.nan) for row in self.hypotheses.rows]
        freqs = np.array(rows)
        if not self.hung or np.isnan(freqs).any():
            return []
        natural = np.geomspace(0.7 * freqs.min(), 1.4 * freqs.max(), _FREQS)
        factor = hung_over_fixed(freqs, natural)
        best: list[tuple[float, int]] = []
        for k, one in enumerate(self.hung):
            if one.fixed in local.owners:
                raw = local.raw[:, [local.best(one.fixed)]] * factor
                many = [one.fixed] * raw.shape[1]
                seen = scored(fit, many, [{}] * len(many), raw, [False] * len(many), [0.0] * len(many))
                best.append((float(seen.z.max()), k))
        best.sort(key=lambda pair: (-pair[0], pair[1]))
        return [self.hung[k].composed for score, k in best[: RULES.proposed_hung] if score > 0]

    # -- fits ----------------------------------------------------------------------------------------------------------

    def _fitted(self, base: CandidateFit, composed: Composed, found: Scores, choices: int) -> Proposal | None:
        """A composition, fitted; None where it cannot be solved, is not supported or is implausible."""
        fits, name = self.fits, composed.effect.name
        if name not in found.owners:
            return None
        fits.tell(f"fitting {composed.effect.title}")
        try:
            fit = fits.best_of((*base.names, name), fits.starts(base.fit, found, name), base)
        except EvaluationError:
            return None
        if fit is None or at_lower(fit.fit, composed.effect):
            return None
        score = float(found.z[found.best(name)])
        return Proposal(composed, fit, score, fit.ln_evidence - base.ln_evidence, choices)

    def _refined(self, base: CandidateFit, ranked: Sequence[Proposal], found: Scores) -> list[Proposal]:
        """The same with those near the best fitted until they converge, and with what is collinear with them."""
        out = []
        for one in ranked:
            fit = one.candidate_fit
            if ranked[0].evidence - one.evidence < RULES.close:
                fit = self.fits.finished(self.fits.followed(fit, whole=1))
            out.append(
                Proposal(
                    one.composed, fit, one.score, fit.ln_evidence - base.ln_evidence, one.choices,
                    alike=self._alike(one, found),
                )
            )  # fmt: skip
        return sorted(out, key=lambda one: (bool(one.candidate_fit.implausible), -one.evidence))

    def _alike(self, one: Proposal, found: Scores) -> tuple[Composed, ...]:
        """Compositions of the same signature: however large, the effect would not be told from them."""
        name = one.composed.effect.name
        if name not in found.owners:
            return ()
        k = found.best(name)
        rho = found.unit.T @ found.unit[:, k]
        near = np.abs(rho) > RULES.same
        possible = found.signed | (np.sign(found.z) > 0)
        return tuple(c for j, c in enumerate(self.composed) if j != k and near[j] and possible[j] and found.size[j] > 0)

    # -- the measurement -----------------------------------------------------------------------------------------------

    def _suspect(self, base: CandidateFit, best: Proposal) -> tuple[CandidateFit | None, WrongDatum | None]:
        """A fault of the measurement and a wrong datum that explain as well as the best proposal, if there are any."""
        fits, h = self.fits, self.hypotheses
        limit = base.ln_evidence + best.evidence
        fault = None
        if h.faults:
            faults = fits.faults(base, beside(fits, base, h.faults), best.candidate_fit)
            own = [t for t in faults if t.ln_evidence - math.log(len(h.faults)) >= limit and not t.implausible]
            fault = next(iter(own), None)
        datum = wrong_datum(fits, base, suspects(base.fit, h, fits.settings.alpha), best.candidate_fit)
        near = best.candidate_fit.ln_evidence - RULES.credible
        return fault, datum if datum is not None and datum.ln_evidence > near else None
