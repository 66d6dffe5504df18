"""What an explanation found, as tables: effects, confounding, parameters under strain, everything tried."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.effect import Effect
from calib.missing.alike import Group
from calib.missing.evidence import expected_ln_bayes, ln_bayes_linear, posterior, rescaled
from calib.missing.findings import Findings, Trial
from calib.missing.local import WIDE
from calib.missing.plausible import strain
from calib.missing.rules import RULES
from calib.missing.score import correlation
from calib.missing.visible import smallest_visible

UNTESTED = "not tested: the model fails with it"

EFFECT_COLUMNS = (
    "name", "title", "unit", "z", "gamma", "phi", "phi_low", "phi_high", "phi_min", "plausible", "largest", "visible",
    "ln_bayes", "ln_bayes_third", "ln_bayes_triple", "posterior", "heldout_gain", "refitted", "credible",
    "implausible", "confounded_with", "stands_for", "lacks", "look_for",
)  # fmt: skip


def effects_table(
    found: Findings,
    intervals: Mapping[str, tuple[float, float]],
    gains: Mapping[str, float],
    visible: Mapping[str, float] = MappingProxyType({}),
    untested: Sequence[Effect] = (),
) -> pd.DataFrame:
    """One row a candidate, best first: see the columns of ``effects.csv`` in the README.

    Parameters
    ----------
    found : Findings
    intervals : mapping from str to (low, high)
        95 % intervals by profile likelihood of the effects that were named; others are linearised.
    gains : mapping from str to float
        Gain in the log density of modes left out, for effects that were fitted.
    visible : mapping from str to float
        Smallest visible strengths that are known better than to first order.
    untested : sequence of Effect
        Those with which the model cannot be solved.
    """
    named = found.base_check.named
    lacking = {e.name for e in untested}
    # A fit that ended worse than without its effect has only missed the way back.
    singles = {t.names[0]: t for t in found.singles if t.state.misfit <= found.base.state.misfit}
    if found.chosen is not None and len(found.chosen.effects) > 1:
        singles |= dict.fromkeys(found.chosen.names, found.chosen)
    rows: list[dict[str, object]] = []
    first: dict[str, object] = {}
    shares = []
    for group, e in [(one, e) for one in found.groups for e in one.effects]:
        if e.name in lacking:
            continue
        k = named.best(e.name)
        trial = singles.get(e.name)
        size = visible.get(e.name, smallest_visible(named, e.name))
        row: dict[str, object] = {
            "name": e.name, "title": e.title, "unit": e.strength.unit, "z": named.z[k], "gamma": named.gamma[k],
            "phi": math.nan, "phi_low": math.nan, "phi_high": math.nan, "phi_min": size, "plausible": e.plausible,
            "largest": max(abs(e.strength.lower), e.strength.upper), "visible": size <= e.plausible,
            "heldout_gain": gains.get(e.name, math.nan), "refitted": trial is not None,
            "credible": e.name in found.credible, "implausible": "" if trial is None else trial.implausible,
            "confounded_with": ", ".join(confounded_with(found, e.name)),
            "stands_for": ", ".join(_stands_for(group, singles)) if e is group.effect else "",
            "lacks": e.lacks, "look_for": e.look_for,
        }  # fmt: skip
        factors = {"ln_bayes": 1.0, "ln_bayes_third": 1 / 3, "ln_bayes_triple": 3.0}
        if trial is None:
            own = named.of(e.name)
            for column, factor in factors.items():
                width = np.full(len(own), factor * e.plausible)
                row[column] = float(np.max(ln_bayes_linear(named.strength[own], named.size[own], width)))
        else:
            phi, std = trial.strength(e.name)
            low, high = intervals.get(e.name, (phi - WIDE * std, phi + WIDE * std))
            p = e.strength
            row |= {"phi": phi, "phi_low": max(low, p.lower), "phi_high": min(high, p.upper)}
            for column, factor in factors.items():
                row[column] = rescaled(found.ln_bayes(trial), phi, std, e.plausible, factor)
        leader = singles.get(group.effect.name)
        if trial is None and leader is not None:  # what the data say of it they say of all that look the same
            row |= {column: first[column] for column in (*factors, "implausible")}
        first = row if e is group.effect else first
        rows.append(row)
        shares.append(1 / len(group.names))
    chances = posterior(np.array([row["ln_bayes"] for row in rows], dtype=float), np.array(shares))[1]
    for row, chance in zip(rows, chances, strict=True):
        row["posterior"] = chance
    table = pd.DataFrame([*rows, *map(_untested, untested)], columns=list(EFFECT_COLUMNS))
    return table.sort_values(["refitted", "ln_bayes"], ascending=False, kind="stable", ignore_index=True)


def _stands_for(group: Group, fitted: Mapping[str, Trial]) -> list[str]:
    """Effects that look the same as the first one and were not fitted by themselves."""
    return [e.name for e in group.others if e.name not in fitted]


def _untested(e: Effect) -> dict[str, object]:
    """Row of an effect of which nothing is known."""
    row: dict[str, object] = dict.fromkeys(EFFECT_COLUMNS, math.nan)
    row |= {"name": e.name, "title": e.title, "unit": e.strength.unit, "plausible": e.plausible}
    row |= {"largest": max(abs(e.strength.lower), e.strength.upper), "implausible": UNTESTED}
    row |= {"lacks": e.lacks, "look_for": e.look_for}
    return row | {"visible": False, "refitted": False, "credible": False, "confounded_with": "", "stands_for": ""}


def confounded_with(found: Findings, name: str) -> list[str]:
    """Effects alike beyond `Rules.confounded`, or that at its fitted strength odds of 20:1 cannot tell apart."""
    named = found.base_check.named
    names = _names(found)
    columns = [named.best(n) for n in names]
    rho = correlation(named, columns)[names.index(name)]
    trial = next((t for t in found.singles if t.names == (name,)), None)
    k = named.best(name)
    strength = 0.0 if trial is None else trial.strength(name)[0] * float(named.size[k])
    out = []
    for other, r in zip(names, rho, strict=True):
        told_apart = expected_ln_bayes(strength, float(r)) >= RULES.credible
        if other != name and (
            abs(r) > RULES.confounded or (abs(r) > 0.5 and strength > RULES.detectable and not told_apart)
        ):
            out.append(other)
    return out


def _names(found: Findings) -> list[str]:
    """All effects that were tested, joined ones beside each other."""
    return [name for group in found.groups for name in group.names]


def confounding_table(found: Findings) -> pd.DataFrame:
    """Correlation of fingerprints after projection; first column ``effect``, then one column an effect."""
    named = found.base_check.named
    names = _names(found)
    matrix = correlation(named, [named.best(n) for n in names])
    table = pd.DataFrame(matrix, columns=names)
    table.insert(0, "effect", names)
    return table


def strain_table(found: Findings) -> pd.DataFrame:
    """Parameters of the base model and of the explained one, in units of what a right model would need."""
    parts = [strain(found.base.state).assign(model="base")]
    if found.chosen is not None:
        parts.append(strain(found.chosen.state, found.chosen.effects).assign(model=" + ".join(found.chosen.names)))
    table = pd.concat(parts, ignore_index=True)
    return table[["model", *[c for c in table.columns if c != "model"]]]


def misfit_table(found: Findings) -> pd.DataFrame:
    """Goodness of fit by mode and kind: ``stage, mode, kind, chi2, freedom, p``.

    Stages are ``base``, and ``explained`` or, where nothing could be named, ``attempt``.
    """
    parts = [found.base_check.modes.assign(stage="base")]
    if found.chosen_check is not None:
        parts.append(found.chosen_check.modes.assign(stage="explained" if found.names_something else "attempt"))
    table = pd.concat(parts, ignore_index=True).replace({"mode": {"": "responses"}})
    return table[["stage", "mode", "kind", "chi2", "freedom", "p"]]


def tried_table(found: Findings) -> pd.DataFrame:
    """Every model that was fitted: ``effects, misfit, ln_bayes, implausible``."""
    trials = [found.base, *found.trials, *([found.atom] if found.atom is not None else [])]
    return pd.DataFrame(
        [
            {
                "effects": " + ".join(t.names) or "none",
                "misfit": t.state.misfit,
                "ln_bayes": found.ln_bayes(t),
                "implausible": t.implausible,
            }
            for t in trials
        ]
    )
