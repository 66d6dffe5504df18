"""Given-data variance shares: the variance that only one parameter explains, with even and interaction effects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from calib.sensitivity.partial import orthonormal, orthonormal_beyond, table_arrays
from calib.sensitivity.rules import RULES
from calib.sensitivity.spearman import mean_ranks, same_rows

Unit = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class VarianceShare:
    """Variance share of parameters, or of groups of them, that the other parameters do not explain.

    Attributes
    ----------
    table : DataFrame (n_units, n_responses)
        Root of the share of the response's variance that only this unit explains, 0 to 1; for independent inputs it is
        comparable with the absolute value of a rank correlation. NaN for a parameter that follows exactly from others
        (an equality constraint), a constant response, or too few rows.
    floor : DataFrame (n_units, n_responses)
        Noise floor of the whole table at the given probability.
    straight, curved : DataFrame (n_units, n_responses)
        Parts of the unit's own sum of squares explained by linear terms and then by quadratic and cubic terms in its
        ranks; the rest, up to 1, is interaction with other parameters. An even effect is almost all ``curved``.
    """

    table: pd.DataFrame
    floor: pd.DataFrame
    straight: pd.DataFrame
    curved: pd.DataFrame


def variance_share(points: pd.DataFrame, responses: pd.DataFrame, level: float = 0.95) -> VarianceShare:
    """Share of every response's variance that only one parameter explains, for every parameter.

    A response (as normal scores of its ranks, van der Waerden 1952, so that outliers weigh little) is regressed on
    Legendre polynomials of the other parameters' ranks up to degree 4 and on their products in pairs. The terms of the
    parameter itself (degrees 1 to 3 and its product with every other one) are then added; the decrease of the sum of
    squares is the parameter's own. With RSS the residual sums of squares, q terms added and v degrees of freedom left,

        share = (RSS_without - RSS_with - q s**2) / TSS,     s**2 = RSS_with / v,

    which is zero on average for an inert parameter (Olejnik and Algina 2003, epsilon squared), and its floor is the
    quantile of Fisher's F for nested models at level**(1/cells) (Sidak 1967). Both hold for correlated inputs: an inert
    parameter bound to an active one by a constraint adds nothing once its partner is in. Integers with few values
    support fewer polynomials. With fewer than 1.5 rows per term, first the products and then degrees 3 and 4 are
    dropped; below that all cells are NaN.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown, dropped response by response.
    level : float
        Probability that no inert cell of the table passes its floor.

    Returns
    -------
    VarianceShare

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together, or a parameter is unknown somewhere.
    """
    return joint_variance_share(points, responses, [(str(name),) for name in points.columns], level)


def joint_variance_share(
    points: pd.DataFrame, responses: pd.DataFrame, units: Sequence[Unit], level: float = 0.95
) -> VarianceShare:
    """As `variance_share`, for groups of parameters, whose terms are added together.

    Parameters
    ----------
    points, responses : DataFrame
    units : sequence of tuples of parameter names
        The rows of the tables returned, named by the members joined with ``+``.
    level : float
    """
    x, y = table_arrays(points, responses)
    names = [str(c) for c in points.columns]
    members = [frozenset(names.index(m) for m in unit) for unit in units]
    shape = (len(units), y.shape[1])
    tables = np.full((4, *shape), np.nan)
    tail = -math.expm1(math.log(level) / max(1, shape[0] * shape[1]))
    for rows, columns in same_rows(y):
        terms = _Terms.of(x[rows])
        if terms is None:
            continue
        scores = _normal_scores(y[np.ix_(rows, columns)])
        for i, unit in enumerate(members):
            tables[:, i, columns] = _cells(terms, unit, scores, tail)
    index = pd.Index(["+".join(unit) for unit in units], name="parameter")
    return VarianceShare(*(pd.DataFrame(a, index=index, columns=responses.columns) for a in tables))


@dataclass(frozen=True, eq=False)
class _Terms:
    """Terms of the full regression: values (n, n_terms), the parameters each involves, and its degree."""

    values: np.ndarray
    owners: tuple[frozenset[int], ...]
    degrees: tuple[int, ...]

    @staticmethod
    def of(x: np.ndarray) -> _Terms | None:
        """The richest regression that the number of rows supports; None when not even quadratic terms are."""
        n, p = x.shape
        for degree, products in ((RULES.others_degree, True), (RULES.others_degree, False), (2, False)):
            count = 1 + degree * p + (p * (p - 1) // 2 if products else 0)
            if n >= RULES.rows_a_term * count:
                break
        else:
            return None
        ranks = 2.0 * (mean_ranks(x) - 0.5) / n - 1.0
        values, owners, degrees = [], [], []
        for i in range(p):
            for d in range(1, degree + 1):
                values.append(np.polynomial.legendre.legval(ranks[:, i], [0.0] * d + [1.0]))
                owners.append(frozenset({i}))
                degrees.append(d)
        for i, j in combinations(range(p), 2) if products else ():
            values.append(ranks[:, i] * ranks[:, j])
            owners.append(frozenset({i, j}))
            degrees.append(2)
        return _Terms(np.stack(values, axis=1), tuple(owners), tuple(degrees))


def _cells(terms: _Terms, unit: frozenset[int], scores: np.ndarray, tail: float) -> np.ndarray:
    """Variance share, floor, straight and curved part of one unit, (4, n_responses); NaN if it adds no terms."""
    n = len(scores)
    others = [k for k, owner in enumerate(terms.owners) if not owner & unit]
    own = [k for k, owner in enumerate(terms.owners) if owner & unit and terms.degrees[k] <= RULES.own_degree]
    kinds = (
        [k for k in own if terms.degrees[k] == 1],
        [k for k in own if len(terms.owners[k]) == 1 and terms.degrees[k] > 1],
        [k for k in own if len(terms.owners[k]) == 2],
    )
    frame = orthonormal(np.column_stack([np.ones(n), terms.values[:, others]]))
    rest = scores - frame @ (frame.T @ scores)
    taken, q = [], 0
    for kind in kinds:
        added = orthonormal_beyond(frame, terms.values[:, kind])
        taken.append(((added.T @ rest) ** 2).sum(axis=0))
        frame, q = np.column_stack([frame, added]), q + added.shape[1]
    left = n - frame.shape[1]
    if q == 0 or left < 2:
        return np.full((4, scores.shape[1]), np.nan)
    total, gain = (scores**2).sum(axis=0), np.sum(taken, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = np.maximum((rest**2).sum(axis=0) - gain, 0.0) / left
        share = np.clip((gain - q * spread) / total, 0.0, 1.0)
        limit = np.minimum(q * spread * (float(special.fdtri(q, left, 1.0 - tail)) - 1.0) / total, 1.0)
        return np.stack([np.sqrt(share), np.sqrt(limit), taken[0] / gain, taken[1] / gain])


def _normal_scores(y: np.ndarray) -> np.ndarray:
    """Van der Waerden scores of each column, centred; a constant column becomes zeros."""
    scores = special.ndtri(mean_ranks(y) / (len(y) + 1))
    scores = scores - scores.mean(axis=0)
    return np.where(np.ptp(y, axis=0) > 0, scores, 0.0)
