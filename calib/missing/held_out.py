"""Test of a fitted model against held-out data."""

from __future__ import annotations

import pandas as pd

from calib.missing.rules import RULES

UNSEEN = ("held_out_sensors", "held_out_modes", "held_out_responses")
"""Groups of held-out data."""


def contradicting(errors: pd.DataFrame, stage: str) -> tuple[str, ...]:
    """Groups of held-out data that contradict a model: a correctly specified one would rarely predict them as badly.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, p``.
    stage : str
        Of the model, such as ``after``.
    """
    own = errors[(errors["stage"] == stage) & errors["group"].isin(UNSEEN)]
    return tuple(own.loc[own["p"] < RULES.contradicted, "group"].astype(str))
