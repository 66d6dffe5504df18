"""What a root of the eigenproblem is, and how those that are vibration modes are ordered and scaled."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from calib.structure.modes import ExcludedRoot, Modes, RootKind

_REAL = 1e-7
"""Imaginary part over modulus below which a root is real: a critical pair splits by the root of machine precision."""

_ZERO = 0.1
"""A root is zero below this part of the shift that keeps the factor regular."""

TurningShare = Callable[[np.ndarray], float]
"""Share of a shape's kinetic energy that lies in rotations."""


def vibrates(roots: np.ndarray, shift: float) -> np.ndarray:
    """Which roots in rad/s stand for a damped vibration mode: those above the real axis, clear of it and of zero."""
    return (roots.imag > _REAL * np.abs(roots)) & (np.abs(roots) >= _ZERO * shift)


def is_zero(squares: np.ndarray, shift: float) -> np.ndarray:
    """Which squared angular frequencies of undamped motions are those of rigid bodies or mechanisms."""
    return squares < (_ZERO * shift) ** 2


def real_modes(
    squares: np.ndarray,
    shapes: np.ndarray,
    mass: sp.csc_array | np.ndarray,
    count: int,
    shift: float,
    turning: TurningShare,
) -> Modes:
    """The ``count`` lowest undamped modes of those solved, mass-normalised; zero roots are listed apart.

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
    excluded = tuple(_zero_root(0.0, shapes[:, j], turning) for j in np.flatnonzero(zero))
    freq = np.sqrt(squares[keep]) / (2 * np.pi)
    return Modes(freq, freq.copy(), np.zeros(len(freq)), shapes[:, keep], excluded)


def damped_modes(
    roots: np.ndarray,
    displacement: Callable[[np.ndarray], np.ndarray],
    damping: sp.csc_array | np.ndarray,
    mass: sp.csc_array | np.ndarray,
    count: int,
    shift: float,
    turning: TurningShare,
) -> Modes:
    """The ``count`` lowest damped modes of those solved, scaled to ``psi^T (2 lambda M + C) psi = 1``.

    Zero and overdamped roots are listed apart, each member of a pair for itself.

    Parameters
    ----------
    roots : ndarray (n_found,)
        All roots found, rad/s.
    displacement : callable
        Shapes (n_dof, k) of the roots at k indices.
    damping, mass : array (n_dof, n_dof)
    """
    zero = np.flatnonzero(np.abs(roots) < _ZERO * shift)
    real = np.setdiff1d(np.flatnonzero(np.abs(roots.imag) <= _REAL * np.abs(roots)), zero)
    excluded = [
        _zero_root(complex(root), shape, turning)
        for root, shape in zip(roots[zero], displacement(zero).T if len(zero) else (), strict=True)
    ]
    excluded += [ExcludedRoot("overdamped", complex(root)) for root in roots[real].real]
    found = np.flatnonzero(vibrates(roots, shift))
    order = found[np.argsort(np.abs(roots[found]), kind="stable")[:count]]
    roots, shapes = roots[order], displacement(order)
    scale = 2 * roots * np.einsum("ij,ij->j", shapes, mass @ shapes) + np.einsum("ij,ij->j", shapes, damping @ shapes)
    size = np.abs(roots)
    return Modes(
        size / (2 * np.pi),
        roots.imag / (2 * np.pi),
        -roots.real / size,
        shapes / np.sqrt(scale),
        tuple(sorted(excluded, key=_size)),
    )


def _size(root: ExcludedRoot) -> float:
    return abs(root.eigenvalue)


def _zero_root(root: complex, shape: np.ndarray, turning: TurningShare) -> ExcludedRoot:
    """A zero root: spin when its kinetic energy lies in rotations alone, else a rigid-body motion or mechanism."""
    kind: RootKind = "spin" if turning(shape) > 0.99 else "zero"
    return ExcludedRoot(kind, root)
