"""The verdict in a sentence that an engineer can act on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from calib.effect import Effect
from calib.missing.findings import Check, Findings
from calib.missing.held_out import contradicting
from calib.missing.local import WIDE, local_change, unit_words
from calib.missing.rules import RULES
from calib.missing.tables import UNTESTED

_LEAST = 1 / 4000
"""Probabilities below this are drawn too rarely to be told apart."""
_REPEATS = 3
"""Repeats that are named in a sentence."""


GROUPS = {
    "left_out": "data left out in turn",
    "withheld_sensors": "withheld sensors",
    "withheld_modes": "withheld modes",
    "withheld_responses": "withheld responses",
}
"""Data that a fit has not seen, in words."""


def sentences(
    found: Findings, effects: pd.DataFrame, errors: pd.DataFrame, advice: str, disagreements: pd.DataFrame | None = None
) -> tuple[str, ...]:
    """Verdict with what supports it, what cannot be seen, and what to measure next; the first ones are the verdict.

    Parameters
    ----------
    found : Findings
    effects : DataFrame
        From `calib.missing.tables.effects_table`.
    errors : DataFrame
        ``group, stage, rms, expected, p``; may be empty.
    advice : str
        What to measure next; may be empty.
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
        repeats = worst_repeats(found.base_check, disagreements)[:_REPEATS]
        parts.append("Repeats that disagree with the others: " + ", ".join(repeats) + "." if repeats else "")
    if found.noise_scale != 1 and found.verdict != "noise_underestimated":
        parts.append(f"The scatter was taken {found.noise_scale:.2g} times as large as stated.")
    if found.names_something:
        parts += _errors(errors)
    if found.verdict == "unconfirmed":
        parts += _contradicted(errors)
    parts += _unseen(effects, found.chosen.names if found.names_something and found.chosen is not None else ())
    if advice and found.verdict not in ("noise_underestimated", "misfit_unlocated"):
        parts.append(advice)
    if found.verdict in ("partial", "none_explains", "misfit_unlocated") and not found.begun_anew:
        parts.append("Fits began from the base model, which nothing strains; each may be a local fit.")
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


def _family(found: Findings) -> str:
    check = found.base_check
    local = f"{len(set(check.atoms.owners))} local changes"
    tested = sum(len(g.names) for g in found.groups)
    counts = f"{tested} effect{'s' * (tested != 1)} and {local}" if tested else local
    return (
        f"with the model complete the chance of such scores is {_chance(check.p_family)} (family-wise over {counts}) "
        f"and of such a misfit as a whole {_chance(check.p_fit)}"
    )


def _nothing(found: Findings, effects: pd.DataFrame) -> list[str]:
    if found.groups and not effects["visible"].astype(bool).any():
        return [
            "Nothing can be told: no effect of the library would show in these data at a plausible size. "
            f"What they show fits: {_family(found)}."
        ]
    return [f"Nothing detectable is missing: {_family(found)}."]


def _noise(found: Findings, effects: pd.DataFrame) -> list[str]:
    factor = f"{found.noise_scale:.2g}"
    return [
        f"The misfit is spread over all modes by a common factor of {factor}: check the scatter. Repeats do not show "
        "what differs between set-ups, and an assumed scatter may be too small. With the scatter "
        f"{factor} times as large nothing detectable is missing."
    ]


def _strength(effects: pd.DataFrame, name: str) -> str:
    row = effects[effects["name"] == name].iloc[0]
    unit = unit_words(row["unit"])
    if not row["refitted"]:
        return f"whose fingerprint is that of {str(row['confounded_with']).split(', ')[0]}"
    return f"{row['phi']:.3g}{unit} (95 %: {row['phi_low']:.3g} to {row['phi_high']:.3g}{unit})"


def _titled(effects: pd.DataFrame, name: str, alike: str | None = None) -> str:
    row = effects[effects["name"] == name].iloc[0]
    same = str(row["stands_for"]) if alike is None else alike
    others = f", or what looks the same here: {same}" if same else ""
    return f"{row['title']} ({name}{others})"


def _others_alike(found: Findings, name: str) -> str:
    """Credible effects that look the same as one of a pair."""
    own = {n for g in found.groups if name in g.names for n in g.names} - {name}
    return ", ".join(n for n in found.credible if n in own)


def _look_for(found: Findings) -> list[str]:
    chosen = found.chosen.effects if found.chosen is not None else ()
    return [
        "As it is, the model says: " + " ".join(_ended(e.lacks) for e in chosen),
        "Look for: " + " ".join(_ended(e.look_for) for e in chosen),
    ]


def _ended(words: str) -> str:
    """As a sentence, whoever wrote it."""
    return words if words.endswith((".", "!", "?")) or not words else f"{words}."


def _effects(found: Findings) -> tuple[Effect, ...]:
    return tuple(e for g in found.groups for e in g.effects)


def _clean(found: Findings) -> str:
    check = found.chosen_check
    assert check is not None
    whole = f"the fit as a whole has {_p(check.p_fit)}"
    if check.p_fit <= found.alpha:
        whole += ", which is poor: the scatter may be larger than stated, or something more may be missing"
    return f"After adding it no effect or local change stands out ({_p(check.p_family)}); {whole}."


def _effect(found: Findings, effects: pd.DataFrame) -> list[str]:
    name = found.credible[0]
    row = effects[effects["name"] == name].iloc[0]
    out = [
        f"Something is missing: {_family(found)}.",
        f"Best explanation: {_titled(effects, name)}, {_strength(effects, name)}; posterior "
        f"{100 * row['posterior']:.0f} % within the library.",
        _clean(found),
    ]
    return out + _look_for(found)


def _indistinguishable(found: Findings, effects: pd.DataFrame) -> list[str]:
    rows = effects[effects["name"].isin(found.credible)].sort_values("ln_bayes", ascending=False)
    explaining = [(float(b), f"{_titled(effects, n, '')}, {_strength(effects, n)}")
                  for n, b in zip(rows["name"], rows["ln_bayes"], strict=True)]  # fmt: skip
    check = ""
    if found.fault is not None:
        explaining.append(
            (found.ln_bayes(found.fault), f"a fault of the measurement: {local_change(found.fault).told}")
        )
        check = "Or: " + " ".join(e.look_for for e in found.fault.effects)
    if found.datum is not None:
        explaining.append((found.ln_bayes(found.datum), found.datum.told))
        check = f"Or measure the {found.datum.what} again."
    explaining.sort(key=lambda one: -one[0])
    odds = math.exp(explaining[0][0] - explaining[1][0])
    named = "; or ".join(words for _, words in explaining)
    credible = [e for n in rows["name"] for e in _effects(found) if e.name == n]
    wrong = ", or a measurement is wrong" if len(explaining) > len(rows) else ""
    # Only what is wrong with the measurement may be far ahead; an effect that is would be named.
    first = (
        "A wrong measurement explains it best" if odds > math.exp(RULES.credible) else "These data cannot tell between"
    )
    return [
        f"Something is missing{wrong}: {_family(found)}.",
        f"{first}: {named}. The odds of the first against the second are {rounded(odds)}:1.",
        _clean(found),
        "As it is, the model says: " + " ".join(_ended(e.lacks) for e in credible),
        f"Look for: {' Or: '.join(_ended(e.look_for) for e in credible)} {check}".strip(),
    ]


def _two(found: Findings, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None
    told = []
    alike = {e.name: _others_alike(found, e.name) for e in found.chosen.effects}
    for e in found.chosen.effects:
        value, std = found.chosen.strength(e.name)
        size = f"{value:.3g} +- {WIDE * std:.2g}{unit_words(e.strength.unit)} (95 %)"
        told.append(f"{_titled(effects, e.name, alike[e.name])}, {size}")
    return [
        f"Two effects are missing: {_family(found)}, and no single effect leaves nothing organised.",
        "Best explanation: " + " together with ".join(told) + ".",
        _clean(found).replace("adding it", "adding both"),
        *_look_for(found),
    ]


def _unconfirmed(found: Findings, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None
    named = " together with ".join(
        f"{_titled(effects, e.name)}, {_strength(effects, e.name)}" for e in found.chosen.effects
    )
    return [
        f"What fits is not confirmed{'' if found.unrivalled else ' by data that no fit has seen'}: {_family(found)}.",
        f"Fits, not confirmed: {named}.",
        "Nothing in the model could be changed by itself, so a wrong name cannot be excluded." * found.unrivalled,
    ]


def _contradicted(errors: pd.DataFrame) -> list[str]:
    """What the withheld data say of the best attempt."""
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    against = contradicting(errors, "attempt")
    if not against:
        return []
    told = []
    for group in against:
        before, after = numbers[group, "before"], numbers[group, "attempt"]
        told.append(
            f"{GROUPS[group]} {float(before['rms']):.2f} -> {float(after['rms']):.2f} (noise floor "
            f"{float(after['expected']):.2f}, {_p(float(after['p']))})"
        )
    return [
        f"Error in units of the scatter: {', '.join(told)}. Either it stands in for something else, or these data are "
        "themselves in error: check them before it is added."
    ]


def _rest(found: Findings) -> str:
    """What an organised misfit points at."""
    atom = found.atom
    if atom is None:
        return ""
    better = bool(found.groups) and (found.chosen is None or atom.ln_evidence > found.chosen.ln_evidence)
    words = "fits better than every listed effect" if better else "is where an unnamed local change would help most"
    told = local_change(atom).told
    return f"A local change, {told}, {words}; that is a place to look at, not a cause."


def _partial(found: Findings, effects: pd.DataFrame) -> list[str]:
    assert found.chosen is not None and found.chosen_check is not None
    name = found.chosen.names[0]
    before, after = found.base.state.misfit, found.chosen.state.misfit
    return [
        f"Organised misfit that no listed effect removes: {_family(found)}.",
        f"{_titled(effects, name)}, {_strength(effects, name)}, lowers the sum of squares from {before:.0f} to "
        f"{after:.0f} but leaves {_p(found.chosen_check.p_family)}: it is part of the answer or stands in for "
        "something that is not listed.",
        _rest(found),
    ]


def _none(found: Findings, effects: pd.DataFrame) -> list[str]:
    what = "Organised misfit that no listed effect explains" if found.groups else "Something is missing"
    out = [f"{what}: {_family(found)}."]
    if found.chosen is not None:
        out.append(f"The best attempt, {_titled(effects, found.chosen.names[0])}, is not believed: {_why_not(found)}.")
    return [*out, _rest(found)]


def _unlocated(found: Findings, effects: pd.DataFrame) -> list[str]:
    return [
        f"The misfit is beyond the scatter, but no effect and no local change stands out: {_family(found)}.",
        f"It is largest {_where(found.base_check)}.",
        "Look at that measurement first: its channel, its repeats, and whether it scatters more than stated.",
    ]


def misfit_at(check: Check, disagreements: pd.DataFrame) -> dict[str, object]:
    """Where a fit is worst: ``sensor`` or plain response, ``mode`` with its ``kind``; ``repeats`` that disagree."""
    sensor, mode = _worst(check)
    return {
        "sensor": None if sensor is None else str(sensor["sensor"]),
        "mode": None if mode is None else str(mode["mode"]),
        "kind": None if mode is None else str(mode["kind"]),
        "repeats": worst_repeats(check, disagreements),
    }


def worst_repeats(check: Check, disagreements: pd.DataFrame) -> list[str]:
    """Repeats that disagree with the others; first those that do where the fit is worst, then by how far."""
    sensor, mode = _worst(check)
    places = {str(row[name]) for row, name in ((sensor, "sensor"), (mode, "mode")) if row is not None}
    here = disagreements[["sensor", "mode"]].isin(places).any(axis=1)
    order = disagreements.assign(here=here).sort_values(["here", "times"], ascending=False, kind="stable")
    return list(dict.fromkeys(order["repeat"].astype(str)))


def _worst(check: Check) -> tuple[pd.Series | None, pd.Series | None]:
    """Rows of the worst sensor and of the worst mode of a fit, where it has any."""
    modes = check.modes[check.modes["mode"] != ""].sort_values("p", kind="stable")
    return (check.sensors.iloc[0] if len(check.sensors) else None, modes.iloc[0] if len(modes) else None)


def _where(check: Check) -> str:
    """The worst sensor and the worst mode of a fit, each with the chance of the worst one being as bad."""
    told = []
    worst, last = _worst(check)
    if worst is not None:
        times = math.sqrt(float(worst["chi2"]) / max(float(worst["freedom"]), 1.0))
        told.append(f"at {worst['sensor']} ({times:.1f} times its scatter, {_of_many(worst['p'], len(check.sensors))})")
    if last is not None:
        count = int((check.modes["mode"] != "").sum())
        told.append(f"in the {last['kind']} of mode {last['mode']} ({_of_many(last['p'], count)})")
    return " and ".join(told)


def _of_many(p: float, count: int) -> str:
    """Chance of the worst one of several, in words."""
    return f"{_p(min(1.0, float(p) * count))} as the worst of {count}"


def _why_not(found: Findings) -> str:
    """What speaks against the best attempt, see `Findings.refused`."""
    trial, check = found.chosen, found.chosen_check
    assert trial is not None and check is not None
    return {
        "implausible": trial.implausible,
        "freedom": f"it leaves {max(check.freedom, 0.0):.1f} effective degrees of freedom, and below two nothing can "
        "speak against it",
        "misfit": f"what is left still has {_p(min(check.p_family, check.p_fit))}",
        "local_change": "a local change fits better",
        "evidence": "too little speaks for it among so many candidates",
    }[found.refused]


def _errors(errors: pd.DataFrame) -> list[str]:
    numbers = {(str(r["group"]), str(r["stage"])): r for r in errors.to_dict("records")}
    told, worse = [], []
    for group, label in GROUPS.items():
        if (group, "before") not in numbers or (group, "after") not in numbers:
            continue
        before, after = float(numbers[group, "before"]["rms"]), float(numbers[group, "after"]["rms"])
        floor = float(numbers[group, "after"]["expected"])
        told.append(f"{label} {before:.2f} -> {after:.2f} (noise floor {floor:.2f})")
        # An error that is larger by chance is none: a right model must hardly ever predict as badly.
        if after > before and float(numbers[group, "after"]["p"]) < RULES.contradicted:
            worse.append(label)
    if not told:
        return []
    out = ["Error in units of the scatter: " + ", ".join(told) + "."]
    if worse:
        out.append(f"It fits better but predicts no better: {', '.join(worse)} got worse.")
    return out


def _unseen(effects: pd.DataFrame, chosen: Sequence[str]) -> list[str]:
    """What these data would not show, and what was not tested; an effect that was found is no such thing."""
    told, blind = [], ~effects["visible"].astype(bool) & ~effects["name"].isin(chosen)
    untested = effects["implausible"] == UNTESTED
    for row in effects[blind & ~untested & effects["phi_min"].notna()].to_dict("records"):
        unit, least = unit_words(str(row["unit"])), float(row["phi_min"])
        possible = least <= float(row["largest"])
        told.append(
            f"{row['name']} below {rounded(least)}{unit}" if possible else f"{row['name']} of any possible strength"
        )
    out = ["Not visible with these data: " + ", ".join(told) + "."] if told else []
    failing = effects.loc[blind & ~untested & effects["phi_min"].isna(), "name"]
    if len(failing):
        out.append("Not visible as far as the model can be evaluated with them: " + ", ".join(failing) + ".")
    if untested.any():
        out.append("Not tested, since the model fails with it: " + ", ".join(effects.loc[untested, "name"]) + ".")
    return out
