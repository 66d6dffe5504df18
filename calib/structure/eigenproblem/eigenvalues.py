"""Classification of eigenvalues, and order and scaling of the vibration modes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from calib.structure.eigenproblem.damped_problem import real_times
from calib.structure.modes import EigenvalueKind, ExcludedEigenvalue, Modes

_REAL = 1e-7
"""Imaginary part over modulus of a real eigenvalue: rounding splits a critical pair by about sqrt(eps)."""

_ZERO = 0.1
"""Modulus of a zero eigenvalue, over the shift that keeps the factor regular."""

RotationalShare = Callable[[np.ndarray], float]
"""Share of a shape's kinetic energy that lies in rotations."""


def vibrates(eigenvalues: np.ndarray, shift: float) -> np.ndarray:
    """Which eigenvalues in rad/s are damped vibration modes: those above the real axis, clear of it and of zero."""
    return (eigenvalues.imag > _REAL * np.abs(eigenvalues)) & (np.abs(eigenvalues) >= _ZERO * shift)


def is_zero(squares: np.ndarray, shift: float) -> np.ndarray:
    """Which squared angular frequencies are those of rigid-body motions or mechanisms."""
    return squares < (_ZERO * shift) ** 2


def real_modes(
    squares: np.ndarray,
    shapes: np.ndarray,
    mass: sp.csc_array | np.ndarray,
    count: int,
    shift: float,
    rotational_share: RotationalShare,
) -> Modes:
    """The ``count`` lowest undamped modes of those solved, mass-normalised; zero eigenvalues are excluded.

    Parameters
    ----------
    squares : ndarray (n_found,)
        Squared angular frequencies.
    shapes : ndarray (n_dof, n_found)
    mass : array (n_dof, n_dof)
    """
    order = np.argsort(squares)
    squares, shapes = squares[order], shapes[:, order]
    zero = is_zero(squares, shift)
    shapes = shapes / np.sqrt(np.einsum("ij,ij->j", shapes, mass @ shapes))
    keep = np.flatnonzero(~zero)[:count]
    excluded = tuple(_zero_eigenvalue(0.0, shapes[:, j], rotational_share) for j in np.flatnonzero(zero))
    freq = np.sqrt(squares[keep]) / (2 * np.pi)
    return Modes(freq, freq.copy(), np.zeros(len(freq)), shapes[:, keep], excluded)


def damped_modes(
    eigenvalues: np.ndarray,
    displacement: Callable[[np.ndarray], np.ndarray],
    damping: sp.csc_array | np.ndarray,
    mass: sp.csc_array | np.ndarray,
    count: int,
    shift: float,
    rotational_share: RotationalShare,
) -> Modes:
    """The ``count`` lowest damped modes of those solved, scaled to ``psi^T (2 lambda M + C) psi = 1``.

    Zero and overdamped eigenvalues are excluded; each member of a pair is listed.

    Parameters
    ----------
    eigenvalues : ndarray (n_found,)
        All eigenvalues found, rad/s.
    displacement : callable
        Shapes (n_dof, k) of the eigenvalues at k indices.
    damping, mass : array (n_dof, n_dof)
    """
    zero = np.flatnonzero(np.abs(eigenvalues) < _ZERO * shift)
    real = np.setdiff1d(np.flatnonzero(np.abs(eigenvalues.imag) <= _REAL * np.abs(eigenvalues)), zero)
    excluded = [
        _zero_eigenvalue(complex(eigenvalue), shape, rotational_share)
        for eigenvalue, shape in zip(eigenvalues[zero], displacement(zero).T if len(zero) else (), strict=True)
    ]
    excluded += [ExcludedEigenvalue("overdamped", complex(eigenvalue)) for eigenvalue in eigenvalues[real].real]
    found = np.flatnonzero(vibrates(eigenvalues, shift))
    order = found[np.argsort(np.abs(eigenvalues[found]), kind="stable")[:count]]
    eigenvalues, shapes = eigenvalues[order], displacement(order)
    inertia, dissipation = (np.einsum("ij,ij->j", shapes, real_times(matrix, shapes)) for matrix in (mass, damping))
    scale = 2 * eigenvalues * inertia + dissipation
    size = np.abs(eigenvalues)
    return Modes(
        size / (2 * np.pi),
        eigenvalues.imag / (2 * np.pi),
        -eigenvalues.real / size,
        shapes / np.sqrt(scale),
        tuple(sorted(excluded, key=_size)),
    )


def _size(excluded: ExcludedEigenvalue) -> float:
    return abs(excluded.eigenvalue)


def _zero_eigenvalue(eigenvalue: complex, shape: np.ndarray, rotational_share: RotationalShare) -> ExcludedEigenvalue:
    """Spin when the kinetic energy lies in rotations alone, else a rigid-body motion or mechanism."""
    kind: EigenvalueKind = "spin" if rotational_share(shape) > 0.99 else "zero"
    return ExcludedEigenvalue(kind, eigenvalue)
