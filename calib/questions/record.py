"""What an answer stands on, kept beside it: the measurement, what is assumed, versions, seeds, and what was said."""

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

from calib.correlation.response_residual import response_std
from calib.correlation.scatter import scatter_of
from calib.errors import InputError
from calib.inference import rules as inference
from calib.joint import said, stacked
from calib.loading import Model
from calib.measurement.disagreements import COLUMNS, Disagreement
from calib.measurement.modal import MeasuredModes
from calib.missing import rules as missing
from calib.named_values import ANY, read_json
from calib.questions.scatter import accuracy_words, assumed_scatter, assumed_words, in_one, scatter_notes
from calib.questions.state import made_from
from calib.results import Results
from calib.several import AnyStudy, JointStudy
from calib.structure.model import Assumption
from calib.study import Study
from calib.version import __version__

PACKAGES = ("numpy", "scipy", "pandas", "pymoo", "SALib", "pyuff", "matplotlib", "plotly")
"""Whose versions may change a digit or a picture."""

MODE_COLUMNS = (
    "mode", "withheld", "natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "repeats",
    "freq_std_used", "damping_std_used",
)  # fmt: skip
SENSOR_COLUMNS = ("sensor", "node", "direction", "x", "y", "z", "part", "withheld", "shape_std")


class HasRepeats(Protocol):
    """A study or a measurement that knows where its repeats disagree."""

    @property
    def disagreements(self) -> Sequence[Disagreement]:
        """Where one repeat disagrees with the others."""
        ...


def write_record(
    study: AnyStudy,
    results: Results,
    question: str,
    seeds: Mapping[str, int],
    sentences: Sequence[str] = (),
    quick: bool = False,
    options: Sequence[str] = (),
) -> None:
    """Write what every answer of a study stands on, and add one question to ``record.json``.

    Writes ``measured.csv``, ``sensors.csv`` (of a modal measurement), ``repeat_disagreements.csv``,
    ``assumptions.csv``, ``parameter_space.csv`` and ``record.json``, which keeps the earlier questions of the same
    folder. Of several tests the tables have the rows of all, with a column ``test``.

    Parameters
    ----------
    study : Study or JointStudy
    results : Results
    question : str
        The verb that was asked.
    seeds : mapping from str to int
        Of the random numbers behind the answer.
    sentences : sequence of str
        What was said about it.
    quick : bool
        Whether it was a small search for a first look.
    options : sequence of str
        Further options of the command that asked, as they are typed.
    """
    tests = study.studies
    tables = {
        "measured": {one.test: measured_table(one) for one in tests},
        "sensors": {
            one.test: sensors_table(one.whole, one.settings.withheld.sensors)
            for one in tests
            if one.whole is not None and one.whole.has_shapes
        },
        "repeat_disagreements": {one.test: disagreements_table(one) for one in tests},
        "assumptions": {one.test: assumptions_table(one) for one in tests},
    }
    for name, own in tables.items():
        if own:
            results.write_table(name, stacked(own) if len(tests) > 1 else own[study.test])
    space = study.search_space if isinstance(study, JointStudy) else study.model.space
    results.write_table("parameter_space", space.frame())
    given, measured = study.settings, [one.settings.measurement for one in tests]
    notes = said({one.test: (*one.measurement_notes, *scatter_notes(one)) for one in tests})
    record = {
        "study": study.name,
        "title": given.title,
        "synthetic": study.synthetic,
        "model": given.model,
        "adopted": {} if given.adopted is None else {n: study.adopted.get(n) for n in given.adopted.parameters},
        "adopted_from": None if given.adopted is None else given.adopted.study,
        "effects_known": len(study.library),
        "effects_in_model": list(given.with_effects),
        "tests": [one.test for one in tests if one.test],
        "files": list(dict.fromkeys(f for m in measured for f in (*m.files, *m.shapes, m.responses) if f)),
        "repeats": study.repeats if isinstance(study, Study) else None,
        "accuracy": in_one(study, accuracy_words),
        "scatter_assumed": in_one(study, assumed_words),
        "notes": [note.removesuffix(".") for note in notes],
        "questions": {
            **earlier(results, question),
            question: {
                **made_with(),
                "quick": quick,
                "options": list(options),
                "seeds": dict(seeds),
                "made_from": made_from(study, question),
                "sentences": list(sentences),
            },
        },
    }
    results.write_json("record", record)


def made_with() -> dict[str, Any]:
    """When, with which versions and by which rules an answer is made."""
    return {
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"calib": __version__, "Python": platform.python_version(), **_installed()},
        "rules": {name: asdict(rules) for name, rules in RULES.items()},
    }


RULES: Mapping[str, Any] = {"inference": inference.RULES, "missing": missing.RULES}
"""What verdicts are made by."""


def measured_table(study: Study) -> pd.DataFrame:
    """Everything that was measured and how far it scatters, withheld data included and marked.

    Of modes `MODE_COLUMNS`: frequencies and their standard deviations in Hz, damping as a ratio, and the number of
    repeats behind the frequency; of plain responses ``response, withheld, value, std, repeats, std_used``. Standard
    deviations are those of the mean over the repeats, of plain responses pooled and with the accuracy that is claimed.
    Those ``used`` are what calibration and explanation weigh by: pooled, with accuracy and floors, and assumed where
    nothing is known.
    """
    held, whole = study.settings.withheld, study.whole
    if whole is None:
        unused = set(held.responses)
        counts = {} if study.responses is None else study.responses.counts
        used = response_std(study.whole_targets)
        rows = [
            (name, name in unused, value, np.nan if std is None else std, counts.get(name, np.nan), taken)
            for (name, (value, std)), taken in zip(study.whole_targets.items(), used, strict=True)
        ]
        return pd.DataFrame(rows, columns=["response", "withheld", "value", "std", "repeats", "std_used"])
    freq_std, damping_std = _std_used(study, whole)
    columns = {
        "mode": list(whole.names),
        "withheld": [name in held.modes for name in whole.names],
        **{name: getattr(whole, name) for name in MODE_COLUMNS[2:-3]},
        "repeats": whole.counts("freq"),
        "freq_std_used": freq_std * whole.natural_freq,
        "damping_std_used": damping_std * whole.damping_ratio,
    }
    return pd.DataFrame(columns, columns=list(MODE_COLUMNS))


def _std_used(study: Study, whole: MeasuredModes) -> tuple[np.ndarray, np.ndarray]:
    """Relative standard deviations of frequency and damping, (n_modes,): as fits weigh by, withheld modes as judged."""
    judged = scatter_of(whole)
    freq, damping = judged.freq.copy(), judged.damping.copy()
    if study.measured is not None:
        fitted, rows = scatter_of(study.measured), [whole.names.index(name) for name in study.measured.names]
        freq[rows], damping[rows] = fitted.freq, fitted.damping
    return freq, damping


def check_repeats(of: HasRepeats) -> list[str]:
    """A sentence for every disagreement between the repeats of a study or a measurement."""
    return [f"Check this repeat: {one.sentence}." for one in of.disagreements]


def disagreements_table(of: HasRepeats) -> pd.DataFrame:
    """What disagrees between the repeats, with its influence: columns `calib.measurement.disagreements.COLUMNS`."""
    rows = [tuple(getattr(one, name) for name in COLUMNS) for one in of.disagreements]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def sensors_table(measured: MeasuredModes, withheld: Sequence[str]) -> pd.DataFrame:
    """Every sensor with its place in metres; columns `SENSOR_COLUMNS`.

    ``shape_std`` is the root mean square over the modes of the standard deviation of its shape, whose largest entry
    in each mode is 1; NaN where unknown.
    """
    rows = []
    for sensor, std in zip(measured.sensors, measured.shape_std, strict=True):
        known = std[np.isfinite(std)]
        scatter = float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
        place = sensor.point or (np.nan, np.nan, np.nan)
        part = sensor.on or ""
        rows.append((sensor.name, sensor.node, sensor.direction, *place, part, sensor.name in withheld, scatter))
    return pd.DataFrame(rows, columns=list(SENSOR_COLUMNS))


def assumptions_table(study: Study) -> pd.DataFrame:
    """What a study assumes; see `assumptions_of`."""
    return assumptions_of(study.model, assumed_scatter(study))


def assumptions_of(model: Model, scatter: Iterable[Assumption]) -> pd.DataFrame:
    """What is assumed of a model, of its parameters' values and limits, and of the measurement's scatter.

    Columns ``item, value, unit, reason``.
    """
    rows = [(a.item, a.value, a.unit, a.reason) for a in (*model.assumptions, *scatter)]
    rows += [(p.name, f"{p.value:g}", p.unit, p.assumed) for p in model.space.parameters if p.assumed]
    return pd.DataFrame(rows, columns=["item", "value", "unit", "reason"])


def questions_of(results: Results) -> dict[str, dict[str, Any]]:
    """Questions of the folder's record, the one asked last at the end; none when there is no readable record."""
    return dict(_record(results).get("questions", {}))


def _record(results: Results) -> dict[str, Any]:
    try:
        return dict(read_json(results.path / "record.json", {"questions": {ANY: _ASKED}}))
    except InputError:
        return {}


def begin_answer(results: Results, question: str) -> None:
    """Take an earlier answer out of the record before its tables are written anew; `write_record` ends the new one.

    A question that breaks off in between has no answer, and tables of two states are never told as one.
    """
    asked = questions_of(results)
    if asked.pop(question, None) is not None:
        results.write_json("record", {**_record(results), "questions": asked})


def earlier(results: Results, question: str) -> dict[str, dict[str, Any]]:
    """Other questions of the folder's record; what was added ends with the answers it rests on."""
    gone = {question} if results.has("added.json") else {question, "extend"}
    return {name: told for name, told in questions_of(results).items() if name not in gone}


_ASKED = {"quick": bool, "options": [str], "made_from": {"files": {ANY: str}, "stated": {ANY: str}, "selected": [str]}}
"""Kinds of what later commands read of a question."""


@cache
def _installed() -> Mapping[str, str]:
    """Asked once: every look into the installed packages searches their folders."""
    out = {}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return MappingProxyType(out)
