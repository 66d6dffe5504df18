"""Modes of small dense problems, such as those of a reduced model."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.errors import EvaluationError
from calib.structure.lowest import lowest_roots
from calib.structure.modes import Modes
from calib.structure.roots import TurningShare, damped_modes, is_zero, real_modes, vibrates

_SHIFT = 1e-10
_REACH = 2.5
"""Undamped modes up to this multiple of the highest frequency wanted are kept, the rest follows statically."""
_EXACT = 1e-9
"""Largest relative eigenvalue error left by that, by its residual; else all of the matrices are used."""
_SAME = 1e-10
_FEW = 8
"""Up to this many coordinates for each mode wanted all roots are as quickly found as a few."""


def solve_dense(
    stiffness: np.ndarray, damping: np.ndarray | None, mass: np.ndarray, count: int, turning: TurningShare
) -> Modes:
    """Lowest vibration modes of dense symmetric matrices, in the conventions of `solve_modes`.

    Parameters
    ----------
    stiffness, mass : ndarray (n, n)
        Symmetric, positive semidefinite; SI.
    damping : ndarray (n, n) or None
    count : int
    turning : callable
        Share of a shape's kinetic energy in rotations; tells spin from other zero roots.

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
            return _undamped(stiffness, mass, count, shift, turning)
        return _damped(stiffness, damping, mass, count, shift, turning)
    except la.LinAlgError as fault:
        raise EvaluationError(f"the eigenproblem could not be solved ({fault})") from fault


def _undamped(stiffness: np.ndarray, mass: np.ndarray, count: int, shift: float, turning: TurningShare) -> Modes:
    n, asked = len(stiffness), count
    shifted = stiffness + shift**2 * mass
    while True:
        asked = min(asked, n)
        # The roles of K and M are exchanged so that massless motions do no harm.
        inverse, shapes = la.eigh(mass, shifted, subset_by_index=(n - asked, n - 1), check_finite=False)
        shapes = shapes[:, inverse > 1e-14 * inverse.max()]
        # Rigid-body modes make K nearly singular; that costs the eigenvalues digits but not Rayleigh quotients.
        squares = np.einsum("ij,ij->j", shapes, stiffness @ shapes) / np.einsum("ij,ij->j", shapes, mass @ shapes)
        if asked == n or np.count_nonzero(~is_zero(squares, shift)) >= count:
            return real_modes(squares, shapes, mass, count, shift, turning)
        asked *= 2


def _damped(
    stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray, count: int, shift: float, turning: TurningShare
) -> Modes:
    """Damped modes in coordinates of undamped ones, those far above the wanted ones reduced to what damping asks."""
    inverse, shapes = la.eigh(mass, stiffness + shift**2 * mass, check_finite=False)
    inverse, shapes = np.maximum(inverse[::-1], 0.0), shapes[:, ::-1]
    local = shapes.T @ damping @ shapes
    low, highest = _low(inverse, count, shift)
    everything = np.eye(len(inverse))
    for kept in (_compressed(inverse, local, low), everything):
        if kept.shape[1] == len(inverse):
            kept = everything
            roots, motions = _roots(np.diag(inverse), local, shift, count, highest)
            break
        roots, motions = _roots(kept.T @ (inverse[:, None] * kept), kept.T @ local @ kept, shift, count, highest)
        found = np.flatnonzero(vibrates(roots, shift))
        if len(found) >= count:
            chosen = found[np.argsort(np.abs(roots[found]))[:count]]
            if _error(inverse, local, roots[chosen], kept @ motions[:, chosen], shift) < _EXACT:
                break
    # Real roots beyond the wanted modes belong to what was reduced and mean nothing.
    wanted = np.sort(np.abs(roots[vibrates(roots, shift)]))[:count]
    near = np.abs(roots) <= (1 + 1e-9) * wanted[-1] if len(wanted) else np.ones(len(roots), dtype=bool)
    roots, motions = roots[near], motions[:, near]

    def displacement(which: np.ndarray) -> np.ndarray:
        return shapes @ (kept @ motions[:, which])

    return damped_modes(roots, displacement, damping, mass, count, shift, turning)


def _low(inverse: np.ndarray, count: int, shift: float) -> tuple[int, float]:
    """Number of undamped modes kept, all up to a multiple of the highest frequency wanted, and that in rad/s."""
    squares = 1.0 / np.maximum(inverse, 1e-300) - shift**2
    first = int(np.count_nonzero(is_zero(squares, shift)))
    highest = squares[min(first + count + 1, len(squares) - 1)]
    low = max(int(np.count_nonzero(squares <= _REACH**2 * highest)), min(first + count + 4, len(squares)))
    return low, float(np.sqrt(highest))


def _compressed(inverse: np.ndarray, damping: np.ndarray, low: int) -> np.ndarray:
    """Coordinates (n, p): the lowest undamped modes, and for the rest the answers to damping forces.

    The higher modes follow ``(I + lambda C + lambda^2 M) z = -lambda C_hl z_low``. A power series in lambda gives the
    static answer, and its corrections through mass and damping (quasi-static correction as by MacNeal 1971, carried one
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
    answers = np.hstack([static, more])
    out = np.zeros((n, low + answers.shape[1]))
    out[:, :low] = kept
    out[low:, low:] = answers
    return out


def _span(vectors: np.ndarray, size: float, beside: np.ndarray) -> np.ndarray:
    """Orthonormal directions of vectors apart from others, those of negligible size left out."""
    rest = vectors - beside @ (beside.T @ vectors)
    rest = rest - beside @ (beside.T @ rest)
    left, sizes, _ = la.svd(rest, full_matrices=False, check_finite=False)
    return left[:, sizes > _SAME * size]


def _roots(
    mass: np.ndarray, damping: np.ndarray, shift: float, count: int, highest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Roots of ``lambda^2 M + lambda C + I - shift^2 M``, the lowest at least, and displacements of their vectors.

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
        inverses, states = lowest_roots(inverse, 2 * n, count, shift, n <= _FEW * count, overdamped)
    except spla.ArpackError:
        inverses, states = lowest_roots(inverse, 2 * n, count, shift, dense=True)
    return shift + 1.0 / inverses, states[:n]


def _overdamped(mass: np.ndarray, damping: np.ndarray, shift: float, speed: float) -> int:
    """Real roots ``lambda > -speed``, but for pairs of them, both members of which are as low.

    ``lambda^2 M + lambda C + K`` is positive definite at 0, and one of its eigenvalues changes sign at every real root.
    Counted are the negative ones at -speed (Sylvester's law of inertia): no two-by-two pivot is definite.
    """
    matrix = np.eye(len(mass)) + (speed**2 - shift**2) * mass - speed * damping
    factor, pivots, _ = la.lapack.dsytrf(matrix, lower=1)
    single = pivots > 0
    return int(np.count_nonzero(np.diag(factor)[single] < 0) + np.count_nonzero(~single) // 2)


def _error(inverse: np.ndarray, damping: np.ndarray, roots: np.ndarray, motions: np.ndarray, shift: float) -> float:
    """Largest relative eigenvalue error by the residual, whose dual norm is Euclidean in these coordinates."""
    heavy = inverse[:, None] * motions
    forces = damping @ motions
    residual = (roots**2 - shift**2) * heavy + roots * forces + motions
    scale = np.abs(np.einsum("ij,ij->j", motions, 2 * roots * heavy + forces))
    squares = np.einsum("ij,ij->j", residual.real, residual.real) + np.einsum("ij,ij->j", residual.imag, residual.imag)
    return float(np.max(squares / (scale * np.abs(roots))))
