"""Refits of single effects from the nominal values, for a base fit that is a poor starting point."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.errors.errors import EvaluationError
from calib.missing.adequacy import suspects
from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.linearised_fit import LinearisedFit, linearised
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.problem.candidate import Candidate

_Start = tuple[float, str, dict[str, float]]


def led_astray(base: CandidateFit, adequacy: AdequacyTests) -> bool:
    """Whether the base fit may be far from the true parameters.

    It is when a parameter is pulled further than a correctly specified model needs (`plausible.parameter_pulls`) or
    when the base model is strongly rejected.
    """
    strongest = float(max(adequacy.named.magnitude, default=0.0))
    return bool(base.implausible) or strongest > RULES.rejected or adequacy.p_fit < RULES.rejected_fit


def restarted(
    fits: Refits, base: CandidateFit, singles: Sequence[CandidateFit], effects: Sequence[Candidate]
) -> list[CandidateFit]:
    """Fit single effects from the nominal values with every magnitude of their grid; best first.

    Where the data have a linear start (FRFs), each effect is started from its own as well: at the nominal values
    resonances may be off by more than their width, so that no first-order prediction tells which effect is promising.
    Starts are ranked by the sum of squares left after a first-order update of the parameters. The most promising ones
    are fitted, and integer parameters are chosen again for the best fit. A fit replaces an earlier one of the same
    effect only if its sum of squares is smaller. Where all of them leave a multiple of the rows, every start is trapped
    or the effect is not listed: the further starts are then fitted too, within a budget of their own, until one is not.
    """
    fits.announce("fitting from the nominal values too")
    own = replace(fits, settings=replace(fits.settings, budget=RULES.anew * fits.settings.budget))
    best = {t.names[0]: t for t in singles}
    try:
        starts = _starts(own, effects)
    except EvaluationError:
        return list(singles)
    tried, kept = Counter[str](), list[_Start]()
    for start in starts:
        if own.spent() or tried[start[1]] >= RULES.starts_anew:
            kept.append(start)
        else:
            tried[start[1]] += 1
            _fitted(own, base, start, best)
    kept = [start for start in kept if start[2][start[1]] != 0]  # the base model, from the nominal values
    if kept and trapped(best.values()):
        further = replace(fits, settings=replace(fits.settings, budget=RULES.anew_further * fits.settings.budget))
        for start in kept:
            if further.spent() or not trapped(best.values()):
                break
            _fitted(further, base, start, best)
    if not best:
        return []
    first = max(best.values(), key=lambda t: t.ln_evidence)
    if not any(first is t for t in singles):
        first = own.followed(first, whole=2)
        best[first.names[0]] = own.moved(first) or first
    return sorted(best.values(), key=lambda t: (-t.ln_evidence, t.names))


def _fitted(fits: Refits, base: CandidateFit, start: _Start, best: dict[str, CandidateFit]) -> None:
    """Fit an effect from a start; the fit replaces an earlier one where its sum of squares is smaller."""
    _, name, values = start
    fits.announce(f"fitting {fits.by_name[name].title}")
    refit = fits.best_of((name,), [values], base)
    if refit is not None and (name not in best or refit.fit.misfit < best[name].fit.misfit):
        best[name] = refit


def trapped(fits: Iterable[CandidateFit]) -> bool:
    """Whether every fit leaves far more than errors of the size that is stated."""
    return all(t.fit.misfit > RULES.trapped * len(t.fit.residual) for t in fits)


def restarted_first(fits: Refits, base: CandidateFit, effects: Sequence[Candidate]) -> list[CandidateFit]:
    """The same before any effect is fitted beside the base fit, where that leaves a multiple of the rows.

    Nothing that is fitted from such a point tells much. Empty where the base fit is not trapped; not charged, as refits
    from the nominal values have their own budget.
    """
    if not trapped((base,)):
        return []
    with fits.allowance.uncharged():
        return restarted(fits, base, (), effects)


def better_of(one: Sequence[CandidateFit], other: Sequence[CandidateFit]) -> list[CandidateFit]:
    """The better fit of every effect, of two lists of single effects; best first."""
    best: dict[str, CandidateFit] = {}
    for t in (*one, *other):
        best[t.names[0]] = min(t, best.get(t.names[0], t), key=lambda own: own.fit.misfit)
    return sorted(best.values(), key=lambda t: (-t.ln_evidence, t.names))


def restarted_faults(fits: Refits, base: CandidateFit, faults: Sequence[CandidateFit]) -> tuple[CandidateFit, ...]:
    """Fit faults of the measurement from the nominal values too, as effects are; best first.

    A gross fault drags the base fit with it: a channel of the wrong sign is then fitted among parameters that have
    gone along with it, and looks implausible. Those fitted before and those with the largest scores at the nominal
    values are tried, where derivatives cost evaluations without exchanges that make the sum of squares larger there; a
    fit replaces an earlier one only if its sum of squares is smaller.
    """
    h, best = fits.hypotheses, {t.names[0]: t for t in faults}
    if not h.faults:
        return tuple(faults)
    fits.announce("fitting measurement errors from the nominal values too")
    fit_problem = fits.fit_problem(())
    try:
        nominal = linearised(fit_problem, (), fit_problem.space.values)
        found = suspects(fits, replace(base, fit=nominal), tuple(best))
    except EvaluationError:
        return tuple(faults)
    known = [name for name in best if name in found.owners]
    tried = list(dict.fromkeys((*known, *(found.owners[k] for k in fits.family.promising(found)))))
    fits.ahead((((n,), start) for n in tried for start in fits.starts(nominal, found, n)), charged=False)
    for name in tried:
        if fits.by_differences and not _may_be_whole(fits, nominal, name):
            continue
        refit = fits.best_of((name,), fits.starts(nominal, found, name), base, fits.columns(nominal, found, name))
        if refit is not None and (name not in best or refit.fit.misfit < best[name].fit.misfit):
            best[name] = refit
    ranked = fits.settled(tuple(best.values()), RULES.credible)
    # Integers that the base fit chose with the fault in its data may be others without it.
    return tuple([fits.moved(ranked[0]) or ranked[0], *ranked[1:]]) if ranked else ()


def _may_be_whole(fits: Refits, nominal: LinearisedFit, name: str) -> bool:
    """Whether a fault lowers the sum of squares at the nominal values where it is there wholly, if it is one of those.

    That needs no run of the model; a fit does, and one that ends at a part of such a fault tells nothing.
    """
    if not fits.by_name[name].whole:
        return True
    try:
        residual = fits.fit_problem((name,)).residual({**nominal.values, name: 1.0})
    except EvaluationError:
        return False
    return float(residual @ residual) < float(nominal.residual @ nominal.residual)


def _starts(fits: Refits, effects: Sequence[Candidate]) -> list[_Start]:
    """Predicted sum of squares, effect and start of the most promising effects at the nominal values; best first."""
    fit_problem = fits.fit_problem(())
    nominal = linearised(fit_problem, (), fit_problem.space.values)
    found = fits.scores(nominal, effects)
    by_name = {e.name: e for e in effects}
    out: list[_Start] = []
    for k, name in enumerate(found.owners):
        effect, point, size = by_name[name], dict(found.points[k]), float(found.size[k])
        if not point:
            p, step = effect.magnitude, float(found.z[k]) / size if size > 0 else 0.0
            point = {name: min(max(step, p.lower), p.upper)}
        out.append(_start(nominal, effect, point, nominal.residual - found.raw[:, k] * point[name]))
    order = list(dict.fromkeys(name for _, name, _ in sorted(out, key=lambda s: s[:2])))[: fits.settings.refits]
    out = [start for start in out if start[1] in order]
    sign = {
        e.name: -1.0 if e.signed and found.z[found.best(e.name)] < 0 else 1.0 for e in effects if e.name in found.owners
    }
    for name in order:
        fits.announce("")
        if not by_name[name].grid and not fits.spent():
            out += _at_magnitudes(fits, nominal, by_name[name], sign[name])
    for name, side in sign.items():
        fits.announce("")
        if not fits.spent():
            effect = by_name[name]
            point = dict(found.points[found.best(name)]) or {name: side * effect.plausible}
            out += _linear(fits, nominal, effect, point)
    return sorted(out, key=lambda s: s[:2])


def _linear(fits: Refits, nominal: LinearisedFit, effect: Candidate, point: Mapping[str, float]) -> Iterator[_Start]:
    """The linear start of a model with an effect, about a point of it; nothing where the data have none."""
    start = fits.hypotheses.linear_start((effect.name,), {**nominal.values, **point})
    if start is None:
        return
    try:
        there = linearised(fits.fit_problem((effect.name,)), (effect.name,), start)
    except EvaluationError:
        return
    predicted = there.relinearised({}, there.residual).misfit
    yield predicted if math.isfinite(predicted) else math.inf, effect.name, start


def _at_magnitudes(fits: Refits, nominal: LinearisedFit, effect: Candidate, sign: float) -> Iterator[_Start]:
    """Starts of an effect without a grid, evaluated by the model itself."""
    fit_problem, p = fits.fit_problem((effect.name,)), effect.magnitude
    for part in RULES.magnitudes:
        point = {effect.name: sign * part * effect.plausible}
        if p.lower <= point[effect.name] <= p.upper:
            try:
                residual = fit_problem.residual({**nominal.values, **point})
            except EvaluationError:
                continue
            yield _start(nominal, effect, point, residual)


def _start(nominal: LinearisedFit, effect: Candidate, point: Mapping[str, float], residual: np.ndarray) -> _Start:
    """A start with the sum of squares predicted from it."""
    linear = nominal.relinearised(point, residual)
    predicted = linear.misfit + (point[effect.name] / effect.plausible) ** 2
    return predicted if math.isfinite(predicted) else math.inf, effect.name, {**nominal.values, **point}
