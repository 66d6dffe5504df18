"""A parameter of a test of FRFs itself: its limits, its name among several tests, its standard deviation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from calib.errors.errors import InputError

Side = Literal["response", "reference"]
"""Channels of a test of FRFs: those of its responses, and those of the forces."""


def in_test(test: str) -> str:
    """End of the name of a parameter that belongs to one of several tests."""
    return f" in test {test}" if test else ""


def require_positive(prior_sd: float | None, place: str) -> None:
    """InputError for a standard deviation that is given and not positive."""
    if prior_sd is not None and not 0 < prior_sd < np.inf:
        raise InputError(f"its standard deviation is {prior_sd:g}", place=place, remedy="give a positive number")
