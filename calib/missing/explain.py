"""Which physical effect is missing: calibrate, test, refit, check what is left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.freedom import effective_freedom
from calib.missing.alike import Group, grouped
from calib.missing.anew import anew, led_astray
from calib.missing.evidence import CREDIBLE, at_lower
from calib.missing.findings import LEAST_FREEDOM, Check, Findings, Trial
from calib.missing.goodness import by_sensor, common_scale, goodness, overall
from calib.missing.hypotheses import Hypotheses
from calib.missing.left_out import left_out
from calib.missing.refits import DEFAULT, EARLY, LATE, Progress, Refits, Settings
from calib.missing.score import Scores, family_p
from calib.missing.state import State, nearest_whole
from calib.missing.suspect import suspects
from calib.missing.wrong_datum import wrong_datum

LEAST_MODES = 4
"""Fewer modes cannot tell an effect from a parameter."""
GUARD = 1.11
"""Factor on the scatter from which it counts as understated (two and a half standard errors with 8 modes)."""


def explain(hypotheses: Hypotheses, settings: Settings = DEFAULT, progress: Progress = lambda words: None) -> Findings:
    """Decide which effect, if any, the base model lacks.

    Calibrate; test whether the largest score among named effects and among unnamed local changes, or the goodness of
    fit, could be chance; fit the most promising effects; take the scatter for understated when most modes ask for it,
    and begin anew; accept an effect, or two, when the evidence outweighs the length of the library, no parameter has to
    take an unbelievable value, no local change fits better, no fault of the measurement and no single wrong datum
    explains about as well, and nothing organised is left.

    Raises
    ------
    InputError
        Without candidates, or with too few measured modes to name anything.
    EvaluationError
        When the base model cannot be fitted.
    """
    if not hypotheses.effects:
        raise InputError("there is no effect to look for", place="explain", remedy="name a library with effects = ...")
    modes = {row.mode for row in hypotheses.rows if row.mode}
    if modes:
        require_modes(len(modes))
    fits = Refits(hypotheses, settings, 1.0, progress)
    found = _Decision(fits).findings({})
    if found.measured_scale > GUARD and found.verdict != "nothing_detectable":
        progress(f"the scatter seems understated by a factor of {found.measured_scale:.2f}: beginning anew")
        starts = {(): found.base.state.values, **{t.names: t.state.values for t in found.singles}}
        again = _Decision(replace(fits, scale=found.measured_scale)).findings(starts)
        verdict = "noise_underestimated" if again.verdict == "nothing_detectable" else again.verdict
        found = replace(again, verdict=verdict, begun_anew=found.begun_anew)
    return found


def require_modes(count: int) -> None:
    """InputError when so many measured modes are too few to name anything."""
    if count < LEAST_MODES:
        raise InputError(
            f"{count} measured modes cannot tell a missing effect from a parameter",
            place="explain",
            remedy=f"measure at least {LEAST_MODES}, or withhold fewer",
        )


@dataclass(frozen=True, eq=False)
class _Decision:
    """The decision with one scale of the scatter."""

    fits: Refits

    def findings(self, starts: dict[tuple[str, ...], dict[str, float]]) -> Findings:
        """Everything found; ``starts`` are the fits of a first decision, by the names of their effects."""
        fits, hypotheses, alpha = self.fits, self.fits.hypotheses, self.fits.settings.alpha
        fits.progress("calibrating the base model")
        question = fits.question(())
        start = starts.get(()) or nearest_whole(question, question.space.values)
        base = fits.trial((), start, whole=0 if fits.spent(EARLY) else 1)
        fits.progress("testing whether anything is missing")
        # By name: neither draws nor ties nor what a budget leaves out may depend on the order of the library.
        able = sorted(hypotheses.effects, key=lambda e: e.name)
        named = fits.scores(base.state, able)
        able = [e for e in able if e.name in named.owners]
        if not able:
            raise EvaluationError("the model cannot be solved with any of the effects")
        library = [e for e in hypotheses.effects if e in able]
        groups = grouped(library, named, fits.settings.merge)
        check = self.check(base, named)
        plain = Findings(
            verdict="nothing_detectable", base=base, base_check=check, groups=groups, trials=(), atom=None,
            chosen=None, chosen_check=None, credible=(), noise_scale=fits.scale,
            measured_scale=self.scale(base), evaluations=hypotheses.evaluations, alpha=alpha,
        )  # fmt: skip
        if check.passes(alpha):
            return plain
        accused = suspects(base.state, hypotheses.rows, hypotheses.fitted_factors, hypotheses.scatter_freedom, alpha)
        plain = replace(plain, suspects=accused)
        singles = fits.singles(base, groups, check.named, starts)
        atom = fits.best_atom(base, check.atoms, check.named, singles)
        fault = fits.fault(base, check.atoms, singles[0])
        if fault is not None and fault.ln_evidence > max(
            singles[0].ln_evidence, -math.inf if atom is None else atom.ln_evidence + CREDIBLE
        ):
            atom = fault
        plain = replace(plain, datum=wrong_datum(fits, base, accused, singles[0]))
        # One of many local changes fits best by chance; against a named effect it pays for their number.
        unnamed = [t.ln_evidence for t in (atom, fault) if t is not None]
        rival = max(unnamed, default=-math.inf) - math.log(max(len(hypotheses.atoms) / len(groups), 1.0))
        needed = max(base.ln_evidence + math.log(len(groups)) + CREDIBLE, rival)
        best, best_check = self.best(singles, able)
        settled = self.accepted(best, best_check, needed) and not self.scale(base, best, atom) > GUARD
        if not settled and not starts and fits.settings.budget > 0 and led_astray(base, check):
            with fits.allowance.uncharged():  # it has an allowance of its own
                singles = anew(fits, base, singles, able)
            best, best_check = self.best(singles, able)
            plain = replace(plain, begun_anew=True)
        plain = replace(
            plain, trials=tuple(singles), atom=atom, fault=fault, measured_scale=self.scale(base, best, atom)
        )
        if plain.measured_scale > GUARD and not starts and self.promised_scale(best, best_check.named) > GUARD:
            return self.done(plain, "none_explains", best, best_check)
        if self.accepted(best, best_check, needed):
            return self.named(plain, singles, best, best_check)
        moved = None if fits.spent(LATE) else fits.moved(best)
        if moved is not None:
            singles = sorted([moved, *(t for t in singles if t is not best)], key=lambda t: -t.ln_evidence)
            best, best_check = self.best(singles, able)
            if self.accepted(best, best_check, needed):
                return self.named(plain, singles, best, best_check)
        pairs = fits.pairs(best, best_check.named, singles, able)
        again = fits.alone(singles, pairs)
        if again is not singles:
            singles = again
            best, best_check = self.best(singles, able)
            if self.accepted(best, best_check, needed):
                return self.named(plain, singles, best, best_check)
        plain = replace(plain, trials=(*singles, *pairs), measured_scale=self.scale(base, best, atom, *pairs[:1]))
        second = 2 * CREDIBLE + math.log(max(len(groups) - 1, 1))
        wrong = -math.inf if plain.datum is None else plain.datum.ln_evidence
        alone = max(wrong, -math.inf if fault is None else fault.ln_evidence) + CREDIBLE
        pair = self.pair(pairs, max(singles[0].ln_evidence + second, rival, alone), groups)
        if pair:
            pair_check = self.check(pair[0], self.beside(pair[0], able))
            if pair_check.adequate(alpha) and self.told_by_data(pair[0]) and self.predicts(pair[0], base):
                credible = dict.fromkeys(name for t in pair for name in t.names)
                both = self.done(plain, "two_effects", pair[0], pair_check, tuple(credible))
                return both.unconfirmed() if both.unrivalled else both
        partial = best.ln_evidence > needed and not best.implausible and best_check.p_family <= alpha
        if partial:
            return self.done(plain, "partial", best, best_check)
        # A fit that is bad although nothing stands out is no organised misfit.
        return self.done(plain, "misfit_unlocated" if check.p_family > alpha else "none_explains", best, best_check)

    def accepted(self, trial: Trial, check: Check, needed: float) -> bool:
        """Whether an effect may be named."""
        adequate = check.adequate(self.fits.settings.alpha) and self.told_by_data(trial)
        return trial.ln_evidence > needed and not trial.implausible and adequate

    def told_by_data(self, trial: Trial) -> bool:
        """Whether enough data are left to speak against a fit."""
        factors = sum(self.fits.hypotheses.fitted_factors.values())
        return effective_freedom(trial.state.slope, trial.state.prior_sd, factors) >= LEAST_FREEDOM

    def predicts(self, trial: Trial, base: Trial) -> bool:
        """Whether data that are left out, mode by mode or one by one, are predicted no worse than by the base model."""
        groups = [row.mode or row.sensor for row in self.fits.hypotheses.rows]

        def error(state: State) -> float:
            return float(np.linalg.norm(left_out(state.residual, state.slope, state.prior_sd, groups).residual))

        return error(trial.state) <= error(base.state)

    def named(self, found: Findings, singles: Sequence[Trial], best: Trial, check: Check) -> Findings:
        """One effect, or several that explain about as well and that a careful reader would believe.

        Where a fault of the measurement explains about as well, nobody can tell either. So it is with a single datum
        without which everything fits. It does not pay for the number of data: that was asked of its chance already.
        """
        lowest = singles[0].ln_evidence - CREDIBLE
        fitted = {t.names[0] for t in singles}
        alike = {group.effect.name: tuple(e.name for e in group.others) for group in found.groups}
        credible = tuple(
            name
            for t in singles
            if t.ln_evidence > lowest and not t.implausible
            # What looks the same and was not fitted explains as well.
            for name in (t.names[0], *(n for n in alike.get(t.names[0], ()) if n not in fitted))
        )
        fault = found.fault
        if fault is not None and fault.ln_evidence <= best.ln_evidence - CREDIBLE:
            fault = None
        datum = found.datum
        if fault is not None or (datum is not None and datum.ln_evidence <= best.ln_evidence - CREDIBLE):
            datum = None
        found = replace(found, trials=tuple(singles))
        alone = len(credible) == 1 and fault is None and datum is None
        done = self.done(found, "effect" if alone else "indistinguishable", best, check, credible)
        done = replace(done, fault=fault, datum=datum)
        return done.unconfirmed() if done.unrivalled else done

    def done(
        self, found: Findings, verdict: str, chosen: Trial, check: Check, credible: tuple[str, ...] = ()
    ) -> Findings:
        """The findings with their verdict."""
        return replace(
            found, verdict=verdict, chosen=chosen, chosen_check=check, credible=credible, fault=None,
            datum=None, evaluations=self.fits.hypotheses.evaluations,
        )  # fmt: skip

    def best(self, singles: Sequence[Trial], candidates: Sequence[Effect]) -> tuple[Trial, Check]:
        """The effect of the highest evidence, with its tests; a believable one of nearly the same goes first."""
        near = [t for t in singles if t.ln_evidence > singles[0].ln_evidence - CREDIBLE and not t.implausible]
        best = near[0] if near else singles[0]
        return best, self.check(best, self.beside(best, candidates))

    def pair(self, pairs: Sequence[Trial], needed: float, groups: Sequence[Group]) -> tuple[Trial, ...]:
        """The pair of effects that may be named, with those that look the same; empty when there is none.

        It is well supported, believable, and no other one is nearly as good.
        """
        believable = [t for t in pairs if not t.implausible and not any(at_lower(t.state, e) for e in t.effects)]
        if not believable or believable[0].ln_evidence <= needed:
            return ()
        leader = {name: g.effect.name for g in groups for name in g.names}
        near = [t for t in believable if t.ln_evidence > believable[0].ln_evidence - CREDIBLE]
        looks = {frozenset(leader[name] for name in t.names) for t in near}
        return tuple(near) if len(looks) == 1 else ()

    # -- tests ---------------------------------------------------------------------------------------------------------

    def scale(self, *trials: Trial | None) -> float:
        """What shapes ask for at the best of some fits; 1 when it is not common to all modes and sensors."""
        best = max((t for t in trials if t is not None), key=lambda t: t.ln_evidence)
        h = self.fits.hypotheses
        return common_scale(best.state, h.rows, h.fitted_factors, h.scatter_freedom, self.fits.settings.alpha)

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
        freedom = hypotheses.scatter_freedom
        kinds, modes = goodness(trial.state, hypotheses.rows, hypotheses.fitted_factors, freedom)
        return Check(
            named=named,
            atoms=local,
            p_named=family_p(named, hypotheses.rows, freedom, seed),
            p_atoms=family_p(local, hypotheses.rows, freedom, seed),
            kinds=kinds,
            modes=modes,
            p_fit=overall(kinds, modes),
            sensors=by_sensor(trial.state, hypotheses.rows, hypotheses.fitted_factors, freedom),
        )
