"""What a comparison asks of a model: modes, their motion at sensors, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

import numpy as np

from calib.measurement.modal import Sensor
from calib.space import ParameterSpace
from calib.structure.derivatives import ModeDerivatives
from calib.structure.geometry import Mesh
from calib.structure.model import Assumption
from calib.structure.modes import Modes


class ModalModel(Protocol):
    """What a comparison asks of a model: modes over its own degrees of freedom and what follows from them.

    A finite-element model has many degrees of freedom and sparse matrices, a reduced one few and dense matrices, a
    function none but the motions of its sensors and no matrices at all; it is not for the asker to know which. Values
    are named, each in its parameter's unit; parameters left out take their adopted value. Shapes are (n_dof, n_modes),
    real or complex.
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
    def n_modes(self) -> int:
        """Modes that can be asked of it at most."""
        ...

    @property
    def clusters(self) -> Collection[str]:
        """Names of the groups of degrees of freedom whose strain energy is told apart; none without energies."""
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
    def dissipates(self) -> bool:
        """Whether its modes are damped at the adopted values, or would be with another parameter."""
        ...

    @property
    def roots(self) -> frozenset[str]:
        """Parameters by which nothing has a derivative where they are 0."""
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
        """Derivatives of some modes with respect to named parameters; whole-number parameters count as fixed.

        Parameters
        ----------
        values : mapping
            At which ``modes`` were solved.
        modes : Modes
        names : sequence of str
        which : sequence of int
            Indices of the modes wanted.
        rows : ndarray (n_rows, n_dof)
            Motions wanted of the shapes, such as the sensors'; without rows shapes are left out.
        at : callable, optional
            Gives the modes at other values, for a model whose derivatives are differences.
        """
        ...

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Shapes in the weight in which modes are told apart, (n_dof, n_modes): times the mass, where there is one."""
        ...

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Motion at the sensors over its degrees of freedom, (n_sensors, n_dof); InputError for one without a place."""
        ...

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Share of each mode's strain energy in each named cluster, (n_names, n_modes); 0 without strain energy."""
        ...

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Strain energy of each mode in the scale of its shape, (n_modes,); exactly 0 for a rigid-body motion.

        A model that knows none gives 1: every mode may then be paired.
        """
        ...

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of all nodes of the mesh, (n_nodes, 3, n_modes)."""
        ...
