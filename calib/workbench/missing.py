"""What the page tells of the physics that a model lacks: effects with evidence, and versions with effects added."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd

from calib.errors.errors import InputError
from calib.missing.explanation import NAMED, OPEN
from calib.report.html import cells, effects, explanation
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, probability
from calib.study.study_file import StudyFile
from calib.workbench.measurement import recommended
from calib.workbench.studies import KnownStudy, Studies

_IN_WORDS = {
    **dict.fromkeys(NAMED, "cause found"), "indistinguishable": "several causes possible",
    "measurement": "error of the measurement", "nothing_detectable": "nothing is missing",
    "unconfirmed": "a guess, not confirmed", "partial": "a cause of a part",
    "noise_underestimated": "standard deviations too small",
}  # fmt: skip
"""Verdicts in short; the others name no cause."""
_SHOWN = 6
"""Rows of a list: errors of the measurement, local changes, and measurements."""


def missing(results: StudyResults) -> dict[str, Any] | None:
    """The explanation of a study; None where there is none.

    Returns
    -------
    dict
        ``words`` (the verdict in short), ``to_add`` (effects that `calib run` adds), ``composed`` (whether others may
        be composed), ``chosen``, ``answer``, ``sentences`` and ``notes``, ``effects`` (ranked, numbers as the report
        words them), ``why`` (sentences), ``shown`` (effects of which the figure shows the change pattern), ``faults``,
        ``places`` (local changes), ``measurements`` (what to measure next), ``axes``.
    """
    if not results.explanation:
        return None
    answer = {key: cells.arrows(words) for key, words in results.answer("explain").items()}
    table, faults = effects.ranked_effects(results), results.table("faults")
    why = results.table("why")
    verdict = str(results.explanation.get("verdict", ""))
    return {
        "to_add": results.explanation.get("to_add", []), "composed": verdict in OPEN,
        "words": _IN_WORDS.get(verdict, "no cause given"), "chosen": list(results.explanation.get("chosen", [])),
        "answer": answer, "sentences": explanation.sentences(results),
        "notes": [cells.arrows(str(words)) for words in results.explanation.get("notes", [])],
        "effects": [] if table is None else _ranked(results, table),
        "why": [] if why is None else effects.why(results).words,
        "shown": [] if why is None else list(dict.fromkeys(why["effect"])),
        "faults": [] if faults is None else _faults(faults),
        "faults_words": "" if faults is None else explanation.named_faults(faults),
        "places": _places(results), "axes": results.axes, "measurements": recommended(results, _SHOWN),
    }  # fmt: skip


def _ranked(results: StudyResults, table: pd.DataFrame) -> list[dict[str, Any]]:
    """Every effect of the library, the strongest evidence first."""
    magnitudes, least = effects.magnitude_cells(table), effects.smallest_visible_magnitudes(table)
    remarks, unseen = effects.remarks(table), effects.unseen(table)
    acts = effects.places_of_effects(results, table) or [""] * len(table)
    return [
        {
            "name": str(r["name"]), "title": str(r["title"]), "z": fixed(r["z"], 1),
            "evidence": fixed(r["ln_bayes"], 1),
            "bar": float(r["ln_bayes"]) if math.isfinite(r["ln_bayes"]) else 0.0,
            "probability": probability(float(r["model_probability"])), "absorbed": fixed(r["unabsorbed"], 2),
            "magnitude": magnitudes[k], "least": least[k], "remark": remarks[k], "unseen": unseen[k],
            "credible": flag(r["credible"]), "lacks": str(r["lacks"]), "look_for": str(r["look_for"]), "acts": acts[k],
        }
        for k, r in enumerate(table.to_dict("records"))
    ]  # fmt: skip


def _faults(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The largest scores of errors of the measurement."""
    first = table.head(_SHOWN)
    return [
        {"told": words or str(r["fault"]), "score": fixed(r["score"], 1, sign=True),
         "limit": fixed(r["limit"], 2), "beyond": abs(float(r["score"])) > float(r["limit"])}
        for r, words in zip(first.to_dict("records"), explanation.faults_in_words(first), strict=True)
    ]  # fmt: skip


def _places(results: StudyResults) -> list[dict[str, Any]]:
    """The local changes with the largest scores."""
    table = effects.ranked_perturbations(results)
    if table is None:
        return []
    first = table.head(_SHOWN)
    at = effects.places_of_perturbations(first)
    return [
        {"name": str(r["perturbation"]), "score": fixed(r["score"], 1, sign=True), "at": at[k]}
        for k, r in enumerate(first.to_dict("records"))
    ]


def versions(studies: Studies, study: KnownStudy, part: str) -> list[dict[str, Any]]:
    """The study and all versions of it, the oldest first, with the errors of each after its calibration.

    Each has ``key, name, parent, effects``, ``errors`` by group (``group, words, rms, expected`` in standard
    deviations, ``text`` of the rms; none before its calibration), and ``fault``: why it cannot be read.
    """
    known = studies.all()
    parents = {key: studies.parent(one, known) for key, one in known.items()}
    first = study.key
    while parents.get(first):
        first = parents[first]
    family, waiting = list[str](), [first]
    while waiting:
        own = waiting.pop(0)
        family.append(own)
        waiting += [key for key, parent in parents.items() if parent == own and key not in family]
    return [_version(studies, known[key], parents.get(key, ""), part) for key in family if key in known]


def _version(studies: Studies, study: KnownStudy, parent: str, part: str) -> dict[str, Any]:
    own = part if part in study.parts else study.parts[0] if study.parts else ""
    found: dict[str, Any] = {"key": study.key, "name": study.name, "parent": parent, "fault": ""}
    try:
        results = studies.results(study, own)
        table = results.table("data_errors")
        names = list(StudyFile.read(study.file).settings.with_effects)
    except InputError as fault:
        return {**found, "effects": [], "errors": [], "fault": fault.sentence}
    return {
        **found, "effects": names,
        "errors": [] if table is None else [
            {"group": str(r["group"]), "words": cells.group_words(str(r["group"])), "rms": float(r["rms"]),
             "expected": float(r["expected"]), "text": fixed(r["rms"], 2)}
            for r in table.to_dict("records") if math.isfinite(r["rms"])
        ],
    }  # fmt: skip


def uncalibrated(studies: Studies, study: KnownStudy, effects: Sequence[str], quick: bool) -> KnownStudy | None:
    """The version of a study that has these effects too, but was not calibrated by such a run; None without one."""
    found = _with_effects(studies, study, effects, "quick" if quick else "")
    keys = [one["key"] for one in found if not one["errors"] and not one["fault"]]
    return studies.one(keys[0]) if keys else None


def is_added(studies: Studies, study: KnownStudy, effects: Sequence[str], part: str) -> bool:
    """Whether a version of a study has these effects too, and its errors are known."""
    return any(one["errors"] for one in _with_effects(studies, study, effects, part))


def _with_effects(studies: Studies, study: KnownStudy, effects: Sequence[str], part: str) -> list[dict[str, Any]]:
    family = {one["key"]: one for one in versions(studies, study, part)}
    wanted = {*family[study.key]["effects"], *effects}
    return [one for one in family.values() if one["parent"] == study.key and set(one["effects"]) == wanted]
