"""Leave-one-group-out prediction of a fitted model, in closed form and without fitting again."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from calib.errors.errors import InputError
from calib.problem.degrees_of_freedom import p_value


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Every group of rows as predicted by a fit to all the others.

    Attributes
    ----------
    names : tuple
        Labels of the groups, length n_groups, in the order of their first row.
    residual : ndarray (n_rows,)
        Whitened residual of every row after a fit without its group, in the order of the rows.
    variance : ndarray (n_rows,)
        Expected square for a correctly specified model: 1 for the noise and the rest for the parameters.
    elpd : ndarray (n_groups,)
        Logarithm of the predictive density of each group, without the terms that all models of the same data share
        (``-n/2 ln 2 pi`` and the standard deviations).
    chi2 : ndarray (n_groups,)
        Squared prediction error of each group in units of its predictive covariance.
    n_rows : ndarray (n_groups,), int
    """

    names: tuple[Hashable, ...]
    residual: np.ndarray
    variance: np.ndarray
    elpd: np.ndarray
    chi2: np.ndarray
    n_rows: np.ndarray

    def p(self, fitted_factors: Mapping[Hashable, int] | None = None, std_dof: float | np.ndarray = np.inf) -> float:
        """Probability that a correctly specified model predicts its worst group as badly (Bonferroni).

        Parameters
        ----------
        fitted_factors : mapping from group to int, optional
            Numbers fitted within a group, such as scale and phase of its shape; each costs one degree of freedom.
        std_dof : float or ndarray (n_groups,)
            Degrees of freedom of the estimated standard deviations; with infinitely many chi2 is chi-square, otherwise
            an F variate.
        """
        lost = np.array([(fitted_factors or {}).get(name, 0) for name in self.names])
        dof = self.n_rows - lost
        some = dof >= 1
        if not some.any():
            return 1.0
        std = np.broadcast_to(std_dof, dof.shape)[some]
        return float(min(1.0, p_value(self.chi2[some], dof[some], std).min() * some.sum()))


def leave_one_out(
    residual: np.ndarray,
    slope: np.ndarray,
    prior_sd: np.ndarray,
    groups: Sequence[Hashable],
    others: np.ndarray | None = None,
    held: Sequence[bool] | np.ndarray | None = None,
) -> LeaveOneOut:
    """Predict every group from all others, in closed form.

    At the optimum ``G^T e = (theta - c)/s^2``, the prior included, so that the gradient of the misfit without group b
    is ``-G_b^T e_b``, and one Gauss-Newton step with ``H_-b = H - G_b^T G_b``, ``H = G^T G + diag(1/s^2)``, leads to
    the optimum without it:

        e_(-b) = e_b + G_b H_-b^-1 G_b^T e_b = (I - G_b H^-1 G_b^T)^-1 e_b,

    the second form by Woodbury's identity. It is exact for a linear model (Allen 1974; Cook and Weisberg 1982, for
    single rows and groups without a prior). The predictive covariance is ``I + G_b H_-b^-1 G_b^T``, the same inverse,
    so that ``chi2_b = e_b^T e_(-b)`` and ``elpd_b = -chi2_b/2 + ln|I - H^-1 G_b^T G_b|/2``. All matrices are
    (n_params, n_params). ``H_-b`` is summed over the other groups, not subtracted from H: cancellation would lose a
    parameter that one group alone informs.

    Parameters
    ----------
    residual : ndarray (n_rows,)
        Whitened, at the optimum.
    slope : ndarray (n_rows, n_params)
        ``G = -de/dtheta``.
    prior_sd : ndarray (n_params,)
        Prior standard deviations, in the units of the slope; infinite without a prior.
    groups : sequence, length n_rows
        Label of the group of every row, such as its mode.
    others : ndarray (n_others, n_params), optional
        Slope of further rows of the same fit, which are never left out, such as those of other tests; see
        `calib.inference.other_rows`.
    held : sequence of bool, length n_params, optional
        Whether a limit holds a parameter: it stays there whatever is left out.

    Raises
    ------
    InputError
        When shapes differ, numbers are not usable, or a parameter without a prior is informed by one group only.
    """
    e, g, s = (np.asarray(a, dtype=float) for a in (residual, slope, prior_sd))
    if e.ndim != 1 or not len(e) or g.shape != (len(e), len(s)) or s.ndim != 1 or len(groups) != len(e):
        raise InputError(
            f"residual {e.shape}, slope {g.shape}, {len(s)} priors and {len(groups)} labels do not belong together",
            place="left-out data",
        )
    if not (np.all(np.isfinite(e)) and np.all(np.isfinite(g)) and np.all(s > 0)):
        raise InputError("the residual, the slope or a prior is not a usable number", place="left-out data")
    names = tuple(dict.fromkeys(groups))
    place = {name: k for k, name in enumerate(names)}
    number = np.array([place[label] for label in groups], dtype=int)
    rows = [np.flatnonzero(number == k) for k in range(len(names))]
    # Columns of length one, the prior included, make the numbers independent of units.
    free = np.ones(len(s)) if held is None else 1.0 - np.asarray(held, dtype=float)
    beside = (np.zeros((0, len(s))) if others is None else np.asarray(others, dtype=float)) * free
    g = g * free
    size = np.sqrt(np.sum(g**2, axis=0) + np.sum(beside**2, axis=0) + 1.0 / s**2)
    size = np.where(size > 0, size, 1.0)
    scaled, prior = g / size, np.diag(1.0 / (s * size) ** 2) + (beside / size).T @ (beside / size)
    products = [scaled[r].T @ scaled[r] for r in rows]
    without = _sums_without(products, prior)
    whole = _half_logdet(prior + sum(products), "all")
    out, variance = np.empty_like(e), np.empty_like(e)
    elpd, chi2 = np.empty(len(names)), np.empty(len(names))
    for k, r in enumerate(rows):
        factor = _factor(without[k], names[k])
        reach = la.solve_triangular(factor, scaled[r].T, lower=True)
        out[r] = e[r] + reach.T @ (reach @ e[r])
        variance[r] = 1.0 + np.sum(reach**2, axis=0)
        chi2[k] = e[r] @ out[r]
        elpd[k] = -0.5 * chi2[k] + np.sum(np.log(np.diag(factor))) - whole
    return LeaveOneOut(names, out, variance, elpd, chi2, np.array([len(r) for r in rows], dtype=int))


def _sums_without(products: Sequence[np.ndarray], first: np.ndarray) -> list[np.ndarray]:
    """``first`` plus the sum of all products but the k-th, for every k."""
    before = [first]
    for product in products[:-1]:
        before.append(before[-1] + product)
    after = np.zeros_like(first)
    sums = []
    for start, product in zip(reversed(before), reversed(products), strict=True):
        sums.append(start + after)
        after = after + product
    return sums[::-1]


def _factor(matrix: np.ndarray, name: Hashable) -> np.ndarray:
    try:
        return la.cholesky(matrix, lower=True)
    except la.LinAlgError:
        raise InputError(
            f"a parameter without a prior is informed by the group {name!r} only",
            place="left-out data",
            remedy="give it a prior",
        ) from None


def _half_logdet(matrix: np.ndarray, name: Hashable) -> float:
    return float(np.sum(np.log(np.diag(_factor(matrix, name)))))
