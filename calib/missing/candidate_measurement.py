"""A candidate for the next measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class CandidateMeasurement:
    """A candidate for the next measurement.

    Attributes
    ----------
    name : str
        In words.
    kind : {"sensor", "mode", "reference", "held out", "repeats", "bench"}
    rows : ndarray (n_rows,), bool or None
        Rows that it adds to the measured ones.
    scale : float
        Factor on the standard deviation of all rows, such as ``1/sqrt(2)`` for twice the repeats.
    prior_sd : mapping from str to float
        Standard deviations of parameters after a bench test of a component.
    """

    name: str
    kind: str
    rows: np.ndarray | None = None
    scale: float = 1.0
    prior_sd: Mapping[str, float] = field(default_factory=dict)


def at_effect(name: str) -> str:
    """Beginning of the name of the measurement with sensors where an effect acts."""
    return f"all directions where {name} acts"
