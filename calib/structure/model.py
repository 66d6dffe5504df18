"""The structural model: named parameters in, affine matrices, modes and sensor motions out."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.space import ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial
from calib.structure.energy import strain_energy, strain_energy_shares
from calib.structure.modes import Modes
from calib.structure.reduced_matrix import ReducedSlope
from calib.structure.solve import solve_modes


@dataclass(frozen=True)
class Mesh:
    """Nodes, lines and faces of a model, for pictures and for finding places.

    Attributes
    ----------
    points : ndarray (n_nodes, 3)
        Coordinates in metres.
    lines : ndarray (n_lines, 2), int
        Node indices of each line element and of each edge of a face.
    groups : tuple of str
        Group name of each line; an edge has that of a face.
    faces : ndarray (n_faces, 4), int
        Node indices of each shell element, in turn.
    face_groups : tuple of str
        Group name of each face.
    """

    points: np.ndarray
    lines: np.ndarray
    groups: tuple[str, ...]
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), dtype=int))
    face_groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class DofMap:
    """How nodal motions follow from the free degrees of freedom.

    Attributes
    ----------
    expansion : csr_array (6 * n_nodes, n_dof)
        Nodal motions (ux, uy, uz, rx, ry, rz of every node) over the free degrees of freedom; suppressed motions are
        empty rows, shared and rigidly linked ones have several entries.
    node, direction : ndarray (n_dof,), int
        Node index and direction index (0..5) that name each free degree of freedom.
    """

    expansion: sp.csr_array
    node: np.ndarray
    direction: np.ndarray

    @property
    def n_dof(self) -> int:
        """Number of free degrees of freedom."""
        return self.expansion.shape[1]


@dataclass(frozen=True)
class Assumption:
    """One number of a model that is an engineering assumption and not published."""

    item: str
    value: str
    unit: str
    reason: str


PartKind = Literal["stiffness", "damping", "mass"]


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a model that may be off by itself: the stiffness or mass of an element group, a spring, a damper.

    Attributes
    ----------
    name : str
        Where it is, such as ``crossbar front``.
    kind : {"stiffness", "damping", "mass"}
    matrix : csr_array (n_dof, n_dof)
        Its share of K, C or M over the coefficient.
    coefficient : Monomial
    place : (3,) float
        Its middle, m, for maps.
    """

    name: str
    kind: PartKind
    matrix: sp.csr_array
    coefficient: Monomial
    place: tuple[float, float, float]


Matrix = sp.csc_array | np.ndarray
"""A square matrix of a model, sparse or dense."""

MatrixSlope = sp.csc_array | np.ndarray | ReducedSlope
"""A derivative of one: it multiplies shapes, and ``abs`` tells the sizes of its entries."""


class Locator(Protocol):
    """Finds points of the geometry on a model."""

    def row(self, point: Sequence[float], direction: int, on: str | None = None) -> tuple[np.ndarray, float]:
        """Motion of a point over the free degrees of freedom.

        Parameters
        ----------
        point : (3,) coordinates in metres
        direction : int
            0..5 for ux, uy, uz, rx, ry, rz.
        on : str, optional
            Name of the part that carries the point; without it the nearest part.

        Returns
        -------
        row : ndarray (n_dof,)
        distance : float
            From the point to the part, in metres.
        """
        ...


class ModalModel(Protocol):
    """What a comparison asks of a model: modes over its own degrees of freedom and what follows from them.

    A finite-element model has many degrees of freedom and sparse matrices, a reduced one few and dense matrices; it is
    not for the asker to know which. Values are named, each in its parameter's unit; parameters left out take their
    adopted value. Shapes are (n_dof, n_modes), real or complex.
    """

    @property
    def name(self) -> str:
        """How messages call the model."""
        ...

    @property
    def space(self) -> ParameterSpace:
        """Parameters with adopted values and limits."""
        ...

    @property
    def n_dof(self) -> int:
        """Number of its degrees of freedom."""
        ...

    @property
    def clusters(self) -> Collection[str]:
        """Names of the groups of degrees of freedom whose strain energy is told apart."""
        ...

    @property
    def mesh(self) -> Mesh:
        """Nodes, lines and faces, for pictures."""
        ...

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """Numbers of the model that are engineering assumptions."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever an evaluation could."""
        ...

    @property
    def is_damped(self) -> bool:
        """Whether modes are complex."""
        ...

    @property
    def roots(self) -> frozenset[str]:
        """Parameters whose matrices have no derivative where they are 0."""
        ...

    def matrices(self, values: Mapping[str, float]) -> tuple[Matrix, Matrix, Matrix]:
        """K, C, M, each (n_dof, n_dof), sparse or dense."""
        ...

    def matrix_derivatives(
        self, values: Mapping[str, float], name: str
    ) -> tuple[MatrixSlope, MatrixSlope, MatrixSlope]:
        """dK, dC, dM with respect to one parameter, per one of its own unit; whole-number parameters count as fixed."""
        ...

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest vibration modes; EvaluationError when the point cannot be solved."""
        ...

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over its degrees of freedom, (n_sensors, n_dof); InputError for one without a place."""
        ...

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Share of each mode's strain energy in each named cluster, (n_names, n_modes); 0 without strain energy."""
        ...

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Strain energy of each mode in the scale of its shape, (n_modes,); exactly 0 for a rigid-body motion."""
        ...

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of all nodes, (n_nodes, 3, n_modes)."""
        ...


@dataclass(frozen=True)
class StructuralModel:
    """A finite-element model that is affine in functions of named parameters.

    Attributes
    ----------
    name : str
    space : ParameterSpace
        Parameters with adopted values and limits.
    stiffness, damping, mass : AffineMatrix
        K, C, M; damping without terms means an undamped model.
    mesh : Mesh
    dofs : DofMap
    clusters : mapping from str to ndarray of int
        Named groups of free degrees of freedom (substructure and direction, such as ``girder.y``) whose strain energy
        is told apart.
    locator : Locator
    assumptions : tuple of Assumption
    sensor_tolerance : float
        Largest distance in metres between a sensor and the part that carries it.
    parts : tuple of Part
        What the matrices are made of; a search for what is missing looks at each. No answer depends on them.
    """

    name: str
    space: ParameterSpace
    stiffness: AffineMatrix
    damping: AffineMatrix
    mass: AffineMatrix
    mesh: Mesh
    dofs: DofMap
    clusters: Mapping[str, np.ndarray]
    locator: Locator
    assumptions: tuple[Assumption, ...] = ()
    sensor_tolerance: float = 0.25
    parts: tuple[Part, ...] = ()

    @property
    def n_dof(self) -> int:
        """Number of free degrees of freedom."""
        return self.dofs.n_dof

    @property
    def is_damped(self) -> bool:
        """Whether the model has damping, so that its modes are complex."""
        return not self.damping.is_zero

    @property
    def fingerprint(self) -> str:
        """Hash over matrices and their coefficients; changes whenever an evaluation could."""
        digest = hashlib.sha256()
        for matrix in (self.stiffness, self.damping, self.mass):
            digest.update(matrix.digest())
        for name in sorted(self.clusters):
            digest.update(name.encode() + np.ascontiguousarray(self.clusters[name], dtype=np.int64).tobytes())
        return digest.hexdigest()[:16]

    @property
    def roots(self) -> frozenset[str]:
        """Parameters whose matrices have no derivative where they are 0."""
        return self.stiffness.roots | self.damping.roots | self.mass.roots

    def matrices(self, values: Mapping[str, float]) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """K, C, M at named values, each in its parameter's unit; parameters left out take their adopted value."""
        si = self.space.si(self.space.complete(values))
        return self.stiffness(si), self.damping(si), self.mass(si)

    def matrix_derivatives(
        self, values: Mapping[str, float], name: str
    ) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """dK, dC, dM with respect to one parameter, per one of its own unit; whole-number parameters count as fixed."""
        si = self.space.si(self.space.complete(values))
        factor = self.space[name].si_factor
        stiffness, damping, mass = (m.derivative(si, name) * factor for m in (self.stiffness, self.damping, self.mass))
        return stiffness, damping, mass

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest vibration modes at named values.

        Raises EvaluationError when the point cannot be solved.
        """
        k, c, m = self.matrices(values)
        return solve_modes(k, c if self.is_damped else None, m, count, rotational=self.dofs.direction >= 3)

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over the free degrees of freedom, shape (n_sensors, n_dof).

        Raises InputError for a sensor without a place, off the model, or on a motion that the model suppresses.
        """
        rows = np.zeros((len(sensors), self.n_dof))
        for i, sensor in enumerate(sensors):
            place = f"sensor {sensor.name}"
            if sensor.point is None:
                raise InputError(
                    "no place is known for it", place=place, remedy="add its node to the study's sensor table"
                )
            row, distance = self.locator.row(sensor.point, DIRECTIONS.index(sensor.direction), sensor.on)
            if distance > self.sensor_tolerance:
                raise InputError(
                    f"it lies {distance:.3f} m off the model {self.name}"
                    + (f" (part {sensor.on!r})" if sensor.on else ""),
                    place=place,
                    remedy=f"correct its coordinates or its part (largest distance {self.sensor_tolerance:g} m)",
                )
            if not np.abs(row).max(initial=0.0) > 1e-9:  # an inclined member leaves rounding where it suppresses
                raise InputError(
                    "the model suppresses this motion, so it can never agree",
                    place=place,
                    remedy="take it out of the measured shapes",
                )
            rows[i] = row
        return rows

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Share of each mode's strain energy in each named cluster, (n_names, n_modes); see `strain_energy_shares`."""
        named = {name: self.clusters[name] for name in names}
        si = self.space.si(self.space.complete(values))
        return strain_energy_shares(self.stiffness(si), shapes, named)[0]

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Strain energy ``phi^H K phi / 2`` of each mode in the scale of its shape, (n_modes,)."""
        si = self.space.si(self.space.complete(values))
        return strain_energy(self.stiffness(si), shapes)

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of all nodes, shape (n_nodes, 3, n_modes), from shapes (n_dof, n_modes)."""
        full = self.dofs.expansion @ shapes
        return full.reshape(len(self.mesh.points), 6, -1)[:, :3, :]
