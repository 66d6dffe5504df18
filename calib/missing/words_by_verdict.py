"""Words of each verdict of an explanation: what was found, how sure that is, and what to do next."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pandas as pd

from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.goodness import p_words, where
from calib.missing.local import fault_words, local_perturbation, meaning_of, range_words
from calib.missing.partial import is_simpler_form, magnitude_range
from calib.missing.place import beyond_places
from calib.missing.recommendation import as_ratio
from calib.missing.rules import RULES
from calib.missing.steps_table import competing_sentence, steps_sentence
from calib.missing.verdict_words import (
    CANNOT_TELL,
    WORST,
    VerdictWords,
    as_it_is,
    collinear,
    effect_words,
    family,
    family_in_short,
    further,
    look_for,
    look_for_one_of,
    misfit_in_short,
    misfit_words,
    near_limit,
    on_measurement,
    row_of,
    with_in_short,
    with_words,
)
from calib.problem.candidate import Candidate

_DRAWN = 3.0
"""Plausible sizes beyond which a magnitude is said to be drawn down by its prior (assumed)."""
MOST = 99.0
"""Largest probability that is stated (%): the prior of the library is no surer."""


def _nothing(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    if not found.base_adequacy.can_tell:
        return VerdictWords(
            "Nothing can be told: the fitted parameters follow these data, whatever may be missing.",
            f"They leave {max(found.base_adequacy.dof, 0.0):.1f} effective degrees of freedom, and below two no fit "
            "can be tested.",
            "Measure more modes or mode shapes, or hold parameters that are known, and ask again.",
        )
    sure = f"The data are as expected of a complete model: {family_in_short(found)}."
    if found.base_adequacy.overstated and found.base_adequacy.p_family <= found.alpha:
        kinds = found.base_adequacy.kinds
        sure = (
            f"The sum of squares is {kinds['chi2'].sum():.0f} for {kinds['dof'].sum():.0f} degrees of freedom, less "
            "than independent errors of the stated standard deviation leave: that is an accuracy which neighbouring "
            f"values share, and their scores prove nothing ({p_words(found.base_adequacy.p_fit)} for {WORST})."
        )
    tested = (f"Tested: {family(found)}.",)
    if found.groups and not effects["visible"].astype(bool).any():
        blind = "The base model fits, but these data cannot show any listed cause at a plausible magnitude."
        return VerdictWords(blind, sure, "Measure more before you conclude that nothing is missing.", tested)
    fits, then = "The model fits: no missing effect is detectable in these data.", ["Nothing calls for a change of it."]
    near = near_limit(found, effects)
    if near:
        fits, then = (
            "The model fits, but only just: no missing effect is detectable in these data.",
            ["Nothing calls for a change of the model yet; more repeats would settle it."],
        )
    if found.base.implausible:
        then.append(f"Check what these parameters stand for: {found.base.implausible}.")
    return VerdictWords(fits, sure, " ".join(then), (*tested, *near))


def _noise(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    factor = f"{found.noise_scale:.2g}"
    return VerdictWords(
        f"The standard deviation seems understated: the residuals of all modes are {factor} times too large.",
        f"With {factor} times the standard deviation nothing detectable is missing. {misfit_in_short(found)}",
        "Check the standard deviation before anything else: repeats do not show what differs between set-ups, and an "
        "assumed one may be too small.",
        (misfit_words(found),),
    )


def _effect(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    assert found.chosen is not None
    (e,) = found.chosen.effects
    tested = sum(len(g.names) for g in found.groups)
    chance = 100 * float(row_of(effects, e.name)["model_probability"])
    probable = f"{chance:.0f} % probable" if chance <= MOST else f"more than {MOST:g} % probable"
    among = f"Among the {tested} causes tested" if tested > 1 else "Among those listed"
    return VerdictWords(
        f"The model lacks {effect_words(effects, e)}.",
        f"{among} it is {probable}. {misfit_in_short(found)} {with_in_short(found)}",
        look_for((e,)),
        (
            misfit_words(found),
            with_words(found),
            further(found.chosen),
            collinear(found, effects, found.chosen),
            as_it_is((e,)),
        ),
    )


def _indistinguishable(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    rows = effects[effects["name"].isin(found.credible)].sort_values("ln_bayes", ascending=False)
    known = {e.name: e for g in found.groups for e in g.effects}
    credible = [known[name] for name in rows["name"]]
    explaining = [(float(b), effect_words(effects, e)) for e, b in zip(credible, rows["ln_bayes"], strict=True)]
    alternatives, check = [*credible], ""
    if found.fault is not None:
        told = f"a measurement error: {fault_words(found.fault)}"
        explaining.append((found.ln_bayes(found.fault), told))
        alternatives += found.fault.effects
    if found.datum is not None:
        explaining.append((found.ln_bayes(found.datum), found.datum.in_words))
        check = f"Or measure the {found.datum.what} again."
    explaining.sort(key=lambda one: -one[0])
    ln_bayes = explaining[0][0] - explaining[1][0]
    named = "; or ".join(words for _, words in explaining)
    collinear_fault = found.fault is not None and found.fault_adequacy is not None
    alike = (
        "Their change patterns are nearly collinear: the odds rest on the exact form of each."
        if collinear_fault
        else ""
    )
    # Only a wrong measurement may be far ahead; an effect that far ahead would be named.
    if ln_bayes > RULES.credible and not collinear_fault:
        first = "A wrong measurement explains the misfit best"
    elif len(explaining) > len(rows):
        first = CANNOT_TELL
    else:
        first = "The model lacks something, and these data cannot tell which"
    return VerdictWords(
        f"{first}: {named}.",
        f"The odds of the first against the second are {as_ratio(ln_bayes)}. {misfit_in_short(found)} "
        f"{with_in_short(found)}",
        f"{look_for_one_of(alternatives)} {check}".strip(),
        (alike, misfit_words(found), with_words(found), as_it_is(credible)),
    )


_NUMBERS = {2: "two", 3: "three", 4: "four"}


def _several(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    assert found.chosen is not None
    phrases = [effect_words(effects, e) for e in found.chosen.effects]
    count = len(phrases)
    named = f"The model lacks {_NUMBERS[count]} effects: {'; '.join(phrases[:-1])}; and {phrases[-1]}."
    fewer = "No single effect removes" if count == 2 else "No single effect and no pair removes"
    them = "both" if count == 2 else f"all {_NUMBERS[count]}"
    return VerdictWords(
        f"{named} {competing_sentence(found)}".strip(),
        f"{fewer} the systematic misfit. {misfit_in_short(found)} {with_in_short(found, them)}",
        look_for(found.chosen.effects),
        (
            misfit_words(found),
            with_words(found, them),
            collinear(found, effects, found.chosen),
            as_it_is(found.chosen.effects),
        ),
    )


def _unconfirmed(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    assert found.chosen is not None
    named = " together with ".join(effect_words(effects, e) for e in found.chosen.effects)
    if found.uncontested:
        against = "but no local stiffness or mass change could be tested against it, so a wrong name cannot be excluded"
        then = "Measure more modes or sensors before it is added."
    else:
        against = "but data that no fit has seen contradict it"
        then = "Check the validation data: it stands in for something else, or they are in error."
    return VerdictWords(
        f"No effect is confirmed: {named}, would fit, {against}.", misfit_in_short(found), then, (misfit_words(found),)
    )


def _rest(found: Explanation) -> str:
    """The place to look at, in words; that there is none where the data single out no local perturbation."""
    perturbation = found.place
    if perturbation is None:
        none = "No single place explains it. " if found.perturbation is not None else ""
        return f"{none}Give a list with further causes."
    better = bool(found.groups) and (found.chosen is None or perturbation.ln_evidence > found.chosen.ln_evidence)
    words = "it fits better than every listed effect" if better else "of all single places it helps most"
    size = local_perturbation(perturbation).in_words
    return f"Look first at this place: {size}; {words}. It is a place to look at, not a cause."


def _partial(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    assert found.chosen is not None and found.chosen_adequacy is not None
    (e,) = found.chosen.effects
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    if is_simpler_form(found):
        return _nearly(found, e)
    it = effect_words(effects, e, believed=False)
    return VerdictWords(
        f"The model lacks something that no listed effect explains fully: {it}, is a part of it or stands in for "
        "something else.",
        f"It lowers the sum of squares from {before:.0f} to {after:.0f}. {with_in_short(found)}"
        f"{_drawn(found.chosen, e)} {misfit_in_short(found)}",
        "Look first where it acts. No single place explains it." if beyond_places(found) else _rest(found),
        (misfit_words(found), steps_sentence(found)),
    )


def _drawn(candidate_fit: CandidateFit, e: Candidate) -> str:
    """That its plausible size draws a magnitude down, with a space before it; empty where it hardly does."""
    times = abs(e.magnitude.pull(candidate_fit.fit.values[e.name])) if e.magnitude.prior_kind == "normal" else 0.0
    return f" Its magnitude is {times:.0f} times its plausible size, which draws it down." if times > _DRAWN else ""


def _nearly(found: Explanation, e: Candidate) -> VerdictWords:
    assert found.chosen is not None and found.chosen_adequacy is not None
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    low, high = magnitude_range(found)
    location = where(found.chosen_adequacy)
    return VerdictWords(
        f"The model lacks something like {e.in_words}, but not exactly that; as it is listed it "
        f"would be {range_words(low, high, e.magnitude.unit, meaning_of(e.magnitude))}.",
        f"It lowers the sum of squares from {before:.0f} to {after:.0f}, far more than anything else does. "
        f"{with_in_short(found)} {misfit_in_short(found)} A further, much smaller effect is "
        "possible too.",
        look_for((e,)),
        (misfit_words(found), f"What is left is largest {location}." if location else "", steps_sentence(found)),
    )


def _none(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    what = "The model lacks something that no listed effect explains." if found.groups else "The model lacks something."
    attempt = ""
    if found.chosen is not None:
        (e,) = found.chosen.effects
        attempt = f"The best attempt, {effect_words(effects, e, believed=False)}, is not believed: {_why_not(found)}."
    return VerdictWords(
        what, misfit_in_short(found), _rest(found), (misfit_words(found), attempt, steps_sentence(found))
    )


def _unlocated(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    return VerdictWords(
        "The model misses the data by more than their standard deviation, but no effect and no place stands out.",
        f"{misfit_in_short(found)} The misfit is largest {where(found.base_adequacy)}.",
        "Look at that measurement first: its channel, its repeats, and whether its standard deviation is larger than "
        "stated.",
        (misfit_words(found),),
    )


def _why_not(found: Explanation) -> str:
    """Why the best attempt is not named, in words; see `Explanation.refused`."""
    candidate_fit, adequacy = found.chosen, found.chosen_adequacy
    assert candidate_fit is not None and adequacy is not None
    return {
        "implausible": candidate_fit.implausible,
        "dof": f"it leaves {max(adequacy.dof, 0.0):.1f} effective degrees of freedom, and below two no fit can be "
        "tested",
        "misfit": f"what is left still has {p_words(min(adequacy.p_family, adequacy.p_fit))}",
        "local_perturbation": "a local stiffness or mass change fits better",
        "evidence": "the evidence for it is too weak among so many candidates",
    }[found.refused]


WORDS: Mapping[str, Callable[[Explanation, pd.DataFrame], VerdictWords]] = {
    "nothing_detectable": _nothing,
    "noise_underestimated": _noise,
    "effect": _effect,
    "indistinguishable": _indistinguishable,
    "two_effects": _several,
    "several_effects": _several,
    "measurement": on_measurement,
    "unconfirmed": _unconfirmed,
    "partial": _partial,
    "none_explains": _none,
    "misfit_unlocated": _unlocated,
}
"""What composes the words, by verdict."""
