"""Fitted parameters with an unexplained misfit: how far what no candidate explains may have pulled them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.local import WIDE
from calib.missing.rules import RULES
from calib.missing.score import Scores

TABLE = "unexplained"
"""Name of the table."""
COLUMNS = (
    "parameter", "unit", "value", "low", "high", "value_unexplained", "low_unexplained", "high_unexplained",
)  # fmt: skip
_LEAST, _POINTS = 1e-2, 80
"""Smallest positive size on the grid of the likelihood, in units of a score, and number of sizes."""


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Parameters of a fit whose misfit is unexplained.

    Every candidate is taken to be present a little: the residual is ``r = G d + S u + noise`` with the change d of the
    parameters under their priors, the signatures S of all candidates, each divided by its part that the parameters
    cannot absorb, and u normal with one standard deviation tau: a discrepancy that acts within the model (Sargsyan,
    Najm and Ghanem 2015). tau is the upper limit of its restricted likelihood (Patterson and Thompson 1971), that of
    the residual less what the parameters absorb.

    Attributes
    ----------
    names : tuple of str
        Fitted parameters, length p.
    change : ndarray (p,)
        Posterior mean of the parameters less the fit, in their own units.
    covariance : ndarray (p, p)
    size : float
        tau, in units of a score.
    """

    names: tuple[str, ...]
    change: np.ndarray
    covariance: np.ndarray
    size: float


def discrepancy(fit: LinearisedFit, *scores: Scores) -> Discrepancy:
    """Posterior of the parameters of a fit with the candidates of some scores, which were computed at this fit."""
    raw = np.hstack([s.raw for s in scores])
    unit, length = np.hstack([s.unit for s in scores]), np.concatenate([s.size for s in scores])
    seen = length > RULES.unexplained_seen * np.maximum(np.linalg.norm(raw, axis=0), 1e-300)
    size = _size(unit[:, seen], fit.projected)
    columns = raw[:, seen] * (size / length[seen])
    p, slope = len(fit.names), fit.data_slope * fit.prior_sd
    beside = np.zeros((len(slope) - len(raw), columns.shape[1]))  # rows of other tests
    wide = np.hstack([slope, np.vstack([columns, beside])])
    root = la.cho_factor(wide.T @ wide + np.eye(wide.shape[1]))
    right = wide.T @ fit.augmented[: len(slope)]
    right[:p] -= fit.shift
    change = la.cho_solve(root, right)[:p] * fit.prior_sd
    inverse = la.cho_solve(root, np.eye(wide.shape[1])[:, :p])[:p]
    return Discrepancy(fit.names, change, inverse * np.outer(fit.prior_sd, fit.prior_sd), size)


def _size(unit: np.ndarray, projected: np.ndarray) -> float:
    """Upper limit of tau, by its restricted likelihood on a flat prior.

    Parameters
    ----------
    unit : ndarray (n, m)
        Signatures less what the parameters absorb, of length 1.
    projected : ndarray (n,)
        The residual likewise.
    """
    if not unit.shape[1]:
        return 0.0
    eigenvalues, vectors = la.eigh(unit.T @ unit)
    eigenvalues = np.maximum(eigenvalues, 0.0)
    along = (vectors.T @ (unit.T @ projected)) ** 2
    most = max(2.0 * float(np.linalg.norm(projected)), 1.0)
    sizes = np.concatenate([[0.0], np.geomspace(_LEAST, most, _POINTS)])
    square = sizes[:, None] ** 2
    ln = 0.5 * np.sum(square * along / (1 + square * eigenvalues) - np.log1p(square * eigenvalues), axis=1)
    weight = np.exp(ln - ln.max()) * np.gradient(sizes)
    at = int(np.searchsorted(np.cumsum(weight) / weight.sum(), RULES.unexplained_size))
    return float(sizes[min(at, len(sizes) - 1)])


def parameter_intervals(found: Explanation) -> pd.DataFrame:
    """Parameters of the base model with 95 % intervals of the fit alone and with the unexplained misfit.

    Returns
    -------
    DataFrame
        `COLUMNS`; intervals end at the limits. Empty after any verdict that is not `UNEXPLAINED`.
    """
    fit, tests = found.base.fit, found.base_adequacy
    if found.verdict not in UNEXPLAINED:
        return pd.DataFrame(columns=list(COLUMNS))
    wide, rows = discrepancy(fit, tests.perturbations, tests.named), []
    alone, together = (np.sqrt(np.diag(c)) for c in (fit.covariance, wide.covariance))
    for k, name in enumerate(fit.names):
        p, value = fit.fit_problem.space[name], fit.values[name]
        moved = min(max(value + float(wide.change[k]), p.lower), p.upper)
        ends = [
            min(max(at + sign * WIDE * float(std[k]), p.lower), p.upper)
            for at, std in ((value, alone), (value + float(wide.change[k]), together))
            for sign in (-1, 1)
        ]
        rows.append((name, p.unit, value, *ends[:2], moved, *ends[2:]))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def sentence(table: pd.DataFrame) -> str:
    """How much wider the intervals are with the unexplained misfit, in words; empty without them."""
    if table.empty:
        return ""
    width = (table["high_unexplained"] - table["low_unexplained"]) / (table["high"] - table["low"])
    outside = table.loc[
        (table["value_unexplained"] < table["low"]) | (table["value_unexplained"] > table["high"]), "parameter"
    ].tolist()
    pulled = f"; it may have pulled {', '.join(outside)} out of the interval of the fit alone" if outside else ""
    return (
        "The unexplained misfit makes the fitted parameters less certain: their 95 % intervals with it are "
        f"{width.median():.2g} times as wide as those of the fit alone, in the median{pulled}."
    )
