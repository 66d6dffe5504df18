"""Hypotheses of a study: its tests as an explanation sees them, with their effects, perturbations and faults."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from calib.analyses.fit_statistics import fit_problem
from calib.analyses.joint_responses import own_values
from calib.analyses.least_squares import ended
from calib.analyses.provenance.record import check_repeats, disagreements_table
from calib.analyses.reduction import (
    Reduction,
    is_followed,
    point_near,
    reduction_near,
    reduction_of,
    training,
    worthwhile,
)
from calib.analyses.uncertain import with_uncertain
from calib.analyses.uncertainty import accuracy_words, assumed_words, std_notes
from calib.correlation.basis import BasisRequirements
from calib.correlation.modal.fault_library import modal_faults
from calib.correlation.modal.faults import ModalFault
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import InputError, ToleranceError
from calib.execution.stage import Progress, silent
from calib.experiment import FRFTest, ModalTest
from calib.experiment.test import ForwardProblem
from calib.hypotheses.discretisation_error import with_mesh_error
from calib.hypotheses.function_perturbations import model_hypotheses
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.joint import joined_adapter
from calib.hypotheses.library import effects_basis, local_perturbations
from calib.hypotheses.modal import ModalAdapter
from calib.hypotheses.scalar import FRFAdapter, ScalarAdapter
from calib.missing.adapter import Adapter
from calib.missing.explanation import OPEN
from calib.missing.facts import MeasurementFacts
from calib.problem.effect import Effect
from calib.results.results import Results
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.study.loading import with_effects
from calib.study.measurement_settings import GENERIC
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy

Local = tuple[Perturbation, ...]
Near = Mapping[str, float] | None


def require_usable(study: AnyStudy, composed: bool = True) -> None:
    """InputError, before any solve, where an effect cannot be built, or two models have different ones of one name.

    Those that are ``composed`` of the models' own parts, which can be hundreds, are left out on request.
    """
    known, place = dict[str, Effect](), str(study.file)
    for one in study.studies:
        model, effects = one.model, [effect for effect in one.candidates if composed or not effect.generic]
        every = [member for simplest in effects for member in simplest.family]
        try:
            with_effects(model, effects, place)  # hundreds at once
            of_family = (member for simplest in effects for member in simplest.family if member is not simplest)
            alone = [member for member in of_family if not member.generic]  # these are made to fit
        except InputError:
            alone = every  # to tell which one does not fit
        for effect in alone:
            with_effects(model, [effect], place)
        for effect in every:
            other = known.setdefault(effect.name, effect)
            if other.parameters != effect.parameters:
                raise InputError(
                    f"two models have different effects {effect.name!r}", place=place,
                    remedy="give one of them another name, or both the same parameters",
                )  # fmt: skip


def adapter_for(
    study: AnyStudy,
    results: Results | None,
    progress: Progress,
    homes: Mapping[str, Results],
    near: Mapping[str, float] | None = None,
) -> Adapter:
    """All tests of a study, with stated errors of its models, ``near`` some values where least squares are followed.

    Where a search needs no basis within all limits, one is made about those values; see
    `calib.analyses.reduction.is_followed`. Other arguments are as in `calib.analyses.explain.explain`.
    """
    return joined_adapter(adapters_for(study, results, progress, homes, near))


WIDENED = 4
"""Times that a basis grows where fits have led: of a base model, and of a decision, which is made again."""


def near_fit(study: AnyStudy, progress: Progress = silent) -> dict[str, float] | None:
    """Values to which least squares lead from the nominal ones, on reduced bases that grow there.

    The base model is fitted near them, so that bases of effects are made there once. None where some test has no such
    basis, or its model cannot be evaluated.
    """
    bases: dict[str, Reduction] = {}
    for one in study.studies:
        found = reduction_near(one) if is_followed(one) else None
        if found is None:
            return None
        bases[one.test] = found
    values = dict(study.search_space.values)
    for _ in range(WIDENED):
        progress("calibrating the base model")
        instead: dict[str, ForwardProblem] = {test: basis.problem for test, basis in bases.items()}
        end = ended(fit_problem(study, None, instead), [values], 1)
        if end is None:
            return None
        values, before = dict(end.best.values), dict(bases)
        for one in study.studies:
            own = own_values(one, values) if len(study.studies) > 1 else values
            bases[one.test] = bases[one.test].covering([own])
        if all(bases[test] is before[test] for test in bases):
            break
    return values


def adapters_for(
    study: AnyStudy,
    results: Results | None = None,
    progress: Progress = silent,
    homes: Mapping[str, Results] = MappingProxyType({}),
    near: Mapping[str, float] | None = None,
) -> dict[str, Adapter]:
    """The same test by test."""
    local, mesh_sd = perturbations_of(study), study.settings.explain.mesh_sd
    free = [with_uncertain(s) for s in study.studies]
    held_sd = {name: sd for s in free for name, sd in s.held_sd.items()}
    adapters = {s.test: adapter_of(s, homes.get(s.test, results), progress, local[s.test], held_sd, near) for s in free}
    if mesh_sd is not None:
        progress("error of the mesh")
        adapters |= {s.test: _with_mesh(adapters[s.test], s, mesh_sd) for s in study.studies if s.states_mesh}
    return adapters


def _with_mesh(adapter: Adapter, study: LoadedStudy, sd: float) -> Adapter:
    try:
        return with_mesh_error(adapter, study.finer_model(), sd, study.test)
    except InputError as fault:
        place = study.place("explain", "mesh_sd")
        raise InputError(fault.problem, place=place, remedy=fault.remedy) from None


def adapter_of(
    study: LoadedStudy,
    home: Results | None,
    progress: Progress,
    local: Local,
    held_sd: Mapping[str, float] | None = None,
    near: Mapping[str, float] | None = None,
) -> Adapter:
    """The adapter of a study's test: that of its kind, else that of data that are compared value by value.

    ``local`` are the perturbations that the tests of its model share; ``held_sd`` are the standard deviations of the
    held parameters of all tests, by default of this one; ``near`` is as in `adapter_for`.
    """
    facts = facts_of(study)
    facts = facts if held_sd is None else replace(facts, held_sd=held_sd)
    made = next((made for kind, made in _OF_TEST.items() if isinstance(study.experiment, kind)), _of_values)
    return made(study, home, progress, local, facts, near if is_followed(study) else None)


def _of_values(
    study: LoadedStudy, home: Results | None, progress: Progress, local: Local, facts: MeasurementFacts, near: Near
) -> ScalarAdapter:
    pair: Any = study.pair
    space = study.search_space.without(study.condition)
    found, own = model_hypotheses(study.solved_model, pair, study.candidates, local, space, study.test)
    return ScalarAdapter(found, own, facts, study.unseen)


def _of_frfs(
    study: LoadedStudy, home: Results | None, progress: Progress, local: Local, facts: MeasurementFacts, near: Near
) -> FRFAdapter:
    pair: Any = study.pair
    basis, space = basis_of(study, home, local, progress), study.search_space.without(study.condition)
    return FRFAdapter.of(
        pair.suspected(study.test), study.candidates, local, space, facts, study.unseen, basis, worthwhile(study),
        study.finer_model,
    )  # fmt: skip


def _of_modes(
    study: LoadedStudy, home: Results | None, progress: Progress, local: Local, facts: MeasurementFacts, near: Near
) -> ModalAdapter:
    found, own = modal_hypotheses(study, home, progress, local, near)
    point = None if near is None or found.variants.basis is None else point_near(study, near)
    whole, finer = study.whole_problem(), study.finer_model
    return ModalAdapter(found, own, facts, whole, finer, reduced=worthwhile(study), near=point)


_OF_TEST: Mapping[type, Callable[..., Adapter]] = {
    FRFTest: _of_frfs,
    ModalTest: _of_modes,
}


def perturbations_of(study: AnyStudy) -> dict[str, Local]:
    """Local perturbations by test: those of one model of matrices are the same in all tests of it.

    A function shares none.
    """
    groups: dict[str, list[LoadedStudy]] = {}
    for one in study.studies:
        if isinstance(one.model, StructuralModel):
            groups.setdefault(one.model_key, []).append(one)
    out: dict[str, Local] = {one.test: () for one in study.studies}
    for group in groups.values():
        first, used = group[0], [data for one in group for data in one.experiment.sensed]
        of = first.model_label if len(groups) > 1 else ""
        found = local_perturbations(first.model, used, first.search_space.values, of)
        out |= {one.test: found for one in group}
    return out


def modal_hypotheses(
    study: LoadedStudy,
    results: Results | None,
    progress: Progress = silent,
    local: tuple[Perturbation, ...] | None = None,
    near: Near = None,
) -> tuple[ModelHypotheses[ModalResidual], tuple[Perturbation, ...]]:
    """Hypotheses of a study with modes, and its local perturbations; those of matrices are by default of its own test.

    A basis trained earlier is read from the results folder, or from the cache.
    """
    problem = study.problem
    assert isinstance(problem, ModalProblem)
    if local is None:
        local = local_perturbations(study.model, [problem.measured], study.search_space.values)
    basis, pair = basis_of(study, results, local, progress, near), ModalResidual(problem, faults=faults_of(study))
    space = study.search_space.without(study.condition)
    return model_hypotheses(
        problem.model, pair, study.candidates, local, space, study.test, basis
    )  # perhaps behind a ledger


def faults_of(study: LoadedStudy) -> tuple[ModalFault, ...]:
    """Faults that the measured modes of a study may have."""
    problem, experiment = study.problem, study.experiment
    assert isinstance(experiment, ModalTest)
    assert isinstance(problem, ModalProblem)
    return modal_faults(problem.model, problem.measured, experiment.set_ups, study.test)


def basis_of(
    study: LoadedStudy,
    results: Results | None,
    local: Sequence[Perturbation],
    progress: Progress = silent,
    near: Near = None,
) -> Basis | None:
    """A basis for a study with its effects and local perturbations, within its limits or about values ``near``.

    None where none is worthwhile, or none reaches its tolerance: then the full model is used, and the adapter notes it.
    """
    problem: Any = study.problem
    model = study.problem.reducible
    if model is None or not worthwhile(study):
        return None
    progress("reduced basis for the effects")

    def search_basis() -> Basis:
        # a search trained it, or will need it
        found = reduction_of(study, results, progress) if near is None else reduction_near(study, near)
        assert found is not None
        return found.basis

    settings = study.settings.reduction
    space, wanted = study.search_space, BasisRequirements.of(problem, settings.tolerance, settings.seed)
    with training(study), contextlib.suppress(ToleranceError):
        return effects_basis(
            model, space, study.candidates, local, wanted, None if results is None else results.path, search_basis,
            progress, None if near is None else point_near(study, near),
        )  # fmt: skip
    return None


def facts_of(study: LoadedStudy) -> MeasurementFacts:
    """The facts about a study's measurement."""
    own, experiment = study.settings.explain, study.experiment
    modes = experiment.modes if isinstance(experiment, ModalTest) else None
    return MeasurementFacts(
        assumed_words(study), accuracy_words(study),
        (*corrections(study), *std_notes(study), *check_repeats(study)),
        disagreements_table(study), study.held_sd, own.seed, own.samples,
        {} if modes is None else dict(zip(modes.names, modes.natural_freq.tolist(), strict=True)),
    )  # fmt: skip


def corrections(study: LoadedStudy) -> tuple[str, ...]:
    """Notes on the faults that are taken out of the measurement on reading."""
    faults = study.settings.measurement.corrected
    return tuple(f"The measurement is corrected for {name} = {by:g}." for name, by in faults.items())


def generic_note(study: LoadedStudy, verdict: str) -> tuple[str, ...]:
    """That effects were composed and how many, in words; where a misfit is left without a library, that they can be."""
    libraries, of = study.settings.libraries, "generic effects of the model's own parts, joints, supports and points"
    if libraries == (GENERIC,):
        tested = f"No list of causes was given: {len(study.candidates)} {of} were tested"
        return (f"{tested}. Names and plausible sizes are calib's.",)
    if GENERIC in libraries:
        return (f"Beside the list, {of} were tested.",)
    if study.library or verdict not in OPEN or not isinstance(study.model, StructuralModel):
        return ()
    return (f'No list of causes was given: effects = "{GENERIC}" tests {of}.',)
