"""Which physical effect is missing: calibrate, test, refit, check what is left."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.missing.alike import grouped
from calib.missing.evidence import CREDIBLE, at_lower, ln_bayes_linear, ln_evidence
from calib.missing.findings import Check, Findings, Trial
from calib.missing.goodness import goodness, noise_scale, overall
from calib.missing.hypotheses import Hypotheses, Question, Scaled
from calib.missing.plausible import implausible
from calib.missing.score import Scores, family_p, scores
from calib.missing.state import FINE, ROUGH, State, fitted, nearest_whole
from calib.updating.gauss_newton import FitSettings

LEAST_MODES = 4
"""Fewer modes cannot tell an effect from a parameter."""
GUARD = 1.11
"""Factor on the scatter from which it counts as understated (two and a half standard errors with 8 modes)."""
SAME = 0.98
"""Correlation of fingerprints from which a local change says the same as a named effect."""
PAIRS_OF_BEST, PAIRS_OF_NEXT = 3, 2
"""Effects that are tried beside the best one and beside the runner-up."""
_FAR = 30.0
"""Log Bayes factor from which an effect leaves no room for those that promise a quarter of it."""
_CLOSE = 10.0
"""Effects whose log evidence is within this of the best are fitted to the end."""
_POLISHED = 3
_NEARLY = 0.35
"""The same, as a part of what the best one has gained."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """How an explanation decides.

    Attributes
    ----------
    alpha : float
        Family-wise level of every test.
    refits : int
        Effects that are fitted, best first.
    merge : float
        Correlation of fingerprints from which two effects are one group.
    seed : int
        Of the draws behind family-wise probabilities.
    budget : float
        Model evaluations after which no further effect or pair of effects is tried.
    """

    alpha: float = 0.01
    refits: int = 6
    merge: float = 0.98
    seed: int = 1
    budget: float = 115.0


def explain(
    hypotheses: Hypotheses, settings: Settings = Settings(), progress: Progress = lambda words: None
) -> Findings:
    """Decide which effect, if any, the base model lacks.

    Calibrate; test whether the largest score among named effects and among unnamed local changes, or the goodness of
    fit, could be chance; fit the most promising effects; take the scatter for understated when most modes ask for it,
    and begin anew; accept an effect, or two, when the evidence outweighs the length of the library, no parameter has to
    take an unbelievable value, no local change fits better, and nothing organised is left.

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
    # What was asked before is not charged to this decision, which must not depend on it.
    settings = replace(settings, budget=settings.budget + hypotheses.evaluations)
    found = _Round(hypotheses, settings, 1.0, progress).findings({})
    if found.measured_scale > GUARD and found.verdict != "nothing_detectable":
        progress(f"the scatter seems understated by a factor of {found.measured_scale:.2f}: beginning anew")
        starts = {(): found.base.state.values, **{t.names: t.state.values for t in found.singles}}
        again = _Round(hypotheses, settings, found.measured_scale, progress).findings(starts)
        verdict = "noise_underestimated" if again.verdict == "nothing_detectable" else again.verdict
        found = replace(again, verdict=verdict)
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
class _Round:
    """One pass with one scale of the scatter."""

    hypotheses: Hypotheses
    settings: Settings
    scale: float
    progress: Progress
    _by_name: dict[str, Effect] = field(init=False)

    def __post_init__(self) -> None:
        known = {e.name: e for e in (*self.hypotheses.effects, *self.hypotheses.atoms)}
        object.__setattr__(self, "_by_name", known)

    def question(self, names: tuple[str, ...]) -> Question:
        inner = self.hypotheses.question(names)
        return inner if self.scale == 1.0 else Scaled(inner, self.scale)

    # -- the decision --------------------------------------------------------------------------------------------------

    def findings(self, starts: dict[tuple[str, ...], dict[str, float]]) -> Findings:
        hypotheses, alpha = self.hypotheses, self.settings.alpha
        self.progress("calibrating the base model")
        question = self.question(())
        start = starts.get(()) or nearest_whole(question, question.space.values)
        base = self.trial((), start, whole=1)
        self.progress("testing whether anything is missing")
        first = self._scores(base, hypotheses.effects)
        able = [e for e in hypotheses.effects if e.name in first.owners]
        if not able:
            raise EvaluationError("the model cannot be solved with any of the effects")
        groups = grouped(able, first, self.settings.merge)
        candidates = tuple(g.effect for g in groups)
        check = self.check(base, candidates)
        plain = Findings(
            verdict="nothing_detectable", base=base, base_check=check, groups=groups, trials=(), atom=None,
            chosen=None, chosen_check=None, credible=(), noise_scale=self.scale,
            measured_scale=noise_scale(check.modes), evaluations=hypotheses.evaluations, alpha=alpha,
        )  # fmt: skip
        if check.passes(alpha):
            return plain
        singles = self.singles(base, candidates, check.named, starts)
        atom = self.best_atom(base, check.atoms, check.named, singles)
        # One of many local changes fits best by chance; against a named effect it pays for their number.
        rival = -math.inf
        if atom is not None:
            rival = atom.ln_evidence - math.log(max(len(hypotheses.atoms) / len(candidates), 1.0))
        needed = max(base.ln_evidence + math.log(len(candidates)) + CREDIBLE, rival)
        best = self.best(singles)
        best_check = self.check(best, candidates)
        plain = replace(plain, trials=tuple(singles), atom=atom, measured_scale=self._scale(base, best, atom))
        if plain.measured_scale > GUARD and not starts:
            return self.done(plain, "none_explains", best, best_check)
        if self.accepted(best, best_check, needed):
            return self.named(plain, singles, best, best_check)
        moved = None if self.spent() else self.moved(best)
        if moved is not None:
            singles = sorted([moved, *(t for t in singles if t is not best)], key=lambda t: -t.ln_evidence)
            best = self.best(singles)
            best_check = self.check(best, candidates)
            plain = replace(plain, trials=tuple(singles))
            if self.accepted(best, best_check, needed):
                return self.named(plain, singles, best, best_check)
        pairs = self.pairs(best, best_check.named, singles, candidates)
        again = self.alone(singles, pairs)
        if again is not singles:
            singles, best = again, self.best(again)
            best_check = self.check(best, candidates)
            plain = replace(plain, trials=tuple(singles))
            if self.accepted(best, best_check, needed):
                return self.named(plain, singles, best, best_check)
        plain = replace(plain, trials=(*singles, *pairs))
        second = 2 * CREDIBLE + math.log(max(len(candidates) - 1, 1))
        pair = self.pair(pairs, max(singles[0].ln_evidence + second, rival))
        if pair is not None:
            pair_check = self.check(pair, candidates)
            if pair_check.adequate(alpha):
                return self.done(plain, "two_effects", pair, pair_check, pair.names)
        partial = best.ln_evidence > needed and not best.implausible and best_check.p_family <= alpha
        return self.done(plain, "partial" if partial else "none_explains", best, best_check)

    def spent(self) -> bool:
        """Whether the budget is used up, so that only what the verdict needs is still solved."""
        return self.hypotheses.evaluations > self.settings.budget

    def accepted(self, trial: Trial, check: Check, needed: float) -> bool:
        """Whether an effect may be named."""
        return trial.ln_evidence > needed and not trial.implausible and check.adequate(self.settings.alpha)

    def named(self, found: Findings, singles: Sequence[Trial], best: Trial, check: Check) -> Findings:
        """One effect, or several that explain about as well."""
        credible = self.credible(singles)
        return self.done(found, "effect" if len(credible) == 1 else "indistinguishable", best, check, credible)

    def done(
        self, found: Findings, verdict: str, chosen: Trial, check: Check, credible: tuple[str, ...] = ()
    ) -> Findings:
        return replace(
            found, verdict=verdict, chosen=chosen, chosen_check=check, credible=credible,
            evaluations=self.hypotheses.evaluations,
        )  # fmt: skip

    def best(self, singles: Sequence[Trial]) -> Trial:
        """The effect of the highest evidence; a believable one of nearly the same goes first."""
        near = [t for t in singles if t.ln_evidence > singles[0].ln_evidence - CREDIBLE and not t.implausible]
        return near[0] if near else singles[0]

    def pair(self, pairs: Sequence[Trial], needed: float) -> Trial | None:
        """The pair of effects that may be named: well supported, believable, and none other nearly as good."""
        believable = [t for t in pairs if not t.implausible]
        if not believable or believable[0].ln_evidence <= needed:
            return None
        if any(t.ln_evidence > believable[0].ln_evidence - CREDIBLE for t in believable[1:]):
            return None
        return believable[0]

    def moved(self, trial: Trial) -> Trial | None:
        """The same effect where whole numbers are chosen with it in the model; None when that is no better.

        What was missing has led the base model to other whole numbers, and the other parameters have followed them.
        """
        question = self.question(trial.names)
        own = {n for e in trial.effects for n in e.names} | {p.name for p in question.space.free if p.integer}
        adopted = question.space.values
        start = nearest_whole(question, {n: trial.state.values[n] if n in own else v for n, v in adopted.items()})
        if all(start[p.name] == trial.state.values[p.name] for p in question.space.free if p.integer):
            return None
        found = self.trial(trial.names, start)
        return found if found.state.misfit < trial.state.misfit else None

    def alone(self, singles: list[Trial], pairs: Sequence[Trial]) -> list[Trial]:
        """The single effects once more where a pair in which the other one vanished has found a better fit."""
        better = {}
        for pair in pairs:
            left = [e for e in pair.effects if not at_lower(pair.state, e)]
            if len(left) != 1 or len(pair.effects) == 1:
                continue
            name = left[0].name
            known = next((t.state.misfit for t in singles if t.names == (name,)), math.inf)
            if pair.state.misfit < known - 1.0:
                gone = {n for e in pair.effects if e.name != name for n in e.names}
                start = {n: v for n, v in pair.state.values.items() if n not in gone}
                found = self.trial((name,), start, whole=1)
                if found.state.misfit < known:
                    better[name] = found
        if not better:
            return singles
        kept = [t for t in singles if t.names[0] not in better]
        return sorted([*kept, *better.values()], key=lambda t: -t.ln_evidence)

    def credible(self, singles: Sequence[Trial]) -> tuple[str, ...]:
        """Effects whose evidence is near the best one's and that a careful reader would believe."""
        lowest = singles[0].ln_evidence - CREDIBLE
        return tuple(t.names[0] for t in singles if t.ln_evidence > lowest and not t.implausible)

    def _scale(self, *trials: Trial | None) -> float:
        """What the shapes of all modes ask for at the best of some fits; 1 when it is not common to them."""
        best = max((t for t in trials if t is not None), key=lambda t: t.ln_evidence)
        h = self.hypotheses
        return noise_scale(goodness(best.state, h.rows, h.fitted_factors, h.scatter_freedom)[1])

    # -- fits ----------------------------------------------------------------------------------------------------------

    def trial(
        self, names: tuple[str, ...], start: dict[str, float], whole: int = 0, settings: FitSettings = FINE
    ) -> Trial:
        effects = tuple(self._by_name[n] for n in names)
        state = fitted(self.question(names), names, start, whole, settings)
        return Trial(effects, state, ln_evidence(state, effects), implausible(state, effects))

    def singles(
        self,
        base: Trial,
        candidates: Sequence[Effect],
        named: Scores,
        starts: dict[tuple[str, ...], dict[str, float]],
    ) -> list[Trial]:
        """The most promising effects, fitted; best first."""
        plausible = np.array([self._by_name[n].plausible for n in named.owners])
        promise = ln_bayes_linear(named.strength, named.size, plausible)
        by_effect = {e.name: max(promise[k] for k, n in enumerate(named.owners) if n == e.name) for e in candidates}
        order = sorted(by_effect, key=lambda n: -by_effect[n])[: self.settings.refits]
        out: list[Trial] = []
        for name in order:
            if len(out) > 1 and self.spent():
                break
            reached = max((t.ln_evidence - base.ln_evidence for t in out), default=0.0)
            if reached > _FAR and by_effect[name] < reached / 4 and (name,) not in starts:
                continue  # it promises next to nothing of what another one has done already
            self.progress(f"fitting {self._by_name[name].title}")
            known = [starts[(name,)]] if (name,) in starts else None
            found = self.best_of((name,), known or self._starts(base.state, named, name))
            if found is not None:
                out.append(found)
        if not out:
            raise EvaluationError("no effect could be fitted")
        out.sort(key=lambda t: -t.ln_evidence)
        # Places of whole-number parameters may have followed what was missing: the best are allowed to move them back.
        reached = out[0].ln_evidence - base.ln_evidence
        near = max(_CLOSE, _NEARLY * reached)
        for k, one in enumerate(out[:_POLISHED]):
            close = out[0].ln_evidence - one.ln_evidence < near
            if reached > CREDIBLE and close and (k == 0 or not self.spent()):
                out[k] = self.trial(one.names, one.state.values, whole=1)
        return sorted(out, key=lambda t: -t.ln_evidence)

    def best_of(self, names: tuple[str, ...], starts: Sequence[dict[str, float]]) -> Trial | None:
        """The best fit from some starts; None when no start can be evaluated."""
        fits = []
        for start in starts:
            try:
                fits.append(self.trial(names, start, settings=ROUGH))
            except EvaluationError:
                continue
        return min(fits, key=lambda t: t.state.misfit) if fits else None

    def _starts(self, state: State, found: Scores, name: str) -> list[dict[str, float]]:
        """Where to start the fit of an effect: one step from the state, of the best points of its grid."""
        effect, out = self._by_name[name], []
        for k in found.steps(name, 2 if effect.nuisance else 1):
            p, point = effect.strength, found.points[k]
            size = found.z[k] / found.size[k] if found.size[k] > 0 else 0.0
            least = 0.1 * abs(point[name]) if point else p.lower
            size = min(max(size, least, p.lower), p.upper)
            step = state.follow(-found.raw[:, k] * size)
            moved = {n: state.values[n] + d for n, d in zip(state.names, step, strict=True)}
            out.append({**state.values, **moved, **point, name: size})
        return out

    def best_atom(self, base: Trial, found: Scores, named: Scores, singles: Sequence[Trial]) -> Trial | None:
        """The unnamed local change with the largest score, fitted; not one that only says what the best effect says."""
        usable = np.array(found.strength)
        column = named.unit[:, named.best(singles[0].names[0])]
        usable[np.abs(found.unit.T @ column) > SAME] = -np.inf
        if not len(usable) or not usable.max() > 0:
            return None
        name = found.owners[int(np.argmax(usable))]
        first = self._starts(base.state, found, name)[0]
        atom = self.best_of((name,), [first])
        if atom is not None and atom.state.misfit > base.state.misfit:
            # One step may lead too far; the derivative still tells the way.
            atom = self.best_of((name,), [{**base.state.values, name: 0.1 * first[name]}]) or atom
        if atom is not None and singles[0].ln_evidence - atom.ln_evidence < _CLOSE:
            atom = self.trial(atom.names, atom.state.values)
        return atom

    def pairs(self, best: Trial, found: Scores, singles: Sequence[Trial], candidates: Sequence[Effect]) -> list[Trial]:
        """Two effects at a time, best first: the best one with what then stands out, and the runner-up likewise.

        ``found`` are the scores of the other candidates beside the best one.
        """
        tests = [(best, found, PAIRS_OF_BEST)]
        for runner_up in [t for t in singles if t is not best][:1]:
            rest = [e for e in candidates if e.name not in runner_up.names]
            if rest:
                tests.append((runner_up, self._scores(runner_up, rest), PAIRS_OF_NEXT))
        wanted: dict[frozenset[str], list[dict[str, float]]] = {}
        for first, beside, count in tests:
            stands_out = {n: float(beside.strength[beside.best(n)]) for n in dict.fromkeys(beside.owners)}
            others = sorted(stands_out, key=stands_out.__getitem__, reverse=True)
            for name in others[:count]:
                starts = wanted.setdefault(frozenset((first.names[0], name)), [])
                starts += self._starts(first.state, beside, name)[:1]
        out = []
        for key, starts in wanted.items():
            if self.spent():
                break
            names = tuple(e.name for e in candidates if e.name in key)
            self.progress("fitting " + " with ".join(self._by_name[n].title for n in names))
            pair = self.best_of(names, starts)
            if pair is not None:
                out.append(pair)
        out.sort(key=lambda t: -t.ln_evidence)
        if out and not self.spent():
            out[0] = self.trial(out[0].names, out[0].state.values, whole=1)
        return sorted(out, key=lambda t: -t.ln_evidence)

    # -- tests ---------------------------------------------------------------------------------------------------------

    def check(self, trial: Trial, candidates: Sequence[Effect]) -> Check:
        hypotheses, seed = self.hypotheses, self.settings.seed
        named = self._scores(trial, [e for e in candidates if e.name not in trial.names])
        local = self._scores(trial, [a for a in hypotheses.atoms if a.name not in trial.names])
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
        )

    def _scores(self, trial: Trial, candidates: Sequence[Effect]) -> Scores:
        with_grid = {e.name: self.question((*trial.names, e.name)) for e in candidates if e.grid}
        return scores(trial.state, candidates, with_grid)
