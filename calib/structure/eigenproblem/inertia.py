"""Solutions with a border, and the number of modes below a frequency (Sylvester)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor

_RESIDUAL = 1e-6
"""Largest relative residual of a bordered solve; beyond it an unsolved close mode makes the matrix singular."""
_BACKWARD = 1e-10
"""Largest backward error of a factor whose inertia is accepted: without pivoting its elements may grow."""


def count_below(stiffness: sp.csc_array, mass: sp.csc_array, freq: float) -> int:
    """Number of undamped modes below a frequency, with multiplicity and rigid-body motions included.

    By Sylvester's law of inertia, ``K - omega^2 M`` has as many negative eigenvalues as there are modes below omega,
    provided that M is positive semidefinite, K positive definite on its kernel, and omega is not an eigenfrequency.
    They are counted as the negative pivots of ``P A P^T = L D L^T``. The count is exact for a matrix that differs from
    A by the backward error of the factor, which is checked; a mode closer to ``freq`` than rounding error may fall on
    either side.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    freq : float
        Hz.

    Raises
    ------
    EvaluationError
        When the factor needs off-diagonal pivots or is too inaccurate.
    """
    shifted = sp.csc_array(stiffness - (2 * np.pi * freq) ** 2 * mass)
    unknown = f"the modes below {freq:.6g} Hz cannot be counted"
    try:
        lu = symmetric_factor(shifted)
    except RuntimeError as fault:
        raise EvaluationError(f"{unknown} ({fault})") from fault
    pivots = lu.pivots
    if not lu.on_diagonal:
        raise EvaluationError(f"{unknown}: a pivot vanishes")
    probe = np.random.default_rng(20110713).standard_normal(len(pivots))
    wanted = shifted @ probe
    solution = lu.solve(wanted)
    size = abs(shifted) @ np.abs(solution) + np.abs(wanted)
    with np.errstate(invalid="ignore"):
        error = np.max(np.abs(shifted @ solution - wanted) / np.where(size > 0, size, 1.0), initial=0.0)
    if not error < _BACKWARD:
        raise EvaluationError(f"{unknown}: the factor is too inaccurate")
    return int(np.count_nonzero(pivots < 0))


def bordered(matrix: Any, border: np.ndarray, top: np.ndarray, bottom: np.ndarray) -> tuple[np.ndarray, bool]:
    """Solution x of ``[Z, B; B^T, 0] [x; mu] = [top; bottom]`` and whether it is accurate.

    Parameters
    ----------
    matrix : sparse or dense (n, n)
        Z, symmetric.
    border : ndarray (n, m)
        B.
    top, bottom : ndarray (n, p), (m, p)

    Returns
    -------
    solution : ndarray (n, p)
    accurate : bool

    Raises
    ------
    EvaluationError
        When the bordered matrix cannot be factorised.
    """
    n, g = border.shape
    # The border is scaled to the size of the matrix, or pivoting would prefer one of them.
    largest = abs(matrix).max()
    scale = largest / np.abs(border).max(axis=0)
    edge = border * scale
    right = np.vstack([top, bottom * scale[:, None]])
    whole: Any
    solve: Callable[[np.ndarray], np.ndarray]
    if sp.issparse(matrix):
        blocks: list[list[Any]] = [[matrix, sp.csc_array(edge)], [sp.csc_array(edge.T), None]]
        whole = sp.csc_matrix(sp.block_array(blocks, format="csc"))
        try:
            lu = symmetric_factor(whole, 0.01)
        except RuntimeError as fault:
            raise EvaluationError(f"the derivative of a mode shape could not be solved ({fault})") from fault
        solve = partial(_sparse_solve, lu, whole.dtype)
    else:
        whole = np.block([[matrix, edge], [edge.T, np.zeros((g, g))]])
        solve = partial(la.lu_solve, la.lu_factor(whole, check_finite=False), check_finite=False)

    def solved(b: np.ndarray) -> np.ndarray:
        if np.iscomplexobj(b) and not np.iscomplexobj(whole):
            return solve(b.real) + 1j * solve(b.imag)
        return solve(b)

    x = solved(right)
    if sp.issparse(matrix):
        x = x + solved(right - whole @ x)  # one iterative refinement makes up for the relaxed pivoting
    miss = np.linalg.norm(right - whole @ x, axis=0)
    size = np.linalg.norm(right, axis=0)
    good = bool(np.all(np.isfinite(x))) and bool(np.all(miss <= _RESIDUAL * np.maximum(size, 1e-300)))
    return x[:n], good


def _sparse_solve(lu: SymmetricFactor, dtype: np.dtype, b: np.ndarray) -> np.ndarray:
    return lu.solve(np.ascontiguousarray(b, dtype=dtype))
