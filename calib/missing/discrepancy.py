"""A fit with an unexplained misfit: how far what no candidate explains may have pulled parameters and predictions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import compress

import numpy as np
import pandas as pd
import scipy.linalg as la
from scipy.special import chdtrc

from calib.inference.rules import WIDE
from calib.missing.explanation import UNEXPLAINED, Explanation
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import Scores

UNHELD = (
    "No interval of a fitted parameter holds: what is missing is unlike every effect and every local stiffness or "
    "mass change, or too large for their derivatives."
)
"""Said where a discrepancy does not account for the misfit."""
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
    owners : tuple of str
        Candidate of every column that is taken to be present, length m.
    points : tuple of mapping
        Where the signature of a column is a difference, see `Scores`; empty for a derivative.
    p : float
        Of the sum of squares with the discrepancy: small where what is missing is unlike every candidate, or too large
        for their derivatives.
    presence : ndarray (m,)
        Posterior mean of the magnitude of every column.
    root : ndarray (m, m)
        R with ``R R^T`` the posterior covariance of these magnitudes.
    absorbed : ndarray (p, m)
        How far the fitted parameters follow one unit of every column.
    """

    names: tuple[str, ...]
    change: np.ndarray
    covariance: np.ndarray
    size: float
    p: float
    owners: tuple[str, ...]
    points: tuple[Mapping[str, float], ...]
    presence: np.ndarray
    root: np.ndarray
    absorbed: np.ndarray

    @property
    def holds(self) -> bool:
        """Whether it accounts for the misfit; else its intervals know of a part of that alone."""
        return self.p >= RULES.suspect

    def elsewhere(self, names: tuple[str, ...], slope: np.ndarray, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the discrepancy does to predictions of data that were not fitted.

        With a magnitude v of the candidates the parameters move by ``-B v`` (B = ``absorbed``), so that other data
        change by ``(S - G B) v``. This adds to the covariance for given parameters, since the posterior covariance of
        the parameters does not depend on v.

        Parameters
        ----------
        names : tuple of str
            Fitted parameters on which these data depend, length q.
        slope : ndarray (n, q)
            G: change of the data per unit of each.
        raw : ndarray (n, m)
            S: change of the data per unit of every column.

        Returns
        -------
        shift : ndarray (n,)
            Expected measurement less prediction of the fit.
        spread : ndarray (n, m)
            A with ``A A^T`` the covariance that the discrepancy adds.
        """
        remainder = raw - slope @ self.absorbed[[self.names.index(name) for name in names]]
        return remainder @ self.presence, remainder @ self.root


def discrepancy(fit: LinearisedFit, *scores: Scores) -> Discrepancy:
    """Posterior of the parameters of a fit with the candidates of some scores, which were computed at this fit."""
    raw = np.hstack([s.raw for s in scores])
    unit, length = np.hstack([s.unit for s in scores]), np.concatenate([s.size for s in scores])
    seen = length > RULES.unexplained_seen * np.maximum(np.linalg.norm(raw, axis=0), 1e-300)
    size = _size(unit[:, seen], fit.projected)
    scale = size / length[seen]
    columns = raw[:, seen] * scale
    p, slope = len(fit.names), fit.data_slope * fit.prior_sd
    beside = np.zeros((len(slope) - len(raw), columns.shape[1]))  # rows of other tests
    wide = np.hstack([slope, np.vstack([columns, beside])])
    root = la.cho_factor(wide.T @ wide + np.eye(wide.shape[1]))
    right = wide.T @ fit.augmented[: len(slope)]
    right[:p] -= fit.shift
    change = la.cho_solve(root, right)[:p] * fit.prior_sd
    inverse = la.cho_solve(root, np.eye(wide.shape[1])[:, :p])[:p]
    # Of the magnitudes alone, with the parameters projected out.
    projected = unit[:, seen] * size
    upper = la.cholesky(projected.T @ projected + np.eye(len(scale)))
    presence = la.cho_solve((upper, False), projected.T @ fit.projected)
    misfit = float(fit.projected @ fit.projected - (projected.T @ fit.projected) @ presence)
    right_of_all = (fit.slope * fit.prior_sd).T @ raw[:, seen]
    return Discrepancy(
        fit.names,
        change,
        inverse * np.outer(fit.prior_sd, fit.prior_sd),
        size,
        float(chdtrc(len(slope), misfit)),
        tuple(compress([name for s in scores for name in s.owners], seen)),
        tuple(compress([point for s in scores for point in s.points], seen)),
        scale * presence,
        scale[:, None] * la.solve_triangular(upper, np.eye(len(scale))),
        fit.prior_sd[:, None] * la.solve(fit.scaled_information, right_of_all, assume_a="pos"),
    )


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


def discrepancy_of(found: Explanation) -> Discrepancy | None:
    """That of the base model with all effects and local perturbations; None where the misfit is explained."""
    tests = found.base_adequacy
    return discrepancy(found.base.fit, tests.perturbations, tests.named) if found.verdict in UNEXPLAINED else None


def parameter_intervals(fit: LinearisedFit, wide: Discrepancy | None) -> pd.DataFrame:
    """Parameters of a fit with 95 % intervals of the fit alone and with its unexplained misfit.

    Parameters
    ----------
    fit : LinearisedFit
    wide : Discrepancy or None
        From `discrepancy` or `discrepancy_of`, at this fit.

    Returns
    -------
    DataFrame
        `COLUMNS`; intervals end at the limits. Empty without a discrepancy, and where it does not account for the
        misfit.
    """
    if wide is None or not wide.holds:
        return pd.DataFrame(columns=list(COLUMNS))
    rows: list[tuple[object, ...]] = []
    alone, together = (np.sqrt(np.diag(c)) for c in (fit.covariance, wide.covariance))
    for k, name in enumerate(fit.names):
        p, value = fit.fit_problem.space[name], fit.values[name]
        change = float(wide.change[k])
        moved, *ends = (
            min(max(p.moved(value, step), p.lower), p.upper)
            for step in (
                change,
                *(
                    middle + sign * WIDE * float(std[k])
                    for middle, std in ((0.0, alone), (change, together))
                    for sign in (-1, 1)
                ),
            )
        )
        rows.append((name, p.unit, value, *ends[:2], moved, *ends[2:]))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def parameters_sentence(table: pd.DataFrame) -> str:
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
