"""Which physical effect is missing: calibrate, test, refit, check what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.inference.left_out import left_out
from calib.missing.alike import Group, grouped
from calib.missing.anew import anew, led_astray
from calib.missing.evidence import at_lower
from calib.missing.findings import Check, Findings, Trial, WrongDatum
from calib.missing.goodness import by_sensor, common_scale, goodness, overall
from calib.missing.hypotheses import Hypotheses
from calib.missing.pairs import alone, fit_pairs
from calib.missing.refits import DEFAULT, EARLY, LATE, Progress, Refits, Settings
from calib.missing.rules import RULES
from calib.missing.score import Scores, family_p
from calib.missing.state import State, nearest_whole
from calib.missing.suspect import suspects
from calib.missing.wrong_datum import wrong_datum


def explain(hypotheses: Hypotheses, settings: Settings = DEFAULT, progress: Progress = lambda words: None) -> Findings:
    """Decide which effect, if any, the base model lacks.

    Calibrate; test whether the largest score among named effects and among unnamed local changes, or the goodness of
    fit, could be chance; fit the most promising effects; take the scatter for understated when most modes ask for it,
    and begin anew; accept an effect, or two, when the evidence outweighs the length of the library, no parameter has to
    take an unbelievable value, no local change fits better, no fault of the measurement and no single wrong datum
    explains about as well, and nothing organised is left. Without effects it is told whether anything is missing, and
    which local change fits best.

    Raises
    ------
    InputError
        With too few measured modes or responses to name anything.
    EvaluationError
        When the base model cannot be fitted.
    """
    modes = {row.mode for row in hypotheses.rows if row.mode}
    responses = sum(not row.mode for row in hypotheses.rows)
    if modes:
        require_modes(len(modes) + responses)
    else:
        require_responses(responses, len(hypotheses.question(()).space.free))
    fits = Refits(hypotheses, settings, 1.0, progress)
    found = _Decision(fits).findings({})
    if found.measured_scale > RULES.guard and found.verdict != "nothing_detectable":
        progress(f"the scatter seems understated by a factor of {found.measured_scale:.2f}: beginning anew")
        starts = {(): found.base.state.values, **{t.names: t.state.values for t in found.singles}}
        again = _Decision(replace(fits, scale=found.measured_scale)).findings(starts)
        verdict = "noise_underestimated" if again.verdict == "nothing_detectable" else again.verdict
        found = replace(again, verdict=verdict, begun_anew=found.begun_anew)
    return found


def require_modes(count: int) -> None:
    """InputError when so many measured modes are too few to name anything."""
    if count < RULES.least_modes:
        raise InputError(
            f"{count} measured modes cannot tell a missing effect from a parameter",
            place="explain",
            remedy=f"measure at least {RULES.least_modes}, or withhold fewer",
        )


def require_responses(count: int, free: int) -> None:
    """InputError when so many measured responses are too few to name anything beside the fitted parameters."""
    least = max(RULES.least_responses, free + 2)
    if count < least:
        raise InputError(
            f"{count} measured responses cannot tell a missing effect from the {free} fitted parameters",
            place="explain",
            remedy=f"measure at least {least}, withhold fewer or fit fewer parameters",
        )


class _Lead(NamedTuple):
    """Single effects that were fitted, best first, and the one that may be named, with its tests."""

    singles: list[Trial]
    best: Trial
    check: Check


@dataclass(frozen=True, eq=False)
class _Decision:
    """The decision with one scale of the scatter."""

    fits: Refits

    def findings(self, starts: dict[tuple[str, ...], dict[str, float]]) -> Findings:
        """Everything found; ``starts`` are the fits of a first decision, by the names of their effects."""
        fits, hypotheses, alpha = self.fits, self.fits.hypotheses, self.fits.settings.alpha
        base = self.calibrated(starts.get(()))
        able, named = self.candidates(base)
        groups = grouped([e for e in hypotheses.effects if e in able], named, fits.settings.merge)
        check = self.check(base, named)
        found = Findings(
            verdict="nothing_detectable", base=base, base_check=check, groups=groups, trials=(), atom=None,
            chosen=None, chosen_check=None, credible=(), noise_scale=fits.scale,
            measured_scale=self.scale(base), evaluations=hypotheses.evaluations, alpha=alpha,
        )  # fmt: skip
        if check.passes(alpha):
            return found
        if not groups:
            return self.unlisted(found)
        singles = fits.singles(base, groups, check.named, starts)
        found = self.with_rivals(found, singles[0])
        needed = self.needed(found)
        lead = self.lead(singles, able)
        found = replace(found, measured_scale=self.scale(base, lead.best, found.atom))
        settled = self.accepted(lead, needed) and not found.measured_scale > RULES.guard
        if not settled and not starts and fits.settings.budget > 0 and led_astray(base, check):
            with fits.allowance.uncharged():  # it has an allowance of its own
                singles = anew(fits, base, singles, able)
            lead = self.lead(singles, able)
            found = replace(found, begun_anew=True, measured_scale=self.scale(base, lead.best, found.atom))
        doubted = found.measured_scale > RULES.guard and not starts
        if doubted and self.promised_scale(lead.best, lead.check.named) > RULES.guard:
            return self.done(found, lead.singles, "none_explains", lead.best, lead.check)
        if self.accepted(lead, needed):
            return self.named(found, lead)
        lead = self.moved(lead, able)
        if self.accepted(lead, needed):
            return self.named(found, lead)
        pairs = fit_pairs(fits, lead.best, lead.check.named, lead.singles, able)
        again = alone(fits, lead.singles, pairs)
        lead = lead if again is lead.singles else self.lead(again, able)
        if self.accepted(lead, needed):
            return self.named(found, lead)
        found = replace(found, measured_scale=self.scale(base, lead.best, found.atom, *pairs[:1]))
        return self.two_effects(found, lead, pairs, able) or self.unexplained(found, lead, pairs, needed)

    # -- steps ---------------------------------------------------------------------------------------------------------

    def calibrated(self, start: dict[str, float] | None) -> Trial:
        """The base model, fitted from a start or from the adopted values with the most promising whole numbers."""
        fits = self.fits
        fits.progress("calibrating the base model")
        question = fits.question(())
        start = start or nearest_whole(question, question.space.values)
        return fits.trial((), start, whole=0 if fits.spent(EARLY) else 1)

    def candidates(self, base: Trial) -> tuple[list[Effect], Scores]:
        """The effects with which the model can be solved, by name, and their scores.

        Neither draws nor ties nor what a budget leaves out may depend on the order of the library.
        """
        self.fits.progress("testing whether anything is missing")
        able = sorted(self.fits.hypotheses.effects, key=lambda e: e.name)
        named = self.fits.scores(base.state, able)
        able = [e for e in able if e.name in named.owners]
        if self.fits.hypotheses.effects and not able:
            raise EvaluationError("the model cannot be solved with any of the effects")
        return able, named

    def with_rivals(self, found: Findings, best: Trial) -> Findings:
        """The findings with what else may explain: a local change, a fault of the measurement, a wrong datum."""
        fits, h, base, check = self.fits, self.fits.hypotheses, found.base, found.base_check
        atom = fits.best_atom(base, check.atoms, check.named, best)
        fault = fits.fault(base, check.atoms, best)
        if _ln(fault) > max(best.ln_evidence, _ln(atom) + RULES.credible):
            atom = fault
        accused = suspects(base.state, h, found.alpha)
        datum = wrong_datum(fits, base, accused, best)
        return replace(found, atom=atom, fault=fault, datum=datum, suspects=accused)

    def moved(self, lead: _Lead, able: Sequence[Effect]) -> _Lead:
        """The same with the best effect where whole numbers are chosen with it in the model."""
        moved = None if self.fits.spent(LATE) else self.fits.moved(lead.best)
        if moved is None:
            return lead
        others = [t for t in lead.singles if t is not lead.best]
        return self.lead(sorted([moved, *others], key=lambda t: -t.ln_evidence), able)

    def two_effects(
        self, found: Findings, lead: _Lead, pairs: Sequence[Trial], able: Sequence[Effect]
    ) -> Findings | None:
        """Two effects that may be named, with those that look the same; None where there are none."""
        second = 2 * RULES.credible + math.log(max(len(found.groups) - 1, 1))
        measurement = max(_ln(found.fault), _ln(found.datum)) + RULES.credible
        needed = max(lead.singles[0].ln_evidence + second, self.rival(found), measurement)
        pair = self.pair(pairs, needed, found.groups)
        if not pair:
            return None
        check = self.check(pair[0], self.beside(pair[0], able))
        if not (self.adequate(check) and self.predicts(pair[0], found.base)):
            return None
        credible = tuple(dict.fromkeys(name for t in pair for name in t.names))
        return self.done(found, (*lead.singles, *pairs), "two_effects", pair[0], check, credible)

    def unlisted(self, found: Findings) -> Findings:
        """What is told where no effect is listed: the local change that fits best, or where the fit is worst."""
        found = self.with_rivals(found, found.base)
        verdict = "none_explains" if found.base_check.p_family <= found.alpha else "misfit_unlocated"
        scale, evaluations = self.scale(found.base, found.atom), self.fits.hypotheses.evaluations
        return replace(found, verdict=verdict, measured_scale=scale, evaluations=evaluations)

    def unexplained(self, found: Findings, lead: _Lead, pairs: Sequence[Trial], needed: float) -> Findings:
        """What is told where nothing may be named."""
        alpha, verdict = found.alpha, "none_explains"
        if lead.best.ln_evidence > needed and not lead.best.implausible and lead.check.p_family <= alpha:
            verdict = "partial"
        elif found.base_check.p_family > alpha:
            verdict = "misfit_unlocated"  # a fit that is bad although nothing stands out is no organised misfit
        return self.done(found, (*lead.singles, *pairs), verdict, lead.best, lead.check)

    def named(self, found: Findings, lead: _Lead) -> Findings:
        """One effect, or several that explain about as well and that a careful reader would believe.

        Where a fault of the measurement explains about as well, nobody can tell either. So it is with a single datum
        without which everything fits. It does not pay for the number of data: that was asked of its chance already.
        """
        lowest = lead.singles[0].ln_evidence - RULES.credible
        fitted = {t.names[0] for t in lead.singles}
        alike = {group.effect.name: tuple(e.name for e in group.others) for group in found.groups}
        credible = tuple(
            name
            for t in lead.singles
            if t.ln_evidence > lowest and not t.implausible
            # What looks the same and was not fitted explains as well.
            for name in (t.names[0], *(n for n in alike.get(t.names[0], ()) if n not in fitted))
        )
        near = lead.best.ln_evidence - RULES.credible
        fault = found.fault if _ln(found.fault) > near else None
        datum = found.datum if fault is None and _ln(found.datum) > near else None
        only = len(credible) == 1 and fault is None and datum is None
        verdict = "effect" if only else "indistinguishable"
        return self.done(found, lead.singles, verdict, lead.best, lead.check, credible, fault, datum)

    def done(
        self, found: Findings, trials: Sequence[Trial], verdict: str, chosen: Trial, check: Check,
        credible: tuple[str, ...] = (), fault: Trial | None = None, datum: WrongDatum | None = None,
    ) -> Findings:  # fmt: skip
        """The findings with their verdict; a name that nothing could have spoken against is withheld."""
        done = replace(
            found, trials=tuple(trials), verdict=verdict, chosen=chosen, chosen_check=check, credible=credible,
            fault=fault, datum=datum, evaluations=self.fits.hypotheses.evaluations,
        )  # fmt: skip
        return done.unconfirmed() if done.names_something and done.unrivalled else done

    # -- what may be named ---------------------------------------------------------------------------------------------

    def rival(self, found: Findings) -> float:
        """Log evidence of what is unnamed and fits best.

        One of many local changes fits best by chance; against a named effect it pays for their number.
        """
        number = len(self.fits.hypotheses.atoms) / len(found.groups)
        return max(_ln(found.atom), _ln(found.fault)) - math.log(max(number, 1.0))

    def needed(self, found: Findings) -> float:
        """Log evidence beyond which one effect may be named."""
        return max(found.base.ln_evidence + math.log(len(found.groups)) + RULES.credible, self.rival(found))

    def accepted(self, lead: _Lead, needed: float) -> bool:
        """Whether the leading effect may be named."""
        return lead.best.ln_evidence > needed and not lead.best.implausible and self.adequate(lead.check)

    def adequate(self, check: Check) -> bool:
        """Whether nothing organised is left although enough data could tell."""
        return check.adequate(self.fits.settings.alpha) and check.can_tell

    def predicts(self, trial: Trial, base: Trial) -> bool:
        """Whether data that are left out, mode by mode or one by one, are predicted no worse than by the base model."""
        groups = [row.mode or row.sensor for row in self.fits.hypotheses.rows]

        def error(state: State) -> float:
            return float(np.linalg.norm(left_out(state.residual, state.slope, state.prior_sd, groups).residual))

        return error(trial.state) <= error(base.state)

    def lead(self, singles: list[Trial], candidates: Sequence[Effect]) -> _Lead:
        """The effect of the highest evidence, with its tests; a believable one of nearly the same goes first."""
        near = [t for t in singles if t.ln_evidence > singles[0].ln_evidence - RULES.credible and not t.implausible]
        best = near[0] if near else singles[0]
        return _Lead(singles, best, self.check(best, self.beside(best, candidates)))

    def pair(self, pairs: Sequence[Trial], needed: float, groups: Sequence[Group]) -> tuple[Trial, ...]:
        """The pair of effects that may be named, with those that look the same; empty when there is none.

        It is well supported, believable, and no other one is nearly as good.
        """
        believable = [t for t in pairs if not t.implausible and not any(at_lower(t.state, e) for e in t.effects)]
        if not believable or believable[0].ln_evidence <= needed:
            return ()
        leader = {name: g.effect.name for g in groups for name in g.names}
        near = [t for t in believable if t.ln_evidence > believable[0].ln_evidence - RULES.credible]
        looks = {frozenset(leader[name] for name in t.names) for t in near}
        return tuple(near) if len(looks) == 1 else ()

    # -- tests ---------------------------------------------------------------------------------------------------------

    def scale(self, *trials: Trial | None) -> float:
        """What shapes ask for at the best of some fits; 1 when it is not common to all modes and sensors."""
        best = max((t for t in trials if t is not None), key=lambda t: t.ln_evidence)
        return common_scale(best.state, self.fits.hypotheses, self.fits.settings.alpha)

    def promised_scale(self, trial: Trial, others: Scores) -> float:
        """The same if the effect that stands out beside a fit did all that its score promises."""
        if not others.owners:
            return self.scale(trial)
        k = int(np.argmax(others.strength))
        left = trial.state.residual - others.unit[: len(trial.state.residual), k] * others.z[k]
        return self.scale(replace(trial, state=replace(trial.state, residual=left)))

    def beside(self, trial: Trial, candidates: Sequence[Effect]) -> Scores:
        """Scores of the candidates that a fitted model does not have, whatever strength its effects need."""
        state = trial.state.granting(trial.names)
        return self.fits.scores(state, [e for e in candidates if e.name not in trial.names])

    def check(self, trial: Trial, named: Scores) -> Check:
        """Tests of a fitted model, given the scores of the named effects that it does not have."""
        hypotheses, seed = self.fits.hypotheses, self.fits.settings.seed
        local = self.beside(trial, hypotheses.atoms)
        kinds, modes = goodness(trial.state, hypotheses)
        return Check(
            named=named,
            atoms=local,
            p_named=family_p(named, hypotheses, seed),
            p_atoms=family_p(local, hypotheses, seed),
            kinds=kinds,
            modes=modes,
            p_fit=overall(kinds, modes),
            sensors=by_sensor(trial.state, hypotheses),
        )


def _ln(one: Trial | WrongDatum | None) -> float:
    """Log evidence; that of nothing is minus infinity."""
    return -math.inf if one is None else one.ln_evidence
