"""When a value is on its limit: one definition for parameters, fits, decisions, tables and pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class LimitRules:
    """Distances at which a value is on its limit; `record.json` holds those of a result.

    Attributes
    ----------
    of_range : float
        Largest distance over the range between the limits.
    of_std : float
        The same over the posterior standard deviation, where it is known: the smaller distance counts.
    searched : float
        Distance over the range at the end of a genetic search: random steps approach a limit without reaching it, and
        a standard deviation says nothing of how near they came.
    """

    of_range: float = 1e-3
    of_std: float = 0.05
    searched: float = 0.01


RULES = LimitRules()
"""Distances in force."""


def limit_at(
    value: float, lower: float, upper: float, std: float | None = None, searched: bool = False
) -> Literal["lower", "upper"] | None:
    """The limit that a value is on or beyond; None between the limits.

    Parameters
    ----------
    value, lower, upper : float
        In one unit.
    std : float, optional
        Posterior standard deviation, in the same unit; NaN where unknown.
    searched : bool
        Whether a genetic search ended there, without least squares.
    """
    near = (RULES.searched if searched else RULES.of_range) * (upper - lower)
    if std is not None and not searched:
        near = min(near, RULES.of_std * std)
    if upper - value <= near:
        return "upper"
    return "lower" if value - lower <= near else None
