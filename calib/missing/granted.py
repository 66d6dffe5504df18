"""Effects and faults of the measurement together: a fault that stands out is granted, and all is decided anew."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np

from calib.errors.errors import EvaluationError
from calib.missing.blame import alike, alike_faults, outweighs
from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.explanation import NAMED, Explanation
from calib.missing.goodness import overall_p
from calib.missing.linearised_fit import FINE
from calib.missing.place import takes_enough
from calib.missing.plausible import has_possible_size, is_whole
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores, scores
from calib.problem.candidate import Candidate

_SPENT = 1e-3
"""Part of a change pattern that others leave, below which nothing is left of it."""

Again = Callable[[Refits, Mapping[str, float]], Explanation]
"""The decision with other hypotheses, from given values of the base model."""


def with_fault(
    fits: Refits,
    found: Explanation,
    singles: Sequence[CandidateFit],
    best: CandidateFit | None,
    tests: AdequacyTests | None,
    again: Again,
) -> Explanation | None:
    """Explanation with one more fault of the measurement among the parameters of the base model; None without one.

    A fault is granted in one of two cases: it beats every effect by 20:1 and takes a share of the misfit
    (`DecisionRules.least_share`), so that it comes before them; or, beside the best effect, it is predicted to explain
    more of what is left than any further effect, by 20:1, and enough for so many faults. The decision is then taken
    anew with the fault in the base model, which may grant a further one, up to `DecisionRules.most_effects`. Its answer
    counts if it leaves nothing over, and if every fault that was granted is needed in it. Where that of the first fault
    does not, the next one like it (`calib.missing.blame.alike_faults`) is granted instead: while an effect is missing,
    evidence does not tell which of two modes holds a share of the other. Where derivatives cost evaluations of the
    model, none is granted if to first order as many as may be leave the fit strongly rejected.

    Parameters
    ----------
    fits : Refits
    found : Explanation
        So far, with its competing explanations.
    singles : sequence of CandidateFit
        Fits of single effects.
    best : CandidateFit or None
        The leading effect; None without any.
    tests : AdequacyTests or None
        Of its fit.
    again : callable
    """
    left = RULES.most_effects - len(fits.granted)
    if left <= 0 or not fits.hypotheses.faults or (fits.by_differences and not _may_explain(fits, found, left)):
        return None
    first = _first(fits, found, best)
    if not first:
        beside = None if best is None or tests is None else _beside(fits, best, tests)
        first = () if beside is None else (beside,)
    for fault, values in first:
        told = _granting(fits, fault, values, again)
        if told is not None:
            alone = next((t for t in found.faults if t.names == (fault.name,)), None)
            known = () if alone is None else singles
            like = [t.names[0] for t in known if not t.implausible and alone and alike(found, alone, t)]
            like += [name for name in _in_place_of(fits, told, fault) if name not in like]
            return replace(told, mistakable=(*((fault.name, name) for name in like), *told.mistakable))
    return None


def _may_explain(fits: Refits, found: Explanation, count: int) -> bool:
    """Whether so many faults might explain the misfit, each that which takes most of what is left to first order."""
    faults = found.base_adequacy.suspects
    if faults is None:
        return False
    fit = found.base.fit
    left, unit = fit.projected, faults.unit
    for _ in range(count):
        first = unit[:, int(np.argmax(np.abs(unit.T @ left)))]
        left, unit = left - first * (first @ left), unit - np.outer(first, first @ unit)
        size = np.linalg.norm(unit, axis=0)
        unit = np.where(size > _SPENT, unit / np.maximum(size, _SPENT), 0.0)
    return overall_p(replace(fit, residual=left[: len(fit.residual)]), fits.hypotheses) > RULES.rejected_fit


def _granting(fits: Refits, fault: Candidate, values: Mapping[str, float], again: Again) -> Explanation | None:
    """The decision with a fault granted, from values of its fit; None where its answer does not count."""
    fits.announce(f"deciding with {fault.title}")
    granting = fits.with_granted(fault)
    told = again(granting, {name: value for name, value in values.items() if name in granting.fit_problem(()).space})
    if told.verdict == "nothing_detectable":
        told = replace(told, verdict="measurement")
    explains = told.verdict in (*NAMED, "indistinguishable") or (told.verdict == "measurement" and not told.remains)
    return told if explains and _needed(fits, told, fault) else None


def _in_place_of(fits: Refits, told: Explanation, fault: Candidate) -> Iterator[str]:
    """Faults that explain about as well in the place of a granted one, beside all else that is told; not charged.

    A channel reads many others that move nearly alike: which of them, the data may not tell. Those that are predicted
    to explain about as much are fitted, at most `DecisionRules.blamed`, and told where they are within 20:1.
    """
    fit = told.last.fit
    names = (*told.last.names, *(e.name for e in told.granted if e is not fault and e not in fits.granted))
    lacking = fit.without(fault.name)
    known = scores(lacking, [e for e in fits.family.single if e.name not in names], {})
    pairs = fits.family.screened(lacking, names, (fault.name,))
    known = known if pairs is None else known.joined(pairs.scores)
    if fault.name not in known.owners:
        return
    predicted = fits.family.predicted(known)
    least = predicted[known.best(fault.name)] - RULES.close
    near = [known.owners[k] for k in np.argsort(-predicted, kind="stable") if predicted[k] > least]
    own = {name: value for name, value in fit.values.items() if name != fault.name}
    starts = dict[str, dict[str, float]]()
    for name in [name for name in near if name != fault.name][: RULES.blamed]:
        k = known.best(name)
        p, size = fits.by_name[name].magnitude, known.z[k] / known.size[k]
        starts[name] = {**own, name: min(max(size, p.lower), p.upper)}
    with fits.allowance.uncharged():
        every = {fault.name: dict(fit.values), **starts}
        fits.ahead((((*names, name), start) for name, start in every.items()), FINE, charged=False)
        granted = fits.candidate_fit((*names, fault.name), dict(fit.values))
        for name, start in starts.items():
            with suppress(EvaluationError):
                other = fits.candidate_fit((*names, name), start)
                close = other.ln_evidence > granted.ln_evidence - RULES.credible
                if close and has_possible_size(other.fit, fits.by_name[name]):
                    yield name


def _first(
    fits: Refits, found: Explanation, best: CandidateFit | None
) -> tuple[tuple[Candidate, Mapping[str, float]], ...]:
    """A fault that comes before every effect, with the values of its fit, and before others the next one like it."""
    fault = found.fault
    if fault is None or not takes_enough(found, fault) or not outweighs(fits, found, best, RULES.credible):
        return ()
    like = (t for t in found.faults if t.names != fault.names and not t.implausible and alike_faults(found, fault, t))
    several = (fault, *islice(like, 0 if fits.granted else 1))
    return tuple((t.effects[0], t.fit.values) for t in several if has_possible_size(t.fit, t.effects[0]))


def _beside(fits: Refits, best: CandidateFit, tests: AdequacyTests) -> tuple[Candidate, Mapping[str, float]] | None:
    """The fault that explains most of what an effect leaves, with the values after one step from its fit."""
    faults = tests.suspects
    if faults is None or not faults.owners:
        return None
    predicted = fits.family.predicted(faults)
    k = int(np.argmax(predicted))
    gain, choices = float(predicted[k]), fits.family.choice
    others = max(_largest(tests.named), _largest(tests.perturbations)) ** 2 / 2
    if gain <= 2 * RULES.credible + choices or gain < others + RULES.credible:
        return None
    name = faults.owners[k]
    return fits.by_name[name], fits.starts(best.fit, faults, name)[0]


def _largest(scores: Scores) -> float:
    return max(float(scores.magnitude.max(initial=0.0)), 0.0)


def _needed(fits: Refits, told: Explanation, fault: Candidate) -> bool:
    """Whether the magnitude of a granted fault is significant among so many in the fit that the verdict rests on.

    And whole, where it must be.
    """
    fit = told.last.fit
    if not is_whole(fit, fault):
        return False
    k = fit.names.index(fault.name)
    size = abs(fit.values[fault.name]) / math.sqrt(float(fit.covariance[k, k]))
    return size**2 / 2 > RULES.credible + fits.family.choice + fits.family.price((fault.name,))
