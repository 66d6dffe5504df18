"""Protocol of a model with modes: solution, sensor rows, derivatives, strain energies."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

import numpy as np

from calib.measurement.modal import Sensor
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.derivatives import ModeDerivatives
from calib.structure.geometry import Mesh
from calib.structure.model import Assumption, StructuralModel
from calib.structure.modes import Modes
from calib.structure.places import ModelPlace


class ModalModel(Protocol):
    """A model with modes over its own degrees of freedom, as a comparison needs it.

    A finite-element model has many degrees of freedom and sparse matrices, a reduced one few and dense matrices, a
    function only the motions of its sensors and no matrices; callers need not know which. Values are named, each in its
    parameter's unit; missing parameters take their nominal value. Shapes are (n_dof, n_modes), real or complex.
    """

    @property
    def name(self) -> str:
        """Name of the model in messages."""
        ...

    @property
    def space(self) -> ParameterSpace:
        """Parameters with nominal values and limits."""
        ...

    @property
    def n_modes(self) -> int:
        """Largest number of modes it can return."""
        ...

    @property
    def clusters(self) -> Collection[str]:
        """Names of the groups of degrees of freedom with their own strain energy; empty without energies."""
        ...

    @property
    def mesh(self) -> Mesh:
        """Nodes, lines and faces, for figures."""
        ...

    @property
    def places(self) -> tuple[ModelPlace, ...]:
        """Where springs, dampers, masses, supports and what parameters scale are, for figures."""
        ...

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """Numbers of the model that are engineering assumptions."""
        ...

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever a result could."""
        ...

    @property
    def dissipates(self) -> bool:
        """Whether its modes are damped at the nominal or other parameter values."""
        ...

    @property
    def roots(self) -> frozenset[str]:
        """Parameters whose derivatives do not exist at 0."""
        ...

    @property
    def reducible(self) -> StructuralModel | None:
        """The model itself where it has matrices that a basis can reduce; None for a function and a reduced model."""
        ...

    @property
    def numbers_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]] | None:
        """The user's function of the numbers of modes; None for a model of matrices, which runs no user code."""
        ...

    def with_function(self, numbers: Callable[[Mapping[str, float]], Mapping[str, float]]) -> ModalModel:
        """The model with another such function; a model of matrices has none and stays as it is."""
        ...

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest vibration modes; EvaluationError when the point cannot be solved."""
        ...

    def derivatives(
        self,
        values: Mapping[str, float],
        modes: Modes,
        names: Sequence[str],
        which: Sequence[int] | np.ndarray,
        rows: np.ndarray,
        at: Callable[[Mapping[str, float]], Modes] | None = None,
    ) -> ModeDerivatives:
        """Derivatives of some modes with respect to named parameters; integer parameters count as fixed.

        Parameters
        ----------
        values : mapping
            At which ``modes`` were solved.
        modes : Modes
        names : sequence of str
        which : sequence of int
            Indices of the modes wanted.
        rows : ndarray (n_rows, n_dof)
            Output rows for the shapes, such as the sensors'; without rows shapes are skipped.
        at : callable, optional
            Returns the modes at other values, for a model whose derivatives are differences.
        """
        ...

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray | None:
        """Shapes times the mass matrix, (n_dof, n_modes), the weight of their orthogonality; None without one."""
        ...

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over its degrees of freedom, (n_sensors, n_dof); InputError for one off the model."""
        ...

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Share of each mode's strain energy in each named cluster, (n_names, n_modes); 0 without strain energy."""
        ...

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Strain energy of each mode in the scale of its shape, (n_modes,); exactly 0 for a rigid-body motion.

        A model without strain energy returns 1: every mode may then be paired.
        """
        ...

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of all nodes of the mesh, (n_nodes, 3, n_modes)."""
        ...
