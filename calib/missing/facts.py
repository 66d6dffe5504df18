"""Facts that an explanation needs beside the rows of its data: about the measurement, and about the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import pandas as pd

Places: TypeAlias = Mapping[str, tuple[str, tuple[float, float, float], str]]
"""Kind, location (m) and sensor of local perturbations and faults of a measurement, by name."""


@dataclass(frozen=True, eq=False)
class MeasurementFacts:
    """Facts about a measurement beside its rows, as an explanation needs them.

    Attributes
    ----------
    assumed : str
        Assumed standard deviations, in words; see `calib.analyses.uncertainty.assumed_words`.
    accuracy : str
        Accuracy claimed in addition to the repeats, in words; empty without.
    notes : tuple of str
        Caveats on the standard deviations, and repeats that disagree.
    disagreements : DataFrame
        Repeats that disagree with the others; see `calib.analyses.provenance.record.disagreements_table`.
    held_sd : mapping from str to float
        Standard deviations of held parameters that an earlier study determined.
    seed : int
        Of all random numbers.
    samples : int
        Posterior samples over which the recommendation is averaged.
    freqs : mapping from str to float
        Measured frequency of each mode, Hz; empty without modes.
    """

    assumed: str
    accuracy: str
    notes: tuple[str, ...]
    disagreements: pd.DataFrame
    held_sd: Mapping[str, float]
    seed: int
    samples: int
    freqs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class DiscretisationError:
    """Scores of every effect and local perturbation on modes of a finer mesh without noise.

    Attributes
    ----------
    table : DataFrame
        ``candidate, kind, score``, largest first; kind is ``effect`` or ``local perturbation``.
    misfit : float
        Sum of squares of the whitened residual left by the fit.
    acceptable : float
        Largest score that it may cause.
    """

    table: pd.DataFrame
    misfit: float
    acceptable: float

    @property
    def largest(self) -> float:
        """Largest size of a score."""
        return float(self.table["score"].abs().max()) if len(self.table) else 0.0

    @property
    def sentence(self) -> str:
        """Whether the mesh is fine enough for these data."""
        first = self.table.iloc[0]
        found = (
            f"A finer mesh of the same model gives scores of up to {self.largest:.2f} ({first['candidate']}) by itself"
        )
        if self.largest <= self.acceptable:
            return f"{found}: the discretisation error neither hides nor mimics an effect."
        return f"{found}, more than {self.acceptable:g}: refine the mesh before relying on a verdict."
