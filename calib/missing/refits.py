"""Fits of a model with effects: which are tried, from where, and how far each is followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.inference.gauss_newton import FitSettings
from calib.missing.alike import Group
from calib.missing.allowance import Allowance
from calib.missing.evidence import ln_bayes_linear, ln_evidence
from calib.missing.findings import Trial
from calib.missing.hypotheses import Altered, Hypotheses, Question
from calib.missing.partners import pairing_points
from calib.missing.plausible import implausible
from calib.missing.rules import RULES
from calib.missing.score import Scores, scores
from calib.missing.state import FINE, ROUGH, State, fitted, grown, nearest_whole

EARLY, LATE = 0.7, 0.85
"""Parts of the budget: for single effects; for looking where whole numbers may have been led astray."""


def near_to(reached: float) -> float:
    """How far below the best what is fitted to the end may be, that having gained so much log evidence."""
    return max(RULES.close, RULES.nearly * reached)


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
        Correlation of fingerprints from which two effects are one group, unless the signal tells them apart.
    seed : int
        Of the draws behind family-wise probabilities.
    budget : float
        Model evaluations after which no further effect or pair of effects is tried; for each decision its own.
    """

    alpha: float = 0.01
    refits: int = 6
    merge: float = 0.98
    seed: int = 1
    budget: float = 115.0


DEFAULT = Settings()


@dataclass(frozen=True, eq=False)
class Refits:
    """Fits with one scale of the scatter.

    Attributes
    ----------
    hypotheses : Hypotheses
    settings : Settings
    scale : float
        Factor on the scatter.
    progress : callable
        Is told in words what is being done.
    allowance : Allowance
        The budget, which is its own: other settings or another scale begin another one.
    """

    hypotheses: Hypotheses
    settings: Settings
    scale: float
    progress: Progress
    allowance: Allowance = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "allowance", Allowance(self.hypotheses, self.settings.budget))

    @cached_property
    def by_name(self) -> Mapping[str, Effect]:
        """Effects and local changes."""
        return {e.name: e for e in (*self.hypotheses.effects, *self.hypotheses.atoms)}

    def question(self, names: tuple[str, ...]) -> Question:
        """The model with the named effects or local changes against the measurement."""
        return Altered(self.hypotheses.question(names), self.scale)

    def spent(self, part: float = 1.0) -> bool:
        """Whether that part of the budget is used up, so that only what the verdict needs is still solved."""
        return self.allowance.spent(part)

    def scores(self, state: State, candidates: Sequence[Effect]) -> Scores:
        """Scores of candidates that a model does not have; effects are also asked where they pair more modes.

        What each effect pairs is asked over decades of strength and charged to nothing: the budget is for fits.
        """

        def question(name: str) -> Question:
            return self.question((*state.effects, name))

        library = {e.name for e in self.hypotheses.effects}
        effects = [e for e in candidates if e.name in library]
        with self.allowance.uncharged():
            pairing = pairing_points(self.hypotheses, state, effects, question)
        asked = {e.name: question(e.name) for e in candidates if e.grid or e.name in pairing}
        return scores(state, candidates, asked, pairing)

    # -- fits ----------------------------------------------------------------------------------------------------------

    def trial(
        self, names: tuple[str, ...], start: dict[str, float], whole: int = 0, settings: FitSettings = FINE
    ) -> Trial:
        """The model with the named effects or local changes, fitted from a start; see `calib.missing.state.fitted`."""
        return self._judged(names, fitted(self.question(names), names, start, whole, self.affordable(settings)))

    def affordable(self, settings: FitSettings) -> FitSettings:
        """The same with no more residuals than the budget leaves, but as many as the verdict needs."""
        return replace(settings, evaluations=min(settings.evaluations, max(self.allowance.left, RULES.least_residuals)))

    def singles(
        self,
        base: Trial,
        groups: Sequence[Group],
        named: Scores,
        starts: dict[tuple[str, ...], dict[str, float]],
    ) -> list[Trial]:
        """The most promising effects, fitted, and those that look the same as what fits well; best first."""
        plausible = np.array([self.by_name[n].plausible for n in named.owners])
        promise = ln_bayes_linear(named.strength, named.size, plausible)
        by_effect = {g.effect.name: max(promise[k] for k, n in enumerate(named.owners) if n in g.names) for g in groups}
        order = sorted(by_effect, key=lambda n: (-by_effect[n], n))[: self.settings.refits]
        out: list[Trial] = []
        for name in order:
            if len(out) > 1 and self.spent(EARLY):
                break
            reached = max((t.ln_evidence - base.ln_evidence for t in out), default=0.0)
            if reached > RULES.far and by_effect[name] < reached / 4 and (name,) not in starts:
                continue  # it promises next to nothing of what another one has done already
            found = self._single(base, named, name, starts)
            if found is not None:
                out.append(found)
        if not out:
            raise EvaluationError("no effect could be fitted")
        out.sort(key=lambda t: -t.ln_evidence)
        reached = out[0].ln_evidence - base.ln_evidence
        near = near_to(reached)
        alike = {g.effect.name: g.others for g in groups}
        for one in tuple(out):
            close = out[0].ln_evidence - one.ln_evidence < near
            for rival in alike[one.names[0]] if close and not self.spent() else ():
                found = self._single(base, named, rival.name, starts)
                out += [] if found is None else [found]
        out.sort(key=lambda t: -t.ln_evidence)
        # Places of whole-number parameters may have followed what was missing: the best are allowed to move them back.
        reached = out[0].ln_evidence - base.ln_evidence
        near = near_to(reached)
        for k, one in enumerate(out[: RULES.polished]):
            close = reached > RULES.credible and out[0].ln_evidence - one.ln_evidence < near
            if close and not self.spent(EARLY if k else 1.0):
                out[k] = self.followed(one, whole=1)
        return sorted(out, key=lambda t: -t.ln_evidence)

    def _single(
        self, base: Trial, named: Scores, name: str, starts: dict[tuple[str, ...], dict[str, float]]
    ) -> Trial | None:
        """One effect, fitted from where it was fitted before, or one step from the base model."""
        self.progress(f"fitting {self.by_name[name].title}")
        known = [starts[(name,)]] if (name,) in starts else None
        return self.best_of((name,), known or self.starts(base.state, named, name), base)

    def best_of(self, names: tuple[str, ...], starts: Sequence[dict[str, float]], parent: Trial) -> Trial | None:
        """The best fit from some starts, never above that of the parent, a model with fewer effects.

        One step may lead too far, where other modes are paired; the derivative still tells the way, so that smaller
        steps are tried. The parent's optimum with none of the further effects is a fit of the larger model too. None
        when no start can be evaluated.
        """
        fits: list[Trial] = []

        def follow(start: dict[str, float]) -> None:
            try:
                fits.append(self.trial(names, start, settings=ROUGH))
            except EvaluationError:
                return

        def best() -> Trial:
            return min(fits, key=lambda t: t.state.misfit)

        for start in starts:
            follow(start)
        if not fits:
            return None
        strengths = [n for n in names if n not in parent.names]
        for part in RULES.smaller_steps:
            if best().state.misfit <= parent.state.misfit or self.spent():
                break
            follow({**starts[0], **parent.state.values, **{n: part * starts[0][n] for n in strengths}})
        if best().state.misfit <= parent.state.misfit:
            return best()
        return self._judged(names, grown(parent.state, self.question(names), names))

    def followed(self, trial: Trial, whole: int = 0, settings: FitSettings = FINE) -> Trial:
        """A fit, followed further; itself where that leads no lower."""
        further = self.trial(trial.names, trial.state.values, whole, settings)
        return further if further.state.misfit <= trial.state.misfit else trial

    def _judged(self, names: tuple[str, ...], state: State) -> Trial:
        effects = tuple(self.by_name[n] for n in names)
        return Trial(effects, state, ln_evidence(state, effects), implausible(state, effects))

    def starts(self, state: State, found: Scores, name: str) -> list[dict[str, float]]:
        """Where to start the fit of an effect: one step from the state, of the best points of its grid."""
        effect, out = self.by_name[name], []
        for k in found.steps(name, 2 if effect.nuisance else 1):
            p, point = effect.strength, found.points[k]
            size = found.z[k] / found.size[k] if found.size[k] > 0 else 0.0
            least = 0.1 * abs(point[name]) if point else p.lower
            size = min(max(size, least, p.lower), p.upper)
            step = state.follow(-found.raw[:, k] * size)
            moved = {n: state.values[n] + d for n, d in zip(state.names, step, strict=True)}
            out.append({**state.values, **moved, **point, name: size})
        return out

    def best_atom(self, base: Trial, found: Scores, named: Scores, best: Trial) -> Trial | None:
        """The unnamed local change with the largest score, fitted; not one that only says what the best effect says.

        ``best`` is the base model where there is no effect.

        A change of a part comes before something added at a sensor: that must fit clearly better.
        """
        usable = np.array(found.strength)
        if best.names:
            column = named.unit[:, named.best(best.names[0])]
            usable[np.abs(found.unit.T @ column) > RULES.same] = -np.inf
        scales = np.array([bool(self.by_name[n].part) for n in found.owners], dtype=bool)
        part, other = (
            int(np.argmax(np.where(own, usable, -np.inf))) if own.any() else None for own in (scales, ~scales)
        )
        first, second = (
            0.0 if k is None else max(float(usable[k]), 0.0) ** 2 / 2 for k in (part, other)
        )  # fmt: skip
        atom = None
        if part is not None and first > 0:
            atom = self._local(found.owners[part], base, found, best)
        clearly = second > first + RULES.credible and not (atom is not None and self.spent())
        if other is not None and (clearly or (atom is None and second > 0)):
            rival = self._local(found.owners[other], base, found, best)
            if rival is not None and (atom is None or rival.ln_evidence > atom.ln_evidence + RULES.credible):
                return rival
        return atom

    def fault(self, base: Trial, found: Scores, best: Trial) -> Trial | None:
        """The fault of the measurement of the largest score, fitted; None where it comes nowhere near the best effect.

        It counts even where it says what that effect says: then nobody can tell whether model or measurement is wrong.
        The verdict needs it, so that it is fitted whatever has been spent.
        """
        usable = np.where([self.by_name[n].of_measurement for n in found.owners], found.strength, -np.inf)
        reached = best.ln_evidence - base.ln_evidence
        if not usable.size or usable.max() <= 0:
            return None
        if reached - usable.max() ** 2 / 2 > near_to(reached):
            return None
        return self._local(found.owners[int(np.argmax(usable))], base, found, best)

    def _local(self, name: str, base: Trial, found: Scores, best: Trial) -> Trial | None:
        """One local change fitted, to the end where it comes near the best effect."""
        first = self.starts(base.state, found, name)[0]
        atom = self.best_of((name,), [first], base)
        if self.spent():
            return atom
        if atom is not None and best.ln_evidence - atom.ln_evidence < RULES.close:
            atom = self.followed(atom)
        return atom

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
        found = self.trial(trial.names, start, settings=ROUGH)
        if found.state.misfit > RULES.hopeless * trial.state.misfit:
            return None
        found = self.trial(trial.names, found.state.values)
        return found if found.state.misfit < trial.state.misfit else None
