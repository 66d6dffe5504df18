"""Spearman rank correlation of parameters and responses, and its noise floor."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from scipy import special

from calib.errors.errors import InputError
from calib.sensitivity.rules import RULES


def mean_ranks(a: np.ndarray) -> np.ndarray:
    """Ranks from 1 of each column (n_rows, n_columns), ties by mean rank; shape as given."""
    from scipy.stats import rankdata  # slow to import, and not every command ranks

    return np.asarray(rankdata(a, axis=0)) if a.size else a


def centred_ranks(a: np.ndarray) -> np.ndarray:
    """Ranks of each column about their mean, ties by mean rank; shape as given."""
    return mean_ranks(a) - (len(a) + 1) / 2 if a.size else a


def spearman(points: pd.DataFrame, responses: pd.DataFrame) -> pd.DataFrame:
    """Rank correlation of every parameter with every response.

    Each pair uses the rows where both are known, so an unpaired mode affects its own responses only.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown.

    Returns
    -------
    DataFrame (n_parameters, n_responses)
        Between -1 and 1 (Spearman 1904, ties by mean rank); NaN where parameter or response is constant over the rows
        used, or fewer than 3 rows are complete.

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together.
    """
    x, y = _arrays(points, responses)
    out = np.full((x.shape[1], y.shape[1]), np.nan)
    for known_x, parameters in same_rows(x):
        for known_y, columns in same_rows(y):
            rows = known_x & known_y
            if rows.sum() < RULES.rows_least:
                continue
            a, b = centred_ranks(x[np.ix_(rows, parameters)]), centred_ranks(y[np.ix_(rows, columns)])
            # Sums of products of half-integers are exact, in whatever order they are added.
            size = np.sqrt(np.outer(np.sum(a * a, axis=0), np.sum(b * b, axis=0)))
            varies = size > 0
            out[np.ix_(parameters, columns)] = np.where(
                varies, (a.T @ b).clip(-size, size) / np.where(varies, size, 1.0), np.nan
            )
    return pd.DataFrame(out, index=pd.Index(points.columns, name="parameter"), columns=responses.columns)


def counts(points: pd.DataFrame, responses: pd.DataFrame) -> pd.DataFrame:
    """Complete rows behind every cell of `spearman`, (n_parameters, n_responses), int."""
    x, y = _arrays(points, responses)
    used = np.isfinite(x).T.astype(int) @ np.isfinite(y).astype(int)
    return pd.DataFrame(used, index=pd.Index(points.columns, name="parameter"), columns=responses.columns)


def noise_floor(n_rows: int, n_cells: int, level: float = 0.95) -> float:
    """Noise floor: bound on every rank correlation of a table of inert parameters, with the given probability.

    Under independence a rank correlation has variance 1/(n - 1) and is close to normal; for m cells taken as
    independent (Sidak 1967) the floor is ``z((1 + level**(1/m))/2) / sqrt(n - 1)``, z being the normal quantile.

    Parameters
    ----------
    n_rows : int
        Complete rows of the sample.
    n_cells : int
        Parameters times responses.
    level : float
        Probability that no spurious correlation is larger.

    Returns
    -------
    float
        At most 1.
    """
    if n_rows < RULES.rows_least or n_cells < 1 or not 0 < level < 1:
        raise InputError(
            f"no noise floor for {n_rows} rows, {n_cells} cells and level {level:g}",
            place="rank correlation",
            remedy="give at least 3 rows, 1 cell and a level between 0 and 1",
        )
    cell = -math.expm1(math.log(level) / n_cells)
    return min(1.0, float(-special.ndtri(0.5 * cell)) / math.sqrt(n_rows - 1))


def same_rows(y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Known rows (bool) and the columns that have exactly these, so that one ranking or regression serves them all."""
    known = np.isfinite(y)
    patterns: dict[bytes, list[int]] = {}
    for j in range(y.shape[1]):
        patterns.setdefault(known[:, j].tobytes(), []).append(j)
    return [(known[:, columns[0]], np.array(columns)) for columns in patterns.values()]


def _arrays(points: pd.DataFrame, responses: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    if not points.index.equals(responses.index):
        raise InputError(
            f"{len(points)} points and {len(responses)} rows of responses do not belong together row for row",
            place="rank correlation",
        )
    return points.to_numpy(dtype=float), responses.to_numpy(dtype=float)
