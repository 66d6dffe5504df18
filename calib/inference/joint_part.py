"""What a joint fit says about the parameters of one of its tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from calib.inference.other_rows import OtherRows, other_rows
from calib.problem.joint import JointProblem

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
