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
from calib.results.answer import in_prose

_REDUCED = 0.1
"""Error of the reduction from which an orthogonality says nothing."""
_LINE = 240
"""Most letters about what moves in the modes at the head of the page."""


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


def moving_most(results: StudyResults) -> dict[str, str]:
    """What moves most in each measured mode, such as ``frame along y``: the part and direction with the largest rms.

    Empty where the sensors name no parts, or no shapes were paired. A mode that no model mode pairs with is left out.
    """
    sensors, stages = results.sensors, [results.table(f"shapes_{stage}") for stage in reversed(STAGES)]
    shapes = next((table for table in stages if table is not None), None)
    if sensors is None or shapes is None or "part" not in sensors:
        return {}
    part = shapes["sensor"].map(dict(zip(sensors["sensor"], sensors["part"].fillna(""), strict=True))).fillna("")
    if not part.any():
        return {}
    rows = shapes.assign(where=part + " along " + shapes["direction"], square=shapes["measured_re"] ** 2)
    size = rows[part != ""].groupby(["mode", "where"], sort=False)["square"].mean().dropna().reset_index()
    largest = size.loc[size.groupby("mode", sort=False)["square"].idxmax()]
    return {str(mode): in_prose(where) for mode, where in zip(largest["mode"], largest["where"], strict=True)}


def modes_in_words(results: StudyResults) -> str:
    """What moves most in the modes, those of one kind together; empty for more than a line holds."""
    kinds: dict[str, list[str]] = {}
    for mode, where in moving_most(results).items():
        kinds.setdefault(where, []).append(mode)
    words = "; ".join(f"{', '.join(modes)}: {where}" for where, modes in kinds.items())
    return words if len(words) <= _LINE else ""


def is_all(results: StudyResults) -> bool:
    """Whether nothing was done but a comparison, which then is the answer."""
    return results.table("parameters") is None and not results.explanation


def expansion_remarks(expansion: pd.DataFrame) -> list[str]:
    """Why a row of the expansion is to be read with care; empty where it is not."""
    few = "the sensors do not tell this shape from others: its orthogonality says nothing"
    known = zip(expansion["reason"].fillna(""), expansion["tam_error"], strict=True)
    return TextCells(str(reason) or (few if error > _REDUCED else "") for reason, error in known)
