"""Like an effect, but not exactly: one that explains nearly all of a misfit, far more than anything else does."""

from __future__ import annotations

from collections.abc import Iterator

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.local import WIDE
from calib.missing.rules import RULES
from calib.missing.score import Scores


def is_nearly(found: Explanation) -> bool:
    """Whether a partial explanation is that of an effect which the library lists in a simpler form than the real one.

    It is far ahead (`is_far_ahead`), and nothing further is predicted to lower the sum of squares by more than
    `Rules.little` of what it did.
    """
    best, adequacy = found.chosen, found.chosen_adequacy
    if found.verdict != "partial" or best is None or adequacy is None or not is_far_ahead(found):
        return False
    decrease = found.base.fit.misfit - best.fit.misfit
    return max(_drops(adequacy.named, adequacy.perturbations, adequacy.faults), default=0.0) < RULES.little * decrease


def is_far_ahead(found: Explanation) -> bool:
    """Whether the best attempt explains far more than anything else.

    Every other effect, local perturbation or fault gains less than `Rules.by_far` of the log evidence that it gains, or
    leaves more than `Rules.leaves` times the sum of squares that it leaves.
    """
    best = found.chosen
    if best is None:
        return False
    gained = found.ln_bayes(best)
    same = {name for group in found.groups if group.effect.name in best.names for name in group.names}
    others = [t for t in found.candidate_fits if not same & set(t.names)]
    others += [t for t in (found.perturbation, *found.faults) if t is not None]
    near = [t for t in others if found.ln_bayes(t) > RULES.by_far * gained]
    return not any(t.fit.misfit < RULES.leaves * best.fit.misfit for t in near)


def _drops(*families: Scores | None) -> Iterator[float]:
    """Predicted decrease of the sum of squares by each candidate of these families."""
    for scores in families:
        if scores is not None:
            yield from (scores.magnitude.clip(0.0) ** 2).tolist()


def spread_of(found: Explanation) -> tuple[float, float]:
    """Ends of all 95 % intervals of the best effect's magnitude, alone and beside what else was taken in with it.

    What the library does not list shifts the magnitude by an error that no interval of a single model holds.
    """
    assert found.chosen is not None
    (effect,) = found.chosen.effects
    fits: list[CandidateFit] = [found.chosen]
    if found.steps is not None:
        fits += [step.candidate_fit for step in found.steps.steps if effect.name in step.candidate_fit.names]
    p, ends = effect.magnitude, []
    for fit in fits:
        value, std = fit.magnitude(effect.name)
        ends += [max(value - WIDE * std, p.lower), min(value + WIDE * std, p.upper)]
    return min(ends), max(ends)
