"""What was measured."""

from __future__ import annotations

import numpy as np
import pandas as pd

from calib.report.html.answers import Answers
from calib.report.html.numbers import counted, fixed, flag, percent, significant, yes
from calib.report.html.page import Block, Plot, Section, Table, Terms, Words
from calib.report.html.space import AXES_TOLD, add_dots, new_space
from calib.report.mesh import rest_lines
from calib.report.style import BLUE, MEASURED

USED = ("withheld", "used")
SYNTHETIC = "The measurement is synthetic: a computer made it from a model with noise added; no structure was measured."


def section(answers: Answers) -> Section | None:
    """Modes or responses, sensors, repeats and scatter; what is synthetic or withheld is said first."""
    blocks: list[Block] = [Words(SYNTHETIC, "warning")] if answers.synthetic else []
    table = _responses(answers) if answers.plain else _modes(answers)
    if table is None:
        return Section("measured", "What was measured", tuple(blocks)) if blocks else None
    return Section("measured", "What was measured", (*blocks, *table, *_sensors(answers), *_suspicious(answers)))


def _repeats(answers: Answers) -> str:
    count = answers.record.get("repeats")
    if not count:
        return "The number of repeats is not known."
    if count == 1:
        return "They were measured once, so that the scatter is what the files state, if they do."
    return f"They were measured {count} times; values are means, and standard deviations are those of the mean."


def _withheld(table: pd.DataFrame, name: str, thing: str) -> str:
    held = [str(row[name]) for row in table.to_dict("records") if flag(row["withheld"])]
    if not held:
        return f"No {thing} is withheld."
    return f"Withheld, so that no fit has seen {'it' if len(held) == 1 else 'them'}: {', '.join(held)}."


def _modes(answers: Answers) -> list[Block] | None:
    numbers = ["natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "repeats"]
    table = answers.table("measured", ["mode"], numbers, flags=["withheld"], unique="mode")
    if table is None:
        return None
    rows = tuple(
        (
            str(r["mode"]),
            fixed(r["natural_freq"], 3),
            fixed(r["freq_std"], 3),
            percent(r["freq_std"] / r["natural_freq"]),
            fixed(r["damped_freq"], 3),
            percent(r["damping_ratio"]),
            percent(r["damping_std"]),
            fixed(r["repeats"], 0),
            yes(r["withheld"], USED),
        )
        for r in table.to_dict("records")
    )
    heads = (
        "mode",
        "natural frequency, Hz",
        "std, Hz",
        "std, %",
        "damped frequency, Hz",
        "damping ratio, %",
        "std, %",
        "repeats",
        "",
    )
    told = f"{counted(len(table), 'mode')} were identified. {_repeats(answers)} {_withheld(table, 'mode', 'mode')}"
    terms = (
        ("natural frequency", "|λ| / 2π of the eigenvalue λ, what the mode would have without damping"),
        ("damped frequency", "Im λ / 2π, at which it rings"),
        ("damping ratio", "share of the critical damping"),
        ("std", "standard deviation of the mean, the scatter that everything below is measured by"),
        ("repeats", "repeats behind the frequency"),
    )
    return [Words(told), *_notes(answers), Table("Measured modes", heads, rows, (8,)), Terms(terms)]


def _notes(answers: Answers) -> list[Words]:
    return [Words(f"{note[:1].upper()}{note[1:]}.", "told") for note in answers.record.get("notes", [])]


def _responses(answers: Answers) -> list[Block] | None:
    table = answers.table("measured", ["response"], ["value", "std", "repeats"], flags=["withheld"], unique="response")
    if table is None:
        return None
    rows = tuple(
        (
            str(r["response"]),
            significant(r["value"], 6),
            significant(r["std"], 3),
            fixed(r["repeats"], 0),
            yes(r["withheld"], USED),
        )
        for r in table.to_dict("records")
    )
    told = f"{counted(len(table), 'response')} were measured, each a single number. "
    told += f"{_repeats(answers)} {_withheld(table, 'response', 'response')}"
    terms = (("std", "standard deviation, the scatter that everything below is measured by"),)
    heads = ("response", "value", "std", "repeats", "")
    return [Words(told), *_notes(answers), Table("Measured responses", heads, rows, (4,)), Terms(terms)]


def _sensors(answers: Answers) -> list[Block]:
    table = answers.table(
        "sensors", ["sensor", "direction"], ["x", "y", "z", "shape_std"], flags=["withheld"], blank=["part"]
    )
    if table is None:
        return [] if answers.plain else [Words("No mode shapes were measured, only frequencies and damping.")]
    rows = tuple(
        (
            str(r["sensor"]),
            str(r["direction"]),
            *(fixed(r[axis], 3) for axis in "xyz"),
            str(r["part"]) or "the nearest part",
            percent(r["shape_std"], 1),
            yes(r["withheld"], USED),
        )
        for r in table.to_dict("records")
    )
    heads = ("sensor", "direction", "x, m", "y, m", "z, m", "on", "scatter, % of the largest entry", "")
    told = f"Mode shapes were measured by {counted(len(table), 'sensor')}, each one direction at one point."
    return [
        Words(f"{told} {_withheld(table, 'sensor', 'sensor')}"),
        *_map(answers, table),
        Table(f"The {counted(len(table), 'sensor')}", heads, rows, (1, 5, 7)),
    ]


def _map(answers: Answers, table: pd.DataFrame) -> list[Block]:
    placed = table.dropna(subset=["x", "y", "z"])
    if placed.empty:
        return []
    points = placed[["x", "y", "z"]].to_numpy(dtype=float)
    held = np.array([flag(value) for value in placed["withheld"]])
    words = [f"{s} (direction {d})" for s, d in zip(placed["sensor"], placed["direction"], strict=True)]
    figure = new_space(rest_lines(answers.folder), points)
    for mask, name, marker in (
        (~held, "used", {"color": BLUE, "size": 5}),
        (held, "withheld", {"color": MEASURED, "size": 6, "symbol": "diamond"}),
    ):
        if mask.any():
            told = [w for w, m in zip(words, mask, strict=True) if m]
            add_dots(figure, points[mask], told, name, marker)
    alt = f"Places of {counted(len(placed), 'sensor')} on the structure, {int(held.sum())} of them withheld."
    caption = f"Where the sensors are; point at one for its name, drag to turn. {AXES_TOLD}"
    return [Plot("sensor-map", caption, alt, figure)]


def _suspicious(answers: Answers) -> list[Block]:
    out: list[Block] = []
    for name, what in (("repeat_disagreements", "repeat"), ("sensor_check", "sensor")):
        table = answers.table(name, ["sentence"])
        out += [] if table is None else [Words(f"Check this {what}: {s}", "warning") for s in table["sentence"]]
    return out
