"""Summary at the top of the page: the answer and its key numbers."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from calib.report.html.answer import first_page, names_something, of_extended
from calib.report.html.effects import ranked_effects
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.numbers import fixed, flag, percent, significant, with_unit
from calib.results.answer import in_prose

DATA = {
    "fit": "error in fitted data",
    "left_out": "error in data left out in turn",
    "held_out_sensors": "error at validation sensors",
    "held_out_modes": "error in validation modes",
    "held_out_responses": "error in validation responses",
    "held_out_references": "error at validation references",
    "held_out_bands": "error in validation bands",
}

_MEASURED = {"modes": "mode", "responses": "response", "frf": "FRF"}
"""What a row of ``measured.csv`` is, by kind of measurement."""
ANSWERING = ("explain", "calibrate", "compare")
"""Analyses whose answer heads the page, the most telling first."""


@dataclass(frozen=True)
class Summary:
    """Contents of the summary box.

    Attributes
    ----------
    found : str
        What was found.
    sure, then : str
        How sure that is, and what to do next; empty where nothing was found.
    facts : tuple of (name, formatted number)
    origin : str
        Study, version and time of the last analysis.
    first : str
        Address of the page of the study that an extended one comes from; empty without it.
    """

    found: str
    sure: str
    then: str
    facts: tuple[tuple[str, str], ...]
    origin: str = ""
    first: str = ""


def page_summary(results: StudyResults) -> Summary:
    """Return the answer of the last analysis that has one, with the key numbers of every test."""
    calibrated = [*_errors_of_tests(results), *_parameters(results)] if results.tests else _calibrated(results)
    facts = [*_measured(results), *calibrated, *_explained(results)]
    answer = next(filter(None, map(results.answer, ANSWERING)), None) or _compared(results)
    sure = f"{answer.get('sure', '')} {results.added.get('conclusion', '')}".strip()
    found, sure, then = (w.replace(" -> ", " → ") for w in (answer["found"], sure, answer.get("then", "")))
    if added := of_extended(results):
        found = f"The model now has the {added}. {found}"
    return Summary(found, sure, then, tuple(facts), _origin(results), first_page(results))


def _compared(results: StudyResults) -> dict[str, str]:
    """What the comparison of each of several tests found; that there is none without it."""
    answers = {one.test: answer for one in results.tests if (answer := one.answer("compare"))}
    if not answers:
        return {"found": _nothing(results)}
    joined = {key: " ".join(f"{test}: {one[key]}" for test, one in answers.items()) for key in ("found", "sure")}
    return {**joined, "then": next(iter(answers.values()))["then"]}


def _nothing(results: StudyResults) -> str:
    stale = "There are no results for the present state of the study."
    return stale if results.stale else "No comparison has been run yet."


def _origin(results: StudyResults) -> str:
    last = max(results.analyses.values(), key=lambda a: str(a.get("when", "")), default=None)
    if last is None:
        return ""
    quick = ", a quick run" if any(a.get("quick") for a in results.analyses.values()) else ""
    version = last.get("versions", {}).get("calib", "")
    what = f"Study {results.name}, analysed"
    if results.record.get("notebook"):
        what = "A comparison made" if set(results.analyses) == {"compare"} else "A fit from Python"
    return f"{what} on {str(last.get('when', ''))[:10]} by calib {version}{quick}."


def _measured(results: StudyResults) -> list[tuple[str, str]]:
    if results.tests:
        each = [f"{one.test}: {fact}" for one in results.tests for _, fact in _measured(one)]
        return [("measured", "; ".join(each))] if each else []
    name = _MEASURED[results.kind]
    table = results.table("measured")
    if table is None:
        return []
    sensors = results.sensors
    words = f"{len(table)} {name}{'s' * (len(table) != 1)}"
    if results.kind == "modes" and len(table) > 1:
        low, high = (significant(f(table["natural_freq"]), 3) for f in (min, max))
        words += f" from {low} to {high} Hz"
    words += "" if sensors is None else f", {len(sensors)} sensors"
    repeats = results.record.get("repeats")
    return [("measured", words + (f", {repeats} repeats" if repeats and repeats > 1 else ""))]


def _calibrated(results: StudyResults) -> list[tuple[str, str]]:
    figures = results.summary
    if not figures:
        compared = results.compared("before")
        if compared is None or not compared["freq_error"].notna().any():
            return []
        error = f"{percent(compared['freq_error'].abs().mean())} %"
        out = [("mean error of natural frequencies, nothing fitted", error)]
        mac = compared["mac"].mean()
        return out if pd.isna(mac) else [*out, ("mean MAC, nothing fitted", fixed(mac, 3))]
    label = "mean error of natural frequencies" if results.kind == "modes" else "mean error"
    criterion = "FRAC" if results.kind == "frf" else "MAC"
    errors = [figures[f"mean_freq_error_{stage}"] for stage in ("before", "after")]
    added = results.added if results.added_effects else {}
    errors += [added["mean_freq_error"]] if added else []
    more = f" → calibrated with {results.added_effects}" if added else ""
    floor = figures.get("noise_freq_error")
    allowed = "" if floor is None else f" (a perfect model: {percent(floor)} %)"
    out = [(f"{label}, nominal → calibrated{more}", " → ".join(f"{percent(error)} %" for error in errors) + allowed)]
    if figures.get("mean_mac_after") is not None:
        noise = "" if figures.get("noise_mac") is None else f" (a perfect model: {fixed(figures['noise_mac'], 3)})"
        macs = [figures[f"mean_mac_{stage}"] for stage in ("before", "after")] + ([added["mean_mac"]] if added else [])
        out.append((f"mean {criterion}, nominal → calibrated{more}", " → ".join(fixed(mac, 3) for mac in macs) + noise))
    return [*out, *_parameters(results)]


def _errors_of_tests(results: StudyResults) -> list[tuple[str, str]]:
    """Mean errors, and mean MAC or FRAC, of each of several tests."""
    stages = {one.test: one.summary for one in results.tests if one.summary}
    if not stages:
        return [(f"{what}, {one.test}", fact) for one in results.tests for what, fact in _calibrated(one)]
    added = {one.test: one.added for one in results.tests if one.added_effects}
    more = f" → calibrated with {results.added_effects}" if added else ""
    out = []
    kinds = (("mean error", "mean_freq_error", _in_percent), ("mean MAC or FRAC", "mean_mac", _in_three))
    for label, key, form in kinds:
        words = []
        for test, figures in stages.items():
            values = [figures.get(f"{key}_{stage}") for stage in STAGES]
            values += [added[test].get(key)] if test in added else []
            known = [value for value in values if value is not None]
            if len(known) == len(values):
                words.append(f"{test} {' → '.join(map(form, known))}")
        if words:
            out.append((f"{label}, nominal → calibrated{more}", "; ".join(words)))
    return out


def _in_percent(value: float) -> str:
    return f"{percent(value)} %"


def _in_three(value: float) -> str:
    return fixed(value, 3)


def _parameters(results: StudyResults) -> list[tuple[str, str]]:
    """How many parameters are identified, without and with added effects."""
    verdicts = results.table("verdicts")
    if verdicts is None:
        return []
    counts = [_identified(verdicts["identified"])]
    table = results.table("added_parameters") if results.added_effects else None
    counts += [] if table is None else [_identified(table["after_identified"])]
    return [("parameters identified", " → ".join(counts))]


def _identified(flags: pd.Series) -> str:
    """How many are identified of those that were assessed, counted as in the sentences."""
    known = flags.dropna()
    return f"{sum(map(flag, known))} of {len(known)}"


def _explained(results: StudyResults) -> list[tuple[str, str]]:
    explanation = results.explanation
    out = []
    if names_something(results):
        table = ranked_effects(results)
        for r in [] if table is None else table.to_dict("records"):
            if r["name"] in explanation.get("chosen", []) and flag(r["refitted"]):
                interval = f"{significant(r['magnitude_low'], 3)} to {significant(r['magnitude_high'], 3)}"
                size = f"{with_unit(r['magnitude'], str(r['unit']))} (95 %: {interval})"
                out.append((f"magnitude of {in_prose(str(r['name']))}", size))
    known = _added_errors(results) or explanation.get("errors", {})
    if results.tests and not known:
        return [*out, *_calibrated_errors(results)]
    for group, found in known.items():
        if found.get("before") is not None:
            after = "" if found.get("after") is None else f" → {fixed(found['after'], 2)}"
            out.append((DATA.get(group, group), f"{fixed(found['before'], 2)}{after} σ"))
    return out


def _calibrated_errors(results: StudyResults) -> list[tuple[str, str]]:
    """Errors of the calibrated model in each group of data, test by test."""
    tables = {one.test: table for one in results.tests if (table := one.table("data_errors")) is not None}
    words: dict[str, list[str]] = {}
    for test, table in tables.items():
        for group, rms in zip(table["group"], table["rms"], strict=True):
            words.setdefault(str(group), []).append(f"{test} {fixed(rms, 2)} σ")
    return [(DATA.get(group, group), "; ".join(each)) for group, each in words.items()]


def _added_errors(results: StudyResults) -> dict[str, dict[str, float]]:
    """Errors of the calibrated models by group and stage, where effects were added."""
    table = results.table("added_errors")
    if table is None:
        return {}
    rms = table.set_index(["group", "stage"])["rms"]
    return {group: {stage: float(rms[group, stage]) for stage in STAGES} for group in dict.fromkeys(table["group"])}
