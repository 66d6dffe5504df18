"""FRFs that a reduced basis must represent, and the error of reduced FRFs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from calib.measurement.frf import Quantity
from calib.problem.effect import Effect
from calib.results.fingerprint import digest_of
from calib.structure.effects.loaded import Load, with_loads
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.frf import frf, frf_solutions, motion_factor
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.reduced import ReducedModel

TOLERANCE = 0.05
"""Largest error of an FRF in standard deviations: a shift of this size at every line raises chi-square by 0.25 % of its
expectation."""
_BEYOND = 1.5
"""Undamped modes up to this multiple of the highest line are included: with them, the inertia of what is missing lowers
its dynamic stiffness by at most 1/1.5^2, which the estimate neglects."""
_SHAPE = 1e-4
"""Squared error of the undamped modes in the basis: the solutions at the worst lines add what this leaves out."""
_LINES = 4
"""Lines solved at a point where the basis fails, each a maximum of the estimate."""


@dataclass(frozen=True, eq=False)
class FRFTarget:
    """FRFs that must meet the tolerance at every line, in units of their standard deviation.

    The basis starts from undamped modes and from the static responses to forces at all references and responses
    (residual attachment modes; Craig and Kurdila 2006). Where the estimate fails, the solutions
    ``Z^-1 F^T`` and ``Z^-1 R^T`` of the full model at the worst lines are added, and with them its damping.

    Attributes
    ----------
    freq : ndarray (n_freq,)
        Hz.
    responses, references : ndarray (n_responses, n_dof), (n_references, n_dof)
        Motions of the sensors and at the forces, over the degrees of freedom of the base model.
    std : ndarray (n_freq, n_responses, n_references)
        Unit of the error; infinite for an entry that does not matter.
    quantity : {"receptance", "mobility", "accelerance"}
        In whose unit ``std`` is given.
    loads : tuple of Load
        Of the test: their parameters follow those of the model at every point.
    effects : tuple of Effect
        With which the model is extended.
    tolerance : float
        Largest error in standard deviations.
    moved : ndarray (n_moved, n_dof)
        Changes of the references over fitted errors of their places, 1/m, and axes, 1/rad: a displaced force is a force
        and moments.
    """

    freq: np.ndarray
    responses: np.ndarray
    references: np.ndarray
    std: np.ndarray
    quantity: Quantity = "receptance"
    loads: tuple[Load, ...] = ()
    effects: tuple[Effect, ...] = ()
    tolerance: float = TOLERANCE
    moved: np.ndarray | None = None

    @property
    def count(self) -> int:
        """0: a basis of FRFs promises no modes."""
        return 0

    @property
    def freq_max(self) -> float:
        """Highest line, Hz."""
        return float(np.max(self.freq))

    @property
    def damping_max(self) -> float:
        """Infinite: FRFs have no modes that are exempt."""
        return np.inf

    @property
    def request(self) -> str:
        """Hash of lines, places, standard deviations and loads."""
        arrays = (
            self.freq,
            self.responses,
            self.references,
            self.std,
            *(load.rows for load in self.loads),
            *self._moved,
        )
        bare = [(load.parameter, load.kind) for load in self.loads]
        return digest_of(self.quantity, repr(bare), *(np.ascontiguousarray(a).tobytes() for a in arrays))[:16]

    def with_effects(self, effects: Sequence[Effect]) -> FRFTarget:
        """The same FRFs of the model with effects."""
        return replace(self, effects=tuple(effects))

    # -- what the basis is grown from ----------------------------------------------------------------------------------

    def forces(self, model: StructuralModel) -> np.ndarray:
        """Unit forces at references and responses, and changes of the former, (n_dof, n_forces)."""
        return np.vstack([self.references, self.responses, *self._moved]).T

    @property
    def _moved(self) -> tuple[np.ndarray, ...]:
        return () if self.moved is None or not len(self.moved) else (self.moved,)

    def snapshots(
        self,
        model: StructuralModel,
        energy: sp.csc_array,
        values: Mapping[str, float],
        known: ReducedModel | None = None,
    ) -> np.ndarray:
        """Undamped modes of the model at named values; see `calib.structure.reduction.growth.Target.snapshots`."""
        full = with_loads(model, self.loads)
        assert isinstance(full, StructuralModel)
        stiffness, _, mass = full.matrices(_of(full, values))
        shapes = _modes_below(stiffness, mass, _BEYOND * self.freq_max)
        size = np.sqrt(np.einsum("ij,ij->j", shapes, energy @ shapes))
        return np.asarray(shapes / size * np.sqrt(self.tolerance / _SHAPE))

    def missing(
        self, reduced: ReducedModel, energy: sp.csc_array, values: Mapping[str, float], unseen: bool = False
    ) -> np.ndarray:
        """Solutions of the full model at the lines where the estimate has its largest maxima.

        The error of a function is at most the product of the errors of both solutions in the energy norm, times an
        amplification near a resonance. Of unit energy, each may therefore have the squared error
        ``tolerance std/(|Z^-1 F^T| |Z^-1 R^T|)``, by which it is scaled.
        """
        at, full = self._peaks(self.by_line(reduced, values)), reduced.model
        rows = [_wider(rows, full.n_dof) for rows in (self.references, self.responses)]
        found = []
        for k, solved in zip(at, frf_solutions(full.matrices(_of(full, values)), self.freq[at], *rows), strict=True):
            forced, felt = (columns[: len(energy.indptr) - 1] for columns in solved)
            sizes = [np.sqrt(np.einsum("ij,ij->j", x.conj(), energy @ x).real) for x in (felt, forced)]
            share = self._receptance_std[k] / np.maximum(np.outer(*sizes), np.finfo(float).tiny)
            for columns, size, least in ((felt, sizes[0], share.min(axis=1)), (forced, sizes[1], share.min(axis=0))):
                found.append(columns[:, size > 0] / (size * np.sqrt(least))[size > 0])
        columns = np.hstack(found)
        return np.hstack([columns.real, columns.imag])

    def _peaks(self, error: np.ndarray) -> np.ndarray:
        """Lines at the largest local maxima of an error by line above half of the tolerance, at least the largest."""
        beside = np.pad(error, 1, constant_values=-np.inf)
        top = (error >= beside[:-2]) & (error > beside[2:]) & (error > 0.5 * self.tolerance)
        top[np.argmax(error)] = True
        lines = np.flatnonzero(top)
        return np.sort(lines[np.argsort(-error[lines], kind="stable")[:_LINES]])

    # -- errors --------------------------------------------------------------------------------------------------------

    def estimate(self, reduced: ReducedModel, values: Mapping[str, float]) -> float:
        """Largest estimated error over all functions and lines; see `error_estimate`."""
        return float(self.by_line(reduced, values).max())

    def by_line(self, reduced: ReducedModel, values: Mapping[str, float]) -> np.ndarray:
        """Largest estimated error of any function at each line, (n_freq,), in standard deviations."""
        responses, references = (_wider(rows, reduced.model.n_dof) for rows in (self.responses, self.references))
        found = error_estimate(reduced, _of(reduced, values), self.freq, responses, references)
        return self._in_std(found).max(axis=(1, 2))

    def error(self, reduced: ReducedModel, values: Mapping[str, float], counted: bool = False) -> float:
        """Largest error over all functions and lines against the full model, in standard deviations."""
        responses, references = (_wider(rows, reduced.model.n_dof) for rows in (self.responses, self.references))
        vectors = reduced.basis.vectors
        point = _of(reduced, values)
        full = frf(reduced.model, point, self.freq, responses, references)
        own = frf(reduced, point, self.freq, responses @ vectors, references @ vectors)
        return float(self._in_std(full - own).max())

    def _in_std(self, receptances: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(receptances) / self._receptance_std)

    @property
    def _receptance_std(self) -> np.ndarray:
        """Standard deviations as receptances, in the shape of ``std``; infinite at 0 Hz of other motions."""
        factor = np.abs(motion_factor(self.quantity, self.freq))[:, None, None]
        return np.divide(self.std, factor, out=np.full(self.std.shape, np.inf), where=factor > 0)

    # -- models --------------------------------------------------------------------------------------------------------

    def posed(self, reduced: ReducedModel) -> ReducedModel:
        """A reduced base model with the effects and loads: the others take this one."""
        own = reduced.extended(self.effects) if self.effects else reduced
        whole = with_loads(own, self._loads(own.model))
        assert isinstance(whole, ReducedModel)
        return whole

    def _loads(self, model: StructuralModel) -> list[Load]:
        return [replace(load, rows=_wider(load.rows, model.n_dof)) for load in self.loads]


def error_estimate(
    reduced: ReducedModel, values: Mapping[str, float], freq: np.ndarray, responses: np.ndarray, references: np.ndarray
) -> np.ndarray:
    """Estimate of the full model's receptances less the reduced ones, without a solution of the full model.

    With the residuals ``r_F = F^T - Z V x`` and ``r_R = R^T - Z V y`` of both reduced solutions, the difference is
    ``r_R^T Z^-1 r_F`` exactly (dual-weighted residual; Becker and Rannacher 2001), since Z is symmetric and the
    residuals are orthogonal to the basis. Here Z^-1 is replaced by the inverse of the stiffness at the reference values
    of the basis, one factor for all lines and points: what a basis with all modes of the band lacks moves nearly
    statically. It is an estimate, not a bound; a model softer than the reference has larger errors.

    Parameters
    ----------
    reduced : ReducedModel
    values : mapping
    freq : ndarray (n_freq,)
        Hz.
    responses, references : ndarray (n_responses, n_dof), (n_references, n_dof)
        Over the degrees of freedom of the full model.

    Returns
    -------
    ndarray (n_freq, n_responses, n_references), complex
    """
    if len(references) > len(responses):  # the residuals of the fewer ones are solved for
        return np.moveaxis(error_estimate(reduced, values, freq, references, responses), 1, 2)
    vectors, few = reduced.basis.vectors, len(references)
    small = [rows @ vectors for rows in (references, responses)]
    solved = list(frf_solutions(reduced.matrices(values), freq, *small))
    forced, felt = (np.array([pair[k] for pair in solved]) for k in (0, 1))  # (n_freq, size, ...)
    matrices = reduced.model.matrices(values)
    omega = np.repeat(2 * np.pi * np.asarray(freq, dtype=float), few)

    def dynamic(motion: np.ndarray) -> np.ndarray:
        """Z times columns, ``few`` for each line."""
        stiffness, damping, mass = (matrix @ motion for matrix in matrices)
        return np.asarray(stiffness + 1j * omega * damping - omega**2 * mass)

    lifted = vectors @ np.moveaxis(forced, 0, 1).reshape(len(vectors.T), -1)
    residual = np.tile(references.T, (1, len(freq))) - dynamic(lifted)
    weighted = reduced.static_response(residual)
    images = (vectors.T @ dynamic(weighted)).reshape(-1, len(freq), few)
    seen = (responses @ weighted).reshape(-1, len(freq), few)
    return np.asarray(np.moveaxis(seen, 0, 1) - np.einsum("knr,nkq->krq", felt, images, optimize=True))


def _modes_below(stiffness: sp.csc_array, mass: sp.csc_array, freq: float) -> np.ndarray:
    """Undamped shapes (n_dof, n_modes) up to a frequency in Hz, with at least one beyond it where there is one."""
    most, count = stiffness.shape[0] // 2, 16
    while True:
        found: Modes = solve_modes(stiffness, None, mass, min(count, most))
        if found.natural_freq[-1] > freq or count >= most:
            return found.shapes[:, found.natural_freq <= freq]
        count *= 2


def _of(model: StructuralModel | ReducedModel, values: Mapping[str, float]) -> dict[str, float]:
    """Those values that are parameters of a model: gains of channels, say, are not."""
    return {name: value for name, value in values.items() if name in model.space}


def _wider(rows: np.ndarray, n_dof: int) -> np.ndarray:
    """Rows over more degrees of freedom, those of effects, which they do not move."""
    return np.pad(rows, ((0, 0), (0, n_dof - rows.shape[1])))
