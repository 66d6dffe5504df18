"""What the page tells of the model beside the measurement: the worst modes, lines and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.report.comparison import STILL
from calib.report.frf import OVERLAID
from calib.report.html.cells import TextCells
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.numbers import fixed, percent

_REDUCED = 0.1
"""Error of the reduction from which an orthogonality says nothing."""


def have_shapes(stages: Mapping[str, pd.DataFrame]) -> bool:
    """Whether shapes were compared at any stage."""
    return any(table["mac"].notna().any() for table in stages.values())


def mode_errors_in_words(results: StudyResults, stages: Mapping[str, pd.DataFrame]) -> str:
    """Mean and largest frequency error, and mean MAC, of every stage."""
    shapes = have_shapes(stages)
    return " ".join(_errors(results.in_words(stage), table, shapes) for stage, table in stages.items())


def _errors(words: str, table: pd.DataFrame, shapes: bool) -> str:
    words = f"{words[:1].upper()}{words[1:]}"
    error = table["freq_error"].abs()
    if not error.notna().any():
        return f"{words}: no mode is paired."
    worst = table.iloc[int(np.nanargmax(error))]
    note = f"{words}: mean error {percent(error.mean())} %, "
    note += f"largest {percent(worst['freq_error'], 2, sign=True)} % ({worst['mode']})"
    if shapes and table["mac"].notna().any():
        note += f"; mean MAC {fixed(table['mac'].mean(), 3)}"
    return note + "."


def overlaid(functions: pd.DataFrame) -> int:
    """Number of the FRFs that are drawn over each other."""
    return min(OVERLAID, len(functions))


def worst_line(results: StudyResults, stage: str) -> dict[str, float]:
    """``freq`` and ``in_std`` of the line of the largest error over all FRFs."""
    lines = results.functions("frf_lines")[stage]
    freq, in_std = max(zip(lines["freq"].tolist(), lines["in_std"].tolist(), strict=True), key=lambda line: line[1])
    return {"freq": freq, "in_std": in_std}


@dataclass(frozen=True)
class WorstSensors:
    """Sensors at which shapes disagree most.

    Attributes
    ----------
    words : str
    still : bool
        Whether any sensor of the test hardly moves.
    """

    words: str
    still: bool


def worst_sensors(results: StudyResults) -> WorstSensors | None:
    """The sensors of the lowest CoMAC at the last stage; None where it is not known."""
    stages = {stage: table for stage in STAGES if (table := results.table(f"comac_{stage}")) is not None}
    if not stages:
        return None
    stage = list(stages)[-1]
    table = stages[stage].set_index("sensor")
    newest = table["comac"].sort_values(kind="stable", na_position="last")
    still = set(table.index[table["motion"] < STILL]) if "motion" in table else set()
    worst = ", ".join(f"{s} {fixed(v, 3)}{' (hardly moves)' if s in still else ''}" for s, v in newest.head(3).items())
    words = f"Dots. The worst sensors, {results.in_words(stage)}: {worst}; the mean is {fixed(newest.mean(), 3)}."
    return WorstSensors(words, bool(still))


def is_all(results: StudyResults) -> bool:
    """Whether nothing was done but a comparison, which then is the answer."""
    return results.table("parameters") is None and not results.explanation


def expansion_remarks(expansion: pd.DataFrame) -> list[str]:
    """Why a row of the expansion is to be read with care; empty where it is not."""
    few = "the sensors do not tell this shape from others: its orthogonality says nothing"
    known = zip(expansion["reason"].fillna(""), expansion["tam_error"], strict=True)
    return TextCells(str(reason) or (few if error > _REDUCED else "") for reason, error in known)
