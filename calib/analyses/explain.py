"""Explanation: which physical effect a study's model lacks, with all tables and sentences on it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pandas as pd

from calib.analyses.explained_fit import TABLE, explained_fits
from calib.analyses.explanation_result import ExplanationResult, summary
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
from calib.missing import explain as engine
from calib.missing.accuracy import changing, less_accurate
from calib.missing.accuracy import sentence as accuracy_sentence
from calib.missing.between_tests import BETWEEN
from calib.missing.by_test import BY_TEST, reduction_table
from calib.missing.detailed import richer_next, richer_sentence, richer_tables
from calib.missing.effect_facts import detectable, gains, untested
from calib.missing.enough import require_modes
from calib.missing.explanation import Explanation
from calib.missing.fault_table import faults_table
from calib.missing.found_place import FOUND_PLACES, found_places, places_sentence
from calib.missing.held_out import contradicting
from calib.missing.left import left_of
from calib.missing.pattern import parameter_table, pattern_table, place_table
from calib.missing.profile import profile_interval
from calib.missing.recommendation import COLUMNS as RECOMMENDATION_COLUMNS
from calib.missing.recommendation import Interval, Recommendation, recommend, recommendation
from calib.missing.richer import richer_members
from calib.missing.score import noise_limit
from calib.missing.steps_table import step_fits, steps_tables
from calib.missing.suspect import sentence as suspect_sentence
from calib.missing.tables import candidate_fits_table, confounding_table, effects_table, misfit_table, pull_table
from calib.missing.test import Adapter
from calib.missing.unexplained import unexplained
from calib.missing.verdict import verdict
from calib.missing.verdict_words import elsewhere, limits_sentence
from calib.missing.worst_misfit import misfit_at
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
    require_usable([(one.model, one.candidates) for one in tests], str(study.file))
    if any(one.measured is not None for one in tests):
        require_modes(sum(one.problem.n_measured for one in tests))
    started, mesh_sd = time.perf_counter(), study.settings.explain.mesh_sd
    adapter = adapter_for(study, results, progress, homes)
    found = decided(adapter, study.settings.explain, study.file, progress)
    answer = answered(adapter, found, progress, started, mesh_words(mesh_sd))
    taken = dict.fromkeys(note for one in tests for note in uncertain_note(one))
    figures = answer.figures if mesh_sd is None else answer.figures | {"mesh_sd": mesh_sd}
    tables, notes = answer.tables | {TABLE: explained_fits(study, found, answer.richer)}, (*answer.notes, *taken)
    answer = replace(answer, tables=tables, notes=notes, figures=figures)
    seeds = {"probabilities": study.settings.explain.seed, "reduction": study.settings.reduction.seed}
    of_all = {name: table for name, table in answer.tables.items() if TEST not in table or name in (BY_TEST, BETWEEN)}
    parts, whole = adapter.by_test(answer), replace(answer, tables=of_all)
    seen = [(one, folders[one.test], parts[one.test]) for one in tests if one.test in parts]
    for part, folder, own in [(study, results, whole), *seen]:
        keep(part, folder, own)
        write_record(part, folder, "explain", seeds, answer=own.answer)
    return answer


def adapter_for(study: AnyStudy, results: Results, progress: Progress, homes: Mapping[str, Results]) -> Adapter:
    """All tests of a study, with stated errors of its models; arguments as in `explain`."""
    local, mesh_sd = perturbations_of(study), study.settings.explain.mesh_sd
    adapters = {
        s.test: adapter_of(with_uncertain(s), homes.get(s.test, results), progress, local[s.test], study.held_sd)
        for s in study.studies
    }
    if mesh_sd is not None:
        progress("error of the mesh")
        adapters = {s.test: _with_mesh(adapters[s.test], s, mesh_sd) for s in study.studies}
    return together(adapters)


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


def decided(adapter: Adapter, given: ExplainSettings, place: str | Path, progress: Progress = unheard) -> Explanation:
    """The decision with given settings; InputError, with the study's place, where no model can be fitted."""
    settings = engine.Settings(given.alpha, given.refits, given.merge, given.seed, adapter.budget_of_fits)
    try:
        return engine.explain(adapter.hypotheses, settings, progress)
    except EvaluationError as fault:
        words, first = _not_fitted(adapter, fault)
        own = first.at is not None or as_cause(first) is not None
        remedy = "correct the function that fails" if own else "check values, limits and supports"
        words = f"the model cannot be fitted: {words}"
        raise InputError(words, place=place, remedy=remedy, at=first.at) from as_cause(first)


def keep(study: AnyStudy, results: Results, answer: ExplanationResult) -> None:
    """Write all tables of an explanation and ``explanation.json``; those that only another verdict has go."""
    begin_analysis(results, "explain")
    results.remove(*ADDED, *PROPOSED, *(f"{name}.csv" for name in EXPLAINED if name != "versions"))
    results.write_table("effects", answer.effects)
    results.write_table("errors", answer.errors)
    for name, table in answer.tables.items():
        results.write_table(name, table)
    results.write_json("explanation", summary(study, answer))


def _not_fitted(adapter: Adapter, fault: EvaluationError) -> tuple[str, EvaluationError]:
    """Why nothing could be fitted, and the commonest failure of a point, or the given one where no point failed."""
    words, failed = str(fault), adapter.failed()
    if not failed:
        return words, fault
    common = reasons(failed)[0]
    if common.error not in words:
        words = f"{words}; {len(failed)} point{'s' * (len(failed) > 1)} failed, most with {common.error}"
    return words, failure(common.first)


def answered(
    adapter: Adapter, found: Explanation, progress: Progress, started: float, supposed: Sequence[str] = ()
) -> ExplanationResult:
    """Assemble the results of a decision.

    ``started`` is when it began, in seconds of `time.perf_counter`; ``supposed`` says what the covariance of the
    residual has beside the measurement.
    """
    progress("intervals and leave-one-out errors")
    intervals = {}
    if found.verdict in ("effect", "indistinguishable"):
        by_name = {t.names[0]: t for t in found.singles}
        intervals = {name: profile_interval(by_name[name].fit, name) for name in found.credible if name in by_name}
    placed = found_places(found)
    progress("held-out data")
    found, errors, more_notes, figures = _confirmed(adapter, found)
    along = step_fits(found)
    stepped = steps_tables(found, adapter.errors(along, found.noise_scale)[0]) if along else {}
    effects = effects_table(
        found, intervals, gains(adapter.hypotheses, found), detectable(adapter, found), untested(adapter, found)
    )
    progress("what to measure next")
    examined = adapter.hypotheses.evaluations
    next_table, advised = _next(adapter, found, effects, progress)
    # Evaluations for intervals and recommendation are counted apart from those of the decision.
    recommended = adapter.hypotheses.evaluations
    figures |= {
        "evaluations_intervals": examined - found.evaluations,
        "evaluations_recommendation": recommended - examined,
    }
    progress("discretisation error")
    discretisation = adapter.discretisation_error(found)
    richer = richer_members(adapter, found, progress)
    notes = [*([] if discretisation is None else [discretisation.sentence]), *adapter.notes(), *more_notes]
    facts = adapter.facts
    accuracy = less_accurate(found, adapter.hypotheses, adapter.hypotheses.relative_std, facts.seed)
    differing, (beside_misfit, misfit_words) = adapter.between(found), unexplained(adapter, found)
    last = "explained" if found.names_something else "attempt"
    stages = {"base": found.base} | ({} if found.chosen is None else {last: found.chosen})
    stages |= {"explained": found.blamed[0]} if found.blamed else {}
    labels = adapter.labels()
    own = adapter.tables(stages)
    acting = _acting(found, own)
    left = left_of(found, adapter.places(), acting, labels["mode"].tolist())
    pointed = elsewhere(found, adapter.places(), acting)
    more = (
        correction_offered(found),
        "" if found.blamed or found.verdict == "effect" else suspect_sentence(found.suspects),
        accuracy_sentence(accuracy, found.alpha),
        "" if differing is None else differing.sentence(found.alpha),
        places_sentence(placed),
        "" if left is None else left.told,
        richer_sentence(richer, errors),
        *misfit_words,
    )
    told = verdict(found, effects, errors, advised, facts.disagreements, facts.assumed, supposed, pointed)
    at_limits = limits_sentence(found)
    words = (*told.sentences, *filter(None, (at_limits, *more)))
    errors = errors.assign(std_from="assumed" if facts.assumed else "stated")
    figures |= {
        "misfit_at": misfit_at(found.base_adequacy, facts.disagreements)
        if found.verdict == "misfit_unlocated"
        else None,
        "accuracy": facts.accuracy or "none",
        "std_assumed": facts.assumed,
        "accuracy_that_explains": None if math.isnan(at := changing(accuracy)) else at,
    }
    known = {e.name: e for e in adapter.hypotheses.faults}
    tables = {
        **({BY_TEST: reduction_table(found, labels[TEST].tolist())} if TEST in labels else {}),
        **({} if differing is None else {BETWEEN: differing.table}),
        **beside_misfit,
        **stepped,
        **(richer_tables(found, richer) if richer else {}),
        **({FOUND_PLACES: placed} if len(placed) else {}),
        "faults": faults_table(found, adapter.places(), known),
        "perturbations": _perturbations(adapter, found),
        "confounding": confounding_table(found),
        "pulls": pull_table(found),
        "misfit_kinds": misfit_table(found),
        "candidate_fits": candidate_fits_table(found),
        "next_measurement": next_table,
        "accuracy": accuracy,
        "suspects_explained": found.suspects,
        "why": pattern_table(found, labels),
        "why_parameters": parameter_table(found),
        "why_places": place_table(found, adapter.places()),
        **own,
    }
    if left is not None:
        figures["left"] = left.plain
    if discretisation is not None:
        tables["discretisation"] = discretisation.table
        figures["discretisation"] = discretisation.largest
    seconds = time.perf_counter() - started
    traces = tuple(reason.first.trace for reason in reasons(adapter.failed())[:SHOWN] if reason.first.trace)
    answer = replace(
        told.answer, sure=f"{told.answer.sure} {at_limits}".strip(),
        then=f"{told.answer.then} {richer_next(richer)}".strip(),
    )  # fmt: skip
    return ExplanationResult(
        found, answer, words, tuple(notes), effects, errors, tables, figures, seconds, traces, richer
    )


def _acting(found: Explanation, tables: Mapping[str, pd.DataFrame]) -> list[tuple[float, float, float]]:
    """Where the best attempt acts on a model with matrices, m; empty where that is unknown."""
    table = tables.get("effect_places")
    if table is None or found.chosen is None:
        return []
    own = table[table["effect"].isin(found.chosen.names)]
    return [(float(x), float(y), float(z)) for x, y, z in own[["x", "y", "z"]].itertuples(index=False)]


def correction_offered(found: Explanation) -> str:
    """How the data can be corrected for the fault that is named, in words; empty where none is or none can be."""
    fault = next(iter(found.blamed), None)
    if fault is None or not correctable(fault.names[0]):
        return ""
    (name,) = fault.names
    return (
        f'Or correct what was read, while the files stay as they are: write corrected = {{ "{name}" = '
        f"{fault.fit.values[name]:.3g} }} under [measurement]."
    )


def _confirmed(adapter: Adapter, found: Explanation) -> tuple[Explanation, pd.DataFrame, list[str], dict[str, object]]:
    """The explanation after the check on held-out data, errors by stage and group, notes, and summary entries.

    An explanation that held-out data contradict is not confirmed; of several indistinguishable effects, only when the
    data contradict all of them.
    """
    last = "after" if found.names_something else "attempt"
    stages = {"before": found.base} | ({} if found.chosen is None else {last: found.chosen})
    errors, notes, figures = adapter.errors(stages, found.noise_scale)
    errors = errors[["group", "stage", "rows", "rms", "expected", "p", "unpaired"]]
    against = found.names_something and bool(contradicting(errors, last))
    if against and found.verdict == "indistinguishable":
        competing = {t.names[0]: t for t in found.singles if t.names[0] in found.credible and t is not found.chosen}
        others = adapter.errors(competing, found.noise_scale)[0] if competing else errors
        against = all(contradicting(others, name) for name in competing)
    if against:
        found, errors = found.unconfirmed(), errors.replace({"stage": {last: "attempt"}})
    return found, errors, notes, figures


def _next(
    adapter: Adapter, found: Explanation, effects: pd.DataFrame, progress: Progress
) -> tuple[pd.DataFrame, Recommendation | None]:
    """The recommended next measurement, as a table and in words."""
    design = adapter.design(found, progress)
    if design is None:
        return pd.DataFrame(columns=list(RECOMMENDATION_COLUMNS)), None
    table = recommend(design)
    pair = None if design.competing is None else design.competing.names
    unseen = effects.loc[~effects["visible"].astype(bool), "name"].tolist()
    if found.verdict == "none_explains" and found.perturbation is not None:
        # The design is for the unexplained perturbation, not for undetectable effects.
        unseen = [name for name in found.perturbation.names if name in design.effects]
    named = found.chosen.names if found.names_something and found.chosen is not None else ()
    rows = effects[effects["name"].isin(named) & effects["refitted"].astype(bool)].to_dict("records")
    intervals = {
        str(r["name"]): Interval(float(r["magnitude_low"]), float(r["magnitude_high"]), str(r["unit"])) for r in rows
    }
    return table, recommendation(table, pair, unseen, named, intervals)


def _perturbations(adapter: Adapter, found: Explanation) -> pd.DataFrame:
    scores, places = found.base_adequacy.perturbations, adapter.places()
    rows = []
    for k, name in enumerate(scores.owners):
        kind, place, sensor = places[name]
        score = scores.z[k] if scores.signed[k] else max(scores.z[k], 0.0)  # the other sign is not physical
        rows.append((name, kind, *place, sensor, score, scores.unabsorbed[k]))
    table = pd.DataFrame(rows, columns=["perturbation", "kind", "x", "y", "z", "sensor", "score", "unabsorbed"])
    return table.assign(limit=noise_limit(table["score"].to_numpy(dtype=float)))
