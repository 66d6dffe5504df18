"""Enrichment of a reduced basis by modes with effects and derivatives by local perturbations."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.errors.errors import EvaluationError
from calib.execution.stage import Progress, silent
from calib.execution.tasks import each
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import Perturbation
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.frf_target import FRFTarget
from calib.structure.reduction.growth import Growth, next_round
from calib.structure.reduction.local_derivatives import TOGETHER, LocalDerivatives, grounded
from calib.structure.reduction.mode_target import REFINED
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near, real_columns, undamped_counts
from calib.structure.reduction.training import space_filling_points
from calib.structure.rules import RULES

_POINTS = 2
"""Points of the space, beside its middle, at which modes with effects are sampled."""
_STRONG = 2.0
"""Largest sampled magnitude, over the plausible one."""
_ERROR = 3e-5
"""Squared projection error of every vector, relative to the strain energy of its mode."""
_NEARER = 3e-6
"""The same about one point, whose basis has less to represent."""
_REFINED = 0.1 * _ERROR
"""Accuracy of eigenvalues of refined modes: about the squared error of their shapes."""
_EFFECTS = 4
"""Effects solved from the same basis, as tasks that can be shared: all their models and shapes are in memory."""
_ROWS = 120_000
"""Degrees of freedom of these models together, beyond which fewer of them are solved from the same basis."""


def effect_basis(
    model: StructuralModel,
    basis: Basis,
    space: ParameterSpace,
    effects: Sequence[Effect],
    perturbations: Sequence[Perturbation],
    seed: int,
    progress: Progress = silent,
    at: Mapping[str, float] | None = None,
) -> Basis:
    """The next version of a basis, which spans modes with effects and derivatives by perturbations.

    The principal directions of the following are added: shapes of the model with each effect, at its plausible and at
    twice its plausible magnitude or at all points of its grid, at a few points of the space; and derivatives of the
    shapes by every perturbation, times its plausible magnitude, at the middle of the space. That of a grounded spring
    is scaled by the lowest frequency of the model instead: no measured frequency enters.

    Parameters
    ----------
    model : StructuralModel
        The base model, for which ``basis`` was trained.
    basis : Basis
    space : ParameterSpace
        Effects are sampled at its middle and a few points.
    effects : sequence of Effect
        Modes are solved with each.
    perturbations : sequence of Perturbation
        Derivatives are taken by each.
    seed : int
    progress : callable
        Called before every few effects and every batch of perturbations.
    at : mapping, optional
        The only point, instead of the middle and others.
    """
    growth, points = Growth(model, basis), _points(space, seed) if at is None else [dict(at)]
    middle, vectors, error = points[0], basis.vectors, _ERROR if at is None else _NEARER
    stage, batches = "training the basis for the effects", math.ceil(len(perturbations) / TOGETHER)
    group = max(min(_EFFECTS, _ROWS // model.n_dof), 1)
    if effects:
        vectors = _with_undamped(growth, basis, middle, error)
    for first in range(0, len(effects), group):
        progress(stage, first, len(effects) + batches)
        few, known = effects[first : first + group], replace(basis, vectors=vectors)
        vectors = _with_modes(growth, ReducedModel(model, known), few, points, error)
    if perturbations:
        basis = replace(basis, vectors=vectors)
        local = LocalDerivatives(growth, basis, middle, model.modes(middle, basis.count))
        for number, first in enumerate(range(0, len(perturbations), TOGETHER)):
            progress(stage, len(effects) + number, len(effects) + batches)
            local.add(perturbations[first : first + TOGETHER], error)
        vectors = local.vectors
    return replace(basis, vectors=vectors, version=basis.version + 1)


def covering_fits(reduced: ReducedModel, fits: Iterable[tuple[Sequence[Effect], Mapping[str, float]]]) -> Basis:
    """The basis of a model, or the next version, which meets its tolerance also with given effects at given values.

    Where the error indicator exceeds it, what the modes there lack is added. A point that cannot be solved is left out.
    """
    model, basis, inner = reduced.model, reduced.basis, reduced
    growth, vectors = Growth(model, basis), basis.vectors
    for effects, values in fits:
        wider = extend(model, effects) if effects else model
        carried = inner.basis.carried(wider.space, wider.n_dof) if effects else inner.basis
        known = ReducedModel(wider, carried, inner, growth.factor)
        with contextlib.suppress(EvaluationError):
            modes = known.modes(values, known.n_modes)
            counts = (modes.natural_freq <= basis.freq_max) & (modes.damping_ratio < basis.damping_max)
            if np.max(known.indicator(values, modes)[counts], initial=0.0) > basis.tolerance:
                accuracy = REFINED * basis.tolerance
                solved = modes_near(known, values, known.n_modes, accuracy)
                vectors = growth.widened(vectors, [_unit(growth, solved, model.n_dof, basis)], accuracy)
                inner = ReducedModel(model, replace(basis, vectors=vectors))
    grown = vectors.shape[1] > basis.size
    return replace(basis, vectors=vectors, version=basis.version + 1) if grown else basis


def frf_effect_basis(
    model: StructuralModel,
    basis: Basis,
    space: ParameterSpace,
    effects: Sequence[Effect],
    target: FRFTarget,
    seed: int,
    progress: Progress = silent,
) -> Basis:
    """The next version of a basis of FRFs, which meets its tolerance with each effect too.

    Effects are sampled as by `effect_basis`. Local perturbations need nothing: the derivative of an FRF holds the
    solutions of the unperturbed model alone.

    Parameters
    ----------
    model : StructuralModel
        The base model, for which ``basis`` was trained.
    basis : Basis
    space : ParameterSpace
        Of the model and of the loads of the target.
    effects : sequence of Effect
    target : FRFTarget
        That the basis was trained for.
    seed : int
    progress : callable
        Called before every effect.
    """
    growth, points = Growth(model, basis), _points(space, seed)
    for number, effect in enumerate(effects):
        progress("training the basis for the effects", number, len(effects))
        sampled = [{**point, **own} for point in points for own in _sampled(effect)]
        sampled = [{**{p.name: p.value for p in effect.parameters}, **point} for point in sampled]
        basis = growth.enriched(basis, sampled, target.with_effects([effect]), next_round(basis), verified=1)[0]
    return replace(basis, version=basis.version + 1)


def _with_modes(
    growth: Growth, known: ReducedModel, effects: Sequence[Effect], points: Sequence[Mapping[str, float]], error: float
) -> np.ndarray:
    """Vectors of a reduced model, with those that modes with each effect need."""
    basis, rows = known.basis, known.model.n_dof
    asked = [(k, {**point, **own}) for k, one in enumerate(effects) for point in points for own in _sampled(one)]
    solved = each(_near, [known.extended([one]) for one in effects], asked)
    vectors = basis.vectors
    for k in range(len(effects)):
        seen = (_unit(growth, m, rows, basis) for m, (of, _) in zip(solved, asked, strict=True) if of == k)
        vectors = growth.widened(vectors, seen, error)
    return vectors


def _with_undamped(growth: Growth, basis: Basis, point: Mapping[str, float], error: float) -> np.ndarray:
    """Vectors of a basis, with the undamped modes that it lacks: those of which no damped mode up to the last consists.

    Modes with an effect are refined from the basis where it lacks no undamped mode: if it did without an effect, every
    one would be solved anew.
    """
    model = growth.model
    if not model.is_damped:
        return basis.vectors
    known, there = undamped_counts(ReducedModel(model, basis), point, basis.count) or (0, 0)
    if known >= there:
        return basis.vectors
    stiffness, _, mass = model.matrices(point)
    solved = solve_modes(stiffness, None, mass, min(there, model.n_dof), model.dofs.direction >= 3)
    return growth.widened(basis.vectors, [_unit(growth, solved, model.n_dof, basis)], error)


def _near(known: Sequence[ReducedModel], asked: tuple[int, Mapping[str, float]]) -> Modes:
    of, point = asked
    return modes_near(known[of], point, known[of].n_modes, _REFINED)


def _points(space: ParameterSpace, seed: int) -> list[dict[str, float]]:
    """Middle of a space and a few points in it."""
    middle = {p.name: p.value for p in space.parameters}
    return [middle, *space_filling_points(space, _POINTS, np.random.default_rng(seed))[:_POINTS]]


def _sampled(effect: Effect) -> Iterator[Mapping[str, float]]:
    """Magnitudes and nuisance values at which modes are solved."""
    if effect.grid:
        yield from effect.grid
        return
    for factor in (1.0, _STRONG) + ((-1.0,) if effect.signed else ()):
        magnitude = min(max(factor * effect.plausible, effect.magnitude.lower), effect.magnitude.upper)
        yield {effect.name: magnitude}


def _unit(growth: Growth, modes: Modes, rows: int, basis: Basis) -> np.ndarray:
    """Shapes at the model's own degrees of freedom, of unit energy or, where they hardly move, of less."""
    shapes = modes.shapes[:rows, modes.natural_freq <= basis.freq_max]
    energy = np.einsum("ij,ij->j", shapes.conj(), growth.matrix @ shapes).real
    moving = energy > 1e-6 * energy.max(initial=0.0)
    kept = shapes[:, moving] / np.sqrt(energy[moving])
    return real_columns(kept)


def weight_key(perturbation: Perturbation) -> tuple[str, float]:
    """Name of a perturbation, and what its weight in a basis depends on beside the model."""
    return perturbation.effect.name, RULES.local if grounded(perturbation) else perturbation.effect.plausible
