"""Damped eigenproblem in coordinates in which the stiffness is the identity, such as undamped modes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

_ALIKE = 1e-12
"""Added to the Gram matrix of unit forces, so that directions that are alike have finite lengths."""


@dataclass(frozen=True, eq=False)
class DampedProblem:
    """``Z(lambda) = (lambda^2 - shift^2) M + lambda C + I``, with the stiffness ``I - shift^2 M``.

    Attributes
    ----------
    mass : ndarray (n,) or (n, n)
        A diagonal M, or all of it.
    damping : ndarray (n, n)
        C.
    shift : float
        Small, in rad/s: keeps the stiffness regular where there are rigid-body motions.
    """

    mass: np.ndarray
    damping: np.ndarray
    shift: float

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.mass)

    def inertia(self, motions: np.ndarray) -> np.ndarray:
        """``M x`` of motions (n, m)."""
        return self.mass[:, None] * motions if self.mass.ndim == 1 else real_times(self.mass, motions)

    def inverse(self) -> Callable[[np.ndarray], np.ndarray]:
        """``(A - shift)^-1`` of states (u, v/speed), one or a block, with A: u' = v, M v' = -K u - C v."""
        n, shift = self.size, self.shift
        speed, momentum = self._speed, self._momentum

        def inverse(state: np.ndarray) -> np.ndarray:
            moved = momentum @ state
            return np.concatenate([moved, (state[:n] + shift * moved) / speed])

        return inverse

    def inverse_matrix(self) -> np.ndarray:
        """The same as a matrix, (2n, 2n)."""
        n, momentum = self.size, self._momentum
        matrix = np.concatenate([momentum, self.shift / self._speed * momentum])
        matrix[np.arange(n, 2 * n), np.arange(n)] += 1.0 / self._speed
        return matrix

    @cached_property
    def _speed(self) -> float:
        """A typical frequency, rad/s, which balances the two halves of a state."""
        trace = float(np.sum(self.mass) if self.mass.ndim == 1 else np.trace(self.mass))
        return float(1.0 / np.sqrt(max(trace / self.size, 1e-300)))

    @cached_property
    def _momentum(self) -> np.ndarray:
        """``-(I + shift C)^-1 (C + shift M, speed M)``, (n, 2n)."""
        mass = np.diag(self.mass) if self.mass.ndim == 1 else self.mass
        both = np.hstack([self.damping + self.shift * mass, self._speed * mass])
        factor = np.eye(self.size) + self.shift * self.damping
        return np.asfortranarray(-np.linalg.solve(factor, both))

    def overdamped(self, speed: float) -> int:
        """Number of real eigenvalues ``lambda > -speed``, except pairs with both members in that range.

        Z is positive definite at 0, and one of its eigenvalues changes sign at every real eigenvalue lambda. The
        negative ones at -speed are counted (Sylvester's law of inertia); a two-by-two pivot is indefinite and holds
        one.
        """
        mass = np.diag(self.mass) if self.mass.ndim == 1 else self.mass
        matrix = np.eye(self.size) + (speed**2 - self.shift**2) * mass - speed * self.damping
        factor, pivots, _ = la.lapack.dsytrf(matrix, lower=1, lwork=64 * self.size)
        single = pivots > 0
        return int(np.count_nonzero(np.diag(factor)[single] < 0) + np.count_nonzero(~single) // 2)


@dataclass(frozen=True, eq=False)
class Eigenpairs:
    """Approximate eigenpairs of a damped problem.

    Attributes
    ----------
    problem : DampedProblem
    values : ndarray (m,), complex
        lambda, rad/s.
    motions : ndarray (n, m), complex
        x, in any scale.
    dissipation : ndarray (n, m), complex
        ``C x``.
    """

    problem: DampedProblem
    values: np.ndarray
    motions: np.ndarray
    dissipation: np.ndarray

    @cached_property
    def inertia(self) -> np.ndarray:
        """``M x``, (n, m)."""
        return self.problem.inertia(self.motions)

    @cached_property
    def residual(self) -> np.ndarray:
        """``Z(lambda) x``, (n, m)."""
        return self.forces(self.motions, self.dissipation)

    @cached_property
    def weights(self) -> np.ndarray:
        """``x^T (2 lambda M + C) x``, (m,): 1 in the scale of `calib.structure.modes.Modes`."""
        return np.einsum("ij,ij->j", self.motions, 2 * self.values * self.inertia + self.dissipation)

    @cached_property
    def errors(self) -> np.ndarray:
        """Estimated relative error of each eigenvalue by its residual, whose dual norm is Euclidean here, (m,)."""
        squares = _squared(self.residual)
        return np.asarray(squares / np.abs(self.weights * self.values))

    def forces(self, motions: np.ndarray, dissipation: np.ndarray) -> np.ndarray:
        """``Z(lambda) y`` of other motions y (n, m) with ``C y``, each at its eigenvalue."""
        squares = self.values**2 - self.problem.shift**2
        return np.asarray(squares * self.problem.inertia(motions) + self.values * dissipation + motions)

    def moved(self, directions: list[tuple[np.ndarray, np.ndarray]]) -> Eigenpairs:
        """With motions changed along given ones (n, m), each with its ``C y``, to the least residual.

        The eigenvalue is the nearest root of ``x^T Z(lambda) x = 0``, whose error is of second order in that of x.
        """
        forces = np.stack([self.forces(*direction) for direction in directions])
        gram = np.einsum("kij,lij->jkl", forces.conj(), forces)
        sizes = np.sqrt(np.maximum(np.einsum("jkk->jk", gram).real, 1e-300))
        gram = gram / sizes[:, :, None] / sizes[:, None, :] + _ALIKE * np.eye(len(directions))
        along = -np.einsum("kij,ij->jk", forces.conj(), self.residual) / sizes
        lengths = (np.linalg.solve(gram, along[:, :, None])[:, :, 0] / sizes).T
        motions, dissipation = self.motions, self.dissipation
        for length, (change, its_dissipation) in zip(lengths, directions, strict=True):
            motions, dissipation = motions + length * change, dissipation + length * its_dissipation
        a = np.einsum("ij,ij->j", motions, self.problem.inertia(motions))
        b = np.einsum("ij,ij->j", motions, dissipation)
        c = np.einsum("ij,ij->j", motions, motions) - self.problem.shift**2 * a
        root = np.sqrt(b * b - 4 * a * c)
        far = -0.5 * np.where((b.conj() * root).real >= 0, b + root, b - root)  # the sum without cancellation
        roots = np.array([far / a, c / far])
        nearest = np.argmin(np.abs(roots - self.values), axis=0)
        return Eigenpairs(self.problem, roots[nearest, np.arange(len(nearest))], motions, dissipation)

    def subset(self, index: np.ndarray) -> Eigenpairs:
        """Some of them, in the order of the indices."""
        return Eigenpairs(self.problem, self.values[index], self.motions[:, index], self.dissipation[:, index])


def real_times(matrix: sp.csc_array | np.ndarray, columns: np.ndarray) -> np.ndarray:
    """A real matrix times real or complex columns (n, m), in real arithmetic."""
    if not np.iscomplexobj(columns):
        return np.asarray(matrix @ columns)
    parts = np.ascontiguousarray(columns).view(float)
    return np.asarray(matrix @ parts).view(complex)


def _squared(columns: np.ndarray) -> np.ndarray:
    """Squared norm of each complex column, (m,)."""
    return np.asarray(
        np.einsum("ij,ij->j", columns.real, columns.real) + np.einsum("ij,ij->j", columns.imag, columns.imag)
    )
