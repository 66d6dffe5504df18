"""Growth of a reduced basis until it meets a target."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.execution.tasks import each
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor
from calib.structure.elongations import few_motions
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced import ReducedModel, reference_factor, reference_matrix

SAFETY = 0.5
"""Limit of the error indicator, as a fraction of the tolerance."""
POD = 0.5
"""Squared projection error of every snapshot, as a fraction of the tolerance."""
_SHARES = (1.0, 0.1, 0.01, 1e-3)
"""Parts of the energy below which a missing vector is dropped, tried in turn."""
_STATIC = 1e-3
"""Static vectors closer than this to the span of the others, in the energy norm, are dropped."""
_LOCAL, _STRAINED = 0.1, 20
"""Degrees of freedom of a small part, over those of the model, and modes whose damping forces on it count."""
_COLUMNS = 64
"""Columns that are multiplied at a time: copies of all would take several times their memory."""
VERIFIED = 6
"""Points of a passed round, worst indicators first, that are compared with the full model: only that detects missed
modes. The first is solved at full order, the others are refined and counted."""


class Target(Protocol):
    """What a reduced basis must represent, and how well."""

    @property
    def count(self) -> int:
        """Number of modes; 0 for none."""

    @property
    def freq_max(self) -> float:
        """Highest frequency, Hz."""

    @property
    def damping_max(self) -> float:
        """Largest damping ratio of a mode that must be represented."""

    @property
    def tolerance(self) -> float:
        """Largest `error`."""

    @property
    def request(self) -> str:
        """Hash of what else the target consists of; empty for modes."""

    def forces(self, model: StructuralModel) -> np.ndarray:
        """Forces whose static responses belong to the basis, (n_dof, n_forces)."""

    def snapshots(
        self,
        model: StructuralModel,
        energy: sp.csc_array,
        values: Mapping[str, float],
        known: ReducedModel | None = None,
    ) -> np.ndarray:
        """Real columns (n_dof, m) that the basis must represent, from the full model at named values.

        A reduced model ``known`` so far may serve as the start of a solution.
        They are scaled so that the tolerance is met where their squared projection errors in the inner product
        ``energy`` (n_dof, n_dof) are below it, to the order of magnitude: `error` decides.
        """

    def posed(self, reduced: ReducedModel) -> ReducedModel:
        """What the following take, from the reduced base model: the same with what the target adds to it."""

    def missing(
        self, reduced: ReducedModel, energy: sp.csc_array, values: Mapping[str, float], unseen: bool = False
    ) -> np.ndarray:
        """The same, chosen where the reduced model is wrong; ``unseen`` where `estimate` does not show it."""

    def estimate(self, reduced: ReducedModel, values: Mapping[str, float]) -> float:
        """Estimate of `error` without the full model's solution."""

    def error(self, reduced: ReducedModel, values: Mapping[str, float], counted: bool = False) -> float:
        """Largest error against the full model at named values.

        ``counted`` allows a solution whose completeness rests on a count of undamped modes.
        """


class Growth:
    """Inner product of a basis, and the projections and decompositions in it.

    ``modes`` are `reference_modes` of the basis, where they are known.
    """

    def __init__(self, model: StructuralModel, basis: Basis, modes: Modes | None = None):
        self.model = model
        self._modes = modes
        self.reference = basis.reference_values
        self.offset = basis.offset
        self.matrix = reference_matrix(model, self.reference, basis.offset)

    @cached_property
    def factor(self) -> SymmetricFactor:
        """Factor of the inner product."""
        return reference_factor(self.model, self.reference, self.offset)

    @cached_property
    def rigid(self) -> int:
        """Number of rigid-body motions and mechanisms of the reference model."""
        return _rigid_count(self.modes) if self.offset else 0

    @cached_property
    def modes(self) -> Modes:
        """See `reference_modes`."""
        return reference_modes(self.model, self.reference) if self._modes is None else self._modes

    @cached_property
    def _strained(self) -> np.ndarray:
        """The lowest undamped shapes at the reference, (n_dof, m): what strains a damped part."""
        mass = self.model.mass(self.model.space.si(self.model.space.complete(self.reference)))
        stiffness = reference_matrix(self.model, self.reference, 0.0)
        return solve_modes(stiffness, None, mass, min(_STRAINED, self.model.n_dof)).shapes

    def _inertia_forces(self) -> np.ndarray:
        """Forces whose responses are the rigid-body motions and mechanisms of the reference model."""
        mass = self.model.mass(self.model.space.si(self.model.space.complete(self.reference)))
        forces = np.random.default_rng(20110713).standard_normal((self.model.n_dof, self.rigid))
        for _ in range(12):  # each pass reduces the first vibration mode by a factor of 100
            motions = np.linalg.qr(self.factor.solve(forces))[0]
            forces = mass @ motions
        return forces

    def project_out(self, vectors: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Vectors with an orthonormal basis projected out in the energy product."""
        rest = np.array(vectors)
        for some in _blocks(rest.shape[1]):
            for _ in range(2):
                rest[:, some] -= basis @ (basis.T @ (self.matrix @ rest[:, some]))
        return rest

    def gram(self, vectors: np.ndarray) -> np.ndarray:
        """Energy products of vectors (n_dof, m) with each other, (m, m)."""
        return products(self.matrix, vectors)

    def spanned(self, vectors: np.ndarray, least: float) -> np.ndarray:
        """Orthonormal basis of vectors (n_dof, m); directions of energy below ``least`` (squared norm) are dropped."""
        if not vectors.shape[1]:
            return vectors
        energies, turn = la.eigh(self.gram(vectors))
        kept = energies > max(least, 1e-13 * energies[-1])
        out = vectors @ (turn[:, kept] / np.sqrt(energies[kept]))
        # A second pass, since the division has amplified the rounding error of small directions.
        energies, turn = la.eigh(self.gram(out))
        return out @ (turn / np.sqrt(energies)) @ turn.T

    def statics(self, loads: np.ndarray) -> np.ndarray:
        """Static responses of the reference model to selected vectors and forces; and its rigid-body motions.

        The forces are those of the dampers and ``loads`` (n_dof, n_loads). A term that resists more than
        `calib.structure.elongations.MOST_MOTIONS` motions is material damping: a small part adds the damping forces of
        the lowest undamped modes, and a large one is left to the modes of which the basis is made.

        Returns
        -------
        ndarray (n_dof, n_vectors)
            Orthonormal in the energy of the reference.
        """
        chosen = [b for term in self.model.stiffness.selected for b in term.vectors.values()]
        forces = [np.column_stack(chosen)] if chosen else []
        if loads.shape[1]:
            forces.append(loads)
        if self.rigid:
            forces.append(self._inertia_forces())
        for term in self.model.damping.terms:
            found = few_motions(term.matrix)
            if found is not None:
                seen, _, motions = found
                columns = np.zeros((self.model.n_dof, motions.shape[1]))
                columns[seen] = motions
                forces.append(columns)
            elif np.count_nonzero(np.diff(term.matrix.indptr)) <= _LOCAL * self.model.n_dof:
                forces.append(term.matrix @ self._strained)
        if not forces:
            return np.zeros((self.model.n_dof, 0))
        responses = self.factor.solve(np.hstack(forces))
        responses /= np.sqrt(np.einsum("ij,ij->j", responses, self.matrix @ responses))
        return self.spanned(responses, _STATIC**2)

    def widened(self, basis: np.ndarray, vectors: Iterable[np.ndarray], error: float) -> np.ndarray:
        """An orthonormal basis, extended to represent given vectors, (n_dof, m) each, to a squared error."""
        snapshots = Snapshots(self, basis)
        for some in vectors:
            snapshots.add(some)
        return snapshots.represented(error)

    def enriched(
        self,
        basis: Basis,
        points: Sequence[Mapping[str, float]],
        target: Target,
        number: int,
        verified: int = VERIFIED,
    ) -> tuple[Basis, bool]:
        """The basis with what is missing at the worst points added until all pass, and whether all passed at once.

        ``number`` is that of the round; so many worst points that passed are ``verified`` at full order.
        """
        final = np.zeros(len(points))
        waiting = list(range(len(points)))
        passed = True
        while waiting:
            reduced = target.posed(ReducedModel(self.model, basis, factor=self.factor))
            final[waiting] = each(_estimate, (target, reduced), [points[k] for k in waiting])
            checks = [(number, basis.size, final[k], np.nan) for k in waiting]
            waiting = [k for k in waiting if final[k] > SAFETY * target.tolerance]
            worst = [max(waiting, key=lambda k: final[k])] if waiting else []
            unseen = not waiting
            if not waiting:
                chosen = np.argsort(-final, kind="stable")[:verified].tolist()
                asked = [(points[k], rank > 0) for rank, k in enumerate(chosen)]
                for k, error in zip(chosen, each(_error, (target, reduced), asked), strict=True):
                    checks.append((number, basis.size, final[k], error))
                    if error > target.tolerance:
                        worst.append(k)
            basis = replace(basis, checks=np.vstack([basis.checks, checks]))
            if not worst:
                break
            passed = False
            lacking = each(_missing, (target, reduced, self.matrix, unseen), [points[k] for k in worst])
            grown = self._grown(basis.vectors, np.hstack(lacking), POD * target.tolerance)
            if grown.shape[1] == basis.size:
                break  # nothing is left to add
            samples = np.vstack([basis.samples, sampled_rows(basis, [points[k] for k in worst])])
            basis = replace(basis, vectors=grown, samples=samples)
        return basis, passed

    def _grown(self, basis: np.ndarray, vectors: np.ndarray, least: float) -> np.ndarray:
        """An orthonormal basis with vectors added that its error shows to be missing.

        The energy of what they add is that at the reference values. Where parameters stiffen what moves little, an
        energy below ``least`` is a larger part of their own: ever smaller ones are added until the basis grows.
        """
        for share in _SHARES:
            grown = self.added(basis, vectors, share * least)
            if grown.shape[1] > basis.shape[1]:
                break
        return grown

    def added(self, basis: np.ndarray, vectors: np.ndarray, least: float) -> np.ndarray:
        """An orthonormal basis with vectors added, directions of energy below ``least`` dropped."""
        new = self.spanned(self.project_out(vectors, basis), least)
        return np.hstack([basis, self.project_out(new, basis)])


class Snapshots:
    """What vectors have outside an orthonormal basis, and the products of that with each other.

    Vectors are taken one after another, each once: what is kept of them is nearly all the memory of a training.
    """

    def __init__(self, growth: Growth, basis: np.ndarray) -> None:
        self._growth, self._basis = growth, basis
        self._parts: list[np.ndarray] = []
        self._gram = np.zeros((0, 0))

    def add(self, vectors: np.ndarray) -> None:
        """Take vectors, (n_dof, m)."""
        for some in _blocks(vectors.shape[1]):
            rest = self._growth.project_out(vectors[:, some], self._basis)
            images = self._growth.matrix @ rest
            beside = [part.T @ images for part in self._parts]
            above = np.vstack([np.zeros((0, rest.shape[1])), *beside])
            self._gram = np.block([[self._gram, above], [above.T, rest.T @ images]])
            self._parts.append(rest)

    def represented(self, error: float) -> np.ndarray:
        """The basis, extended by the fewest principal directions that represent every vector to a squared error."""
        own = np.diag(self._gram)
        if own.max(initial=0.0) < error:
            return self._basis
        energies, turn = la.eigh(self._gram)
        energies, turn = energies[::-1], turn[:, ::-1]
        size = fewest(energies * turn**2, error)
        size = min(size, int(np.count_nonzero(energies > 1e-13 * energies[0])))
        growth, ends = self._growth, np.cumsum([part.shape[1] for part in self._parts])[:-1]
        weights = np.split(turn[:, :size] / np.sqrt(energies[:size]), ends)
        found = np.zeros((len(self._basis), size))
        for part, weight in zip(self._parts, weights, strict=True):
            found += part @ weight
        return np.hstack([self._basis, growth.spanned(growth.project_out(found, self._basis), 0.0)])


def fewest(parts: np.ndarray, error: float) -> int:
    """How many principal directions represent every vector to a squared error.

    ``parts`` (n_vectors, n_directions) are the squares of each vector along all directions, the principal one first.
    """
    beyond = np.cumsum(parts[:, ::-1], axis=1)[:, ::-1]
    return int(np.count_nonzero(beyond.max(axis=0, initial=0.0) >= error))


def products(energy: sp.csc_array, vectors: np.ndarray) -> np.ndarray:
    """Products of vectors (n_dof, m) with each other in an inner product (n_dof, n_dof), (m, m)."""
    return np.hstack([vectors.T @ (energy @ vectors[:, some]) for some in _blocks(vectors.shape[1])])


def _blocks(count: int) -> list[slice]:
    """Columns in blocks, at least one."""
    return [slice(first, first + _COLUMNS) for first in range(0, max(count, 1), _COLUMNS)]


def _estimate(shared: tuple[Target, ReducedModel], point: Mapping[str, float]) -> float:
    target, reduced = shared
    return target.estimate(reduced, point)


def _error(shared: tuple[Target, ReducedModel], asked: tuple[Mapping[str, float], bool]) -> float:
    target, reduced = shared
    point, counted = asked
    return target.error(reduced, point, counted)


def _missing(shared: tuple[Target, ReducedModel, sp.csc_array, bool], point: Mapping[str, float]) -> np.ndarray:
    target, reduced, energy, unseen = shared
    return target.missing(reduced, energy, point, unseen)


def _rigid_count(modes: Modes) -> int:
    """Number of rigid-body motions and mechanisms among the modes of a reference model."""
    return sum(eigenvalue.kind in ("zero", "spin") for eigenvalue in modes.excluded)


def offset_of(modes: Modes) -> float:
    """Factor of the mass that keeps the inner product regular, by `reference_modes`; 0 without rigid-body motions."""
    return float((0.1 * 2 * np.pi * modes.natural_freq[0]) ** 2) if _rigid_count(modes) else 0.0


def reference_modes(model: StructuralModel, values: Mapping[str, float]) -> Modes:
    """The lowest mode of a model without selected terms and damping, and what is excluded below it."""
    stiffness = reference_matrix(model, values, 0.0)
    return solve_modes(stiffness, None, model.mass(model.space.si(model.space.complete(values))), 1)


def sampled_rows(basis: Basis, points: Sequence[Mapping[str, float]]) -> np.ndarray:
    """Points as rows of `Basis.samples`, (n_points, n_names)."""
    return np.array([[p[name] for name in basis.names] for p in points], dtype=float).reshape(-1, len(basis.names))


def next_round(basis: Basis) -> int:
    """Number of the next round of checks."""
    return int(basis.checks[:, 0].max(initial=0)) + 1
