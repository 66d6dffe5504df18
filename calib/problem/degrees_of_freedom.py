"""Degrees of freedom of a fit and of a standard deviation, and p-values of a sum of squares."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

KNOWN = 1e9
"""Degrees of freedom of a standard deviation that is known exactly."""

_ZERO = 1e-13


@dataclass(frozen=True)
class DofRules:
    """Degrees of freedom that a test needs; `record.json` holds those of a result.

    Attributes
    ----------
    pool_below : int
        With fewer repeats a single standard deviation is too uncertain (34 % with five) and is pooled.
    least : float
        Effective degrees of freedom below which data cannot reject a fit: two, of which priors may leave slightly less.
    absorbed : float
        Degrees of freedom below which the residual of a fit tells only how far the search converged.
    """

    pool_below: int = 10
    least: float = 2 - 1e-6
    absorbed: float = 0.01


RULES = DofRules()
"""Numbers in force."""


def row_dof(slope: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """Share of each row's variance that a fit leaves, ``1 - h_i`` with h the diagonal of the hat matrix, (n_rows,).

    The sum is the effective number of degrees of freedom, rows less ``tr(H)``, ``H = G (G^T G + diag(1/s^2))^-1 G^T``
    (Hastie, Tibshirani and Friedman 2009, section 7.6; Ye 1998). A parameter with a prior counts in proportion to the
    information in the data: one without effect counts 0. Integers have no slope and are not counted.

    Parameters
    ----------
    slope : ndarray (n_rows, n_params)
        Derivative of the whitened residual, with either sign.
    prior_sd : ndarray (n_params,)
        Prior standard deviations, in the units of the slope; infinite without a prior.
    """
    return np.asarray(np.maximum(1.0 - np.sum(hat_root(slope, prior_sd) ** 2, axis=1), 0.0))


def hat_root(slope: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """Matrix S, (n_rows, rank), of which ``S S^T`` is the hat matrix; parameters as in `row_dof`."""
    g, s = np.asarray(slope, dtype=float), np.asarray(prior_sd, dtype=float)
    if not g.shape[1]:
        return np.zeros((len(g), 0))
    stacked = np.vstack([g, np.diag(1.0 / s)])
    size = np.linalg.norm(stacked, axis=0)
    u, singular, _ = np.linalg.svd(stacked / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(u[: len(g), singular > _ZERO * len(stacked) * singular.max(initial=1.0)])


def effective_dof(slope: np.ndarray, prior_sd: np.ndarray, fitted_factors: int = 0) -> float:
    """Effective degrees of freedom of a fit: rows less the trace of the hat matrix, less factors fitted to shapes.

    Parameters
    ----------
    slope, prior_sd
        As in `row_dof`.
    fitted_factors : int
        Real numbers fitted to the scale and phase of measured shapes.
    """
    return float(row_dof(slope, prior_sd).sum()) - fitted_factors


def matched(
    slope: np.ndarray, prior_sd: np.ndarray, fitted_factors: int = 0, others: np.ndarray | None = None
) -> tuple[float, float]:
    """Scale c and degrees of freedom nu of the variate ``c chi2_nu`` like a fit's sum of squares over some rows.

    The residual of rows a at the end of a fit has the covariance ``M = I - G_a V G_a^T`` with V the posterior
    covariance from all rows, these and others, and the priors (that of the data is ``I + G S G^T`` with S the prior
    covariance; Gelman et al. 2013, section 14.8). Then ``e^T e`` has the mean tr(M) and the variance 2 tr(M^2), as
    ``c chi2_nu`` has with ``c = tr(M^2)/tr(M)`` and ``nu = tr(M)^2/tr(M^2)`` (Satterthwaite 1946). Where M projects, as
    for all rows without priors, c is 1 and nu the usual number.

    Parameters
    ----------
    slope, prior_sd
        As in `row_dof`, of the rows a.
    fitted_factors : int
        Real numbers fitted to the scale and phase of measured shapes, to which the slope is orthogonal.
    others : ndarray (n_others, n_params), optional
        Slope of the other rows.
    """
    whole = slope if others is None else np.vstack([slope, others])
    root = hat_root(whole, prior_sd)[: len(slope)]
    inner = root.T @ root
    first = len(slope) - fitted_factors - float(np.trace(inner))
    second = len(slope) - fitted_factors - 2.0 * float(np.trace(inner)) + float(np.sum(inner**2))
    if first < RULES.absorbed:
        return 1.0, max(first, 0.0)
    return second / first, first**2 / second


def beside_known(dof: float, shares: np.ndarray, pooled: bool = True) -> float:
    """Degrees of freedom behind variances of which only a share is estimated, the rest being known exactly.

    With variances ``s^2 + c^2``, s estimated and c known, these are ``dof ((s^2 + c^2)/s^2)^2`` (Welch 1947,
    Satterthwaite 1946). Where shares differ, their mean counts if all values rest on one pooled estimate, and their
    root mean square if each rests on its own.

    Parameters
    ----------
    dof : float
        Behind the estimated part of all values together.
    shares : ndarray
        Estimated part of each value's variance, 0 to 1; empty for all of it.
    pooled : bool
    """
    share = np.asarray(shares, dtype=float)
    square = 1.0 if not share.size else float(np.mean(share) ** 2 if pooled else np.mean(share**2))
    return dof / square if square > 0 else math.inf


def widened_by(dof: np.ndarray | float) -> np.ndarray:
    """Factor that widens a standard deviation with nu degrees of freedom of its own, ``sqrt(nu/(nu - 2))``.

    With it the error over the standard deviation, a Student's t variate, has unit variance (JCGM 101:2008, 6.4.9).
    Without it a sum of squares is too large by ``nu/(nu - 2)``, whatever the number of rows.
    """
    nu = np.asarray(dof, dtype=float)
    return np.asarray(np.sqrt(nu / np.maximum(nu - 2.0, 1.0)))


def dof_each(dof: float) -> float:
    """Degrees of freedom of a widened standard deviation in an F test, ``(nu - 4)/3``.

    They give the sum of squares of n rows the variance ``2 n (nu - 1)/(nu - 4)`` of n squared t variates.
    """
    return max((dof - 4.0) / 3.0, 1.0 / 3.0)


def repeats_dof(
    kinds: Iterable[Hashable], repeats: float | None, shares: Iterable[float] | None = None
) -> dict[str, float]:
    """Degrees of freedom behind the standard deviation of each kind of row, from repeats; infinite without repeats.

    Parameters
    ----------
    kinds : iterable of str
        Kind of every row.
    repeats : float or None
        Repeats behind the standard deviation, pooled over each kind; 1 or None means known.
    shares : iterable of float, optional
        Part of each row's variance that the repeats estimate; see `beside_known`. All of it by default.
    """
    names = [str(kind) for kind in kinds]
    fractions = np.ones(len(names)) if shares is None else np.array(list(shares), dtype=float)
    each = math.inf if repeats is None or repeats == 1 else float(repeats - 1)
    own = {kind: fractions[[name == kind for name in names]] for kind in dict.fromkeys(names)}
    # A row without a contribution from repeats adds no degrees of freedom.
    estimated = {kind: int(np.count_nonzero(share)) for kind, share in own.items()}
    return {k: beside_known(each * estimated[k], s) if estimated[k] else math.inf for k, s in own.items()}


def behind(counts: Mapping[str, float], std_dof: Mapping[str, float] | None) -> float:
    """Degrees of freedom behind rows of several kinds, weighted by their number (Satterthwaite 1946).

    Parameters
    ----------
    counts : mapping from kind to float
        Degrees of freedom, or rows, of each kind.
    std_dof : mapping from kind to float
        From `repeats_dof`; a missing kind is known.
    """
    given = std_dof or {}
    total = sum(counts.values())
    spread = sum(count**2 / given.get(kind, math.inf) for kind, count in counts.items())
    return min(total**2 / spread, KNOWN) if spread > 0 else KNOWN


def p_value(chi2: np.ndarray | float, dof: np.ndarray | float, std_dof: np.ndarray | float = KNOWN) -> np.ndarray:
    """p-value: probability of an equal or larger sum of squares for a correctly specified model, elementwise.

    F distribution when the standard deviations were estimated with ``std_dof`` degrees of freedom, else chi-square.
    Below one degree of freedom the value for one is used, which is no smaller: a saturated fit carries no evidence
    unless its residual is not zero.
    """
    from scipy import special

    counted = np.maximum(dof, 1.0)
    behind_std = np.minimum(std_dof, KNOWN)
    estimated = special.fdtrc(counted, behind_std, np.asarray(chi2) / counted)
    return np.asarray(np.where(behind_std >= KNOWN, special.chdtrc(counted, chi2), estimated))
