"""Modes of small dense problems, such as those of a reduced model."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.compression import corrected_eigenpairs, static_eigenpairs
from calib.structure.eigenproblem.damped_problem import DampedProblem, real_times
from calib.structure.eigenproblem.eigenvalues import RotationalShare, damped_modes, is_zero, real_modes, vibrates
from calib.structure.eigenproblem.krylov import lowest_eigenpairs
from calib.structure.modes import Modes

_SHIFT = 1e-10
ACCURACY = 1e-9
"""Relative error of damped eigenvalues, by their residual, at which corrections of a smaller problem end."""
_LARGE = 100
"""Coordinates from which corrections of a smaller problem cost less than they save."""
_FEW = 8
"""Up to this many coordinates for each wanted mode a full eigensolution is as fast as a partial one."""


def solve_dense(
    stiffness: np.ndarray, damping: np.ndarray | None, mass: np.ndarray, count: int, rotational_share: RotationalShare
) -> Modes:
    """Lowest vibration modes of dense symmetric matrices, in the conventions of `solve_modes`.

    Parameters
    ----------
    stiffness, mass : ndarray (n, n)
        Symmetric, positive semidefinite; SI.
    damping : ndarray (n, n) or None
    count : int
    rotational_share : callable
        Share of a shape's kinetic energy in rotations; distinguishes spin from other zero eigenvalues.

    Raises
    ------
    EvaluationError
        When the problem cannot be solved.
    """
    for label, matrix in (("stiffness", stiffness), ("damping", damping), ("mass", mass)):
        if matrix is not None and not np.all(np.isfinite(matrix)):
            raise EvaluationError(f"the {label} matrix holds entries that are not finite")
    k, m = np.diag(stiffness), np.diag(mass)
    heavy = m > 1e-12 * m.max()
    shift = float(np.sqrt(_SHIFT * np.max(k[heavy] / m[heavy])))
    try:
        if damping is None or not np.any(damping):
            return _undamped(stiffness, mass, count, shift, rotational_share)
        return _damped(stiffness, damping, mass, count, shift, rotational_share)
    except la.LinAlgError as fault:
        raise EvaluationError(f"the eigenproblem could not be solved ({fault})") from fault


def _undamped(
    stiffness: np.ndarray, mass: np.ndarray, count: int, shift: float, rotational_share: RotationalShare
) -> Modes:
    n, requested = len(stiffness), count
    shifted = stiffness + shift**2 * mass
    while True:
        requested = min(requested, n)
        # K and M are exchanged so that massless motions cause no infinite eigenvalues.
        inverse, shapes = la.eigh(mass, shifted, subset_by_index=(n - requested, n - 1), check_finite=False)
        shapes = shapes[:, inverse > 1e-14 * inverse.max()]
        # Rigid-body modes make K nearly singular: eigenvalues lose digits, Rayleigh quotients do not.
        squares = np.einsum("ij,ij->j", shapes, stiffness @ shapes) / np.einsum("ij,ij->j", shapes, mass @ shapes)
        if requested == n or np.count_nonzero(~is_zero(squares, shift)) >= count:
            return real_modes(squares, shapes, mass, count, shift, rotational_share)
        requested *= 2


def _damped(
    stiffness: np.ndarray,
    damping: np.ndarray,
    mass: np.ndarray,
    count: int,
    shift: float,
    rotational_share: RotationalShare,
) -> Modes:
    """Damped modes in undamped modal coordinates: of a smaller problem where these are certain, else of the whole."""
    inverse, shapes = la.eigh(mass, stiffness + shift**2 * mass, check_finite=False)
    inverse, shapes = np.maximum(inverse[::-1], 0.0), shapes[:, ::-1]
    problem = DampedProblem(inverse, shapes.T @ damping @ shapes, shift)
    smaller = static_eigenpairs if problem.size < _LARGE else corrected_eigenpairs
    eigenvalues, motions = smaller(problem, count, ACCURACY) or _eigenpairs(problem, count)
    # Real eigenvalues beyond the wanted modes are incomplete.
    wanted = np.sort(np.abs(eigenvalues[vibrates(eigenvalues, shift)]))[:count]
    near = np.abs(eigenvalues) <= (1 + 1e-9) * wanted[-1] if len(wanted) else np.ones(len(eigenvalues), dtype=bool)
    eigenvalues, motions = eigenvalues[near], motions[:, near]

    def displacement(which: np.ndarray) -> np.ndarray:
        return real_times(shapes, motions[:, which])

    return damped_modes(eigenvalues, displacement, damping, mass, count, shift, rotational_share)


def _eigenpairs(problem: DampedProblem, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of the whole problem, at least the lowest: eigenvalues and displacements."""
    n, shift = problem.size, problem.shift
    squares = 1.0 / np.maximum(problem.mass, 1e-300) - shift**2
    first = int(np.count_nonzero(is_zero(squares, shift)))
    highest = float(np.sqrt(squares[min(first + count + 1, n - 1)]))
    inverse, overdamped = problem.inverse(), problem.overdamped(highest)
    try:
        inverses, states = lowest_eigenpairs(inverse, 2 * n, count, shift, n <= _FEW * count, overdamped)
    except spla.ArpackError:
        inverses, states = lowest_eigenpairs(inverse, 2 * n, count, shift, dense=True)
    return shift + 1.0 / inverses, states[:n]
