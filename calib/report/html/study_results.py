"""Results of the analyses in a results folder, read for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import pandas as pd

from calib.errors.errors import InputError
from calib.report.html.columns import COLUMNS
from calib.report.tables import (
    TEST,
    Folder,
    Kind,
    comparison_kind,
    has_column,
    read_results,
    read_stages,
    without_stage,
)
from calib.results.answer import in_prose
from calib.results.json_file import ANY, read_json

if TYPE_CHECKING:
    from calib.report.figures import Figures

REPORT = "report.html"
"""Name of the page."""
STAGES = ("before", "after")
_ANALYSIS = {
    "when": str, "quick": bool, "versions": {ANY: str}, "seeds": {ANY: float}, "sentences": [str],
    "answer": {"found": str, "sure": str, "then": str, "command": str},
}  # fmt: skip
RECORD = {
    "study": str, "notebook": bool, "model": str, "adopted": {ANY: float}, "adopted_from": str, "effects_known": float,
    "effects_in_model": [str], "files": [str], "axes": str, "repeats": float, "notes": [str],
    "analyses": {ANY: _ANALYSIS},
}  # fmt: skip
_FIGURES = {
    name: float
    for name in (
        *("misfit", "search_misfit", "mean_freq_error_before", "mean_freq_error_after", "mean_mac_before"),
        *("mean_mac_after", "noise_freq_error", "noise_mac", "seconds", "evaluations", "solved", "infeasible"),
        *("failed", "birge"),
    )
}
SUMMARY = {"best_case": str, "method": str, **_FIGURES, "cases": {ANY: _FIGURES}, "tests": {ANY: _FIGURES}}
EXPLANATION = {
    "verdict": str, "sentence": str, "sentences": [str], "notes": [str], "chosen": [str], "credible_set": [str],
    "to_add": [str],
    "alpha": float, "p_family": float, "p_fit": float, "adequacy_p_family": float, "adequacy_p_fit": float,
    "evaluations": float, "doubts": [{"doubt": str, "check": str}], "errors": {ANY: {"before": float, "after": float}},
}  # fmt: skip
ADDED = {
    "sentence": str, "conclusion": str, "own": str, "effects": [{"name": str, "title": str}], "study": str,
    "mean_freq_error": float, "mean_mac": float,
    "own_modes": [{"effect": str, "natural_freq": float, "share": float, "paired": str}],
}  # fmt: skip
PROPOSALS = {"sentences": [str]}
"""Types of the named values that the page reads, by file."""


@dataclass(frozen=True)
class StudyResults:
    """Tables and records of one folder; those of an analysis that was not run are None or empty.

    Attributes
    ----------
    folder : Path
    title : str
        Title of the study.
    synthetic : bool
        Whether the measurement is synthetic.
    stale : mapping from analysis to str
        Analyses of another state of the study, with a sentence about each; ``folder`` hides their results.
    other_code : str
        A sentence on the analyses that other code of calib has computed; empty without.
    tests : tuple of StudyResults
        Of several tests that are fitted together each by itself; this folder then holds what they say together.
    test, prefix : str
        One of such tests: its name, and the beginning of the names of its parts of the page. Empty without others.
    """

    folder: Folder
    title: str
    synthetic: bool
    stale: Mapping[str, str] = field(default_factory=dict)
    other_code: str = ""
    tests: tuple[StudyResults, ...] = ()
    test: str = ""
    prefix: str = ""
    _tables: dict[str, pd.DataFrame | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def record(self) -> dict[str, Any]:
        """``record.json``: provenance of the results."""
        return self._json("record", RECORD)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """``summary.json`` of a calibration."""
        errors = () if self.tests else ("mean_freq_error_before", "mean_freq_error_after")
        return self._json("summary", SUMMARY, errors)

    @cached_property
    def explanation(self) -> dict[str, Any]:
        """``explanation.json``."""
        return self._json("explanation", EXPLANATION)

    @cached_property
    def added(self) -> dict[str, Any]:
        """``added.json``: the effects added after an explanation, or why there are none; of several tests in one."""
        if self.tests:
            return _together({test.test: test.added for test in self.tests if test.added})
        found = self._json("added", ADDED, ("sentence",))
        if found.get("effects") and not {"study", "mean_freq_error", "mean_mac"} <= found.keys():
            raise InputError("it is incomplete", place=self.folder / "added.json", remedy="run the analysis again")
        return found

    @cached_property
    def proposals(self) -> dict[str, Any]:
        """``proposals.json``."""
        return self._json("proposals", PROPOSALS)

    @cached_property
    def figures(self) -> Figures:
        """The figures of the folder."""
        from calib.report.figures import Figures

        return Figures(self.folder, self.title, self.synthetic, self.prefix, str(self.record.get("axes", "")))

    @property
    def added_effects(self) -> str:
        """Names of the effects that were added, joined by " + "; empty where there are none."""
        return " + ".join(in_prose(str(effect["name"])) for effect in self.added.get("effects", ()))

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages of the model that was compared: before and after calibration, and with added effects."""
        return (*STAGES, *(["added"] if self.added_effects else []))

    def in_words(self, stage: str) -> str:
        """What the model of a stage is; see `calib.report.style.stage_words`."""
        from calib.report.style import stage_words

        return stage_words(stage, self.added_effects)

    def has(self, name: str) -> bool:
        """Whether the folder has a table of that name."""
        return (self.folder / f"{name}.csv").exists()

    def table(self, name: str) -> pd.DataFrame | None:
        """Read the `COLUMNS` of ``name.csv``; None without the file or without rows in it.

        Each table is read once: who changes one makes a copy. Of several tests, parameters with and without added
        effects, and assumptions, are those of all.
        """
        if self.tests and name == "added_parameters":
            return next((table for one in self.tests if (table := one.table(name)) is not None), None)
        if name not in self._tables:
            self._tables[name] = self._read(name) if self.has(name) else None
        return self._tables[name]

    def of_stages(self, name: str) -> dict[str, pd.DataFrame]:
        """The tables of that name that are there, by the stage of the model."""
        found = {stage: self.table(f"{name}_{stage}") for stage in self.stages}
        return {stage: table for stage, table in found.items() if table is not None}

    def functions(self, name: str) -> dict[str, pd.DataFrame]:
        """Tables of FRFs by the stage of the model, as `calib.report.tables.read_stages` reads them."""
        return read_stages(self.folder, name, self.stages)

    def _read(self, name: str) -> pd.DataFrame | None:
        kind = without_stage(name)
        columns = dict(COLUMNS.get(kind) or COLUMNS[f"{kind} of {self.kind}"])
        path, text = self.folder / f"{name}.csv", list(columns.pop("text"))
        if not self.tests or TEST in text or not has_column(path, TEST):
            table = read_results(path, text, may_be_empty=True, **columns)
        else:
            table = read_results(path, [*text, TEST], may_be_empty=True, **columns)
            if name == "assumptions":
                table = table.drop(columns=TEST).drop_duplicates(ignore_index=True)
        return None if table.empty else table

    def sentences(self, analysis: str) -> tuple[str, ...]:
        """Sentences that an analysis reported; none if it was not run or is stale."""
        record = {} if analysis in self.stale else self.analyses.get(analysis, {})
        return tuple(str(words) for words in record.get("sentences", ()))

    def answer(self, analysis: str) -> Mapping[str, str]:
        """What an analysis found, how sure that is, and what to do next; empty if it was not run or is stale."""
        record = {} if analysis in self.stale else self.analyses.get(analysis, {})
        return {key: str(words) for key, words in record.get("answer", {}).items()}

    @property
    def analyses(self) -> Mapping[str, Mapping[str, Any]]:
        """The analyses that were run, with their versions and seeds."""
        return dict(self.record.get("analyses", {}))

    @property
    def name(self) -> str:
        """Name of the study on the command line."""
        return str(self.record.get("study", "STUDY"))

    @property
    def axes(self) -> str:
        """What the axes mean, as the model says it, or how the figures show them."""
        return f"Axes: {self.record.get('axes') or 'x along, y up, z across'}."

    @cached_property
    def kind(self) -> Kind:
        """Whether the study compares modes, scalar responses or FRFs."""
        for table in ("measured", "comparison_before", "comparison_after"):
            if self.has(table):
                return comparison_kind(self.folder / f"{table}.csv")
        return "responses" if self.has("response_misfit") else "frf" if self.has("frf_misfit") else "modes"

    def compared(self, stage: str) -> pd.DataFrame | None:
        """``comparison_before.csv``, ``comparison_after.csv`` or ``comparison_added.csv`` of a modal study."""
        return self.table(f"comparison_{stage}") if self.kind == "modes" else None

    @property
    def sensors(self) -> pd.DataFrame | None:
        """``sensors.csv``."""
        return self.table("sensors")

    def runs(self) -> pd.DataFrame:
        """Extent, time, seeds and versions of every analysis."""
        from_python = self.record.get("notebook")
        return pd.DataFrame(
            [
                {
                    "analysis": analysis if from_python else f"calib {analysis}",
                    "extent": ("quick run" if run.get("quick") else "full run") + ", stale" * (analysis in self.stale),
                    "when": str(run.get("when", "")).replace("T", " ").replace("+00:00", " UTC"),
                    "seeds": _listed(run.get("seeds", {})) or "none needed",
                    "versions": _listed(run.get("versions", {})),
                }
                for analysis, run in self.analyses.items()
            ]
        )

    def not_run(self) -> dict[str, str]:
        """What an analysis without results in this folder would tell, with its name."""
        if self.record.get("notebook"):  # there is no study folder for the command
            return {}
        lacking = {
            "Model against measurement, mode by mode": ("compare", not self._any_has("comparison_before")),
            "Which parameters matter": ("sensitivity", not self._any_has("selection")),
            "Identified parameters and errors after a calibration": ("calibrate", not self.has("parameters")),
            "Which effects the model lacks": (
                "explain", not self.explanation and bool(self.record.get("effects_known"))
            ),
            "The model with the named effects added": (
                "run",
                not self.added and bool(self.explanation.get("to_add")),
            ),
        }  # fmt: skip
        return {what: name for what, (name, lacks) in lacking.items() if lacks and name not in self.stale}

    def _any_has(self, name: str) -> bool:
        """Whether this folder, or that of one of several tests, has a table."""
        return any(one.has(name) for one in (self, *self.tests))

    def _json(self, name: str, kinds: Mapping[Any, Any], required: Sequence[str] = ()) -> dict[str, Any]:
        path = self.folder / f"{name}.json"
        return read_json(path, kinds, required) if path.exists() else {}


def _together(added: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The effects that were added to a model of several tests, by what each test says of them."""
    if not added:
        return {}
    first = next(iter(added.values()))
    if not first.get("effects"):
        return dict(first)
    conclusion = " ".join(f"{test}: {one['conclusion']}" for test, one in added.items() if one.get("conclusion"))
    sentence = f"Added: {' and '.join(str(effect['name']) for effect in first['effects'])}. {conclusion}".strip()
    return {"sentence": sentence, "conclusion": conclusion, "effects": first["effects"], "study": first["study"]}


def _listed(named: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in named.items())
