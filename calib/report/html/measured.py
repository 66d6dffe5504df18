"""Section on the measurement."""

from __future__ import annotations

import pandas as pd

from calib.report.html.page import Block, Picture, Section, Table, Terms, Words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import counted, fixed, flag, percent, significant, yes

USED = ("held out", "used")
SYNTHETIC = "The measurement is synthetic: a computer made it from a model with noise added; no structure was measured."


def section(results: StudyResults) -> Section | None:
    """Modes or responses, sensors, repeats and standard deviations; first of all, whether the data are synthetic."""
    blocks: list[Block] = [Words(SYNTHETIC, "warning")] if results.synthetic else []
    table = {"modes": _modes, "responses": _responses, "frf": _frfs}[results.kind](results)
    if table is None:
        return Section("measured", "What was measured", tuple(blocks)) if blocks else None
    blocks += [*table, *_sensors(results), *_model(results), *_suspicious(results)]
    return Section("measured", "What was measured", tuple(blocks))


def _repeats(results: StudyResults) -> str:
    count = results.record.get("repeats")
    if not count:
        return "The number of repeats is not known."
    if count == 1:
        return "They were measured once; standard deviations are those stated in the files, if any."
    return f"They were measured {count} times; values are means, and standard deviations are those of the mean."


def _held_out(table: pd.DataFrame, name: str, thing: str) -> str:
    held = [str(row[name]) for row in table.to_dict("records") if flag(row["held_out"])]
    if not held:
        return f"No {thing} is held out."
    return f"Held out from every fit: {', '.join(held)}."


def _modes(results: StudyResults) -> list[Block] | None:
    numbers = ["natural_freq", "damped_freq", "freq_std", "damping_ratio", "damping_std", "repeats", "freq_std_used"]
    table = results.table("measured", ["mode"], numbers, flags=["held_out"], unique="mode")
    if table is None:
        return None
    rows = tuple(
        (
            str(r["mode"]),
            fixed(r["natural_freq"], 3),
            fixed(r["freq_std"], 3),
            percent(r["freq_std_used"] / r["natural_freq"]),
            fixed(r["damped_freq"], 3),
            percent(r["damping_ratio"]),
            percent(r["damping_std"]),
            fixed(r["repeats"], 0),
            yes(r["held_out"], USED),
        )
        for r in table.to_dict("records")
    )
    heads = (
        "mode",
        "natural frequency, Hz",
        "std, Hz",
        "std used, %",
        "damped frequency, Hz",
        "damping ratio, %",
        "std, % points",
        "repeats",
        "",
    )
    intro = f"{counted(len(table), 'mode')} were identified. {_repeats(results)} {_held_out(table, 'mode', 'mode')}"
    terms = (
        ("natural frequency", "|λ| / 2π of the eigenvalue λ, the undamped frequency under proportional damping"),
        ("damped frequency", "Im λ / 2π, the frequency of free decay"),
        ("damping ratio", "fraction of critical damping"),
        ("std", "standard deviation of the mean, of the value's own repeats"),
        (
            "std used",
            "the unit of the residuals below: pooled over the modes where repeats are few, with claimed accuracy",
        ),
        ("repeats", "number of repeats of the frequency"),
    )
    return [Words(intro), *_notes(results), Table("Measured modes", heads, rows, (8,)), Terms(terms)]


def _notes(results: StudyResults) -> list[Words]:
    return [Words(f"{note[:1].upper()}{note[1:]}.", "reported") for note in results.record.get("notes", [])]


def _responses(results: StudyResults) -> list[Block] | None:
    table = results.table("measured", ["response"], ["value", "std", "repeats"], flags=["held_out"], unique="response")
    if table is None:
        return None
    rows = tuple(
        (
            str(r["response"]),
            significant(r["value"], 6),
            significant(r["std"], 3),
            fixed(r["repeats"], 0),
            yes(r["held_out"], USED),
        )
        for r in table.to_dict("records")
    )
    intro = f"{counted(len(table), 'response')} were measured, each a single number. "
    intro += f"{_repeats(results)} {_held_out(table, 'response', 'response')}"
    terms = (("std", "standard deviation, the unit of the residuals below"),)
    heads = ("response", "value", "std", "repeats", "")
    return [Words(intro), *_notes(results), Table("Measured responses", heads, rows, (4,)), Terms(terms)]


def _frfs(results: StudyResults) -> list[Block] | None:
    numbers = ["lines", "freq_min", "freq_max", "repeats"]
    table = results.table("measured", ["response", "reference", "quantity"], numbers, flags=["held_out"])
    if table is None:
        return None
    names = table["response"] + "/" + table["reference"]
    rows = tuple(
        (
            name,
            fixed(r["lines"], 0),
            significant(r["freq_min"], 3),
            significant(r["freq_max"], 3),
            yes(r["held_out"], USED),
        )
        for name, r in zip(names, table.to_dict("records"), strict=True)
    )
    intro = f"{counted(len(table), 'frequency response function')} ({table['quantity'].iloc[0]}) were measured. "
    intro += f"{_repeats(results)} {_held_out(table.assign(function=names), 'function', 'function')}"
    heads = ("FRF", "lines", "from, Hz", "to, Hz", "")
    return [Words(intro), *_notes(results), Table("Every measured FRF", heads, rows, (4,))]


def _sensors(results: StudyResults) -> list[Block]:
    table = results.sensors
    if table is None:
        return [] if results.kind != "modes" else [Words("No mode shapes were measured, only frequencies and damping.")]
    rows = tuple(
        (
            str(r["sensor"]),
            str(r["direction"]),
            *(fixed(r[axis], 3) for axis in "xyz"),
            str(r["part"]) or "the nearest part",
            percent(r["shape_std"], 1),
            yes(r["held_out"], USED),
        )
        for r in table.to_dict("records")
    )
    heads = ("sensor", "direction", "x, m", "y, m", "z, m", "on", "std, % of the largest entry", "")
    what = "FRFs" if results.kind == "frf" else "Mode shapes"
    intro = f"{what} were measured by {counted(len(table), 'sensor')}, each one direction at one point."
    return [Words(f"{intro} {_held_out(table, 'sensor', 'sensor')}"), Table("Sensors", heads, rows, (1, 5, 7))]


def _model(results: StudyResults) -> list[Picture]:
    """The model with the sensors that are used on it, and its springs, masses and supports."""
    used = 0 if results.sensors is None else sum(not flag(held) for held in results.sensors["held_out"])
    what = f"The model and the {counted(used, 'sensor')} used on it." if used else "The model, its parts in colours."
    marks = "Springs, dampers, masses and supports of the model; numbers are those of the parameters in the key."
    return [
        *results.picture("model", f"{what} {results.axes}", what),
        *results.picture("model_places", f"{marks} Point at a mark for its name. {results.axes}", marks),
    ]


def _suspicious(results: StudyResults) -> list[Block]:
    out: list[Block] = []
    for name, what in (("repeat_disagreements", "repeat"), ("sensor_check", "sensor")):
        table = results.table(name, ["sentence"])
        out += [] if table is None else [Words(f"Check this {what}: {s}", "warning") for s in table["sentence"]]
    return out
