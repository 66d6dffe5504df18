"""At which of several places an effect acts, and at which others it may."""

from __future__ import annotations

import math

import pandas as pd

from calib.errors.errors import EvaluationError
from calib.missing.candidate_fit import CandidateFit
from calib.missing.evidence import ln_evidence
from calib.missing.explanation import Explanation
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.recommendation import as_ratio
from calib.missing.rules import RULES
from calib.problem.effect import Effect

FOUND_PLACES = "found_places"
"""Name of the table."""
COLUMNS = ("effect", "place", "name", "magnitude", "sum_of_squares", "ln_bayes", "credible", "error")


def found_places(found: Explanation) -> pd.DataFrame:
    """Fits of the best model with each place of its effects held in turn; columns `COLUMNS`.

    Credible are those whose log evidence is within `Rules.credible` of the best, as effects are. A place with which the
    model cannot be solved has an error, and no numbers.
    """
    rows: list[tuple[object, ...]] = []
    chosen = found.chosen
    if chosen is not None:
        for effect in (e for e in chosen.effects if isinstance(e, Effect) and e.places):
            rows += _rows(found, chosen, effect)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(found: Explanation, chosen: CandidateFit, effect: Effect) -> list[tuple[object, ...]]:
    fit, rows = chosen.fit, []
    for number, name in enumerate(effect.places, 1):
        held = {effect.place_name: float(number)}
        try:
            there = least_squares_fit(Altered(fit.fit_problem, held=held), fit.effects, {**fit.values, **held})
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
