"""Local perturbations that the tests of a model share, and a reduced basis that represents all effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from calib.correlation.basis import BasisRequirements, parameter_key
from calib.execution.stage import Progress, silent
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.results.written import is_own
from calib.structure.effects.extend import addition_of
from calib.structure.effects.perturbations import Perturbation, accelerometers, perturbations
from calib.structure.located import placed_sensors
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.cache import basis_key, kept_basis
from calib.structure.reduction.effect_basis import weight_key
from calib.study.loading import Model


def local_perturbations(
    model: Model,
    measured: Sequence[MeasuredModes | MeasuredFRFs],
    values: Mapping[str, float],
    of: str = "",
) -> tuple[Perturbation, ...]:
    """Local perturbations that all tests of a model share: of its parts, and at every sensor of its tests.

    The last one is a fault of the tests, the mass of their accelerometers. A function shares none: its own depend on
    what a test measures, see `calib.hypotheses.function_perturbations`.

    Parameters
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
    measured : sequence of MeasuredModes or MeasuredFRFs
        The fitted data of each test with sensors.
    values : mapping
        Reference values, see `calib.structure.effects.perturbations.perturbations`; those of a test's nuisances are
        ignored.
    of : str
        Name of the model, where other models have perturbations of the same names.
    """
    if not isinstance(model, StructuralModel):
        return ()
    placed = {s.name: s for one in measured for s in placed_sensors(model, one.sensors)}
    values = {name: value for name, value in values.items() if name in model.space}
    sensors, lowest = list(placed.values()), min((one.lowest_freq for one in measured), default=0.0)
    return (*perturbations(model, sensors, values, lowest, of), *accelerometers(model, sensors, values, of))


def effects_basis(
    model: StructuralModel,
    space: ParameterSpace,
    effects: Sequence[Effect],
    local: Sequence[Perturbation],
    wanted: BasisRequirements,
    folder: Path | None = None,
    base: Callable[[], Basis] | None = None,
    progress: Progress = silent,
    at: Mapping[str, float] | None = None,
) -> Basis:
    """A basis for the effects and local perturbations of a model, kept in a folder and in the cache, or trained.

    Composed effects, of which there may be hundreds, count as local perturbations: the basis spans derivatives by them,
    not modes with each. The folder holds one such basis. ``base`` returns a basis of the model alone; by default that
    of the cache. One that serves near a point is made ``at`` that. EvaluationError when the model cannot be solved at
    some training point.
    """
    from calib.structure.effects.composed import OF_MATRICES  # where a basis is trained

    own = wanted.key(model, space)
    added = [addition_of(model, effect).digest() for effect in (*effects, *(one.effect for one in local))]
    solved = [e for e in effects if e.grid or not isinstance(e.build, OF_MATRICES)]
    nowhere = (math.nan, math.nan, math.nan)
    composed = [
        Perturbation(e, "composed", nowhere) for e in effects if not e.grid and isinstance(e.build, OF_MATRICES)
    ]
    effects, local = solved, [*local, *composed]
    sampled = [(e.name, [parameter_key(p) for p in e.parameters], e.plausible, e.grid) for e in effects]
    near = () if at is None else (sorted(at.items()),)
    key = basis_key(model, own, added, sampled, [weight_key(one) for one in local], *near)
    path = None if folder is None else folder / f"basis_effects_{key}.npz"

    def trained() -> Basis:
        of_model = base() if base else kept_basis(None, own, lambda: wanted.trained(model, space, progress))
        return wanted.with_effects(model, of_model, space, effects, local, progress, at)

    basis = kept_basis(path, key, trained)
    for old in () if folder is None else folder.glob("basis_effects_*.npz"):
        if old != path and is_own(old):
            old.unlink(missing_ok=True)
    return basis
