"""Stale results: analyses in a folder that were made from another state of the study."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calib.analyses.provenance.places import QUICK, is_quick
from calib.analyses.provenance.record import analyses_of
from calib.analyses.provenance.state import WRITES, agree, code_of, made_from, state_differences
from calib.errors.errors import InputError
from calib.results.json_file import read_json
from calib.results.results import Results
from calib.results.table import read_table
from calib.results.written import is_changed, is_own
from calib.sensitivity.selection import selected_in
from calib.study.study_file import StudyFile, shell_argument, study_file


@dataclass(frozen=True)
class Stale:
    """Stale analyses of a study.

    Attributes
    ----------
    sentences : mapping from analysis to str
        What has changed, its own tables included, or that it was interrupted, and the command that repeats it.
    files : frozenset of str
        Their tables, and tables that no finished analysis wrote. A table that several analyses write belongs to the
        latest.
    other_code : str
        A sentence on the analyses that are not stale and were computed by other code of calib; empty without.
    """

    sentences: Mapping[str, str] = field(default_factory=dict)
    files: frozenset[str] = frozenset()
    other_code: str = ""

    @property
    def told(self) -> tuple[str, ...]:
        """All sentences."""
        return (*self.sentences.values(), *filter(None, [self.other_code]))


def stale_answers(study: StudyFile, results: Results, root: Path | None = None) -> Stale:
    """Compare the inputs of every analysis in a folder with the study as it is.

    Parameters
    ----------
    study : StudyFile
        As it is now. A `Study` is compared with model and settings, a `StudyFile` without running its code.
    results : Results
    root : Path, optional
        Root folder of all results, for the proposed commands; None for the default.
    """
    changed = {name for name in _ALL_FILES if is_changed(results.path / name)}
    quick = " --quick" * is_quick(study, results)
    place = "" if root is None else f" --results {shell_argument(root)}"
    sentences: dict[str, str] = {}
    writer: dict[str, str] = {}
    again: dict[str, str] = {}
    for analysis, entry in analyses_of(results).items():
        if analysis not in WRITES:
            continue
        writer |= dict.fromkeys(WRITES[analysis], analysis)
        options = "".join(f" {shlex.quote(option)}" for option in entry.get("options", ()))
        again[analysis] = (
            "so its results are not shown; run it again with: "
            f"calib {_verb(analysis)} {shell_argument(study.file)}{options}{quick}{place}"
        )
        if differs := _changed(study, results, analysis, entry):
            sentences[analysis] = f"'{analysis}' was run on an earlier state of {', '.join(differs)}, {again[analysis]}"
    for analysis in again:
        own = sorted(file for file in changed if file == RECORD_FILE or writer.get(file) == analysis)
        if own and analysis not in sentences:
            were, it = ("was", "it") if len(own) == 1 else ("were", "them")
            sentences[analysis] = (
                f"{', '.join(own)} of '{analysis}' {were} changed after calib wrote {it}, {again[analysis]}"
            )
    stale = {file for file, analysis in writer.items() if analysis in sentences}
    others = {file for files in WRITES.values() for file in files} - set(writer)
    written = {file for file in others if is_own(results.path / file)}
    for analysis in WRITES:
        if _OWN[analysis] & written:
            sentences[analysis] = (
                f"'{analysis}' was interrupted, so its incomplete results are not shown; run it again with: "
                f"calib {_verb(analysis)} {shell_argument(study.file)}{quick}{place}"
            )
    current = {name: entry for name, entry in analyses_of(results).items() if name in WRITES and name not in sentences}
    return Stale(sentences, frozenset(stale | written | others & changed), _other_code(current))


def stale_analyses(file: Path, results: Results) -> set[str]:
    """Analyses in a folder that are stale for a study file; all where the file cannot be read."""
    try:
        return set(stale_answers(StudyFile.read(file), results).sentences)
    except InputError:
        return set(analyses_of(results))


RECORD_FILE = "record.json"
_ALL_FILES = {RECORD_FILE, *(file for files in WRITES.values() for file in files)}
_OWN = {
    analysis: frozenset(files) - {file for other, theirs in WRITES.items() if other != analysis for file in theirs}
    for analysis, files in WRITES.items()
}
"""Tables that no other analysis writes."""


def _changed(study: StudyFile, results: Results, analysis: str, entry: Mapping[str, Any]) -> list[str]:
    """What an analysis in a folder was made from and is otherwise now, in words."""
    then, now = dict(entry.get("made_from", {})), made_from(study, analysis)
    if analysis == "calibrate" and (selected := _selected(study, results, entry)) is not None:
        now["selected"], then["selected"] = sorted(selected), sorted(then.get("selected", ()))
    if "taken" not in now and (found := _found_earlier(study, results)):
        now["taken"] = next((values for values in found if agree(then.get("taken", {}), values)), found[0])
    return state_differences(then, now)


def _other_code(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """A sentence on the analyses that were computed by other code of calib; empty without."""
    other = [f"'{name}'" for name in WRITES if name in entries and entries[name].get("code") != code_of(name)]
    if not other:
        return ""
    listed = " and ".join(filter(None, [", ".join(other[:-1]), other[-1]]))
    return f"Results of {listed} were computed by other code of calib than the present one; a new run may change them"


def _verb(analysis: str) -> str:
    """Command that runs an analysis."""
    return "run" if analysis == "extend" else analysis


def _selection_in(results: Results, entry: Mapping[str, Any]) -> Results | None:
    """Folder with the selection that a calibration uses: its own, else that of the quick or of the full run."""
    home = results.path.parent
    places = (results, Results(home / QUICK if entry.get("quick") else home))
    return next((place for place in places if place.has("selection.csv")), None)


def _selected(study: StudyFile, results: Results, entry: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The parameters that the sensitivity analysis selects; None where the study names them, or it was not run."""
    place = _selection_in(results, entry)
    if place is not None and study.settings.selected_by_sensitivity:
        with suppress(InputError):
            return selected_in(place.path / "selection.csv")[0]
    return None


def _found_earlier(study: StudyFile, results: Results) -> list[dict[str, float]]:
    """Values that the study named under ``[adopted]`` has found, in its full run and in its quick run.

    The folder of that study is beside that of this one. Empty where it has no readable results, or nothing is adopted.
    """
    adopted = study.settings.adopted
    home = next((path for path in (results.path, *results.path.parents) if path.name == study.name), None)
    if adopted is None or home is None:
        return []
    name = study_file(study.file.resolve().parent / adopted.study).resolve().parent.name
    out = []
    for folder in (home.parent / name, home.parent / name / QUICK):
        with suppress(InputError):
            values = _best_case(folder)
            out.append({parameter: values[parameter] for parameter in adopted.parameters if parameter in values})
    return out


def _best_case(folder: Path) -> dict[str, float]:
    best = read_json(folder / "summary.json", {"best_case": str}, ["best_case"])["best_case"]
    table = read_table(folder / "parameters.csv", ["case", "parameter"], ["value"], complete=["value"])
    found = table[table["case"] == best]
    return dict(zip(found["parameter"], found["value"], strict=True))
