"""Section on errors in fitted, left-out and held-out data."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.report.html.page import Block, Picture, Section, Table, Terms, Words
from calib.report.html.predictions import predictions
from calib.report.html.study_results import StudyResults
from calib.report.numbers import chance, fixed, flag, percent, significant
from calib.report.style import added
from calib.report.verification import GROUPS

TERMS = (
    ("rms", "root mean square of the errors, in standard deviations σ of the measurement"),
    (
        "expected",
        "rms of a correctly specified model on these data; larger where the left-out data alone determine a parameter",
    ),
)
CHANCE = ("p", "probability that a correctly specified model has at least this error")
"""Told here where the page has no explanation, whose key tells it."""


def errors(results: StudyResults) -> Section | None:
    """Errors before and after by group of data, and over the versions of an extended model."""
    sentence = [Words(str(results.added["sentence"]).replace(" -> ", " → "), "verdict")] if results.added else []
    if results.added_effects:
        title, blocks = "Prediction errors before and after adding the effects", _added(results)
    else:
        title, blocks = (
            "Prediction errors",
            [
                *_explained(results),
                *predictions(results),
                *_calibrated(results),
                *_modes(results),
                *_responses(results),
            ],
        )
    blocks += _versions(results)
    if not blocks:
        return None
    intro = Words(
        "An explanation or a calibration is assessed by its predictions: errors in fitted data, in data left out in "
        "turn, and in data held out from every fit."
    )
    return Section(
        "errors", title, (intro, *sentence, Terms(TERMS if results.explanation else (*TERMS, CHANCE)), *blocks)
    )


def _added(results: StudyResults) -> list[Block]:
    """Errors of the model with the added effects beside those of the model without."""
    table = results.table("added_errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is None:
        return []
    what = f"before and after adding {results.added_effects}, both models calibrated"
    return [*_error_picture(results, "added_errors", table, what), _both_table(table, f"Errors {what}")]


def _explained(results: StudyResults) -> list[Block]:
    table = results.table("errors", ["group", "stage"], ["rows", "rms", "expected", "p"])
    if table is None:
        return []
    name = " + ".join(results.explanation.get("chosen", []))
    what = f"before and after adding {name}" if name else "of the base model"
    return [*_error_picture(results, "errors_before_after", table, what), _error_table(table, f"Errors {what}", name)]


def _error_picture(results: StudyResults, figure: str, table: pd.DataFrame, what: str) -> list[Picture]:
    """Errors by stage and group of data."""
    note = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in _groups(table))
    caption = f"Error {what}, in standard deviations; black lines: expected for a correctly specified model."
    return results.picture(figure, caption, f"Bars. {note}.")


def _arrow(table: pd.DataFrame, group: str) -> str:
    return " → ".join(fixed(v, 2) for v in table[table["group"] == group]["rms"])


def _error_table(table: pd.DataFrame, caption: str, name: str = "") -> Table:
    """Errors by group of data and model; ``name`` are the effects in the other model."""
    rows = tuple(
        (
            GROUPS.get(str(r["group"]), str(r["group"])),
            added("base" if r.get("stage", "before") == "before" else str(r["stage"]), name),
            fixed(r["rows"], 0),
            fixed(r["rms"], 2),
            fixed(r["expected"], 2),
            chance(r["p"]),
        )
        for r in table.to_dict("records")
    )
    return Table(caption, ("data", "model", "residuals", "rms, σ", "expected, σ", "p"), rows, (1,))


def _both_table(table: pd.DataFrame, caption: str) -> Table:
    """One row per group of data, both stages side by side."""
    groups = _groups(table)
    # A group that one stage lacks, such as modes that are unpaired there, has a dash.
    before, after = (table[table["stage"] == s].set_index("group").reindex(groups) for s in ("before", "after"))
    rows = tuple(
        (
            GROUPS.get(group, group),
            fixed(after["rows"][group], 0),
            *(fixed(stage[number][group], 2) for number in ("rms", "expected") for stage in (before, after)),
            *(chance(stage["p"][group]) for stage in (before, after)),
        )
        for group in groups
    )
    columns = ("rms before, σ", "after, σ", "expected before, σ", "after, σ", "p before", "after")
    return Table(caption, ("data", "residuals", *columns), rows)


def _calibrated(results: StudyResults) -> list[Block]:
    table = results.table("data_errors", ["group"], ["rows", "rms", "expected", "p"])
    return [] if table is None else [_error_table(table, "Errors of the calibrated model, no effect added")]


def _modes(results: StudyResults) -> list[Block]:
    words = [results.in_words(stage) for stage in ("before", "after")]
    caption = f"Damped frequencies and MAC of every measured mode, {' and '.join(words)}"
    table = every_mode_table(results, "modes", {"initial": "initial", "before": "before", "after": "after"}, caption)
    note = "Initial: the model before the calibration of the earlier study."
    return [Words(note), *table] if table and "initial, Hz" in table[0].heads else [*table]


def _responses(results: StudyResults) -> list[Table]:
    stages = ("before", "after")
    numbers = ["measured", *stages, *(f"error_{stage}" for stage in stages)]
    table = results.table("responses", ["response"], numbers, flags=["held_out"], unique="response")
    if table is None:
        return []
    rows = tuple(
        (
            str(r["response"]),
            "held out" if flag(r["held_out"]) else "used",
            *(significant(r[n], 5) for n in numbers[:3]),
            *(percent(r[n], sign=True) for n in numbers[3:]),
        )
        for r in table.to_dict("records")
    )
    heads = ("response", "", "measured", *stages, *(f"error {stage}, %" for stage in stages))
    return [Table("Every measured response, before and after calibration", heads, rows, (1,))]


def every_mode_table(results: StudyResults, name: str, labels: Mapping[str, str], caption: str) -> list[Table]:
    """Damped frequency and MAC of every measured mode at each stage; ``labels`` names the stages."""
    kinds = ("damped_freq", "error", "mac")
    numbers = [f"{kind}_{stage}" for kind in kinds for stage in ("before", "after")]
    table = results.table(
        name, ["mode"], ["damped_freq_measured", *numbers], flags=["held_out"],
        if_there=[f"{kind}_initial" for kind in kinds],
    )  # fmt: skip
    if table is None:
        return []
    stages = [stage for stage in labels if f"error_{stage}" in table]
    rows = tuple(
        (
            str(r["mode"]),
            "held out" if flag(r["held_out"]) else "fitted",
            *(fixed(r[f"damped_freq_{stage}"], 3) for stage in ("measured", *stages)),
            *(percent(r[f"error_{stage}"], 2, sign=True) for stage in stages),
            *(fixed(r[f"mac_{stage}"], 3) for stage in stages),
        )
        for r in table.to_dict("records")
    )
    heads = ["mode", "", "damped frequency measured, Hz", *(f"{labels[stage]}, Hz" for stage in stages)]
    heads += [*(f"error {labels[stage]}, %" for stage in stages), *(f"MAC {labels[stage]}" for stage in stages)]
    return [Table(caption, tuple(heads), rows, (1,))]


def _versions(results: StudyResults) -> list[Block]:
    table = results.table(
        "versions", ["group"], ["version", "rms", "expected"], complete=["version"], blank=["study", "effects"]
    )
    if table is None:
        return []
    note = "; ".join(f"{GROUPS.get(g, g)} {_arrow(table, g)}" for g in _groups(table))
    rows = tuple(
        (f"{r['version']:g}", str(r["effects"]) or "base model", GROUPS.get(str(r["group"]), str(r["group"])),
         fixed(r["rms"], 2), fixed(r["expected"], 2))
        for r in table.to_dict("records")
    )  # fmt: skip
    caption = "Errors over the versions of the model; dashed: expected for a correctly specified model."
    heads = ("version", "added", "data", "rms, σ", "expected, σ")
    return [
        *results.picture("errors_over_versions", caption, f"Lines. {note}."),
        Table("Errors over the versions of the model", heads, rows, (1, 2)),
    ]


def _groups(table: pd.DataFrame) -> list[str]:
    known = set(table["group"][table["rms"].notna()])
    return [*(g for g in GROUPS if g in known), *sorted(known - set(GROUPS))]
