"""Which parameter, or magnitude of an effect, differs between several tests of one structure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.missing.goodness import p_words
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.local import WIDE, interval_words
from calib.missing.score import family_p, scored
from calib.problem.joint import JointRows

BETWEEN = "test_differences"
"""Name of the table."""
COLUMNS = ("parameter", "test", "value", "change", "change_low", "change_high", "unit", "z")


@dataclass(frozen=True)
class Differences:
    """Differences of shared parameters between tests.

    Attributes
    ----------
    table : DataFrame
        `COLUMNS`, largest score first: what a parameter would be larger by in one test, ``value`` being that of all
        tests together, with its 95 % interval; all to first order.
    p : float
        Family-wise p-value of the largest score if nothing differs; 1 where nothing can differ.
    """

    table: pd.DataFrame
    p: float

    def sentence(self, alpha: float) -> str:
        """The result in words; empty where no parameter is shared."""
        if self.table.empty:
            return ""
        count = f"the largest of {len(self.table)} differences between the tests"
        if self.p > alpha:
            return f"No parameter differs between the tests: {p_words(self.p)} for {count}."
        row = self.table.iloc[0]
        value, low, high = (float(row[name]) for name in ("change", "change_low", "change_high"))
        size = interval_words(value, low, high, str(row["unit"]))
        return (
            f"Between the tests {row['parameter']} differs: in {row['test']} by {size}, {p_words(self.p)} for {count}."
        )


def differences(fit: LinearisedFit, tests: JointRows, seed: int) -> Differences:
    """Score, for every parameter that several tests share, that it differs in one of them.

    The signature is the derivative of that test's data alone (Rao's score test, 1948; see `calib.missing.score`), all
    parameters projected out. Of two tests the second is told, since the first would differ by the opposite.

    Parameters
    ----------
    fit : LinearisedFit
        Of all tests together.
    tests : JointRows
        Labels of its rows.
    seed : int
        Of the samples behind the p-value.
    """
    owner = np.array([row.test for row in tests.rows])
    found, raw = [], []
    for k, name in enumerate(fit.names):
        acting = [test for test in tests.parts if np.any(fit.slope[owner == test, k])]
        for test in acting[1:] if len(acting) == 2 else acting if len(acting) > 2 else ():
            found.append((name, test))
            raw.append(np.where(owner == test, fit.slope[:, k], 0.0))
    if not raw:
        return Differences(pd.DataFrame(columns=list(COLUMNS)), 1.0)
    scores = scored(
        fit, [name for name, _ in found], [{}] * len(raw), np.column_stack(raw), [True] * len(raw), [0.0] * len(raw)
    )
    space = fit.fit_problem.space
    rows = []
    for k, (name, test) in enumerate(found):
        if scores.size[k]:
            change, std = scores.z[k] / scores.size[k], 1 / scores.size[k]
            ends = (change - WIDE * std, change + WIDE * std)
            rows.append((name, test, fit.values[name], change, *ends, space[name].unit, scores.z[k]))
    table = pd.DataFrame(rows, columns=list(COLUMNS)).sort_values("z", key=np.abs, ascending=False, ignore_index=True)
    return Differences(table, family_p(scores, tests, seed))
