"""The lowest roots of a damped system by inverse Arnoldi iteration, or all of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as la
import scipy.sparse.linalg as spla

from calib.structure.missed import missed_vectors, real_span
from calib.structure.roots import vibrates


def start_vector(n: int) -> np.ndarray:
    """Fixed start of the iteration: the same point gives the same digits in every process."""
    return np.random.default_rng(20110713).standard_normal(n)


def lowest_roots(
    inverse: Callable[[np.ndarray], np.ndarray], size: int, count: int, shift: float, dense: bool, overdamped: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of ``(A - shift)^-1`` of largest modulus until they hold ``count`` vibrating roots.

    An iteration from one vector may leave out copies of a repeated root, so they are sought once more with all that
    were found projected out.

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
        Solve for all roots at once.
    overdamped : int
        Real roots expected among the lowest, if that is known; a wrong number costs time only.

    Returns
    -------
    inverses : ndarray (n_roots,)
        ``1/(lambda - shift)``, complex.
    states : ndarray (size, n_roots)

    Raises
    ------
    scipy.sparse.linalg.ArpackError
        When the iteration does not converge.
    """
    asked, again = 2 * count + 2 + overdamped, False
    while True:
        whole = dense or asked >= size - 2
        if whole:
            inverses, states = la.eig(inverse(np.eye(size)), check_finite=False)
        else:
            operator = spla.LinearOperator((size, size), matvec=inverse, dtype=float)
            inverses, states = spla.eigs(
                operator, k=asked, which="LM", v0=start_vector(size), ncv=min(size, 2 * asked + 4), tol=1e-11
            )
            inverses, states = _with_missed(inverses, states, inverse, count, shift)
        finite = np.abs(inverses) > 1e-14 * np.abs(inverses).max()
        inverses, states = inverses[finite], states[:, finite]
        lacking = count - int(np.count_nonzero(vibrates(shift + 1.0 / inverses, shift)))
        if whole or lacking <= 0:
            return inverses, states
        # Overdamped roots took some places. A few more cost less than twice as many, which may reach into a crowd of
        # local modes where the iteration is slow.
        asked, again = min(2 * asked if again else asked + 2 * lacking + 4, size), True


def _with_missed(
    inverses: np.ndarray,
    states: np.ndarray,
    inverse: Callable[[np.ndarray], np.ndarray],
    count: int,
    shift: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenpairs of the inverse found and those that the iteration left out below the last mode wanted."""
    while True:
        roots = shift + 1.0 / inverses
        wanted = np.flatnonzero(vibrates(roots, shift))
        if len(wanted) < count:
            return inverses, states  # more will be asked
        last = wanted[np.argsort(np.abs(roots[wanted]))[count - 1]]
        found = real_span(inverses, states)
        more, _ = missed_vectors(inverse, found, float(np.abs(inverses[last])))
        if not more.shape[1]:
            return inverses, states
        basis = np.hstack([found, more])
        inverses, weights = la.eig(basis.T @ inverse(basis))
        states = basis @ weights
