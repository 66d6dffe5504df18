"""Errors over the versions of a model: a study and those it was extended from."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from calib.analyses.provenance.places import results_of
from calib.analyses.provenance.record import analyses_of
from calib.analyses.provenance.stale import stale_analyses
from calib.analyses.provenance.state import measurement_digest
from calib.results.results import Results
from calib.results.table import read_table
from calib.study.study_file import StudyFile, shell_argument
from calib.study.study_text import base_of, read_settings

COLUMNS = ("version", "study", "effects", "group", "rms", "expected")
MOST = 50
"""Largest number of versions; more can only be a circular reference."""


@dataclass(frozen=True, eq=False)
class Versions:
    """Errors over the versions of a model.

    Attributes
    ----------
    table : DataFrame
        ``version, study, effects, group, rms, expected``, the oldest version first.
    notes : tuple of str
        One sentence for every version whose errors are unknown.
    """

    table: pd.DataFrame
    notes: tuple[str, ...] = ()


def write_versions(study: StudyFile, root: Path) -> Versions:
    """Write ``versions.csv`` of a study that was extended from another; an empty table for any other.

    A version's errors are those of its last calibration or, when it was never calibrated, of the base model in its
    explanation. Versions without either, or with stale ones only, are left out with a note.

    Parameters
    ----------
    study : StudyFile
    root : Path
        Root folder of all results.
    """
    nothing = pd.DataFrame(columns=list(COLUMNS))
    chain = [(study.name, study.settings.with_effects, study.file)]
    file, settings = study.file, study.settings
    notes: list[str] = []
    while settings.base is not None and len(chain) < MOST:
        older = base_of(file, settings.base)
        assert older is not None  # or the study could not have been read
        file = older.resolve()
        settings = read_settings(file)
        if not set(settings.with_effects) < set(chain[-1][1]):
            break  # a base study that is not an earlier version
        chain.append((file.parent.name, settings.with_effects, file))
    if len(chain) == 1:
        return Versions(nothing, tuple(notes))
    parts, measurement = [], measurement_digest(study)
    for number, (name, effects, origin) in enumerate(reversed(chain), start=1):
        found = Results(root / name)
        errors = _errors(found, measurement, stale_analyses(origin, found)) if found.belongs_to(origin) else None
        if errors is None:
            command = f"calib explain {shell_argument(origin)} --results {shell_argument(root)}"
            notes.append(f"Version {number} ({name}) has no up-to-date errors under {root}: run '{command}'.")
        else:
            parts.append(errors.assign(version=number, study=name, effects=" + ".join(effects)))
    if not parts:
        return Versions(nothing, tuple(notes))
    table = pd.concat(parts, ignore_index=True)[list(COLUMNS)]
    results_of(study, root).write_table("versions", table)
    return Versions(table, tuple(notes))


def _errors(results: Results, measurement: str, stale: Collection[str]) -> pd.DataFrame | None:
    """Errors on the given measurement; analyses without a recorded measurement are taken to be on it."""
    numbers = ["rms", "expected"]
    states = {analysis: entry.get("made_from", {}) for analysis, entry in analyses_of(results).items()}
    other = {analysis for analysis, made in states.items() if made.get("measurement", measurement) != measurement}
    unusable = other.union(stale)
    if results.has("data_errors.csv") and "calibrate" not in unusable:
        return read_table(results.path / "data_errors.csv", ["group"], numbers, unique="group", may_be_empty=True)
    if results.has("errors.csv") and "explain" not in unusable:
        both = ["group", "stage"]
        table = read_table(results.path / "errors.csv", both, numbers, unique=both, may_be_empty=True)
        return table[table["stage"] == "before"]
    return None
