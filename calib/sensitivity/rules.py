"""Thresholds by which parameters count as sensitive, and by which metamodels are chosen."""

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


@dataclass(frozen=True)
class PrognosisRules:
    """How metamodels are built and chosen; `record.json` holds those of a result.

    Attributes
    ----------
    folds : int
        Parts of the designs, each predicted from the others.
    terms : int
        Largest number of terms that a polynomial is chosen from.
    products : int
        Products in pairs of all inputs from which none are tried in quadratic polynomials.
    q : float
        Norm of the degrees of polynomial chaos (Blatman and Sudret 2011).
    degree : int
        Largest bound on that norm.
    chance : float
        Probability with which a term of an input without influence is taken.
    stable : float
        Part of the folds that must have an input of the metamodel too.
    rounds : int
        Times at most that further inputs are looked for.
    terms_a_row : float
        Terms for every design, at most.
    exact : float
        Part of the variance below which a polynomial is exact.
    patience : int
        Terms without a smaller error after which no more are tried.
    process_below : float
        Prognosis of the best polynomial below which a Gaussian process is tried.
    process_rows : int
        Designs with which a Gaussian process is tried at most; its cost is cubic.
    process_tuned : int
        Designs by which its length scales are tuned; the cost is cubic, and more tell little more.
    better : float
        Part of its remaining error that a less simple model must save.
    rows_least : int
        Complete designs below which there is no metamodel.
    runs_an_input : int
        Runs of a table for every input, below which it is no model.
    pairs : int
        Pairs of points behind each total share.
    resamplings : int
        Of the designs, behind the interval of a total prognosis.
    """

    folds: int = 5
    terms: int = 700
    products: int = 2000
    q: float = 0.75
    degree: int = 14
    chance: float = 0.01
    stable: float = 0.8
    rounds: int = 3
    terms_a_row: float = 0.5
    exact: float = 1e-20
    patience: int = 15
    process_below: float = 0.99
    process_rows: int = 500
    process_tuned: int = 150
    better: float = 0.05
    rows_least: int = 20
    runs_an_input: int = 3
    pairs: int = 1024
    resamplings: int = 400


PROGNOSIS = PrognosisRules()
"""Those in force."""
