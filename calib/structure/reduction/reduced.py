"""Reduced model: a structural model projected on a basis, with small dense matrices."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.extend import extend
from calib.structure.eigenproblem.damped_problem import real_times
from calib.structure.eigenproblem.derivatives import Analytic
from calib.structure.eigenproblem.solve_dense import solve_dense
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor
from calib.structure.energy import shares_of, strain_energy
from calib.structure.geometry import Mesh
from calib.structure.model import Assumption, StructuralModel
from calib.structure.modes import Modes
from calib.structure.pattern import padded
from calib.structure.places import ModelPlace
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced_matrix import ClusterEnergy, ReducedMatrix, ReducedSlope, reduce_matrix


@dataclass(frozen=True, eq=False)
class ReducedModel(Analytic):
    """A structural model projected on a basis; a `ModalModel` whose degrees of freedom are the basis vectors.

    Errors of frequencies are of second order in the projection error of the shapes (Rayleigh-Ritz); those of MAC and
    strain energy shares are of first order, largest for the latter, since a basis represents forces less accurately
    than shapes. `indicator` estimates the frequency error at a point.

    Attributes
    ----------
    model : StructuralModel
    basis : Basis
    inner : ReducedModel, optional
        The reduced base model that ``model`` and ``basis`` extend: its projections are shared, see `extended`.
    factor : SymmetricFactor, optional
        Of `reference_matrix` at the reference values of the basis, where it is known; of ``inner`` where that is given.

    Raises
    ------
    InputError
        When the basis belongs to another model.
    """

    model: StructuralModel
    basis: Basis
    inner: ReducedModel | None = None
    factor: SymmetricFactor | None = field(default=None, repr=False)
    _stiffness: ReducedMatrix = field(init=False, repr=False)
    _damping: ReducedMatrix = field(init=False, repr=False)
    _mass: ReducedMatrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.inner is None and self.basis.model_fingerprint != self.model.fingerprint:
            raise InputError(
                "the reduced basis belongs to another model or to an earlier version of it",
                place=f"model {self.model.name}",
                remedy="train it anew",
            )
        for name in ("stiffness", "damping", "mass"):
            known = () if self.inner is None else getattr(self.inner, f"_{name}").blocks
            object.__setattr__(self, f"_{name}", reduce_matrix(getattr(self.model, name), self.basis.vectors, known))

    def __getstate__(self) -> dict[str, Any]:
        # A factor cannot be pickled; it is made again where it is needed.
        state = {name: value for name, value in self.__dict__.items() if name != "_reference_factor"}
        return {**state, "factor": None}

    def extended(self, effects: Sequence[Effect]) -> ReducedModel:
        """The model with effects; each added degree of freedom becomes a basis vector.

        InputError when an effect cannot be added, see `calib.structure.effects.extend.extend`.
        """
        model = extend(self.model, effects, leading=True)
        return ReducedModel(model, self.basis.carried(model.space, model.n_dof), self)

    # -- properties shared with the full model -------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name of the full model and size of the basis."""
        return f"{self.model.name} (reduced to {self.n_dof})"

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the full model."""
        return self.model.space

    @property
    def n_dof(self) -> int:
        """Number of vectors."""
        return self.basis.size

    @property
    def clusters(self) -> tuple[str, ...]:
        """Names of the full model's clusters."""
        return tuple(self.model.clusters)

    @property
    def mesh(self) -> Mesh:
        """Mesh of the full model."""
        return self.model.mesh

    @property
    def places(self) -> tuple[ModelPlace, ...]:
        """Places of the full model."""
        return self.model.places

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """Assumptions of the full model."""
        return self.model.assumptions

    @property
    def reducible(self) -> None:
        """None: it is reduced already."""
        return

    @property
    def whole(self) -> StructuralModel:
        """The full model."""
        return self.model

    @property
    def n_modes(self) -> int:
        """Modes that the basis was trained for."""
        return self.basis.count

    @property
    def is_damped(self) -> bool:
        """Whether modes are complex."""
        return self.model.is_damped

    @property
    def roots(self) -> frozenset[str]:
        """Parameters whose derivatives do not exist at 0, as for the full model."""
        return self.model.roots

    @cached_property
    def fingerprint(self) -> str:
        """Hash over the full model and the basis."""
        return hashlib.sha256((self.model.fingerprint + self.basis.digest).encode()).hexdigest()[:16]

    # -- results -------------------------------------------------------------------------------------------------------

    def matrices(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K, C, M over the basis at named values, each (size, size)."""
        si = self.space.si(self.space.complete(values))
        return self._stiffness(si), self._damping(si), self._mass(si)

    def matrix_derivatives(
        self, values: Mapping[str, float], name: str
    ) -> tuple[ReducedSlope, ReducedSlope, ReducedSlope]:
        """dK, dC, dM with respect to one parameter in its own unit; integer parameters count as fixed."""
        si = self.space.si(self.space.complete(values))
        factor = self.space[name].si_factor
        stiffness, damping, mass = (m.derivative(si, name) * factor for m in self._matrices)
        return stiffness, damping, mass

    @property
    def _matrices(self) -> tuple[ReducedMatrix, ReducedMatrix, ReducedMatrix]:
        return self._stiffness, self._damping, self._mass

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest vibration modes at named values, with shapes over the basis, (size, count).

        Raises
        ------
        InputError
            When more modes are requested than the basis was trained for.
        EvaluationError
            When the point cannot be solved.
        """
        if count > self.basis.count:
            raise InputError(
                f"{count} modes are requested from a basis trained for {self.basis.count}",
                place=f"model {self.name}",
                remedy="train it for as many",
            )
        si = self.space.si(self.space.complete(values))
        stiffness, mass = self._stiffness(si), self._mass(si)
        damping = self._damping(si) if self.is_damped else None

        def rotational_share(shape: np.ndarray) -> float:
            total = abs(np.vdot(shape, mass @ shape))
            return float(abs(np.vdot(shape, self._rotational_mass(si) @ shape)) / total) if total > 0 else 0.0

        return solve_dense(stiffness, damping, mass, count, rotational_share)

    def lift(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes over the full model's degrees of freedom, (n_full, n_modes), from those over the basis."""
        return real_times(self.basis.vectors, shapes)

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over the basis, (n_sensors, size); raises like the full model."""
        return self.model.sensor_rows(sensors) @ self.basis.vectors

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of all nodes, (n_nodes, 3, n_modes), from shapes over the basis."""
        return self.model.displacement(self.lift(shapes))

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Strain energy of each mode in the scale of its shape, (n_modes,)."""
        return strain_energy(self._stiffness(self.space.si(self.space.complete(values))), shapes)

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Share of each mode's strain energy in each named cluster, (n_names, n_modes): that of the lifted shapes."""
        si = self.space.si(self.space.complete(values))
        factors = [t.coefficient(si) for t in self.model.stiffness.terms]
        supports = zip(self.model.stiffness.selected, self._stiffness.vectors, strict=True)
        picks = [(t.coefficient(si), vectors[key := t.choice(si)], key) for t, vectors in supports]
        real = np.hstack([shapes.real, shapes.imag]) if np.iscomplexobj(shapes) else shapes
        parts = np.zeros((len(names), real.shape[1]))
        for i, name in enumerate(names):
            share = self._cluster_energy[name]
            matrix = share.matrix(factors)
            parts[i] = np.einsum("ij,ij->j", real, matrix @ real)
            for (factor, b, key), own in zip(picks, share.supports, strict=True):
                if key in own:
                    parts[i] += factor * (own[key] @ real) * (b @ real)
        if np.iscomplexobj(shapes):
            parts = parts[:, : shapes.shape[1]] + parts[:, shapes.shape[1] :]
        return shares_of(parts, strain_energy(self._stiffness(si), shapes))

    @cached_property
    def _cluster_energy(self) -> Mapping[str, ClusterEnergy]:
        return {name: self._energy_of(name, np.unique(members)) for name, members in self.model.clusters.items()}

    def _energy_of(self, name: str, members: np.ndarray) -> ClusterEnergy:
        own = self.basis.vectors[members]
        supports = tuple(
            {key: own.T @ b[members] for key, b in term.vectors.items() if np.any(b[members])}
            for term in self.model.stiffness.selected
        )
        inner = None if self.inner is None else self.inner._cluster_energy[name]
        return ClusterEnergy(self.basis, members, self.model.stiffness.terms, supports, inner)

    # -- rotations, needed only for zero eigenvalues -------------------------------------------------------------------

    def _rotational_mass(self, si: Mapping[str, float]) -> np.ndarray:
        rotational = np.where(self.model.dofs.direction >= 3, 1.0, 0.0)
        part = rotational[:, None] * self.basis.vectors
        return part.T @ (self.model.mass(si) @ part)

    # -- error indicator -----------------------------------------------------------------------------------------------

    def indicator(self, values: Mapping[str, float], modes: Modes) -> np.ndarray:
        """Estimated relative error ``|lambda_reduced - lambda|/|lambda|`` of each mode, (n_modes,).

        ``est = ||R||^2 / |lambda|`` with the full model's residual ``R = (lambda^2 M + lambda C + K) psi`` in the dual
        norm of the basis, psi scaled as in `Modes` (half of it for an undamped mode, which makes it the relative error
        of the frequency there too). A Galerkin eigenvalue is exact to first order in the error of its shape; the
        remaining error is ``R^T (lambda^2 M + lambda C + K)^+ R``, approximated here with the inverse of K at the
        reference values.

        It is an indicator, not a bound: it accounts neither for the distance to the next eigenvalue nor for a model
        softer than the reference, and it cannot detect a missed mode.

        Parameters
        ----------
        values : mapping
        modes : Modes
            Of this model at these values.
        """
        stiffness, damping, mass = self.full_matrices(values)
        shapes = self.lift(modes.shapes)
        size = 2 * np.pi * modes.natural_freq
        if modes.is_complex:
            lam = -modes.damping_ratio * size + 2j * np.pi * modes.damped_freq
            inertia, dissipation = real_times(mass, shapes), real_times(damping, shapes)
            residual = lam**2 * inertia + lam * dissipation + real_times(stiffness, shapes)
            parts = np.hstack([residual.real, residual.imag])
        else:
            parts = stiffness @ shapes - size**2 * (mass @ shapes)
        squares = np.einsum("ij,ij->j", parts, self.static_response(parts))
        if modes.is_complex:
            return (squares[: modes.n_modes] + squares[modes.n_modes :]) / size
        return 0.5 * squares / size**2

    def full_matrices(self, values: Mapping[str, float]) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """K, C, M of the full model at named values, (n_full, n_full) each.

        Those of the base model with the terms of effects that are not 0 there: a pattern of its own for every
        combination of effects would take as much memory as all matrices.
        """
        complete = self.space.complete(values)
        if self.inner is None:
            return self.model.matrices(complete)
        base = self.inner.full_matrices({name: complete[name] for name in self.inner.space.names})
        si, out = self.space.si(complete), []
        for matrix, kind in zip(base, ("stiffness", "damping", "mass"), strict=True):
            own, known = getattr(self.model, kind), getattr(self.inner.model, kind)
            if not own.continues(known):
                return self.model.matrices(complete)
            added = [(term.coefficient(si), term.matrix) for term in own.terms[len(known.terms) :]]
            parts = [padded(factor * each, self.model.n_dof) for factor, each in added if factor]
            out.append(sp.csc_array(sum(parts, padded(matrix.T, self.model.n_dof)).T))
        stiffness, damping, mass = out
        return stiffness, damping, mass

    def static_response(self, forces: np.ndarray) -> np.ndarray:
        """Motions of the full model under static forces (n_full, m) with the stiffness at the basis' reference values.

        With the offset of the basis where there are rigid-body motions; complex forces give complex motions. Degrees of
        freedom that effects add are apart there, where every magnitude is 0: the factor of the base model serves all.
        """
        own = self.model.n_dof if self.inner is None else self.inner.model.n_dof
        if self.inner is not None and self.factor is None:
            parts = [self.inner.static_response(forces[:own])]
        else:
            parts = [self._reference_factor.solve_by_parts(forces[:own])]
        if self.model.n_dof > own:
            parts.append(la.solve(self._stiffness_of_added, forces[own:], assume_a="sym"))
        return np.concatenate(parts)

    @cached_property
    def _reference_factor(self) -> SymmetricFactor:
        return self.factor or reference_factor(self.model, self.basis.reference_values, self.basis.offset)

    @cached_property
    def _stiffness_of_added(self) -> np.ndarray:
        """`reference_matrix` over the degrees of freedom that effects add, (n_added, n_added)."""
        assert self.inner is not None
        own, si = self.inner.model.n_dof, self.space.si(self.space.complete(self.basis.reference_values))
        out = np.zeros((self.model.n_dof - own,) * 2)
        for affine, factor in ((self.model.stiffness, 1.0), (self.model.mass, self.basis.offset)):
            for term in affine.terms if factor else ():
                if term.matrix.shape[0] > own:
                    out += factor * term.coefficient(si) * sp.csr_array(term.matrix)[own:][:, own:].toarray()
        return out


def reference_matrix(model: StructuralModel, values: Mapping[str, float], offset: float) -> sp.csc_array:
    """``K + offset M`` at named values without selected terms, (n_dof, n_dof): the inner product of a basis.

    Without the selected terms no position is preferred. With ``K^-1 b`` of all their vectors in the basis, a Galerkin
    residual is orthogonal to these, and its dual norm is the same with any of the terms present (Woodbury's identity).
    """
    si = model.space.si(model.space.complete(values))
    return sp.csc_array(model.stiffness.unselected(si) + offset * model.mass(si))


def reference_factor(model: StructuralModel, values: Mapping[str, float], offset: float) -> SymmetricFactor:
    """Factor of `reference_matrix`; EvaluationError when it is singular."""
    try:
        return symmetric_factor(reference_matrix(model, values, offset))
    except RuntimeError as fault:
        raise EvaluationError(f"the reference stiffness of {model.name} is singular ({fault})") from fault
