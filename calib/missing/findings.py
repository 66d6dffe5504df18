"""Findings of a decision: the verdict on what is missing with all tables and sentences that support it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import pandas as pd

from calib.execution.stage import Progress, silent
from calib.missing.accuracy import accuracy_sentence, changing, less_accurate
from calib.missing.accuracy_by_kind import TABLE as ACCURACY_BY_KIND
from calib.missing.accuracy_by_kind import AccuracyByKind, accuracy_by_kind
from calib.missing.adapter import Adapter
from calib.missing.adequacy import contradicting
from calib.missing.between_tests import BETWEEN
from calib.missing.candidate_fit import CandidateFit
from calib.missing.data_words import for_readers
from calib.missing.detailed import DetailedFit, detailed_next, detailed_sentence, detailed_tables
from calib.missing.effect_facts import (
    FOUND_PLACES,
    detailed_fits,
    detectable,
    found_places,
    gains,
    places_sentence,
    unexplained,
    untested,
)
from calib.missing.explanation import Explanation
from calib.missing.goodness import misfit_at, overall_p
from calib.missing.hypotheses import Hypotheses
from calib.missing.local import range_words
from calib.missing.partial import remainder_of
from calib.missing.pattern import BY_TEST, parameter_table, pattern_table, place_table, reduction_table
from calib.missing.profile import profile_interval
from calib.missing.recommendation import COLUMNS as RECOMMENDATION_COLUMNS
from calib.missing.recommendation import MEASURED, Interval, Recommendation, recommend, recommendation, with_few_rows
from calib.missing.reservations import Reservation, reservations
from calib.missing.steps_table import step_fits, steps_tables
from calib.missing.suspect import suspect_sentence
from calib.missing.tables import (
    candidate_fits_table,
    confounding_table,
    effects_table,
    faults_table,
    misfit_table,
    perturbations_table,
    pull_table,
)
from calib.missing.test_order import TABLE as TEST_ORDER
from calib.missing.test_order import first_steps, test_order
from calib.missing.verdict import NO_DOUBTS, Doubts, verdict_of
from calib.missing.verdict_words import elsewhere, limits_sentence
from calib.problem.joint import TEST
from calib.results.answer import Answer

_ERRORS = ["group", "stage", "rows", "rms", "expected", "p", "unpaired"]


@dataclass(frozen=True, eq=False)
class ExplanationResult:
    """The verdict on what is missing, with its tables.

    Attributes
    ----------
    explanation : Explanation
    answer : Answer
        The verdict in a sentence, how sure it is, and what to do next.
    sentences : tuple of str
        The same with what supports it.
    notes : tuple of str
        Caveats, such as an assumed standard deviation.
    effects, errors : DataFrame
        ``effects.csv`` and ``errors.csv``.
    tables : mapping from str to DataFrame
        All others, by file name.
    figures : mapping from str to object
        Further entries of the summary.
    seconds : float
    traces : tuple of str
        Tracebacks of the commonest failures in the user's code.
    richer : tuple of DetailedFit
        More detailed forms of the effect that nearly explains the data, from simple to detailed.
    doubts : tuple of Reservation
        What speaks against what is named, and how to check it.
    """

    explanation: Explanation
    answer: Answer
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    effects: pd.DataFrame
    errors: pd.DataFrame
    tables: dict[str, pd.DataFrame]
    figures: dict[str, object]
    seconds: float
    traces: tuple[str, ...] = ()
    richer: tuple[DetailedFit, ...] = ()
    doubts: tuple[Reservation, ...] = ()

    @property
    def sentence(self) -> str:
        """The verdict and what supports it."""
        return " ".join(self.sentences)

    @property
    def verdict(self) -> str:
        """One of the verdicts of `calib.missing.explanation.Explanation`."""
        return self.explanation.verdict


def findings(
    adapter: Adapter,
    decision: Explanation,
    started: float,
    supposed: Sequence[str] = (),
    correctable: Callable[[str], bool] = lambda name: False,
    progress: Progress = silent,
    doubts: Doubts = NO_DOUBTS,
) -> ExplanationResult:
    """Everything that a decision tells, tested on held-out data.

    Parameters
    ----------
    adapter : Adapter
        Of the test, or of all tests, that the decision is about.
    decision : Explanation
    started : float
        When the decision began, in seconds of `time.perf_counter`.
    supposed : sequence of str
        What the covariance of the residual has beside the measurement.
    correctable : callable
        Whether a fault of that name can be taken out of the data on reading.
    progress : callable
        Called with a description of each step.
    doubts : Doubts
        What looks wrong in the measurement before any fit.
    """
    progress("intervals and leave-one-out errors")
    intervals = _intervals(decision)
    placed = found_places(decision)
    progress("validation data")
    found, errors, notes, figures = _confirmed(adapter, decision)
    along = step_fits(found)
    stepped = steps_tables(found, adapter.errors(along, found.noise_scale)[0]) if along else {}
    effects = effects_table(
        found, intervals, gains(adapter.hypotheses, found), detectable(adapter, found), untested(adapter, found)
    )
    progress("what to measure next")
    examined = adapter.hypotheses.evaluations
    next_tables, advised = _next(adapter, found, effects, progress)
    # Evaluations for intervals and recommendation are counted apart from those of the decision.
    recommended = adapter.hypotheses.evaluations
    progress("discretisation error")
    discretisation = None if found.granted else adapter.discretisation_error(found)  # once the data are corrected
    detailed = detailed_fits(adapter, found, progress)
    if found.granted:
        notes = ["Validation data are compared as they were measured, with the errors that are named.", *notes]
    notes = [*([] if discretisation is None else [discretisation.sentence]), *adapter.notes(), *notes]
    facts, places, labels = adapter.facts, adapter.places(), adapter.labels()
    accuracy = less_accurate(found, adapter.hypotheses, adapter.hypotheses.relative_std, facts.seed)
    by_kind = accuracy_by_kind(found, adapter.hypotheses, facts.seed, progress)
    differing, (beside_misfit, misfit_words) = adapter.between(found), unexplained(adapter, found)
    of_test = adapter.tables(_stages(found))
    acting = _acting(found, of_test)
    remainder = remainder_of(found, places, acting, labels["mode"].tolist())
    pointed = elsewhere(found, places, acting)
    verdict = verdict_of(
        found, effects, errors, advised, facts.disagreements, facts.assumed, supposed, pointed, doubts
    )  # fmt: skip
    at_limits, corrected = limits_sentence(found), correction_offered(found, correctable)
    added = (
        at_limits,
        corrected,
        "" if found.faulty or found.verdict == "effect" else suspect_sentence(found.suspects),
        accuracy_sentence(accuracy, found.alpha),
        "" if by_kind is None else by_kind.sentence,
        "" if differing is None else differing.sentence(found.alpha),
        places_sentence(placed),
        "" if remainder is None else remainder.sentence,
        detailed_sentence(detailed, errors),
        *misfit_words,
    )
    at_misfit, changed_at = found.verdict == "misfit_unlocated", changing(accuracy)
    figures |= {
        "evaluations_intervals": examined - decision.evaluations,
        "evaluations_recommendation": recommended - examined,
        "misfit_at": misfit_at(found.base_adequacy, facts.disagreements) if at_misfit else None,
        "accuracy": facts.accuracy or "none",
        "std_assumed": facts.assumed,
        "accuracy_that_explains": None if math.isnan(changed_at) else changed_at,
        **({} if remainder is None else {"left": remainder.entries}),
        **({} if discretisation is None else {"discretisation": discretisation.largest}),
    }
    tables = {
        **({BY_TEST: reduction_table(found, labels[TEST].tolist())} if TEST in labels else {}),
        **({} if differing is None else {BETWEEN: differing.table}),
        **beside_misfit,
        **stepped,
        **(detailed_tables(found, detailed) if detailed else {}),
        **({FOUND_PLACES: placed} if len(placed) else {}),
        "faults": faults_table(found, places, {e.name: e for e in adapter.hypotheses.faults}),
        "perturbations": perturbations_table(found, places),
        "confounding": confounding_table(found, effects),
        "pulls": pull_table(found),
        "misfit_kinds": misfit_table(found),
        "candidate_fits": candidate_fits_table(found),
        **next_tables,
        "accuracy": accuracy,
        **({} if by_kind is None else {ACCURACY_BY_KIND: by_kind.table}),
        "suspects_explained": found.suspects,
        "why": pattern_table(found, labels),
        "why_parameters": parameter_table(found),
        "why_places": place_table(found, places),
        **of_test,
        **({} if discretisation is None else {"discretisation": discretisation.table}),
    }
    answer = replace(
        verdict.answer, sure=f"{verdict.answer.sure} {at_limits}".strip(),
        then=f"{_then(found, verdict.answer.then, by_kind, adapter.hypotheses)} {detailed_next(detailed)}".strip(),
    )  # fmt: skip
    answer = answer if differing is None else differing.told(answer, found.alpha, found.names_something)
    told = partial(for_readers, effects=effects["name"].tolist(), freqs=facts.freqs)
    every = (answer.found, *verdict.sentences, *filter(None, added))
    sentences = dict.fromkeys(one if one == corrected else told(one) for one in every)  # a line of TOML stays as it is
    return ExplanationResult(
        found, replace(answer, found=told(answer.found), sure=told(answer.sure), then=told(answer.then)),
        tuple(sentences), tuple(notes), effects,
        errors.assign(std_from="assumed" if facts.assumed else "stated"), tables, figures,
        time.perf_counter() - started, richer=detailed,
        doubts=tuple(
            Reservation(*map(told, one)) for one in reservations(found, effects, pointed, facts.assumed)
        ),
    )  # fmt: skip


def _then(found: Explanation, then: str, by_kind: AccuracyByKind | None, hypotheses: Hypotheses) -> str:
    """What to do next; where no effect, place or fault is adequate, also an accuracy with which the model would fit.

    It comes first where no place is told either.
    """
    opened = found.verdict in ("partial", "none_explains", "misfit_unlocated") and found.datum is None
    if by_kind is None or not opened or (found.place and overall_p(found.place.fit, hypotheses) > found.alpha):
        return then
    return " ".join(filter(None, (then, by_kind.then) if found.place else (by_kind.then, then)))


def _intervals(found: Explanation) -> dict[str, tuple[float, float]]:
    """Profile intervals of the magnitudes of the credible effects, where one effect is named or several compete."""
    if found.verdict not in ("effect", "indistinguishable"):
        return {}
    by_name = {t.names[0]: t for t in found.singles}
    return {name: profile_interval(by_name[name].fit, name) for name in found.credible if name in by_name}


def _stages(found: Explanation) -> dict[str, CandidateFit]:
    """The fits that the tables of a test show: the base model, and what is named, attempted or blamed."""
    last = "explained" if found.names_something else "attempt"
    stages = {"base": found.base} | ({} if found.chosen is None else {last: found.chosen})
    return stages | ({"explained": found.blamed[0]} if found.blamed else {})


def _acting(found: Explanation, tables: Mapping[str, pd.DataFrame]) -> list[tuple[float, float, float]]:
    """Where the best attempt acts on a model with matrices, m; empty where that is unknown."""
    table = tables.get("effect_places")
    if table is None or found.chosen is None:
        return []
    own = table[table["effect"].isin(found.chosen.names)]
    return [(float(x), float(y), float(z)) for x, y, z in own[["x", "y", "z"]].itertuples(index=False)]


def correction_offered(found: Explanation, correctable: Callable[[str], bool]) -> str:
    """How the data can be corrected for the fault that is named, in words; empty where none is or none can be."""
    told = found.faulty if found.granted else found.faulty[:1]
    if not told or not all(correctable(fault.name) for fault, _ in told):
        return ""
    by = ", ".join(f'"{fault.name}" = {one.fit.values[fault.name]:.3g}' for fault, one in told)
    return (
        f"Or correct what was read, while the files stay as they are: write corrected = {{ {by} }} under [measurement]."
    )


def _confirmed(adapter: Adapter, found: Explanation) -> tuple[Explanation, pd.DataFrame, list[str], dict[str, object]]:
    """The explanation after the check on held-out data, errors by stage and group, notes, and summary entries.

    An explanation that held-out data contradict is not confirmed; of several indistinguishable effects, only when the
    data contradict all of them.
    """
    last = "after" if found.names_something else "attempt"
    stages = {"before": found.base} | ({} if found.chosen is None else {last: found.chosen})
    errors, notes, figures = adapter.errors(stages, found.noise_scale)
    errors = errors[_ERRORS]
    # Held-out data have the faults of the measurement too, so that they contradict nothing beside them.
    against = found.names_something and not found.granted and bool(contradicting(errors, last))
    if against and found.verdict == "indistinguishable":
        alternatives = [*found.singles, *([] if found.fault is None else [found.fault])]
        credible = (*found.credible, *(() if found.fault is None else found.fault.names))
        competing = {t.names[0]: t for t in alternatives if t.names[0] in credible and t is not found.chosen}
        others = adapter.errors(competing, found.noise_scale)[0] if competing else errors
        against = all(contradicting(others, name) for name in competing)
    if against:
        found, errors = found.unconfirmed(), errors.replace({"stage": {last: "attempt"}})
    return found, errors, notes, figures


def _next(
    adapter: Adapter, found: Explanation, effects: pd.DataFrame, progress: Progress
) -> tuple[dict[str, pd.DataFrame], Recommendation | None]:
    """The recommended next measurement, as tables and in words: gains of all candidates, and a test order."""
    # A measurement with faults is corrected first: what to measure beside it is asked of the corrected one.
    design = None if found.granted else adapter.design(found, progress)
    if design is None:
        return {"next_measurement": pd.DataFrame(columns=[*RECOMMENDATION_COLUMNS, "told"])}, None
    table = recommend(design)
    pair = None if design.competing is None else design.competing.names
    unseen = effects.loc[~effects["visible"].astype(bool), "name"].tolist()
    if found.verdict == "none_explains" and found.place is not None:
        # The design is for the place that is told, not for undetectable effects.
        unseen = [name for name in found.place.names if name in design.effects]
    named = found.chosen.names if found.names_something and found.chosen is not None else ()
    rows = effects[effects["name"].isin(named) & effects["refitted"].astype(bool)].to_dict("records")
    intervals = {
        str(r["name"]): Interval(float(r["magnitude_low"]), float(r["magnitude_high"]), str(r["unit"])) for r in rows
    }
    told = (pair[0],) if pair is not None else named or unseen
    order = test_order(table, design, told, intervals)
    order["narrows"] = [for_readers(words, design.effects, {}) for words in order["narrows"]]
    kept = with_few_rows(table)
    tables = {"next_measurement": kept.assign(told=kept["effect"].isin(told)), TEST_ORDER: order}
    advised = recommendation(table, pair, unseen, named, intervals)
    if advised is None or order.empty or MEASURED in advised.short:  # data that are measured already are no step
        return tables, advised
    purpose = "To tell them apart" if pair is not None else "To see further effects"
    if pair is None and named:
        ends = [range_words(one.low, one.high, one.unit) for one in intervals.values()]
        purpose = f"To narrow {' and '.join(ends) if len(ends) == len(named) else 'what is named'}"
    return tables, replace(advised, short=first_steps(order, purpose))
