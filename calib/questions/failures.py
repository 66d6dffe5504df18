"""Why evaluations failed: the commonest reasons, with a point for each."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from calib.ledger import Ledger
from calib.outcome import Outcome
from calib.questions.stored import point_words
from calib.space import ParameterSpace

SHOWN = 3
"""Reasons that are told."""

_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")


class Reason(NamedTuple):
    """Failures that differ in numbers only.

    Attributes
    ----------
    error : str
        As told for the first of them.
    points : int
    first : Outcome
        Of the points with this reason, in the order given.
    """

    error: str
    points: int
    first: Outcome


def reasons(outcomes: Sequence[Outcome]) -> tuple[Reason, ...]:
    """Reasons of the failed ones, the commonest first."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.status == "failed":
            groups.setdefault(_NUMBER.sub("#", outcome.error), []).append(outcome)
    found = [Reason(group[0].error, len(group), group[0]) for group in groups.values()]
    return tuple(sorted(found, key=lambda reason: -reason.points))


def reasons_sentence(space: ParameterSpace, found: Sequence[Reason], asked: int) -> str:
    """How many of the points asked failed, and why; empty when none did."""
    if not found:
        return ""
    told = [f"{r.points} × {r.error} (first at {point_words(space, r.first.values)})" for r in found[:SHOWN]]
    more = len(found) - SHOWN
    rest = f"; {more} other reason{'s' * (more > 1)} more rarely" if more > 0 else ""
    return f"{sum(r.points for r in found)} of {asked} points failed: {'; '.join(told)}{rest}."


def stored_reasons(ledger: Ledger, fingerprints: Sequence[str]) -> tuple[tuple[Reason, ...], int]:
    """Reasons of all failed points that a ledger holds of some problems, and how many points it holds."""
    failed = [outcome for fingerprint in fingerprints for outcome in ledger.failed(fingerprint)]
    return reasons(failed), sum(ledger.count(fingerprint) for fingerprint in fingerprints)
