"""Verdict of an explanation in sentences: what is missing, how sure that is, what to do next, and what supports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from calib.answer import Answer
from calib.candidate import Candidate
from calib.missing.explanation import CandidateFit, Explanation
from calib.missing.held_out import UNSEEN, contradicting
from calib.missing.local import WIDE, fault_words, interval_words, local_perturbation, unit_words
from calib.missing.recommendation import Recommendation, as_ratio, rounded
from calib.missing.rules import RULES
from calib.missing.tables import UNTESTED
from calib.missing.worst_misfit import p_words, where, worst_repeats

_REPEATS = 3
"""Largest number of repeats named in a sentence."""


MOST = 99.0
"""Largest probability that is stated (%): the prior of the library is no surer."""
GROUPS = {"left_out": "data left out in turn", **UNSEEN}
"""Groups of data that a fit has not seen, in words."""

_WORST = "the worst kind of data or mode shape"
"""What the p-value of a fit is of, corrected for their number; see `calib.missing.goodness.overall`."""
_OUTSIDE = "An effect outside the library cannot be excluded."


@dataclass(frozen=True)
class Verdict:
    """An explanation in words.

    Attributes
    ----------
    answer : Answer
        The verdict in a sentence, how sure it is, and what to do next.
    sentences : tuple of str
        The same with what it rests on, what these data cannot show, and the recommended measurement with its gain.
    """

    answer: Answer
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class _Words:
    """What one kind of verdict says; ``then`` is what to do before anything is measured."""

    found: str
    sure: str
    then: str = ""
    support: tuple[str, ...] = ()


def verdict(
    found: Explanation,
    effects: pd.DataFrame,
    errors: pd.DataFrame,
    recommendation: Recommendation | None = None,
    disagreements: pd.DataFrame | None = None,
    assumed: str = "",
) -> Verdict:
    """The explanation in words.

    Parameters
    ----------
    found : Explanation
    effects : DataFrame
        From `calib.missing.tables.effects_table`.
    errors : DataFrame
        ``group, stage, rms, expected, p``; may be empty.
    recommendation : Recommendation, optional
        Recommended measurement.
    disagreements : DataFrame, optional
        Repeats that disagree with the others: columns ``repeat, mode, sensor, times``.
    assumed : str
        Assumed standard deviations, in words.
    """
    words = {
        "nothing_detectable": _nothing,
        "noise_underestimated": _noise,
        "effect": _effect,
        "indistinguishable": _indistinguishable,
        "two_effects": _two,
        "measurement": _measurement,
        "unconfirmed": _unconfirmed,
        "partial": _partial,
        "none_explains": _none,
        "misfit_unlocated": _unlocated,
    }[found.verdict](found, effects)
    sure, support = [words.sure], list(words.support)
    if found.verdict == "misfit_unlocated" and disagreements is not None:
        repeats = worst_repeats(found.base_adequacy, disagreements)[:_REPEATS]
        support.append("Repeats that disagree with the others: " + ", ".join(repeats) + "." if repeats else "")
    if found.noise_scale != 1 and found.verdict != "noise_underestimated":
        sure.append(f"The standard deviation was taken {found.noise_scale:.2g} times as large as stated.")
    if found.names_something:
        support += _errors(errors)
    if found.verdict == "unconfirmed":
        support += _contradicted(errors)
    support += _unseen(effects, found.chosen.names if found.names_something and found.chosen is not None else ())
    short = ""
    if recommendation is not None and found.verdict not in ("noise_underestimated", "misfit_unlocated"):
        support.append(recommendation.sentence)
        short = recommendation.short
    if found.verdict in ("partial", "none_explains", "misfit_unlocated") and not found.begun_anew:
        support.append(
            "All fits started from the base fit, in which no parameter is pulled; each may be a local minimum."
        )
    if found.names_something or found.verdict in ("partial", "unconfirmed"):
        sure.append(_OUTSIDE)
    if assumed:
        sure.append(f"These results rest on an assumed standard deviation: {assumed}.")
    answer = Answer(words.found, " ".join(sure), f"{words.then} {short}".strip())
    return Verdict(answer, tuple(filter(None, (answer.found, answer.sure, words.then, *support))))


# -- parts of sentences ------------------------------------------------------------------------------------------------


def _without(found: Explanation) -> str:
    """How improbable the misfit of the base model would be if nothing were missing."""
    return f"If nothing were missing: {_family(found)}."


def _family(found: Explanation) -> str:
    """The tests of the base model, in words."""
    adequacy = found.base_adequacy
    local = f"{len(set(adequacy.perturbations.owners))} local perturbations"
    tested = sum(len(g.names) for g in found.groups)
    parts = [*([f"{tested} effect{'s' * (tested != 1)}"] if tested else []), local]
    parts += [] if adequacy.faults is None else [_faults(found)]
    counts = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else local
    return f"{p_words(adequacy.p_family)} for the largest score of {counts}, {p_words(adequacy.p_fit)} for {_WORST}"


def _with(found: Explanation, them: str = "it") -> str:
    """How well the data fit with the chosen effects, in words."""
    adequacy = found.chosen_adequacy
    assert adequacy is not None
    words = (
        f"With {them} no other effect or local perturbation stands out ({p_words(adequacy.p_family)}) and {_WORST} has "
        f"{p_words(adequacy.p_fit)}"
    )
    if adequacy.p_fit <= found.alpha:
        return (
            f"{words}, which is poor: the standard deviation may be larger than stated, or something more is missing."
        )
    return f"{words}."


def _row(effects: pd.DataFrame, name: str) -> pd.Series:
    return effects[effects["name"] == name].iloc[0]


def _magnitude(effects: pd.DataFrame, name: str) -> str:
    row = _row(effects, name)
    if not row["refitted"]:
        return f"with the signature of {str(row['confounded_with']).split(', ')[0]}"
    return interval_words(row["magnitude"], row["magnitude_low"], row["magnitude_high"], str(row["unit"]))


def _sized(effects: pd.DataFrame, e: Candidate) -> str:
    """An effect with its magnitude, such as ``a guy rope along x, about 12 kN/m (95 %: 10 to 14)``."""
    return f"{e.in_words}, {_magnitude(effects, e.name)}"


def _collinear(found: Explanation, effects: pd.DataFrame, chosen: CandidateFit) -> str:
    """Effects whose signatures are those of the chosen ones, in words."""
    out = []
    for e in chosen.effects:
        if len(chosen.effects) > 1:
            own = {n for g in found.groups if e.name in g.names for n in g.names} - {e.name}
            same = ", ".join(n for n in found.credible if n in own)
        else:
            same = str(_row(effects, e.name)["stands_for"])
        out += [f"Collinear with {e.name} in these data: {same}."] if same else []
    return " ".join(out)


def _look_for(effects: Sequence[Candidate], joint: str = " ") -> str:
    return f"Look for: {joint.join(_ended(e.look_for) for e in effects)}"


def _as_it_is(effects: Sequence[Candidate]) -> str:
    return "The model assumes: " + " ".join(_ended(e.lacks) for e in effects)


def _ended(words: str) -> str:
    """Text with a full stop at its end."""
    return words if words.endswith((".", "!", "?")) or not words else f"{words}."


# -- verdict by verdict ------------------------------------------------------------------------------------------------


def _nothing(found: Explanation, effects: pd.DataFrame) -> _Words:
    if not found.base_adequacy.can_tell:
        return _Words(
            "Nothing can be told: the fitted parameters follow these data, whatever may be missing.",
            f"They leave {max(found.base_adequacy.dof, 0.0):.1f} effective degrees of freedom, and below two no fit "
            "can be tested.",
            "Measure more modes or mode shapes, or hold parameters that are known, and ask again.",
        )
    sure = f"The data are as expected of a complete model: {_family(found)}."
    if found.groups and not effects["visible"].astype(bool).any():
        blind = "The base model fits, but these data cannot show any effect of the library at a plausible magnitude."
        return _Words(blind, sure, "Measure more before you conclude that nothing is missing.")
    fits = "The model fits: no missing effect is detectable in these data."
    return _Words(fits, sure, "Nothing calls for a change of the model.")


def _noise(found: Explanation, effects: pd.DataFrame) -> _Words:
    factor = f"{found.noise_scale:.2g}"
    return _Words(
        f"The standard deviation seems understated: the residuals of all modes are {factor} times too large.",
        f"With {factor} times the standard deviation nothing detectable is missing. {_without(found)}",
        "Check the standard deviation before anything else: repeats do not show what differs between set-ups, and an "
        "assumed one may be too small.",
    )


def _effect(found: Explanation, effects: pd.DataFrame) -> _Words:
    assert found.chosen is not None
    (e,) = found.chosen.effects
    tested = sum(len(g.names) for g in found.groups)
    chance = 100 * float(_row(effects, e.name)["model_probability"])
    probable = f"{chance:.0f} % probable" if chance <= MOST else f"more than {MOST:g} % probable"
    among = f" among the {tested} effects of the library" if tested > 1 else " within the library"
    return _Words(
        f"The model lacks {_sized(effects, e)}.",
        f"{e.name} is {probable}{among}. {_without(found)} {_with(found)}",
        _look_for((e,)),
        (_collinear(found, effects, found.chosen), _as_it_is((e,))),
    )


def _indistinguishable(found: Explanation, effects: pd.DataFrame) -> _Words:
    rows = effects[effects["name"].isin(found.credible)].sort_values("ln_bayes", ascending=False)
    known = {e.name: e for g in found.groups for e in g.effects}
    credible = [known[name] for name in rows["name"]]
    explaining = [(float(b), _sized(effects, e)) for e, b in zip(credible, rows["ln_bayes"], strict=True)]
    check = ""
    if found.fault is not None:
        told = f"a fault of the measurement: {fault_words(found.fault)}"
        explaining.append((found.ln_bayes(found.fault), told))
        check = "Or: " + " ".join(_ended(e.look_for) for e in found.fault.effects)
    if found.datum is not None:
        explaining.append((found.ln_bayes(found.datum), found.datum.told))
        check = f"Or measure the {found.datum.what} again."
    explaining.sort(key=lambda one: -one[0])
    ln_bayes = explaining[0][0] - explaining[1][0]
    named = "; or ".join(words for _, words in explaining)
    # Only a wrong measurement may be far ahead; an effect that far ahead would be named.
    if ln_bayes > RULES.credible:
        first = "A wrong measurement explains the misfit best"
    elif len(explaining) > len(rows):
        first = "Model or measurement is wrong, and these data cannot tell which"
    else:
        first = "The model lacks something, and these data cannot tell which"
    return _Words(
        f"{first}: {named}.",
        f"The odds of the first against the second are {as_ratio(ln_bayes)}. {_without(found)} {_with(found)}",
        f"{_look_for(credible, ' Or: ')} {check}".strip(),
        (_as_it_is(credible),),
    )


def _measurement(found: Explanation, effects: pd.DataFrame) -> _Words:
    assert found.fault is not None and found.fault_adequacy is not None
    (e,) = found.fault.effects
    first, *others = [fault_words(t) for t in found.blamed] or [fault_words(found.fault)]
    also = f" As well explained by: {'; '.join(others)}." if others else ""
    best = found.singles[0] if found.singles else None
    against = f" The best effect, {best.names[0]}, is {_behind(found, best)}." if best is not None else ""
    after = found.fault_adequacy
    return _Words(
        f"The measurement is what does not fit: {first}: {e.look_for[:1].lower()}{_ended(e.look_for)[1:]}{also}",
        f"Its log Bayes factor is {found.ln_bayes(found.fault):.1f} against the model without any fault or effect, "
        f"chosen among {_faults(found)}.{against} {_without(found)} With it nothing else stands out "
        f"({p_words(after.p_family)}) and {_WORST} has {p_words(after.p_fit)}.",
        "Correct the measurement, or take it out, before the model is changed; nothing is added to the model.",
        (f"It takes for granted: {_ended(e.lacks)}",),
    )


def _behind(found: Explanation, best: CandidateFit) -> str:
    """How much worse the best effect is than the named fault, in words."""
    assert found.fault is not None
    ln = found.fault.ln_evidence - best.ln_evidence
    return f"behind it by odds of {as_ratio(ln)}" if ln > 0 else "no better once the number of candidates is counted"


def _faults(found: Explanation) -> str:
    faults = found.base_adequacy.faults
    return f"{0 if faults is None else len(set(faults.owners))} faults of the measurement"


def _two(found: Explanation, effects: pd.DataFrame) -> _Words:
    assert found.chosen is not None
    phrases = []
    for e in found.chosen.effects:
        value, std = found.chosen.magnitude(e.name)
        ends = (max(value - WIDE * std, e.magnitude.lower), min(value + WIDE * std, e.magnitude.upper))
        phrases.append(f"{e.in_words}, {interval_words(value, *ends, e.magnitude.unit)}")
    return _Words(
        f"The model lacks two effects: {'; and '.join(phrases)}.",
        f"No single effect removes the systematic misfit. {_without(found)} {_with(found, 'both')}",
        _look_for(found.chosen.effects),
        (_collinear(found, effects, found.chosen), _as_it_is(found.chosen.effects)),
    )


def _unconfirmed(found: Explanation, effects: pd.DataFrame) -> _Words:
    assert found.chosen is not None
    named = " together with ".join(_sized(effects, e) for e in found.chosen.effects)
    if found.uncontested:
        against = "but no local perturbation could be tested against it, so a wrong name cannot be excluded"
        then = "Measure more modes or sensors before it is added."
    else:
        against = "but data that no fit has seen contradict it"
        then = "Check the held-out data: it stands in for something else, or they are in error."
    return _Words(f"No effect is confirmed: {named}, would fit, {against}.", _without(found), then)


def _rest(found: Explanation) -> str:
    """Local perturbation that fits a systematic misfit best, in words."""
    perturbation = found.perturbation
    if perturbation is None:
        return "Give a library with further effects."
    better = bool(found.groups) and (found.chosen is None or perturbation.ln_evidence > found.chosen.ln_evidence)
    words = "it fits better than every listed effect" if better else "it would help most"
    size = local_perturbation(perturbation).told
    return f"Look first at this place: {size}; {words}. It is a place to look at, not a cause."


def _partial(found: Explanation, effects: pd.DataFrame) -> _Words:
    assert found.chosen is not None and found.chosen_adequacy is not None
    (e,) = found.chosen.effects
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    return _Words(
        f"The model lacks something that no listed effect explains fully: {_sized(effects, e)}, is a part of it or "
        "stands in for something else.",
        f"It lowers the sum of squares from {before:.0f} to {after:.0f} but leaves "
        f"{p_words(found.chosen_adequacy.p_family)}. {_without(found)}",
        _rest(found),
    )


def _none(found: Explanation, effects: pd.DataFrame) -> _Words:
    what = "The model lacks something that no listed effect explains." if found.groups else "The model lacks something."
    attempt = ""
    if found.chosen is not None:
        (e,) = found.chosen.effects
        attempt = f"The best attempt, {_sized(effects, e)}, is not believed: {_why_not(found)}."
    return _Words(what, _without(found), _rest(found), (attempt,))


def _unlocated(found: Explanation, effects: pd.DataFrame) -> _Words:
    return _Words(
        "The model misses the data by more than their standard deviation, but no effect and no place stands out.",
        f"{_without(found)} The misfit is largest {where(found.base_adequacy)}.",
        "Look at that measurement first: its channel, its repeats, and whether its standard deviation is larger than "
        "stated.",
    )


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
            f"{float(after['expected']):.2f}, {p_words(float(after['p']))})"
        )
    return [
        f"Error in standard deviations: {', '.join(phrases)}. Either it stands in for something else, or these data "
        "are themselves in error: check them before it is added."
    ]


def _why_not(found: Explanation) -> str:
    """Why the best attempt is not named, in words; see `Explanation.refused`."""
    candidate_fit, adequacy = found.chosen, found.chosen_adequacy
    assert candidate_fit is not None and adequacy is not None
    return {
        "implausible": candidate_fit.implausible,
        "dof": f"it leaves {max(adequacy.dof, 0.0):.1f} effective degrees of freedom, and below two no fit can be "
        "tested",
        "misfit": f"what is left still has {p_words(min(adequacy.p_family, adequacy.p_fit))}",
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
