"""Fits of an explanation, kept so that a calibration of the same model begins where they ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from calib.errors import InputError
from calib.missing.findings import Findings
from calib.questions.stale import stale_questions
from calib.results import Results
from calib.study import Study
from calib.study_file import StudyFile
from calib.study_text import base_of
from calib.table import read_rows

TABLE = "explained_fits"
COLUMNS = ("effects", "parameter", "value")
"""``effects``: those of the model that was fitted, by name and in the order of the alphabet."""


def explained_fits(study: StudyFile, found: Findings) -> pd.DataFrame:
    """The base fit and, where there is one, that with the chosen effects; columns `COLUMNS`."""
    fits = [found.base, *([] if found.chosen is None else [found.chosen])]
    rows = []
    for trial in fits:
        space = trial.state.question.space
        effects = _key(*study.settings.with_effects, *trial.names)
        rows += [(effects, name, trial.state.values[name]) for name in space.free_names]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def explained_fit(study: Study, home: Results) -> Mapping[str, float]:
    """Values at which an explanation has fitted this study's model; empty without one.

    They are those of the study's own explanation, or of the one of the study that it was extended from. An explanation
    of another state of its study is none: its answer is shown nowhere, and starts nothing.

    Parameters
    ----------
    study : Study
    home : Results
        Of the whole study; answers of the other study are in the folder beside it.
    """
    asked = [(study.file, home.path)]
    base = study.settings.base
    parent = None if base is None else base_of(study.file, base)
    if parent is not None:
        asked.append((parent, home.path.parent / parent.parent.name))
    space, effects = study.search_space, _key(*study.settings.with_effects)
    for file, folder in asked:
        found = {}
        rows = _read(folder / f"{TABLE}.csv", effects)
        for name, value in rows if rows and "explain" not in stale_questions(file, Results(folder)) else ():
            if name in space.free_names:
                p = space[name]
                inside = min(max(value, p.lower), p.upper)
                found[name] = float(round(inside)) if p.integer else inside
        if found:
            return found
    return {}


def _key(*names: str) -> str:
    return " ".join(sorted(names))


def _read(path: Path, effects: str) -> list[tuple[str, float]]:
    if not path.is_file():
        return []
    try:
        rows = [row for row in read_rows(path, COLUMNS) if row.cells["effects"] == effects]
        return [(row.text("parameter"), row.number("value")) for row in rows]
    except InputError as fault:
        remedy = "explain the study again, or remove the file"
        raise InputError(fault.problem, place=fault.place, remedy=remedy) from None
