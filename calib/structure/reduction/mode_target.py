"""Modes that a reduced basis must represent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.structure.eigenproblem.derivatives import beside_roots
from calib.structure.eigenproblem.mode_systems import eigenvalues
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.certificate import mode_errors
from calib.structure.reduction.growth import products
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near, real_columns, refined_modes, undamped_count_agrees

_NEAR = 1.15
"""Modes up to this multiple of the highest wanted frequency are included: they may be lower at other points."""
REFINED = 0.01
"""Accuracy of refined modes, over the tolerance."""
_DIRECTIONS = 2
"""Most directions in which parameters move modes, over the number of modes and parameters together."""
_KEPT = 2
"""The same before the motions by all parameters are known, over those in the end."""


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
    moved : tuple of (name, change)
        Parameters whose influence on the modes at a point counts as missing there too, each with the change that
        matters, in its own unit; none of a basis that is trained over limits, which has points all over.
    """

    count: int
    freq_max: float
    damping_max: float
    tolerance: float
    moved: tuple[tuple[str, float], ...] = ()

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
        return self.columns(self._solved(model, values, known), energy)

    def _solved(self, model: StructuralModel, values: Mapping[str, float], known: ReducedModel | None) -> Modes:
        """Modes of the full model, refined from a reduced one where it is known."""
        if known is None:
            return model.modes(values, self.count)
        return modes_near(known, values, self.count, REFINED * self.tolerance)

    def columns(self, modes: Modes, energy: sp.csc_array) -> np.ndarray:
        """Real columns that span modes, each mode of unit energy."""
        shapes = modes.shapes[:, modes.natural_freq <= _NEAR * self.freq_max]
        size = np.einsum("ij,ij->j", shapes.conj(), energy @ shapes).real
        if not modes.is_complex:
            return np.asarray(shapes / np.sqrt(size))
        # Rotated to the phase that maximises the real part.
        turn = np.exp(-0.5j * np.angle(np.einsum("ij,ij->j", shapes, energy @ shapes)))
        return real_columns(shapes * (turn / np.sqrt(size)))

    def directions(
        self,
        model: StructuralModel,
        energy: sp.csc_array,
        values: Mapping[str, float],
        modes: Modes,
        static: Callable[[np.ndarray], np.ndarray],
    ) -> np.ndarray:
        """Principal directions (n_dof, m) in which the parameters of `moved` move modes at named values.

        The derivative of a shape is sought among the other modes and the static responses to the forces
        ``(lambda^2 dM + lambda dC + dK) phi`` that the parameters exert on the modes: their part in higher modes is
        nearly static.

        Parameters
        ----------
        model : StructuralModel
        energy : csc_array (n_dof, n_dof)
            Inner product of the basis.
        values : mapping
            The point.
        modes : Modes
            Solved there.
        static : callable
            Static responses (n_dof, n_forces) to real forces of that shape.
        """
        names = [name for name, _ in self.moved]
        point = beside_roots(model.space, model.roots, values, names)
        kept = modes.subset(np.flatnonzero(modes.natural_freq <= _NEAR * self.freq_max))
        lam, shapes = eigenvalues(kept), kept.shapes
        size = np.sqrt(np.einsum("ij,ij->j", shapes.conj(), energy @ shapes).real)
        most = _DIRECTIONS * (kept.n_modes + len(names))
        moves = [np.zeros((model.n_dof, 0))]
        for name, change in self.moved:
            dk, dc, dm = model.matrix_derivatives(point, name)
            force = dk @ shapes + (lam**2).real * (dm @ shapes)
            if kept.is_complex:
                force = force + lam * (dc @ shapes) + 1j * (lam**2).imag * (dm @ shapes)
            moves.append(static(real_columns(force * (change / size))))
            if sum(part.shape[1] for part in moves) > 2 * _KEPT * most:  # not all are in memory together
                moves = [self._principal(energy, np.hstack(moves), _KEPT * most)]
        return self._principal(energy, np.hstack(moves), most)

    def _principal(self, energy: sp.csc_array, moves: np.ndarray, most: int) -> np.ndarray:
        """Principal directions of motions (n_dof, m), at most so many, scaled by how far these go along them."""
        if not moves.shape[1]:
            return moves
        energies, turn = la.eigh(products(energy, moves))
        first = max(len(energies) - most, int(np.count_nonzero(energies < self.tolerance)))
        return np.asarray(moves @ turn[:, first:])

    def posed(self, reduced: ReducedModel) -> ReducedModel:
        """The reduced model itself."""
        return reduced

    def missing(
        self, reduced: ReducedModel, energy: sp.csc_array, values: Mapping[str, float], unseen: bool = False
    ) -> np.ndarray:
        """What a reduced model lacks at named values: the modes there, and how parameters move them."""
        modes = self._solved(reduced.model, values, None if unseen or self.moved else reduced)
        found = self.columns(modes, energy)
        if not self.moved:
            return found
        return np.hstack([found, self.directions(reduced.model, energy, values, modes, reduced.static_response)])

    def estimate(self, reduced: ReducedModel, values: Mapping[str, float]) -> float:
        """Largest error indicator of the modes that must meet the tolerance."""
        modes = reduced.modes(values, self.count)
        relevant = (modes.natural_freq <= self.freq_max) & (modes.damping_ratio < self.damping_max)
        return float(np.max(reduced.indicator(values, modes)[relevant], initial=0.0))

    def error(self, reduced: ReducedModel, values: Mapping[str, float], counted: bool = False) -> float:
        """Largest error of an eigenvalue or shape against the full model; infinite for a missed mode."""
        if counted and undamped_count_agrees(reduced, values, self.count):
            refined = refined_modes(reduced, values, self.count, REFINED * self.tolerance)
            if refined is not None:
                found = mode_errors(reduced, values, self.count, refined).worst
                if found <= self.tolerance:
                    return found
        return mode_errors(reduced, values, self.count).worst
