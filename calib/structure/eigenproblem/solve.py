"""Full-order eigenproblem: classical modes without damping, state-space modes with damping."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.deflation import deflated_eigenvectors
from calib.structure.eigenproblem.eigenvalues import RotationalShare, damped_modes, is_zero, real_modes
from calib.structure.eigenproblem.inertia import count_below
from calib.structure.eigenproblem.krylov import lowest_eigenpairs, start_vector
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor
from calib.structure.modes import Modes
from calib.structure.null_space import answers_with_null_motion, common_null_space, motions_in_words

DENSE_LIMIT = 80
"""Up to this many degrees of freedom dense LAPACK is faster and more robust than Arnoldi iteration."""

_COPY = 1e-6
"""Relative distance of squared frequencies below which modes count as repeated."""

_ROUNDINGS = 4.0
"""Rounding errors of an entry that the factor behind a count may have, in units of the machine precision."""

_SHIFT = 1e-10
"""Square of the shift over the largest local eigenvalue: keeps the factor regular when rigid-body modes exist."""

_RIGID = 8
"""Most rigid-body motions and mechanisms that are counted before the modes are requested."""

_TURNING = 10.0
"""Limit of the largest local eigenvalue of rotations over that of translations, for the shift."""


def solve_modes(
    stiffness: sp.csc_array,
    damping: sp.csc_array | None,
    mass: sp.csc_array,
    count: int,
    rotational: np.ndarray | None = None,
) -> Modes:
    """Lowest vibration modes of ``K - M omega^2`` or of ``lambda^2 M + lambda C + K``.

    Zero, spin and overdamped eigenvalues are listed in `Modes.excluded` and do not count as modes. The damped problem
    is solved in state space (Foss 1958) by inverse Arnoldi iteration about a small real shift, so that only one real
    symmetric matrix is factorised.

    An iteration from one vector may miss copies of a repeated eigenvalue. Undamped modes are therefore counted by
    Sylvester's law of inertia, and damped modes are searched again by deflation: the first is a proof to within
    rounding, the second is not.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    damping : csc_array (n_dof, n_dof) or None
        None (or all zero) gives real modes.
    count : int
        Number of vibration modes wanted; fewer are returned when the model has no more.
    rotational : ndarray (n_dof,), bool, optional
        Which degrees of freedom are rotations; distinguishes spin from other zero eigenvalues.

    Returns
    -------
    Modes

    Raises
    ------
    EvaluationError
        When matrices are not finite, the factor is singular, a motion has neither stiffness nor mass, the iteration
        does not converge, or undamped modes are known to be missing.
    """
    for label, matrix in (("stiffness", stiffness), ("damping", damping), ("mass", mass)):
        if matrix is not None and not np.all(np.isfinite(matrix.data)):
            raise EvaluationError(f"the {label} matrix holds entries that are not finite")
    if not mass.diagonal().max(initial=0.0) > 0:
        raise EvaluationError("the model has no mass")
    rotational_share = rotational_share_of(mass, rotational)
    shift = _shift(stiffness, mass, rotational)
    try:
        if damping is None or not np.any(damping.data):
            return _real_modes(stiffness, mass, count, shift, rotational_share)
        return _complex_modes(stiffness, damping, mass, count, shift, rotational_share)
    except (la.LinAlgError, spla.ArpackError, RuntimeError) as fault:
        _refuse_null_motions(stiffness, mass)
        if isinstance(fault, EvaluationError):
            raise
        raise EvaluationError(f"the eigenproblem could not be solved ({fault})") from fault


def _refuse_null_motions(stiffness: sp.csc_array, mass: sp.csc_array) -> None:
    if null := len(common_null_space(stiffness, mass)[0]):
        words = f"common null space: {motions_in_words(null)} with neither stiffness nor mass"
        raise EvaluationError(words)


def _shift(stiffness: sp.csc_array, mass: sp.csc_array, rotational: np.ndarray | None = None) -> float:
    """Small positive shift in rad/s, far below the vibration modes and above the rounding error of zero eigenvalues.

    Rotations of thin shells have very little inertia: a shift scaled by their local eigenvalues would exceed the modes
    of a body on soft springs and count these as zero. They are therefore limited relative to translations.
    """
    k, m = stiffness.diagonal(), mass.diagonal()
    heavy = m > 1e-12 * m.max()
    local = np.abs(k[heavy]) / m[heavy]
    largest = float(local.max())
    if rotational is not None and not np.all(rotational[heavy]):
        largest = min(largest, _TURNING * float(local[~rotational[heavy]].max()))
    return float(np.sqrt(_SHIFT * max(largest, 1e-300)))


def rotational_share_of(mass: sp.csc_array, rotational: np.ndarray | None) -> RotationalShare:
    """Share of a shape's kinetic energy in the marked degrees of freedom, (n_dof,) bool."""
    rotational_share = np.zeros(mass.shape[0], dtype=bool) if rotational is None else rotational

    def share(shape: np.ndarray) -> float:
        part = np.where(rotational_share, shape, 0.0)
        total = abs(np.vdot(shape, mass @ shape))
        return float(abs(np.vdot(part, mass @ part)) / total) if total > 0 else 0.0

    return share


# -- undamped ----------------------------------------------------------------------------------------------------------


def _real_modes(
    stiffness: sp.csc_array, mass: sp.csc_array, count: int, shift: float, rotational_share: RotationalShare
) -> Modes:
    n = stiffness.shape[0]
    requested, again = count, False
    while True:
        if n <= DENSE_LIMIT or requested >= n - 1:
            squares, shapes = _dense_real(stiffness, mass, shift)
            complete = True
        else:
            lu = symmetric_factor(sp.csc_array(stiffness + shift**2 * mass))
            if answers_with_null_motion(lu.solve, stiffness, mass):
                _refuse_null_motions(stiffness, mass)
            if not again:
                requested = min(count + _rigid_count(lu, stiffness, mass, shift), n - 2)
            squares, shapes = spla.eigsh(
                sp.csr_matrix(stiffness),
                k=requested,
                M=sp.csr_matrix(mass),
                sigma=-(shift**2),
                OPinv=spla.LinearOperator((n, n), matvec=lu.solve, dtype=float),
                v0=start_vector(n),
            )
            squares = _refined(squares, shapes, stiffness, mass, shift)
            squares, shapes = _with_deflated_real(squares, shapes, lu, stiffness, mass, count, shift)
            complete = False
        lacking = count - int(np.count_nonzero(~is_zero(squares, shift)))
        if complete or lacking <= 0:
            return real_modes(squares, shapes, mass, count, shift, rotational_share)
        # Few are mostly lacking: twice as many modes take more than twice as long.
        requested, again = min(2 * requested if again else requested + 2 * lacking + 4, n), True


def _rigid_count(lu: SymmetricFactor, stiffness: sp.csc_array, mass: sp.csc_array, shift: float) -> int:
    """Number of rigid-body motions and mechanisms, up to `_RIGID`, by inverse iteration, of one vector first.

    They come first: a request without them would hold too few modes, and the whole iteration would be repeated. 0 where
    the motions found are not clear, which only costs time.
    """
    count = 0
    for columns in (1, _RIGID):
        motions = np.random.default_rng(20110713).standard_normal((mass.shape[0], columns))
        for _ in range(2):
            motions = np.linalg.qr(lu.solve(mass @ motions))[0]
        inertia = motions.T @ (mass @ motions)
        try:
            inverse = la.eigvalsh(inertia, motions.T @ (stiffness @ motions) + shift**2 * inertia)
        except la.LinAlgError:
            return 0
        count = int(np.count_nonzero(is_zero(1.0 / np.maximum(inverse, 1e-300) - shift**2, shift)))
        if not count:
            return 0
    return count


def _refined(
    squares: np.ndarray, shapes: np.ndarray, stiffness: sp.csc_array, mass: sp.csc_array, shift: float
) -> np.ndarray:
    """Squared frequencies by Rayleigh's quotient, zero ones as they are.

    Rigid-body motions magnify the rounding of the factor by ``1 / shift^2``: squares of the iteration were seen off by
    1e-6 in a free solid, more than the count of modes below them bears. The error of the quotient is that of the shape
    squared.
    """
    quotient = np.sum(shapes * (stiffness @ shapes), axis=0) / np.sum(shapes * (mass @ shapes), axis=0)
    return np.where(is_zero(squares, shift), squares, quotient)


def _with_deflated_real(
    squares: np.ndarray,
    shapes: np.ndarray,
    lu: SymmetricFactor,
    stiffness: sp.csc_array,
    mass: sp.csc_array,
    count: int,
    shift: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The modes found, with those below the last wanted one that the iteration missed."""

    def operate(block: np.ndarray) -> np.ndarray:
        return lu.solve(mass @ block)

    while True:
        zero = int(np.count_nonzero(is_zero(squares, shift)))
        if zero == len(squares):
            return squares, shapes  # rigid-body motions only: the request grows
        last = int(np.argsort(squares)[min(zero + count, len(squares)) - 1])
        edge = float(squares[last]) * (1 - _COPY) - _rounding(shapes[:, last], stiffness, mass)
        freq = math.sqrt(edge) / (2 * np.pi)
        missing: int | None = None
        with contextlib.suppress(EvaluationError):  # then only deflation can find missing modes
            missing = count_below(stiffness, mass, freq) - int(np.count_nonzero(squares < edge))
        if missing is not None and missing <= 0:
            return squares, shapes
        basis = la.qr(shapes, mode="economic")[0]
        more, _ = deflated_eigenvectors(operate, basis, 1.0 / (edge + shift**2))
        if not more.shape[1]:
            if missing:
                raise EvaluationError(f"{missing} modes below {freq:.6g} Hz were not found")
            return squares, shapes
        basis = np.hstack([basis, more])
        squares, weights = la.eigh(basis.T @ (stiffness @ basis), basis.T @ (mass @ basis))
        shapes = basis @ weights


def _rounding(shape: np.ndarray, stiffness: sp.csc_array, mass: sp.csc_array) -> float:
    """Error of a squared frequency (rad/s)^2 from rounded entries of K; large where a long part has a fine mesh.

    A relative change of every entry by eps moves it by at most ``eps |x|^T |K| |x| / x^T M x``; elimination rounds a
    few times.
    """
    size = np.abs(shape)
    return float(_ROUNDINGS * np.finfo(float).eps * (size @ (abs(stiffness) @ size)) / (shape @ (mass @ shape)))


def _dense_real(stiffness: sp.csc_array, mass: sp.csc_array, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """All modes of finite frequency; K and M are exchanged so that massless motions cause no infinite eigenvalues."""
    k, m = stiffness.toarray(), mass.toarray()
    shifted = k + shift**2 * m
    if answers_with_null_motion(lambda load: np.linalg.solve(shifted, load), stiffness, mass):
        _refuse_null_motions(stiffness, mass)
    inverse, shapes = la.eigh(m, shifted)
    shapes = shapes[:, inverse > 1e-14 * inverse.max()]
    # Rigid-body modes make K + shift^2 M nearly singular: eigenvalues lose digits, Rayleigh quotients do not.
    return np.einsum("ij,ij->j", shapes, k @ shapes) / np.einsum("ij,ij->j", shapes, m @ shapes), shapes


# -- damped ------------------------------------------------------------------------------------------------------------


def _complex_modes(
    stiffness: sp.csc_array,
    damping: sp.csc_array,
    mass: sp.csc_array,
    count: int,
    shift: float,
    rotational_share: RotationalShare,
) -> Modes:
    n = stiffness.shape[0]
    lu = symmetric_factor(sp.csc_array(stiffness + shift * damping + shift**2 * mass))
    if answers_with_null_motion(lu.solve, stiffness, mass):
        _refuse_null_motions(stiffness, mass)
    speed = _typical_speed(lu, mass)
    # Motions without mass and damping follow the others statically and are not part of the state.
    carried = np.zeros(n, dtype=bool)
    carried[mass.indices[mass.data != 0]] = True
    carried[damping.indices[damping.data != 0]] = True
    carried = np.flatnonzero(carried)
    h = len(carried)
    momentum = sp.csr_array(sp.hstack([damping[:, carried] + shift * mass[:, carried], speed * mass[:, carried]]))

    def inverse(state: np.ndarray) -> np.ndarray:
        """(A - shift)^-1 of states (u, v/speed), one or a block, with A: u' = v, M v' = -K u - C v."""
        out = np.empty_like(state)
        out[:h] = -lu.solve(momentum @ state)[carried]
        out[h:] = (state[:h] + shift * out[:h]) / speed
        return out

    inverses, states = lowest_eigenpairs(inverse, 2 * h, count, shift, dense=n <= DENSE_LIMIT)
    eigenvalues = shift + 1.0 / inverses

    def displacement(which: np.ndarray) -> np.ndarray:
        """Displacements of all motions in some of the eigenvectors, (n, len(which))."""
        forces = momentum @ (states[:, which] / inverses[which])
        parts = -lu.solve(np.hstack([forces.real, forces.imag]))
        return parts[:, : len(which)] + 1j * parts[:, len(which) :]

    return damped_modes(eigenvalues, displacement, damping, mass, count, shift, rotational_share)


def _typical_speed(lu: SymmetricFactor, mass: sp.csc_array) -> float:
    """A frequency in rad/s that balances displacements and velocities in the state vector."""
    x = start_vector(mass.shape[0])
    for _ in range(2):
        x = lu.solve(mass @ x)
        x /= np.linalg.norm(x)
    grown = lu.solve(mass @ x)
    return 1.0 / math.sqrt(max(abs(float(x @ grown)), 1e-300))
