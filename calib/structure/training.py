"""Training of a reduced basis on full-order modes over parameter spaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as la

from calib.errors import InputError, ToleranceError
from calib.space import ParameterSpace
from calib.stage import Progress, unheard
from calib.structure.basis import CHECK_COLUMNS, Basis
from calib.structure.certificate import mode_errors
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduced import ReducedModel, reference_factor, reference_matrix
from calib.structure.solve import solve_modes
from calib.structure.space_filling import box, levels, middle, space_filling_points

_SAFETY = 0.5
"""Limit of the error indicator, as a fraction of the tolerance."""
_POD = 0.5
"""Squared projection error of every snapshot, as a fraction of the tolerance."""
_STATIC = 1e-3
"""Static vectors closer than this to the span of the others, in the energy norm, are dropped."""
_NEAR = 1.15
"""Modes up to this multiple of the highest wanted frequency are included: they may be lower at other points."""
_FRESH = 24
"""Validation points of each space in a round of checks."""
_VERIFIED = 6
"""Points of a passed round, worst indicators first, that are verified at full order: only that detects missed modes."""
_ROUNDS = 16


@dataclass(frozen=True)
class _Target:
    """Modes that must meet the tolerance."""

    count: int
    freq_max: float
    damping_max: float
    tolerance: float

    def relevant(self, modes: Modes) -> np.ndarray:
        """Which modes must meet it, (n_modes,), bool."""
        return (modes.natural_freq <= self.freq_max) & (modes.damping_ratio < self.damping_max)


def train_basis(
    model: StructuralModel,
    spaces: ParameterSpace | Sequence[ParameterSpace],
    count: int,
    *,
    seed: int,
    freq_max: float = np.inf,
    damping_max: float = 0.95,
    tolerance: float = 1e-5,
    samples: int | None = None,
    progress: Progress = unheard,
) -> Basis:
    """Train a basis that represents the lowest modes of a model over whole parameter spaces.

    The basis collects, in this order: static responses to all selected vectors b and to the dampers; the proper
    orthogonal decomposition of snapshots (modes at Latin hypercube points, scaled to equal energy, real and imaginary
    parts); and the modes at the validation points where `ReducedModel.indicator` is largest, until a round of new
    points passes and its worst points agree with the full model without a missed mode. Points that were not solved rest
    on the indicator alone; `calib.structure.certificate` measures the error.

    Parameters
    ----------
    model : StructuralModel
    spaces : ParameterSpace or sequence of them
        Domain of the basis, constraints included; integer parameters take all of their values.
    count : int
        Number of modes to represent.
    seed : int
        Same seed, same basis on the same machine.
    freq_max, damping_max : float
        Only modes below this natural frequency (Hz) and damping ratio must meet the tolerance. A nearly critical
        eigenvalue is almost defective and cannot meet a tight tolerance.
    tolerance : float
        Relative eigenvalue error; the indicator must meet half of it. Errors of shapes, MAC and damping ratios are
        about its square root, those of strain energy shares several times that, so that a hundredth of what frequencies
        need is worthwhile.
    samples : int, optional
        Snapshot points of each space; default 8 plus 2 for each free parameter, at least as many as an integer
        parameter has values.
    progress : callable
        Called before every point that is solved.

    Raises
    ------
    InputError
        When a space does not belong to the model or has no feasible point.
    ToleranceError
        When the tolerance is not reached.
    EvaluationError
        When a point cannot be solved.
    """
    several = (spaces,) if isinstance(spaces, ParameterSpace) else tuple(spaces)
    _check(model, several, count, tolerance)
    target = _Target(count, freq_max, damping_max, tolerance)
    rng = np.random.default_rng(seed)
    lower, upper = box(several)
    reference = middle(lower, upper)
    offset = _offset(model, dict(zip(model.space.names, reference.tolist(), strict=True)))
    basis = Basis(
        vectors=np.zeros((model.n_dof, 0)),
        model_fingerprint=model.fingerprint,
        names=model.space.names,
        reference=reference,
        lower=lower,
        upper=upper,
        offset=offset,
        count=count,
        freq_max=float(freq_max),
        damping_max=float(damping_max),
        tolerance=float(tolerance),
        samples=np.zeros((0, len(reference))),
        checks=np.zeros((0, len(CHECK_COLUMNS))),
        seed=seed,
    )
    growth = Growth(model, basis)
    vectors = growth.statics()
    points = [p for space in several for p in space_filling_points(space, samples or _sample_count(space), rng)]
    solved = []
    for k, p in enumerate(points):
        progress("training the reduced basis", k, len(points))
        solved.append(growth.snapshots(model.modes(p, count), target))
    snapshots = np.hstack(solved)
    vectors = np.hstack([vectors, growth.decomposed(snapshots, vectors, _POD * tolerance)])
    basis = replace(basis, vectors=vectors, samples=_rows(basis, points))
    for number in range(1, _ROUNDS + 1):
        progress(f"checking the reduced basis, round {number}")
        fresh = [p for space in several for p in space_filling_points(space, _fresh_count(space), rng)]
        basis, passed = growth.enriched(basis, fresh, target, number)
        if passed:
            return basis
    raise ToleranceError(
        f"a basis of {basis.size} vectors misses its tolerance of {tolerance:g} {_missed(basis, tolerance)}",
        place=f"reduced model of {model.name}",
        remedy="raise the tolerance, narrow the limits, or work with the full model",
    )


def _missed(basis: Basis, tolerance: float) -> str:
    """Failure of the last round of checks, in words."""
    found = basis.checks[basis.checks[:, 0] == _ROUNDS]
    error = float(np.nanmax(found[:, 3], initial=0.0))
    if error > tolerance:
        return f"after {_ROUNDS} rounds of checks: eigenvalues of the full model differ by up to {error:.1e}"
    required, indicator = _SAFETY * tolerance, float(found[:, 2].max())
    return f"after {_ROUNDS} rounds of checks: its error indicator of {indicator:.1e} exceeds {required:.1e}"


def enrich_basis(model: StructuralModel, basis: Basis, points: Sequence[Mapping[str, float]]) -> Basis:
    """The next version of a basis, which also meets its tolerance at given points, in the order given.

    Do not change a basis during a search: results would then depend on the order of evaluations.
    """
    growth = Growth(model, basis)
    target = _Target(basis.count, basis.freq_max, basis.damping_max, basis.tolerance)
    number = int(basis.checks[:, 0].max(initial=0)) + 1
    complete = [model.space.complete(p) for p in points]
    grown = growth.enriched(basis, complete, target, number)[0]
    return replace(grown, version=basis.version + 1)


# -- vectors -----------------------------------------------------------------------------------------------------------


class Growth:
    """Inner product of a basis, and the projections and decompositions in it."""

    def __init__(self, model: StructuralModel, basis: Basis):
        self.model = model
        self.reference = basis.reference_values
        self.matrix = reference_matrix(model, self.reference, basis.offset)
        self.factor = reference_factor(model, self.reference, basis.offset)
        self.rigid = _rigid_count(model, self.reference) if basis.offset else 0

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
        for _ in range(2):
            vectors = vectors - basis @ (basis.T @ (self.matrix @ vectors))
        return vectors

    def spanned(self, vectors: np.ndarray, least: float) -> np.ndarray:
        """Orthonormal basis of vectors (n_dof, m); directions of energy below ``least`` (squared norm) are dropped."""
        if not vectors.shape[1]:
            return vectors
        energies, turn = la.eigh(vectors.T @ (self.matrix @ vectors))
        kept = energies > max(least, 1e-13 * energies[-1])
        out = vectors @ (turn[:, kept] / np.sqrt(energies[kept]))
        # A second pass, since the division has amplified the rounding error of small directions.
        energies, turn = la.eigh(out.T @ (self.matrix @ out))
        return out @ (turn / np.sqrt(energies)) @ turn.T

    def statics(self) -> np.ndarray:
        """Static responses of the reference model to selected vectors and damper forces, and its rigid-body motions."""
        chosen = [b for term in self.model.stiffness.selected for b in term.vectors.values()]
        forces = [np.column_stack(chosen)] if chosen else []
        if self.rigid:
            forces.append(self._inertia_forces())
        if self.model.is_damped:
            for term in self.model.damping.terms:
                active = np.unique(term.matrix.indices[term.matrix.data != 0])
                if len(active) <= 0.1 * self.model.n_dof:  # discrete dampers, not material damping
                    sizes, turn = la.eigh(term.matrix[active][:, active].toarray())
                    columns = np.zeros((self.model.n_dof, np.count_nonzero(sizes > 1e-10 * sizes[-1])))
                    columns[active] = turn[:, sizes > 1e-10 * sizes[-1]]
                    forces.append(columns)
        if not forces:
            return np.zeros((self.model.n_dof, 0))
        responses = self.factor.solve(np.hstack(forces))
        responses /= np.sqrt(np.einsum("ij,ij->j", responses, self.matrix @ responses))
        return self.spanned(responses, _STATIC**2)

    def snapshots(self, modes: Modes, target: _Target) -> np.ndarray:
        """Real columns that span modes, each mode scaled to unit energy; (n_dof, n_modes) or twice as many."""
        shapes = modes.shapes[:, modes.natural_freq <= _NEAR * target.freq_max]
        energy = np.einsum("ij,ij->j", shapes.conj(), self.matrix @ shapes).real
        if not modes.is_complex:
            return shapes / np.sqrt(energy)
        # Rotated to the phase that maximises the real part.
        turn = np.exp(-0.5j * np.angle(np.einsum("ij,ij->j", shapes, self.matrix @ shapes)))
        shapes = shapes * (turn / np.sqrt(energy))
        return np.hstack([shapes.real, shapes.imag])

    def decomposed(self, snapshots: np.ndarray, basis: np.ndarray, error: float) -> np.ndarray:
        """Fewest principal directions that, with a basis, represent every snapshot to a squared error."""
        rest = self.project_out(snapshots, basis)
        gram = rest.T @ (self.matrix @ rest)
        if np.diag(gram).max(initial=0.0) < error:
            return np.zeros((len(rest), 0))
        energies, turn = la.eigh(gram)
        energies, turn = energies[::-1], turn[:, ::-1]
        left = np.diag(gram)[:, None] - np.cumsum(energies * turn**2, axis=1)
        size = int(np.argmax(left.max(axis=0) < error)) + 1
        size = min(size, int(np.count_nonzero(energies > 1e-13 * energies[0])))
        return self.spanned(self.project_out(rest @ (turn[:, :size] / np.sqrt(energies[:size])), basis), 0.0)

    def widened(self, basis: np.ndarray, vectors: np.ndarray, error: float) -> np.ndarray:
        """An orthonormal basis, extended to represent given vectors to a squared error."""
        return np.hstack([basis, self.decomposed(vectors, basis, error)])

    def enriched(
        self, basis: Basis, points: Sequence[Mapping[str, float]], target: _Target, number: int
    ) -> tuple[Basis, bool]:
        """The basis with modes of the worst points added until all pass, and whether all passed at once."""
        final = np.zeros(len(points))
        waiting = list(range(len(points)))
        passed = True
        while waiting:
            reduced = ReducedModel(self.model, basis)
            for k in waiting:
                modes = reduced.modes(points[k], target.count)
                final[k] = np.max(reduced.indicator(points[k], modes)[target.relevant(modes)], initial=0.0)
            checks = [(number, basis.size, final[k], np.nan) for k in waiting]
            waiting = [k for k in waiting if final[k] > _SAFETY * target.tolerance]
            worst = [max(waiting, key=lambda k: final[k])] if waiting else []
            if not waiting:
                for k in np.argsort(-final, kind="stable")[:_VERIFIED].tolist():
                    error = mode_errors(reduced, points[k], target.count).worst
                    checks.append((number, basis.size, final[k], error))
                    if error > target.tolerance:
                        worst.append(k)
            basis = replace(basis, checks=np.vstack([basis.checks, checks]))
            if not worst:
                break
            passed = False
            snapshots = [self.snapshots(self.model.modes(points[k], target.count), target) for k in worst]
            grown = self.added(basis.vectors, np.hstack(snapshots), _POD * target.tolerance)
            if grown.shape[1] == basis.size:
                break  # nothing is left to add: the indicator overestimates the error there
            samples = np.vstack([basis.samples, _rows(basis, [points[k] for k in worst])])
            basis = replace(basis, vectors=grown, samples=samples)
        return basis, passed

    def added(self, basis: np.ndarray, vectors: np.ndarray, least: float) -> np.ndarray:
        """An orthonormal basis with vectors added, directions of energy below ``least`` dropped."""
        new = self.spanned(self.project_out(vectors, basis), least)
        return np.hstack([basis, self.project_out(new, basis)])


def _rigid_count(model: StructuralModel, values: Mapping[str, float]) -> int:
    """Number of rigid-body motions and mechanisms of the reference model."""
    return sum(eigenvalue.kind in ("zero", "spin") for eigenvalue in _reference_modes(model, values).excluded)


def _offset(model: StructuralModel, values: Mapping[str, float]) -> float:
    """Factor of the mass that keeps the inner product regular; 0 without rigid-body motions and mechanisms."""
    if not _rigid_count(model, values):
        return 0.0
    return float((0.1 * 2 * np.pi * _reference_modes(model, values).natural_freq[0]) ** 2)


def _reference_modes(model: StructuralModel, values: Mapping[str, float]) -> Modes:
    stiffness = reference_matrix(model, values, 0.0)
    return solve_modes(stiffness, None, model.mass(model.space.si(model.space.complete(values))), 1)


def _check(model: StructuralModel, spaces: Sequence[ParameterSpace], count: int, tolerance: float) -> None:
    place = f"reduced model of {model.name}"
    if count < 1:
        raise InputError(f"the number of modes is {count}", place=place, remedy="ask for at least 1")
    if not 0 < tolerance < 1:
        raise InputError(f"the tolerance is {tolerance}", place=place, remedy="choose one such as 1e-4")
    if not spaces:
        raise InputError("no parameter space is given", place=place)
    for space in spaces:
        if space.names != model.space.names:
            raise InputError("the parameters of a space are not those of the model", place=place)
        space.require_feasible()


def _sample_count(space: ParameterSpace) -> int:
    return max(8 + 2 * len(space.free), levels(space))


def _fresh_count(space: ParameterSpace) -> int:
    return max(_FRESH, levels(space))


def _rows(basis: Basis, points: Sequence[Mapping[str, float]]) -> np.ndarray:
    return np.array([[p[name] for name in basis.names] for p in points], dtype=float).reshape(-1, len(basis.names))
