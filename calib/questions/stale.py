"""Which answers of a folder were made from another state of the study than the present one."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib.errors import InputError
from calib.questions.places import QUICK, is_quick
from calib.questions.record import questions_of
from calib.questions.sensitivity import selected_in, selecting
from calib.questions.state import WRITES, changed, made_from, made_from_on_paper
from calib.questions.taken_over import found_earlier
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile, shell_argument
from calib.written import is_own


@dataclass(frozen=True)
class Stale:
    """What is no longer true of a study.

    Attributes
    ----------
    sentences : mapping from question to str
        Which state it was asked of, or that it broke off, and how to ask again.
    files : frozenset of str
        Tables that hold such answers, or that no finished answer has written. A table that several questions write is
        that of the last one asked.
    """

    sentences: Mapping[str, str] = field(default_factory=dict)
    files: frozenset[str] = frozenset()


def stale_answers(study: StudyFile, results: Results, root: Path | None = None) -> Stale:
    """Compare what every answer of a folder was made from with the study as it is.

    Parameters
    ----------
    study : StudyFile
        As it is now; of a `Study` model and settings are compared, of its file alone what can be told without its code.
    results : Results
    root : Path, optional
        Where results of all studies go, for the commands that are proposed; None where it is the default.
    """
    quick = " --quick" * is_quick(study, results)
    place = "" if root is None else f" --results {shell_argument(root)}"
    sentences: dict[str, str] = {}
    writer: dict[str, str] = {}
    for question, told in questions_of(results).items():
        if question not in WRITES:
            continue
        writer |= dict.fromkeys(WRITES[question], question)
        then = told.get("made_from", {})
        if isinstance(study, Study):
            now = made_from(_selecting(study, results, told) if question == "calibrate" else study, question)
        else:
            found = found_earlier(study, results)
            now = made_from_on_paper(study, question, then, _selected(study, results, told), found)
        if differs := changed(then, now):
            options = "".join(f" {shlex.quote(option)}" for option in told.get("options", ()))
            sentences[question] = (
                f"'{question}' was asked of an earlier state of {', '.join(differs)}, and its answer is not shown; ask "
                f"again with: calib {_verb(question)} {shell_argument(study.file)}{options}{quick}{place}"
            )
    stale = {file for file, question in writer.items() if question in sentences}
    others = {file for files in WRITES.values() for file in files} - set(writer)
    written = {file for file in others if is_own(results.path / file)}
    for question in WRITES:
        if _OWN[question] & written:
            sentences[question] = (
                f"'{question}' broke off before its answer was whole, and what it wrote is not shown; ask again with: "
                f"calib {_verb(question)} {shell_argument(study.file)}{quick}{place}"
            )
    return Stale(sentences, frozenset(stale | written))


def stale_questions(file: Path, results: Results) -> set[str]:
    """Questions of a folder whose answers are not of a study as its file is now; all where it cannot be read."""
    try:
        return set(stale_answers(StudyFile.read(file), results).sentences)
    except InputError:
        return set(questions_of(results))


_OWN = {
    question: frozenset(files) - {file for other, theirs in WRITES.items() if other != question for file in theirs}
    for question, files in WRITES.items()
}
"""Tables that no other question writes."""


def _verb(question: str) -> str:
    """Command that asks a question."""
    return "run" if question == "extend" else question


def _measured_in(results: Results, told: Mapping[str, Any]) -> Results | None:
    """Where the selection is that a calibration in a folder takes: a quick look's, or that of the whole."""
    home = results.path.parent
    places = (results, Results(home / QUICK if told.get("quick") else home))
    return next((place for place in places if place.has("selection.csv")), None)


def _selecting(study: Study, results: Results, told: Mapping[str, Any]) -> Study:
    """The study with the parameters that a calibration would fit now."""
    if place := _measured_in(results, told):
        with suppress(InputError):
            return selecting(study, place)
    return study


def _selected(study: StudyFile, results: Results, told: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The parameters that the sensitivity analysis selects; None where the study names them, or it was not asked."""
    place = _measured_in(results, told)
    if place is not None and isinstance(study.settings.selection, str):
        with suppress(InputError):
            return selected_in(place.path / "selection.csv")[0]
    return None
