"""Fits of an explanation, stored as starting points for a calibration of the same model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from calib.analyses.provenance.stale import stale_analyses
from calib.errors.errors import InputError
from calib.missing.detailed import DetailedFit
from calib.missing.explanation import Explanation
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.results.table import read_rows
from calib.study.several import AnyStudy
from calib.study.study_file import StudyFile
from calib.study.study_text import base_of

TABLE = "explained_fits"
COLUMNS = ("effects", "parameter", "value")
"""``effects``: those in the fitted model, by name in alphabetical order."""


def explained_fits(study: StudyFile, found: Explanation, richer: Sequence[DetailedFit] = ()) -> pd.DataFrame:
    """The base fit and, if any, the fits with the chosen effects and with richer members; columns `COLUMNS`."""
    fits = [found.base, *([] if found.chosen is None else [found.chosen]), *(one.candidate_fit for one in richer)]
    rows = []
    for candidate_fit in fits:
        space = candidate_fit.fit.fit_problem.space
        effects = _key(*study.settings.with_effects, *candidate_fit.names)
        rows += [(effects, name, candidate_fit.fit.values[name]) for name in space.free_names]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def explained_fit(study: AnyStudy, home: Results, beside: Sequence[str] = ()) -> Mapping[str, float]:
    """Values at which an explanation fitted this study's model; empty without one.

    They come from the study's own explanation, or from that of the study it was extended from. An explanation of
    another state of its study is ignored.

    Parameters
    ----------
    study : Study
    home : Results
        Of full runs of the study; results of the other study are in the folder beside it.
    beside : sequence of str
        Effects that its model lacks, but had in the fit; their parameters are among the values.
    """
    sources = [(study.file, home.path)]
    base = study.settings.base
    parent = None if base is None else base_of(study.file, base)
    if parent is not None:
        sources.append((parent, home.path.parent / parent.parent.name))
    every = (one for effect in study.candidates for one in effect.family)
    own = [p for effect in every if effect.name in beside for p in effect.parameters]
    space, effects = study.search_space, _key(*study.settings.with_effects, *beside)
    space = ParameterSpace((*space.parameters, *own), space.constraints) if own else space
    for file, folder in sources:
        found = {}
        rows = _read(folder / f"{TABLE}.csv", effects)
        for name, value in rows if rows and "explain" not in stale_analyses(file, Results(folder)) else ():
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
