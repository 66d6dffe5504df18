"""Single data that spoil a fit: each measured value, mode and sensor left out in turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy.linalg as la
from scipy import stats

from calib.freedom import KNOWN
from calib.missing.goodness import Fit, goodness, overall
from calib.missing.hypotheses import Label

COLUMNS = ("what", "kind", "rows", "chi2", "freedom", "p", "p_fit_without", "explains")
LEVEL = 0.01
"""Chance of calling a datum bad when none is, over all that are left out in turn."""
_LEAST = 2.0
"""Degrees of freedom without a datum below which nothing can be said to fit."""
_FOLLOWED = 0.02
"""Part of a value's variance left by the parameters below which the others do not predict it."""
_SINGULAR = 1e-9
"""The same of any combination of several values, below which their prediction is rounding."""


class Datum(NamedTuple):
    """Rows that belong to one value, mode or sensor.

    Attributes
    ----------
    what : str
        Such as ``frequency of 2B``.
    kind : {"value", "shape", "mode", "sensor"}
    rows : ndarray of int
    """

    what: str
    kind: str
    rows: np.ndarray


@dataclass(frozen=True, eq=False)
class _Rest:
    """A fit without some rows."""

    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray


def data_of(rows: Sequence[Label]) -> tuple[Datum, ...]:
    """Everything that may be bad by itself: values, shapes, modes, sensors and entries of shapes, or plain responses.

    What consists of the same rows as another is named once, by the smaller thing.
    """
    found: dict[tuple[str, str], list[int]] = {}
    for k, row in enumerate(rows):
        if not row.mode:
            names = [("value", row.sensor)]
        elif row.kind == "shape":
            names = [
                ("value", f"shape of {row.mode} at {row.sensor}"), ("shape", f"shape of {row.mode}"),
                ("mode", f"mode {row.mode}"), ("sensor", f"sensor {row.sensor}"),
            ]  # fmt: skip
        else:
            names = [("value", f"{row.kind} of {row.mode}"), ("mode", f"mode {row.mode}")]
        for name in names:
            found.setdefault(name, []).append(k)
    out, seen = [], set()
    for (kind, what), index in found.items():
        if tuple(index) not in seen and len(index) < len(rows):
            seen.add(tuple(index))
            out.append(Datum(what, kind, np.array(index)))
    return tuple(out)


def suspects(
    fit: Fit,
    rows: Sequence[Label],
    fitted_factors: Mapping[tuple[str, str], int],
    scatter_freedom: Mapping[str, float],
    level: float = LEVEL,
) -> pd.DataFrame:
    """Leave out every datum in turn, where the fit as a whole fails, and tell which of them alone is to blame.

    With G the slope, e the residual and V the posterior covariance of a fit, data b are predicted by all others with
    the error ``e_(-b) = (I - G_b V G_b^T)^-1 e_b`` (see `calib.missing.left_out`), so that leaving them out lowers the
    sum of squares by ``chi2_b = e_b^T e_(-b)``; all others move to ``e + G V G_b^T e_(-b)``. That is exact for a linear
    model. ``p`` is the chance of such a value of chi2_b times the number of data that were tried (Bonferroni, as in the
    test of studentised residuals; Cook and Weisberg 1982); ``p_fit_without`` is that of goodness of fit without b, NaN
    where p is above the level. A datum explains the misfit when the first is below and the second above the level: it
    is improbable by itself, and without it everything fits. A single value that the parameters follow nearly everywhere
    is not asked: its residual is what the search has left.

    Parameters
    ----------
    fit : Fit
        At its optimum.
    rows, fitted_factors, scatter_freedom
        As in `calib.missing.goodness.goodness`.
    level : float
        Also of goodness of fit.

    Returns
    -------
    DataFrame
        `COLUMNS`, the largest decrease first within those that explain, and those first; empty when everything fits.
    """
    if overall(*goodness(fit, rows, fitted_factors, scatter_freedom)) > level:
        return pd.DataFrame(columns=list(COLUMNS))
    e, g = np.asarray(fit.residual, dtype=float), np.asarray(fit.slope, dtype=float)
    unit, covariance = _scaled_covariance(g, fit.prior_sd)
    data = data_of(rows)
    lines = []
    for datum in data:
        b, others = datum.rows, np.setdiff1d(np.arange(len(e)), datum.rows)
        here = unit[b]
        inverse = np.eye(len(b)) - here @ covariance @ here.T
        if np.linalg.eigvalsh(inverse)[0] < (_FOLLOWED if len(b) == 1 else _SINGULAR):
            continue  # a parameter stands on these data alone
        predicted = la.solve(inverse, e[b], assume_a="pos")
        chi2 = float(e[b] @ predicted)
        lost = _factors(datum, rows, fitted_factors)
        freedom = float(max(len(b) - lost, 1))
        scatter = min((scatter_freedom.get(kind, np.inf) for kind in {rows[k].kind for k in b}), default=np.inf)
        p = min(1.0, len(data) * float(stats.f.sf(chi2 / freedom, freedom, min(scatter, KNOWN))))
        if p >= level:
            lines.append((datum.what, datum.kind, len(b), chi2, freedom, p, np.nan, False))
            continue
        rest = _Rest(e[others] + unit[others] @ (covariance @ (here.T @ predicted)), g[others], fit.prior_sd)
        left = [rows[k] for k in others]
        kept = {block: n for block, n in fitted_factors.items() if block in {(r.mode, r.kind) for r in left}}
        kinds, modes = goodness(rest, left, kept, scatter_freedom)
        p_fit = overall(kinds, modes)
        explains = p < level < p_fit and float(kinds["freedom"].sum()) >= _LEAST
        lines.append((datum.what, datum.kind, len(b), chi2, freedom, p, p_fit, explains))
    table = pd.DataFrame(lines, columns=list(COLUMNS))
    # Of two that explain, the one with fewer rows says more.
    order = np.lexsort((-table["chi2"], np.where(table["explains"], table["rows"], 0), ~table["explains"].astype(bool)))
    return table.iloc[order].reset_index(drop=True)


def sentence(table: pd.DataFrame) -> str:
    """Without which datum everything fits; empty where none alone is to blame."""
    guilty = table[table["explains"].astype(bool)]
    if guilty.empty:
        return ""
    first, more = guilty.iloc[0], guilty["what"].tolist()[1:4]
    words = (
        f"Without {first['what']} everything fits (p = {first['p_fit_without']:.2g}, to first order), and its chance "
        f"in a right model is {first['p']:.1g}, over all that were left out in turn: look at that measurement first."
    )
    return words + (f" So it does without {' or without '.join(more)}." if more else "")


def _scaled_covariance(slope: np.ndarray, prior_sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slope over columns of length one, prior included, and the covariance of what they multiply."""
    size = np.sqrt(np.sum(slope**2, axis=0) + 1.0 / np.asarray(prior_sd) ** 2)
    size = np.where(size > 0, size, 1.0)
    unit = slope / size
    return unit, la.pinvh(unit.T @ unit + np.diag(1.0 / (prior_sd * size) ** 2))


def _factors(datum: Datum, rows: Sequence[Label], fitted_factors: Mapping[tuple[str, str], int]) -> int:
    """Numbers fitted to shapes that are left out whole."""
    gone = set(datum.rows.tolist())
    blocks = {(rows[k].mode, rows[k].kind) for k in gone}
    whole = [b for b in blocks if all(k in gone for k, row in enumerate(rows) if (row.mode, row.kind) == b)]
    return sum(fitted_factors.get(block, 0) for block in whole)
