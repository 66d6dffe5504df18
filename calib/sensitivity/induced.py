"""Correlation between parameters induced by constraints, and the part of rank correlations that it induces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.sensitivity.partial import (
    degrees_of_freedom,
    orthonormal,
    orthonormal_beyond,
    rank_blocks,
    table_arrays,
)
from calib.sensitivity.spearman import centred_ranks


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Every Spearman value as the parameter's own part plus the part induced by correlated parameters (partners).

    Attributes
    ----------
    own : DataFrame (n_parameters, n_responses)
        Standardised coefficient of a linear regression of the response's ranks on the ranks of all parameters: the
        Spearman value if the inputs were uncorrelated and the rest of the response the same.
    induced : DataFrame (n_parameters, n_responses)
        Spearman's value less the own part: the sum over the partners of input correlation times the partner's own part
        (Wright 1934, path coefficients).
    partner : DataFrame (n_parameters, n_responses)
        Name of the partner that contributes most in the direction of ``induced``; empty where none does.
    """

    own: pd.DataFrame
    induced: pd.DataFrame
    partner: pd.DataFrame


def input_correlation(points: pd.DataFrame) -> pd.DataFrame:
    """Rank correlation between the parameters of a sample; off the diagonal 0 is expected without constraints.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)

    Returns
    -------
    DataFrame (n_parameters, n_parameters)
        Ones on the diagonal; NaN for a parameter that never changes.
    """
    x, _ = table_arrays(points, points)
    a = centred_ranks(x)
    size = np.linalg.norm(a, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        out = np.clip((a.T @ a) / np.outer(size, size), -1.0, 1.0)
    return pd.DataFrame(out, index=pd.Index(points.columns, name="parameter"), columns=points.columns)


def decompose(points: pd.DataFrame, responses: pd.DataFrame) -> Decomposition:
    """Split every Spearman value into the parameter's own part and the part induced by its partners.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown, dropped response by response.

    Returns
    -------
    Decomposition
        NaN (and no partner) where a response or parameter never changes, or the parameter follows exactly from others.

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together, or a parameter is unknown somewhere.
    """
    shape = points.shape[1], responses.shape[1]
    own, induced, partner = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, "", dtype=object)
    names = np.array([str(c) for c in points.columns], dtype=object)
    for columns, of_points, of_responses in rank_blocks(points, responses):
        if degrees_of_freedom(len(of_points), shape[0]) < 1:
            continue
        a, b = _unit(of_points), _unit(of_responses)
        paths = np.full((shape[0], len(columns)), np.nan)
        for i in range(shape[0]):
            beyond = orthonormal_beyond(orthonormal(np.delete(a, i, axis=1)), a[:, [i]])
            if beyond.shape[1]:
                paths[i] = (beyond[:, 0] @ b) / (beyond[:, 0] @ a[:, i])
        own[:, columns], induced[:, columns] = paths, a.T @ b - paths
        between = a.T @ a
        np.fill_diagonal(between, 0.0)
        for i in range(shape[0]):
            by_partner = np.nan_to_num(between[i][:, None] * paths) * np.sign(induced[i, columns])
            most = by_partner.argmax(axis=0)
            partner[i, columns] = np.where(by_partner.max(axis=0) > 0, names[most], "")
    index = pd.Index(points.columns, name="parameter")
    tables = (pd.DataFrame(part, index=index, columns=responses.columns) for part in (own, induced, partner))
    return Decomposition(*tables)


def _unit(a: np.ndarray) -> np.ndarray:
    """Columns of length 1, or of NaN where they were zero."""
    size = np.linalg.norm(a, axis=0)
    return a / np.where(size > 0, size, np.nan)
