"""Tables of an explanation: effects, faults, perturbations, confounding, pulls, goodness of fit, candidate fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.inference.rules import WIDE
from calib.missing.candidate_fit import CandidateFit
from calib.missing.collinear import Group
from calib.missing.effect_facts import smallest_visible
from calib.missing.evidence import expected_ln_bayes, ln_bayes_linear, model_probabilities, resized
from calib.missing.explanation import Explanation
from calib.missing.facts import Places
from calib.missing.local import fault_words, local_perturbation
from calib.missing.partial import is_simpler_form
from calib.missing.place import beyond_places
from calib.missing.plausible import parameter_pulls
from calib.missing.rules import RULES
from calib.missing.score import correlation, noise_limit
from calib.problem.candidate import NOWHERE, Candidate

CORRELATED = 60
"""Effects between which correlations are tabled; the figure draws fewer."""
UNTESTED = "not tested: the model fails with it"

EFFECT_COLUMNS = (
    "name", "title", "unit", "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min",
    "plausible", "largest", "visible", "ln_bayes", "ln_bayes_third", "ln_bayes_triple", "model_probability",
    "held_out_gain", "refitted", "credible", "told", "implausible", "confounded_with", "stands_for", "lacks",
    "look_for",
)  # fmt: skip
FAULT_COLUMNS = (
    "fault", "kind", "sensor", "x", "y", "z", "unit", "score", "unabsorbed", "magnitude", "low", "high",
    "magnitude_min", "ln_bayes", "fitted", "blamed", "told", "limit",
)  # fmt: skip


def effects_table(
    found: Explanation,
    intervals: Mapping[str, tuple[float, float]],
    gains: Mapping[str, float],
    visible: Mapping[str, float] = MappingProxyType({}),
    untested: Sequence[Candidate] = (),
) -> pd.DataFrame:
    """One row per effect, best first; `docs/tables.toml` lists the columns of ``effects.csv``.

    Parameters
    ----------
    found : Explanation
    intervals : mapping from str to (low, high)
        95 % profile-likelihood intervals of the named effects; others are linearised.
    gains : mapping from str to float
        Gain in the log density of modes left out in turn, for fitted effects.
    visible : mapping from str to float
        Smallest visible magnitudes beyond first order, where known.
    untested : sequence of Candidate
        Effects with which the model cannot be solved.
    """
    named = found.base_adequacy.named
    lacking = {e.name for e in untested}
    # A fit worse than the base model did not converge: zero magnitude would fit better.
    singles = {t.names[0]: t for t in found.singles if t.fit.misfit <= found.base.fit.misfit}
    if found.chosen is not None and len(found.chosen.effects) > 1:
        singles |= dict.fromkeys(found.chosen.names, found.chosen)
    attempted = is_simpler_form(found) or beyond_places(found)
    told = {*found.credible, *(found.chosen.names if found.chosen is not None and attempted else ())}
    rows: list[dict[str, object]] = []
    first: dict[str, object] = {}
    shares = []
    for group, e in [(one, e) for one in found.groups for e in one.effects]:
        if e.name in lacking:
            continue
        k = named.best(e.name)
        candidate_fit = singles.get(e.name)
        size = visible.get(e.name, smallest_visible(named, e.name))
        row: dict[str, object] = {
            "name": e.name, "title": e.title, "unit": e.magnitude.unit,
            "z": named.z[k], "unabsorbed": named.unabsorbed[k],
            "magnitude": math.nan, "magnitude_low": math.nan, "magnitude_high": math.nan, "magnitude_min": size,
            "plausible": e.plausible, "largest": max(abs(e.magnitude.lower), e.magnitude.upper),
            "visible": size <= e.plausible, "held_out_gain": gains.get(e.name, math.nan),
            "refitted": candidate_fit is not None, "credible": e.name in found.credible, "told": e.name in told,
            "implausible": "" if candidate_fit is None else candidate_fit.implausible,
            "confounded_with": ", ".join(confounded_with(found, e.name)),
            "stands_for": ", ".join(_stands_for(group, singles)) if e is group.effect else "",
            "lacks": e.lacks, "look_for": e.look_for,
        }  # fmt: skip
        factors = {"ln_bayes": 1.0, "ln_bayes_third": 1 / 3, "ln_bayes_triple": 3.0}
        if candidate_fit is None:
            own = named.of(e.name)
            for column, factor in factors.items():
                width = np.full(len(own), factor * e.plausible)
                row[column] = float(np.max(ln_bayes_linear(named.magnitude[own], named.size[own], width)))
        else:
            magnitude, std = candidate_fit.magnitude(e.name)
            low, high = intervals.get(e.name, (magnitude - WIDE * std, magnitude + WIDE * std))
            p = e.magnitude
            row |= {"magnitude": magnitude, "magnitude_low": max(low, p.lower), "magnitude_high": min(high, p.upper)}
            for column, factor in factors.items():
                row[column] = resized(found.ln_bayes(candidate_fit), magnitude, std, p, factor)
        leader = singles.get(group.effect.name)
        if candidate_fit is None and leader is not None:  # the data say the same of all collinear effects
            row |= {column: first[column] for column in (*factors, "implausible")}
        first = row if e is group.effect else first
        rows.append(row)
        shares.append(1 / len(group.names))
    for row, chance in zip(rows, _chances(rows, shares, found.chosen), strict=True):
        row["model_probability"] = chance
    table = pd.DataFrame([*rows, *map(_untested, untested)], columns=list(EFFECT_COLUMNS))
    return table.sort_values(["refitted", "ln_bayes"], ascending=False, kind="stable", ignore_index=True)


def _chances(rows: Sequence[Mapping[str, object]], shares: Sequence[float], chosen: CandidateFit | None) -> list[float]:
    """Probability of the model with each effect; of effects that are chosen together, of the model with all of them."""
    together = chosen.names if chosen is not None and len(chosen.names) > 1 else ()
    names = [str(row["name"]) for row in rows]
    counted = [k for k, name in enumerate(names) if name not in together[1:]]
    ln_bayes = np.array([rows[k]["ln_bayes"] for k in counted], dtype=float)
    chances = model_probabilities(ln_bayes, np.array([shares[k] for k in counted]))[1]
    known = dict(zip((names[k] for k in counted), chances.tolist(), strict=True))
    return [known[together[0] if name in together else name] for name in names]


def _stands_for(group: Group, fitted: Mapping[str, CandidateFit]) -> list[str]:
    """Effects collinear with the leader of the group that were not fitted by themselves."""
    return [e.name for e in group.others if e.name not in fitted]


def _untested(e: Candidate) -> dict[str, object]:
    """Row of an effect that could not be tested."""
    row: dict[str, object] = dict.fromkeys(EFFECT_COLUMNS, math.nan)
    row |= {"name": e.name, "title": e.title, "unit": e.magnitude.unit, "plausible": e.plausible}
    row |= {"largest": max(abs(e.magnitude.lower), e.magnitude.upper), "implausible": UNTESTED}
    row |= {"lacks": e.lacks, "look_for": e.look_for}
    return row | {
        "visible": False,
        "refitted": False,
        "credible": False,
        "told": False,
        "confounded_with": "",
        "stands_for": "",
    }


def confounded_with(found: Explanation, name: str) -> list[str]:
    """Effects collinear beyond `DecisionRules.confounded`, or not told apart by 20:1 at its fitted magnitude."""
    named = found.base_adequacy.named
    names = _names(found)
    columns = [named.best(n) for n in names]
    rho = correlation(named, columns)[names.index(name)]
    candidate_fit = next((t for t in found.singles if t.names == (name,)), None)
    k = named.best(name)
    magnitude = 0.0 if candidate_fit is None else abs(candidate_fit.magnitude(name)[0]) * float(named.size[k])
    out = []
    for other, r in zip(names, rho, strict=True):
        told_apart = expected_ln_bayes(magnitude, float(r)) >= RULES.credible
        if other != name and (abs(r) > RULES.confounded or (magnitude > RULES.detectable and not told_apart)):
            out.append(other)
    return out


def _names(found: Explanation) -> list[str]:
    """All tested effects, in the order of their groups."""
    return [name for group in found.groups for name in group.names]


def confounding_table(found: Explanation, effects: pd.DataFrame | None = None) -> pd.DataFrame:
    """Correlation of signatures after projection; first column ``effect``, then one column per effect.

    Of more than `CORRELATED` effects it has those with most evidence, ``ln_bayes`` of the table of `effects_table`.
    """
    named = found.base_adequacy.named
    names = _names(found)
    if effects is not None and len(names) > CORRELATED:
        first = effects.sort_values("ln_bayes", ascending=False, kind="stable", na_position="last")["name"]
        most = set(first.head(CORRELATED))
        names = [name for name in names if name in most]
    matrix = correlation(named, [named.best(n) for n in names])
    table = pd.DataFrame(matrix, columns=names)
    table.insert(0, "effect", names)
    return table


def pull_table(found: Explanation) -> pd.DataFrame:
    """Pulls of the parameters of the base model and of the model with the chosen effects; see `parameter_pulls`."""
    parts = [parameter_pulls(found.base.fit, found.granted).assign(model="base")]
    if found.chosen is not None:
        parts.append(
            parameter_pulls(found.chosen.fit, (*found.chosen.effects, *found.granted)).assign(
                model=" + ".join(found.chosen.names)
            )
        )
    table = pd.concat(parts, ignore_index=True)
    return table[["model", *[c for c in table.columns if c != "model"]]]


def misfit_table(found: Explanation) -> pd.DataFrame:
    """Goodness of fit by mode and kind: ``stage, mode, kind, chi2, dof, p``.

    Stages are ``base``, and ``explained`` (also by a fault of the measurement) or, where nothing could be named,
    ``attempt``.
    """
    parts = [found.base_adequacy.modes.assign(stage="base")]
    if found.chosen_adequacy is not None:
        parts.append(found.chosen_adequacy.modes.assign(stage="explained" if found.names_something else "attempt"))
    elif found.fault_adequacy is not None:
        parts.append(found.fault_adequacy.modes.assign(stage="explained"))
    table = pd.concat(parts, ignore_index=True).replace({"mode": {"": "responses"}})
    return table[["stage", "mode", "kind", "chi2", "dof", "p"]]


def candidate_fits_table(found: Explanation) -> pd.DataFrame:
    """Every model that was fitted: ``effects, misfit, ln_bayes, implausible``."""
    candidate_fits = [
        found.base,
        *found.candidate_fits,
        *([found.perturbation] if found.perturbation is not None else []),
        *(t for t in found.faults if t is not found.perturbation),
    ]
    return pd.DataFrame(
        [
            {
                "effects": " + ".join(t.names) or "none",
                "misfit": t.fit.misfit,
                "ln_bayes": found.ln_bayes(t),
                "implausible": t.implausible,
            }
            for t in candidate_fits
        ]
    )


def faults_table(found: Explanation, places: Places, candidates: Mapping[str, Candidate]) -> pd.DataFrame:
    """One row per fault of the measurement, largest score first; `docs/tables.toml` lists the columns.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every fault, by name; m.
    candidates : mapping from str to Candidate
        The faults themselves, for units and limits.
    """
    scores, single, pairs = found.base_adequacy.suspects, found.base_adequacy.faults, found.base_adequacy.pairs
    if scores is None or single is None:
        return pd.DataFrame(columns=list(FAULT_COLUMNS))
    limits = np.full(len(scores.owners), noise_limit(single.magnitude))
    limits[len(single.owners) :] = math.nan if pairs is None else pairs.limit
    fits, blamed = {t.names[0]: t for t in found.faults}, {e.name for e, _ in found.faulty}
    rows: list[dict[str, object]] = [_granted(found, e) for e in found.granted]
    for k, name in enumerate(scores.owners):
        kind, (x, y, z), sensor = places[name]
        size, p = float(scores.size[k]), candidates[name].magnitude
        stepped = float(scores.z[k]) / size if size > 0 else math.nan
        row: dict[str, object] = {
            "fault": name, "kind": kind, "sensor": sensor, "x": x, "y": y, "z": z, "unit": p.unit,
            "score": scores.z[k] if scores.signed[k] else max(scores.z[k], 0.0), "unabsorbed": scores.unabsorbed[k],
            "magnitude": stepped if p.lower <= stepped <= p.upper else math.nan, "low": math.nan, "high": math.nan,
            "magnitude_min": RULES.detectable / size if size > 0 else math.inf,
            "ln_bayes": math.nan, "fitted": name in fits, "blamed": name in blamed, "told": "", "limit": limits[k],
        }  # fmt: skip
        if name in fits:
            fitted = local_perturbation(fits[name])
            row |= {"magnitude": fitted.value, "low": fitted.low, "high": fitted.high}
            row |= {"ln_bayes": found.ln_bayes(fits[name])}
            row["told"] = fault_words(fits[name])
        rows.append(row)
    table = pd.DataFrame(rows).fillna({"limit": limits[0]})
    order = np.argsort(-table["score"].abs().to_numpy(dtype=float), kind="stable")
    return table.iloc[order][list(FAULT_COLUMNS)].reset_index(drop=True)


def _granted(found: Explanation, fault: Candidate) -> dict[str, object]:
    """Row of a fault whose magnitude is among the parameters; its score is that of the fitted magnitude."""
    value, std = found.last.magnitude(fault.name)
    change, (x, y, z) = local_perturbation(found.last, fault), getattr(fault, "place", NOWHERE)
    return {
        "fault": fault.name, "kind": getattr(fault, "kind", ""), "sensor": getattr(fault, "sensor", ""),
        "x": x, "y": y, "z": z, "unit": fault.magnitude.unit, "score": value / std, "unabsorbed": math.nan,
        "magnitude": value, "low": change.low, "high": change.high, "magnitude_min": RULES.detectable * std,
        "ln_bayes": math.nan, "fitted": True, "blamed": True, "told": fault_words(found.last, fault),
    }  # fmt: skip


def perturbations_table(found: Explanation, places: Places) -> pd.DataFrame:
    """Score of every local perturbation, with its place and what noise alone would give."""
    scores, rows = found.base_adequacy.perturbations, []
    for k, name in enumerate(scores.owners):
        kind, place, sensor = places[name]
        score = scores.z[k] if scores.signed[k] else max(scores.z[k], 0.0)  # the other sign is not physical
        rows.append((name, kind, *place, sensor, score, scores.unabsorbed[k]))
    table = pd.DataFrame(rows, columns=["perturbation", "kind", "x", "y", "z", "sensor", "score", "unabsorbed"])
    told = () if found.place is None else found.place.names
    return table.assign(limit=noise_limit(table["score"].to_numpy(dtype=float)), told=table["perturbation"].isin(told))
