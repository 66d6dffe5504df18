"""Span of the derivatives of modes by local perturbations, from responses to their own forces with one real factor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError
from calib.execution.tasks import each
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import Perturbation
from calib.structure.eigenproblem.damped_problem import real_times
from calib.structure.eigenproblem.mode_systems import NEIGHBOUR, eigenvalues
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.growth import Growth, fewest
from calib.structure.reduction.refinement import real_columns
from calib.structure.rules import RULES

TOGETHER = 40
"""Perturbations whose responses are in memory together."""
_ROUNDS = 4
"""Times that what the derivatives lack is added."""
_SURE = 0.1
"""Estimated squared error of a derivative, over the one allowed, at which nothing is added for it."""
_FORCE = 1e-3
"""Forces of a perturbation on the modes, over the largest, that have a static response of their own."""
_NEGLIGIBLE = 1e-3
"""Energy of a direction of the responses, over the squared error allowed, below which it is dropped."""
_COLUMNS = 64
"""Columns that are solved at a time: copies of all would take several times their memory."""


class LocalDerivatives:
    """A basis that grows by derivatives of a model's modes by local perturbations, at one point.

    The derivative by a perturbation solves ``Z(lambda) x = -F`` at each mode's eigenvalue. Its part outside the basis
    has no share of the modes, so that it varies little from mode to mode: the static response to the perturbation's
    forces holds most of it. The derivatives are solved on the basis and these responses (Galerkin); what the equations
    of a perturbation lack is summed over its modes with random phases, whose static response has in the mean the energy
    of all their errors (Hutchinson 1990) and is the direction to add. Principal directions of the derivatives so found
    extend the basis.

    Parameters
    ----------
    growth : Growth
        Of the basis.
    basis : Basis
        Modes up to its highest frequency and damping count.
    point : mapping
    modes : Modes
        All modes known at the point.
    """

    def __init__(self, growth: Growth, basis: Basis, point: Mapping[str, float], modes: Modes) -> None:
        model = growth.model
        self._growth, self._point = growth, point
        self._matrices = model.matrices(point)
        shift = (2 * np.pi * growth.modes.natural_freq[0]) ** 2
        dynamic = sp.csc_array(self._matrices[0] + shift * self._matrices[2])
        self._factor, self._diagonal = symmetric_factor(dynamic), dynamic.diagonal()
        upper = eigenvalues(modes)
        self._lam, self._shapes = np.concatenate([upper, upper.conj()]), np.hstack([modes.shapes, modes.shapes.conj()])
        counted = (modes.natural_freq <= basis.freq_max) & (modes.damping_ratio < basis.damping_max)
        self._modes = np.flatnonzero(counted)
        own = modes.shapes[:, self._modes]
        self._size = np.sqrt(np.einsum("ij,ij->j", own.conj(), growth.matrix @ own).real)
        _, damping, mass = self._matrices
        self._inertia, self._dissipation = real_times(mass, self._shapes), real_times(damping, self._shapes)
        self._space = _Space()
        self._extend(self._space, basis.vectors)

    @property
    def vectors(self) -> np.ndarray:
        """The basis so far, (n_dof, n), orthonormal in the energy."""
        return self._space.parts[0]

    def add(self, perturbations: Sequence[Perturbation], error: float) -> None:
        """Extend the basis to represent derivatives by perturbations of magnitude 0 at the point.

        Each is weighed by its plausible magnitude, and represented to a squared error relative to the strain energy of
        its mode. Perturbations add no degrees of freedom. EvaluationError where a mode's equations are singular.
        """
        forces, space, known = self._forces(perturbations), self._space.copy(), self._space.size
        right = [real_times(self.vectors[one.rows].T, one.values) for one in forces]

        def take(responses: np.ndarray) -> None:
            new = self._independent(space, responses, _NEGLIGIBLE * error)
            self._extend(space, new)
            for k, one in enumerate(forces):
                right[k] = np.concatenate([right[k], real_times(new[one.rows].T, one.values)])

        for some in self._static(forces):
            take(self._factor.solve(some))
        waiting, rng = np.arange(len(forces)), np.random.default_rng(len(self.vectors))
        for left in range(_ROUNDS, -1, -1):
            solved = self._galerkin(space, right)
            if not left:
                break
            rest = self._lacking(space, solved, [forces[k] for k in waiting], waiting, rng)
            response = self._factor.solve(rest)
            energy = 2 * np.einsum("ij,ij->j", rest, response)  # half of it is in the real part
            large = energy > _SURE * error
            waiting = waiting[large]
            if not len(waiting):
                break
            take(response[:, large])
        scale = np.array([one.weight for one in forces]) / self._size[:, None, None]
        found = real_columns(np.hstack([*(solved.motions[:, known:] * scale)]))
        directions = la.eigh(found @ found.T)[1][:, ::-1]
        self._space = space.turned(directions[:, : fewest((found.T @ directions) ** 2, error)])

    def _forces(self, perturbations: Sequence[Perturbation]) -> list[_Forces]:
        """Of each perturbation ``(dK + lambda dC + lambda^2 dM) psi`` at every mode, per unit of its magnitude."""
        model = extend(self._growth.model, [one.effect for one in perturbations])
        shapes, lam = self._shapes[:, self._modes], self._lam[self._modes]
        found = []
        for one in perturbations:
            touched = np.zeros(len(shapes), dtype=bool)
            slopes = [sp.csr_array(slope) for slope in model.matrix_derivatives(self._point, one.effect.name)]
            for slope in slopes:
                touched |= np.diff(slope.indptr) > 0
            rows = np.flatnonzero(touched)
            total = np.zeros((len(rows), len(lam)), dtype=complex)
            for slope, power in zip(slopes, (0, 1, 2), strict=True):
                if slope.nnz:
                    total += lam**power * real_times(sp.csc_array(slope[rows]), shapes)
            found.append(_Forces(rows, total, self._weight(one, slopes[0])))
        return found

    def _weight(self, perturbation: Perturbation, stiffness: sp.csr_array) -> float:
        """Magnitude by which the derivative by a perturbation is weighed.

        The plausible one of a grounded spring is scaled by a measured frequency; here by the lowest of the reference
        model, so that measurements of other values need no other basis.
        """
        if not grounded(perturbation):
            return perturbation.effect.plausible
        touched = np.unique(stiffness.indices)
        energies, turn = la.eigh(stiffness[touched][:, touched].toarray())
        kept = energies > 1e-10 * energies[-1]
        forces = np.zeros((len(self._diagonal), int(kept.sum())))
        forces[touched] = turn[:, kept] * np.sqrt(energies[kept])
        return RULES.local / float(np.einsum("ij,ij->", forces, self._factor.solve(forces)))

    def _static(self, forces: Sequence[_Forces]) -> Iterator[np.ndarray]:
        """Independent forces of every perturbation, in the scale of its weight, in blocks (n_dof, m)."""
        found = []
        for one in forces:
            scale = np.sqrt(self._diagonal[one.rows])[:, None]
            parts = real_columns(one.values * (one.weight / self._size)) / scale
            left, sizes, _ = la.svd(parts, full_matrices=False, check_finite=False)
            kept = sizes > _FORCE * sizes.max(initial=0.0)
            found += [(one.rows, column) for column in (scale * left[:, kept] * sizes[kept]).T]
        for first in range(0, len(found), _COLUMNS):
            some = found[first : first + _COLUMNS]
            block = np.zeros((len(self._diagonal), len(some)))
            for k, (rows, column) in enumerate(some):
                block[rows, k] = column
            yield block

    def _independent(self, space: _Space, columns: np.ndarray, least: float) -> np.ndarray:
        """What columns have outside a space, orthonormal in the energy; directions of less energy are dropped."""
        energy = self._growth.matrix
        new = self._growth.spanned(space.outside(columns, energy), least)
        return space.outside(new, energy)

    def _extend(self, space: _Space, new: np.ndarray) -> None:
        space.add(new, self._matrices, (self._inertia, self._dissipation))

    def _galerkin(self, space: _Space, right: Sequence[np.ndarray]) -> _Solved:
        """Derivatives of every mode on a space, but for their part in the modes close to it.

        ``right`` are the forces of every perturbation on the space, (n, n_modes).
        """
        equations = _Equations(space.small, space.along, self._lam, self._modes, np.stack(right, axis=2))
        found = each(_of_mode, equations, range(len(self._modes)))
        return _Solved(np.stack([one.motions for one in found]), [(one.near, one.factors) for one in found])

    def _lacking(
        self, space: _Space, solved: _Solved, forces: Sequence[_Forces], which: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Residual forces of perturbations, summed over modes with random phases, (n_dof, m), real."""
        lam = self._lam[self._modes]
        phases = np.exp(2j * np.pi * rng.random((len(lam), len(forces))))
        phases *= np.array([one.weight for one in forces]) / self._size[:, None]
        own = solved.motions[:, :, which]
        out = np.zeros((len(self._diagonal), len(forces)))
        for matrix, power in zip(self._matrices, (0, 1, 2), strict=True):
            if matrix.nnz:
                small = np.einsum("kp,kip->ip", phases * lam[:, None] ** power, own).real
                out += matrix @ space.combined(small)
        by_inertia, by_damping = (np.zeros((len(self._lam), len(forces)), dtype=complex) for _ in range(2))
        for k, (near, factors) in enumerate(solved.borders):
            held = factors[:, which] * phases[k]
            by_damping[near] += held
            by_inertia[near] += held * (lam[k] + self._lam[near])[:, None]
        out += (self._inertia @ by_inertia + self._dissipation @ by_damping).real
        for p, one in enumerate(forces):
            out[one.rows, p] += (one.values @ phases[:, p]).real
        return out


@dataclass(frozen=True, eq=False)
class _Equations:
    """Equations on a space of derivatives of modes.

    Attributes
    ----------
    matrices : sequence of ndarray (n, n)
        K, C and M on the space.
    along : sequence of ndarray (n, n_every)
        ``M psi`` and ``C psi`` of every mode on the space.
    lam : ndarray (n_every,), complex
        Eigenvalues.
    modes : ndarray (n_modes,), int
        Which of them have derivatives.
    right : ndarray (n, n_modes, n_perturbations)
        Forces.
    """

    matrices: Sequence[np.ndarray]
    along: Sequence[np.ndarray]
    lam: np.ndarray
    modes: np.ndarray
    right: np.ndarray


class _OfMode(NamedTuple):
    """Derivatives of one mode by every perturbation, (n, n_perturbations), its close modes, and what holds these."""

    motions: np.ndarray
    near: np.ndarray
    factors: np.ndarray


def _of_mode(equations: _Equations, k: int) -> _OfMode:
    """Solution for one of the modes."""
    (stiffness, damping, mass), (inertia, dissipation) = equations.matrices, equations.along
    size, every, lam = len(stiffness), equations.lam, equations.lam[equations.modes[k]]
    near = np.flatnonzero(np.abs(every - lam) <= NEIGHBOUR * abs(lam))
    border = inertia[:, near] * (lam + every[near]) + dissipation[:, near]
    scale = float(np.abs(border).max(initial=0.0)) or 1.0
    whole = np.zeros((size + len(near),) * 2, dtype=complex)
    whole[:size, :size] = stiffness + lam * damping + lam**2 * mass
    whole[:size, size:], whole[size:, :size] = border / scale, border.T / scale
    given = np.zeros((len(whole), equations.right.shape[2]), dtype=complex)
    given[:size] = -equations.right[:, k]
    try:
        both = np.linalg.solve(whole, given)
    except np.linalg.LinAlgError as fault:
        raise EvaluationError(f"derivatives of mode {k + 1} cannot be solved ({fault})") from fault
    return _OfMode(both[:size], near, both[size:] / scale)


@dataclass(frozen=True, eq=False)
class _Forces:
    """Forces of a perturbation on each mode, (n_rows, n_modes), at the rows that it reaches, and its weight."""

    rows: np.ndarray
    values: np.ndarray
    weight: float


class _Space:
    """Vectors in parts (n_dof, n_k) that are orthonormal together, and what is projected on all of them.

    ``small`` are matrices (n, n), and ``along`` other columns (n, m).
    """

    def __init__(self) -> None:
        self.parts: list[np.ndarray] = []
        self.small: list[np.ndarray] = []
        self.along: list[np.ndarray] = []

    @property
    def size(self) -> int:
        """Number of vectors."""
        return sum(part.shape[1] for part in self.parts)

    def copy(self) -> _Space:
        """Another one, which shares the parts."""
        out = _Space()
        out.parts, out.small, out.along = list(self.parts), list(self.small), list(self.along)
        return out

    def add(self, new: np.ndarray, matrices: Sequence[Any], columns: Sequence[np.ndarray]) -> None:
        """Take vectors, orthonormal to the others, and project matrices and columns on them."""
        if not self.parts:
            self.small = [np.zeros((0, 0)) for _ in matrices]
            self.along = [np.zeros((0, one.shape[1]), dtype=one.dtype) for one in columns]
        for k, matrix in enumerate(matrices):
            image = matrix @ new
            beside = self.onto(image)
            self.small[k] = np.block([[self.small[k], beside], [beside.T, new.T @ image]])
        self.along = [
            np.concatenate([known, real_times(new.T, one)]) for known, one in zip(self.along, columns, strict=True)
        ]
        self.parts.append(new)

    def onto(self, columns: np.ndarray) -> np.ndarray:
        """Products of all vectors with columns, (n, m)."""
        return np.concatenate([np.zeros((0, columns.shape[1])), *(part.T @ columns for part in self.parts)])

    def combined(self, small: np.ndarray) -> np.ndarray:
        """Motions (n_dof, m) from factors of all vectors (n, m)."""
        ends = np.cumsum([part.shape[1] for part in self.parts])[:-1]
        out: np.ndarray = sum(part @ own for part, own in zip(self.parts, np.split(small, ends), strict=True))
        return out

    def outside(self, columns: np.ndarray, energy: Any) -> np.ndarray:
        """Columns with all vectors projected out in the energy."""
        rest = np.array(columns)
        for first in range(0, rest.shape[1], _COLUMNS):
            some = slice(first, first + _COLUMNS)
            for _ in range(2):
                rest[:, some] -= self.combined(self.onto(energy @ rest[:, some]))
        return rest

    def turned(self, directions: np.ndarray) -> _Space:
        """The first part, and of all others some directions, (n - n_0, m)."""
        known, out, others = self.parts[0], _Space(), _Space()
        others.parts = self.parts[1:]
        out.parts = [np.hstack([known, others.combined(directions)])]
        whole = la.block_diag(np.eye(known.shape[1]), directions)
        out.small = [whole.T @ matrix @ whole for matrix in self.small]
        out.along = [whole.T @ columns for columns in self.along]
        return out


@dataclass(frozen=True, eq=False)
class _Solved:
    """Derivatives (n_modes, n, n_perturbations) over a space; of each mode, what holds its close modes, by these."""

    motions: np.ndarray
    borders: list[tuple[np.ndarray, np.ndarray]]


def grounded(perturbation: Perturbation) -> bool:
    """Whether a perturbation is a spring to the ground at a sensor."""
    return bool(perturbation.sensor) and perturbation.kind == "stiffness"
