"""Modes of a model as faulty channels and a faulty analysis give them, with the derivatives of what is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.faults import ModalFault, Readings
from calib.correlation.modal.problem import ModalProblem
from calib.measurement.mac import is_real
from calib.structure.eigenproblem.derivatives import ModeDerivatives
from calib.structure.modes import Modes


@dataclass(frozen=True, eq=False)
class FaultyModes:
    """What a test with faults reads of the modes of a model; without any at nonzero magnitude the modes themselves.

    Attributes
    ----------
    problem : ModalProblem
    faults : tuple of ModalFault
    readings : Readings
    """

    problem: ModalProblem
    faults: tuple[ModalFault, ...]
    readings: Readings = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "readings", Readings(self.faults, 2 * np.pi * self.problem.measured.natural_freq))

    def without(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values without the magnitudes of faults."""
        names = self.readings.names
        return {name: value for name, value in values.items() if name not in names}

    @cached_property
    def _sources(self) -> sp.csr_array:
        """Motions of which faulty channels read a share, over the degrees of freedom, (n_sources, n_dof)."""
        return sp.csr_array(self.problem.model.sensor_rows(self.readings.sources))

    def compared(self, values: Mapping[str, float], solved: Modes | None = None) -> Comparison:
        """Comparison at named values, magnitudes included: modes are paired by what the sensors read.

        Modes already ``solved`` there are reused. EvaluationError when the model cannot be solved there.
        """
        at, problem, readings = self.readings.active(values), self.problem, self.readings
        found = problem.compare(self.without(values), solved)
        if not at:
            return found
        if not problem.measured.has_shapes or not readings.reach_shapes(at):
            return replace(found, faults=at)
        motions, omega = self.motions(found), 2 * np.pi * found.modes.natural_freq
        read = np.column_stack(
            [readings.shape(at, w, v, m) for w, v, m in zip(omega, found.sensor_shapes.T, motions.T, strict=True)]
        )
        shares = problem.energy_shares(found.values, found.modes)
        pairing, mac, emac = problem.pair(problem.measured.shapes, read, shares, found.modes)
        return replace(found, faults=at, pairing=pairing, mac=mac, emac=emac)

    def rows(self, found: Comparison) -> np.ndarray:
        """Output rows whose derivatives `reading_slope` needs, (n_sensors, n_dof), below them those of the sources."""
        rows = self.problem.sensor_rows
        return np.vstack([rows, self._sources.toarray()]) if found.faults else rows

    def added_damping(self, found: Comparison) -> np.ndarray | float:
        """Damping ratios that the analysis adds, (n_measured,)."""
        return self.readings.added_damping(found.faults) if found.faults else 0.0

    def reading(self, found: Comparison, i: int, j: int) -> np.ndarray:
        """What the sensors read of model mode j as measured mode i, (n_sensors,)."""
        shape = found.sensor_shapes[:, j]
        if not found.faults:
            return shape
        omega = self.readings.omega[i]
        return self.readings.shape(found.faults, omega, shape, self._sources @ found.modes.shapes[:, j])

    def reading_slope(self, found: Comparison, i: int, k: int, slopes: ModeDerivatives) -> np.ndarray:
        """Derivatives of the reading of measured mode i, the k-th paired one, (n_sensors, n_params)."""
        change = slopes.shapes[:, :, k].T
        if not found.faults:
            return change
        n = len(self.problem.measured.sensors)
        return self.readings.shape(found.faults, self.readings.omega[i], change[:n], change[n:])

    def motions(self, found: Comparison) -> np.ndarray:
        """Motions of the sources in every model mode, (n_sources, n_modes)."""
        return np.asarray(self._sources @ found.modes.shapes)

    def mixtures(self, found: Comparison, i: int) -> np.ndarray | float:
        """What the shape of measured mode i holds of other measured modes, (n_sensors,)."""
        own = [
            (name, by) for name, by in found.faults.items() if self.readings.mixed(name)[:1] == self._names[i : i + 1]
        ]
        return sum(by * self.mixture(name) for name, by in own) if own else 0.0

    def mixture(self, name: str) -> np.ndarray:
        """What a share of 1 of another mode adds to a measured shape, (n_sensors,).

        The shape of the other mode, as large as the measured one over the sensors that measured both, in the phase in
        which that is most real, or in quadrature.
        """
        mode, of, way = self.readings.mixed(name)
        i, j = self._names.index(mode), self._names.index(of)
        own, other = self.problem.measured.shapes[:, i], self.problem.measured.shapes[:, j]
        both = np.isfinite(own) & np.isfinite(other)
        half = [np.exp(-0.5j * np.angle(np.sum(shape[both] ** 2))) for shape in (own, other)]
        size = np.linalg.norm(own[both]) / max(float(np.linalg.norm(other[both])), 1e-300)
        turned = other * half[1]
        if is_real(own[:, None])[0]:
            turned = turned.real
        turned = turned * (1j if way else 1.0)
        return np.where(both, np.nan_to_num(turned) * size / half[0], 0.0)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return self.problem.measured.names
