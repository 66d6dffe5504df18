"""The answers that a folder of results holds, read for the page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from calib.errors import InputError
from calib.report.shown import Folder
from calib.table import read_table

STAGES = ("before", "after")


@dataclass(frozen=True)
class Answers:
    """Tables and records of one folder; what was not asked is None or empty.

    Attributes
    ----------
    folder : Path
    title : str
        Of the study.
    synthetic : bool
        Whether the measurement is invented.
    stale : mapping from question to str
        Questions that were asked of another state of the study, with a sentence about each; ``folder`` hides what they
        answered.
    """

    folder: Folder
    title: str
    synthetic: bool
    stale: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def record(self) -> dict[str, Any]:
        """``record.json``: what the answers stand on."""
        return self._json("record")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """``summary.json`` of a calibration."""
        return self._json("summary")

    @cached_property
    def explanation(self) -> dict[str, Any]:
        """``explanation.json``."""
        return self._json("explanation")

    @cached_property
    def added(self) -> dict[str, Any]:
        """``added.json``: what was added after an explanation, or why nothing was."""
        return self._json("added")

    @property
    def added_names(self) -> tuple[str, ...]:
        """Names of the effects that were added."""
        return tuple(str(effect["name"]) for effect in self.added.get("effects", ()))

    def has(self, name: str) -> bool:
        """Whether a table of that name was written."""
        return (self.folder / f"{name}.csv").exists()

    def table(
        self, name: str, text: Sequence[str] = (), numbers: Sequence[str] = (), **more: Any
    ) -> pd.DataFrame | None:
        """Read ``name.csv`` as `calib.report.tables.read_table` does; None without the file or without rows in it."""
        if not self.has(name):
            return None
        table = read_table(self.folder / f"{name}.csv", text, numbers, may_be_empty=True, **more)
        return None if table.empty else table

    def sentences(self, question: str) -> tuple[str, ...]:
        """What was said when a question was asked; nothing when it was not."""
        asked = {} if question in self.stale else self.questions.get(question, {})
        return tuple(str(words) for words in asked.get("sentences", ()))

    @property
    def questions(self) -> Mapping[str, Mapping[str, Any]]:
        """What was asked, and with which versions and seeds."""
        asked = self.record.get("questions", {})
        return asked if isinstance(asked, dict) else {}

    @property
    def name(self) -> str:
        """Name of the study, as the command line knows it."""
        return str(self.record.get("study", "STUDY"))

    @property
    def plain(self) -> bool:
        """Whether plain responses are compared, which have no modes."""
        for table in ("measured", "comparison_before", "comparison_after"):
            if self.has(table):
                with (self.folder / f"{table}.csv").open(encoding="utf-8", errors="replace") as stream:
                    return stream.readline().startswith("response,")
        return self.has("response_misfit")

    def compared(self, stage: str) -> pd.DataFrame | None:
        """``comparison_before.csv`` or ``comparison_after.csv`` of a modal study."""
        numbers = [
            *("model_mode", "natural_freq_measured", "natural_freq_model", "freq_error", "damping_ratio_measured"),
            *("damping_ratio_model", "mac", "emac", "margin"),
        ]
        return None if self.plain else self.table(f"comparison_{stage}", ["mode"], numbers, unique="mode")

    @property
    def noise_mac(self) -> float:
        """Mean MAC that noise alone would leave a perfect model; NaN where unknown."""
        value = self.summary.get("noise_mac")
        return float("nan") if value is None else float(value)

    def _json(self, name: str) -> dict[str, Any]:
        path = self.folder / f"{name}.json"
        if not path.exists():
            return {}
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as problem:
            raise InputError(f"it cannot be read: {problem}", place=path, remedy="ask the question again") from problem
        if not isinstance(content, dict):
            raise InputError("it holds no named values", place=path, remedy="ask the question again")
        return content
