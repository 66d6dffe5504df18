"""Whether data that no fit has seen speak against what fits the others."""

from __future__ import annotations

import pandas as pd

UNSEEN = ("withheld_sensors", "withheld_modes", "withheld_responses")
"""Groups of data that no fit has seen."""
CONTRADICTED = 1e-3
"""Chance of a right model predicting a group as badly, below which the group contradicts it."""


def contradicting(errors: pd.DataFrame, stage: str) -> tuple[str, ...]:
    """Groups of withheld data that a model predicts as badly as hardly ever a right one.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, p``.
    stage : str
        Of the model, such as ``after``.
    """
    own = errors[(errors["stage"] == stage) & errors["group"].isin(UNSEEN)]
    return tuple(own.loc[own["p"] < CONTRADICTED, "group"].astype(str))
