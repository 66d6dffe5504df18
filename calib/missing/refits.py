"""Fits of a model with effects: choice of candidates, starts and refinement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, takewhile
from types import MappingProxyType

import numpy as np

from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress
from calib.inference.gauss_newton import FitSettings
from calib.missing.candidate_fit import CandidateFit
from calib.missing.evidence import ln_evidence
from calib.missing.fault_family import FaultFamily
from calib.missing.hypotheses import Altered, FitProblem, Hypotheses
from calib.missing.linearised_fit import (
    FINE,
    ROUGH,
    LinearisedFit,
    grown,
    least_squares_fit,
)
from calib.missing.nearest_integers import nearest_whole, other_whole
from calib.missing.partners import pairing_points
from calib.missing.plausible import implausible
from calib.missing.rules import RULES
from calib.missing.score import Scores, scores
from calib.missing.settings import Allowance, Settings
from calib.problem.candidate import Candidate
from calib.problem.shared_points import run_shared


def near_to(reached: float) -> float:
    """Log evidence below the best within which a fit is refined, when the best has gained ``reached``."""
    return max(RULES.close, RULES.nearly * reached)


@dataclass(frozen=True, eq=False)
class Refits:
    """Fits with one factor on the standard deviation.

    Attributes
    ----------
    hypotheses : Hypotheses
    settings : Settings
    scale : float
        Factor on the standard deviation.
    progress : callable
        Receives a description of the current step.
    granted : tuple of Candidate
        Faults of the measurement whose magnitudes are among the parameters of the base model.
    allowance : Allowance
        The evaluation budget; other settings or another scale have their own.
    """

    hypotheses: Hypotheses
    settings: Settings
    scale: float
    progress: Progress
    granted: tuple[Candidate, ...] = ()
    allowance: Allowance = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "allowance", Allowance(self.hypotheses, self.settings.budget, RULES.beyond * self.settings.budget)
        )

    def with_granted(self, fault: Candidate) -> Refits:
        """The same with a fault of the measurement in the base model, and a budget of its own."""
        return replace(self, hypotheses=self.hypotheses.granting((fault.name,)), granted=(*self.granted, fault))

    @cached_property
    def by_name(self) -> Mapping[str, Candidate]:
        """Effects, local perturbations and faults of the measurement."""
        h = self.hypotheses
        return {e.name: e for e in (*h.effects, *h.perturbations, *h.faults)}

    @cached_property
    def family(self) -> FaultFamily:
        """Faults of the measurement that may be named."""
        return FaultFamily(tuple(self.hypotheses.faults))

    def fit_problem(self, names: tuple[str, ...]) -> FitProblem:
        """The model with the named effects or local perturbations against the measurement."""
        return Altered(self.hypotheses.fit_problem(names), self.scale)

    def spent(self, part: float = 1.0) -> bool:
        """Whether that part of the budget is used up; then only the fits that the verdict needs are made."""
        return self.allowance.spent(part)

    def scores(self, fit: LinearisedFit, candidates: Sequence[Candidate]) -> Scores:
        """Scores of candidates that a model lacks, of effects also where they pair more modes; this is not charged."""

        def fit_problem(name: str) -> FitProblem:
            return self.fit_problem((*fit.effects, name))

        fit = fit.granting([fault.name for fault in self.granted])
        library = {e.name for e in self.hypotheses.effects}
        effects = [e for e in candidates if e.name in library]
        with self.allowance.uncharged():
            pairing = pairing_points(self.hypotheses, fit, effects, fit_problem)
        problems = {e.name: fit_problem(e.name) for e in candidates if e.grid or e.name in pairing}
        return scores(fit, candidates, problems, pairing)

    # -- fits ----------------------------------------------------------------------------------------------------------

    def candidate_fit(
        self, names: tuple[str, ...], start: dict[str, float], whole: int = 0, settings: FitSettings = FINE,
        columns: Mapping[str, np.ndarray] = MappingProxyType({}), exact: bool = False,
    ) -> CandidateFit:  # fmt: skip
        """The model with the named effects or local perturbations, fitted from a start by `least_squares_fit`."""
        problem, limited = self.fit_problem(names), self.affordable(settings)
        return self._candidate_fit(
            names, least_squares_fit(problem, names, start, whole, limited, self._step, columns, exact)
        )

    def ahead(
        self, wanted: Iterable[tuple[tuple[str, ...], dict[str, float]]], settings: FitSettings = ROUGH, whole: int = 0,
        charged: bool = True,
    ) -> None:  # fmt: skip
        """Fits that are about to be asked for, as effects and start: all processes make what the budget allows."""
        most, limited = self.allowance.remaining / (ROUGH.iterations + 1), self.affordable(settings)
        some = islice(wanted, int(max(most, 0))) if charged and math.isfinite(most) else wanted
        requests = ((self.fit_problem(names), names, start, whole, limited) for names, start in some)
        run_shared(least_squares_fit, requests, self._step)

    def announce(self, stage: str) -> None:
        """Tell the present step, with the part of the budget that is used, where there is one."""
        used, most = max(self.allowance.used, 0), self.allowance.most
        self.progress(stage, used, max(most, used) if math.isfinite(most) else 0)

    def _step(self, share: float) -> None:
        self.announce("")

    def affordable(self, settings: FitSettings) -> FitSettings:
        """Fit settings limited to the evaluations left in the budget, but no fewer than the verdict needs."""
        return replace(
            settings, evaluations=min(settings.evaluations, max(self.allowance.remaining, RULES.least_residuals))
        )

    def best_of(
        self, names: tuple[str, ...], starts: Sequence[dict[str, float]], parent: CandidateFit,
        columns: Mapping[str, np.ndarray] = MappingProxyType({}),
    ) -> CandidateFit | None:  # fmt: skip
        """The best fit from some starts, never worse than that of the parent, a model with fewer effects.

        A full step may go too far and change the pairing of modes; smaller steps along the same direction are then
        tried. The optimum of the parent, with zero magnitude of the further effects, is the last resort. None when no
        start can be evaluated. ``columns`` are about those of the slope at the starts, see `columns`.
        """
        fits: list[CandidateFit] = []
        still = {name: self.by_name[name].magnitude.value for name in names}

        def follow(start: dict[str, float]) -> None:
            at = self.by_differences and all(start.get(name) == value for name, value in still.items())
            try:
                fits.append(self.candidate_fit(names, start, settings=ROUGH, columns=columns, exact=at))
            except EvaluationError:
                return

        def best() -> CandidateFit:
            return min(fits, key=lambda t: t.fit.misfit)

        for start in starts:
            follow(start)
        if not fits:
            return None
        magnitudes = [n for n in names if n not in parent.names]
        for part in RULES.smaller_steps:
            if best().fit.misfit <= parent.fit.misfit or self.spent():
                break
            follow({**starts[0], **parent.fit.values, **{n: part * starts[0][n] for n in magnitudes}})
        return best() if best().fit.misfit <= parent.fit.misfit else self.grown(names, parent)

    def without(self, model: CandidateFit, effect: Candidate, base: CandidateFit) -> CandidateFit | None:
        """A model refitted without one of its effects, from its values; None where that cannot be evaluated."""
        if not (remaining := tuple(name for name in model.names if name != effect.name)):
            return base
        self.announce(f"leaving out {effect.title}")
        return self.best_of(remaining, [_values_without(model, effect)], base)

    def without_each(
        self, model: CandidateFit, effects: Sequence[Candidate], base: CandidateFit
    ) -> Iterator[CandidateFit | None]:
        """`without` each of some effects."""
        smaller = [(tuple(n for n in model.names if n != e.name), _values_without(model, e)) for e in effects]
        self.ahead(one for one in smaller if one[0])
        return (self.without(model, effect, base) for effect in effects)

    def grown(self, names: tuple[str, ...], parent: CandidateFit) -> CandidateFit:
        """The optimum of a model with fewer effects, with zero magnitude of the further ones."""
        return self._candidate_fit(names, grown(parent.fit, self.fit_problem(names), names))

    def followed(self, candidate_fit: CandidateFit, whole: int = 0, settings: FitSettings = FINE) -> CandidateFit:
        """Refine a fit; the fit itself where that does not lower the sum of squares."""
        fit = candidate_fit.fit
        further = self.candidate_fit(candidate_fit.names, fit.values, whole, settings, fit.columns, fit.converged)
        return further if further.fit.misfit <= candidate_fit.fit.misfit else candidate_fit

    def _candidate_fit(self, names: tuple[str, ...], fit: LinearisedFit) -> CandidateFit:
        effects = tuple(self.by_name[n] for n in names)
        added, errors = (*effects, *self.granted), self.hypotheses.shared_errors / self.scale
        fit = replace(fit, shared=np.pad(errors, ((0, len(fit.data_slope) - len(errors)), (0, 0))))
        return CandidateFit(effects, fit, ln_evidence(fit, added) - self.family.price(names), implausible(fit, added))

    @property
    def by_differences(self) -> bool:
        """Whether derivatives cost evaluations of the model."""
        return bool(getattr(self.fit_problem(()), "by_differences", False))

    def columns(self, fit: LinearisedFit, found: Scores, name: str) -> dict[str, np.ndarray]:
        """Columns of the slope of a fitted model with a further effect, from its signature there, (n_rows,) each."""
        return fit.columns | {name: found.raw[:, found.best(name)]}

    def starts(self, fit: LinearisedFit, found: Scores, name: str) -> list[dict[str, float]]:
        """Starts for the fit of an effect: one step from a fit, for the best points of its grid.

        Where derivatives cost evaluations it starts at that fit, where they are known, and takes the step itself.
        """
        effect, out = self.by_name[name], []
        if self.by_differences and (name,) == effect.names and not any(found.points[k] for k in found.of(name)):
            return [{**fit.values, name: effect.magnitude.value}]
        for k in found.steps(name, 2 if effect.nuisance else 1):
            p, point = effect.magnitude, found.points[k]
            size = found.z[k] / found.size[k] if found.size[k] > 0 else 0.0
            least = 0.1 * abs(point[name]) if point else p.lower
            size = min(max(size, least, p.lower), p.upper)
            step = fit.update(-found.raw[:, k] * size)
            moved = {n: fit.values[n] + d for n, d in zip(fit.names, step, strict=True)}
            out.append({**fit.values, **moved, **point, name: size})
        linear = self.hypotheses.linear_start((*fit.effects, name), out[0])
        return out if linear is None else [*out, linear]

    def fault(self, base: CandidateFit, found: Scores, best: CandidateFit) -> CandidateFit | None:
        """Fit of the measurement fault with the largest score; None where it comes nowhere near the best effect.

        A fault collinear with that effect counts too: then the data cannot tell whether model or measurement is wrong.
        The verdict needs it, so that it is fitted whatever has been spent.
        """
        usable = np.where([self.by_name[n].of_measurement for n in found.owners], found.magnitude, -np.inf)
        reached = best.ln_evidence - base.ln_evidence
        if not usable.size or usable.max() <= 0:
            return None
        if reached - usable.max() ** 2 / 2 > near_to(reached):
            return None
        return self.local(found.owners[int(np.argmax(usable))], base, found, best)

    def faults(self, base: CandidateFit, found: Scores, best: CandidateFit) -> tuple[CandidateFit, ...]:
        """Fits of the faults of the measurement with the largest scores, best first.

        Like `fault`, only those that come near the best effect, and at most `DecisionRules.blamed` that are predicted
        to explain about equally well. Fits of faults are not charged: they need no further model.
        """
        predicted, order = self.family.predicted(found), self.family.promising(found)
        reached = best.ln_evidence - base.ln_evidence

        def too_small(k: int) -> bool:
            gain, largest = float(predicted[k]), float(predicted[order[0]])
            return gain <= 0 or reached - gain > near_to(reached) or largest - gain > RULES.close

        able = list(takewhile(lambda k: not too_small(k), order))
        out = list[CandidateFit]()
        with self.allowance.uncharged():
            names = [found.owners[k] for k in able]
            self.ahead((((*base.names, n), self.starts(base.fit, found, n)[0]) for n in names), charged=False)
            for k in able:
                self.announce(f"fitting {self.by_name[found.owners[k]].title}")
                fit = self.local(found.owners[k], base, found, best)
                out += [] if fit is None else [fit]
        return tuple(sorted(out, key=lambda t: -t.ln_evidence))

    def local(self, name: str, base: CandidateFit, found: Scores, best: CandidateFit) -> CandidateFit | None:
        """Fit of one local perturbation, refined where it comes near the best effect."""
        starts, columns = self.starts(base.fit, found, name)[:1], self.columns(base.fit, found, name)
        perturbation = self.best_of((*base.names, name), starts, base, columns)
        if self.spent() or perturbation is None:
            return perturbation
        gained = perturbation.fit.misfit < base.fit.misfit
        if self.by_differences and (perturbation.fit.converged or not gained):
            return perturbation  # each further step costs runs
        if best.ln_evidence - perturbation.ln_evidence < RULES.close:
            perturbation = self.followed(perturbation)
        return perturbation

    def moved(self, candidate_fit: CandidateFit) -> CandidateFit | None:
        """Refit of the same effects with integers chosen again; None when that is no better.

        Without the effects, the base model may have settled on other integers, and its other parameters with them.
        """
        fit_problem, best = self.fit_problem(candidate_fit.names), candidate_fit
        whole = [p.name for p in fit_problem.space.free if p.integer]
        if not self.spent(RULES.late):
            own = {n for e in best.effects for n in e.names} | set(whole)
            nominal = fit_problem.space.values
            start = nearest_whole(fit_problem, {n: best.fit.values[n] if n in own else v for n, v in nominal.items()})
            if any(start[name] != best.fit.values[name] for name in whole):
                best = self._better(best, [start])
        best = self.beside_whole(best)
        return None if best is candidate_fit else best

    def settled(self, fits: Sequence[CandidateFit], margin: float) -> list[CandidateFit]:
        """Fits sorted by evidence, of which those within a margin of the best are `finished`."""
        out, tried = sorted(fits, key=lambda t: -t.ln_evidence), set[tuple[str, ...]]()
        unconverged = [t for t in out if t.ln_evidence >= out[0].ln_evidence - margin and not t.fit.converged]
        with self.allowance.continuing():
            self.ahead(((t.names, t.fit.values) for t in unconverged), FINE)
        while True:
            near = (t for t in out if t.ln_evidence >= out[0].ln_evidence - margin)
            first = next((t for t in near if not t.fit.converged and t.names not in tried), None)
            if first is None:
                return out
            tried.add(first.names)
            finished = self.finished(first)
            out = sorted((finished if t is first else t for t in out), key=lambda t: -t.ln_evidence)

    def finished(self, candidate_fit: CandidateFit) -> CandidateFit:
        """The fit continued, a few times, until it converges: many parameters need more than its first iterations.

        As a verdict rests on it, it is charged to what may be spent beyond the budget.
        """
        best = candidate_fit
        with self.allowance.continuing():
            for _ in range(RULES.continued):
                if best.fit.converged or self.allowance.remaining <= 0:
                    break
                further = self.followed(best)
                if further is best:
                    break
                best = further
        return best

    def beside_whole(self, candidate_fit: CandidateFit) -> CandidateFit:
        """The best of the fits with integers nearby, each at most one off, until none is better.

        Better is by more than `DecisionRules.worth`. They are fitted: where residuals turn sharply, such as near
        resonances, one step predicts the integers badly. As the answer depends on them, they
        are charged to what may be spent beyond the budget.
        """
        best = candidate_fit
        with self.allowance.continuing():
            for _ in range(RULES.walk):
                if self.allowance.remaining <= 0:
                    break
                values = best.fit.values
                others = other_whole(self.fit_problem(best.names), values)
                better = self._better(best, [{**values, **other} for other in others])
                if better is best:
                    break
                best = better
        return best

    def _better(self, best: CandidateFit, starts: Sequence[dict[str, float]]) -> CandidateFit:
        """The fit of the same effects from the most promising start, or the best one where it is not beaten."""
        rough = []
        self.ahead((best.names, start) for start in starts)
        for start in starts:
            with suppress(EvaluationError):
                rough.append(self.candidate_fit(best.names, start, settings=ROUGH))
        found = min(rough, key=lambda one: one.fit.misfit, default=best)
        if found is best or found.fit.misfit > RULES.hopeless * best.fit.misfit:
            return best
        found = self.candidate_fit(best.names, found.fit.values)
        return found if found.fit.misfit < best.fit.misfit - RULES.worth else best


def _values_without(model: CandidateFit, effect: Candidate) -> dict[str, float]:
    return {name: value for name, value in model.fit.values.items() if name not in effect.names}
