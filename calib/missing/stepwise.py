"""Stepwise search for several effects: the best further one is taken in, and those no longer needed are left out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.missing.adequacy import adequacy_of, adequate, beside, left_out_error, predicts, suspects
from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.collinear import Group, grouped
from calib.missing.evidence import at_lower, ln_bayes_linear
from calib.missing.place import best_perturbation
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.steps import Rejected, Step, StepwiseSearch, Stopped, Trial
from calib.problem.candidate import Candidate


@dataclass(frozen=True, eq=False)
class Stepwise:
    """Search that begins with one effect, or two, which leave a systematic misfit.

    At each step, the effects predicted to explain most of what is left are fitted beside those taken in. The one of the
    highest evidence enters if its evidence outweighs the number of effects to choose from, data left out in turn are
    predicted no worse, and at least two effective degrees of freedom remain. Effects that lost their evidence by it are
    left out again. Parameters may stay pulled until nothing systematic is left.

    A model that leaves nothing is accepted when its values are plausible, and when nothing else in the place of any of
    its effects explains about as well: no other effect, no local perturbation and no fault of the measurement. Effects
    collinear with one of them are named beside it.

    Attributes
    ----------
    fits : Refits
    base : CandidateFit
        Without effects.
    base_adequacy : AdequacyTests
    candidates : sequence of Candidate
        Effects with which the model can be solved.
    """

    fits: Refits
    base: CandidateFit
    base_adequacy: AdequacyTests
    candidates: Sequence[Candidate]
    _trials: list[Trial] = field(init=False, repr=False, default_factory=list)

    def steps(self, *start: CandidateFit) -> StepwiseSearch:
        """Search from a fitted model; what was taken in before comes first."""
        steps = [self._step(self.base, self.base_adequacy), *map(self._step, start)]
        self.fits.allowance.ensure(RULES.stepped * self.fits.settings.budget)
        seen = {frozenset(step.candidate_fit.names) for step in steps}
        while True:
            current = steps[-1]
            if adequate(self.fits, current.adequacy):
                return self._assessed(steps)
            if len(current.candidate_fit.names) >= RULES.most_effects:
                return self._ended(steps, "most")
            if self.fits.spent():
                return self._ended(steps, "budget")
            entered = self._entered(current)
            if entered is None:
                return self._ended(steps, "rejected")
            reduced = self._reduced(entered)
            if frozenset(reduced.candidate_fit.names) in seen:
                return self._ended(steps, "returned")
            seen.add(frozenset(reduced.candidate_fit.names))
            steps.append(reduced)

    def path(self, *fits: CandidateFit) -> StepwiseSearch:
        """Models that were found otherwise, as the steps of a search."""
        with self.fits.allowance.uncharged():
            return self._ended([self._step(self.base, self.base_adequacy), *map(self._step, fits)], "adequate")

    def _ended(self, steps: Sequence[Step], stopped: Stopped) -> StepwiseSearch:
        return StepwiseSearch(tuple(steps), tuple(self._trials), stopped)

    def _step(self, candidate_fit: CandidateFit, adequacy: AdequacyTests | None = None) -> Step:
        fits = self.fits
        if adequacy is None:
            adequacy = adequacy_of(fits, candidate_fit, beside(fits, candidate_fit, self.candidates))
        return Step(candidate_fit, adequacy, left_out_error(fits, candidate_fit))

    def _reject(self, larger: CandidateFit, smaller: CandidateFit, what: Candidate, why: Rejected) -> None:
        others = tuple(name for name in larger.names if name != what.name)
        gain, error = larger.ln_evidence - smaller.ln_evidence, left_out_error(self.fits, larger)
        self._trials.append(Trial(others, what, gain, error, why))

    # -- a step --------------------------------------------------------------------------------------------------------

    def _entered(self, current: Step) -> Step | None:
        """The model with the best further effect; None where every one is rejected."""
        model, scores = current.candidate_fit, current.adequacy.named
        groups = self._groups(model, scores)
        tried = self._fitted(model, scores, groups)
        found: Step | None = None
        for one in tried:
            what = one.effects[-1]
            if one.ln_evidence - model.ln_evidence <= further_price(len(groups)) or at_lower(one.fit, what):
                self._reject(one, model, what, "evidence")
            elif found is not None:
                self._reject(one, model, what, "weaker")
            elif (step := self._step(one)).left_out > current.left_out:
                self._reject(one, model, what, "left_out")
            elif not step.adequacy.can_tell:
                self._reject(one, model, what, "dof")
            else:
                found = step
        return found

    def _groups(self, model: CandidateFit, scores: Scores) -> list[Group]:
        """Groups of collinear effects that the model lacks, those predicted to explain most first."""
        able = [e for e in self.candidates if e.name in scores.owners]
        plausible = {e.name: e.plausible for e in able}
        sizes = np.array([plausible[name] for name in scores.owners])
        predicted = ln_bayes_linear(scores.magnitude, scores.size, sizes)
        best = {name: max(predicted[k] for k in scores.of(name)) for name in plausible}
        groups = grouped(able, scores, self.fits.settings.merge)
        return sorted(groups, key=lambda g: (-max(best[name] for name in g.names), g.effect.name))

    def _fitted(self, model: CandidateFit, scores: Scores, groups: Sequence[Group]) -> list[CandidateFit]:
        """The model with each of the most promising further effects, best first; the best with all like it."""
        fits = self.fits
        out = sorted(
            self._beside(model, scores, [g.effect for g in groups[: RULES.further]]), key=lambda t: -t.ln_evidence
        )
        if not out:
            return []
        leader = out[0].effects[-1].name
        others = next(g.others for g in groups if g.effect.name == leader)
        out += self._beside(model, scores, others)
        best = max(range(len(out)), key=lambda k: out[k].ln_evidence)
        out[best] = fits.followed(out[best], whole=1)
        return sorted(out, key=lambda t: -t.ln_evidence)

    def _beside(self, model: CandidateFit, scores: Scores, effects: Sequence[Candidate]) -> Iterator[CandidateFit]:
        fits, starts = self.fits, {e.name: self.fits.starts(model.fit, scores, e.name)[:1] for e in effects}
        fits.ahead(((*model.names, name), start) for name, (start,) in starts.items())
        for effect in effects:
            fits.announce(f"fitting {effect.title} beside {' and '.join(e.title for e in model.effects)}")
            columns = fits.columns(model.fit, scores, effect.name)
            found = fits.best_of((*model.names, effect.name), starts[effect.name], model, columns)
            if found is not None:
                yield found

    def _reduced(self, entered: Step) -> Step:
        """The model without the effects that are no longer needed, least needed first."""
        step = entered
        while len(step.candidate_fit.names) > 1:
            model = step.candidate_fit
            effects = model.effects[:-1]
            refits = zip(self.fits.without_each(model, effects, self.base), effects, strict=True)
            smaller = [(rest, effect) for rest, effect in refits if rest is not None]
            smaller.sort(key=lambda one: -one[0].ln_evidence)
            price = further_price(len(self.candidates) - len(model.names) + 1)
            if not smaller or model.ln_evidence - smaller[0][0].ln_evidence > price:
                return step
            rest, least = smaller[0]
            self._reject(model, rest, least, "no_longer_needed")
            step = self._step(rest)
        return step

    # -- what may be named ---------------------------------------------------------------------------------------------

    def _assessed(self, steps: Sequence[Step]) -> StepwiseSearch:
        """The search that ended with a model which leaves nothing systematic: whether it may be named."""
        model = steps[-1].candidate_fit
        if not model.is_possible:
            return self._ended(steps, "implausible")
        if not predicts(self.fits, model, self.base):
            return self._ended(steps, "doubtful")
        competing: list[tuple[str, str]] = []
        doubted = False
        for effect in model.effects if len(model.names) > 1 else ():
            for one, why in self._competing(model, effect):
                competing += [(effect.name, one.effects[-1].name)] if why == "collinear" else []
                doubted |= why != "collinear"
                self._reject(one, model, one.effects[-1], why)
        found = self._ended(steps, "doubtful" if doubted else "adequate")
        return replace(found, competing=tuple(competing))

    def _competing(self, model: CandidateFit, effect: Candidate) -> list[tuple[CandidateFit, Rejected]]:
        """What explains about as well in the place of one effect: other effects, a local perturbation, a fault.

        One of many local perturbations, or of many faults, fits best by chance: their number is taken off.
        """
        fits, h = self.fits, self.fits.hypotheses
        rest = fits.without(model, effect, self.base)
        if rest is None:
            return []
        with fits.allowance.uncharged():
            scores = beside(fits, rest, self.candidates)
            groups = self._groups(rest, scores)
            own = next((g for g in groups if effect.name in g.names), None)
            alike = [] if own is None else [e for e in own.effects if e is not effect]
            others = [g.effect for g in groups if g is not own][: RULES.competing]
            near = model.ln_evidence - RULES.credible
            out: list[tuple[CandidateFit, Rejected]] = [
                (one, "collinear" if one.effects[-1] in alike else "as_good")
                for one in self._beside(rest, scores, [*alike, *others])
                if one.ln_evidence > near and not one.implausible
            ]
            local = beside(fits, rest, h.perturbations)
            place = best_perturbation(fits, rest, local, scores, model) if local.owners else None
            if place is not None and place.ln_evidence - _chance(h.perturbations, groups) > model.ln_evidence:
                out.append((place, "local_perturbation"))
            faults = fits.faults(rest, suspects(fits, rest), model)[:1] if h.faults else ()
            out += [(one, "fault") for one in faults if one.ln_evidence - _chance(fits.family.single, groups) > near]
        return out


def further_price(choices: int) -> float:
    """Log Bayes factor above which a further effect is taken in beside others, out of so many to choose from.

    Twice that of a first effect: a wrong model is often improved by any effect.
    """
    return 2 * RULES.credible + math.log(max(choices, 1))


def _chance(unnamed: Sequence[Candidate], groups: Sequence[Group]) -> float:
    """Log of the number of unnamed candidates for each group of effects."""
    return math.log(max(len(unnamed) / max(len(groups), 1), 1.0))
