"""Krylov solver: the lowest eigenpairs of a damped system by inverse Arnoldi iteration, or all of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.structure.eigenproblem.deflation import deflated_eigenvectors, real_span
from calib.structure.eigenproblem.eigenvalues import vibrates


def start_vector(n: int) -> np.ndarray:
    """Fixed start vector: the same point gives the same digits in every process."""
    return np.random.default_rng(20110713).standard_normal(n)


def lowest_eigenpairs(
    inverse: Callable[[np.ndarray], np.ndarray], size: int, count: int, shift: float, dense: bool, overdamped: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of ``(A - shift)^-1`` of largest modulus until they hold ``count`` vibrating eigenvalues.

    An iteration from one vector may miss copies of a repeated eigenvalue, so a second search runs with all found
    eigenvectors projected out (deflation).

    Parameters
    ----------
    inverse : callable
        The operator on states, one (size,) or a block (size, b).
    size : int
        Length of a state.
    count : int
        Vibrating pairs wanted.
    shift : float
        Real, in rad/s.
    dense : bool
        Solve for all eigenvalues at once.
    overdamped : int
        Number of real eigenvalues expected among the lowest, if known; a wrong number only costs time.

    Returns
    -------
    inverses : ndarray (n_found,)
        ``1/(lambda - shift)``, complex.
    states : ndarray (size, n_found)

    Raises
    ------
    scipy.sparse.linalg.ArpackError
        When the iteration does not converge.
    """
    requested, again = 2 * count + 2 + overdamped, False
    while True:
        complete = dense or requested >= size - 2
        if complete:
            inverses, states = la.eig(inverse(np.eye(size)), check_finite=False)
        else:
            operator = spla.LinearOperator((size, size), matvec=inverse, dtype=float)
            inverses, states = spla.eigs(
                operator, k=requested, which="LM", v0=start_vector(size), ncv=min(size, 2 * requested + 4), tol=1e-11
            )
            inverses, states = _with_deflated(inverses, states, inverse, count, shift)
        finite = np.abs(inverses) > 1e-14 * np.abs(inverses).max()
        inverses, states = inverses[finite], states[:, finite]
        lacking = count - int(np.count_nonzero(vibrates(shift + 1.0 / inverses, shift)))
        if complete or lacking <= 0:
            return inverses, states
        # When overdamped eigenvalues fill the request, ask for a few extra eigenpairs instead of doubling it: twice as
        # many may reach into a cluster of local modes, where the iteration is slow.
        requested, again = min(2 * requested if again else requested + 2 * lacking + 4, size), True


def _with_deflated(
    inverses: np.ndarray,
    states: np.ndarray,
    inverse: Callable[[np.ndarray], np.ndarray],
    count: int,
    shift: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The eigenpairs of the inverse with those below the last wanted mode that the iteration missed."""
    while True:
        eigenvalues = shift + 1.0 / inverses
        wanted = np.flatnonzero(vibrates(eigenvalues, shift))
        if len(wanted) < count:
            return inverses, states  # the request grows
        last = wanted[np.argsort(np.abs(eigenvalues[wanted]))[count - 1]]
        found = real_span(inverses, states)
        more, _ = deflated_eigenvectors(inverse, found, float(np.abs(inverses[last])))
        if not more.shape[1]:
            return inverses, states
        basis = np.hstack([found, more])
        inverses, weights = la.eig(basis.T @ inverse(basis))
        states = basis @ weights
