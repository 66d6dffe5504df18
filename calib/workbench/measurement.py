"""What the page tells of the measurement: files and what they hold, what looks wrong, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from calib.report.html import explanation, space
from calib.report.html.study_results import StudyResults
from calib.report.numbers import fixed, flag, percent, significant
from calib.study.study_file import StudyFile

_SHOWN = 8
"""Recommended measurements that are listed."""
_LAYERS = ("sensors", "misfit")
"""Dots of the viewer that belong to the measurement."""


def measurement(results: StudyResults, study: StudyFile) -> dict[str, Any] | None:
    """The measurement of a test; None before any analysis has written it.

    Returns
    -------
    dict
        ``files`` of the study, ``heads`` and ``rows`` of what was measured (``name, held_out, cells``), ``kind`` of the
        data, ``sensors`` (``name, held_out``), ``doubts`` and what was checked and is ``fine`` (sentences), ``scene``
        with the sensors, ``order`` of the next tests and ``measurements`` with their gains.
    """
    table, sensors = results.table("measured"), results.sensors
    if table is None:
        return None
    drawn = space.scene(results)
    layers = [] if drawn is None else [one for one in drawn["layers"] if one["name"] in _LAYERS]
    order = results.table("test_order")
    heads, rows = _modes(table) if results.kind == "modes" else _others(table)
    return {
        "files": [_named(path, study.folder) for path in study.inputs],
        "kind": results.kind, "heads": heads, "rows": rows,
        "sensors": [] if sensors is None else [
            {"name": str(r["sensor"]), "held_out": flag(r["held_out"])} for r in sensors.to_dict("records")
        ],
        **_doubts(results), "scene": {**drawn, "stages": [], "layers": layers} if drawn and layers else None,
        "order": [] if order is None else [_step(r) for r in order.to_dict("records")],
        "measurements": recommended(results, _SHOWN), "axes": results.axes,
    }  # fmt: skip


def recommended(results: StudyResults, most: int) -> list[dict[str, str]]:
    """The recommended measurements in words, the best first."""
    found = explanation.candidate_measurements(results)
    if found is None:
        return []
    rows = found.of_named if len(found.of_named) else found.best
    return [
        {"what": str(r["measurement"]), "effect": str(r["effect"]), "gain": f"× {fixed(r['gain'], 2)}",
         "range": f"{fixed(r['gain_low'], 2)} to {fixed(r['gain_high'], 2)}"}
        for r in rows.head(most).to_dict("records")
    ]  # fmt: skip


def _named(path: Path, folder: Path) -> str:
    """A file as the study names it: relative to its folder where it lies there."""
    own = path.resolve()
    return str(own.relative_to(folder.resolve())) if own.is_relative_to(folder.resolve()) else own.name


def _modes(table: pd.DataFrame) -> tuple[list[str], list[dict[str, Any]]]:
    heads = ["mode", "frequency, Hz", "sd, %", "sd in fits, %", "damping, %", "repeats"]
    rows = [
        {"name": str(r["mode"]), "held_out": flag(r["held_out"]), "cells": [
            fixed(r["natural_freq"], 3), percent(r["freq_std"] / r["natural_freq"], 2),
            percent(r["freq_std_used"] / r["natural_freq"], 2), percent(r["damping_ratio"], 2),
            significant(r["repeats"]),
        ]}
        for r in table.to_dict("records")
    ]  # fmt: skip
    return heads, rows


def _others(table: pd.DataFrame) -> tuple[list[str], list[dict[str, Any]]]:
    """Of FRFs and of numbers: the columns of the table as they are."""
    first, *others = [str(name) for name in table.columns if name != "held_out"]
    rows = [
        {"name": str(r[first]), "held_out": flag(r.get("held_out", False)),
         "cells": [significant(r[n]) if isinstance(r[n], float | int) else str(r[n]) for n in others]}
        for r in table.to_dict("records")
    ]  # fmt: skip
    return [first, *others], rows


_CHECKED = {"repeat_disagreements": "No repeat disagrees with the others.", "sensor_check": "No sensor looks wrong."}


def _doubts(results: StudyResults) -> dict[str, list[str]]:
    """What repeats and sensors have against them, and which of the two have nothing, in sentences."""
    tables = {name: results.table(name) for name in _CHECKED}
    told = [str(words) for table in tables.values() if table is not None for words in table["sentence"]]
    fine = [_CHECKED[name] for name, table in tables.items() if table is None and results.has(name)]  # without rows
    return {"doubts": list(dict.fromkeys(told)), "fine": fine}


def _step(r: Mapping[Any, Any]) -> dict[str, str]:
    return {key: "" if pd.isna(r[key]) else str(r[key]) for key in ("what", "excite", "sensors", "how", "narrows")}
