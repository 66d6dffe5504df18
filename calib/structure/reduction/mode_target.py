"""Modes that a reduced basis must represent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from calib.structure.model import StructuralModel
from calib.structure.reduction.certificate import mode_errors
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near, refined_modes, undamped_count_agrees

_NEAR = 1.15
"""Modes up to this multiple of the highest wanted frequency are included: they may be lower at other points."""
_REFINED = 0.01
"""Accuracy of refined modes, over the tolerance."""


@dataclass(frozen=True)
class ModeTarget:
    """Modes that must meet the tolerance; see `calib.structure.reduction.training.train_basis`.

    Attributes
    ----------
    count : int
        Number of the lowest modes.
    freq_max, damping_max : float
        Only modes below this natural frequency (Hz) and damping ratio must meet it.
    tolerance : float
        Largest relative error of an eigenvalue, and largest 1 - MAC.
    """

    count: int
    freq_max: float
    damping_max: float
    tolerance: float

    @property
    def request(self) -> str:
        """Empty: a basis records the attributes themselves."""
        return ""

    def forces(self, model: StructuralModel) -> np.ndarray:
        """None, (n_dof, 0): no force of its own needs a static response."""
        return np.zeros((model.n_dof, 0))

    def snapshots(
        self,
        model: StructuralModel,
        energy: sp.csc_array,
        values: Mapping[str, float],
        known: ReducedModel | None = None,
    ) -> np.ndarray:
        """Real columns that span the modes at named values, each mode of unit energy; see `Target.snapshots`."""
        if known is None:
            modes = model.modes(values, self.count)
        else:
            modes = modes_near(known, values, self.count, _REFINED * self.tolerance)
        shapes = modes.shapes[:, modes.natural_freq <= _NEAR * self.freq_max]
        size = np.einsum("ij,ij->j", shapes.conj(), energy @ shapes).real
        if not modes.is_complex:
            return np.asarray(shapes / np.sqrt(size))
        # Rotated to the phase that maximises the real part.
        turn = np.exp(-0.5j * np.angle(np.einsum("ij,ij->j", shapes, energy @ shapes)))
        shapes = shapes * (turn / np.sqrt(size))
        return np.hstack([shapes.real, shapes.imag])

    def posed(self, reduced: ReducedModel) -> ReducedModel:
        """The reduced model itself."""
        return reduced

    def missing(
        self, reduced: ReducedModel, energy: sp.csc_array, values: Mapping[str, float], unseen: bool = False
    ) -> np.ndarray:
        """What a reduced model lacks at named values: the modes there."""
        return self.snapshots(reduced.model, energy, values, None if unseen else reduced)

    def estimate(self, reduced: ReducedModel, values: Mapping[str, float]) -> float:
        """Largest error indicator of the modes that must meet the tolerance."""
        modes = reduced.modes(values, self.count)
        relevant = (modes.natural_freq <= self.freq_max) & (modes.damping_ratio < self.damping_max)
        return float(np.max(reduced.indicator(values, modes)[relevant], initial=0.0))

    def error(self, reduced: ReducedModel, values: Mapping[str, float], counted: bool = False) -> float:
        """Largest error of an eigenvalue or shape against the full model; infinite for a missed mode."""
        if counted and undamped_count_agrees(reduced, values, self.count):
            refined = refined_modes(reduced, values, self.count, _REFINED * self.tolerance)
            if refined is not None:
                found = mode_errors(reduced, values, self.count, refined).worst
                if found <= self.tolerance:
                    return found
        return mode_errors(reduced, values, self.count).worst
