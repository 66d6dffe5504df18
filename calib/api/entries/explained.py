"""What an explanation has to say, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calib.analyses.added import WORDS, Added, by_group, to_add
from calib.analyses.extend import Extension
from calib.analyses.versions import Versions
from calib.api.entries.calibrated import ERRORS, errors_row, suspect_rows
from calib.api.entries.compared import held_out
from calib.api.entries.entry import Entry, Rows, Warned, Words, count, decimals
from calib.missing.accuracy_by_kind import TABLE as ACCURACY_BY_KIND
from calib.missing.findings import ExplanationResult
from calib.missing.pattern import BY_TEST
from calib.missing.predictions import ERRORS as ERRORS_WITH
from calib.missing.predictions import TABLE as PREDICTIONS
from calib.missing.recommendation import rounded
from calib.missing.steps_table import STEPS, STEPS_ERRORS
from calib.missing.test_order import TABLE as TEST_ORDER
from calib.problem.joint import TEST, of_test
from calib.problem.parameter import unit_words
from calib.results.results import Results
from calib.study.several import AnyStudy

EFFECTS = 5
"""Effects that are shown unless all are asked for."""
_MORE = ("z", "unabsorbed", "smallest visible")
"""Columns that are shown on request only."""


def explained_entries(study: AnyStudy, result: ExplanationResult, followed: bool = False) -> list[Entry]:
    """An explanation; ``followed`` by errors before and after, if its effects are added."""
    found, answer = result.explanation, result.answer
    in_answer = {answer.found, answer.sure}
    rows = [_effect(r) for r in result.effects.to_dict("records")]
    heads = ("effect", "z", "evidence", "unabsorbed", "magnitude, 95 %", "smallest visible", "remark")
    title = "Possible causes, best first (evidence: log Bayes factor against the model as it is; 3 is odds of 20 to 1):"
    brief = [tuple(cell for head, cell in zip(heads, row, strict=True) if head not in _MORE) for row in rows]
    named = [head for head in heads if head not in _MORE]
    out: list[Entry] = [
        Rows.of(title, named, brief, left=("remark",), when="brief", most=EFFECTS),
        Rows.of(title, heads, rows, left=("remark",), when="verbose"),
        *_errors(result, followed and to_add(found) is not None),
        *_predictions(result),
        *_accuracies(result),
        *_steps(result),
        *_by_test(result),
        *([] if to_add(found) else suspect_rows(result.tables["suspects_explained"])),
        *map(Warned, result.notes),
        Words(f"\nVerdict: {result.verdict}"),
        *(Words(sentence) for sentence in result.sentences if sentence not in in_answer),
        *_order(result),
        *_doubts(result),
        *map(Words, held_out(study)),
    ]
    effects = count(sum(len(g.names) for g in found.groups), "effect")
    local = count(len(result.tables["perturbations"]), "local stiffness or mass change")
    fits = count(len(result.tables["candidate_fits"]), "model")
    work = f"{fits} fitted, {count(found.evaluations, 'model evaluation')}"
    out.append(Words(f"{effects} and {local} tested, {work}, {result.seconds:.0f} s."))
    if rows:
        against = "the evidence is the log Bayes factor against the base model, for the plausible size of each cause"
        out.append(Words(f"z is a score, not a probability; {against}."))
    return out


def _order(result: ExplanationResult) -> list[Rows]:
    """What to measure next, as a test order."""
    table = result.tables.get(TEST_ORDER)
    if table is None:
        return []
    rows = [
        (f"{r['step']}", r["what"], r["excite"], r["sensors"], r["how"], r["narrows"]) for r in table.to_dict("records")
    ]
    heads = ("step", "what", "excite", "sensors", "how", "narrows")
    return [Rows.of("What to measure next, the cheapest first:", heads, rows, heads)]


def _doubts(result: ExplanationResult) -> list[Rows]:
    """What speaks against what is named, and how to check each."""
    rows = [(f"{number}", *one) for number, one in enumerate(result.doubts, 1)]
    heads = ("", "doubt", "how to check it")
    return [Rows.of("Doubts, and how to check each:", heads, rows, heads, when="verbose")]


def _effect(r: Mapping[Any, Any]) -> tuple[str, ...]:
    unit = unit_words(r["unit"])
    interval = f"{r['magnitude']:.3g} [{r['magnitude_low']:.3g}, {r['magnitude_high']:.3g}]{unit}"
    least = f"{rounded(r['magnitude_min'])}{unit}" if math.isfinite(r["magnitude_min"]) else ""
    least = ", ".join([*([least] if least else []), *([] if r["visible"] else ["not visible"])])
    ln_bayes = decimals(r["ln_bayes"], 1)
    if not r["refitted"] and ln_bayes:
        ln_bayes = f"{ln_bayes} (estimate)"
    remark = "candidate left" if r["credible"] else r["implausible"]
    magnitude = interval if r["refitted"] else ""
    return r["name"], decimals(r["z"], 1), ln_bayes, decimals(r["unabsorbed"], 2), magnitude, least, remark


def _errors(result: ExplanationResult, followed: bool) -> list[Rows]:
    if not len(result.errors):
        return []
    chosen = result.explanation.chosen
    name = "" if chosen is None else " and ".join(chosen.names)
    label = f" and after with {name}" if name else ""
    if (result.errors["stage"] == "attempt").any():
        label = f" and with {name}: best attempt, not believed"
    rows = [(str(r["group"]), str(r["stage"]), *errors_row(r)) for r in result.errors.to_dict("records")]
    title = f"Errors in standard deviations, before{label}:"
    table = result.errors.pivot(index="group", columns="stage", values=["rms", "expected", "p"])
    stages = [stage for stage in ("before", "after", "attempt") if stage in set(result.errors["stage"])]
    short = [
        (
            WORDS[group],
            *(decimals(table.loc[group, ("rms", stage)], 2) for stage in stages),
            decimals(table.loc[group, ("expected", stages[-1])], 2),
            *(p_cell(table.loc[group, ("p", stage)]) for stage in stages),
        )
        for group in dict.fromkeys(result.errors["group"])
    ]
    heads = ("data", *stages, "of a correct model", *(f"p {stage}" for stage in stages))
    return [
        *([] if followed else [Rows.of(title, heads, short, when="brief")]),
        Rows.of(title, ("data", "stage", *ERRORS), rows, ("stage",), when="verbose"),
    ]


def _accuracies(result: ExplanationResult) -> list[Rows]:
    """Whether the model fits by the accuracies of frequencies and shapes."""
    table = result.tables.get(ACCURACY_BY_KIND)
    if table is None:
        return []
    table = table.assign(cell=[_accuracy(r) for r in table.to_dict("records")])
    cells = table.pivot(index="frequency", columns="shape", values="cell")
    heads = ("frequencies", *(f"shapes {_as_stated(float(at))}" for at in cells.columns))
    rows = [(_as_stated(at), *cells.loc[at]) for at in cells.index.to_list()]
    title = "Whether the model without any effect fits, by the accuracy of the measurement (a fact, no advice):"
    return [Rows.of(title, heads, rows)]


def _accuracy(r: Mapping[Any, Any]) -> str:
    damped = f", damping {100 * r['damping']:g} %" if r["damping"] > 0 else ""
    return "no" if r["missing"] else f"yes{damped}"


def _as_stated(accuracy: float) -> str:
    return f"{100 * accuracy:g} %" if accuracy else "as stated"


def _predictions(result: ExplanationResult) -> list[Rows]:
    """Held-out data by the base model with what a misfit that nothing explains does to them."""
    if ERRORS_WITH not in result.tables or PREDICTIONS not in result.tables:
        return []
    table, several = result.tables[PREDICTIONS], TEST in result.tables[ERRORS_WITH]
    rows = []
    for r in result.tables[ERRORS_WITH].to_dict("records"):
        own = table[(table["group"] == r["group"]) & ((table[TEST] == r[TEST]) if several else True)]
        inside = [f"{int(own[name].sum())} of {len(own)}" for name in ("inside", "inside_unexplained")]
        numbers = [decimals(r[name], 2) for name in ("rms", "expected", "expected_unexplained")]
        data = of_test(r[TEST], WORDS[r["group"]]) if several else WORDS[r["group"]]
        rows.append((data, *inside, *numbers, p_cell(r["p_unexplained"])))
    title = "Validation data inside the 95 % intervals of their predictions, of the fit alone and with the misfit:"
    heads = ("data", "alone", "with it", "rms error", "expected alone", "expected with it", "p with it")
    return [Rows.of(title, heads, rows)]


def _steps(result: ExplanationResult) -> list[Rows]:
    """Errors of the models in turn, where effects were taken in one after the other."""
    if STEPS not in result.tables:
        return []
    table = result.tables[STEPS_ERRORS]
    groups = [group for group in WORDS if (table["group"] == group).any()]
    rms = table.pivot(index="step", columns="group", values="rms")
    rows = [
        (
            str(r["step"]),
            str(r["effects"]),
            decimals(r["ln_bayes"], 1),
            *(decimals(rms.loc[r["step"], g], 2) for g in groups),
        )
        for r in result.tables[STEPS].to_dict("records")
    ]
    title = "Effects taken in one after the other; rms errors in standard deviations:"
    heads = ("step", "effects", "evidence", *(WORDS[group] for group in groups))
    return [
        Rows.of(
            title, heads, rows, left=("effects",), when="always" if result.explanation.names_something else "verbose"
        )
    ]


def _by_test(result: ExplanationResult) -> list[Entry]:
    """In which of several tests the effect shows, and with which the figures begin."""
    table = result.tables.get(BY_TEST)
    if table is None or table.empty:
        return []
    effects = str(table["effects"].iloc[0])
    own = table[table["effects"] == effects].to_dict("records")
    rows = [
        (
            str(r[TEST]),
            str(r["rows"]),
            *(decimals(r[name], 1) for name in ("before", "after")),
            decimals(100 * r["share"], 0),
        )
        for r in own
    ]
    title = f"Sum of squares by test, all fitted together, without and with {effects}:"
    out: list[Entry] = [Rows.of(title, ("test", "rows", "without", "with", "% of the decrease"), rows)]
    for r in own:
        if r["shown_first"]:
            words = f"{effects} shows most in test {r[TEST]} (largest share): figures and reports begin with it."
            out.append(Words(words, when="always"))
    return out


def p_cell(p: float) -> str:
    """A p-value; empty where there is none."""
    return "" if math.isnan(p) else f"{p:.2g}"


def of_extension(written: Extension, brief: bool) -> list[Entry]:
    """A study with more effects; ``brief`` where a run goes on with it."""
    effects, folder = written.effects, written.file.parent
    more = "one effect" if len(effects) == 1 else f"{len(effects)} effects"
    named = " and ".join(f"{effect.title} ({effect.name})" for effect in effects)
    words = [f"Written: {folder}, which builds on the same study and has {more} more in its model: {named}."]
    if written.selected:
        words.append(f"Its calibration may change {', '.join(written.selected)} too.")
    else:
        names = ", ".join(name for effect in effects for name in effect.names)
        words.append(f"Its model has {names} too; the study leaves the selection to 'calib sensitivity'.")
    out: list[Entry] = [Words(one, when="verbose" if brief else "always") for one in words]
    if written.aside is not None:
        aside = f"The study that was there had been changed, and is kept as {written.aside}, without its results."
        out.append(Warned(aside))
    return out


def of_added(result: Added, written: Extension, folder: Results) -> list[Entry]:
    """Errors before and after adding the named effects."""
    rows = [
        (WORDS[r["group"]], str(r["rows_after"]), *(decimals(r[f"rms_{stage}"], 2) for stage in ("before", "after")),
         decimals(r["expected_after"], 2), *(f"{r[f'p_{stage}']:.2g}" for stage in ("before", "after")))
        for r in by_group(result.errors).to_dict("records")
    ]  # fmt: skip
    heads = ("data", "rows", "before", "after", "of a correct model", "p before", "p after")
    own = f"Test {result.test}: both" if result.test else "Both"
    title = f"{own} models calibrated in the same way; rms errors in standard deviations:"
    return [
        Rows.of(title, heads, rows),
        Words(result.sentence),
        Words(f"With the effects: {folder.path}; the extended study: {written.file.parent}", when="always"),
    ]


def of_versions(found: Versions) -> list[Entry]:
    """Errors over the versions of a model."""
    rows = [
        (
            str(r["study"]),
            str(r["effects"]) or "none",
            str(r["group"]),
            decimals(r["rms"], 2),
            decimals(r["expected"], 2),
        )
        for r in found.table.to_dict("records")
    ]
    heads = ("study", "effects", "data", "rms", "of a correct model")
    title = "Errors in standard deviations over the versions of the model:"
    return [*map(Warned, found.notes), Rows.of(title, heads, rows, left=("effects", "data"))]
