"""In which of several tests the data ask for an effect: what it takes from the sum of squares of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calib.missing.explanation import Explanation
from calib.missing.pattern import explaining
from calib.problem.joint import TEST

BY_TEST = "reduction_by_test"
"""Name of the table."""
COLUMNS = ("effects", TEST, "rows", "before", "after", "share", "shown_first")


def reduction_table(found: Explanation, tests: Sequence[str]) -> pd.DataFrame:
    """Sum of squares of each test without and with the effects that are named or attempted, all tests fitted together.

    The joint fit minimises the sum of squares of all data and priors. That of one test may rise; its share of the
    whole decrease tells how much of the evidence is in it.

    Parameters
    ----------
    found : Explanation
    tests : sequence of str, n_rows
        Test of every row of the data.

    Returns
    -------
    DataFrame
        `COLUMNS`, for the fits of `calib.missing.pattern.explaining` and every test: ``before`` and ``after`` in units
        of the variance, ``share`` of the decrease over all data and priors (1 less that of the priors over all tests);
        NaN where there is no decrease. ``shown_first`` marks the test with the largest share by the first fit, where
        an effect is named; figures and reports begin with it.
    """
    labels, base, rows = np.array(tests), found.base.fit, []
    for candidate_fit in explaining(found):
        fit = candidate_fit.fit
        whole = base.misfit - fit.misfit
        for test in dict.fromkeys(tests):
            own = labels == test
            before, after = (float(np.sum(e[own] ** 2)) for e in (base.residual, fit.residual))
            share = (before - after) / whole if whole > 0 else np.nan
            rows.append((" + ".join(candidate_fit.names), test, int(own.sum()), before, after, share))
    table = pd.DataFrame(rows, columns=list(COLUMNS[:-1])).assign(shown_first=False)
    if found.names_something and found.chosen is not None:
        own = table[table["effects"] == " + ".join(found.chosen.names)].dropna(subset=["share"])
        if len(own):
            table.loc[own["share"].idxmax(), "shown_first"] = True
    return table
