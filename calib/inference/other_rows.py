"""What all other rows of a joint fit say about the parameters of some of its rows, as a few rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg as la

from calib.problem.degrees_of_freedom import hat_root


class OtherRows(NamedTuple):
    """The other rows of a joint fit in as many rows as there are parameters.

    Attributes
    ----------
    slope : ndarray (n, n_params)
        ``G = -de/dtheta`` by the parameters of the rows kept.
    held : ndarray (n, n_held)
        Change of -e by one standard deviation of each held parameter.
    residual : ndarray (n,)
        e at the joint optimum.
    """

    slope: np.ndarray
    held: np.ndarray
    residual: np.ndarray


def none_beside(n_params: int, n_held: int = 0) -> OtherRows:
    """No other rows."""
    return OtherRows(np.zeros((0, n_params)), np.zeros((0, n_held)), np.zeros(0))


def rows_beside(others: OtherRows | None, n_params: int, n_held: int) -> OtherRows:
    """Other rows, if any, with so many held parameters, which rows of priors do not depend on."""
    if others is None:
        return none_beside(n_params, n_held)
    return others if others.held.shape[1] else others._replace(held=np.zeros((len(others.slope), n_held)))


def other_rows(
    slope: np.ndarray,
    prior_sd: np.ndarray,
    residual: np.ndarray,
    shift: np.ndarray,
    own_rows: Sequence[int] | np.ndarray,
    own_params: Sequence[int] | np.ndarray,
    held: np.ndarray | None = None,
) -> OtherRows:
    """Condense the rows beside ``own_rows`` to rows about ``own_params``, exactly for a linear model.

    With B the other rows and o the parameters that only they have, the stack ``[G_Bo, G_B; diag(1/s_o), 0]`` with the
    residual ``[e_B; -shift_o]`` is projected off its first columns, which marginalises these parameters, and reduced to
    a triangle that has the same normal equations (square-root information filter, Bierman 1977, chapter V). Own rows,
    these rows and the priors of the own parameters together have the optimum and the posterior covariance of the joint
    fit.

    Parameters
    ----------
    slope : ndarray (n_rows, n_params)
        G of all rows of the joint fit.
    prior_sd : ndarray (n_params,)
        Infinite without a prior.
    residual : ndarray (n_rows,)
        Whitened.
    shift : ndarray (n_params,)
        Pull ``(theta - c)/s``.
    own_rows, own_params : sequence of int
        What is kept.
    held : ndarray (n_rows, n_held), optional
        As in `OtherRows`.
    """
    own = np.asarray(own_params, dtype=int)
    held = np.zeros((len(slope), 0)) if held is None else held
    others = np.setdiff1d(np.arange(len(slope)), own_rows)
    only = np.setdiff1d(np.arange(slope.shape[1]), own)
    kept = np.column_stack([slope[np.ix_(others, own)], held[others], residual[others]])
    prior = np.zeros((len(only), kept.shape[1]))
    prior[:, -1] = -shift[only]
    stack = np.vstack([kept, prior])
    basis = _basis(slope[np.ix_(others, only)], prior_sd[only])
    if not len(stack):
        return none_beside(len(own), held.shape[1])
    for _ in range(2):  # twice is enough (Kahan and Parlett)
        stack = stack - basis @ (basis.T @ stack)
    rows = la.qr(stack, mode="r")[0][: stack.shape[1]]
    return OtherRows(rows[:, : len(own)], rows[:, len(own) : -1], rows[:, -1])


def _basis(slope: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns of the slope and the priors below it, (n_rows + n_params, rank)."""
    return hat_root(np.vstack([slope, np.diag(1.0 / prior_sd)]), np.full(len(prior_sd), np.inf))
