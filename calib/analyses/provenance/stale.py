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
from calib.analyses.provenance.state import WRITES, changed, made_from, made_from_on_paper
from calib.analyses.provenance.taken_over import found_earlier
from calib.analyses.sensitivity import selected_in, selecting
from calib.errors.errors import InputError
from calib.results.results import Results
from calib.results.written import is_own
from calib.study.study import Study
from calib.study.study_file import StudyFile, shell_argument


@dataclass(frozen=True)
class Stale:
    """Stale analyses of a study.

    Attributes
    ----------
    sentences : mapping from analysis to str
        What has changed, or that it was interrupted, and the command that repeats it.
    files : frozenset of str
        Their tables, and tables that no finished analysis wrote. A table that several analyses write belongs to the
        latest.
    """

    sentences: Mapping[str, str] = field(default_factory=dict)
    files: frozenset[str] = frozenset()


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
    quick = " --quick" * is_quick(study, results)
    place = "" if root is None else f" --results {shell_argument(root)}"
    sentences: dict[str, str] = {}
    writer: dict[str, str] = {}
    for analysis, entry in analyses_of(results).items():
        if analysis not in WRITES:
            continue
        writer |= dict.fromkeys(WRITES[analysis], analysis)
        then = entry.get("made_from", {})
        if isinstance(study, Study):
            now = made_from(_selecting(study, results, entry) if analysis == "calibrate" else study, analysis)
        else:
            found = found_earlier(study, results)
            now = made_from_on_paper(study, analysis, then, _selected(study, results, entry), found)
        if differs := changed(then, now):
            options = "".join(f" {shlex.quote(option)}" for option in entry.get("options", ()))
            sentences[analysis] = (
                f"'{analysis}' was run on an earlier state of {', '.join(differs)}, so its results are not shown; run "
                f"it again with: calib {_verb(analysis)} {shell_argument(study.file)}{options}{quick}{place}"
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
    return Stale(sentences, frozenset(stale | written))


def stale_analyses(file: Path, results: Results) -> set[str]:
    """Analyses in a folder that are stale for a study file; all where the file cannot be read."""
    try:
        return set(stale_answers(StudyFile.read(file), results).sentences)
    except InputError:
        return set(analyses_of(results))


_OWN = {
    analysis: frozenset(files) - {file for other, theirs in WRITES.items() if other != analysis for file in theirs}
    for analysis, files in WRITES.items()
}
"""Tables that no other analysis writes."""


def _verb(analysis: str) -> str:
    """Command that runs an analysis."""
    return "run" if analysis == "extend" else analysis


def _selection_in(results: Results, entry: Mapping[str, Any]) -> Results | None:
    """Folder with the selection that a calibration uses: its own, else that of the quick or of the full run."""
    home = results.path.parent
    places = (results, Results(home / QUICK if entry.get("quick") else home))
    return next((place for place in places if place.has("selection.csv")), None)


def _selecting(study: Study, results: Results, entry: Mapping[str, Any]) -> Study:
    """The study with the parameters that a calibration would fit now."""
    if place := _selection_in(results, entry):
        with suppress(InputError):
            return selecting(study, place)
    return study


def _selected(study: StudyFile, results: Results, entry: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The parameters that the sensitivity analysis selects; None where the study names them, or it was not run."""
    place = _selection_in(results, entry)
    if place is not None and study.settings.selected_by_sensitivity:
        with suppress(InputError):
            return selected_in(place.path / "selection.csv")[0]
    return None
