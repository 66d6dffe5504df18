"""Record of an analysis beside its results: measurement, assumptions, versions, seeds, and sentences."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import pandas as pd

from calib.analyses.provenance.state import code_of, made_from, rules_of
from calib.analyses.uncertainty import accuracy_words, assumed_std, assumed_words, in_one, std_notes
from calib.errors.errors import InputError
from calib.measurement.disagreements import COLUMNS, Disagreement
from calib.problem.joint import prefixed, stacked
from calib.problem.space import ParameterSpace
from calib.results.answer import Answer
from calib.results.json_file import ANY, read_json
from calib.results.results import Results
from calib.results.version import __version__
from calib.structure.model import Assumption
from calib.study.loading import Model
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy
from calib.study.study_file import Measured

PACKAGES = (
    "numpy", "scipy", "pandas", "pymoo", "SALib", "pyuff", "matplotlib", "scikit-learn", "emcee", "pymetis"
)  # fmt: skip
"""Packages whose versions, or presence, may change a digit or a figure."""

SENSOR_COLUMNS = ("sensor", "node", "direction", "x", "y", "z", "part", "held_out", "shape_std")


class HasRepeats(Protocol):
    """A study or a measurement with the disagreements between its repeats."""

    @property
    def disagreements(self) -> Sequence[Disagreement]:
        """Values in which one repeat disagrees with the others."""
        ...


def write_record(
    study: AnyStudy,
    results: Results,
    analysis: str,
    seeds: Mapping[str, int],
    sentences: Sequence[str] = (),
    quick: bool = False,
    options: Sequence[str] = (),
    answer: Answer | None = None,
) -> None:
    """Write the data and assumptions behind the results, and add one analysis to ``record.json``.

    Writes ``measured.csv``, ``sensors.csv`` (of a modal measurement), ``repeat_disagreements.csv``,
    ``assumptions.csv``, ``parameter_space.csv`` and ``record.json``, which keeps the earlier analyses of the same
    folder. For several tests the tables have the rows of all, with a column ``test``.

    Parameters
    ----------
    study : Study or JointStudy
    results : Results
    analysis : str
        The verb of the command.
    seeds : mapping from str to int
        Of the random numbers behind the results.
    sentences : sequence of str
        The reported sentences.
    quick : bool
        Whether it was a quick run.
    options : sequence of str
        Further options of the command, as they are typed.
    answer : Answer, optional
        The sentences that head the analysis on the console and in the report.
    """
    tests = study.studies
    tables = {
        "measured": {one.test: measured_table(one) for one in tests},
        "sensors": {
            one.test: sensors_table(whole, one.experiment.held_out_sensors)
            for one in tests
            if (whole := one.measurement()).sensors
        },
        "repeat_disagreements": {one.test: disagreements_table(one) for one in tests},
        "assumptions": {one.test: assumptions_table(one) for one in tests},
    }
    for name, own in tables.items():
        if own:
            results.write_table(name, stacked(own) if len(tests) > 1 else own[study.test])
    limits = [one.sensitivity_space for one in tests]
    results.write_table("parameter_space", limits_table(study.search_space, study.space, limits))
    given, measured = study.settings, [one.settings.measurement for one in tests]
    notes = prefixed({one.test: (*one.experiment.notes, *std_notes(one)) for one in tests})
    record = {
        "study": study.name,
        "title": given.title,
        "synthetic": study.synthetic,
        "model": given.model if given.solver is None else given.solver.command,
        "adopted": {} if given.adopted is None else {n: study.adopted.get(n) for n in given.adopted.parameters},
        "adopted_from": None if given.adopted is None else given.adopted.study,
        "effects_known": len(study.library),
        "effects_in_model": list(given.with_effects),
        "axes": in_one(study, _axes),
        "tests": [one.test for one in tests if one.test],
        "files": list(dict.fromkeys(f for m in measured for f in (*m.files, *m.shapes, m.responses) if f)),
        "repeats": study.repeats,
        "accuracy": in_one(study, accuracy_words) or "none",
        "std_assumed": in_one(study, assumed_words),
        "notes": [note.removesuffix(".") for note in notes],
        "analyses": {
            **earlier(results, analysis),
            analysis: {
                **made_with(analysis),
                "quick": quick,
                "options": list(options),
                "seeds": dict(seeds),
                "made_from": {**made_from(study, analysis), "selected": list(study.search_space.free_names)},
                "sentences": list(sentences),
                **({} if answer is None else {"answer": answer.plain}),
            },
        },
    }
    results.write_json("record", record)


def _axes(study: LoadedStudy) -> str:
    """What the axes of the model mean, in words; empty where it does not say."""
    mesh = getattr(study.model, "mesh", None)  # a function of scalar responses has none
    return "" if mesh is None else mesh.axes


def limits_table(
    search: ParameterSpace, space: ParameterSpace, sensitivity: Sequence[ParameterSpace] = ()
) -> pd.DataFrame:
    """Every parameter of a model with the limits of the sensitivity beside those of the calibration.

    Parameters
    ----------
    search : ParameterSpace
        Parameters within the limits of the calibration; free are those that it varies.
    space : ParameterSpace
        The parameters to list.
    sensitivity : sequence of ParameterSpace
        Spaces whose limits the sensitivity keeps, one for each test: of several limits the narrowest. Without one, or
        where none leaves a parameter free, the limits are those of ``space``.

    Returns
    -------
    DataFrame
        Columns of `calib.problem.space.ParameterSpace.frame`, with ``search_lower, search_upper`` after ``upper``:
        limits of calibration and explanation, which every position in a range and share of a range refers to; NaN where
        they hold the parameter at its value.
    """
    table = space.frame()
    own = [[one[name] for one in sensitivity if name in one.free_names] or [space[name]] for name in space.names]
    table["lower"] = [max(p.lower for p in alike) for alike in own]
    table["upper"] = [min(p.upper for p in alike) for alike in own]
    varied = [search[name] if name in search.free_names else None for name in space.names]
    after = list(table.columns).index("upper") + 1
    table.insert(after, "search_lower", [np.nan if p is None else p.lower for p in varied])
    table.insert(after + 1, "search_upper", [np.nan if p is None else p.upper for p in varied])
    return table


def made_with(analysis: str) -> dict[str, Any]:
    """Time, versions, rules and code of an analysis made now."""
    return {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"calib": __version__, "Python": platform.python_version(), **_installed()},
        "rules": {name: asdict(rules) for name, rules in rules_of(analysis).items()},
        "code": code_of(analysis),
    }


def measured_table(study: LoadedStudy) -> pd.DataFrame:
    """All measured data with their standard deviations, held-out data included and marked.

    Columns are those of `calib.experiment.ModalTest.table`, and of the same for scalar responses and FRFs.
    Standard deviations are those of the mean over the repeats; for scalar responses they are pooled and include the
    claimed accuracy. Those ``used`` are the weights of calibration and explanation: pooled, with accuracy and floors,
    and assumed where nothing is known.
    """
    return study.experiment.table()


def check_repeats(of: HasRepeats) -> list[str]:
    """A sentence for every disagreement between the repeats of a study or a measurement."""
    return [f"Check this repeat: {one.sentence}." for one in of.disagreements]


def disagreements_table(of: HasRepeats) -> pd.DataFrame:
    """Disagreements between the repeats; columns `calib.measurement.disagreements.COLUMNS`."""
    rows = [tuple(getattr(one, name) for name in COLUMNS) for one in of.disagreements]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def sensors_table(measured: Measured, held_out: Sequence[str]) -> pd.DataFrame:
    """Every sensor with its location (m); columns `SENSOR_COLUMNS`.

    ``shape_std`` is the root mean square over the modes of the standard deviation of its shape entries, with the
    largest entry of each mode scaled to 1; NaN where unknown, and for sensors of FRFs, references among them.
    """
    rows = []
    for sensor, shape_std in zip(measured.sensors, measured.sensor_std.tolist(), strict=True):
        place = sensor.point or (np.nan, np.nan, np.nan)
        part = sensor.on or ""
        rows.append((sensor.name, sensor.node, sensor.direction, *place, part, sensor.name in held_out, shape_std))
    return pd.DataFrame(rows, columns=list(SENSOR_COLUMNS))


def assumptions_table(study: LoadedStudy) -> pd.DataFrame:
    """Assumptions of a study; see `assumptions_of`."""
    return assumptions_of(study.model, assumed_std(study))


def assumptions_of(model: Model, std: Iterable[Assumption]) -> pd.DataFrame:
    """Assumptions on a model, on its parameters' values and limits, and on the standard deviations of the measurement.

    Columns ``item, value, unit, reason``.
    """
    rows = [(a.item, a.value, a.unit, a.reason) for a in (*model.assumptions, *std)]
    rows += [(p.name, f"{p.value:g}", p.unit, p.assumed) for p in model.space.parameters if p.assumed]
    return pd.DataFrame(rows, columns=["item", "value", "unit", "reason"])


def analyses_of(results: Results) -> dict[str, dict[str, Any]]:
    """Analyses in the folder's record, the latest last; empty when there is no readable record."""
    return dict(_record(results).get("analyses", {}))


def _record(results: Results) -> dict[str, Any]:
    try:
        return dict(read_json(results.path / "record.json", {"analyses": {ANY: _ANALYSIS}}))
    except InputError:
        return {}


def begin_analysis(results: Results, analysis: str) -> None:
    """Remove an earlier analysis from the record before its tables are overwritten; `write_record` adds the new one.

    An interrupted analysis is not in the record, so that tables of two states are never reported as one.
    """
    analyses = analyses_of(results)
    if analyses.pop(analysis, None) is not None:
        results.write_json("record", {**_record(results), "analyses": analyses})


def earlier(results: Results, analysis: str) -> dict[str, dict[str, Any]]:
    """Other analyses in the folder's record; those that rest on one are dropped with it, as their files are."""
    resting = {"extend": "added.json", "propose": "proposals.json"}
    gone = {analysis, *(name for name, file in resting.items() if not results.has(file))}
    return {name: entry for name, entry in analyses_of(results).items() if name not in gone}


_ANALYSIS = {
    "quick": bool,
    "options": [str],
    "code": str,
    "made_from": {"files": {ANY: str}, "sources": [str], "stated": {ANY: str}, "selected": [str]},
}
"""Types of the entries of an analysis that later commands read."""


@cache
def _installed() -> Mapping[str, str]:
    """Versions of the installed packages; cached, since each lookup searches their folders."""
    out = {}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return MappingProxyType(out)
