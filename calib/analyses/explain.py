"""Explanation: which physical effect a study's model lacks, with all tables and sentences on it."""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.analyses.added import to_add
from calib.analyses.compare import comparison_at
from calib.analyses.explained_fit import TABLE, explained_fits
from calib.analyses.failures import SHOWN, reasons
from calib.analyses.hypotheses_of_study import WIDENED, adapter_for, generic_note, near_fit, require_usable
from calib.analyses.provenance.record import begin_analysis, write_record
from calib.analyses.provenance.state import ADDED, EXPLAINED, PROPOSED
from calib.analyses.staged import stored_calibration
from calib.analyses.uncertain import uncertain_note
from calib.errors.errors import EvaluationError, InputError
from calib.execution.memory import giving_back
from calib.execution.outcome import as_cause, failure
from calib.execution.stage import Progress, silent
from calib.hypotheses.discretisation_error import mesh_words
from calib.hypotheses.joint import JointAdapter
from calib.inference.region import InfeasibleError
from calib.measurement.corrections import correctable
from calib.missing import decision as engine
from calib.missing.adapter import Adapter
from calib.missing.between_tests import BETWEEN
from calib.missing.candidate_fit import CandidateFit, WrongDatum
from calib.missing.data_words import GROUPS as UNSEEN_GROUPS
from calib.missing.discrepancy import COLUMNS, discrepancy, parameter_intervals
from calib.missing.effect_facts import decided_in_detail
from calib.missing.explanation import Explanation
from calib.missing.findings import ExplanationResult, findings
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.local import local_perturbation
from calib.missing.partial import is_simpler_form
from calib.missing.pattern import BY_TEST
from calib.missing.score import scores
from calib.missing.settings import Settings, require_enough
from calib.missing.verdict import NO_DOUBTS, Doubts
from calib.missing.verdict_words import with_full_stop
from calib.problem.candidate import Candidate
from calib.problem.joint import TEST, JointRows, of_test
from calib.results.results import Results
from calib.study.settings import ExplainSettings
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy


def explain(
    study: AnyStudy,
    results: Results,
    progress: Progress = silent,
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
    of_test = {one.test: homes.get(one.test, results) for one in tests}
    adapter, answer = explanation_of(study, progress, of_test, _begin(study, results))
    seeds = {"probabilities": study.settings.explain.seed, "reduction": study.settings.reduction.seed}
    of_all = {name: table for name, table in answer.tables.items() if TEST not in table or name in (BY_TEST, BETWEEN)}
    parts, whole = by_test(adapter, answer), replace(answer, tables=of_all)
    of_each = [(one, folders[one.test], parts[one.test]) for one in tests if one.test in parts]
    for part, folder, own in [(study, results, whole), *of_each]:
        write_explanation(part, folder, own)
        write_record(part, folder, "explain", seeds, answer=own.answer)
    return answer


def explanation_of(
    study: AnyStudy,
    progress: Progress = silent,
    homes: Mapping[str, Results] = MappingProxyType({}),
    begin: Mapping[str, float] | None = None,
) -> tuple[Adapter, ExplanationResult]:
    """The same without writing anything, with the adapter that it rests on; a study in memory has no ``homes``.

    ``begin`` are the values of a calibration, from which the fit of the model as it is begins.
    """
    tests, progress = study.studies, giving_back(progress)
    require_usable(study)
    pairs = {one.test: one.pair for one in tests}
    require_enough(JointRows(pairs).rows, len(study.search_space.free))
    started, stated = time.perf_counter(), study.settings.explain.mesh_sd
    mesh_sd = stated if any(one.states_mesh for one in tests) else None
    settings, near = study.settings.explain, begin or near_fit(study, progress)
    adapter = adapter_for(study, None, progress, homes, near or {})
    decided = decision(adapter, settings, study.file, progress, near)
    for _ in range(WIDENED):
        grown = adapter.covering([decided.base])
        if grown is not adapter:  # what the effects change there is not in it either
            near = decided.base.fit.values
            del adapter, grown, decided
            gc.collect()
            adapter = adapter_for(study, None, progress, homes, near)
        elif (grown := adapter.covering(decided.every)) is adapter:
            break
        else:
            adapter = grown
            del grown, decided
            gc.collect()  # models of a decision, which refer to each other, go before others are built
        decided = decision(adapter, settings, study.file, progress, near)
    adapter, decided = decision_in_detail(adapter, decided, settings, study.file, progress)
    answer = explain_tests(adapter, decided, started, mesh_words(mesh_sd), progress, _doubts(tests))
    own = ((*generic_note(one, answer.verdict), *uncertain_note(one)) for one in tests)
    taken = dict.fromkeys(note for notes in own for note in notes)
    if stated is not None and mesh_sd is None:
        taken[_MESH_OF_NUMBERS] = None
    adapter = granting(adapter, answer.explanation)
    figures = answer.figures if mesh_sd is None else answer.figures | {"mesh_sd": mesh_sd}
    fits = explained_fits(study, answer.explanation, answer.richer)
    tables, notes = answer.tables | {TABLE: fits}, (*answer.notes, *taken)
    return adapter, replace(answer, tables=tables, notes=notes, figures=figures)


_MESH_OF_NUMBERS = "The error of the mesh does not count here: an explanation knows it in modes and FRFs alone."


def _begin(study: AnyStudy, results: Results) -> dict[str, float] | None:
    """Values of the stored calibration of the study as it is; None without one, and where its tables are damaged."""
    with suppress(InputError):
        found = stored_calibration(study, results)
        return None if found is None else found.values
    return None


def has_misfit_intervals(study: AnyStudy) -> bool:
    """Whether `misfit_intervals` are known of its tests: of modes or FRFs of models of matrices."""
    return all(one.problem.reducible is not None for one in study.studies)


def misfit_intervals(
    study: AnyStudy,
    values: Mapping[str, float],
    progress: Progress = silent,
    homes: Mapping[str, Results] = MappingProxyType({}),
) -> pd.DataFrame:
    """Fitted parameters with 95 % intervals of the fit alone and with its misfit, without naming a cause of it.

    Every effect and every local perturbation is taken to be present a little, as in an explanation that leaves a misfit
    unexplained (see `calib.missing.discrepancy`), at a fit that begins at given values.

    Parameters
    ----------
    study : Study or JointStudy
    values : mapping from str to float
        Where the model was fitted.
    progress, homes
        As in `explain`, which uses the same reduced bases.

    Returns
    -------
    DataFrame
        `calib.missing.discrepancy.COLUMNS`; empty where a test is not one of modes or FRFs of a model of matrices, and
        where the fit cannot be evaluated.
    """
    if not has_misfit_intervals(study):
        return pd.DataFrame(columns=list(COLUMNS))
    progress("intervals with the misfit")
    try:
        hypotheses = adapter_for(study, None, progress, homes, values).hypotheses
        fit_problem = hypotheses.fit_problem(())
        start = {name: value for name, value in values.items() if name in fit_problem.space}
        fit = least_squares_fit(fit_problem, (), fit_problem.space.complete(start))
        every = [*hypotheses.effects, *hypotheses.perturbations]
        tested = scores(fit, every, {e.name: hypotheses.fit_problem((e.name,)) for e in every if e.grid})
    except (EvaluationError, InfeasibleError):
        return pd.DataFrame(columns=list(COLUMNS))
    table = parameter_intervals(fit, discrepancy(fit, tested) if len(tested.owners) else None)
    return table[table["parameter"].isin(study.search_space.free_names)].reset_index(drop=True)


def _doubts(tests: Sequence[LoadedStudy]) -> Doubts:
    """What a comparison at the nominal values doubts in the measurements; nothing where a model fails there."""
    sentences, checks, data = [], [], list[str]()
    for one in tests:
        if one.problem.reducible is None:
            continue  # a user's function would be called once more than the decision needs; a comparison tells the same
        try:
            found = comparison_at(one, one.model.space.values)
        except EvaluationError:
            continue
        whole = [with_full_stop(words) for words in found.doubts]
        sentences += [of_test(one.test, words) if one.test else words for words in whole]
        checks += [f"{what} in test {one.test}" if one.test else what for what in found.checks]
        twice = [mode for pair in found.found_twice for mode in (pair.first, pair.second)]
        data += [f"mode {of_test(one.test, mode) if one.test else mode}" for mode in twice]
    return Doubts(tuple(sentences), tuple(checks), tuple(data))


def explain_tests(
    adapter: Adapter,
    decided: Explanation,
    started: float,
    supposed: Sequence[str] = (),
    progress: Progress = silent,
    doubts: Doubts = NO_DOUBTS,
) -> ExplanationResult:
    """What a decision has found; arguments as in `findings`."""
    adapter = granting(adapter, decided)
    answer = findings(adapter, decided, started, supposed, correctable, progress, doubts)
    failures = reasons(adapter.failed())[:SHOWN]
    return replace(answer, traces=tuple(reason.first.trace for reason in failures if reason.first.trace))


def granting(adapter: Adapter, found: Explanation) -> Adapter:
    """The adapter whose base model has the faults of the measurement that an explanation tells among its parameters."""
    return adapter.granting([fault.name for fault in found.granted]) if found.granted else adapter


def decision(
    adapter: Adapter,
    requested: ExplainSettings,
    place: str | Path,
    progress: Progress = silent,
    begin: Mapping[str, float] | None = None,
) -> Explanation:
    """The decision with the settings of a study; InputError, with the study's place, where no model can be fitted."""
    settings = Settings(
        requested.alpha, requested.refits, requested.merge, requested.seed, adapter.budget_of_fits, begin
    )  # fmt: skip
    try:
        return engine.decide(adapter.hypotheses, settings, progress)
    except EvaluationError as fault:
        words, first = _not_fitted(adapter, fault)
        own = first.at is not None or as_cause(first) is not None
        remedy = "correct the function that fails" if own else "check values, limits and supports"
        words = f"the model cannot be fitted: {words}"
        raise InputError(words, place=place, remedy=remedy, at=first.at) from as_cause(first)


def decision_in_detail(
    adapter: Adapter, found: Explanation, requested: ExplainSettings, place: str | Path, progress: Progress = silent
) -> tuple[Adapter, Explanation]:
    """See `calib.missing.effect_facts.decided_in_detail`, with the settings of a study."""

    def again(grown: Adapter) -> Explanation:
        return decision(grown, requested, place, progress, found.base.fit.values)

    return decided_in_detail(adapter, found, again, progress)


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


GROUPS = ("fit", *UNSEEN_GROUPS)
"""Groups of data whose errors are reported."""


def by_test(adapter: Adapter, answer: ExplanationResult) -> dict[str, ExplanationResult]:
    """The result as each of several tests sees it; empty for a single test, which is no part of another."""
    if not isinstance(adapter, JointAdapter):
        return {}
    return {test: _of_test(adapter, test, answer) for test in adapter.adapters}


def _of_test(adapter: JointAdapter, test: str, answer: ExplanationResult) -> ExplanationResult:
    """The result for one test: its own errors, in the stages of the joint ones, and its own rows."""
    found = answer.explanation
    last = next((stage for stage in answer.errors["stage"] if stage != "before"), "")
    stages = {"before": found.base} | ({last: found.chosen} if last and found.chosen is not None else {})
    errors = adapter.adapters[test].errors(adapter.fits_of(test, stages), found.noise_scale)[0]
    errors = errors[list(answer.errors.columns.drop("std_from"))].assign(std_from=answer.errors["std_from"].iloc[0])
    tables = {}
    for name, table in answer.tables.items():
        own = table[table[TEST] == test].drop(columns=TEST) if TEST in table else table
        if TEST not in table or len(own):
            tables[name] = own
    return replace(answer, errors=errors, tables=tables)


def explanation_summary(study: AnyStudy, answer: ExplanationResult) -> dict[str, object]:
    """``explanation.json``."""
    found, check = answer.explanation, answer.explanation.base_adequacy
    columns = (
        "name", "z", "unabsorbed", "magnitude", "magnitude_low", "magnitude_high", "magnitude_min", "ln_bayes",
        "model_probability", "held_out_gain", "implausible", "confounded_with",
    )  # fmt: skip
    errors: dict[str, dict[str, float | None]] = {group: {"before": None, "after": None} for group in GROUPS}
    for row in answer.errors[answer.errors["stage"] != "attempt"].to_dict("records"):
        errors[str(row["group"])][str(row["stage"])] = float(row["rms"])
    chosen, fits = found.chosen, found.chosen_adequacy if found.fault_adequacy is None else found.fault_adequacy
    named = to_add(found)
    return {
        "study": study.name,
        "synthetic": study.synthetic,
        "verdict": found.verdict,
        "sentence": answer.sentence,
        "sentences": list(answer.sentences),
        "notes": list(answer.notes),
        "doubts": [doubt._asdict() for doubt in answer.doubts],
        "alpha": found.alpha,
        "p_family": check.p_family,
        "p_fit": check.p_fit,
        "credible_set": list(found.credible),
        "effects": answer.effects[list(columns)].replace(np.inf, np.nan).to_dict("records"),
        "chosen": [] if chosen is None else list(chosen.names),
        "to_add": [] if named is None else list(named.names),
        "chosen_values": {} if chosen is None else {n: chosen.fit.values[n] for e in chosen.effects for n in e.names},
        "adequacy_p": None if fits is None else min(fits.p_family, fits.p_fit),
        "adequacy_p_family": None if fits is None else fits.p_family,
        "adequacy_p_fit": None if fits is None else fits.p_fit,
        "noise_scale": found.noise_scale,
        "measured_noise_scale": found.measured_scale,
        "local_perturbations": len(set(check.perturbations.owners)),
        "local_perturbation": None if found.perturbation is None else _local_perturbation(found.perturbation),
        "place": None if found.place is None else found.place.names[0],
        "refused": found.refused or None,
        "nearly": is_simpler_form(found),
        "measurement_fault": None if found.fault is None else _local_perturbation(found.fault),
        "faults": 0 if check.faults is None else len(set(check.faults.owners)),
        "pair_faults": 0 if check.pairs is None else check.pairs.number,
        "blamed": [_local_perturbation(t, fault) for fault, t in found.faulty],
        "wrong_datum": None if found.datum is None else _wrong_datum(found, found.datum),
        "evaluations": found.evaluations,
        "begun_anew": found.begun_anew,
        "errors": errors,
        "seconds": answer.seconds,
        **answer.figures,
    }


def _local_perturbation(perturbation: CandidateFit, of: Candidate | None = None) -> dict[str, object]:
    change = local_perturbation(perturbation, of)
    unit = change.effect.magnitude.unit
    return {"name": change.effect.name, "value": change.value, "low": change.low, "high": change.high, "unit": unit}


def _wrong_datum(found: Explanation, datum: WrongDatum) -> dict[str, object]:
    return {"what": datum.what, "kind": datum.kind, "ln_bayes": datum.ln_evidence - found.base.ln_evidence}
