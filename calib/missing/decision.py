"""Decision on the missing effect: calibrate, test, refit, test again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress, silent
from calib.missing.adequacy import adequacy_of, adequate, beside, measured_scale, predicted_scale, predicts
from calib.missing.base_fit import fitted_base, from_further_points, nested
from calib.missing.blame import blamed, fault_first, ln_of, mistakable, tests_of, with_competing, with_faults
from calib.missing.candidate_fit import AdequacyTests, CandidateFit, WrongDatum
from calib.missing.collinear import Group, grouped
from calib.missing.effect_pairs import fit_pairs, no_worse, singles_from_pairs
from calib.missing.explanation import SEVERAL, Explanation
from calib.missing.granted import with_fault
from calib.missing.hypotheses import Hypotheses
from calib.missing.partial import minor_beside, minor_of, several_generic
from calib.missing.place import takes_enough, told_place
from calib.missing.refits import Refits, near_to
from calib.missing.restarts import better_of, led_astray, restarted, restarted_faults, restarted_first, trapped
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.settings import DEFAULT, Settings, require_enough
from calib.missing.single_effects import fit_singles
from calib.missing.stepwise import Stepwise, further_price
from calib.problem.candidate import Candidate


def decide(hypotheses: Hypotheses, settings: Settings = DEFAULT, progress: Progress = silent) -> Explanation:
    """Decide which effect, if any, the base model lacks.

    The base model is calibrated. Tests decide whether the largest score among named effects and among unnamed local
    perturbations, or the goodness of fit, could be chance. The most promising effects are fitted. When most modes call
    for a larger standard deviation, it counts as understated and the decision is repeated with the larger one.

    One effect, or up to four (`Stepwise`), are accepted when the evidence outweighs the length of the library, no
    parameter takes an implausible value, no local perturbation fits better, no measurement fault and no single wrong
    datum explains the data about as well, and no systematic misfit is left. A measurement fault that explains the data
    better than every effect is named instead. Without a library of effects, the result says whether anything is missing
    and which local perturbation fits best.

    Raises
    ------
    InputError
        With too few measured modes or responses to name anything.
    EvaluationError
        When the base model cannot be fitted.
    """
    require_enough(hypotheses.rows, len(hypotheses.fit_problem(()).space.free))
    fits = Refits(hypotheses, settings, 1.0, progress)
    found = _Decision(fits).explanation({}, settings.begin)
    if found.measured_scale > RULES.guard and found.verdict != "nothing_detectable":
        progress(
            f"the standard deviation seems understated by a factor of {found.measured_scale:.2f}: repeating with it"
        )
        starts = {(): found.base.fit.values, **{t.names: t.fit.values for t in found.singles}}
        again = _Decision(replace(fits, scale=found.measured_scale)).explanation(starts)
        verdict = "noise_underestimated" if again.verdict == "nothing_detectable" else again.verdict
        found = replace(again, verdict=verdict, begun_anew=found.begun_anew)
    return found


class _Lead(NamedTuple):
    """Fitted single effects, best first, and the leading one with its tests."""

    singles: list[CandidateFit]
    best: CandidateFit
    adequacy: AdequacyTests


@dataclass(frozen=True, eq=False)
class _Decision:
    """The decision with one factor on the standard deviation."""

    fits: Refits

    def explanation(
        self,
        starts: dict[tuple[str, ...], dict[str, float]],
        begin: Mapping[str, float] | None = None,
        rebased: int = 0,
    ) -> Explanation:
        """Decide.

        Parameters
        ----------
        starts : dict
            Parameter values fitted by an earlier decision, by the names of their effects.
        begin : mapping, optional
            Values from which the base fit begins: of a stored calibration, or of a better base fit.
        rebased : int
            How often a better base fit has made the decision begin again.
        """
        fits, hypotheses, alpha = self.fits, self.fits.hypotheses, self.fits.settings.alpha
        only = bool(starts) or rebased > 0 or bool(fits.granted)
        base = fits.finished(fitted_base(fits, starts.get(()) or begin, only))
        able, named = self.candidates(base)
        adequacy = adequacy_of(fits, base, named)
        better = base if starts or adequacy.passes(alpha) else fits.finished(fits.beside_whole(base))
        if better is not base:
            base = better
            able, named = self.candidates(base)
            adequacy = adequacy_of(fits, base, named)
        groups = grouped([e for e in hypotheses.effects if e in able], named, fits.settings.merge)
        found = Explanation(
            verdict="nothing_detectable", base=base, base_adequacy=adequacy, groups=groups, candidate_fits=(),
            perturbation=None, chosen=None, chosen_adequacy=None, credible=(), noise_scale=fits.scale,
            measured_scale=measured_scale(fits, base), evaluations=hypotheses.evaluations, alpha=alpha,
            granted=fits.granted,
        )  # fmt: skip
        if adequacy.passes(alpha):
            return found
        if not groups:
            return self.unlisted(found)
        astray = not starts and fits.settings.budget > 0 and led_astray(base, adequacy)
        first = restarted_first(fits, base, able) if astray else []
        free = bool(first) and not trapped(first)
        singles = first if free else better_of(first, fit_singles(fits, base, groups, adequacy.named, starts))
        lead = self.lead(singles, able, base)
        found = with_competing(self.fits, found, lead.singles[0])
        needed = self.needed(found)
        factor = measured_scale(fits, base, lead.best, found.perturbation, found.fault)
        found = replace(found, measured_scale=factor, begun_anew=bool(first))
        settled = self.accepted(lead, needed) and not found.measured_scale > RULES.guard
        told = self.blamed(found, lead, needed)
        if not settled and told is None and astray:
            with fits.allowance.uncharged():  # refits from the nominal values have their own budget
                singles = lead.singles if first else restarted(fits, base, lead.singles, able)
                found = with_faults(found, restarted_faults(fits, base, found.faults))
            lead = self.lead(singles, able, base)
            factor = measured_scale(fits, base, lead.best, found.perturbation, found.fault)
            found = replace(found, begun_anew=True, measured_scale=factor)
            settled = self.accepted(lead, needed) and not factor > RULES.guard
            told = self.blamed(found, lead, needed)
        if not starts and rebased < RULES.rebasings and fits.settings.budget > 0:
            better, tried = self.better_base(found, lead, settled or told is not None, adequacy)
            found = replace(found, base_starts=tried)
            if better is not base:
                anew = self.explanation({}, better.fit.values, rebased + 1)
                return replace(anew, base_starts=anew.base_starts + max(tried, 1))
        if told is not None:
            return replace(told, base_starts=found.base_starts)
        doubted = found.measured_scale > RULES.guard and not starts
        if doubted and predicted_scale(fits, lead.best, lead.adequacy.named) > RULES.guard:
            found = self.stepwise(found, lead, (), able)
            return (
                self.several(found, lead)
                or fault_first(fits, found, lead.singles)
                or self.done(found, lead.singles, "none_explains", lead.best, lead.adequacy)
            )
        if self.accepted(lead, needed):
            return self.named(found, lead)
        lead = self.moved(lead, able, base)
        if self.accepted(lead, needed):
            return self.named(found, lead)
        together = None if starts else with_fault(fits, found, lead.singles, lead.best, lead.adequacy, _again)
        if together is not None:
            return together
        pairs = fit_pairs(fits, lead.best, lead.adequacy.named, lead.singles, able)
        again = singles_from_pairs(fits, base, lead.singles, pairs)
        if again is not lead.singles:
            lead, pairs = self.lead(again, able, base), no_worse(fits, pairs, again)
            found = with_competing(self.fits, found, lead.singles[0])
            needed = self.needed(found)
        factor = measured_scale(fits, base, lead.best, found.perturbation, found.fault, *pairs[:1])
        found = replace(found, measured_scale=factor)
        if self.accepted(lead, needed):
            return self.named(found, lead)
        two = self.two_effects(found, lead, pairs, able)
        if two is not None:
            return two
        found = self.stepwise(found, lead, pairs, able)
        return (
            self.several(found, lead, pairs)
            or fault_first(fits, found, (*lead.singles, *pairs))
            or self.unexplained(found, lead, pairs, needed)
        )

    # -- steps ---------------------------------------------------------------------------------------------------------

    def better_base(
        self, found: Explanation, lead: _Lead, settled: bool, adequacy: AdequacyTests
    ) -> tuple[CandidateFit, int]:
        """A better base fit, or the same one, and how many further points were tried; see `calib.missing.base_fit`."""
        fits, base = self.fits, found.base
        better = base
        for larger in dict.fromkeys((lead.best, found.fault)):
            better = better if better is not base else nested(fits, base, larger)
        if better is not base or settled or not led_astray(base, adequacy):
            return better, 0
        return from_further_points(fits, base)

    def candidates(self, base: CandidateFit) -> tuple[list[Candidate], Scores]:
        """The effects with which the model can be solved, sorted by name, and their scores.

        Sorted, so that samples, ties and what the budget leaves out do not depend on the order of the library.
        """
        self.fits.announce("testing whether anything is missing")
        able = sorted(self.fits.hypotheses.effects, key=lambda e: e.name)
        named = self.fits.scores(base.fit, able)
        able = [e for e in able if e.name in named.owners]
        if self.fits.hypotheses.effects and not able:
            raise EvaluationError("the model cannot be solved with any of the effects")
        return able, named

    def blamed(self, found: Explanation, lead: _Lead, needed: float) -> Explanation | None:
        """Explanation by a fault of the measurement; it must beat an effect that could be named by 20:1."""
        margin = RULES.credible if self.accepted(lead, needed) else 0.0
        return blamed(self.fits, found, lead.singles, lead.best, margin)

    def moved(self, lead: _Lead, able: Sequence[Candidate], base: CandidateFit) -> _Lead:
        """The lead after the integer parameters are chosen again with the best effect in the model."""
        moved = self.fits.moved(lead.best)
        if moved is None:
            return lead
        others = [t for t in lead.singles if t is not lead.best]
        return self.lead([moved, *others], able, base)

    def two_effects(
        self, found: Explanation, lead: _Lead, pairs: Sequence[CandidateFit], able: Sequence[Candidate]
    ) -> Explanation | None:
        """Explanation by two effects, with those collinear with them; None when no pair may be named."""
        second = further_price(len(found.groups) - 1)
        needed = max(lead.singles[0].ln_evidence + second, self.unlike_effects(found))
        pairs = self.fits.settled(pairs, RULES.credible)
        pair = self.pair(pairs, needed, found.groups)
        if not pair or several_generic(pair[0]) or minor_beside(found, lead.singles, pair[0]):
            return None
        adequacy = adequacy_of(self.fits, pair[0], beside(self.fits, pair[0], able))
        if not (adequate(self.fits, adequacy) and predicts(self.fits, pair[0], found.base)):
            return None
        credible = tuple(dict.fromkeys(name for t in pair for name in t.names))
        search = Stepwise(self.fits, found.base, found.base_adequacy, able)
        found = replace(found, steps=search.path(*_first(lead, pair[0]), pair[0]))
        return self.done(found, (*lead.singles, *pairs), "two_effects", pair[0], adequacy, credible)

    def stepwise(
        self, found: Explanation, lead: _Lead, pairs: Sequence[CandidateFit], able: Sequence[Candidate]
    ) -> Explanation:
        """Take in one effect after the other, where the best one or the best pair has strong evidence."""
        first, second = RULES.credible + math.log(len(found.groups)), further_price(len(found.groups) - 1)
        start = next((t for t in pairs[:1] if t.ln_evidence - lead.best.ln_evidence > second), lead.best)
        strong = lead.best.ln_evidence - found.base.ln_evidence > first or start is not lead.best
        if not strong or self.fits.settings.budget <= 0:
            return found
        search = Stepwise(self.fits, found.base, found.base_adequacy, able)
        return replace(found, steps=search.steps(*_first(lead, start), start))

    def several(self, found: Explanation, lead: _Lead, pairs: Sequence[CandidateFit] = ()) -> Explanation | None:
        """Explanation by the effects of a stepwise search, with those as good in their place; None without."""
        steps = found.steps
        if steps is None or not steps.explains or minor_beside(found, lead.singles, steps.last.candidate_fit):
            return None
        last = steps.last
        if several_generic(last.candidate_fit) or last.candidate_fit.ln_evidence <= self.unlike_effects(found):
            return None
        names = last.candidate_fit.names
        verdict = "two_effects" if len(names) == 2 else "several_effects"
        found = replace(found, measured_scale=measured_scale(self.fits, found.base, last.candidate_fit))
        credible = tuple(dict.fromkeys((*names, *(other for _, other in steps.competing))))
        fitted = [step.candidate_fit for step in steps.steps[1:]]
        every = (*lead.singles, *pairs, *(t for t in fitted if t not in (*lead.singles, *pairs)))
        return self.done(found, every, verdict, last.candidate_fit, last.adequacy, credible)

    def unlisted(self, found: Explanation) -> Explanation:
        """Explanation without a library: the local perturbation that fits best, or where the fit is worst."""
        found = with_competing(self.fits, found, found.base)
        if self.fits.settings.budget > 0 and led_astray(found.base, found.base_adequacy):
            with self.fits.allowance.uncharged():
                found = with_faults(found, restarted_faults(self.fits, found.base, found.faults))
        told = (
            blamed(self.fits, found, (), None, 0.0)
            or with_fault(self.fits, found, (), None, None, _again)
            or fault_first(self.fits, found, ())
        )
        if told is not None:
            return told
        verdict = "none_explains" if found.base_adequacy.p_family <= found.alpha else "misfit_unlocated"
        factor, evaluations = (
            measured_scale(self.fits, found.base, found.perturbation),
            self.fits.hypotheses.evaluations,
        )
        found = replace(found, verdict=verdict, measured_scale=factor, evaluations=evaluations)
        return replace(found, place=told_place(self.fits, found))

    def unexplained(self, found: Explanation, lead: _Lead, pairs: Sequence[CandidateFit], needed: float) -> Explanation:
        """Explanation when no effect may be named."""
        alpha, verdict = found.alpha, "none_explains"
        strong = lead.best.ln_evidence > needed and not lead.best.implausible and takes_enough(found, lead.best)
        if strong and lead.adequacy.p_family <= alpha:
            verdict = "partial"
            found = replace(found, minor=minor_of(found, lead.singles))
        elif found.base_adequacy.p_family > alpha:
            verdict = "misfit_unlocated"  # a bad fit in which nothing stands out is not a systematic misfit
        return self.done(found, (*lead.singles, *pairs), verdict, lead.best, lead.adequacy)

    def named(self, found: Explanation, lead: _Lead) -> Explanation:
        """Explanation by one effect, or by several that explain about as well.

        The effect also counts as indistinguishable when a measurement fault, or a single wrong datum, explains about
        as well. The datum is not penalised for the number of data: its p-value already accounts for it.
        """
        least = lead.singles[0].ln_evidence - RULES.credible
        fitted = {t.names[0] for t in lead.singles}
        collinear = {group.effect.name: tuple(e.name for e in group.others) for group in found.groups}
        credible = tuple(
            name
            for t in lead.singles
            if t.ln_evidence > least and not t.implausible
            # A collinear effect that was not fitted explains as well.
            for name in (t.names[0], *(n for n in collinear.get(t.names[0], ()) if n not in fitted))
        )
        near = lead.best.ln_evidence - RULES.credible
        choice = math.log(max(len(self.fits.family.single) / len(found.groups), 1.0))
        fault = found.fault if ln_of(found.fault) - choice > near else None
        if fault is None and (alike := mistakable(found, lead.best)) is not None:
            fault, found = alike, replace(found, fault_adequacy=tests_of(self.fits, found, alike))
        datum = found.datum if fault is None and ln_of(found.datum) > near else None
        only = len(credible) == 1 and fault is None and datum is None
        verdict = "effect" if only else "indistinguishable"
        return self.done(found, lead.singles, verdict, lead.best, lead.adequacy, credible, fault, datum)

    def done(
        self, found: Explanation, candidate_fits: Sequence[CandidateFit], verdict: str, chosen: CandidateFit,
        adequacy: AdequacyTests, credible: tuple[str, ...] = (), fault: CandidateFit | None = None,
        datum: WrongDatum | None = None,
    ) -> Explanation:  # fmt: skip
        """The explanation with its verdict; unconfirmed when nothing could have contradicted the name."""
        done = replace(
            found, candidate_fits=tuple(candidate_fits), verdict=verdict, chosen=chosen, chosen_adequacy=adequacy,
            credible=credible, fault=fault, datum=datum, evaluations=self.fits.hypotheses.evaluations,
            odds_against_datum=chosen.ln_evidence - ln_of(found.datum) if found.datum is not None else math.nan,
        )  # fmt: skip
        if done.names_something:
            singles = [t for t in done.singles if verdict in SEVERAL and t.names[0] in chosen.names]
            like = ((t.names[0], one.names[0]) for t in singles if (one := mistakable(done, t)) is not None)
            done = replace(done, mistakable=tuple(like))
            return done.unconfirmed() if done.uncontested else done
        return replace(done, place=told_place(self.fits, done))

    # -- what may be named ---------------------------------------------------------------------------------------------

    def competitor(self, found: Explanation) -> float:
        """Log evidence of the best unnamed explanation.

        One of many local perturbations fits best by chance; its evidence is reduced by their number per group.
        """
        number = len(self.fits.hypotheses.perturbations) / len(found.groups)
        fault = None if self.fits.hypotheses.faults else found.fault  # else `blamed` weighs it
        return max(ln_of(found.perturbation), ln_of(fault)) - math.log(max(number, 1.0))

    def unlike_effects(self, found: Explanation) -> float:
        """Log evidence above which several effects may be named: of anything else that explains the data alone."""
        return max(self.competitor(found), max(ln_of(found.fault), ln_of(found.datum)) + RULES.credible)

    def needed(self, found: Explanation) -> float:
        """Log evidence above which one effect may be named."""
        return max(found.base.ln_evidence + math.log(len(found.groups)) + RULES.credible, self.competitor(found))

    def accepted(self, lead: _Lead, needed: float) -> bool:
        """Whether the leading effect may be named."""
        return lead.best.ln_evidence > needed and not lead.best.implausible and adequate(self.fits, lead.adequacy)

    def lead(self, singles: Sequence[CandidateFit], candidates: Sequence[Candidate], base: CandidateFit) -> _Lead:
        """The effect of the highest evidence, with its tests; a plausible one nearly as good is preferred.

        It and the effects near to it are fitted until they converge first.
        """
        reached = max(t.ln_evidence for t in singles) - base.ln_evidence
        ranked = self.fits.settled(singles, near_to(reached))
        near = [t for t in ranked if t.ln_evidence > ranked[0].ln_evidence - RULES.credible and not t.implausible]
        best = near[0] if near else ranked[0]
        return _Lead(ranked, best, adequacy_of(self.fits, best, beside(self.fits, best, candidates)))

    def pair(self, pairs: Sequence[CandidateFit], needed: float, groups: Sequence[Group]) -> tuple[CandidateFit, ...]:
        """The pair of effects that may be named, with pairs collinear with it; empty when there is none.

        It is well supported and plausible, and no other pair is nearly as good.
        """
        credible = [t for t in pairs if t.is_possible]
        if not credible or credible[0].ln_evidence <= needed:
            return ()
        leader = {name: g.effect.name for g in groups for name in g.names}
        near = [t for t in credible if t.ln_evidence > credible[0].ln_evidence - RULES.credible]
        distinct = {frozenset(leader[name] for name in t.names) for t in near}
        return tuple(near) if len(distinct) == 1 else ()


def _again(fits: Refits, begin: Mapping[str, float]) -> Explanation:
    return _Decision(fits).explanation({}, begin)


def _first(lead: _Lead, pair: CandidateFit) -> list[CandidateFit]:
    """The best fit with one effect of a pair; nothing for a single effect."""
    return [t for t in lead.singles if t.names[0] in pair.names][:1] if len(pair.names) > 1 else []
