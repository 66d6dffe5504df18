"""What the table of effects says beside the fits: predictive gain, smallest detectable magnitude, what is untested."""

from __future__ import annotations

import numpy as np

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.hypotheses import Altered, Hypotheses
from calib.missing.rules import RULES
from calib.missing.test import Adapter
from calib.missing.visible import smallest_visible, visible_within_limits
from calib.problem.candidate import Candidate


def untested(adapter: Adapter, found: Explanation) -> list[Candidate]:
    """Effects with which the model could be solved at no magnitude or at no point of their grid."""
    scores = found.base_adequacy.named
    absorbed = {n for n in scores.owners if not scores.size[scores.of(n)].any()}
    tested = {name for group in found.groups for name in group.names} - (absorbed & adapter.failing())
    return [e for e in adapter.hypotheses.effects if e.name not in tested]


def detectable(adapter: Adapter, found: Explanation) -> dict[str, float]:
    """Smallest detectable magnitudes, from the model itself where the derivative does not determine them.

    This concerns effects that are detectable at no plausible magnitude to first order, and effects found with a
    magnitude that should not be detectable: their response grows faster than its derivative.
    """
    fit, out = found.base.fit, {}
    fits = {t.names[0]: t for t in found.singles}
    for effect in (e for group in found.groups for e in group.effects):
        first, single = smallest_visible(found.base_adequacy.named, effect.name), fits.get(effect.name)
        seen = (
            single is not None
            and found.ln_bayes(single) > RULES.credible
            and abs(single.fit.values[effect.name]) < first
        )
        if seen or (not effect.nuisance and first > effect.plausible):
            scaled = Altered(adapter.hypotheses.fit_problem((effect.name,)), found.noise_scale)
            nuisance = {q.name: single.fit.values[q.name] if single else q.value for q in effect.nuisance}
            within = visible_within_limits(scaled, fit, effect, nuisance)
            out[effect.name] = np.fmin(first, within) if seen else within
    return out


def gains(hypotheses: Hypotheses, found: Explanation) -> dict[str, float]:
    """Gain of every fitted effect in leave-one-out log predictive density, by mode or by response."""
    groups = [row.mode or row.sensor for row in hypotheses.rows]

    def density(candidate_fit: CandidateFit) -> float:
        return float(np.sum(candidate_fit.fit.left_out(groups).elpd))

    base = density(found.base)
    return {t.names[0]: density(t) - base for t in found.singles}
