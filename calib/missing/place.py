"""The best local perturbation, and the place to look at of a verdict without a cause, where the data single one out."""

from __future__ import annotations

import numpy as np

from calib.missing.adequacy import adequacy_of, adequate, beside
from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.goodness import goodness, overall
from calib.missing.local import local_perturbation
from calib.missing.plausible import limit_of
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import Scores, noise_limit


def told_place(fits: Refits, found: Explanation) -> CandidateFit | None:
    """The fitted local perturbation of an explanation if it may be told as a place to look at.

    The best of many local perturbations always fits a little better. It says where to look only if all of these hold:

    - its score is beyond what noise gives the largest of them (`calib.missing.score.noise_limit`, and the family-wise
      p-value);
    - the 95 % interval of its magnitude excludes 0, and no limit holds the magnitude: a part that is "wholly lost" in
      data that hardly know of it stands in for something else;
    - it takes at least `DecisionRules.least_share` of the sum of squares of the base model, or the fit with it is
      adequate;
    - nothing is told of an effect that explains better, by more than 20:1.

    None too where the base model is adequate: then there is nothing to look for.

    Parameters
    ----------
    fits : Refits
    found : Explanation
        With its verdict, one of `calib.missing.explanation.UNEXPLAINED`; of any other nothing is told.
    """
    place, tests = found.perturbation, found.base_adequacy
    if place is None or found.verdict not in ("partial", "none_explains") or tests.adequate(found.alpha):
        return None
    if beyond_places(found):
        return None
    return place if stands_out(found, place) and (takes_enough(found, place) or _fits(fits, found, place)) else None


def beyond_places(found: Explanation) -> bool:
    """Whether something is told of an effect that explains better than any local perturbation, by more than 20:1."""
    if found.verdict != "partial" or found.chosen is None:
        return False
    return found.perturbation is None or found.chosen.ln_evidence > found.perturbation.ln_evidence + RULES.credible


def stands_out(found: Explanation, place: CandidateFit) -> bool:
    """Whether the score of a local perturbation, its interval and its limits allow it to be told."""
    scores, change = found.base_adequacy.perturbations, local_perturbation(place)
    (name,) = place.names
    if name not in scores.owners or found.base_adequacy.p_perturbations > found.alpha:
        return False
    score = float(scores.magnitude[scores.best(name)])
    beyond = score > noise_limit(np.where(scores.size > 0, scores.magnitude, np.nan))
    return beyond and not change.low <= 0 <= change.high and limit_of(place.fit, change.effect.magnitude) is None


def takes_enough(found: Explanation, one: CandidateFit, least: float = RULES.least_share) -> bool:
    """Whether a fit takes at least a share of the sum of squares of the base model."""
    return found.base.fit.misfit - one.fit.misfit >= least * found.base.fit.misfit


def _fits(fits: Refits, found: Explanation, place: CandidateFit) -> bool:
    """Whether nothing systematic is left beside a local perturbation; not charged, as it changes no verdict."""
    if overall(*goodness(place.fit, fits.hypotheses)) <= found.alpha / 10:
        return False  # known without a further evaluation
    effects = [e for group in found.groups for e in group.effects]
    with fits.allowance.uncharged():
        return adequate(fits, adequacy_of(fits, place, beside(fits, place, effects)))


def best_perturbation(
    fits: Refits, base: CandidateFit, found: Scores, named: Scores, best: CandidateFit
) -> CandidateFit | None:
    """Fit of the local perturbation with the largest score that is not collinear with the best effect.

    A changed component is preferred to an addition at a sensor, which must fit clearly better. ``best`` has one
    effect more than ``base``; it is the base model when there is none.
    """
    usable = np.array(found.magnitude)
    for own in (n for n in best.names if n not in base.names):
        column = named.unit[:, named.best(own)]
        usable[np.abs(found.unit.T @ column) > RULES.same] = -np.inf
    scales = np.array([bool(fits.by_name[n].part) for n in found.owners], dtype=bool)
    part, other = (int(np.argmax(np.where(own, usable, -np.inf))) if own.any() else None for own in (scales, ~scales))
    first, second = (
        0.0 if k is None else max(float(usable[k]), 0.0) ** 2 / 2 for k in (part, other)
    )  # fmt: skip
    perturbation = None
    if part is not None and first > 0:
        perturbation = fits.local(found.owners[part], base, found, best)
    clearly = second > first + RULES.credible and not (perturbation is not None and fits.spent())
    if other is not None and (clearly or (perturbation is None and second > 0)):
        competitor = fits.local(found.owners[other], base, found, best)
        if competitor is not None and (
            perturbation is None or competitor.ln_evidence > perturbation.ln_evidence + RULES.credible
        ):
            return competitor
    return perturbation
