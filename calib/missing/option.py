"""One further measurement that could be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Option:
    """One further measurement.

    Attributes
    ----------
    name : str
        In words.
    kind : {"sensor", "mode", "repeats", "bench"}
    rows : ndarray (n_rows,), bool or None
        Rows it adds to those that were measured.
    scale : float
        On the scatter of all rows, such as ``1/sqrt(2)`` for twice the repeats.
    prior_sd : mapping from str to float
        Standard deviations of parameters after a test of a part by itself.
    """

    name: str
    kind: str
    rows: np.ndarray | None = None
    scale: float = 1.0
    prior_sd: Mapping[str, float] = field(default_factory=dict)
