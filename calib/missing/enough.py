"""Whether the data are enough to name a missing effect."""

from __future__ import annotations

from calib.errors.errors import InputError
from calib.missing.rules import RULES


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
