"""Facts of an explanation beside its fits: gains, detectable magnitudes, detailed effects, what a misfit does."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, ToleranceError
from calib.execution.stage import Progress, unheard
from calib.missing.candidate_fit import CandidateFit
from calib.missing.detailed import DetailedFit, fitted_in_detail, leading_fit, tested_in_detail
from calib.missing.discrepancy import TABLE as PARAMETERS
from calib.missing.discrepancy import discrepancy_of, parameter_intervals, parameters_sentence
from calib.missing.explanation import Explanation
from calib.missing.hypotheses import Altered, Hypotheses
from calib.missing.predictions import ERRORS, predictions_sentence
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.missing.rules import RULES
from calib.missing.settings import Settings
from calib.missing.test import Adapter
from calib.missing.visible import smallest_visible, visible_within_limits
from calib.problem.candidate import Candidate

STAGE = "richer"
"""Stage of the errors of a richer member."""


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


def detailed_fits(adapter: Adapter, found: Explanation, progress: Progress = unheard) -> tuple[DetailedFit, ...]:
    """The family of the effect that nearly explains the data, from simple to rich, up to the first adequate member.

    Empty where no effect does, or where it has no richer member.
    """
    settings, tried = Settings(alpha=found.alpha, seed=adapter.facts.seed), list[DetailedFit]()
    simpler = leading_fit(found)
    while simpler is not None:
        try:
            richer = adapter.richer(simpler.names[0], progress)
            if richer is None:
                break
            (name,) = {e.name for e in richer.hypotheses.effects} - {e.name for e in adapter.hypotheses.effects}
            fitted = fitted_in_detail(richer.hypotheses, found, simpler, name, settings, progress)
        except (EvaluationError, ToleranceError):
            break
        if fitted is None:
            break
        errors = richer.errors({STAGE: fitted[0]}, found.noise_scale)[0]
        errors = errors[["group", "stage", "rows", "rms", "expected", "p"]]
        tried.append(tested_in_detail(found, simpler, fitted, errors))
        adapter, simpler = richer, None if tried[-1].adequate else fitted[0]
    return tuple(tried)


def unexplained(adapter: Adapter, found: Explanation) -> tuple[dict[str, pd.DataFrame], tuple[str, str]]:
    """Tables by name, those that have rows, and a sentence on parameters and on held-out data; empty without a misfit.

    Parameters
    ----------
    adapter : Adapter
    found : Explanation
    """
    wide = discrepancy_of(found)
    if wide is None:
        return {}, ("", "")
    parameters = parameter_intervals(found, wide)
    predicted, errors = adapter.predictions(found.base, wide, found.noise_scale)
    tables = {PARAMETERS: parameters, PREDICTIONS: predicted, ERRORS: errors}
    words = (parameters_sentence(parameters), predictions_sentence(predicted, errors))
    return {name: table for name, table in tables.items() if len(table)}, words
