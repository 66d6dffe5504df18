"""Which physical effect a study's model lacks: everything that is told and written about it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.response_residual import ResponseResidual
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.function import FunctionModel
from calib.inference.left_out import left_out
from calib.joint import TEST
from calib.loading import with_effects
from calib.missing import explain as engine
from calib.missing.accuracy import changing, less_accurate
from calib.missing.accuracy import sentence as accuracy_sentence
from calib.missing.advice import COLUMNS as ADVICE_COLUMNS
from calib.missing.advice import advice_sentence, advise
from calib.missing.findings import Findings, Trial
from calib.missing.held_out import contradicting
from calib.missing.hypotheses import Altered, Hypotheses
from calib.missing.profile import profile_interval
from calib.missing.rules import RULES
from calib.missing.suspect import sentence as suspect_sentence
from calib.missing.tables import (
    confounding_table,
    effects_table,
    misfit_table,
    strain_table,
    tried_table,
)
from calib.missing.verdict import misfit_at, sentences
from calib.missing.visible import smallest_visible, visible_within_limits
from calib.outcome import as_cause, failure
from calib.questions.explained_fit import TABLE, explained_fits
from calib.questions.explanation import Explanation, Told, summary
from calib.questions.failures import SHOWN, reasons
from calib.questions.function_hypotheses import function_hypotheses
from calib.questions.joint_side import JointSide, together
from calib.questions.library import local_changes, modal_hypotheses
from calib.questions.modal_side import ModalSide
from calib.questions.plain_side import PlainSide
from calib.questions.record import begin_answer, write_record
from calib.questions.reduction import worthwhile
from calib.questions.side import Side
from calib.questions.state import ADDED
from calib.questions.verify import withheld_targets
from calib.results import Results
from calib.settings import ExplainSettings
from calib.several import AnyStudy
from calib.structure.atoms import Atom
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.study import Study

Progress = Callable[[str], None]


def explain(
    study: AnyStudy,
    results: Results,
    progress: Progress = lambda words: None,
    homes: Mapping[str, Results] = MappingProxyType({}),
    folders: Mapping[str, Results] = MappingProxyType({}),
) -> Explanation:
    """Find which effect of the study's library its model lacks; write all tables and ``explanation.json``.

    Without a library, or with all of it in the model, local changes alone are asked. Several tests are asked together:
    an effect acts in every test whose library has it.

    Parameters
    ----------
    study : Study or JointStudy
    results : Results
    progress : callable
        Told what is being done.
    homes : mapping from str to Results
        By name of the test: they hold the reduced bases, which whole and quick runs share; by default ``results``.
    folders : mapping from str to Results
        By name of the test: they take what each of several tests says of the answer.

    Raises
    ------
    InputError
        When too little was measured.
    """
    tests = study.studies
    for one in tests:
        for effect in one.candidates:  # one that cannot be built is told by its name, before anything is solved
            with_effects(one.model, [effect], str(study.file))
    _require_alike(study)
    if any(one.measured is not None for one in tests):
        engine.require_modes(sum(len(one.targets) if one.measured is None else one.measured.n_modes for one in tests))
    started, local = time.perf_counter(), _local(study)
    side = together({s.test: side_of(s, homes.get(s.test, results), progress, local.get(s.test)) for s in tests})
    found = decided(side, study.settings.explain, study.file, progress)
    answer = answered(side, found, progress, started)
    answer = replace(answer, tables=answer.tables | {TABLE: explained_fits(study, found)})
    seeds = {"probabilities": study.settings.explain.seed, "reduction": study.settings.reduction.seed}
    of_all = {name: table for name, table in answer.tables.items() if TEST not in table}
    seen: list[tuple[AnyStudy, Results, Explanation]] = [(study, results, replace(answer, tables=of_all))]
    if isinstance(side, JointSide):
        seen += [(one, folders[one.test], side.seen(one.test, answer)) for one in tests]
    for asked, folder, told in seen:
        keep(asked, folder, told)
        write_record(asked, folder, "explain", seeds)
    return answer


def side_of(study: Study, home: Results, progress: Progress, local: tuple[Atom, ...] | None = None) -> Side:
    """What a study's test asks; ``local`` changes are by default those of its own."""
    problem, told, space = study.problem, Told.of(study), study.search_space.without(study.condition)
    if isinstance(problem, FunctionProblem):
        assert isinstance(study.model, FunctionModel)
        pair = ResponseResidual(problem)
        plain, asked = function_hypotheses(study.model, pair, study.candidates, space, study.test)
        return PlainSide(plain, asked, told, withheld_targets(study))
    if isinstance(problem.model, ModalFunctionModel):  # which may be behind a ledger
        modal, asked = function_hypotheses(problem.model, ModalResidual(problem), study.candidates, space, study.test)
    else:
        modal, asked = modal_hypotheses(study, home, progress, local)
    return ModalSide(modal, asked, told, study.whole_problem(), study.finer_model, worthwhile(study))


def _local(study: AnyStudy) -> dict[str, tuple[Atom, ...]]:
    """Local changes by test: those of one model are the same in all tests of it."""
    groups: dict[str, list[Study]] = {}
    for one in study.studies:
        if isinstance(one.model, StructuralModel):
            groups.setdefault(repr((one.settings.model, one.settings.model_options)), []).append(one)
    out: dict[str, tuple[Atom, ...]] = {}
    for group in groups.values():
        model, used = group[0].model, [one.measured for one in group if one.measured is not None]
        assert isinstance(model, StructuralModel)
        of = group[0].test if len(groups) > 1 else ""
        found = local_changes(model, used, group[0].search_space.values, of)
        out |= {one.test: found for one in group}
    return out


def _require_alike(study: AnyStudy) -> None:
    """InputError where two libraries mean different things by one name."""
    known: dict[str, Effect] = {}
    for effect in (e for one in study.studies for e in one.candidates):
        other = known.setdefault(effect.name, effect)
        if other.parameters != effect.parameters:
            raise InputError(
                f"the libraries of two tests have different effects {effect.name!r}", place=study.file,
                remedy="give one of them another name, or both the same strength",
            )  # fmt: skip


def decided(side: Side, given: ExplainSettings, place: str | Path, progress: Progress = lambda words: None) -> Findings:
    """The decision with some settings; InputError, with the place of what is asked, where no model can be fitted."""
    settings = engine.Settings(given.alpha, given.refits, given.merge, given.seed, side.budget_of_fits)
    try:
        return engine.explain(side.hypotheses, settings, progress)
    except EvaluationError as fault:
        words, cause = _not_fitted(side, fault)
        remedy = "check values, limits and supports" if cause is None else "correct the function that fails"
        raise InputError(f"the model cannot be fitted: {words}", place=place, remedy=remedy) from cause


def keep(study: AnyStudy, results: Results, answer: Explanation) -> None:
    """Write all tables of an explanation and ``explanation.json``."""
    begin_answer(results, "explain")
    results.remove(*ADDED)
    results.write_table("effects", answer.effects)
    results.write_table("errors", answer.errors)
    for name, table in answer.tables.items():
        results.write_table(name, table)
    results.write_json("explanation", summary(study, answer))


def _not_fitted(side: Side, fault: EvaluationError) -> tuple[str, EvaluationError | None]:
    """Why nothing could be fitted, and the commonest failure of the user's own code, where that has failed."""
    words, failed = str(fault), side.failed()
    if not failed:
        return words, None
    common = reasons(failed)[0]
    if common.error not in words:
        words = f"{words}; {len(failed)} point{'s' * (len(failed) > 1)} failed, most with {common.error}"
    return words, as_cause(failure(common.first))


def answered(side: Side, found: Findings, progress: Progress, started: float) -> Explanation:
    """Everything that is told about a decision; ``started`` is when it began, in seconds of `time.perf_counter`."""
    progress("intervals and data that were left out")
    intervals = {}
    if found.verdict in ("effect", "indistinguishable"):
        by_name = {t.names[0]: t for t in found.singles}
        intervals = {name: profile_interval(by_name[name].state, name) for name in found.credible if name in by_name}
    progress("withheld data")
    found, errors, more_notes, figures = _confirmed(side, found)
    untested = _untested(side, found)
    effects = effects_table(found, intervals, _gains(side.hypotheses, found), _visible(side, found), untested)
    progress("what to measure next")
    examined = side.hypotheses.evaluations
    next_table, advice = _next(side, found, effects)
    # What the decision took is one thing, what is told about it another.
    advised = side.hypotheses.evaluations
    figures |= {"evaluations_intervals": examined - found.evaluations, "evaluations_advice": advised - examined}
    progress("what the discretisation alone would look like")
    budget = side.budget(found)
    notes = [*([] if budget is None else [budget.sentence]), *side.notes(), *more_notes]
    told = side.told
    accuracy = less_accurate(found, side.hypotheses, side.relative_std, told.seed)
    rests = f"All this rests on an assumed scatter: {told.assumed}." if told.assumed else ""
    more = (suspect_sentence(found.suspects), accuracy_sentence(accuracy), rests)
    words = (*sentences(found, effects, errors, advice, told.disagreements), *filter(None, more))
    errors = errors.assign(scatter="assumed" if told.assumed else "stated")
    figures |= {
        "misfit_at": misfit_at(found.base_check, told.disagreements) if found.verdict == "misfit_unlocated" else None,
        "accuracy": told.accuracy,
        "scatter_assumed": told.assumed,
        "accuracy_that_explains": None if math.isnan(at := changing(accuracy)) else at,
    }
    last = "explained" if found.names_something else "attempt"
    stages = {"base": found.base} | ({} if found.chosen is None else {last: found.chosen})
    tables = {
        "atoms": _atoms(side, found),
        "confounding": confounding_table(found),
        "strain": strain_table(found),
        "misfit_kinds": misfit_table(found),
        "tried": tried_table(found),
        "next_measurement": next_table,
        "accuracy": accuracy,
        "suspects_explained": found.suspects,
        **side.tables(stages),
    }
    if budget is not None:
        tables["discretisation"] = budget.table
        figures["discretisation"] = budget.largest
    seconds = time.perf_counter() - started
    traces = tuple(reason.first.trace for reason in reasons(side.failed())[:SHOWN] if reason.first.trace)
    return Explanation(found, words, tuple(notes), effects, errors, tables, figures, seconds, traces)


def _confirmed(side: Side, found: Findings) -> tuple[Findings, pd.DataFrame, list[str], dict[str, object]]:
    """The findings once withheld data have been asked, errors by stage and group, what to note, and figures.

    What would be named is not where withheld data contradict it; of several that cannot be told apart, all of them.
    """
    last = "after" if found.names_something else "attempt"
    stages = {"before": found.base} | ({} if found.chosen is None else {last: found.chosen})
    errors, notes, figures = side.errors(stages, found.noise_scale)
    errors = errors[["group", "stage", "rows", "rms", "expected", "p", "unpaired"]]
    against = found.names_something and bool(contradicting(errors, last))
    if against and found.verdict == "indistinguishable":
        rivals = {t.names[0]: t for t in found.singles if t.names[0] in found.credible and t is not found.chosen}
        others = side.errors(rivals, found.noise_scale)[0] if rivals else errors
        against = all(contradicting(others, name) for name in rivals)
    if against:
        found, errors = found.unconfirmed(), errors.replace({"stage": {last: "attempt"}})
    return found, errors, notes, figures


def _untested(side: Side, found: Findings) -> list[Effect]:
    """Effects with which the model could not be solved, at no strength or at none of their grid."""
    scores = found.base_check.named
    absorbed = {n for n in scores.owners if not scores.size[scores.of(n)].any()}
    tested = {name for group in found.groups for name in group.names} - (absorbed & side.failing())
    return [e for e in side.hypotheses.effects if e.name not in tested]


def _visible(side: Side, found: Findings) -> dict[str, float]:
    """Smallest visible strengths, asked of the model itself where the derivative cannot tell them.

    These are effects that show at no plausible strength to first order, and those that were found with a strength that
    should not show: it grows faster than its derivative says.
    """
    state, out = found.base.state, {}
    fits = {t.names[0]: t for t in found.singles}
    for effect in (e for group in found.groups for e in group.effects):
        first, fit = smallest_visible(found.base_check.named, effect.name), fits.get(effect.name)
        seen = fit is not None and found.ln_bayes(fit) > RULES.credible and abs(fit.state.values[effect.name]) < first
        if seen or (not effect.nuisance and first > effect.plausible):
            question = Altered(side.hypotheses.question((effect.name,)), found.noise_scale)
            nuisance = {q.name: fit.state.values[q.name] if fit else q.value for q in effect.nuisance}
            within = visible_within_limits(question, state, effect, nuisance)
            out[effect.name] = np.fmin(first, within) if seen else within
    return out


def _gains(hypotheses: Hypotheses, found: Findings) -> dict[str, float]:
    """Gain of every fitted effect in the log density of data that are left out, mode by mode or one by one."""
    groups = [row.mode or row.sensor for row in hypotheses.rows]

    def density(trial: Trial) -> float:
        s = trial.state
        return float(np.sum(left_out(s.residual, s.slope, s.prior_sd, groups).elpd))

    base = density(found.base)
    return {t.names[0]: density(t) - base for t in found.singles}


def _next(side: Side, found: Findings, effects: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """What to measure next, in a table and in words."""
    prospects = side.prospects(found)
    if prospects is None:
        return pd.DataFrame(columns=list(ADVICE_COLUMNS)), ""
    table = advise(prospects)
    pair = None if prospects.rivals is None else prospects.rivals.names
    unseen = effects.loc[~effects["visible"].astype(bool), "name"].tolist()
    if found.verdict == "none_explains" and found.atom is not None:
        unseen = [name for name in found.atom.names if name in prospects.effects]  # what is unexplained, not the unseen
    return table, advice_sentence(table, pair, unseen)


def _atoms(side: Side, found: Findings) -> pd.DataFrame:
    scores, places = found.base_check.atoms, side.places()
    rows = []
    for k, name in enumerate(scores.owners):
        kind, place, sensor = places[name]
        score = scores.z[k] if scores.signed[k] else max(scores.z[k], 0.0)  # of the other sign it cannot exist
        rows.append((name, kind, *place, sensor, score, scores.gamma[k]))
    return pd.DataFrame(rows, columns=["atom", "kind", "x", "y", "z", "sensor", "score", "gamma"])
