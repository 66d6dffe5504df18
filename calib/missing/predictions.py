"""Predictions of held-out data with 95 % intervals, of a fit alone and with its unexplained misfit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg as la

from calib.inference.rules import WIDE
from calib.missing.adequacy import UNSEEN
from calib.missing.discrepancy import Discrepancy
from calib.problem.degrees_of_freedom import KNOWN, p_value
from calib.problem.labels import Label, label_table

TABLE, ERRORS = "unexplained_predictions", "unexplained_errors"
"""Names of the tables."""
WITH = "_unexplained"
"""What columns of the interval and of the error with the unexplained misfit end in."""
INTERVAL = ("low", "high", "inside")
ERROR_COLUMNS = ("group", "rows", "rms", "expected", "p", f"expected{WITH}", f"p{WITH}")
_LABELS = ("mode", "sensor", "kind", "part")


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Held-out data of one group beside their predictions by a fitted model.

    Attributes
    ----------
    labels : sequence of Label
        Length n.
    value : ndarray (n,)
        What was measured.
    std : ndarray (n,)
        Its standard deviation, relative where ``relative`` says so.
    relative : ndarray (n,), bool
        Rows that compare logarithms.
    residual : ndarray (n,)
        (Measured - predicted)/std, of logarithms where relative.
    names : tuple of str
        Fitted parameters, length p.
    slope : ndarray (n, p)
        Change of the predictions per unit of each parameter, over std.
    spread : ndarray (n, k)
        A with ``I + A A^T`` the covariance of the residual for a correctly specified model.
    factors : int
        Numbers that are fitted to these rows themselves.
    lost : ndarray (n,), bool
        Rows without a prediction, whose residual only counts.
    std_dof : float
        Degrees of freedom behind the standard deviations.
    """

    labels: Sequence[Label]
    value: np.ndarray
    std: np.ndarray
    relative: np.ndarray
    residual: np.ndarray
    names: tuple[str, ...]
    slope: np.ndarray
    spread: np.ndarray
    factors: int = 0
    lost: np.ndarray | None = None
    std_dof: float = KNOWN

    @property
    def predicted(self) -> np.ndarray:
        """Predictions, (n,)."""
        return self._at(self.residual)

    def intervals(self, spread: np.ndarray) -> pd.DataFrame:
        """95 % intervals of the measured values about their predictions, `INTERVAL`, n rows.

        Parameters
        ----------
        spread : ndarray (n, k)
            As the attribute.
        """
        half = WIDE * np.sqrt(1.0 + np.sum(spread**2, axis=1))
        low, high = (self._at(self.residual + side * half) for side in (1, -1))
        return pd.DataFrame(dict(zip(INTERVAL, (low, high, np.abs(self.residual) <= half), strict=True)))

    def _at(self, residual: np.ndarray) -> np.ndarray:
        """Predictions with a given residual."""
        with np.errstate(over="ignore"):
            relative = self.value * np.exp(-np.where(self.relative, residual * self.std, 0.0))
        return np.where(self.relative, relative, self.value - residual * self.std)

    def error(self, spread: np.ndarray) -> tuple[float, float]:
        """Expected rms error in standard deviations, and the probability of a larger sum of squares."""
        e, n = self.residual, len(self.residual)
        along = spread.T @ e
        root = la.cho_factor(np.eye(len(along)) + spread.T @ spread)
        chi2 = float(e @ e - along @ la.cho_solve(root, along))
        expected = math.sqrt((n - self.factors + float(np.sum(spread**2))) / n)
        return expected, float(p_value(chi2, n - self.factors, self.std_dof))


def prediction_tables(
    held_out: Mapping[str, HeldOut], wide: Discrepancy, changes: Mapping[str, np.ndarray]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Predictions and errors by group, with what is expected of the fit alone and with the discrepancy.

    The prediction stays that of the fit, and its error with the discrepancy has the second moment about it,
    ``C + m m^T`` with mean m and covariance C: what is missing may be unlike every candidate, and then m leads astray.

    Parameters
    ----------
    held_out : mapping from group to HeldOut
    wide : Discrepancy
    changes : mapping from group to ndarray (n, m)
        Change of the predictions per unit of every column of the discrepancy, over std.

    Returns
    -------
    predictions : DataFrame
        ``group``, the labels of the rows, ``value``, ``predicted``, `INTERVAL` and the same with `WITH`; without rows
        that have no prediction.
    errors : DataFrame
        `ERROR_COLUMNS`, one row for each group; none where no row of any group has a prediction.
    """
    tables, errors = [], []
    for group, own in held_out.items():
        mean, added = wide.elsewhere(own.names, own.slope, changes[group])
        whole = np.hstack([own.spread, added, mean[:, None]])
        rms = math.sqrt(float(np.mean(own.residual**2)))
        errors.append((group, len(own.residual), rms, *own.error(own.spread), *own.error(whole)))
        labels = label_table(own.labels)
        labels = labels.reindex(columns=[*dict.fromkeys([*_LABELS, *labels.columns])], fill_value="")
        parts = [
            labels.assign(value=own.value, predicted=own.predicted),
            own.intervals(own.spread),
            own.intervals(whole).add_suffix(WITH),
        ]
        table = pd.concat(parts, axis=1)
        table.insert(0, "group", group)
        tables.append(table if own.lost is None else table[~own.lost])
    if not any(len(table) for table in tables):
        return pd.DataFrame(), pd.DataFrame(columns=list(ERROR_COLUMNS))
    return pd.concat(tables, ignore_index=True), pd.DataFrame(errors, columns=list(ERROR_COLUMNS))


def predictions_sentence(table: pd.DataFrame, errors: pd.DataFrame) -> str:
    """How far held-out data agree with the predictions, with and without the unexplained misfit; empty without data."""
    if table.empty:
        return ""
    groups = []
    for group, own in table.groupby("group", sort=False):
        error = errors[errors["group"] == group]
        rms, alone, beside = (
            math.sqrt(float((error["rows"] * error[name] ** 2).sum() / error["rows"].sum()))
            for name in ("rms", "expected", f"expected{WITH}")
        )
        groups.append(
            f"{UNSEEN.get(str(group), str(group))} {int(own['inside'].sum())} and {int(own[f'inside{WITH}'].sum())} of "
            f"{len(own)} (rms error {rms:.2g}, expected {alone:.2g} and {beside:.2g})"
        )
    return (
        "Validation data inside the 95 % intervals of their predictions, of the fit alone and with the unexplained "
        f"misfit: {'; '.join(groups)}."
    )
