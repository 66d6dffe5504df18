"""Influence that no partner explains: given-data variance shares that see even and combined effects too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import special

from calib.sensitivity.partial import orthonormal, orthonormal_beyond, same_rows, table_arrays
from calib.sensitivity.ranks import mean_ranks

RELEVANT = 0.1
"""Influence below which a certain effect is still not worth a parameter: 1 % of the response's variance."""

_OWN_DEGREE, _OTHERS_DEGREE = 3, 4
_ROWS_A_TERM = 1.5
"""Rows needed for every term of the model."""

Unit = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Influence:
    """Unexplained-by-others influence of parameters, or of groups of them, on every response.

    Attributes
    ----------
    table : DataFrame (n_units, n_responses)
        Root of the share of the response's variance that only this unit brings, 0 to 1; for inputs that are independent
        it is comparable with the size of a rank correlation. NaN where it cannot be told: a parameter without values of
        its own (an equality constraint), a constant response, or too few rows.
    floor : DataFrame (n_units, n_responses)
        What chance alone would reach in the whole table with the given probability.
    straight, curved : DataFrame (n_units, n_responses)
        Parts of the unit's own sum of squares that straight lines and then parabolas and cubics in its ranks take; the
        rest, up to 1, acts only together with other parameters. An influence alike up and down is almost all curved.
    """

    table: pd.DataFrame
    floor: pd.DataFrame
    straight: pd.DataFrame
    curved: pd.DataFrame


def influence(points: pd.DataFrame, responses: pd.DataFrame, level: float = 0.95) -> Influence:
    """Influence of every parameter on every response, after all other parameters have explained what they can.

    A response (as normal scores of its ranks, van der Waerden 1952, so that outliers weigh little) is regressed on
    Legendre polynomials of the other parameters' ranks up to degree 4 and on their products in pairs. The terms of the
    parameter itself (degrees 1 to 3 and its product with every other one) are then added; what they take off the sum of
    squares is the parameter's own. With RSS the residual sums, q terms added and v degrees of freedom left,

        share = (RSS_without - RSS_with - q s**2) / TSS,     s**2 = RSS_with / v,

    which is zero on average for an inert parameter (Olejnik and Algina 2003, epsilon squared), and its floor is the
    quantile of Fisher's F for nested models at level**(1/cells) (Sidak 1967). Both hold for correlated inputs: an inert
    parameter bound to an active one by a constraint adds nothing once its partner is in. Whole numbers with few values
    simply support fewer polynomials. With fewer than 1.5 rows a term, first the products and then degrees 3 and 4 are
    left out; below that all cells are NaN.

    Parameters
    ----------
    points : DataFrame (n, n_parameters)
    responses : DataFrame (n, n_responses)
        Row for row with ``points``; NaN where unknown, dropped response by response.
    level : float
        Probability that no inert cell of the table passes its floor.

    Returns
    -------
    Influence

    Raises
    ------
    InputError
        When the rows of the two tables do not belong together, or a parameter is unknown somewhere.
    """
    return joint_influence(points, responses, [(str(name),) for name in points.columns], level)


def joint_influence(
    points: pd.DataFrame, responses: pd.DataFrame, units: Sequence[Unit], level: float = 0.95
) -> Influence:
    """As `influence`, for groups of parameters that are taken out and put back together.

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
    return Influence(*(pd.DataFrame(a, index=index, columns=responses.columns) for a in tables))


@dataclass(frozen=True, eq=False)
class _Terms:
    """Columns of the full model: values (n, n_terms), the parameters each involves, and its degree."""

    values: np.ndarray
    owners: tuple[frozenset[int], ...]
    degrees: tuple[int, ...]

    @staticmethod
    def of(x: np.ndarray) -> _Terms | None:
        """The richest model that the number of rows carries; None when it carries not even parabolas."""
        n, p = x.shape
        for degree, products in ((_OTHERS_DEGREE, True), (_OTHERS_DEGREE, False), (2, False)):
            count = 1 + degree * p + (p * (p - 1) // 2 if products else 0)
            if n >= _ROWS_A_TERM * count:
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
    """Influence, floor, straight and curved part of one unit, (4, n_responses); NaN where it has no part of its own."""
    n = len(scores)
    others = [k for k, owner in enumerate(terms.owners) if not owner & unit]
    own = [k for k, owner in enumerate(terms.owners) if owner & unit and terms.degrees[k] <= _OWN_DEGREE]
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
