"""Doubts that an explanation leaves, each with how to check it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import pandas as pd

from calib.missing.explanation import Explanation
from calib.missing.local import range_words
from calib.missing.rules import RULES
from calib.missing.suspect import suspect_sentence
from calib.missing.verdict_words import KINDS, limits_sentence, lowered

_LISTED = 6
"""Largest number of effects that a doubt lists."""
_MASS = ("kg", "t", "g")
"""Units of magnitudes that can be weighed."""


class Reservation(NamedTuple):
    """A doubt about an answer.

    Attributes
    ----------
    doubt : str
    check : str
        How to check it.
    """

    doubt: str
    check: str


def reservations(
    found: Explanation, effects: pd.DataFrame, pointed: str = "", assumed: str = ""
) -> tuple[Reservation, ...]:
    """What speaks against an answer that names something, the most serious first; empty for other answers.

    Parameters
    ----------
    found : Explanation
    effects : DataFrame
        From `calib.missing.tables.effects_table`.
    pointed : str
        Where the data point to, in words; see `calib.missing.verdict_words.elsewhere`.
    assumed : str
        Assumed standard deviations, in words.
    """
    return tuple(_reservations(found, effects, pointed, assumed)) if found.names_something else ()


def _reservations(found: Explanation, effects: pd.DataFrame, pointed: str, assumed: str) -> Iterator[Reservation]:
    assert found.chosen is not None
    if pointed:
        yield Reservation(pointed, "Look at what is mounted at either place and between them.")
    suspects = found.suspects[found.suspects["explains"].astype(bool)]
    if found.verdict == "effect" and len(suspects):
        check = f"Measure {suspects['what'].iloc[0]} again with another excitation, and compare its repeats."
        yield Reservation(
            suspect_sentence(suspects, found.chosen.names[0], found.odds_against_datum),
            "Check its mounting, cable and direction." if suspects["kind"].iloc[0] == "sensor" else check,
        )
    fits = found.chosen_adequacy
    if fits is not None and found.alpha < fits.p_fit <= RULES.near_limit and len(fits.modes):
        worst = fits.modes.sort_values("p", kind="stable").iloc[0]
        what = f"{worst['kind']} of {worst['mode']}" if worst["mode"] else _of_responses(str(worst["kind"]))
        yield Reservation(
            f"The data fit as a whole, but one group of them only just (p = {fits.p_fit:.2g}; {found.alpha:g} or less "
            f"is rejected): the worst fit is that of the {what}.",
            f"Look at the {what} in the measurement, and measure again.",
        )
    if limited := limits_sentence(found):
        yield Reservation(limited, "Ask whether that search limit is a physical one.")
    if assumed:
        yield Reservation(
            f"The standard deviation is assumed: {assumed}.", "Repeat the test at least three times, or state accuracy."
        )
    count = sum(len(group.names) for group in found.groups)
    yield Reservation(
        f"A cause that is not among the {count} listed ones may look the same."
        if count > 1
        else "A cause that is not listed may look the same.",
        f"Look at the structure there before you change model or drawing. {_weighed(found, effects)}If nothing is "
        "found, list further causes.",
    )
    hidden = effects[~effects["visible"].astype(bool) & ~effects["name"].isin(found.chosen.names)]
    unseen = hidden["title"].tolist()
    if unseen:
        more = [] if len(unseen) <= _LISTED else [f"{len(unseen) - _LISTED} more"]
        yield Reservation(
            f"These data cannot show whether there is: {'; '.join([*map(lowered, unseen[:_LISTED]), *more])}.",
            "What would show each stands under Recommended measurements.",
        )


def _of_responses(kind: str) -> str:
    """A kind of data without modes, in words; scalar responses bear the beginning of their names."""
    return KINDS.get(kind, "responses" if kind == "response" else f"responses {kind}")


def _weighed(found: Explanation, effects: pd.DataFrame) -> str:
    """What a scale should show where a named effect is a mass, with a space behind it; empty where none is."""
    assert found.chosen is not None
    rows = effects[effects["name"].isin(found.chosen.names) & effects["refitted"].astype(bool)]
    masses = [
        range_words(float(r["magnitude_low"]), float(r["magnitude_high"]), str(r["unit"]))
        for r in rows.to_dict("records")
        if r["unit"] in _MASS
    ]
    return f"Weigh what you find there: {' and '.join(masses)} are expected. " if masses else ""
