"""Deflation: eigenvectors of repeated eigenvalues that a single-vector Krylov iteration misses."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import scipy.linalg as la

_BLOCK = 4
_STEPS_MIN, _STEPS_MAX = 3, 60
_CLEAR = 0.1
"""Largest relative residual of a Ritz value that is accepted as too small to matter."""
_CONVERGED = 1e-10
_SAME = 1e-8
"""Relative distance of eigenvalues below which they count as repeated."""


def deflated_eigenvectors(
    operate: Callable[[np.ndarray], np.ndarray], found: np.ndarray, smallest: float
) -> tuple[np.ndarray, bool]:
    """Eigenvectors whose eigenvalues exceed a modulus, orthogonal to a known invariant subspace.

    In exact arithmetic a Krylov space holds one eigenvector of every eigenvalue present in its start vector, so an
    iteration from one vector finds further copies of a repeated eigenvalue only through rounding. Here the known
    subspace is projected out and a block Arnoldi iteration starts from random vectors (Saad 2011, sections 4.2 and
    6.4); a missed copy is then the largest eigenvalue left. Up to four copies are found at a time: repeat with the
    enlarged subspace until none is found.

    This is an iteration, not a proof: an eigenvector is missed when the random vectors have no component along it.

    Parameters
    ----------
    operate : callable
        The operator on a block of real vectors, (n, b) to (n, b); its largest eigenvalues are wanted.
    found : ndarray (n, k)
        Orthonormal basis of the invariant subspace known so far.
    smallest : float
        Modulus that a wanted eigenvalue exceeds.

    Returns
    -------
    vectors : ndarray (n, m)
        Orthonormal, orthogonal to ``found``; together they span an invariant subspace. Empty when nothing was missed.
    certain : bool
        False when the iteration ended before it could decide.
    """
    n, free = found.shape[0], found.shape[0] - found.shape[1]
    nothing = np.zeros((n, 0))
    if free <= 0:
        return nothing, True
    block = min(_BLOCK, free)
    known, capacity = found.shape[1], min(block * _STEPS_MAX, free)
    # Known subspace first, then the Krylov space: one product makes a block orthogonal to both.
    space = np.empty((n, known + capacity), order="F")
    space[:, :known] = found
    matrix = np.zeros((capacity, capacity))

    # New vectors each time: the previous ones have no component along the remaining copies.
    fresh = np.random.default_rng((20260713, known)).standard_normal((n, block))
    # Two inverse iterations suppress components far above the wanted frequencies.
    fresh = operate(operate(fresh))
    last = la.qr(_projected_out(fresh / np.linalg.norm(fresh, axis=0), found)[0], mode="economic")[0]
    size = 0
    for step in itertools.count(1):
        now, size = slice(size, size + last.shape[1]), size + last.shape[1]
        everything = space[:, : known + size]
        everything[:, known + now.start :] = last
        rest, parts = _projected_out(operate(last), everything)
        matrix[:size, now] = parts[known:]
        last, onward = la.qr(rest, mode="economic", check_finite=False)
        if size == capacity or step == _STEPS_MIN or (step > _STEPS_MIN and (step < 8 or step % 4 == 0)):
            ritz, weights = la.eig(matrix[:size, :size], check_finite=False)
            large = np.flatnonzero(np.abs(ritz) > smallest * (1 + _SAME))
            considered = large if len(large) else np.array([np.argmax(np.abs(ritz))])
            error = float(np.max(np.linalg.norm(onward @ weights[now, considered], axis=0)))
            if size == free:
                error = 0.0  # the Krylov space is complete
            if len(large) and error < _CONVERGED * smallest:
                return real_span(ritz[large], everything[:, known:] @ weights[:, large]), True
            if not len(large):
                clear = error < _CLEAR * smallest and abs(ritz[considered[0]]) + error < smallest
                if clear or error < _CONVERGED * smallest:
                    return nothing, True
        if size == capacity:
            return nothing, False
        last = last[:, : capacity - size]
        matrix[size : size + last.shape[1], now] = onward[: last.shape[1]]
    raise AssertionError("not reached")


def real_span(values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Orthonormal real basis (n, k) of eigenvectors (n, m) of a real operator, complex ones in conjugate pairs.

    One member of each pair is used: that of the sign of the imaginary part that is more complete.
    """
    upper, lower = np.flatnonzero(values.imag > 0), np.flatnonzero(values.imag < 0)
    half = vectors[:, upper if len(upper) >= len(lower) else lower]
    parts = np.hstack([vectors[:, values.imag == 0].real, half.real, half.imag])
    parts /= np.linalg.norm(parts, axis=0)
    while True:
        sizes, rotation = la.eigh(parts.T @ parts, check_finite=False)
        kept = sizes > 1e-12 * sizes[-1]
        parts = parts @ (rotation[:, kept] / np.sqrt(sizes[kept]))
        if sizes[kept][0] > 1e-4 * sizes[-1]:  # else rounding spoils orthogonality, and another pass restores it
            return parts


def _projected_out(block: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A block with an orthonormal basis projected out, and its components along the basis."""
    first = basis.T @ block
    rest = block - basis @ first
    again = basis.T @ rest  # one pass is inaccurate where the remainder is small
    return rest - basis @ again, first + again
