"""Degrees of freedom of a fit and of a scatter, and the chance of a sum of squares."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping

import numpy as np
from scipy import special

KNOWN = 1e9
"""Degrees of freedom that stand for a scatter without an error of its own."""

POOL_BELOW = 10
"""With fewer repeats the scatter of a single number is itself too uncertain (34 % with five) and is pooled."""

LEAST_FREEDOM = 2 - 1e-6
"""Effective degrees of freedom below which data cannot speak against a fit; priors take a little of the last one."""

_ZERO = 1e-13


def row_freedom(slope: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """What a fit leaves of each row's variance, ``1 - h_i`` with h the diagonal of the hat matrix, (n_rows,).

    The sum is the effective number of degrees of freedom, rows less ``tr(H)``, ``H = G (G^T G + diag(1/s^2))^-1 G^T``
    (Hastie, Tibshirani and Friedman 2009, section 7.6; Ye 1998). A parameter that its prior holds counts for as much as
    the data move it: one that acts on nothing takes nothing. Whole numbers have no slope and are not counted.

    Parameters
    ----------
    slope : ndarray (n_rows, n_params)
        Derivative of the whitened residual, of either sign.
    prior_sd : ndarray (n_params,)
        Prior standard deviations, in the units of the slope; infinite without a prior.
    """
    return np.asarray(np.maximum(1.0 - np.sum(hat_root(slope, prior_sd) ** 2, axis=1), 0.0))


def hat_root(slope: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """Matrix S, (n_rows, rank), of which ``S S^T`` is the hat matrix; parameters as in `row_freedom`."""
    g, s = np.asarray(slope, dtype=float), np.asarray(prior_sd, dtype=float)
    if not g.shape[1]:
        return np.zeros((len(g), 0))
    whole = np.vstack([g, np.diag(1.0 / s)])
    size = np.linalg.norm(whole, axis=0)
    u, singular, _ = np.linalg.svd(whole / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(u[: len(g), singular > _ZERO * len(whole) * singular.max(initial=1.0)])


def effective_freedom(slope: np.ndarray, prior_sd: np.ndarray, fitted_factors: int = 0) -> float:
    """Effective degrees of freedom of a fit: rows less the trace of the hat matrix, less factors fitted to shapes.

    Parameters
    ----------
    slope, prior_sd
        As in `row_freedom`.
    fitted_factors : int
        Real numbers that scale and turn measured shapes.
    """
    return float(row_freedom(slope, prior_sd).sum()) - fitted_factors


def beside_known(freedom: float, shares: np.ndarray, pooled: bool = True) -> float:
    """Degrees of freedom behind variances of which repeats estimate a share only, and the rest is known exactly.

    With variances ``s^2 + c^2``, s estimated and c known, these are ``freedom ((s^2 + c^2)/s^2)^2`` (Welch 1947,
    Satterthwaite 1946). Where the shares of several values differ it is their mean that counts if all of them rest on
    one pooled estimate, and their root mean square if each rests on its own.

    Parameters
    ----------
    freedom : float
        Behind the estimated part of all values together.
    shares : ndarray
        Estimated part of each value's variance, 0 to 1; empty for all of it.
    pooled : bool
    """
    share = np.asarray(shares, dtype=float)
    square = 1.0 if not share.size else float(np.mean(share) ** 2 if pooled else np.mean(share**2))
    return freedom / square if square > 0 else math.inf


def widened_by(freedom: np.ndarray | float) -> np.ndarray:
    """Factor on a standard deviation that rests on so many degrees of freedom of its own, ``sqrt(nu/(nu - 2))``.

    With it the error over the deviation, a Student's t variate, has unit variance (JCGM 101:2008, 6.4.9). Without, a
    sum of squares over many rows is too large by ``nu/(nu - 2)``, however many rows there are.
    """
    nu = np.asarray(freedom, dtype=float)
    return np.asarray(np.sqrt(nu / np.maximum(nu - 2.0, 1.0)))


def freedom_each(freedom: float) -> float:
    """Degrees of freedom that a standard deviation widened so brings to an F test, ``(nu - 4)/3``.

    They give the sum of squares of n rows the variance ``2 n (nu - 1)/(nu - 4)`` of so many squares of t variates.
    """
    return max((freedom - 4.0) / 3.0, 1.0 / 3.0)


def repeats_freedom(
    kinds: Iterable[Hashable], repeats: float | None, shares: Iterable[float] | None = None
) -> dict[str, float]:
    """Degrees of freedom behind the scatter of all rows of a kind, from repeats; infinite without.

    Parameters
    ----------
    kinds : iterable of str
        Kind of every row.
    repeats : float or None
        Repeats behind the scatter, pooled over each kind; with 1 or None it is taken for known.
    shares : iterable of float, optional
        Part of each row's variance that the repeats tell; see `beside_known`. All of it by default.
    """
    names = [str(kind) for kind in kinds]
    told = np.ones(len(names)) if shares is None else np.array(list(shares), dtype=float)
    each = math.inf if repeats is None or repeats == 1 else float(repeats - 1)
    own = {kind: told[[name == kind for name in names]] for kind in dict.fromkeys(names)}
    # A row of which the repeats tell nothing brings no degrees of freedom either.
    estimated = {kind: int(np.count_nonzero(share)) for kind, share in own.items()}
    return {k: beside_known(each * estimated[k], s) if estimated[k] else math.inf for k, s in own.items()}


def behind(counts: Mapping[str, float], scatter_freedom: Mapping[str, float] | None) -> float:
    """Degrees of freedom behind the scatter of rows of several kinds (Satterthwaite 1946), weighted by their number.

    Parameters
    ----------
    counts : mapping from kind to float
        Degrees of freedom, or rows, of each kind.
    scatter_freedom : mapping from kind to float
        Of `repeats_freedom`; a kind left out is known.
    """
    given = scatter_freedom or {}
    total = sum(counts.values())
    spread = sum(count**2 / given.get(kind, math.inf) for kind, count in counts.items())
    return min(total**2 / spread, KNOWN) if spread > 0 else KNOWN


def chance(chi2: np.ndarray | float, freedom: np.ndarray | float, scatter: np.ndarray | float = KNOWN) -> np.ndarray:
    """Chance of a sum of squares as large in a right model, elementwise.

    An F variate when the standard deviations were estimated, else chi-square. With less than one degree of freedom it
    is that of one, which is no smaller: a perfect fit says nothing then, but one that is not even perfect does.
    """
    said = np.maximum(freedom, 1.0)
    known = np.minimum(scatter, KNOWN)
    exact = special.chdtrc(said, chi2)
    return np.asarray(np.where(known >= KNOWN, exact, special.fdtrc(said, known, np.asarray(chi2) / said)))
