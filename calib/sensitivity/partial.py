"""Partial rank correlation: rank correlation after the other parameters are regressed out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy import special
from scipy.linalg import qr

from calib.errors.errors import InputError
from calib.sensitivity.spearman import centred_ranks, same_rows

OWN_PART = 1e-6
"""Part of a column's length outside the span of the others below which it counts as rounding."""


def partial(points: pd.DataFrame, responses: pd.DataFrame) -> pd.DataFrame:
    """Partial rank correlation coefficient (PRCC) of every parameter with every response.

    Parameter and response are turned into ranks, the ranks of all other parameters are regressed out of both, and the
    residuals are correlated (Iman and Conover 1979; Marino et al. 2008). An inert parameter that a constraint binds to
    an active partner has no residual to correlate. Each parameter is projected on an orthonormal basis of the others
    (pivoted QR) and no correlation matrix is inverted: nearly collinear inputs cost certainty but no digits, and an
    inert parameter does not look active however tightly it is bound.

    Like every linear measure in ranks it is blind to even effects (the same up and down), and it is relative to what
    the others leave unexplained: a small effect in a smooth model can come close to 1. `variance_share` covers both.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown, dropped response by response.

    Returns
    -------
    DataFrame (n_parameters, n_responses)
        Between -1 and 1; NaN where the response never changes, where the parameter never changes or follows exactly
        from the others (an equality constraint), where the others explain the response completely, or without degrees
        of freedom.

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together, or a parameter is unknown somewhere.
    """
    out = np.full((points.shape[1], responses.shape[1]), np.nan)
    for columns, a, b in rank_blocks(points, responses):
        if degrees_of_freedom(len(a), a.shape[1]) < 1:
            continue
        for i in range(a.shape[1]):
            others = orthonormal(np.delete(a, i, axis=1))
            own = orthonormal_beyond(others, a[:, [i]])
            if own.shape[1] == 0:
                continue
            rest = b - others @ (others.T @ b)
            size = np.linalg.norm(rest, axis=0)
            known = size > OWN_PART * np.linalg.norm(b, axis=0)
            # The sign of a basis vector is arbitrary; take that of the parameter's own residual.
            sign = np.sign(own[:, 0] @ a[:, i])
            out[i, columns[known]] = np.clip(sign * (own[:, 0] @ rest[:, known]) / size[known], -1.0, 1.0)
    return pd.DataFrame(out, index=pd.Index(points.columns, name="parameter"), columns=responses.columns)


def partial_noise_floor(n_rows: int, n_parameters: int, n_cells: int, level: float = 0.95) -> float:
    """Noise floor: bound on every partial rank correlation of a table of inert parameters, with the given probability.

    For an inert parameter ``r sqrt(v/(1 - r**2))`` follows Student's t with ``v = n - 2 - (p - 1)`` degrees of freedom
    (Kendall and Stuart 1979, for ranks approximately); the level is shared among the cells (Sidak 1967).

    Parameters
    ----------
    n_rows : int
        Rows in which the response is known.
    n_parameters : int
        Parameters p, of which all but one are regressed out.
    n_cells : int
        Parameters times responses.
    level : float
        Probability that no spurious value is larger.

    Returns
    -------
    float
        1 when there are no degrees of freedom.
    """
    if n_rows < 1 or n_parameters < 1 or n_cells < 1 or not 0 < level < 1:
        raise InputError(
            f"no noise floor for {n_rows} rows, {n_parameters} parameters, {n_cells} cells and level {level:g}",
            place="partial rank correlation",
            remedy="give at least 1 of each and a level between 0 and 1",
        )
    free = degrees_of_freedom(n_rows, n_parameters)
    if free < 1:
        return 1.0
    t = float(-special.stdtrit(free, -0.5 * math.expm1(math.log(level) / n_cells)))
    return t / math.sqrt(free + t * t)


def degrees_of_freedom(n_rows: int, n_parameters: int) -> int:
    """Degrees of freedom of one partial correlation: rows less two, less the parameters regressed out."""
    return n_rows - 2 - (n_parameters - 1)


# -- arrays shared by the measures -------------------------------------------------------------------------------------


def table_arrays(points: pd.DataFrame, responses: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Values of two tables whose rows belong together; InputError when they do not, or a parameter is unknown."""
    if not points.index.equals(responses.index):
        raise InputError(
            f"{len(points)} points and {len(responses)} rows of responses do not belong together row for row",
            place="sensitivity",
        )
    x = points.to_numpy(dtype=float)
    if not np.isfinite(x).all():
        name = points.columns[~np.isfinite(x).all(axis=0)][0]
        raise InputError(f"parameter {name!r} is unknown at some point", place="sensitivity", remedy="drop that row")
    return x, responses.to_numpy(dtype=float)


def rank_blocks(points: pd.DataFrame, responses: pd.DataFrame) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Columns of responses known in the same rows, with the centred ranks of all parameters and of these responses."""
    x, y = table_arrays(points, responses)
    for rows, columns in same_rows(y):
        yield columns, centred_ranks(x[rows]), centred_ranks(y[np.ix_(rows, columns)])


def orthonormal(a: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span those of ``a``, even if these are nearly collinear."""
    size = np.linalg.norm(a, axis=0)
    a = a[:, size > 0] / size[size > 0]
    if a.shape[1] == 0:
        return a
    q, r, _ = qr(a, mode="economic", pivoting=True)
    return q[:, : int((np.abs(np.diag(r)) > OWN_PART).sum())]


def orthonormal_beyond(frame: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Orthonormal columns for the part of ``a`` outside the span of ``frame``, without parts that are rounding."""
    size = np.linalg.norm(a, axis=0)
    a = a[:, size > 0] / size[size > 0]
    for _ in range(2):  # one projection of nearly dependent columns leaves some rounding behind
        a = a - frame @ (frame.T @ a)
    if a.shape[1] == 0:
        return a
    q, r, _ = qr(a, mode="economic", pivoting=True)
    return q[:, : int((np.abs(np.diag(r)) > OWN_PART).sum())]
