"""Verdict of an explanation in sentences: what is missing, how sure that is, what to do next, and what supports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

from calib.missing.data_words import contradicted_words, error_words, unseen_words
from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.goodness import p_words, where, worst_repeats
from calib.missing.local import fault_words, local_perturbation, meaning_of, range_words
from calib.missing.partial import is_simpler_form, magnitude_range
from calib.missing.recommendation import Recommendation, as_ratio
from calib.missing.rules import RULES
from calib.missing.steps_table import competing_sentence, steps_sentence
from calib.missing.suspect import suspect_in_short, suspect_sentence
from calib.missing.verdict_words import (
    CANNOT_TELL,
    WORST,
    VerdictWords,
    as_it_is,
    beside_faults,
    check_faults,
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
from calib.results.answer import Answer

_REPEATS = 3
"""Largest number of repeats named in a sentence."""


MOST = 99.0
"""Largest probability that is stated (%): the prior of the library is no surer."""

_OUTSIDE = "An effect outside the library cannot be excluded."


class Doubts(NamedTuple):
    """What looks wrong in the measurement itself, seen without a fit; `calib compare` tells the same.

    Attributes
    ----------
    sentences : tuple of str
    checks : tuple of str
        What to check, such as ``sensor 12y``.
    """

    sentences: tuple[str, ...] = ()
    checks: tuple[str, ...] = ()


NO_DOUBTS = Doubts()


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


def verdict_of(
    found: Explanation,
    effects: pd.DataFrame,
    errors: pd.DataFrame,
    recommendation: Recommendation | None = None,
    disagreements: pd.DataFrame | None = None,
    assumed: str = "",
    supposed: Sequence[str] = (),
    pointed: str = "",
    doubts: Doubts = NO_DOUBTS,
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
    supposed : sequence of str
        What the covariance of the residual has beside the measurement, in sentences.
    pointed : str
        Where the data point to, in words; see `calib.missing.verdict_words.elsewhere`.
    doubts : Doubts
        What looks wrong in the measurement itself, before any fit. It comes first, unless the data fit.
    """
    words = {
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
    }[found.verdict](found, effects)
    sure, support = [words.sure], list(words.support)
    if found.verdict == "misfit_unlocated" and disagreements is not None:
        repeats = worst_repeats(found.base_adequacy, disagreements)[:_REPEATS]
        support.append("Repeats that disagree with the others: " + ", ".join(repeats) + "." if repeats else "")
    if found.noise_scale != 1 and found.verdict != "noise_underestimated":
        sure.append(f"The standard deviation was taken {found.noise_scale:.2g} times as large as stated.")
    if found.names_something:
        support += error_words(errors)
    if found.verdict == "unconfirmed":
        support += contradicted_words(errors)
    support += unseen_words(effects, found.chosen.names if found.names_something and found.chosen is not None else ())
    short = ""
    if recommendation is not None and found.verdict not in ("noise_underestimated", "misfit_unlocated"):
        support.append(recommendation.sentence)
        short = recommendation.short
    if found.base_starts:
        points = "a further point" if found.base_starts == 1 else f"{found.base_starts} further points"
        support.append(f"The base model, rejected or pulled at first, was fitted from {points} too.")
    if found.verdict in UNEXPLAINED and not found.begun_anew:
        support.append(
            "All fits started from the base fit, in which no parameter is pulled; each may be a local minimum."
        )
    if found.names_something or found.verdict in ("partial", "unconfirmed"):
        sure.append(_OUTSIDE)
    if found.verdict == "effect" and found.chosen is not None:
        sure.append(suspect_in_short(found.suspects, found.chosen.names[0]))
        support.insert(0, suspect_sentence(found.suspects, found.chosen.names[0]))
    if assumed:
        sure.append(f"These results rest on an assumed standard deviation: {assumed}.")
    sure += supposed
    if (found.names_something and not found.remains) or found.verdict == "nothing_detectable":
        doubts = NO_DOUBTS  # with a gross error in them the data would not fit
    headline = " ".join(filter(None, (*doubts.sentences, words.found, beside_faults(found))))
    check = f"Check first: {'; '.join(doubts.checks)}." if doubts.checks else ""
    then = (check, words.then, check_faults(found), pointed, short)
    answer = Answer(headline, *(" ".join(filter(None, some)) for some in (sure, then)))
    return Verdict(answer, tuple(filter(None, (answer.found, answer.sure, words.then, pointed, *support))))


# -- verdict by verdict ------------------------------------------------------------------------------------------------


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
        blind = "The base model fits, but these data cannot show any effect of the library at a plausible magnitude."
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
    among = f" among the {tested} effects of the library" if tested > 1 else " within the library"
    return VerdictWords(
        f"The model lacks {effect_words(effects, e)}.",
        f"{e.name} is {probable}{among}. {misfit_in_short(found)} {with_in_short(found)}",
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
        told = f"a fault of the measurement: {fault_words(found.fault)}"
        explaining.append((found.ln_bayes(found.fault), told))
        alternatives += found.fault.effects
    if found.datum is not None:
        explaining.append((found.ln_bayes(found.datum), found.datum.in_words))
        check = f"Or measure the {found.datum.what} again."
    explaining.sort(key=lambda one: -one[0])
    ln_bayes = explaining[0][0] - explaining[1][0]
    named = "; or ".join(words for _, words in explaining)
    collinear_fault = found.fault is not None and found.fault_adequacy is not None
    alike = "Their signatures are nearly collinear: the odds rest on the exact form of each." if collinear_fault else ""
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
        against = "but no local perturbation could be tested against it, so a wrong name cannot be excluded"
        then = "Measure more modes or sensors before it is added."
    else:
        against = "but data that no fit has seen contradict it"
        then = "Check the held-out data: it stands in for something else, or they are in error."
    return VerdictWords(
        f"No effect is confirmed: {named}, would fit, {against}.", misfit_in_short(found), then, (misfit_words(found),)
    )


def _rest(found: Explanation) -> str:
    """The place to look at, in words; that there is none where the data single out no local perturbation."""
    perturbation = found.place
    if perturbation is None:
        none = "No single place explains it. " if found.perturbation is not None else ""
        return f"{none}Give a library with further effects."
    better = bool(found.groups) and (found.chosen is None or perturbation.ln_evidence > found.chosen.ln_evidence)
    words = "it fits better than every listed effect" if better else "it would help most"
    size = local_perturbation(perturbation).in_words
    return f"Look first at this place: {size}; {words}. It is a place to look at, not a cause."


def _partial(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    assert found.chosen is not None and found.chosen_adequacy is not None
    (e,) = found.chosen.effects
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    if is_simpler_form(found):
        return _nearly(found, e)
    return VerdictWords(
        f"The model lacks something that no listed effect explains fully: {effect_words(effects, e)}, is a part of it "
        "or stands in for something else.",
        f"It lowers the sum of squares from {before:.0f} to {after:.0f} but leaves "
        f"{p_words(found.chosen_adequacy.p_family)}. {misfit_in_short(found)}",
        _rest(found),
        (misfit_words(found), steps_sentence(found)),
    )


def _nearly(found: Explanation, e: Candidate) -> VerdictWords:
    assert found.chosen is not None and found.chosen_adequacy is not None
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    low, high = magnitude_range(found)
    location = where(found.chosen_adequacy)
    return VerdictWords(
        f"The model lacks something like {e.in_words}, but not exactly that; in the form that the library lists it "
        f"would be {range_words(low, high, e.magnitude.unit, meaning_of(e.magnitude))}.",
        f"It lowers the sum of squares from {before:.0f} to {after:.0f}, far more than anything else does, but leaves "
        f"{p_words(found.chosen_adequacy.p_family)}. {misfit_in_short(found)} A further, much smaller effect is "
        "possible too.",
        look_for((e,)),
        (misfit_words(found), f"What is left is largest {location}." if location else "", steps_sentence(found)),
    )


def _none(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    what = "The model lacks something that no listed effect explains." if found.groups else "The model lacks something."
    attempt = ""
    if found.chosen is not None:
        (e,) = found.chosen.effects
        attempt = f"The best attempt, {effect_words(effects, e)}, is not believed: {_why_not(found)}."
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
        "local_perturbation": "a local perturbation fits better",
        "evidence": "the evidence for it is too weak among so many candidates",
    }[found.refused]
