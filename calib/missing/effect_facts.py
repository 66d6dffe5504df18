"""Facts of an explanation beside its fits: gains, detectable magnitudes, detailed effects, what a misfit does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError, InputError, ToleranceError
from calib.execution.stage import Progress, silent
from calib.missing.adapter import Adapter
from calib.missing.candidate_fit import CandidateFit
from calib.missing.detailed import DetailedFit, fitted_in_detail, leading_fit, tested_in_detail
from calib.missing.discrepancy import TABLE as PARAMETERS
from calib.missing.discrepancy import UNHELD, discrepancy_of, parameter_intervals, parameters_sentence
from calib.missing.evidence import ln_evidence
from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.hypotheses import Altered, FitProblem, Hypotheses
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.missing.predictions import ERRORS, predictions_sentence
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.missing.recommendation import as_ratio
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.settings import Settings
from calib.problem.candidate import Candidate
from calib.problem.effect import Effect
from calib.problem.shared_points import run_shared

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


def detailed_fits(adapter: Adapter, found: Explanation, progress: Progress = silent) -> tuple[DetailedFit, ...]:
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


def decided_in_detail(
    adapter: Adapter, found: Explanation, decide: Callable[[Adapter], Explanation], progress: Progress = silent
) -> tuple[Adapter, Explanation]:
    """The decision again with richer members of generic effects, which may lie anywhere near where they were composed.

    A point at which a generic effect was composed is none of the structure's: one that may lie anywhere near it is the
    same candidate, of as many. Where nothing was named, the members replace the `DecisionRules.freed` best effects that
    have one, one after the other until something is named, as far as these gain `DecisionRules.by_far` of what the best
    effect does. Where one effect was named, they replace those of another kind that come within `DecisionRules.close`
    of it, all at once: at their own place these may explain as well. Otherwise, and where nothing is named then, the
    adapter and the decision are as before.
    """
    rivals = _rivals(found)
    grown, spent = adapter, found.evaluations
    for some in [rivals] if found.names_something and rivals else [[one] for one in rivals]:
        progress(f"trying any place near that of {' and '.join(one.names[0] for one in some)}")
        try:
            for one in some:
                grown = grown.richer(one.names[0], progress) or grown
            again = decide(grown)
        except (EvaluationError, InputError, ToleranceError):
            continue
        spent += again.evaluations
        if again.names_something:
            return grown, replace(again, evaluations=spent)
    return adapter, found


def _rivals(found: Explanation) -> list[CandidateFit]:
    """Generic effects that may explain the data better, or as well as what is named, at a place of their own."""
    best = found.chosen if found.names_something else next(iter(found.singles), None)
    named = set(found.credible) if found.names_something else set()
    if best is None or not best.effects[0].generic or len(best.names) > 1:
        return []
    if found.names_something:
        least, own = found.ln_bayes(best) - RULES.close, best.effects[0]
        point = getattr(own, "richer", None) is not None
        some = [t for t in found.singles if not point or t.effects[0].magnitude.unit != own.magnitude.unit]
    elif found.verdict in UNEXPLAINED:
        least, some = RULES.by_far * found.ln_bayes(best), list(found.singles)
    else:
        return []
    near = [t for t in some if found.ln_bayes(t) > least and getattr(t.effects[0], "richer", None)]
    return [t for t in near if t.names[0] not in named][: RULES.freed]


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
    parameters = parameter_intervals(found.base.fit, wide)
    predicted, errors = adapter.predictions(found.base, wide, found.noise_scale)
    tables = {PARAMETERS: parameters, PREDICTIONS: predicted, ERRORS: errors}
    words = (parameters_sentence(parameters) if wide.holds else UNHELD, predictions_sentence(predicted, errors))
    return {name: table for name, table in tables.items() if len(table)}, words


FOUND_PLACES = "found_places"
"""Name of the table."""
COLUMNS = ("effect", "place", "name", "magnitude", "sum_of_squares", "ln_bayes", "credible", "error")


def found_places(found: Explanation) -> pd.DataFrame:
    """Fits of the best model with each place of its effects held in turn; columns `COLUMNS`.

    Credible are those whose log evidence is within `DecisionRules.credible` of the best, as effects are. A place
    with which the model cannot be solved has an error, and no numbers.
    """
    rows: list[tuple[object, ...]] = []
    chosen = found.chosen
    if chosen is not None:
        for effect in (e for e in chosen.effects if isinstance(e, Effect) and e.places):
            rows += _rows(found, chosen, effect)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(found: Explanation, chosen: CandidateFit, effect: Effect) -> list[tuple[object, ...]]:
    fit, rows = chosen.fit, []
    at = [{effect.place_name: float(number)} for number in range(1, len(effect.places) + 1)]
    requests = [(Altered(fit.fit_problem, held=held), fit.effects, {**fit.values, **held}) for held in at]
    run_shared(least_squares_fit, requests)
    for number, (name, request) in enumerate(zip(effect.places, requests, strict=True), 1):
        try:
            there = least_squares_fit(*request)
        except EvaluationError as fault:
            rows.append((number, name, math.nan, math.nan, math.nan, str(fault)))
            continue
        if number == round(fit.values[effect.place_name]) and fit.misfit < there.misfit:
            there = fit
        gain = ln_evidence(there, chosen.effects) - found.base.ln_evidence
        rows.append((number, name, there.values[effect.name], there.misfit, gain, ""))
    best = max((gain for *_, gain, error in rows if not error), default=math.nan)
    return [(effect.name, *row[:-1], row[-2] > best - RULES.credible, row[-1]) for row in rows]


def places_sentence(table: pd.DataFrame) -> str:
    """The places in words; empty where no effect has any."""
    out = []
    for effect, own in table.groupby("effect", sort=False):
        ranked = own[own["error"] == ""].sort_values("ln_bayes", ascending=False, kind="stable")
        failed = [str(name) for name in own.loc[own["error"] != "", "name"]]
        if ranked.empty:
            continue
        best, others = ranked.iloc[0], ranked.iloc[1:]
        near = [str(name) for name in others.loc[others["credible"].astype(bool), "name"]]
        words = f"{effect} acts at {best['name']}, one of {len(own)} places"
        if near:
            words += f"; {' and '.join(near)} explain{'s' * (len(near) == 1)} about as well"
        elif len(others):
            second = others.iloc[0]
            odds = as_ratio(float(best["ln_bayes"] - second["ln_bayes"]))
            words += f"; the odds against the next one, {second['name']}, are {odds}"
        if failed:
            words += f"; the model cannot be solved with it at {' or '.join(failed)}"
        out.append(f"{words}.")
    return " ".join(out)


_ASKED = 12
"""Residuals evaluated for one sign of a magnitude."""
_CLOSE = 1.1
"""Ratio of the ends of the bracket at which the search stops."""
_INWARD = (1.0, 0.99, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)
"""Parts of the limit tried in turn until the model can be evaluated."""
_LEAST = 1e-4
"""Part of the limit below which the search stops."""


def smallest_visible(found: Scores, name: str) -> float:
    """Magnitude of an effect from which it is found with about 90 % power; infinite where the parameters absorb it.

    To first order; see `visible_within_limits` for effects that grow faster than that.
    """
    own = [k for k in found.of(name) if found.size[k] > 0]
    return min((max(RULES.detectable / float(found.size[k]), float(found.onset[k])) for k in own), default=math.inf)


def visible_within_limits(
    fit_problem: FitProblem, fit: LinearisedFit, effect: Candidate, nuisance: Mapping[str, float] = MappingProxyType({})
) -> float:
    """The same by evaluating the model, up to the limits of the magnitude; infinite when even these do not show.

    A loss of stiffness, for instance, changes the data far more near its limit than its derivative predicts. The other
    parameters are updated to first order. The magnitude is bracketed to 10 %. Where the model fails at a limit, the
    largest magnitude that can be evaluated takes its place; if the effect does not show there either, the result is
    NaN, since it might show beyond.

    Parameters
    ----------
    fit_problem : FitProblem
        The fit problem with the effect added.
    fit : LinearisedFit
        Fit without it.
    effect : Candidate
    nuisance : mapping
        Values of its nuisance parameters.
    """
    ends = {effect.magnitude.lower, effect.magnitude.upper} - {effect.magnitude.value}
    found = [_onset(fit_problem, fit, effect, end, nuisance) for end in ends]
    shows = min((size for size in found if not math.isnan(size)), default=math.inf)
    return math.nan if math.isinf(shows) and any(map(math.isnan, found)) else shows


def _onset(
    fit_problem: FitProblem, fit: LinearisedFit, effect: Candidate, end: float, nuisance: Mapping[str, float]
) -> float:
    start = effect.magnitude.value

    def shown(part: float) -> float | None:
        """Length of the projected change over the detectable one; None where the model fails."""
        try:
            there = fit_problem.residual({**fit.values, **nuisance, effect.name: start + part * (end - start)})
        except EvaluationError:
            return None
        return float(np.linalg.norm(fit.project_out((fit.residual - there)[:, None]))) / RULES.detectable

    # Where the model fails at the limit, the largest magnitude that can be evaluated takes its place.
    reached = ((part, size) for part in _INWARD if (size := shown(part)) is not None)
    high, above = next(reached, (0.0, 0.0))
    if above < 1:
        return math.inf if high == 1.0 else math.nan
    low, below = 0.0, 0.0
    for _ in range(_ASKED - 1):
        if high < _LEAST or (low and high / low < _CLOSE):
            break
        if below > 0:  # interpolated by a power law, well inside the bracket
            share = math.log(1 / below) / math.log(above / below)
            part = low * (high / low) ** min(max(share, 0.15), 0.85)
        else:
            part = low + (high - low) / 2 if low else high * min(max(0.7 / above, 0.1), 0.7)
        inside = [part + k / 4 * (high - part) for k in range(4)]
        # Where the model fails inside the bracket, a point nearer to its upper end is tried.
        part, size = next(((p, s) for p in inside if (s := shown(p)) is not None), (high, above))
        if part == high:
            break
        low, below, high, above = (low, below, part, size) if size >= 1 else (part, size, high, above)
    return high * abs(end - start)
