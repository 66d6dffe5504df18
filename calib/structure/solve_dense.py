"""Modes of small dense problems, such as those of a reduced model."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.errors import EvaluationError
from calib.structure.eigenvalues import RotationalShare, damped_modes, is_zero, real_modes, vibrates
from calib.structure.krylov import lowest_eigenpairs
from calib.structure.modes import Modes

_SHIFT = 1e-10
_REACH = 2.5
"""Undamped modes up to this multiple of the highest wanted frequency are kept; the rest follow quasi-statically."""
_EXACT = 1e-9
"""Largest relative eigenvalue error of that reduction, by its residual; beyond it the full matrices are used."""
_SAME = 1e-10
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
    """Damped modes in modal coordinates; modes far above the wanted ones are reduced to quasi-static corrections."""
    inverse, shapes = la.eigh(mass, stiffness + shift**2 * mass, check_finite=False)
    inverse, shapes = np.maximum(inverse[::-1], 0.0), shapes[:, ::-1]
    local = shapes.T @ damping @ shapes
    low, highest = _low(inverse, count, shift)
    everything = np.eye(len(inverse))
    for kept in (_compressed(inverse, local, low), everything):
        if kept.shape[1] == len(inverse):
            kept = everything
            eigenvalues, motions = _eigenpairs(np.diag(inverse), local, shift, count, highest)
            break
        matrices = kept.T @ (inverse[:, None] * kept), kept.T @ local @ kept
        eigenvalues, motions = _eigenpairs(*matrices, shift, count, highest)
        found = np.flatnonzero(vibrates(eigenvalues, shift))
        if len(found) >= count:
            chosen = found[np.argsort(np.abs(eigenvalues[found]))[:count]]
            if _error(inverse, local, eigenvalues[chosen], kept @ motions[:, chosen], shift) < _EXACT:
                break
    # Real eigenvalues beyond the wanted modes are artefacts of the reduction.
    wanted = np.sort(np.abs(eigenvalues[vibrates(eigenvalues, shift)]))[:count]
    near = np.abs(eigenvalues) <= (1 + 1e-9) * wanted[-1] if len(wanted) else np.ones(len(eigenvalues), dtype=bool)
    eigenvalues, motions = eigenvalues[near], motions[:, near]

    def displacement(which: np.ndarray) -> np.ndarray:
        return shapes @ (kept @ motions[:, which])

    return damped_modes(eigenvalues, displacement, damping, mass, count, shift, rotational_share)


def _low(inverse: np.ndarray, count: int, shift: float) -> tuple[int, float]:
    """Number of undamped modes kept, all up to a multiple of the highest frequency wanted, and that in rad/s."""
    squares = 1.0 / np.maximum(inverse, 1e-300) - shift**2
    first = int(np.count_nonzero(is_zero(squares, shift)))
    highest = squares[min(first + count + 1, len(squares) - 1)]
    low = max(int(np.count_nonzero(squares <= _REACH**2 * highest)), min(first + count + 4, len(squares)))
    return low, float(np.sqrt(highest))


def _compressed(inverse: np.ndarray, damping: np.ndarray, low: int) -> np.ndarray:
    """Coordinates (n, p): the lowest undamped modes, and for the rest the responses to damping forces.

    The higher modes follow ``(I + lambda C + lambda^2 M) z = -lambda C_hl z_low``. A power series in lambda gives the
    static response and its corrections by mass and damping (quasi-static correction as by MacNeal 1971, carried one
    term further).
    """
    n = len(inverse)
    kept = np.zeros((n, low))
    kept[:low] = np.eye(low)
    if low == n:
        return kept
    across, among = damping[low:, :low], damping[low:, low:]
    size = max(float(np.abs(np.diag(damping)).max()), 1e-300)
    static = _span(across, size, np.zeros((n - low, 0)))
    more = _span(np.hstack([inverse[low:, None] * static / inverse[low], among @ static / size]), 1.0, static)
    responses = np.hstack([static, more])
    out = np.zeros((n, low + responses.shape[1]))
    out[:, :low] = kept
    out[low:, low:] = responses
    return out


def _span(vectors: np.ndarray, size: float, beside: np.ndarray) -> np.ndarray:
    """Orthonormal directions of vectors, others projected out and negligible ones dropped."""
    rest = vectors - beside @ (beside.T @ vectors)
    rest = rest - beside @ (beside.T @ rest)
    left, sizes, _ = la.svd(rest, full_matrices=False, check_finite=False)
    return left[:, sizes > _SAME * size]


def _eigenpairs(
    mass: np.ndarray, damping: np.ndarray, shift: float, count: int, highest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of ``lambda^2 M + lambda C + I - shift^2 M``, at least the lowest: lambda and displacements.

    ``highest`` is about the largest modulus wanted, rad/s.
    """
    n = len(mass)
    factor = la.cho_factor(np.eye(n) + shift * damping, check_finite=False)
    speed = 1.0 / np.sqrt(max(float(np.trace(mass)) / n, 1e-300))
    momentum = np.asfortranarray(
        -la.cho_solve(factor, np.hstack([damping + shift * mass, speed * mass]), check_finite=False)
    )

    def inverse(state: np.ndarray) -> np.ndarray:
        """(A - shift)^-1 of states (u, v/speed), one or a block, with A: u' = v, M v' = -K u - C v."""
        moved = momentum @ state
        return np.concatenate([moved, (state[:n] + shift * moved) / speed])

    overdamped = _overdamped(mass, damping, shift, highest)
    try:
        inverses, states = lowest_eigenpairs(inverse, 2 * n, count, shift, n <= _FEW * count, overdamped)
    except spla.ArpackError:
        inverses, states = lowest_eigenpairs(inverse, 2 * n, count, shift, dense=True)
    return shift + 1.0 / inverses, states[:n]


def _overdamped(mass: np.ndarray, damping: np.ndarray, shift: float, speed: float) -> int:
    """Number of real eigenvalues ``lambda > -speed``, except pairs with both members in that range.

    ``lambda^2 M + lambda C + K`` is positive definite at 0, and one of its eigenvalues changes sign at every real
    eigenvalue lambda. The negative ones at -speed are counted (Sylvester's law of inertia); a two-by-two pivot is
    indefinite and holds one.
    """
    matrix = np.eye(len(mass)) + (speed**2 - shift**2) * mass - speed * damping
    factor, pivots, _ = la.lapack.dsytrf(matrix, lower=1)
    single = pivots > 0
    return int(np.count_nonzero(np.diag(factor)[single] < 0) + np.count_nonzero(~single) // 2)


def _error(
    inverse: np.ndarray, damping: np.ndarray, eigenvalues: np.ndarray, motions: np.ndarray, shift: float
) -> float:
    """Largest relative eigenvalue error by the residual, whose dual norm is Euclidean in these coordinates."""
    heavy = inverse[:, None] * motions
    forces = damping @ motions
    residual = (eigenvalues**2 - shift**2) * heavy + eigenvalues * forces + motions
    scale = np.abs(np.einsum("ij,ij->j", motions, 2 * eigenvalues * heavy + forces))
    squares = np.einsum("ij,ij->j", residual.real, residual.real) + np.einsum("ij,ij->j", residual.imag, residual.imag)
    return float(np.max(squares / (scale * np.abs(eigenvalues))))
