"""Search for what may explain a misfit that no listed effect explains: compositions, scored, fitted and ranked."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.errors.errors import EvaluationError
from calib.hypotheses.proposals.proposal import Composed, Lost, Proposal, Proposals
from calib.missing.adequacy import adequacy_of, beside, suspects
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.evidence import at_lower, ln_bayes_linear
from calib.missing.hypotheses import FitProblem, Hypotheses
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.nearest_integers import nearest_whole
from calib.missing.refits import Refits, near_to
from calib.missing.rules import RULES
from calib.missing.score import Scores, family_p, scored, scores
from calib.missing.suspect import suspects_table, wrong_datum
from calib.problem.candidate import Candidate
from calib.structure.effects.composition import HungBy

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


def _drop(found: Scores, name: str) -> float:
    """Largest predicted decrease of the sum of squares by a candidate at a point of its grid."""
    (k,) = found.steps(name, 1)
    length = found.size[k] * abs(found.points[k][name])
    return float(2 * found.z[k] * length - length**2)


@dataclass(frozen=True, eq=False)
class Search:
    """Search for the composition that explains a misfit best.

    Attributes
    ----------
    fits : Refits
        Its hypotheses have all compositions as effects.
    composed : sequence of Composed
        Without degrees of freedom of their own.
    mounts : sequence of Composed
        Of dampers; with a grid.
    hung : sequence of HungBy
    held : sequence of Candidate
        Masses held fast that are no local perturbations.
    freqs : ndarray (n_rows,)
        Frequency of each row of the residual, Hz; NaN where a row has none, for which no mass is hung.
    """

    fits: Refits
    composed: Sequence[Composed]
    mounts: Sequence[Composed]
    hung: Sequence[HungBy]
    held: Sequence[Candidate]
    freqs: np.ndarray

    @property
    def hypotheses(self) -> Hypotheses:
        """The models with any of the compositions."""
        return self.fits.hypotheses

    def proposals(self, names: tuple[str, ...], start: Mapping[str, float]) -> Proposals:
        """Search beside some effects of the library, from fitted values."""
        fits, h, alpha = self.fits, self.hypotheses, self.fits.settings.alpha
        fits.announce("fitting the model")
        begin = nearest_whole(fits.fit_problem(names), dict(start))
        base = fits.finished(fits.beside_whole(fits.candidate_fit(names, begin, whole=1)))
        fits.announce("testing every composition")
        # Magnitudes of the effects at hand are as free as they can be, so that proposals are not their leftovers.
        fit = base.fit.granting(names) if names else base.fit
        found = scores(fit, [c.effect for c in self.composed], {})
        local = fits.scores(fit, h.perturbations)
        lost: list[Lost] = []
        mounts, at_mounts = self._mounts(base, fit, found, lost)
        tests = [one for one in (found, local, at_mounts) if one.owners]
        p = min(1.0, len(tests) * min(family_p(one, h, fits.settings.seed) for one in tests))
        all_of_them = (*self.composed, *self.mounts, *(one.composed for one in self.hung))
        if p > alpha:
            return self._none(base, p, len(all_of_them), lost)
        choices = Counter(c.family for c in all_of_them)
        hung = self._hung(fit, local, lost)
        at_hung = self._at_grid(base, fit, hung)
        ranked: list[Proposal] = []
        tried = (*((c, found) for c in self._leading(found, choices)), *((c, at_mounts) for c in mounts))
        for composed, own in (*tried, *((c, at_hung) for c in hung)):
            proposal = self._fitted(base, composed, own, choices[composed.family], lost)
            ranked += [] if proposal is None else [proposal]
        ranked.sort(key=lambda one: -one.evidence)
        ranked = self._refined(base, ranked, (found, at_mounts, at_hung), choices)
        if not ranked or ranked[0].evidence <= 0:
            return self._none(base, p, len(all_of_them), lost)
        best = ranked[0].candidate_fit
        adequacy = adequacy_of(fits, best, beside(fits, best, []))
        fault, datum = self._suspect(base, ranked[0])
        return Proposals(
            base,
            tuple(ranked),
            p,
            len(all_of_them),
            adequacy,
            fault,
            datum,
            fits.scale,
            alpha,
            h.evaluations,
            tuple(lost),
        )

    def _none(self, base: CandidateFit, p: float, tested: int, lost: Sequence[Lost] = ()) -> Proposals:
        scale, alpha, count = self.fits.scale, self.fits.settings.alpha, self.hypotheses.evaluations
        return Proposals(base, (), p, tested, None, None, None, scale, alpha, count, tuple(lost))

    def _problem(self, base: CandidateFit, composed: Composed) -> FitProblem:
        return self.fits.fit_problem((*base.names, composed.effect.name))

    def _at_grid(self, base: CandidateFit, fit: LinearisedFit, composed: Sequence[Composed]) -> Scores:
        """Scores at the points of their grids."""
        problems = {c.effect.name: self._problem(base, c) for c in composed}
        return scores(fit, [c.effect for c in composed], problems)

    def _unsolved(self, base: CandidateFit, composed: Composed) -> Lost:
        """A composition that no point of its grid could be solved with, and why."""
        effect, reason = composed.effect, "the model cannot be solved with it"
        for point in effect.grid[:1]:
            try:
                self._problem(base, composed).residual({**base.fit.values, **point})
            except EvaluationError as fault:
                reason = str(fault)
        return Lost(effect.title, reason)

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

    def _mounts(
        self, base: CandidateFit, fit: LinearisedFit, found: Scores, lost: list[Lost]
    ) -> tuple[list[Composed], Scores]:
        """Damper mounts of the largest predicted decrease of the sum of squares, with their scores.

        Signatures are taken where the dampers themselves have the largest scores, of either sign.
        """
        damping = {c.at: c.effect.name for c in self.composed if c.kind == "damping"}
        size = {c.at: abs(float(found.z[found.best(damping[c.at])])) for c in self.mounts if c.at in damping}
        tried = sorted(self.mounts, key=lambda c: -size.get(c.at, 0.0))[: RULES.tried_mounts]
        at_grid = self._at_grid(base, fit, tried)
        drops: list[tuple[float, Composed]] = []
        for composed in tried:
            name = composed.effect.name
            if name not in at_grid.owners:
                lost.append(self._unsolved(base, composed))
                continue
            drops.append((_drop(at_grid, name), composed))
        drops.sort(key=lambda pair: -pair[0])
        return [composed for drop, composed in drops[: RULES.proposed_mounts] if drop > 0], at_grid

    def _hung(self, fit: LinearisedFit, local: Scores, lost: list[Lost]) -> list[Composed]:
        """Hung masses of the largest scores, one at a place, which follow from those of the same masses held fast.

        A mass m on a spring acts at a frequency f as ``m/(1 - (f/f0)^2)`` does, so that the signature of a fixed one,
        row by row times this factor, is that of a hung one to first order.
        """
        if not self.hung or np.isnan(self.freqs).any() or not (self.freqs > 0).any():
            return []
        held = scores(fit, self.held, {})
        natural = np.geomspace(0.7 * self.freqs[self.freqs > 0].min(), 1.4 * self.freqs.max(), _FREQS)
        factor = hung_over_fixed(self.freqs, natural)
        best: list[tuple[float, int]] = []
        for k, one in enumerate(self.hung):
            own = next((found for found in (local, held) if one.fixed in found.owners), None)
            if own is None:
                lost.append(Lost(one.composed.effect.title, "nothing is known of the same mass held fast"))
                continue
            raw = own.raw[:, [own.best(one.fixed)]] * factor
            many = [one.fixed] * raw.shape[1]
            seen = scored(fit, many, [{}] * len(many), raw, [False] * len(many), [0.0] * len(many))
            best.append((float(seen.z.max()), k))
        best.sort(key=lambda pair: (-pair[0], pair[1]))
        chosen: dict[tuple[float, float, float], Composed] = {}
        for score, k in best:
            composed = self.hung[k].composed
            if score > 0 and len(chosen) < RULES.proposed_hung:
                chosen.setdefault(composed.place, composed)
        return list(chosen.values())

    # -- fits ----------------------------------------------------------------------------------------------------------

    def _fitted(
        self, base: CandidateFit, composed: Composed, found: Scores, choices: int, lost: list[Lost]
    ) -> Proposal | None:
        """A composition, fitted; None where it is not supported, and where it cannot be solved, which is kept."""
        fits, name = self.fits, composed.effect.name
        if name not in found.owners:
            lost.append(self._unsolved(base, composed))
            return None
        fits.announce(f"fitting {composed.effect.title}")
        try:
            fit = fits.best_of((*base.names, name), self._starts(base, composed, found), base)
        except EvaluationError as fault:
            lost.append(Lost(composed.effect.title, str(fault)))
            return None
        if fit is None:
            lost.append(Lost(composed.effect.title, "the model cannot be solved near any start"))
            return None
        if at_lower(fit.fit, composed.effect):
            return None
        score = float(found.z[found.best(name)])
        return Proposal(composed, fit, score, fit.ln_evidence - base.ln_evidence, choices)

    def _starts(self, base: CandidateFit, composed: Composed, found: Scores) -> list[dict[str, float]]:
        """Starts for the fit of a composition: one step, and where that goes beyond the plausible magnitude this one.

        A change of many tens of percent is beyond what one step foresees: from it a fit may end in a poor optimum.
        """
        effect, out = composed.effect, self.fits.starts(base.fit, found, composed.effect.name)
        size = out[0][effect.name]
        if effect.grid or abs(size) <= effect.plausible:
            return out
        size = math.copysign(effect.plausible, size)
        step = base.fit.update(-found.raw[:, found.best(effect.name)] * size)
        moved = {n: base.fit.values[n] + d for n, d in zip(base.fit.names, step, strict=True)}
        return [{**base.fit.values, **moved, effect.name: size}, *out]

    def _refined(
        self,
        base: CandidateFit,
        ranked: Sequence[Proposal],
        known: tuple[Scores, Scores, Scores],
        choices: Mapping[tuple[str, bool], int],
    ) -> list[Proposal]:
        """The same with those near the best fitted until they converge, and with what is equal to them."""
        out, near = [], near_to(ranked[0].evidence) if ranked else 0.0
        for k, one in enumerate(ranked):
            fit, behind = one.candidate_fit, ranked[0].evidence - one.evidence
            if behind < (near if k < RULES.refined else RULES.close):
                fit = self.fits.finished(self.fits.followed(fit, whole=1))
            out.append(replace(one, candidate_fit=fit, ln_bayes=fit.ln_evidence - base.ln_evidence))
        out.sort(key=lambda one: (bool(one.candidate_fit.implausible), -one.evidence))
        fitted = {one.composed.effect.name for one in out}
        return [replace(one, alike=self._alike(one, known, choices, fitted)) for one in out]

    def _alike(
        self,
        one: Proposal,
        known: tuple[Scores, Scores, Scores],
        choices: Mapping[tuple[str, bool], int],
        fitted: Collection[str],
    ) -> tuple[Composed, ...]:
        """Compositions that were not fitted, and whose signatures are predicted to explain about as much.

        One of a signature with the correlation rho is expected to lose ``z^2 (1 - rho^2)/2`` of the log evidence, at
        the score z of the proposal. ``known`` are the scores of those without a grid, of mounts and of hung masses.
        """
        name, found = one.composed.effect.name, known[0]
        own = next((scores for scores in known if name in scores.owners), None)
        if own is None or not found.owners:
            return ()
        rho = found.unit.T @ own.unit[:, own.best(name)]
        counts = np.log([choices[self.of[owner].family] for owner in found.owners])
        lost = one.score**2 * (1 - rho**2) / 2 + counts - math.log(one.choices)
        possible = (found.signed | (np.sign(found.z) > 0)) & (found.size > 0) & (lost < RULES.equal)
        return tuple(
            self.of[owner]
            for k, owner in enumerate(found.owners)
            if possible[k] and owner != name and owner not in fitted
        )

    @cached_property
    def of(self) -> Mapping[str, Composed]:
        """Compositions by the name of their effect."""
        return {c.effect.name: c for c in self.composed}

    # -- the measurement -----------------------------------------------------------------------------------------------

    def _suspect(self, base: CandidateFit, best: Proposal) -> tuple[CandidateFit | None, WrongDatum | None]:
        """A fault of the measurement and a wrong datum that explain as well as the best proposal, if there are any."""
        fits, h = self.fits, self.hypotheses
        limit = base.ln_evidence + best.evidence
        fault = None
        if h.faults:
            faults, choice = fits.faults(base, suspects(fits, base), best.candidate_fit), fits.family.choice
            own = [t for t in faults if t.ln_evidence - choice >= limit and not t.implausible]
            fault = next(iter(own), None)
        datum = wrong_datum(fits, base, suspects_table(base.fit, h, fits.settings.alpha), best.candidate_fit)
        near = best.candidate_fit.ln_evidence - RULES.credible
        return fault, datum if datum is not None and datum.ln_evidence > near else None
