"""What the page tells of measured and model modes: MAC of all pairs, the pairs, and the motion of every model mode."""

from __future__ import annotations

import math
import re
from typing import Any

from calib.report.html import space
from calib.report.html.study_results import STAGES, StudyResults
from calib.report.numbers import fixed, flag, percent

_MODEL = re.compile(r"(\d+)(?: \((.+) Hz\))?")
"""Header of a column of the MAC: number of the model mode and its frequency."""


def correlation_view(results: StudyResults) -> dict[str, Any] | None:
    """Measured modes against those of the model; None for a study of other data, or before its comparison.

    Returns
    -------
    dict
        ``stages``: of each ``name, words``, the MAC (``measured`` and ``model`` modes with their frequencies, ``mac``
        by row), and ``pairs`` as the report words them. ``scene``: data of the viewer. ``motions``: of each stage the
        motion of the model modes, by number. ``sensors`` and ``modes`` with what is held out.
    """
    if results.kind != "modes" or results.compared("before") is None:
        return None
    stages = [found for stage in STAGES if (found := _stage(results, stage)) is not None]
    measured, sensors = results.table("measured"), results.sensors
    return {
        "stages": stages, "scene": space.scene(results), "motions": space.model_motions(results),
        "modes": [] if measured is None else [
            {"name": str(r["mode"]), "held_out": flag(r["held_out"])} for r in measured.to_dict("records")
        ],
        "sensors": [] if sensors is None else [
            {"name": str(r["sensor"]), "held_out": flag(r["held_out"])} for r in sensors.to_dict("records")
        ],
    }  # fmt: skip


def _stage(results: StudyResults, stage: str) -> dict[str, Any] | None:
    compared, mac = results.compared(stage), results.table(f"mac_{stage}")
    if compared is None:
        return None
    facts = {str(r["mode"]): r for r in compared.to_dict("records")}
    pairs = [_pair(r) for r in facts.values()]
    found: dict[str, Any] = {
        "name": stage,
        "words": results.in_words(stage),
        "pairs": pairs,
        "measured": [],
        "model": [],
        "mac": [],
    }
    if mac is None:
        return found
    columns = [str(column) for column in mac.columns if column != "mode"]
    names = [str(name) for name in mac["mode"]]
    found["model"] = [{"number": int(m[1]), "freq": m[2] or ""} for column in columns if (m := _MODEL.match(column))]
    found["measured"] = [
        {"name": name, "freq": fixed(facts[name]["natural_freq_measured"], 2) if name in facts else ""}
        for name in names
    ]
    found["mac"] = [
        [float(value) if math.isfinite(value) else None for value in row]
        for row in mac[columns].to_numpy(float).tolist()
    ]
    return found


def _pair(r: Any) -> dict[str, Any]:
    """One measured mode with its partner, in words."""
    number = float(r["model_mode"])
    return {
        "mode": str(r["mode"]), "model_mode": int(number) if math.isfinite(number) else None,
        "measured": fixed(r["natural_freq_measured"], 2), "model": fixed(r["natural_freq_model"], 2),
        "error": percent(r["freq_error"], 2, sign=True), "mac": fixed(r["mac"], 3),
        "damping": percent(r["damping_ratio_measured"], 2), "damping_model": percent(r["damping_ratio_model"], 2),
    }  # fmt: skip
