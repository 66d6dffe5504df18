"""Verdict of an explanation in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from calib.effect import Effect
from calib.missing.explanation import AdequacyTests, Explanation
from calib.missing.held_out import UNSEEN, contradicting
from calib.missing.local import WIDE, local_perturbation, unit_words
from calib.missing.rules import RULES
from calib.missing.tables import UNTESTED

_LEAST = 2 / RULES.draws
"""Smallest p-value that is stated: that of the samples, for the smaller of two tests (`AdequacyTests.p_family`)."""
_REPEATS = 3
"""Largest number of repeats named in a sentence."""


GROUPS = {"left_out": "data left out in turn", **UNSEEN}
"""Groups of data that a fit has not seen, in words."""


def sentences(
    found: Explanation,
    effects: pd.DataFrame,
    errors: pd.DataFrame,
    recommendation: str,
    disagreements: pd.DataFrame | None = None,
) -> tuple[str, ...]:
    """Verdict first, then its support, the effects that are not visible, and the recommended measurement.

    Parameters
    ----------
    found : Explanation
    effects : DataFrame
        From `calib.missing.tables.effects_table`.
    errors : DataFrame
        ``group, stage, rms, expected, p``; may be empty.
    recommendation : str
        Recommended measurement; may be empty.
    disagreements : DataFrame, optional
        Repeats that disagree with the others: columns ``repeat, mode, sensor, times``.
    """
    parts = {
        "nothing_detectable": _nothing,
        "noise_underestimated": _noise,
        "effect": _effect,
        "indistinguishable": _indistinguishable,
        "two_effects": _two,
        "unconfirmed": _unconfirmed,
        "partial": _partial,
        "none_explains": _none,
        "misfit_unlocated": _unlocated,
    }[found.verdict](found, effects)
    if found.verdict == "misfit_unlocated" and disagreements is not None:
        repeats = worst_repeats(found.base_adequacy, disagreements)[:_REPEATS]
        parts.append("Repeats that disagree with the others: " + ", ".join(repeats) + "." if repeats else "")
    if found.noise_scale != 1 and found.verdict != "noise_underestimated":
        parts.append(f"The standard deviation was taken {found.noise_scale:.2g} times as large as stated.")
    if found.names_something:
        parts += _errors(errors)
    if found.verdict == "unconfirmed":
        parts += _contradicted(errors)
    parts += _unseen(effects, found.chosen.names if found.names_something and found.chosen is not None else ())
    if recommendation and found.verdict not in ("noise_underestimated", "misfit_unlocated"):
        parts.append(recommendation)
    if found.verdict in ("partial", "none_explains", "misfit_unlocated") and not found.begun_anew:
        parts.append(
            "All fits started from the base fit, in which no parameter is pulled; each may be a local minimum."
        )
    if found.names_something or found.verdict in ("partial", "unconfirmed"):
        parts.append("Explanations outside the library cannot be excluded.")
    return tuple(part for part in parts if part)


def rounded(value: float) -> str:
    """Two significant digits without an exponent where that reads better."""
    return f"{float(f'{value:.2g}'):g}"


def _chance(p: float) -> str:
    return f"< {_LEAST:.1g}" if p < _LEAST else f"{p:.2g}"


def _p(p: float) -> str:
    return f"p {_chance(p)}" if p < _LEAST else f"p = {_chance(p)}"


def _family(found: Explanation) -> str:
    adequacy = found.base_adequacy
    local = f"{len(set(adequacy.perturbations.owners))} local perturbations"
    tested = sum(len(g.names) for g in found.groups)
    counts = f"{tested} effect{'s' * (tested != 1)} and {local}" if tested else local
    return (
        f"with the model complete the chance of such scores is {_chance(adequacy.p_family)} (family-wise over "
        f"{counts}) and of such a misfit as a whole {_chance(adequacy.p_fit)}"
    )


def _nothing(found: Explanation, effects: pd.DataFrame) -> list[str]:
    if found.groups and not effects["visible"].astype(bool).any():
        return [
            "These data cannot show any effect of the library at a plausible magnitude. "
            f"The base model fits them: {_family(found)}."
        ]
    return [f"Nothing detectable is missing: {_family(found)}."]


def _noise(found: Explanation, effects: pd.DataFrame) -> list[str]:
    factor = f"{found.noise_scale:.2g}"
    return [
        f"The residuals of all modes are too large by a common factor of {factor}: check the standard deviation. "
        "Repeats do not show what differs between set-ups, and an assumed standard deviation may be too small. With "
        f"the standard deviation {factor} times as large nothing detectable is missing."
    ]


def _magnitude(effects: pd.DataFrame, name: str) -> str:
    row = effects[effects["name"] == name].iloc[0]
    unit = unit_words(row["unit"])
    if not row["refitted"]:
        return f"whose signature is that of {str(row['confounded_with']).split(', ')[0]}"
    return f"{row['magnitude']:.3g}{unit} (95 %: {row['magnitude_low']:.3g} to {row['magnitude_high']:.3g}{unit})"


def _titled(effects: pd.DataFrame, name: str, collinear: str | None = None) -> str:
    row = effects[effects["name"] == name].iloc[0]
    same = str(row["stands_for"]) if collinear is None else collinear
    others = f", or collinear here: {same}" if same else ""
    return f"{row['title']} ({name}{others})"


def _collinear(found: Explanation, name: str) -> str:
    """Credible effects collinear with one of a pair."""
    own = {n for g in found.groups if name in g.names for n in g.names} - {name}
    return ", ".join(n for n in found.credible if n in own)


def _look_for(found: Explanation) -> list[str]:
    chosen = found.chosen.effects if found.chosen is not None else ()
    return [
        "As it is, the model says: " + " ".join(_ended(e.lacks) for e in chosen),
        "Look for: " + " ".join(_ended(e.look_for) for e in chosen),
    ]


def _ended(words: str) -> str:
    """Text with a full stop at its end."""
    return words if words.endswith((".", "!", "?")) or not words else f"{words}."


def _effects(found: Explanation) -> tuple[Effect, ...]:
    return tuple(e for g in found.groups for e in g.effects)


def _clean(found: Explanation) -> str:
    adequacy = found.chosen_adequacy
    assert adequacy is not None
    whole = f"the fit as a whole has {_p(adequacy.p_fit)}"
    if adequacy.p_fit <= found.alpha:
        whole += ", which is poor: the standard deviation may be larger than stated, or something more may be missing"
    return f"After adding it no effect or local perturbation stands out ({_p(adequacy.p_family)}); {whole}."


def _effect(found: Explanation, effects: pd.DataFrame) -> list[str]:
    name = found.credible[0]
    row = effects[effects["name"] == name].iloc[0]
    out = [
        f"Something is missing: {_family(found)}.",
        f"Best explanation: {_titled(effects, name)}, {_magnitude(effects, name)}; probability "
        f"{100 * row['model_probability']:.0f} % within the library.",
        _clean(found),
    ]
    return out + _look_for(found)


def _indistinguishable(found: Explanation, effects: pd.DataFrame) -> list[str]:
    rows = effects[effects["name"].isin(found.credible)].sort_values("ln_bayes", ascending=False)
    explaining = [(float(b), f"{_titled(effects, n, '')}, {_magnitude(effects, n)}")
                  for n, b in zip(rows["name"], rows["ln_bayes"], strict=True)]  # fmt: skip
    adequacy = ""
    if found.fault is not None:
        explaining.append(
            (found.ln_bayes(found.fault), f"a fault of the measurement: {local_perturbation(found.fault).told}")
        )
        adequacy = "Or: " + " ".join(e.look_for for e in found.fault.effects)
    if found.datum is not None:
        explaining.append((found.ln_bayes(found.datum), found.datum.told))
        adequacy = f"Or measure the {found.datum.what} again."
    explaining.sort(key=lambda one: -one[0])
    bayes_factor = math.exp(explaining[0][0] - explaining[1][0])
    named = "; or ".join(words for _, words in explaining)
    credible = [e for n in rows["name"] for e in _effects(found) if e.name == n]
    wrong = ", or a measurement is wrong" if len(explaining) > len(rows) else ""
    # Only a wrong measurement may be far ahead; an effect that far ahead would be named.
    first = (
        "A wrong measurement explains it best"
        if bayes_factor > math.exp(RULES.credible)
        else "These data cannot tell between"
    )
    return [
        f"Something is missing{wrong}: {_family(found)}.",
        f"{first}: {named}. The odds of the first against the second are {rounded(bayes_factor)}:1.",
        _clean(found),
        "As it is, the model says: " + " ".join(_ended(e.lacks) for e in credible),
        f"Look for: {' Or: '.join(_ended(e.look_for) for e in credible)} {adequacy}".strip(),
    ]


def _two(found: Explanation, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None
    phrases = []
    collinear = {e.name: _collinear(found, e.name) for e in found.chosen.effects}
    for e in found.chosen.effects:
        value, std = found.chosen.magnitude(e.name)
        size = f"{value:.3g} +- {WIDE * std:.2g}{unit_words(e.magnitude.unit)} (95 %)"
        phrases.append(f"{_titled(effects, e.name, collinear[e.name])}, {size}")
    return [
        f"Two effects are missing: {_family(found)}, and no single effect removes the systematic misfit.",
        "Best explanation: " + " together with ".join(phrases) + ".",
        _clean(found).replace("adding it", "adding both"),
        *_look_for(found),
    ]


def _unconfirmed(found: Explanation, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None
    named = " together with ".join(
        f"{_titled(effects, e.name)}, {_magnitude(effects, e.name)}" for e in found.chosen.effects
    )
    return [
        f"What fits is not confirmed{'' if found.uncontested else ' by data that no fit has seen'}: {_family(found)}.",
        f"Fits, not confirmed: {named}.",
        "No local perturbation could be tested, so a wrong name cannot be excluded." * found.uncontested,
    ]


def _contradicted(errors: pd.DataFrame) -> list[str]:
    """Held-out data that contradict the best attempt, in words."""
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    against = contradicting(errors, "attempt")
    if not against:
        return []
    phrases = []
    for group in against:
        before, after = numbers[group, "before"], numbers[group, "attempt"]
        phrases.append(
            f"{GROUPS[group]} {float(before['rms']):.2f} -> {float(after['rms']):.2f} (noise floor "
            f"{float(after['expected']):.2f}, {_p(float(after['p']))})"
        )
    return [
        f"Error in standard deviations: {', '.join(phrases)}. Either it stands in for something else, or these data "
        "are themselves in error: check them before it is added."
    ]


def _rest(found: Explanation) -> str:
    """Local perturbation that fits a systematic misfit best, in words."""
    perturbation = found.perturbation
    if perturbation is None:
        return ""
    better = bool(found.groups) and (found.chosen is None or perturbation.ln_evidence > found.chosen.ln_evidence)
    words = (
        "fits better than every listed effect" if better else "is where an unnamed local perturbation would help most"
    )
    size = local_perturbation(perturbation).told
    return f"A local perturbation, {size}, {words}; that is a place to look at, not a cause."


def _partial(found: Explanation, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None and found.chosen_adequacy is not None
    name = found.chosen.names[0]
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    return [
        f"Systematic misfit that no listed effect removes: {_family(found)}.",
        f"{_titled(effects, name)}, {_magnitude(effects, name)}, lowers the sum of squares from {before:.0f} to "
        f"{after:.0f} but leaves {_p(found.chosen_adequacy.p_family)}: it is part of the answer or stands in for "
        "something that is not listed.",
        _rest(found),
    ]


def _none(found: Explanation, effects: pd.DataFrame) -> list[str]:
    what = "Systematic misfit that no listed effect explains" if found.groups else "Something is missing"
    out = [f"{what}: {_family(found)}."]
    if found.chosen is not None:
        out.append(f"The best attempt, {_titled(effects, found.chosen.names[0])}, is not believed: {_why_not(found)}.")
    return [*out, _rest(found)]


def _unlocated(found: Explanation, effects: pd.DataFrame) -> list[str]:
    return [
        "The misfit is beyond the standard deviation, but no effect and no local perturbation stands out: "
        f"{_family(found)}.",
        f"It is largest {_where(found.base_adequacy)}.",
        "Look at that measurement first: its channel, its repeats, and whether its standard deviation is larger than "
        "stated.",
    ]


def misfit_at(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> dict[str, object]:
    """Where a fit is worst: ``sensor`` or scalar response, ``mode`` with its ``kind``; ``repeats`` that disagree."""
    sensor, mode = _worst(adequacy)
    return {
        "sensor": None if sensor is None else str(sensor["sensor"]),
        "mode": None if mode is None else str(mode["mode"]),
        "kind": None if mode is None else str(mode["kind"]),
        "repeats": worst_repeats(adequacy, disagreements),
    }


def worst_repeats(adequacy: AdequacyTests, disagreements: pd.DataFrame) -> list[str]:
    """Repeats that disagree with the others; first those that do where the fit is worst, then by how much."""
    sensor, mode = _worst(adequacy)
    places = {str(row[name]) for row, name in ((sensor, "sensor"), (mode, "mode")) if row is not None}
    here = disagreements[["sensor", "mode"]].isin(places).any(axis=1)
    order = disagreements.assign(here=here).sort_values(["here", "times"], ascending=False, kind="stable")
    return list(dict.fromkeys(order["repeat"].astype(str)))


def _worst(adequacy: AdequacyTests) -> tuple[pd.Series | None, pd.Series | None]:
    """Rows of the worst sensor and of the worst mode of a fit; None where it has none."""
    modes = adequacy.modes[adequacy.modes["mode"] != ""].sort_values("p", kind="stable")
    return (adequacy.sensors.iloc[0] if len(adequacy.sensors) else None, modes.iloc[0] if len(modes) else None)


def _where(adequacy: AdequacyTests) -> str:
    """The worst sensor and the worst mode of a fit, each with its p-value, in words."""
    phrases = []
    worst, last = _worst(adequacy)
    if worst is not None:
        times = math.sqrt(float(worst["chi2"]) / max(float(worst["dof"]), 1.0))
        phrases.append(
            f"at {worst['sensor']} ({times:.1f} times its standard deviation, "
            f"{_of_many(worst['p'], len(adequacy.sensors))})"
        )
    if last is not None:
        count = int((adequacy.modes["mode"] != "").sum())
        phrases.append(f"in the {last['kind']} of mode {last['mode']} ({_of_many(last['p'], count)})")
    return " and ".join(phrases)


def _of_many(p: float, count: int) -> str:
    """p-value of the worst one of several, in words (Bonferroni)."""
    return f"{_p(min(1.0, float(p) * count))} as the worst of {count}"


def _why_not(found: Explanation) -> str:
    """Why the best attempt is not named, in words; see `Explanation.refused`."""
    candidate_fit, adequacy = found.chosen, found.chosen_adequacy
    assert candidate_fit is not None and adequacy is not None
    return {
        "implausible": candidate_fit.implausible,
        "dof": f"it leaves {max(adequacy.dof, 0.0):.1f} effective degrees of freedom, and below two no fit can be "
        "tested",
        "misfit": f"what is left still has {_p(min(adequacy.p_family, adequacy.p_fit))}",
        "local_perturbation": "a local perturbation fits better",
        "evidence": "the evidence for it is too weak among so many candidates",
    }[found.refused]


def _errors(errors: pd.DataFrame) -> list[str]:
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    phrases, worse = [], []
    for group, label in GROUPS.items():
        if (group, "before") not in numbers or (group, "after") not in numbers:
            continue
        before, after = float(numbers[group, "before"]["rms"]), float(numbers[group, "after"]["rms"])
        floor = float(numbers[group, "after"]["expected"])
        phrases.append(f"{label} {before:.2f} -> {after:.2f} (noise floor {floor:.2f})")
        # The error must be significantly larger: a correctly specified model must rarely predict as badly.
        if after > before and float(numbers[group, "after"]["p"]) < RULES.contradicted:
            worse.append(label)
    if not phrases:
        return []
    out = ["Error in standard deviations: " + ", ".join(phrases) + "."]
    if worse:
        out.append(f"It fits better but predicts no better: {', '.join(worse)} got worse.")
    return out


def _unseen(effects: pd.DataFrame, chosen: Sequence[str]) -> list[str]:
    """Effects that these data would not show and those not tested, without the chosen ones; in words."""
    phrases, blind = [], ~effects["visible"].astype(bool) & ~effects["name"].isin(chosen)
    untested = effects["implausible"] == UNTESTED
    for row in effects[blind & ~untested & effects["magnitude_min"].notna()].to_dict("records"):
        unit, least = unit_words(str(row["unit"])), float(row["magnitude_min"])
        possible = least <= float(row["largest"])
        phrases.append(
            f"{row['name']} below {rounded(least)}{unit}" if possible else f"{row['name']} of any possible magnitude"
        )
    out = ["Not visible with these data: " + ", ".join(phrases) + "."] if phrases else []
    failing = effects.loc[blind & ~untested & effects["magnitude_min"].isna(), "name"]
    if len(failing):
        out.append("Not visible as far as the model can be evaluated with them: " + ", ".join(failing) + ".")
    if untested.any():
        out.append("Not tested, since the model fails with it: " + ", ".join(effects.loc[untested, "name"]) + ".")
    return out
