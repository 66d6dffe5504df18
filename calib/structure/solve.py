"""Full-order modes: classical ones without damping, state-space ones with it."""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from calib.errors import EvaluationError
from calib.structure.modes import ExcludedRoot, Modes, RootKind

DENSE_LIMIT = 80
"""Up to this many degrees of freedom dense LAPACK is faster and safer than Arnoldi iteration."""

_REAL = 1e-7
"""Imaginary part over modulus below which a root is real: a critical pair splits by the root of machine precision."""

_SHIFT = 1e-10
"""Square of the shift over the largest local eigenvalue: keeps the factor regular when rigid-body modes exist."""


def solve_modes(
    stiffness: sp.csc_array,
    damping: sp.csc_array | None,
    mass: sp.csc_array,
    count: int,
    rotational: np.ndarray | None = None,
) -> Modes:
    """Lowest vibration modes of ``K - M omega^2`` or of ``lambda^2 M + lambda C + K``.

    Zero, spin and overdamped roots are listed in `Modes.excluded` and do not count. The damped problem is solved in
    state space (Foss 1958) by inverse Arnoldi iteration about a small real shift, so that only one real symmetric
    matrix is factorised.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    damping : csc_array (n_dof, n_dof) or None
        None (or all zero) gives real modes.
    count : int
        Number of vibration modes wanted; fewer come back when the model has no more.
    rotational : ndarray (n_dof,), bool, optional
        Which degrees of freedom are rotations; tells spin from other zero roots.

    Returns
    -------
    Modes

    Raises
    ------
    EvaluationError
        When matrices are not finite, the factor is singular or the iteration does not converge.
    """
    n = stiffness.shape[0]
    for label, matrix in (("stiffness", stiffness), ("damping", damping), ("mass", mass)):
        if matrix is not None and not np.all(np.isfinite(matrix.data)):
            raise EvaluationError(f"the {label} matrix holds entries that are not finite")
    if not mass.diagonal().max(initial=0.0) > 0:
        raise EvaluationError("the model has no mass")
    turning = np.zeros(n, dtype=bool) if rotational is None else rotational
    shift = _shift(stiffness, mass)
    try:
        if damping is None or not np.any(damping.data):
            return _real_modes(stiffness, mass, count, shift, turning)
        return _complex_modes(stiffness, damping, mass, count, shift, turning)
    except (la.LinAlgError, spla.ArpackError, RuntimeError) as fault:
        if isinstance(fault, EvaluationError):
            raise
        raise EvaluationError(f"the eigenproblem could not be solved ({fault})") from fault


def _shift(stiffness: sp.csc_array, mass: sp.csc_array) -> float:
    """Small positive shift in rad/s, far below the vibration modes and above the rounding of zero roots."""
    k, m = stiffness.diagonal(), mass.diagonal()
    heavy = m > 1e-12 * m.max()
    return float(np.sqrt(_SHIFT * max(np.max(np.abs(k[heavy]) / m[heavy]), 1e-300)))


def _factor(matrix: sp.csc_array) -> spla.SuperLU:
    """LU of a symmetric positive definite matrix; the ordering is 5-7 times faster here than SuperLU's default."""
    return spla.splu(
        sp.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _start_vector(n: int) -> np.ndarray:
    """Fixed start of the iteration: the same point gives the same digits in every process."""
    return np.random.default_rng(20110713).standard_normal(n)


# -- undamped ----------------------------------------------------------------------------------------------------------


def _real_modes(stiffness: sp.csc_array, mass: sp.csc_array, count: int, shift: float, rotational: np.ndarray) -> Modes:
    n = stiffness.shape[0]
    asked = count
    while True:
        if n <= DENSE_LIMIT or asked >= n - 1:
            squares, shapes = _dense_real(stiffness, mass, shift)
            complete = True
        else:
            lu = _factor(sp.csc_array(stiffness + shift**2 * mass))
            squares, shapes = spla.eigsh(
                sp.csr_matrix(stiffness),
                k=asked,
                M=sp.csr_matrix(mass),
                sigma=-(shift**2),
                OPinv=spla.LinearOperator((n, n), matvec=lu.solve, dtype=float),
                v0=_start_vector(n),
            )
            complete = False
        order = np.argsort(squares)
        squares, shapes = squares[order], shapes[:, order]
        zero = squares < (0.1 * shift) ** 2
        if complete or np.count_nonzero(~zero) >= count:
            break
        asked = min(2 * asked, n)
    shapes = shapes / np.sqrt(np.einsum("ij,ij->j", shapes, mass @ shapes))
    keep = np.flatnonzero(~zero)[:count]
    omega = np.sqrt(squares[keep])
    excluded = tuple(_zero_root(0.0, shapes[:, j], mass, rotational) for j in np.flatnonzero(zero))
    freq = omega / (2 * np.pi)
    return Modes(freq, freq.copy(), np.zeros(len(freq)), shapes[:, keep], excluded)


def _dense_real(stiffness: sp.csc_array, mass: sp.csc_array, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """All modes of finite frequency; the roles of K and M are exchanged so that massless motions do no harm."""
    k, m = stiffness.toarray(), mass.toarray()
    inverse, shapes = la.eigh(m, k + shift**2 * m)
    shapes = shapes[:, inverse > 1e-14 * inverse.max()]
    # Rigid-body modes make K + shift^2 M nearly singular; that costs the eigenvalues digits but not Rayleigh quotients.
    return np.einsum("ij,ij->j", shapes, k @ shapes) / np.einsum("ij,ij->j", shapes, m @ shapes), shapes


# -- damped ------------------------------------------------------------------------------------------------------------


def _complex_modes(
    stiffness: sp.csc_array,
    damping: sp.csc_array,
    mass: sp.csc_array,
    count: int,
    shift: float,
    rotational: np.ndarray,
) -> Modes:
    n = stiffness.shape[0]
    lu = _factor(sp.csc_array(stiffness + shift * damping + shift**2 * mass))
    speed = _typical_speed(lu, mass)
    c_shifted = sp.csr_array(damping + shift * mass)
    m_rows = sp.csr_array(mass)

    def inverse(state: np.ndarray) -> np.ndarray:
        """(A - shift)^-1 of the state (u, v/speed) with A: u' = v, M v' = -K u - C v."""
        u, v = state[:n], speed * state[n:]
        new = -lu.solve(c_shifted @ u + m_rows @ v)
        return np.concatenate([new, (u + shift * new) / speed])

    asked = 2 * count + 4
    while True:
        if n <= DENSE_LIMIT or asked >= 2 * n - 2:
            matrix = np.column_stack([inverse(column) for column in np.eye(2 * n)])
            inverses, states = la.eig(matrix)
            complete = True
        else:
            operator = spla.LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=float)
            inverses, states = spla.eigs(
                operator, k=asked, which="LM", v0=_start_vector(2 * n), ncv=min(2 * n, 3 * asked // 2), tol=1e-11
            )
            complete = False
        finite = np.abs(inverses) > 1e-14 * np.abs(inverses).max()
        roots = shift + 1.0 / inverses[finite]
        shapes = states[:n, finite]
        near_zero = np.abs(roots) < 0.1 * shift
        oscillating = (roots.imag > _REAL * np.abs(roots)) & ~near_zero
        if complete or np.count_nonzero(oscillating) >= count:
            break
        asked = min(2 * asked, 2 * n)
    excluded = _excluded(roots, shapes, near_zero, mass, rotational)
    roots, shapes = roots[oscillating], shapes[:, oscillating]
    order = np.argsort(np.abs(roots), kind="stable")[:count]
    roots, shapes = roots[order], shapes[:, order]
    scale = 2 * roots * np.einsum("ij,ij->j", shapes, mass @ shapes) + np.einsum("ij,ij->j", shapes, damping @ shapes)
    shapes = shapes / np.sqrt(scale)
    size = np.abs(roots)
    return Modes(size / (2 * np.pi), roots.imag / (2 * np.pi), -roots.real / size, shapes, excluded)


def _typical_speed(lu: spla.SuperLU, mass: sp.csc_array) -> float:
    """A frequency in rad/s that balances displacements and velocities in the state vector."""
    x = _start_vector(mass.shape[0])
    for _ in range(3):
        x = lu.solve(mass @ x)
        x /= np.linalg.norm(x)
    grown = lu.solve(mass @ x)
    return 1.0 / math.sqrt(max(abs(float(x @ grown)), 1e-300))


def _excluded(
    roots: np.ndarray, shapes: np.ndarray, near_zero: np.ndarray, mass: sp.csc_array, rotational: np.ndarray
) -> tuple[ExcludedRoot, ...]:
    """Zero and overdamped roots among those found; the two members of a zero pair are listed once each."""
    real = (np.abs(roots.imag) <= _REAL * np.abs(roots)) & ~near_zero
    found = [_zero_root(complex(roots[j]), shapes[:, j], mass, rotational) for j in np.flatnonzero(near_zero)]
    found += [
        ExcludedRoot("overdamped", complex(roots[j].real), f"decays without oscillation at {-roots[j].real:.4g} 1/s")
        for j in np.flatnonzero(real)
    ]
    return tuple(sorted(found, key=_size))


def _size(root: ExcludedRoot) -> float:
    return abs(root.eigenvalue)


def _zero_root(root: complex, shape: np.ndarray, mass: sp.csc_array, rotational: np.ndarray) -> ExcludedRoot:
    """A zero root: spin when its kinetic energy lies in rotations alone, else a rigid-body motion or mechanism."""
    turning = np.where(rotational, shape, 0.0)
    total = abs(np.vdot(shape, mass @ shape))
    share = abs(np.vdot(turning, mass @ turning)) / total if total > 0 else 0.0
    kind: RootKind = "spin" if share > 0.99 else "zero"
    words = "rotation of a part about its own axis" if kind == "spin" else "rigid-body motion or mechanism"
    return ExcludedRoot(kind, root, words)
