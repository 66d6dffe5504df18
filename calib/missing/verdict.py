"""Verdict of an explanation in sentences: what is missing, how sure that is, what to do next, and what supports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import pandas as pd

from calib.missing.coverage import coverage_sentence
from calib.missing.data_words import contradicted_words, error_words, unseen_words
from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.goodness import worst_repeats
from calib.missing.recommendation import Recommendation
from calib.missing.suspect import ESTIMATED, suspect_in_short, suspect_sentence
from calib.missing.verdict_words import VerdictWords, beside_faults, check_faults, misfit_in_short
from calib.missing.words_by_verdict import WORDS
from calib.results.answer import Answer

_REPEATS = 3
"""Largest number of repeats named in a sentence."""


_OUTSIDE = "A cause that is not listed cannot be ruled out."


class Doubts(NamedTuple):
    """What looks wrong in the measurement itself, seen without a fit; `calib compare` tells the same.

    Attributes
    ----------
    sentences : tuple of str
    checks : tuple of str
        What to check, such as ``sensor 12y``.
    data : tuple of str
        Modes of which one may not be there, as `calib.missing.suspect.suspects_table` names them.
    """

    sentences: tuple[str, ...] = ()
    checks: tuple[str, ...] = ()
    data: tuple[str, ...] = ()


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


def _without_doubtful(found: Explanation, doubts: Doubts) -> VerdictWords | None:
    """What is told where nothing explains a misfit that a mode causes which is doubtful without a fit; else None."""
    table = found.suspects
    causes = table[table["explains"].astype(bool) & table["what"].isin(doubts.data)]
    if found.verdict not in UNEXPLAINED or causes.empty:
        return None
    first = causes.iloc[0]
    return VerdictWords(
        f"Without {first['what']} the model fits (p = {first['p_fit_without']:.2g}, {ESTIMATED}): nothing else is "
        "seen to be missing.",
        misfit_in_short(found),
        "Leave it out, and ask again.",
    )


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
    leave_out = _without_doubtful(found, doubts)
    words = leave_out or WORDS[found.verdict](found, effects)
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
        named, odds = found.chosen.names[0], found.odds_against_datum
        sure.append(suspect_in_short(found.suspects, odds))
        support.insert(0, suspect_sentence(found.suspects, named, odds))
    sure.append(coverage_sentence(found))
    if assumed:
        sure.append(f"These results rest on an assumed standard deviation: {assumed}.")
    sure += supposed
    if (found.names_something and not found.remains) or found.verdict == "nothing_detectable":
        doubts = NO_DOUBTS  # with a gross error in them the data would not fit
    headline = " ".join(filter(None, (*doubts.sentences, words.found, beside_faults(found))))
    check = f"Check first: {'; '.join(doubts.checks)}." if doubts.checks else ""
    if leave_out is not None:  # what else is missing is asked again without it
        pointed = short = ""
    then = (check, words.then, check_faults(found), pointed, short)
    answer = Answer(headline, *(" ".join(filter(None, some)) for some in (sure, then)))
    return Verdict(answer, tuple(filter(None, (answer.found, answer.sure, words.then, pointed, *support))))
