"""Hypotheses of a study with matrices: effects, local perturbations, and a reduced basis that represents them all."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.analyses.reduction import Wanted, parameter_key, reduction_of, training, worthwhile
from calib.correlation.modal.fault_library import modal_faults
from calib.correlation.modal.faults import ModalFault
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import ToleranceError
from calib.execution.stage import Progress, unheard
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.model_hypotheses import hypotheses
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes
from calib.problem.effect import Effect
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.results.written import is_own
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import Perturbation, accelerometers, perturbations
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.cache import kept_basis, key_of
from calib.structure.reduction.effect_basis import weight_key
from calib.study.loading import Model
from calib.study.study import Study


def local_perturbations(
    model: Model,
    measured: Sequence[MeasuredModes | MeasuredFRFs],
    values: Mapping[str, float],
    of: str = "",
) -> tuple[Perturbation, ...]:
    """Local perturbations that all tests of a model share: of its parts, and at every sensor of its tests.

    The last one is a fault of the tests, the mass of their accelerometers. A function shares none: its own depend on
    what a test measures, see `calib.hypotheses.function_hypotheses`.

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
    placed = {s.name: s for one in measured for s in one.sensors if s.point is not None}
    values = {name: value for name, value in values.items() if name in model.space}
    sensors, lowest = list(placed.values()), min((one.lowest_freq for one in measured), default=0.0)
    return (*perturbations(model, sensors, values, lowest, of), *accelerometers(model, sensors, values, of))


def modal_hypotheses(
    study: Study,
    results: Results,
    progress: Progress = unheard,
    local: tuple[Perturbation, ...] | None = None,
) -> tuple[ModelHypotheses[ModalResidual], tuple[Perturbation, ...]]:
    """Hypotheses of a study with modes, and its local perturbations; those of matrices are by default of its own test.

    A basis trained earlier is read from the results folder, or from the cache.
    """
    problem = study.problem
    assert isinstance(problem, ModalProblem)
    if local is None:
        local = local_perturbations(study.model, [problem.measured], study.search_space.values)
    basis, pair = basis_of(study, results, local, progress), ModalResidual(problem, faults=faults_of(study))
    space = study.search_space.without(study.condition)
    return hypotheses(problem.model, pair, study.candidates, local, space, study.test, basis)  # perhaps behind a ledger


def faults_of(study: Study) -> tuple[ModalFault, ...]:
    """Faults that the measured modes of a study may have."""
    problem, set_ups = study.problem, study.settings.measurement.set_ups
    assert isinstance(problem, ModalProblem)
    return modal_faults(problem.model, problem.measured, set_ups, study.test)


def basis_of(
    study: Study, results: Results, local: Sequence[Perturbation], progress: Progress = unheard
) -> Basis | None:
    """A basis for a study with its effects and local perturbations.

    None where none is worthwhile, or none reaches its tolerance: then the full model is used, and the adapter notes it.
    """
    problem: Any = study.problem
    model = study.problem.reducible
    if model is None or not worthwhile(study):
        return None
    progress("reduced basis for the effects")

    def search_basis() -> Basis:
        found = reduction_of(study, results, progress)  # a search trained it, or will need it
        assert found is not None
        return found.basis

    settings = study.settings.reduction
    space, wanted = study.search_space, Wanted.of(problem, settings.tolerance, settings.seed)
    with training(study), contextlib.suppress(ToleranceError):
        return effects_basis(
            model, space, study.candidates, local, wanted, results.path, search_basis, progress
        )  # fmt: skip
    return None


def effects_basis(
    model: StructuralModel,
    space: ParameterSpace,
    effects: Sequence[Effect],
    local: Sequence[Perturbation],
    wanted: Wanted,
    folder: Path | None = None,
    base: Callable[[], Basis] | None = None,
    progress: Progress = unheard,
) -> Basis:
    """A basis for the effects and local perturbations of a model, kept in a folder and in the cache, or trained.

    The folder holds one such basis. ``base`` returns a basis of the model alone; by default that of the cache.
    EvaluationError when the model cannot be solved at some training point.
    """
    own = wanted.key(model, space)
    whole = extend(model, [*effects, *(one.effect for one in local)])
    sampled = [(e.name, [parameter_key(p) for p in e.parameters], e.plausible, e.grid) for e in effects]
    key = key_of(whole, own, sampled, [weight_key(one) for one in local])
    path = None if folder is None else folder / f"basis_effects_{key}.npz"

    def trained() -> Basis:
        of_model = base() if base else kept_basis(None, own, lambda: wanted.trained(model, space, progress))
        return wanted.with_effects(model, of_model, space, effects, local, progress)

    basis = kept_basis(path, key, trained)
    for old in () if folder is None else folder.glob("basis_effects_*.npz"):
        if old != path and is_own(old):
            old.unlink(missing_ok=True)
    return basis
