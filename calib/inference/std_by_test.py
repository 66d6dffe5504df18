"""What each of several tests alone would determine of the parameters, beside all tests together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from calib.inference.identify import posterior
from calib.problem.space import ParameterSpace

ALL_TESTS = "all tests"
"""Name of the rows of the joint fit; no test can have it, since names of tests hold no spaces."""
COLUMNS = ("parameter", "unit", "test", "std", "prior_sd")


def std_by_test(
    space: ParameterSpace,
    names: Sequence[str],
    jacobian: np.ndarray,
    tests: Sequence[str],
    held: np.ndarray | None = None,
    birge: float = 1.0,
) -> pd.DataFrame:
    """Posterior standard deviations from the rows of each test, then of all, linearised at the joint fit.

    The values of a fit to one test alone differ, and with them its derivatives: these standard deviations compare the
    information of the tests, and are those of separate fits only near the joint one. Rows of all tests count as
    independent.

    Parameters
    ----------
    space : ParameterSpace
        For units and prior widths.
    names : sequence of str
        Parameters of the columns.
    jacobian : ndarray (n_rows, n_params)
        Of the whitened residual, per unit of each parameter.
    tests : sequence of str
        Test of every row, n_rows.
    held, birge
        As in `calib.inference.identify.identify`; the same factor for every test.

    Returns
    -------
    DataFrame
        ``parameter, unit, test, std, prior_sd``, in the parameters' own units; a parameter that a test does not see has
        its prior width there.
    """
    prior_sd, own = np.array([space[n].prior_width for n in names]), np.array(tests)
    groups = {**{test: own == test for test in dict.fromkeys(tests)}, ALL_TESTS: np.ones(len(own), dtype=bool)}
    rows = [
        (name, space[name].unit, test, std, width)
        for test, kept in groups.items()
        for name, std, width in zip(
            names,
            posterior(names, jacobian[kept] / birge, prior_sd, None if held is None else held[kept] / birge).std,
            prior_sd,
            strict=True,
        )
    ]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    order = {name: k for k, name in enumerate(names)}
    return table.sort_values("parameter", key=lambda column: column.map(order), kind="stable", ignore_index=True)
