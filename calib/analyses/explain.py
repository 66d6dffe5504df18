"""Explanation: which physical effect a study's model lacks, with all tables and sentences on it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from calib.analyses.explained_fit import TABLE, explained_fits
from calib.analyses.explanation_result import by_test, explanation_summary
from calib.analyses.failures import SHOWN, reasons
from calib.analyses.hypotheses_of_study import adapter_of, perturbations_of
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.state import ADDED, EXPLAINED, PROPOSED
from calib.analyses.uncertain import uncertain_note, with_uncertain
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import as_cause, failure
from calib.execution.stage import Progress, unheard
from calib.hypotheses.joint import together
from calib.hypotheses.mesh_term import mesh_words, with_mesh_error
from calib.measurement.corrections import correctable
from calib.missing import decision as engine
from calib.missing.between_tests import BETWEEN
from calib.missing.explanation import Explanation
from calib.missing.findings import ExplanationResult, findings
from calib.missing.pattern import BY_TEST
from calib.missing.settings import Settings, require_modes
from calib.missing.test import Adapter
from calib.problem.effect import Effect
from calib.problem.joint import TEST
from calib.results.results import Results
from calib.study.loading import Model, with_effects
from calib.study.settings import ExplainSettings
from calib.study.several import AnyStudy
from calib.study.study import Study


def explain(
    study: AnyStudy,
    results: Results,
    progress: Progress = unheard,
    homes: Mapping[str, Results] = MappingProxyType({}),
    folders: Mapping[str, Results] = MappingProxyType({}),
) -> ExplanationResult:
    """Find which effect of the study's library its model lacks; write all tables and ``explanation.json``.

    Without a library, or with all of it in the model, only local perturbations are tested. Several tests are explained
    together: an effect acts in every test whose library has it.

    Parameters
    ----------
    study : Study or JointStudy
    results : Results
    progress : callable
        Called with a description of each step.
    homes : mapping from str to Results
        By name of the test: they hold the reduced bases, which full and quick runs share; by default ``results``.
    folders : mapping from str to Results
        By name of the test: they take the results of each of several tests.

    Raises
    ------
    InputError
        When there are too few measured data.
    """
    tests = study.studies
    adapter, answer = explanation_of(study, progress, {one.test: homes.get(one.test, results) for one in tests})
    seeds = {"probabilities": study.settings.explain.seed, "reduction": study.settings.reduction.seed}
    of_all = {name: table for name, table in answer.tables.items() if TEST not in table or name in (BY_TEST, BETWEEN)}
    parts, whole = by_test(adapter, answer), replace(answer, tables=of_all)
    of_each = [(one, folders[one.test], parts[one.test]) for one in tests if one.test in parts]
    for part, folder, own in [(study, results, whole), *of_each]:
        write_explanation(part, folder, own)
        write_record(part, folder, "explain", seeds, answer=own.answer)
    return answer


def explanation_of(
    study: AnyStudy, progress: Progress = unheard, homes: Mapping[str, Results] = MappingProxyType({})
) -> tuple[Adapter, ExplanationResult]:
    """The same without writing anything, with the adapter that it rests on; a study in memory has no ``homes``."""
    tests = study.studies
    require_usable([(one.model, one.candidates) for one in tests], str(study.file))
    if any(one.measured is not None for one in tests):
        require_modes(sum(one.problem.n_measured for one in tests))
    started, mesh_sd = time.perf_counter(), study.settings.explain.mesh_sd
    adapter = adapter_for(study, None, progress, homes)
    answer = explain_tests(adapter, study.settings.explain, study.file, started, mesh_words(mesh_sd), progress)
    taken = dict.fromkeys(note for one in tests for note in uncertain_note(one))
    figures = answer.figures if mesh_sd is None else answer.figures | {"mesh_sd": mesh_sd}
    fits = explained_fits(study, answer.explanation, answer.richer)
    tables, notes = answer.tables | {TABLE: fits}, (*answer.notes, *taken)
    return adapter, replace(answer, tables=tables, notes=notes, figures=figures)


def adapter_for(study: AnyStudy, results: Results | None, progress: Progress, homes: Mapping[str, Results]) -> Adapter:
    """All tests of a study, with stated errors of its models; arguments as in `explain`."""
    return together(adapters_for(study, results, progress, homes))


def adapters_for(
    study: AnyStudy,
    results: Results | None = None,
    progress: Progress = unheard,
    homes: Mapping[str, Results] = MappingProxyType({}),
) -> dict[str, Adapter]:
    """The same test by test."""
    local, mesh_sd = perturbations_of(study), study.settings.explain.mesh_sd
    adapters = {
        s.test: adapter_of(with_uncertain(s), homes.get(s.test, results), progress, local[s.test], study.held_sd)
        for s in study.studies
    }
    if mesh_sd is not None:
        progress("error of the mesh")
        adapters |= {s.test: _with_mesh(adapters[s.test], s, mesh_sd) for s in study.studies if s.states_mesh}
    return adapters


def _with_mesh(adapter: Adapter, study: Study, sd: float) -> Adapter:
    try:
        return with_mesh_error(adapter, study.finer_model(), sd, study.test)
    except InputError as fault:
        place = study.place("explain", "mesh_sd")
        raise InputError(fault.problem, place=place, remedy=fault.remedy) from None


def require_usable(libraries: Iterable[tuple[Model, Sequence[Effect]]], place: str) -> None:
    """InputError, before any solve, where an effect cannot be built or two models have different ones of one name."""
    known: dict[str, Effect] = {}
    for model, effects in libraries:
        for effect in (one for simplest in effects for one in simplest.family):
            with_effects(model, [effect], place)
            other = known.setdefault(effect.name, effect)
            if other.parameters != effect.parameters:
                raise InputError(
                    f"two models have different effects {effect.name!r}", place=place,
                    remedy="give one of them another name, or both the same parameters",
                )  # fmt: skip


def explain_tests(
    adapter: Adapter,
    settings: ExplainSettings,
    place: str | Path,
    started: float,
    supposed: Sequence[str] = (),
    progress: Progress = unheard,
) -> ExplanationResult:
    """The decision about tests with its findings, whoever asks; arguments as in `decision` and `findings`."""
    decided = decision(adapter, settings, place, progress)
    answer = findings(adapter, decided, started, supposed, correctable, progress)
    failures = reasons(adapter.failed())[:SHOWN]
    return replace(answer, traces=tuple(reason.first.trace for reason in failures if reason.first.trace))


def decision(
    adapter: Adapter, requested: ExplainSettings, place: str | Path, progress: Progress = unheard
) -> Explanation:
    """The decision with the settings of a study; InputError, with the study's place, where no model can be fitted."""
    settings = Settings(
        requested.alpha, requested.refits, requested.merge, requested.seed, adapter.budget_of_fits
    )  # fmt: skip
    try:
        return engine.decide(adapter.hypotheses, settings, progress)
    except EvaluationError as fault:
        words, first = _not_fitted(adapter, fault)
        own = first.at is not None or as_cause(first) is not None
        remedy = "correct the function that fails" if own else "check values, limits and supports"
        words = f"the model cannot be fitted: {words}"
        raise InputError(words, place=place, remedy=remedy, at=first.at) from as_cause(first)


def _not_fitted(adapter: Adapter, fault: EvaluationError) -> tuple[str, EvaluationError]:
    """Why nothing could be fitted, and the commonest failure of a point, or the given one where no point failed."""
    words, failed = str(fault), adapter.failed()
    if not failed:
        return words, fault
    common = reasons(failed)[0]
    if common.error not in words:
        words = f"{words}; {len(failed)} point{'s' * (len(failed) > 1)} failed, most with {common.error}"
    return words, failure(common.first)


def write_explanation(study: AnyStudy, results: Results, answer: ExplanationResult) -> None:
    """Write all tables of an explanation and ``explanation.json``; those that only another verdict has go."""
    begin_analysis(results, "explain")
    results.remove(*ADDED, *PROPOSED, *(f"{name}.csv" for name in EXPLAINED if name != "versions"))
    results.write_table("effects", answer.effects)
    results.write_table("errors", answer.errors)
    for name, table in answer.tables.items():
        results.write_table(name, table)
    results.write_json("explanation", explanation_summary(study, answer))
