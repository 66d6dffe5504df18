"""Thresholds by which parameters count as sensitive."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SensitivityRules:
    """Thresholds of a selection; `record.json` holds those of a result.

    Attributes
    ----------
    relevant : float
        Variance share (as a root) below which a significant effect is too small: 1 % of the response's variance.
    bound : float
        Tolerance (1 / variance inflation factor) below which a parameter counts as bound to others.
    rows_least : int
        Complete rows below which a pair stays blank: two points always correlate perfectly.
    rows_a_term : float
        Rows needed for every term of the regression behind variance shares.
    own_degree : int
        Degree of the polynomials of a parameter itself.
    others_degree : int
        Degree of those of the other parameters, which are regressed out.
    trajectories : int
        Trajectories of Morris that usually rank well (Campolongo and Saltelli 1997).
    """

    relevant: float = 0.1
    bound: float = 0.1
    rows_least: int = 3
    rows_a_term: float = 1.5
    own_degree: int = 3
    others_degree: int = 4
    trajectories: int = 10


RULES = SensitivityRules()
"""Thresholds in force."""
