"""Faults of the measurement against effects: which is told, and which these data cannot tell from the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.missing.adequacy import adequacy_of, adequate, beside, measured_scale
from calib.missing.candidate_fit import AdequacyTests, CandidateFit, WrongDatum
from calib.missing.explanation import Explanation
from calib.missing.place import best_perturbation, takes_enough
from calib.missing.plausible import has_possible_size
from calib.missing.refits import Refits, near_to
from calib.missing.rules import RULES
from calib.missing.score import scores
from calib.missing.suspect import suspects_table, wrong_datum

DAMPING = "damping"
"""Kind of a fault by which an analysis adds damping: any loss in the structure looks like it."""


def with_competing(fits: Refits, found: Explanation, best: CandidateFit) -> Explanation:
    """Add the competing explanations: a local perturbation, faults of the measurement and a wrong datum."""
    h, base, adequacy = fits.hypotheses, found.base, found.base_adequacy
    margin = near_to(best.ln_evidence - base.ln_evidence)
    perturbation = best_perturbation(fits, base, adequacy.perturbations, adequacy.named, best)
    if perturbation is not None and perturbation.ln_evidence > best.ln_evidence - margin:
        perturbation = fits.finished(perturbation)
    faults = () if adequacy.suspects is None else fits.faults(base, adequacy.suspects, best)
    faults = tuple(fits.settled(faults, RULES.credible)) if faults else ()
    fault = faults[0] if faults else None
    if adequacy.faults is None:
        fault = fits.fault(base, adequacy.perturbations, best)
    if adequacy.faults is None and ln_of(fault) > max(best.ln_evidence, ln_of(perturbation) + RULES.credible):
        perturbation = fault
    accused = suspects_table(base.fit, h, found.alpha)
    datum = wrong_datum(fits, base, accused, best)
    return replace(found, perturbation=perturbation, fault=fault, faults=faults, datum=datum, suspects=accused)


def with_faults(found: Explanation, faults: Sequence[CandidateFit]) -> Explanation:
    """The same with other fits of faults; the best one counts."""
    ranked = tuple(sorted(faults, key=lambda t: -t.ln_evidence))
    return replace(found, faults=ranked, fault=ranked[0]) if ranked else found


def blamed(
    fits: Refits, found: Explanation, singles: Sequence[CandidateFit], best: CandidateFit | None, margin: float
) -> Explanation | None:
    """Explanation by a fault of the measurement that leaves nothing over; None when none may be named.

    The same is asked of a fault as of an effect: evidence that outweighs the number of faults, no better local
    perturbation or wrong datum, plausible parameters, no misfit left. Its evidence must exceed that of the best effect
    by ``margin``, after the number of faults and of effects is taken off.
    """
    fault = found.fault
    if fault is None or fault.implausible or not outweighs(fits, found, best, margin):
        return None
    adequacy = tests_of(fits, found, fault)
    # Where only too large a standard deviation hides what stands out, further faults are looked for first.
    hidden = adequacy.overstated and adequacy.p_family <= found.alpha
    return _told(fits, found, fault, adequacy, singles) if adequate(fits, adequacy) and not hidden else None


def fault_first(fits: Refits, found: Explanation, candidate_fits: Sequence[CandidateFit]) -> Explanation | None:
    """Explanation by a fault that beats everything else by far, although something is left besides; None without one.

    It explains the data better than every fitted model with effects by 20:1, and takes at least
    `DecisionRules.least_share` of the sum of squares, one of a pair `DecisionRules.pairs_least`. Parameters may be
    pulled by what is left; its own magnitude is inside its limits.
    """
    fault = found.fault
    least = RULES.pairs_least if fault is not None and fault.effects[0].of_pair else RULES.least_share
    if fault is None or not takes_enough(found, fault, least):
        return None
    steps = () if found.steps is None else tuple(step.candidate_fit for step in found.steps.steps[1:])
    best = max((*candidate_fits, *steps), key=lambda t: t.ln_evidence, default=None)
    possible = has_possible_size(fault.fit, fault.effects[0])
    if not possible or not outweighs(fits, found, best, RULES.credible):
        return None
    singles = [t for t in candidate_fits if len(t.names) == 1]
    return _told(fits, found, fault, tests_of(fits, found, fault), singles, candidate_fits)


def mistakable(found: Explanation, one: CandidateFit) -> CandidateFit | None:
    """A fault by which the analysis adds damping that is nearly collinear with an effect; None without one.

    Whatever the odds: the loss of a real joint has not quite the frequencies that the library gives it, so that neither
    form is exact, and the evidence between the two rests on that.
    """
    for fault in found.faults:
        if getattr(fault.effects[0], "kind", "") == DAMPING and not fault.implausible and alike(found, fault, one):
            return fault
    return None


# -- what is asked of a fault ------------------------------------------------------------------------------------------


def outweighs(fits: Refits, found: Explanation, best: CandidateFit | None, margin: float) -> bool:
    """Whether the evidence for the best fault exceeds that of anything else, for so many of each."""
    fault, h = found.fault, fits.hypotheses
    if fault is None or not h.faults:
        return False
    own, groups = fits.family.choice, math.log(max(len(found.groups), 1))
    limits = [
        found.base.ln_evidence + own + RULES.credible,
        ln_of(found.perturbation) - math.log(max(len(h.perturbations), 1)) + own,
        -math.inf if _same(fault, found.datum) else ln_of(found.datum) - RULES.credible,
        -math.inf if best is None else best.ln_evidence - groups + own + margin,
    ]
    return fault.ln_evidence > max(limits)


def _same(fault: CandidateFit, datum: WrongDatum | None) -> bool:
    """Whether a wrong datum is the sensor or mode whose fault is told: then they do not contradict each other."""
    subjects = getattr(fault.effects[0], "subjects", ())
    return datum is not None and any(f" {name} " in f" {datum.what} " for name in subjects)


def tests_of(fits: Refits, found: Explanation, fault: CandidateFit) -> AdequacyTests:
    """Tests of a model with a fault of the measurement, or with one effect; not charged."""
    effects = [e for group in found.groups for e in group.effects]
    with fits.allowance.uncharged():
        return adequacy_of(fits, fault, beside(fits, fault, effects))


def _told(
    fits: Refits, found: Explanation, fault: CandidateFit, adequacy: AdequacyTests, singles: Sequence[CandidateFit],
    candidate_fits: Sequence[CandidateFit] = (),
) -> Explanation:  # fmt: skip
    """The verdict on a fault: alone, or with what is nearly collinear with it."""
    found = replace(
        found, candidate_fits=tuple(candidate_fits or singles), datum=None, fault_adequacy=adequacy,
        evaluations=fits.hypotheses.evaluations, measured_scale=measured_scale(fits, found.base, fault),
    )  # fmt: skip
    like = [t for t in singles if not t.implausible and alike(found, fault, t)]
    if like:
        chosen = tests_of(fits, found, like[0])
        names = tuple(t.names[0] for t in like)
        return replace(found, verdict="indistinguishable", chosen=like[0], chosen_adequacy=chosen, credible=names)
    return replace(found, verdict="measurement", chosen=None, chosen_adequacy=None, place=_place(fits, found, fault))


def alike(found: Explanation, fault: CandidateFit, one: CandidateFit) -> bool:
    """Whether an effect is nearly collinear with a fault and explains much of what it does."""
    much = found.ln_bayes(one) > max(RULES.by_far * found.ln_bayes(fault), RULES.credible)
    direction, named = _direction(found, fault), found.base_adequacy.named
    if direction is None or one.names[0] not in named.owners or not much:
        return False
    return max(abs(float(named.unit[:, k] @ direction)) for k in named.of(one.names[0])) > RULES.confounded


def alike_faults(found: Explanation, fault: CandidateFit, other: CandidateFit) -> bool:
    """Whether another fault explains at least half of what a fault does, in log evidence and in change pattern."""
    if not found.ln_bayes(other) > max(RULES.by_far * found.ln_bayes(fault), RULES.credible):
        return False
    one, two = _direction(found, fault), _direction(found, other)
    return one is not None and two is not None and float(one @ two) ** 2 > RULES.by_far


def _direction(found: Explanation, fault: CandidateFit) -> np.ndarray | None:
    known = found.base_adequacy.suspects
    if known is None:
        return None
    (e,) = fault.effects
    if e.name not in known.owners:  # of pairs the largest are kept
        known = scores(found.base.fit, [e], {})
    return np.asarray(known.unit[:, known.best(e.name)])


def _place(fits: Refits, found: Explanation, fault: CandidateFit) -> CandidateFit | None:
    """The local perturbation nearly collinear with a fault that explains most of what it does; None without one."""
    direction, local = _direction(found, fault), found.base_adequacy.perturbations
    if direction is None or not local.owners:
        return None
    near = np.where(np.abs(local.unit.T @ direction) > RULES.confounded, local.magnitude, -np.inf)
    if not near.max() ** 2 / 2 > RULES.by_far * found.ln_bayes(fault) or not np.isfinite(near.max()):
        return None
    with fits.allowance.uncharged():
        one = fits.local(local.owners[int(np.argmax(near))], found.base, local, fault)
    return one if one is not None and found.ln_bayes(one) > RULES.by_far * found.ln_bayes(fault) else None


def ln_of(one: CandidateFit | WrongDatum | None) -> float:
    """Log evidence; minus infinity for None."""
    return -math.inf if one is None else one.ln_evidence
