"""Reasons of failed evaluations, the commonest first, each with a point."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from calib.analyses.provenance.stored import point_label
from calib.execution.outcome import Outcome
from calib.problem.space import ParameterSpace
from calib.results.ledger import Ledger

SHOWN = 3
"""Reasons that are reported."""

_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")


class Reason(NamedTuple):
    """Failures whose messages differ only in numbers.

    Attributes
    ----------
    error : str
        Message of the first one.
    points : int
        Number of points.
    first : Outcome
        The first of them, in the given order.
    """

    error: str
    points: int
    first: Outcome


def reasons(outcomes: Sequence[Outcome]) -> tuple[Reason, ...]:
    """Reasons of the failed outcomes, the commonest first."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        if outcome.status == "failed":
            groups.setdefault(_NUMBER.sub("#", outcome.error), []).append(outcome)
    found = [Reason(group[0].error, len(group), group[0]) for group in groups.values()]
    return tuple(sorted(found, key=lambda reason: -reason.points))


def reasons_sentence(space: ParameterSpace, found: Sequence[Reason], requested: int) -> str:
    """How many of the requested points failed, and why; empty when none did."""
    if not found:
        return ""
    listed = [f"{r.points} × {r.error} (first at {point_label(space, r.first.values)})" for r in found[:SHOWN]]
    more = len(found) - SHOWN
    rest = f"; {more} less frequent reason{'s' * (more > 1)}" if more > 0 else ""
    return f"{sum(r.points for r in found)} of {requested} points failed: {'; '.join(listed)}{rest}."


def stored_reasons(ledger: Ledger, fingerprints: Sequence[str]) -> tuple[tuple[Reason, ...], int]:
    """Reasons of all failed points in a ledger for some problems, and the number of their points in it."""
    failed = [outcome for fingerprint in fingerprints for outcome in ledger.failed(fingerprint)]
    return reasons(failed), sum(ledger.count(fingerprint) for fingerprint in fingerprints)
