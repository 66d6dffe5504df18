"""Symmetric systems with a border, which are regular where the matrix by itself is singular."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.inertia import symmetric_factor

_RESIDUAL = 1e-6
"""Largest relative residual of a bordered solve; beyond it an unsolved close mode makes the matrix singular."""


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
    x = x + solved(right - whole @ x)  # one iterative refinement makes up for the relaxed pivoting
    miss = np.linalg.norm(right - whole @ x, axis=0)
    size = np.linalg.norm(right, axis=0)
    good = bool(np.all(np.isfinite(x))) and bool(np.all(miss <= _RESIDUAL * np.maximum(size, 1e-300)))
    return x[:n], good


def _sparse_solve(lu: spla.SuperLU, dtype: np.dtype, b: np.ndarray) -> np.ndarray:
    return lu.solve(np.ascontiguousarray(b, dtype=dtype))
