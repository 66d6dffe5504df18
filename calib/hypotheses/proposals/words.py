"""Proposals as a table and in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from calib.hypotheses.proposals.proposal import Proposal, Proposals, composition_words
from calib.missing.goodness import p_words
from calib.missing.local import fault_words, interval_words
from calib.problem.candidate import Candidate
from calib.results.answer import Answer

COLUMNS = (
    "rank", "name", "kind", "at", "x", "y", "z", "magnitude", "lower", "upper", "unit", "freq", "evidence", "ln_bayes",
    "score", "choices", "close", "implausible", "alike", "title",
)  # fmt: skip


def proposals_table(found: Proposals) -> pd.DataFrame:
    """One row per proposal, best first; `docs/tables.toml` lists the columns of ``proposals.csv``."""
    rows = []
    for rank, p in enumerate(found.ranked, 1):
        effect, values = p.composed.effect, p.candidate_fit.fit.values
        freq = values[effect.nuisance[0].name] if effect.nuisance else math.nan
        unit, factor = _told_in(effect)
        alike = "; ".join(map(composition_words, p.alike))
        rows.append((
            rank, effect.name, p.composed.kind, p.composed.at, *p.composed.place,
            factor * p.value, factor * p.low, factor * p.high, unit, freq, p.evidence, p.ln_bayes, p.score, p.choices,
            p in found.close, p.candidate_fit.implausible, alike, effect.title,
        ))  # fmt: skip
    return pd.DataFrame(rows, columns=list(COLUMNS))


PLACES = ("rank", "kind", "at", "fitted", "close", "evidence", "x", "y", "z")


def proposed_places_table(found: Proposals) -> pd.DataFrame:
    """One row per place of every proposal, and of compositions alike: the columns of ``proposal_places.csv``."""
    rows = []
    for rank, p in enumerate(found.ranked, 1):
        close = p in found.close
        rows += [(rank, p.composed.kind, p.composed.at, True, close, p.evidence, *at) for at in p.composed.places]
        for other in p.alike:
            rows += [(rank, other.kind, other.at, False, close, math.nan, *at) for at in other.places]
    return pd.DataFrame(rows, columns=list(PLACES))


def lost_words(found: Proposals) -> tuple[str, ...]:
    """What could not be fitted, in a sentence."""
    if not found.lost:
        return ()
    first, count = found.lost[0], len(found.lost)
    title = f"{first.title[:1].lower()}{first.title[1:]}"
    others = f", and {count - 1} more (see proposals.json)" if count > 1 else ""
    return (f"Not fitted: {title} ({first.reason}){others}.",)


def proposal_words(p: Proposal) -> str:
    """A proposal in words, such as ``a mass at node 3, about 0.26 kg (95 %: 0.24 to 0.27)``."""
    effect: Candidate = p.composed.effect
    unit, factor = _told_in(effect)
    sign = ""
    if unit == "%":
        sign, factor = (" less" if p.value < 0 else " more"), math.copysign(factor, p.value)
    low, high = sorted((factor * p.low, factor * p.high))
    return f"{effect.title[:1].lower()}{effect.title[1:]}, {interval_words(factor * p.value, low, high, unit)}{sign}"


def _told_in(effect: Candidate) -> tuple[str, float]:
    """The unit in which a composition is told, and the factor to it: a relative change of parts in percent."""
    unit = effect.magnitude.unit
    return ("%", 100.0) if unit == "-" else (unit, 1.0)


def answer_of(found: Proposals) -> Answer:
    """What is proposed, how sure that is, and what to do next; of a search without a proposal why there is none."""
    tested = f"{found.tested} compositions of local stiffness or mass changes were tested"
    if not found.ranked:
        apart = found.p_family <= found.alpha
        none = "a place stands out, but no composition explains it" if apart else "no place stands out"
        return Answer(
            f"Nothing can be proposed: {none}.",
            f"{tested}; the largest score of all has the family-wise {p_words(found.p_family)}.",
            "Measure with more sensors or more modes, or check the standard deviations; then explain again.",
        )
    best, *others = found.close
    evidence = f"evidence {best.ln_bayes:.1f}, chosen among {best.choices} of its kind; {tested}"
    if found.measurement:
        blamed = fault_words(found.fault) if found.fault is not None else ""
        datum = "" if found.datum is None else found.datum.in_words
        return Answer(
            f"Nothing is proposed: the measurement is the suspect, {blamed or datum}.",
            f"It explains as well as the best composition, {proposal_words(best)} ({evidence}).",
            "Check the measurement first, and correct it or hold it out.",
        )
    words = f"Proposed: {proposal_words(best)}."
    if others:
        words += f" About as well explained by: {'; '.join(map(proposal_words, others))}."
    if best.alike:
        words += f" The data cannot discriminate it from: {'; '.join(map(composition_words, best.alike[:3]))}."
    if found.datum is not None:
        words += f" Or {found.datum.in_words} explains about as well: check it first."
    beside = f" beside {' and '.join(found.base.names)}" if found.base.names else ""
    assert found.adequacy is not None
    left = min(found.adequacy.p_family, found.adequacy.p_fit)
    rest = "nothing systematic is left" if left > found.alpha else "a misfit is left, so it is not the whole truth"
    doubt = f" It is implausible: {best.candidate_fit.implausible}." if best.candidate_fit.implausible else ""
    sure = f"{evidence[:1].upper()}{evidence[1:]}. With it{beside} {rest} ({p_words(left)}).{doubt}"
    return Answer(words, sure, "Look at that place; the proposals join your list of causes once you have tested them.")


def no_proposals() -> pd.DataFrame:
    """The table without a row."""
    return pd.DataFrame(columns=list(COLUMNS))


def no_places() -> pd.DataFrame:
    """The table of places without a row."""
    return pd.DataFrame(columns=list(PLACES))


def not_sought(verdict: str, named: Sequence[str], remedy: str) -> Answer:
    """Why nothing was sought, after a verdict that leaves nothing open; ``remedy`` adds what was named."""
    names = " and ".join(named)
    if verdict == "measurement":
        return Answer(
            f"Nothing is proposed: the measurement is the suspect, {names}.",
            "The explanation found that a measurement error explains the data better than any effect.",
            "Correct the measurement, and explain again.",
        )
    if verdict == "noise_underestimated":
        return Answer(
            "Nothing is proposed: the standard deviations seem understated.",
            f"The verdict of the explanation is {verdict}.",
            "Check the standard deviations, and explain again.",
        )
    if not named:
        return Answer(
            "Nothing is proposed: nothing seems missing.",
            f"The verdict of the explanation is {verdict}.",
            "More sensors, modes or repeats would show smaller effects.",
        )
    if verdict == "indistinguishable":
        remedy = "measure what tells them apart: the explanation recommends it"
    return Answer(
        f"Nothing is proposed: listed causes explain the data, {names}.",
        f"The verdict of the explanation is {verdict}.",
        f"{remedy[:1].upper()}{remedy[1:]}.",
    )
