"""Structural model: affine matrices, modes and sensor motions as functions of named parameters."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.space import Parameter, ParameterSpace
from calib.results.in_short import Short
from calib.structure.affine import AffineMatrix, Monomial
from calib.structure.dof_table import Dofs, DofTable, Layers, two_columns
from calib.structure.eigenproblem.derivatives import Analytic
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.energy import strain_energy, strain_energy_shares
from calib.structure.geometry import DofMap, Locator, Mesh, NodeLocator
from calib.structure.located import sensor_row, sensor_rows
from calib.structure.matrices import Terms, affine, require_mass, require_used
from calib.structure.modes import Modes
from calib.structure.null_space import without_null
from calib.structure.pattern import narrow
from calib.structure.places import ModelPlace, model_places
from calib.structure.unit_system import unit_system


@dataclass(frozen=True)
class Assumption:
    """One number of a model that is an engineering assumption, not published data."""

    item: str
    value: str
    unit: str
    reason: str


_REMEMBERED, _BYTES = 4, 200_000_000
"""Latest solutions that a model keeps, and how many bytes their shapes may take; it keeps at least one."""

PartKind = Literal["stiffness", "damping", "mass"]


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a model that may be wrong by itself: stiffness or mass of an element group, a spring, a damper.

    Attributes
    ----------
    name : str
        Location, such as ``crossbar front``.
    kind : {"stiffness", "damping", "mass"}
    matrix : csr_array (n_dof, n_dof)
        Its contribution to K, C or M, divided by the coefficient.
    coefficient : Monomial
    place : (3,) float
        Its midpoint, m, for maps.
    """

    name: str
    kind: PartKind
    matrix: sp.csr_array
    coefficient: Monomial
    place: tuple[float, float, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", narrow(self.matrix))


@dataclass(frozen=True)
class StructuralModel(Analytic, Short):
    """A finite-element model that is affine in functions of named parameters.

    Attributes
    ----------
    name : str
    space : ParameterSpace
        Parameters with nominal values and limits.
    stiffness, damping, mass : AffineMatrix
        K, C, M; damping without terms means an undamped model.
    mesh : Mesh
    dofs : DofMap
    clusters : mapping from str to ndarray of int
        Named groups of free degrees of freedom (substructure and direction, such as ``girder.y``) with separate strain
        energies.
    locator : Locator
    assumptions : tuple of Assumption
    sensor_tolerance : float, optional
        Largest distance in metres between a sensor and the part that carries it; by default from the size of the model
        and the spacing of its nodes, see `calib.measurement.partners.node_partners`.
    parts : tuple of Part
        Contributions to the matrices, each a candidate for a local perturbation. The modes do not depend on them.
    labels : tuple of int
        Node labels that the model shares with the measurement, length n_nodes; empty where sensors are located by their
        coordinates alone.

    Examples
    --------
    A mass of 10 kg on a spring; matrices of a finite-element code enter in the same way:

    >>> import numpy as np
    >>> import calib
    >>> spring = calib.Parameter("k", 30.0, 10.0, 90.0, "kN/m")
    >>> one = np.eye(1)
    >>> model = calib.StructuralModel.from_matrices({"k": one}, 10.0 * one, dofs=[(1, "x")], parameters=[spring])
    >>> model.modes({"k": 40.0}, 1).natural_freq.round(3)
    array([10.066])
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
    sensor_tolerance: float | None = None
    parts: tuple[Part, ...] = ()
    labels: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.name}: matrices of {self.n_dof} degrees of freedom, {len(self.space.parameters)} parameters"

    @staticmethod
    def from_matrices(
        stiffness: Terms,
        mass: Terms,
        damping: Terms | None = None,
        *,
        dofs: Dofs,
        parameters: ParameterSpace | Iterable[Parameter] = (),
        lines: Iterable[tuple[int, int]] = (),
        sets: Mapping[str, Iterable[int]] | None = None,
        name: str = "matrices",
        units: str = "m-kg-N",
        layers: Layers | None = None,
    ) -> StructuralModel:
        """A model from matrices assembled by another code.

        Each matrix is one (n_dof, n_dof) array, dense or sparse, or a mapping of named ones that add up. A matrix named
        like a parameter is multiplied by it; ``(matrix, "parameter")`` and ``(matrix, {"parameter": power, ...})`` set
        the multiplier explicitly. Values are those of the parameters in ``units``: for one in kN/m those in N/m in SI,
        in N/mm in ``"mm-t-N"``. Of a symmetric matrix one triangle is enough. Mass may be singular and the structure
        free. Rows, and motions of several rows, that have neither stiffness nor mass are fixed, and told among the
        `assumptions`; frequencies do not depend on them.

        Parameters
        ----------
        stiffness, mass : Terms
        damping : Terms, optional
            Viscous; without it modes are real.
        dofs : DataFrame or iterable of (node, direction)
            Node and direction of each row of the matrices: columns ``node, direction`` and, for figures and for sensors
            located by coordinates, ``x, y, z`` in m, or in the unit of length of ``units``. Directions are x, y, z, rx,
            ry, rz, or 1 to 6; numbers may be doubles, and one number may name both, as 11.3 or 11.03 for direction 3 of
            node 11. A list of tables, one of each run that a term was made from, must agree row by row.
        parameters : iterable of Parameter, or ParameterSpace
        lines : iterable of (node, node)
            Drawn between nodes.
        sets : mapping from str to iterable of nodes, optional
            Such as those of element sets. Each is a cluster of degrees of freedom, whose share of a mode's strain
            energy is told, and the colour of the lines between its nodes that no set before it has.
        name : str
        units : {"m-kg-N", "mm-t-N", "mm-kg-mN", "in-lbf", "in-kip", "ft-lbf"}
            Unit system of matrices and coordinates, with s and rad; parameters keep their own units.
        layers : {"mean"}, optional
            Several rows of one name are layers of a shell that the code expands to a solid, as CalculiX does: the node
            moves as the mean of its outer layers, the first and the last of these rows.

        Raises
        ------
        InputError
            When sizes do not match, an entry is not finite, a matrix is not symmetric, a row is named twice, a mass is
            negative, a parameter scales nothing, or the rows of two runs differ.

        Examples
        --------
        Two masses on springs in a row; the second spring is a parameter.

        >>> import numpy as np
        >>> from calib.problem.space import Parameter
        >>> from calib.structure.model import StructuralModel
        >>> ground, between = np.diag([1.0, 0.0]), np.array([[1.0, -1.0], [-1.0, 1.0]])
        >>> model = StructuralModel.from_matrices(
        ...     stiffness={"ground": 2e4 * ground, "k": between},
        ...     mass=np.diag([1.0, 2.0]),
        ...     dofs=[(1, "x"), (2, "x")],
        ...     parameters=[Parameter("k", 1e4, 5e3, 2e4, "N/m")],
        ... )
        >>> model.modes({"k": 8e3}, 2).natural_freq.round(2)
        array([ 8.32, 27.23])
        """
        system = unit_system(units, f"model {name}, units")
        table = DofTable.of(dofs, name, layers).scaled(system.length)
        space = parameters if isinstance(parameters, ParameterSpace) else ParameterSpace(parameters)  # type: ignore[arg-type]
        viscous: Terms = {} if damping is None else damping
        given: Mapping[str, Terms] = {"stiffness": stiffness, "damping": viscous, "mass": mass}
        read = {kind: affine(kind, terms, space, table, name, system) for kind, terms in given.items()}
        matrices = {kind: matrix for kind, (matrix, _) in read.items()}
        require_used(space, list(matrices.values()), name)
        require_mass(matrices["mass"](space.si(space.values)), table, name)
        matrices, table, dropped = without_null(matrices, space.si(space.values), table, name)
        place = {label: k for k, label in enumerate(table.labels)}
        segments = two_columns(lines, f"model {name}, lines", "(node, node)")
        ends = [[_index(node, place, "a line ends at", f"model {name}, lines") for node in line] for line in segments]
        expansion = table.expansion
        clusters = {d: np.flatnonzero(table.direction == k) for k, d in enumerate(DIRECTIONS) if k in table.direction}
        groups = ["lines"] * len(ends)
        for own, nodes in (sets or {}).items():
            inside = np.array(
                sorted({_index(node, place, f"{own!r} has", f"model {name}, sets") for node in nodes}), dtype=int
            )
            if own in clusters:
                raise InputError(f"a set is called {own!r}, as a direction is", place=f"model {name}, sets",
                                 remedy="rename it")  # fmt: skip
            clusters[own] = np.flatnonzero(np.isin(table.node, inside))
            groups = [own if old == "lines" and np.isin(line, inside).all() else old
                      for line, old in zip(ends, groups, strict=True)]  # fmt: skip
        return StructuralModel(
            name=name,
            space=space,
            mesh=Mesh(table.points, np.array(ends, dtype=int).reshape(-1, 2), tuple(groups)),
            dofs=DofMap(expansion, table.node, table.direction),
            clusters=clusters,
            locator=NodeLocator(table.points, expansion),
            assumptions=tuple(
                Assumption(f"{kind} {key!r}", "symmetric", "-", "one triangle was given and has been mirrored")
                for kind, (_, completed) in read.items()
                for key in completed
            )
            + tuple(Assumption(item, value, "-", reason) for item, value, reason in dropped),
            labels=table.labels,
            stiffness=matrices["stiffness"],
            damping=matrices["damping"],
            mass=matrices["mass"],
        )

    @property
    def n_dof(self) -> int:
        """Number of free degrees of freedom."""
        return self.dofs.n_dof

    @property
    def reducible(self) -> StructuralModel:
        """The model itself, which a basis can reduce."""
        return self

    @property
    def whole(self) -> StructuralModel:
        """The model itself, at full order."""
        return self

    @property
    def n_modes(self) -> int:
        """Largest number of modes: one for each degree of freedom."""
        return self.n_dof

    @property
    def is_damped(self) -> bool:
        """Whether the model has damping, so that its modes are complex."""
        return not self.damping.is_zero

    @property
    def places(self) -> tuple[ModelPlace, ...]:
        """Where its springs, dampers, masses, supports and parameters are; see `model_places`."""
        return model_places(self)

    @cached_property
    def fingerprint(self) -> str:
        """Hash over matrices and their coefficients; changes whenever a result could."""
        digest = hashlib.sha256()
        for matrix in (self.stiffness, self.damping, self.mass):
            digest.update(matrix.digest())
        for name in sorted(self.clusters):
            digest.update(name.encode() + np.ascontiguousarray(self.clusters[name], dtype=np.int64).tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def additions(self) -> dict[int, tuple[Any, Any]]:
        """Effects built so far, by identity, with what each adds; see `calib.structure.effects.extend.addition_of`."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        # An effect may hold a function that cannot be pickled; it is built again where it is needed.
        return {name: value for name, value in self.__dict__.items() if name not in ("additions", "_latest")}

    @property
    def roots(self) -> frozenset[str]:
        """Parameters whose matrices have no derivative at 0."""
        return self.stiffness.roots | self.damping.roots | self.mass.roots

    def matrices(self, values: Mapping[str, float]) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """K, C, M at named values, each in its parameter's unit; missing parameters take their nominal value."""
        si = self.space.si(self.space.complete(values))
        return self.stiffness(si), self.damping(si), self.mass(si)

    def matrix_derivatives(
        self, values: Mapping[str, float], name: str
    ) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """dK, dC, dM with respect to one parameter in its own unit; integer parameters count as fixed."""
        si = self.space.si(self.space.complete(values))
        factor = self.space[name].si_factor
        slopes = (m.derivative(si, name) for m in (self.stiffness, self.damping, self.mass))
        stiffness, damping, mass = (slope * factor if slope.nnz and factor != 1 else slope for slope in slopes)
        return stiffness, damping, mass

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Shapes times the mass matrix, (n_dof, n_modes), the weight of their orthogonality."""
        return np.asarray(self.mass(self.space.si(self.space.complete(values))) @ shapes)

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest vibration modes at named values.

        Raises EvaluationError when the point cannot be solved.
        """
        complete = self.space.complete(values)
        key, known = (count, tuple(sorted(complete.items()))), self._latest
        latest = known.get(key)
        if latest is None:
            k, c, m = self.matrices(complete)
            latest = solve_modes(k, c if self.is_damped else None, m, count, rotational=self.dofs.direction >= 3)
            room = max(1, min(_REMEMBERED, _BYTES // max(latest.shapes.nbytes, 1)))
            for older in list(known)[::-1][room - 1 :]:
                known.pop(older, None)  # another thread may have dropped it
            known[key] = latest
        own = ("natural_freq", "damped_freq", "damping_ratio", "shapes")
        return replace(latest, **{name: getattr(latest, name).copy() for name in own})  # the caller may change them

    @cached_property
    def _latest(self) -> dict[tuple[int, tuple[tuple[str, float], ...]], Modes]:
        """The latest solutions: several steps of an analysis ask for the nominal and for the fitted values."""
        return {}

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over the free degrees of freedom, (n_sensors, n_dof); see `calib.structure.located`."""
        return sensor_rows(self, sensors)

    def translations(self, sensor: Sensor) -> np.ndarray:
        """Motions in x, y and z at the place of a sensor, (3, n_dof), zero where the model suppresses them.

        Raises like `sensor_rows`.
        """
        self.sensor_rows([sensor])
        return np.array([sensor_row(self, replace(sensor, direction=d))[0] for d in DIRECTIONS[:3]])

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


def _index(node: int, place: Mapping[int, int], words: str, where: str) -> int:
    if node not in place:
        raise InputError(f"{words} node {node}, which no row names", place=where, remedy="correct the label")
    return place[node]
