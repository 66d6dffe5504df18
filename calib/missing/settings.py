"""Settings of an explanation, and whether the data are enough for one."""

from __future__ import annotations

from dataclasses import dataclass

from calib.errors.errors import InputError
from calib.missing.rules import RULES


@dataclass(frozen=True)
class Settings:
    """Settings of an explanation.

    Attributes
    ----------
    alpha : float
        Family-wise level of every test.
    refits : int
        Number of effects that are fitted, best first.
    merge : float
        Correlation of signatures from which two effects are grouped, unless the data tell them apart.
    seed : int
        Of the samples behind family-wise p-values.
    budget : float
        Model evaluations of one decision, after which no further effect or pair of effects is tried.
    """

    alpha: float = 0.01
    refits: int = 6
    merge: float = 0.98
    seed: int = 1
    budget: float = 115.0


DEFAULT = Settings()


def require_modes(count: int) -> None:
    """Raise InputError for too few measured modes to name an effect."""
    if count < RULES.least_modes:
        raise InputError(
            f"{count} measured modes cannot tell a missing effect from a parameter",
            place="explain",
            remedy=f"measure at least {RULES.least_modes}, or hold out fewer",
        )


def require_responses(count: int, free: int) -> None:
    """Raise InputError for too few measured responses to name an effect beside the fitted parameters."""
    least = max(RULES.least_responses, free + 2)
    if count < least:
        raise InputError(
            f"{count} measured responses cannot tell a missing effect from the {free} fitted parameters",
            place="explain",
            remedy=f"measure at least {least}, hold out fewer or fit fewer parameters",
        )
