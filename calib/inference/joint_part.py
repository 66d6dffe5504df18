"""What a joint fit says about the parameters of one of its tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from calib.inference.constraints import ConstraintRows
from calib.inference.identify import posterior
from calib.inference.other_rows import OtherRows, other_rows
from calib.problem.joint import JointProblem
from calib.problem.prior import Prior
from calib.problem.problem import PairProblem
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
        Rows of the other tests, and constraints that count as data.
    held_sd : mapping from str to float
        Standard deviations of the held parameters of all tests that are uncertain.
    """

    names: tuple[str, ...]
    prior_sd: np.ndarray
    others: OtherRows
    held_sd: Mapping[str, float]


def joint_parts(
    problem: PairProblem[Any] | JointProblem,
    names: Sequence[str],
    residual: np.ndarray,
    jacobian: np.ndarray,
    prior_sd: np.ndarray,
    shift: np.ndarray,
    held: np.ndarray | None = None,
    held_sd: Mapping[str, float] = _NONE,
    constraints: ConstraintRows | None = None,
) -> dict[str, JointPart]:
    """The part of every test, by its name.

    Parameters
    ----------
    problem : PairProblem or JointProblem
        A problem of one test is its only part, by the name "".
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
    constraints : ConstraintRows, optional
        Rows beside the data; they are other rows to every test.
    """
    parts, held = {}, np.zeros((len(residual), len(held_sd))) if held is None else held
    beside = constraints or ConstraintRows.none(len(names), len(held_sd))
    jacobian, held = np.vstack([jacobian, beside.slope]), np.vstack([held, beside.held])
    residual = np.concatenate([residual, beside.residual])
    tests, spaces = [""] * len(problem.rows), {"": problem.space}
    if isinstance(problem, JointProblem):
        tests, spaces = [row.test for row in problem.rows], {test: part.space for test, part in problem.parts.items()}
    for test, space in spaces.items():
        rows = [k for k, name in enumerate(tests) if name == test]
        kept = [k for k, name in enumerate(names) if name in space]
        others = other_rows(-jacobian, prior_sd, residual, shift, rows, kept, -held)
        parts[test] = JointPart(tuple(names[k] for k in kept), prior_sd[kept], others, held_sd)
    return parts


ALL_TESTS = "all tests"
"""Name of the rows of the joint fit; no test can have it, since names of tests hold no spaces."""
COLUMNS = ("parameter", "unit", "test", "std", "prior_sd")


def std_by_test(
    space: ParameterSpace,
    names: Sequence[str],
    values: Mapping[str, float],
    jacobian: np.ndarray,
    tests: Sequence[str],
    held: np.ndarray | None = None,
    birge: float = 1.0,
    constraints: ConstraintRows | None = None,
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
    values : mapping from str to float
        Of the joint fit.
    jacobian : ndarray (n_rows, n_params)
        Of the whitened residual, per unit of each parameter.
    tests : sequence of str
        Test of every row, n_rows.
    held, birge, constraints
        As in `calib.inference.identify.identify`; the same factor and constraints for every test.

    Returns
    -------
    DataFrame
        ``parameter, unit, test, std, prior_sd``, in the parameters' own units; a parameter that a test does not see has
        its prior width there.
    """
    prior_sd, own = Prior.of(space).widths(values, names), np.array(tests)
    widths = [space[n].prior_width_at(values[n]) for n in names]
    groups = {**{test: own == test for test in dict.fromkeys(tests)}, ALL_TESTS: np.ones(len(own), dtype=bool)}
    held = np.zeros((len(own), 0)) if held is None else held
    beside = constraints or ConstraintRows.none(len(names), held.shape[1])
    rows = []
    for test, kept in groups.items():
        slope, moved = (np.vstack([a[kept] / birge, b]) for a, b in ((jacobian, beside.slope), (held, beside.held)))
        known = zip(names, posterior(names, slope, prior_sd, moved).std, widths, strict=True)
        rows += [(name, space[name].unit, test, std, width) for name, std, width in known]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    order = {name: k for k, name in enumerate(names)}
    return table.sort_values("parameter", key=lambda column: column.map(order), kind="stable", ignore_index=True)
