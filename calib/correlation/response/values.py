"""Rows and degrees of freedom of scalar responses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from calib.correlation.rules import RULES
from calib.measurement.responses import response_kinds
from calib.problem.degrees_of_freedom import repeats_dof
from calib.structure.model import Assumption

_LISTED = 4
"""Responses that are listed by name."""


class ResponseRow(NamedTuple):
    """What one entry of the residual compares.

    Attributes
    ----------
    mode : str
        Empty.
    kind : str
        See `calib.measurement.responses.response_kinds`.
    sensor : str
        Name of the response.
    """

    mode: str
    kind: str
    sensor: str


def response_rows(names: Iterable[str]) -> tuple[ResponseRow, ...]:
    """Rows of the residual of some scalar responses, in their order."""
    return tuple(ResponseRow("", kind, name) for name, kind in response_kinds(names).items())


def response_dof(names: Iterable[str], repeats: float | None, shares: Mapping[str, float]) -> dict[str, float]:
    """Degrees of freedom behind the standard deviations of scalar responses, by kind.

    Parameters
    ----------
    names : iterable of str
    repeats : float or None
        Number behind the standard deviations; None for known ones.
    shares : mapping from response name to float
        Part of each variance that the repeats estimate; default 1.
    """
    rows = response_rows(names)
    return repeats_dof((row.kind for row in rows), repeats, [shares.get(row.sensor, 1.0) for row in rows])


def assumed_responses(targets: Mapping[str, tuple[float, float | None]]) -> tuple[Assumption, ...]:
    """Assumed standard deviations of scalar responses, each a value with its standard deviation or None."""
    unknown = [name for name, (_, std) in targets.items() if not std]
    if not unknown:
        return ()
    value = f"{100 * RULES.unknown_response_std:g}"
    reason = "no standard deviation and no accuracy is stated"
    listed = ", ".join(unknown) if len(unknown) <= _LISTED else f"{unknown[0]} and {len(unknown) - 1} more responses"
    return (Assumption(f"standard deviation of {listed}", value, "% of each", reason),)
