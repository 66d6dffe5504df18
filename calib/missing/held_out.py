"""Test of a fitted model against held-out data."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.missing.rules import RULES

UNSEEN: Mapping[str, str] = {
    "held_out_sensors": "held-out sensors",
    "held_out_modes": "held-out modes",
    "held_out_responses": "held-out responses",
    "held_out_references": "held-out references",
    "held_out_bands": "held-out bands",
}
"""Groups of held-out data, in words."""


def contradicting(errors: pd.DataFrame, stage: str) -> tuple[str, ...]:
    """Groups of held-out data that contradict a model: a correctly specified one would rarely predict them as badly.

    Parameters
    ----------
    errors : DataFrame
        ``group, stage, p``.
    stage : str
        Of the model, such as ``after``.
    """
    own = errors[(errors["stage"] == stage) & errors["group"].isin(list(UNSEEN))]
    return tuple(own.loc[own["p"] < RULES.contradicted, "group"].astype(str))
