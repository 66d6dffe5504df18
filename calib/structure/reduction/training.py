"""Training of a reduced basis on solutions of the full model over parameter spaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError, ToleranceError
from calib.execution.stage import Progress, silent
from calib.execution.tasks import each
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.basis import CHECK_COLUMNS, Basis
from calib.structure.reduction.growth import (
    POD,
    SAFETY,
    VERIFIED,
    Growth,
    Snapshots,
    Target,
    next_round,
    offset_of,
    reference_modes,
    sampled_rows,
)
from calib.structure.reduction.mode_target import ModeTarget
from calib.structure.reduction.reduced import ReducedModel


def box(spaces: Sequence[ParameterSpace]) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest value of every parameter."""
    ends = []
    for space in spaces:
        free = set(space.free_names)
        ends.append([(p.lower, p.upper) if p.name in free else (p.value, p.value) for p in space.parameters])
    table = np.array(ends, dtype=float)
    return table[:, :, 0].min(axis=0), table[:, :, 1].max(axis=0)


def mid_point(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Middle of the limits: the geometric mean where both are positive, so that both ends are equally far in ratio."""
    return np.where(lower > 0, np.sqrt(np.abs(lower * upper)), 0.5 * (lower + upper))


def integer_levels(space: ParameterSpace) -> int:
    """Largest number of values of an integer parameter."""
    return int(max((p.upper - p.lower + 1 for p in space.free if p.integer), default=1))


def space_filling_points(space: ParameterSpace, count: int, rng: np.random.Generator) -> list[dict[str, float]]:
    """Latin hypercube points within the constraints, with integers distributed evenly; complete sets of values."""
    if not space.free:
        return [space.complete({})]
    lower, upper, integer = space.lower, space.upper, space.integer
    points = sample(space, count, rng, 4 * count).points
    dealt = points.copy()
    for j in np.flatnonzero(integer):
        dealt[:, j] = rng.permutation(np.resize(np.arange(lower[j], upper[j] + 1), count))
    good = space.feasible(dealt)  # with a constraint on integers the sampled values stay
    return [space.complete(row) for row in np.where(good[:, None], dealt, points)]


_FRESH = 24
"""Validation points of each space in a round of checks."""
_FIRST = 4
"""Snapshot points solved at full order; those after them start from a reduced model."""
_ROUNDS = 16


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
    progress: Progress = silent,
) -> Basis:
    """Train a basis that represents the lowest modes of a model over whole parameter spaces.

    The basis collects, in this order: static responses to all selected vectors b and to the dampers; the proper
    orthogonal decomposition of snapshots (modes at Latin hypercube points, scaled to equal energy, real and imaginary
    parts); and the modes at the validation points where `ReducedModel.indicator` is largest, until a round of new
    points passes and its worst points agree with the full model without a missed mode. Points that were not solved rest
    on the indicator alone; `calib.structure.reduction.certificate` measures the error.

    After the first snapshots, modes are refined from the basis known so far (`calib.structure.reduction.refinement`)
    where their number is confirmed by the law of inertia, and solved at full order elsewhere.

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
        Called before every point that is solved here; others may share them, see `calib.execution.tasks.each`.

    Raises
    ------
    InputError
        When a space does not belong to the model or has no feasible point.
    ToleranceError
        When the tolerance is not reached.
    EvaluationError
        When a point cannot be solved.
    """
    if count < 1:
        raise InputError(f"the number of modes is {count}", place=_place(model), remedy="ask for at least 1")
    target = ModeTarget(count, float(freq_max), float(damping_max), float(tolerance))
    return train(model, spaces, target, seed=seed, samples=samples, progress=progress)


def train(
    model: StructuralModel,
    spaces: ParameterSpace | Sequence[ParameterSpace],
    target: Target,
    *,
    seed: int,
    samples: int | None = None,
    progress: Progress = silent,
) -> Basis:
    """Train a basis that meets a target over whole parameter spaces; see `train_basis`.

    The parameters of a space are those of the model, and after them those of the test's loads, which the target adds.
    """
    several = (spaces,) if isinstance(spaces, ParameterSpace) else tuple(spaces)
    _check(model, several, target.tolerance)
    rng = np.random.default_rng(seed)
    lower, upper = (end[: len(model.space.names)] for end in box(several))
    reference = mid_point(lower, upper)
    modes = reference_modes(model, dict(zip(model.space.names, reference.tolist(), strict=True)))
    basis = _empty(model, target, (lower, reference, upper), modes, seed)
    growth = Growth(model, basis, modes)
    points = [p for space in several for p in space_filling_points(space, samples or _sample_count(space), rng)]
    snapshots = Snapshots(growth, growth.statics(target.forces(model)))
    known: ReducedModel | None = None
    for some in _batches(len(points)):
        if some.start:
            known = ReducedModel(model, replace(basis, vectors=snapshots.represented(POD * target.tolerance)))

        def told(done: int, first: int = some.start) -> None:
            progress("training the reduced basis", first + done, len(points))

        solved = each(_snapshots, (target, model, growth.matrix, known), [points[k] for k in some], told)
        while solved:
            snapshots.add(solved.pop(0))
    vectors = snapshots.represented(POD * target.tolerance)
    del snapshots
    basis = replace(basis, vectors=vectors, samples=sampled_rows(basis, points))
    for number in range(1, _ROUNDS + 1):
        progress(f"checking the reduced basis, round {number}")
        fresh = [p for space in several for p in space_filling_points(space, _fresh_count(space), rng)]
        basis, passed = growth.enriched(basis, fresh, target, number)
        if passed:
            return basis
    raise ToleranceError(
        f"a basis of {basis.size} vectors misses its tolerance of {target.tolerance:g} {_missed(basis)}",
        place=_place(model),
        remedy="raise the tolerance, narrow the limits, or work with the full model",
    )


def basis_at(model: StructuralModel, space: ParameterSpace, target: ModeTarget, values: Mapping[str, float]) -> Basis:
    """A basis of what a model does at one point, without training: its modes, and how parameters move them.

    It serves near that point. Its error indicator tells where it lacks something elsewhere, and `enrich_basis` adds
    that.

    Parameters
    ----------
    model : StructuralModel
    space : ParameterSpace
        Its limits are those of the basis.
    target : ModeTarget
        With the parameters that are going to move in ``moved``.
    values : mapping
        The point, also the reference of the inner product.

    Returns
    -------
    Basis

    Raises
    ------
    EvaluationError
        When the model cannot be solved there.
    """
    _check(model, (space,), target.tolerance)
    point = model.space.complete({name: v for name, v in values.items() if name in model.space})
    lower, upper = (end[: len(model.space.names)] for end in box((space,)))
    modes = model.modes(point, target.count)
    plain = not (modes.is_complex or model.stiffness.selected)
    reference = modes if plain else reference_modes(model, point)
    row = np.array([point[name] for name in model.space.names])
    basis = _empty(model, target, (np.minimum(lower, row), row, np.maximum(upper, row)), reference, 0)
    growth = Growth(model, basis, reference)
    vectors = growth.widened(
        growth.statics(target.forces(model)), [target.columns(modes, growth.matrix)], POD * target.tolerance
    )
    basis = replace(basis, vectors=vectors, samples=sampled_rows(basis, [point]))
    static = ReducedModel(model, basis, factor=growth.factor).static_response
    moves = target.directions(model, growth.matrix, point, modes, static)
    return replace(basis, vectors=growth.added(vectors, moves, POD * target.tolerance))


def _empty(
    model: StructuralModel,
    target: Target,
    limits: tuple[np.ndarray, np.ndarray, np.ndarray],
    modes: Modes,
    seed: int,
) -> Basis:
    """A basis without vectors; of the limits lower, reference and upper values, ``modes`` are `reference_modes`."""
    lower, reference, upper = limits
    return Basis(
        vectors=np.zeros((model.n_dof, 0)),
        model_fingerprint=model.fingerprint,
        names=model.space.names,
        reference=reference,
        lower=lower,
        upper=upper,
        offset=offset_of(modes),
        count=target.count,
        freq_max=target.freq_max,
        damping_max=target.damping_max,
        tolerance=target.tolerance,
        request=target.request,
        samples=np.zeros((0, len(reference))),
        checks=np.zeros((0, len(CHECK_COLUMNS))),
        seed=seed,
    )


def _batches(count: int) -> Iterator[range]:
    """Points that are solved from what is known at 0, 4, 8, 16 ... points: independently of each other."""
    first, size = 0, _FIRST
    while first < count:
        yield range(first, min(first + size, count))
        first = size = first + size


def _snapshots(
    shared: tuple[Target, StructuralModel, sp.csc_array, ReducedModel | None], point: Mapping[str, float]
) -> np.ndarray:
    target, model, energy, known = shared
    return target.snapshots(model, energy, point, known)


def _missed(basis: Basis) -> str:
    """Failure of the last round of checks, in words."""
    found = basis.checks[basis.checks[:, 0] == _ROUNDS]
    error = float(np.nanmax(found[:, 3], initial=0.0))
    if error > basis.tolerance:
        return f"after {_ROUNDS} rounds of checks: the full model differs by up to {error:.1e}"
    required, indicator = SAFETY * basis.tolerance, float(found[:, 2].max())
    return f"after {_ROUNDS} rounds of checks: its error indicator of {indicator:.1e} exceeds {required:.1e}"


def enrich_basis(
    model: StructuralModel,
    basis: Basis,
    points: Sequence[Mapping[str, float]],
    target: Target | None = None,
    verified: int = VERIFIED,
) -> Basis:
    """The next version of a basis, which also meets its tolerance at given points, in the order given.

    ``target`` is the one it was trained for, by default modes; so many of the points are ``verified`` at full order.
    Do not change a basis during a search: results would then depend on the order of evaluations.
    """
    growth = Growth(model, basis)
    if target is None:
        target = ModeTarget(basis.count, basis.freq_max, basis.damping_max, basis.tolerance)
    complete = [{**p, **model.space.complete({n: v for n, v in p.items() if n in model.space})} for p in points]
    grown = growth.enriched(basis, complete, target, next_round(basis), verified)[0]
    return replace(grown, version=basis.version + 1)


def _place(model: StructuralModel) -> str:
    return f"reduced model of {model.name}"


def _check(model: StructuralModel, spaces: Sequence[ParameterSpace], tolerance: float) -> None:
    place = _place(model)
    if not 0 < tolerance < 1:
        raise InputError(f"the tolerance is {tolerance}", place=place, remedy="choose one such as 1e-4")
    if not spaces:
        raise InputError("no parameter space is given", place=place)
    for space in spaces:
        if space.names[: len(model.space.names)] != model.space.names:
            raise InputError("the parameters of a space are not those of the model", place=place)
        space.require_feasible()


def _sample_count(space: ParameterSpace) -> int:
    return max(8 + 2 * len(space.free), integer_levels(space))


def _fresh_count(space: ParameterSpace) -> int:
    return max(_FRESH, integer_levels(space))
