"""Settings of an explanation."""

from __future__ import annotations

from dataclasses import dataclass


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
