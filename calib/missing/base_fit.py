"""Fit of the model as it is, on which every comparison rests: from known points, nested ones and further ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.errors.errors import EvaluationError
from calib.inference.starts import Optima
from calib.missing.candidate_fit import CandidateFit
from calib.missing.linearised_fit import FINE, LinearisedFit
from calib.missing.nearest_integers import nearest_whole
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.problem.prior import Prior
from calib.problem.sampling import sample


def fitted_base(fits: Refits, start: Mapping[str, float] | None, only: bool = False) -> CandidateFit:
    """The base model, fitted from a start, or from the nominal values and from a linear solution, if any.

    A start that is an optimum, such as the fit of a calibration, is the base fit: its search is not repeated, and its
    integers stay. Where derivatives cost evaluations no step is tried from it that promises nothing. Where it rests in
    a valley, `nested` and `from_further_points` lead out of it. Else the best of all counts, from the nominal values
    with the most promising integers; ``only`` leaves these out.
    """
    fits.announce("calibrating the base model")
    fit_problem = fits.fit_problem(())
    found, known = list[CandidateFit](), None
    if start is not None and fits.by_differences and not only:
        known = fits.candidate_fit((), {**fit_problem.space.values, **start}, settings=replace(FINE, iterations=0))
        if known.fit.converged:  # not so where what is uncertain is fitted along
            return known
    if start is not None:
        there = {**fit_problem.space.values, **start}
        shift = Prior.of(fit_problem.space).rows(there, fit_problem.space.free_names)[0]
        before = float(np.sum(fit_problem.residual(there) ** 2) + shift @ shift)
        found = [fits.candidate_fit((), there)]
        if only or not _is_lower(found[0].fit, before):
            # What is known there, such as derivatives, holds for a base fit that is the calibration.
            return (
                found[0] if known is None else replace(known, fit=replace(known.fit, converged=found[0].fit.converged))
            )
    whole = 0 if fits.spent(RULES.early) else 1
    begin = nearest_whole(fit_problem, fit_problem.space.values)
    linear = fits.hypotheses.linear_start((), begin)
    starts = [begin] if linear is None else [linear, begin]
    fits.ahead((((), one) for one in starts), FINE, whole)
    found += [fits.candidate_fit((), one, whole) for one in starts]
    return min(found, key=lambda one: one.fit.misfit)


def nested(fits: Refits, base: CandidateFit, larger: CandidateFit | None) -> CandidateFit:
    """The base model refitted from a model with an effect or a fault, of which it is the case of magnitude 0.

    An effect that explains a misfit begins a fit elsewhere. Where the base fit was trapped, the effect gets the credit
    for what other parameters explain; from its values the base model then reaches them too. The base fit itself where
    that is no better, or where the larger model gained too little to be in another place (`DecisionRules.far`).
    """
    if larger is None or larger.ln_evidence - base.ln_evidence < RULES.far:
        return base
    own = {name for effect in larger.effects for name in effect.names}
    fits.announce("calibrating the base model from the best explanation")
    with fits.allowance.uncharged():
        return _better(fits, base, {name: value for name, value in larger.fit.values.items() if name not in own})


def from_further_points(fits: Refits, base: CandidateFit) -> tuple[CandidateFit, int]:
    """The best of the base fit and of fits from sampled points, and the number of these.

    They end when they agree (`calib.inference.starts.Optima`) on what the base fit had found, with the first better
    one, or after `DecisionRules.base_starts`. Integer parameters keep the values of the base fit.
    """
    fit_problem, ends = fits.fit_problem(()), list[LinearisedFit | None]()
    space = fit_problem.space
    whole = {p.name: base.fit.values[p.name] for p in space.free if p.integer}
    with fits.allowance.uncharged():
        for point in sample(space, RULES.base_starts, fits.settings.seed).points:
            fits.announce("calibrating the base model from further points")
            try:
                found = fits.candidate_fit((), {**space.complete(point), **whole})
                if found.fit.misfit <= RULES.trapped * base.fit.misfit:  # else it is far from anything better
                    found = fits.finished(found)
            except EvaluationError:
                ends.append(None)
                continue
            ends.append(found.fit)
            if _is_better(found, base):
                return found, len(ends)
            if Optima.of([base.fit, *ends]).agree:
                break
    return base, len(ends)


def _better(fits: Refits, base: CandidateFit, start: dict[str, float]) -> CandidateFit:
    try:
        found = fits.finished(fits.candidate_fit((), start))
    except EvaluationError:
        return base
    return found if _is_better(found, base) else base


def _is_better(found: CandidateFit, base: CandidateFit) -> bool:
    return _is_lower(found.fit, base.fit.misfit)


def _is_lower(found: LinearisedFit, before: float) -> bool:
    """Whether a fit lowers a sum of squares by more than a step that is not taken any more may promise.

    And by `DecisionRules.rebased`, or so many times the mean square that was left.
    """
    unit = max(before / max(len(found.residual), 1), 1.0)
    return found.misfit < before - max(RULES.rebased * unit, FINE.relative * before)
