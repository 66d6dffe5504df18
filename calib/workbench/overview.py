"""What the page tells of a study as a whole: what was run, what was found, and the command that comes next."""

from __future__ import annotations

from typing import Any

from calib.missing.explanation import OPEN
from calib.report.html.cells import arrows
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import ANSWERING, page_summary
from calib.study.study_file import StudyFile
from calib.workbench.missing import is_added
from calib.workbench.studies import KnownStudy, Studies

_ROWS = (
    ("compare", "Model against measurement", "modes or responses side by side, nothing fitted"),
    ("sensitivity", "Which parameters matter", "samples between the limits; metamodels"),
    ("calibrate", "Fitted parameters", "search, least squares, and how well each parameter is identified"),
    ("intervals", "Intervals of the parameters", "by the profile likelihood"),
    ("explain", "What the model lacks", "possible causes, local changes, measurement errors"),
)
"""The analyses in their order, in words."""
_FURTHER = (
    ("pareto", "Pareto front", "designs that lower one of two groups of errors only by raising the other", "calibrate"),
    ("refine", "Better metamodels", "new runs where metamodels know least near what was measured", "sensitivity"),
    ("robustness", "Robustness", "how far responses vary with what is known of the fitted parameters", "calibrate"),
)
"""Analyses of the designs, in words, each with the one that it needs."""
_OF_TEST = ("compare", "sensitivity")
"""Analyses of each test by itself."""
_FIGURES = ("comparison", "responses", "frf_overlays")
"""Model against measurement, of each kind of data."""


def overview(studies: Studies, study: KnownStudy, part: str, test: str) -> dict[str, Any]:
    """The state of a study, for its first view.

    Returns
    -------
    dict
        ``title, synthetic, summary`` (as the report's head says it), ``analyses`` (one each, with ``state``: ``done``,
        ``stale`` or ``never``), ``next`` (a command, ``add`` or ``added``, and the sentence that names it), ``notes``,
        ``parts``, ``tests``, ``kind`` of the data, ``figure``, and ``further``: analyses of the designs, of each the
        one that it needs (``after``) and its ``figure``.
    """
    results = studies.results(study, part, test)
    rows = [_analysis(results, *row) for row in _ROWS if row[0] != "explain" or _has_library(results)]
    summary = page_summary(results)
    ran = any(row["state"] != "never" for row in rows)
    then = _next(results, rows)
    if then["verb"] == "add" and is_added(studies, study, results.explanation["to_add"], part):
        then = {"verb": "added", "words": "The errors with what was added stand beside those without it."}
    return {
        "title": results.title, "name": study.name, "synthetic": results.synthetic, "path": str(study.file.parent),
        "summary": {"found": summary.found, "sure": summary.sure, "then": summary.then, "facts": summary.facts,
                    "origin": summary.origin} if ran else None,
        "analyses": rows, "next": then, "notes": _notes(results), "parts": study.parts,
        "tests": _tests(study), "kind": results.kind if ran else "", "figure": _figure(results) if ran else None,
        "report": studies.report(study, part) is not None, "further": _further(results),
    }  # fmt: skip


def _has_library(results: StudyResults) -> bool:
    """Whether there may be effects to test: known to be none once an analysis has counted them."""
    return (
        not results.record
        or bool(results.tests)
        or bool(results.record.get("effects_known"))
        or bool(results.explanation)
    )


def _figure(results: StudyResults) -> dict[str, str] | None:
    """The figure of model and measurement, of several tests that of the first."""
    for one in (results, *results.tests):
        name = next((name for name in _FIGURES if name in one.figures.plan), None)
        if name is not None:
            return {"name": name, "test": one.test, "words": one.figures.plan[name].caption}
    return None


def _tests(study: KnownStudy) -> list[str]:
    settings = StudyFile.read(study.file).settings
    return [one.name for one in settings.tests] if settings.several else []


def _analysis(results: StudyResults, verb: str, title: str, what: str) -> dict[str, Any]:
    """One analysis; of several tests a comparison and a sensitivity are those of each."""
    each = results.tests if results.tests and verb in _OF_TEST else (results,)
    entries = [one.analyses.get(verb) for one in each]
    stale = next((words for one in each if (words := one.stale.get(verb, ""))), "")
    state = "stale" if stale else "never" if None in entries else "done"
    answers = [(one.test, answer) for one in each if (answer := one.answer(verb))]
    found = " ".join(f"{test}: {answer['found']}" if test else answer["found"] for test, answer in answers)
    return {
        "verb": verb, "title": title, "what": what, "state": state, "stale": arrows(stale),
        "when": max((str(entry.get("when", "")) for entry in entries if entry), default=""),
        "quick": any(bool(entry.get("quick")) for entry in entries if entry), "found": arrows(found),
        "then": answers[0][1].get("then", "") if answers else "",
        "command": answers[0][1].get("command", "") if answers else "",
    }  # fmt: skip


def _further(results: StudyResults) -> list[dict[str, Any]]:
    found = []
    for verb, title, what, after in _FURTHER:
        if verb == "refine" and results.tests:  # it chooses runs of a single test
            continue
        drawing = results.figures.plan.get(verb) if results.record else None
        drawn = {"figure": "", "caption": ""} if drawing is None else {"figure": verb, "caption": drawing.caption}
        found.append({**_analysis(results, verb, title, what), "after": after, **drawn})
    return found


def _next(results: StudyResults, rows: list[dict[str, Any]]) -> dict[str, str]:
    """The command that the latest answer names; the first analysis that is missing or stale where it names none."""
    by_verb = {row["verb"]: row for row in rows}
    stale = next((row for row in rows if row["state"] == "stale"), None)
    if stale is not None:
        return {"verb": stale["verb"], "words": stale["stale"]}
    for verb in ANSWERING:
        row = by_verb.get(verb)
        if row is None or row["state"] != "done":
            continue
        named = row["command"]
        if verb == "explain" and (results.explanation.get("to_add") or results.explanation.get("verdict") in OPEN):
            named = "add" if results.explanation.get("to_add") else "propose"
        if named and by_verb.get(named, {"state": "never"})["state"] == "never":
            return {"verb": named, "words": row["then"]}
        break
    missing = next((row for row in rows if row["state"] == "never" and row["verb"] != "intervals"), None)
    if missing is None or (missing["verb"] == "explain" and by_verb["calibrate"]["state"] == "done"):
        return {"verb": "", "words": ""}
    return {"verb": missing["verb"], "words": f"{missing['title']}: {missing['what']}."}


def _notes(results: StudyResults) -> list[str]:
    """What to know of these results before they are believed."""
    own = [*results.record.get("notes", ()), results.other_code]
    return [str(words) for words in own if words]


def listed(studies: Studies, study: KnownStudy, known: dict[str, KnownStudy]) -> dict[str, Any]:
    """One study in the list of all: title, state, last answer, and the one that it was extended from."""
    part = study.parts[0] if study.parts else ""
    results = studies.results(study, part)
    summary = page_summary(results)
    done = [row["verb"] for row in (_analysis(results, *one) for one in _ROWS) if row["state"] == "done"]
    return {
        "key": study.key, "name": study.name, "title": results.title, "path": str(study.file.parent),
        "done": done, "stale": sorted(results.stale), "found": summary.found if done else "",
        "parent": studies.parent(study, known), "part": part,
    }  # fmt: skip
