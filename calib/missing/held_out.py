"""Whether data that no fit has seen speak against what fits the others."""

from __future__ import annotations

import pandas as pd

from calib.missing.rules import RULES

UNSEEN = ("withheld_sensors", "withheld_modes", "withheld_responses")
"""Groups of data that no fit has seen."""


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
    return tuple(own.loc[own["p"] < RULES.contradicted, "group"].astype(str))
