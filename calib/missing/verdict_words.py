"""Words that the verdicts of an explanation share."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.inference.rules import WIDE
from calib.missing.candidate_fit import AdequacyTests, CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.facts import Places
from calib.missing.goodness import p_words
from calib.missing.local import fault_words, local_perturbation, magnitude_words
from calib.missing.plausible import limit_of
from calib.missing.recommendation import as_ratio, rounded
from calib.missing.rules import RULES
from calib.missing.score import noise_limit
from calib.problem.candidate import Candidate
from calib.problem.effect import Effect
from calib.problem.parameter import unit_words
from calib.results.answer import in_prose, names_in_words

_QUESTIONS = ("Whether", "Where", "How", "Which", "What")
"""First words of a text to look for that is a question."""
_REQUESTS = ("Look", "Check", "Measure")
"""First words of a text to look for that is a request already."""
CANNOT_TELL = "Model or measurement is wrong, and these data cannot tell which"
KINDS = {"freq": "frequencies", "frequency": "frequencies", "shape": "mode shapes", "frf": "FRFs"}
"""Kinds of data in words, where these differ from the names in tables."""
WORST = "the worst kind of data or mode shape"
"""What the p-value of a fit is of, corrected for their number; see `calib.missing.goodness.overall`."""


@dataclass(frozen=True)
class VerdictWords:
    """What one kind of verdict says, ``sure`` in short and ``support`` in full; ``then`` is to do before measuring."""

    found: str
    sure: str
    then: str = ""
    support: tuple[str, ...] = ()


def near_limit(found: Explanation, effects: pd.DataFrame) -> tuple[str, ...]:
    """What a test that was nearly failed says and does not say; empty where it was not near.

    The largest score with the limit that so many candidates have, how much of it is due to the faults of the
    measurement, and from which magnitude on each effect would have been seen.
    """
    tests = found.base_adequacy
    if not found.alpha < tests.p_family <= RULES.near_limit:
        return ()
    families = [tests.named, tests.perturbations, *([] if tests.faults is None else [tests.faults])]
    scores = [np.where(family.size > 0, family.magnitude, np.nan) for family in families]
    owners = [name for family in families for name in family.owners]
    every = np.concatenate(scores)
    if not np.isfinite(every).any():
        return ()
    largest, without = int(np.nanargmax(every)), noise_limit(np.concatenate(scores[:2]))
    words = (
        f"The largest score is {every[largest]:.1f} ({owners[largest]}); noise alone gives one of {len(owners)} "
        f"candidates more than {noise_limit(every):.1f} in {100 * RULES.noise_level:.0f} % of all cases"
    )
    if tests.faults is not None:
        words += f", and {without:.1f} without the {_counts(found)[2]} measurement errors among them"
    seen = effects[effects["visible"].astype(bool) & effects["magnitude_min"].notna()]
    least = ", ".join(f"{r['name']} from {rounded(float(r['magnitude_min']))}{unit_words(str(r['unit']))}"
                      for r in seen.to_dict("records"))  # fmt: skip
    visible = f"Would have been seen with a chance of 90 %: {least}; what is smaller would not." if least else ""
    return (f"{words}.", visible)


def misfit_words(found: Explanation) -> str:
    """How improbable the misfit of the base model is where nothing is missing."""
    return f"Chance of such a misfit by noise alone, with {_supposed(found)}: {family(found)}."


def misfit_in_short(found: Explanation) -> str:
    """The same for the summary: what was tried, and what the data make of it."""
    return f"With {_supposed(found)}, a misfit like this has {family_in_short(found)}."


def _supposed(found: Explanation) -> str:
    return "only the measurement wrong so" if found.granted else "nothing missing"


def family_in_short(found: Explanation) -> str:
    """The two tests of the base model: what the best change tried gains, and how badly the worst kind of data fits."""
    adequacy = found.base_adequacy
    causes, perturbations, errors = _counts(found)
    errors += 0 if adequacy.pairs is None else adequacy.pairs.number
    tried = {"listed causes": causes, "stiffness or mass at single places": perturbations, "measurement errors": errors}
    number = sum(tried.values())
    worst = f"{p_words(adequacy.p_fit)} ({_worst_of(adequacy)})"
    if not number:
        return worst
    words = names_in_words([what for what, count in tried.items() if count])
    best = f"the largest gain of {number} changes tried" if number > 1 else "the gain of the one change tried"
    return f"{p_words(adequacy.p_family)} ({best}: {words}) and {worst}"


def _worst_of(adequacy: AdequacyTests) -> str:
    """The group of data whose p-value is told, in words."""
    kinds = [KINDS.get(kind, kind) for kind in adequacy.kinds["kind"]]
    return f"the worst of {names_in_words(kinds)}, corrected for their number" if len(kinds) > 1 else "the data"


def with_in_short(found: Explanation, them: str = "it") -> str:
    """How well the data fit with the chosen effects, for the summary."""
    assert found.chosen_adequacy is not None
    return fit_in_short(found.chosen_adequacy, found.alpha, them)


def fit_in_short(adequacy: AdequacyTests, alpha: float, them: str = "it") -> str:
    """The two tests of a fit: the largest score, and the worst kind of data."""
    if adequacy.p_family <= alpha and not adequacy.overstated:
        return f"With {them} something is left ({p_words(adequacy.p_family)} for the largest score)."
    if adequacy.p_family <= alpha:
        return f"With {them} the data fit better than independent errors of their standard deviations would."
    rest = "but what remains is more than noise" if adequacy.p_fit <= alpha else "and what remains may be noise"
    return (
        f"With {them} no further cause or place stands out ({p_words(adequacy.p_family)}), {rest} "
        f"({p_words(adequacy.p_fit)} for {_worst_of(adequacy)}; limit {alpha:g})."
    )


def family(found: Explanation) -> str:
    """The tests of the base model, in words."""
    adequacy = found.base_adequacy
    tested, perturbations, _ = _counts(found)
    local = f"{perturbations} local stiffness or mass changes"
    parts = [*([f"{tested} effect{'s' * (tested != 1)}"] if tested else []), local]
    parts += [] if adequacy.faults is None else [counted_faults(found)]
    largest = f"{p_words(adequacy.p_family)} for the largest score of {names_in_words(parts)}"
    return f"{largest}, {p_words(adequacy.p_fit)} for {WORST}"


def with_words(found: Explanation, them: str = "it") -> str:
    """How well the data fit with the chosen effects, in words."""
    adequacy = found.chosen_adequacy
    assert adequacy is not None
    if adequacy.p_family <= found.alpha:
        return fit_in_short(adequacy, found.alpha, them)
    words = (
        f"With {them} no other effect or local stiffness or mass change stands out ({p_words(adequacy.p_family)}) "
        f"and {WORST} has {p_words(adequacy.p_fit)}"
    )
    if adequacy.p_fit <= found.alpha:
        return (
            f"{words}, which is poor: the standard deviation may be larger than stated, or something more is missing."
        )
    return f"{words} ({found.alpha:g} or less would be poor)."


def limits_sentence(found: Explanation) -> str:
    """Parameters that end at a limit in the model with the named effects, in a sentence; empty for none.

    A hard limit acts like a datum, and an effect may stand in for what it keeps a parameter from.
    """
    if not found.names_something or found.chosen is None:
        return ""
    fit, own = found.chosen.fit, {name for effect in found.chosen.effects for name in effect.names}
    held = [name for name in fit.names if name not in own and limit_of(fit, fit.fit_problem.space[name]) is not None]
    if not held:
        return ""
    if len(held) == 1:
        return f"{held[0]} ends at its search limit: unless that is a physical one, widen it and explain again."
    return (
        f"{names_in_words(held)} end at their search limits: unless these are physical ones, widen them and explain "
        "again."
    )


def row_of(effects: pd.DataFrame, name: str) -> pd.Series:
    """Row of an effect."""
    return effects[effects["name"] == name].iloc[0]


def effect_words(effects: pd.DataFrame, e: Candidate, believed: bool = True) -> str:
    """An effect with its magnitude, such as ``a guy rope along x, about 12 kN/m (95 %: 10 to 14)``.

    Of an effect that was not fitted, the one that it is collinear with. One that is not believed has no interval, which
    would hold only if it were what is missing.
    """
    row = row_of(effects, e.name)
    if not row["refitted"]:
        return f"{e.in_words}, with the change pattern of {str(row['confounded_with']).split(', ')[0]}"
    ends = (float(row["magnitude_low"]), float(row["magnitude_high"])) if believed else (math.nan, math.nan)
    return f"{e.in_words}, {magnitude_words(e.magnitude, float(row['magnitude']), *ends)}"


def further(chosen: CandidateFit) -> str:
    """What the chosen effects have beside their magnitudes, as fitted, with 95 % intervals; empty for nothing."""
    out = []
    for q in (q for e in chosen.effects for q in e.parameters if q.name != e.name and q.name in chosen.fit.names):
        value, k = chosen.fit.values[q.name], chosen.fit.names.index(q.name)
        reach = WIDE * float(chosen.fit.std[k])
        low, high = max(value - reach, q.lower), min(value + reach, q.upper)
        out.append(f"{q.name}: {magnitude_words(q, value, low, high)}.")
    return " ".join(out)


def collinear(found: Explanation, effects: pd.DataFrame, chosen: CandidateFit) -> str:
    """Effects whose signatures are those of the chosen ones, in words."""
    out = []
    for e in chosen.effects:
        if len(chosen.effects) > 1:
            competing = () if found.steps is None else found.steps.competing
            own = {n for g in found.groups if e.name in g.names for n in g.names} - {e.name, *(r for _, r in competing)}
            same = ", ".join(n for n in found.credible if n in own)
        else:
            same = str(row_of(effects, e.name)["stands_for"])
        out += [f"Collinear with {e.name} in these data: {same}."] if same else []
    return " ".join(out)


def look_for(effects: Sequence[Candidate]) -> str:
    """What to look for on the structure, for effects that act together."""
    return " ".join(map(_request, effects))


def look_for_one_of(effects: Sequence[Candidate]) -> str:
    """What to look for on the structure or to check of the measurement, for alternatives."""
    first, *others = map(_request, effects)
    return " ".join([first, *(f"Or {lowered(words)}" for words in others)])


def _request(e: Candidate) -> str:
    """What an effect asks for, such as `Look for a cracked weld.` or `Check whether the brakes are released.`."""
    first, words = e.look_for.split(" ", 1)[0], with_full_stop(e.look_for)
    if first in _REQUESTS:
        return words
    return f"{'Check' if first in _QUESTIONS else 'Look for'} {lowered(words)}"


def lowered(words: str) -> str:
    """A sentence as it continues another: an abbreviation, or a name such as ``E2``, keeps its capital."""
    return f"{words[:1].lower()}{words[1:]}" if words[1:2].islower() or words[1:2] == " " else words


def elsewhere(
    found: Explanation,
    places: Places,
    acting: Sequence[tuple[float, float, float]],
) -> str:
    """The sensor at which a local perturbation fits best, where the named effect acts somewhere else; in words.

    Empty for a verdict other than one effect, an effect whose place is fitted or unknown, perturbations that noise may
    explain, or a best one that is a part. Elsewhere is further from the effect than the sensor nearest to it.

    Parameters
    ----------
    found : Explanation
    places : mapping from str to (kind, (x, y, z), sensor)
        Of every local perturbation, by name; m.
    acting : sequence of (x, y, z)
        Where the effect acts, m; empty where that is unknown.
    """
    scores, chosen = found.base_adequacy.perturbations, found.chosen
    if found.verdict != "effect" or chosen is None or not len(acting) or not len(scores.owners):
        return ""
    fitted_place = any(isinstance(e, Effect) and e.places for e in chosen.effects)
    best = scores.owners[int(np.argmax(scores.magnitude))]
    at_sensors = {name: places[name][1] for name in scores.owners if name in places and places[name][2]}
    if fitted_place or best not in at_sensors or found.base_adequacy.p_perturbations > found.alpha:
        return ""
    away = {name: min(math.dist(at, own) for own in acting) for name, at in at_sensors.items()}
    known = [distance for distance in away.values() if math.isfinite(distance)]
    if not known or not away[best] > min(known):
        return ""
    named, what = found.base_adequacy.named, in_prose(chosen.names[0])
    own = max((s for n, s in zip(named.owners, named.magnitude, strict=True) if n == chosen.names[0]), default=0.0)
    less = f" (less well than the {what})" if own > scores.magnitude.max() else ""
    assumed, away_by = f"The list of causes assumes where the {what} is", f"{away[best]:.2g} m away"
    return f"{assumed}. Of single masses or springs anywhere, {best} fits best{less}, {away_by}: inspect both places."


def as_it_is(effects: Sequence[Candidate]) -> str:
    """What the model assumes without the effects."""
    return "The model assumes: " + " ".join(with_full_stop(e.lacks) for e in effects)


def with_full_stop(words: str) -> str:
    """Text with a full stop at its end."""
    return words if words.endswith((".", "!", "?")) or not words else f"{words}."


def counted_faults(found: Explanation) -> str:
    """Number of faults of the measurement that were tested, with that of pairs."""
    pairs = found.base_adequacy.pairs
    also = "" if pairs is None else f" ({pairs.number} more of pairs of channels or modes)"
    return f"{_counts(found)[2]} measurement errors{also}"


def _counts(found: Explanation) -> tuple[int, int, int]:
    """Number of effects, of local perturbations and of faults of the measurement that were tested."""
    tests = found.base_adequacy
    faults = 0 if tests.faults is None else len(set(tests.faults.owners))
    return sum(len(g.names) for g in found.groups), len(set(tests.perturbations.owners)), faults


def on_measurement(found: Explanation, effects: pd.DataFrame) -> VerdictWords:
    """A fault of the measurement is named, or several are: which, how sure that is, what to check."""
    if found.granted:
        return _faults_together(found)
    assert found.fault is not None and found.fault_adequacy is not None
    (e,) = found.fault.effects
    first, *others = [fault_words(t) for t in found.blamed] or [fault_words(found.fault)]
    also = f" As well explained by: {'; '.join(others)}." if others else ""
    check, left = lowered(with_full_stop(e.look_for)), "Something may be left besides." if found.remains else ""
    if found.place is not None:
        told = f"{CANNOT_TELL}: {first}; or {local_perturbation(found.place).in_words}: {check}{also}"
    elif found.remains:
        told = f"The measurement first: {first}: {check}{also}"
    else:
        told = f"The measurement is what does not fit: {first}: {check}{also}"
    best = found.singles[0] if found.singles else None
    against = f" The best effect, {best.names[0]}, is {_behind(found, best)}." if best is not None else ""
    after = found.fault_adequacy
    again = " Then explain again." if found.remains else ""
    return VerdictWords(
        f"{told} {left}".strip(),
        f"Its log Bayes factor is {found.ln_bayes(found.fault):.1f} against the model without any error or cause, "
        f"chosen among {counted_faults(found)}.{against} {misfit_in_short(found)} "
        f"{fit_in_short(after, found.alpha)}",
        f"Correct the measurement, or take it out, before the model is changed; nothing is added to the model.{again}",
        (
            misfit_words(found),
            ""
            if found.remains
            else f"With it no effect or place stands out ({p_words(after.p_family)}), and {WORST} "
            f"has {p_words(after.p_fit)}.",
            f"It takes for granted: {with_full_stop(e.lacks)}",
        ),
    )


def _faults_together(found: Explanation) -> VerdictWords:
    """Several faults of the measurement, or one that is needed beside others, with nothing left over."""
    phrases = [fault_words(one, fault) for fault, one in found.faulty]
    checks = _checks([fault for fault, _ in found.faulty])
    after = found.base_adequacy if found.fault is None else found.fault_adequacy
    assert after is not None
    them = "it" if len(phrases) == 1 else "them"
    return VerdictWords(
        f"The measurement is what does not fit: {'; and '.join(phrases)}. {instead_of_faults(found)}".strip(),
        f"Each is needed beside the other{'s' if len(phrases) > 2 else ''}. {fit_in_short(after, found.alpha, them)}",
        f"{checks} Correct the measurement, or take it out, before the model is changed; nothing is added to it.",
        (misfit_words(found),),
    )


def beside_faults(found: Explanation) -> str:
    """Faults of the measurement that are told beside effects, or that may be in the place of one; empty without any."""
    if not found.names_something:
        return ""
    if not found.granted:
        return instead_of_faults(found)
    phrases = "; and ".join(fault_words(found.last, fault) for fault in found.granted)
    return f"The measurement does not fit either: {phrases}. {instead_of_faults(found)}".strip()


def check_faults(found: Explanation) -> str:
    """What to check of the measurement, for the faults that are told beside effects; empty without any."""
    if not (found.granted and found.names_something):
        return ""
    return _checks(found.granted)


def _checks(faults: Sequence[Candidate]) -> str:
    """What to check of several faults of the measurement, each check once, in the plural where several need it."""
    asked = Counter(with_full_stop(fault.look_for) for fault in faults)
    return " ".join(_PLURAL.sub(lambda own: _OF_SEVERAL[own[0]], one) if n > 1 else one for one, n in asked.items())


_OF_SEVERAL = {"its": "their", "it is": "they are", "it sits": "they sit"}
_PLURAL = re.compile(r"\b(?:it sits|it is|its)\b")


def instead_of_faults(found: Explanation) -> str:
    """Effects or faults that explain about as well in the place of a fault that is told, or the reverse, in words."""
    others = {first: " or ".join(b for a, b in found.mistakable if a == first) for first, _ in found.mistakable}
    return " ".join(
        f"In the place of {first}, {other} explains about as well: these data cannot tell which."
        for first, other in others.items()
    )


def _behind(found: Explanation, best: CandidateFit) -> str:
    """How much worse the best effect is than the named fault, in words."""
    assert found.fault is not None
    ln = found.fault.ln_evidence - best.ln_evidence
    return f"behind it by odds of {as_ratio(ln)}" if ln > 0 else "no better once the number of candidates is counted"
