"""What a joint fit says about the parameters of one of its tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pandas as pd

from calib.inference.identify import posterior
from calib.inference.other_rows import OtherRows, other_rows
from calib.problem.joint import JointProblem
from calib.problem.space import ParameterSpace

_NONE: Mapping[str, float] = MappingProxyType({})


class JointPart(NamedTuple):
    """What a joint fit says about the parameters of one of its tests.

    Attributes
    ----------
    names : tuple of str
        Fitted parameters that the test's model has.
    prior_sd : ndarray (n_params,)
    others : OtherRows
        Rows of the other tests.
    held_sd : mapping from str to float
        Standard deviations of the held parameters of all tests that are uncertain.
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    others: OtherRows
    held_sd: Mapping[str, float]


def joint_parts(
    problem: JointProblem,
    names: Sequence[str],
    residual: np.ndarray,
    jacobian: np.ndarray,
    prior_sd: np.ndarray,
    shift: np.ndarray,
    held: np.ndarray | None = None,
    held_sd: Mapping[str, float] = _NONE,
) -> dict[str, JointPart]:
    """The part of every test, by its name.

    Parameters
    ----------
    problem : JointProblem
    names : sequence of str
        Fitted parameters.
    residual : ndarray (n_rows,)
        Whitened, at the optimum.
    jacobian : ndarray (n_rows, n_params)
        Its derivative.
    prior_sd, shift : ndarray (n_params,)
        Prior standard deviations, and the pull ``(theta - c)/s``.
    held : ndarray (n_rows, n_held), optional
        Change of the residual by one standard deviation of each of the held parameters in ``held_sd``.
    """
    parts = {}
    for test, own in problem.parts.items():
        rows = [k for k, row in enumerate(problem.rows) if row.test == test]
        kept = [k for k, name in enumerate(names) if name in own.space]
        others = other_rows(-jacobian, prior_sd, residual, shift, rows, kept, None if held is None else -held)
        parts[test] = JointPart(tuple(names[k] for k in kept), prior_sd[kept], others, held_sd)
    return parts


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
