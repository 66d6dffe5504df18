"""What the page tells of errors in fitted, left-out and held-out data: groups, stages, counts within intervals."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.report.html.cells import TextCells, group_words
from calib.report.html.study_results import StudyResults
from calib.report.numbers import UNKNOWN, fixed, flag, p_in_words, percent
from calib.report.style import added
from calib.report.verification import GROUPS


def groups(table: pd.DataFrame) -> pd.Series:
    """Groups of data with an error, in the order of the page."""
    known = set(table["group"][table["rms"].notna()])
    return pd.Series([*(group for group in GROUPS if group in known), *sorted(known - set(GROUPS))], dtype=object)


def errors_in_words(table: pd.DataFrame) -> str:
    """The errors of every group of data, from stage to stage."""
    by_group = {group: table[table["group"] == group]["rms"] for group in groups(table)}
    return "; ".join(f"{group_words(g)} {' → '.join(fixed(value, 2) for value in rms)}" for g, rms in by_group.items())


def at_stage(table: pd.DataFrame, stage: str) -> pd.DataFrame:
    """Errors at one stage, a row for each of `groups`; one that the stage lacks, as unpaired modes do, is not known."""
    return table[table["stage"] == stage].set_index("group").reindex(groups(table))


def models(table: pd.DataFrame, effects: str) -> list[str]:
    """The model of every row in words; ``effects`` are those in the other model."""
    stages = table["stage"] if "stage" in table else ["before"] * len(table)
    return [added("base" if stage == "before" else str(stage), effects) for stage in stages]


def columns_of_errors(table: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """Columns of errors by group of data, one of each number for every stage of the model."""
    stages = list(dict.fromkeys(table["stage"])) if "stage" in table else [""]
    each = [at_stage(table, stage) if stage else table.set_index("group").reindex(groups(table)) for stage in stages]
    marks = [""] if len(stages) == 1 else [f" {stage}" for stage in stages]
    return [
        ("data", TextCells(group_words(group) for group in groups(table))),
        ("residuals", [fixed(rows, 0) for rows in each[-1]["rows"]]),
        *((f"rms{mark}, σ", [fixed(v, 2) for v in e["rms"]]) for mark, e in zip(marks, each, strict=True)),
        ("expected, σ", [fixed(value, 2) for value in each[-1]["expected"]]),
        *((f"p{mark}", [p_in_words(v) for v in e["p"]]) for mark, e in zip(marks, each, strict=True)),
    ]


def errors_by_test(results: StudyResults) -> list[tuple[str, list[str]]]:
    """Columns of the errors of each of several tests: with added effects, of an explanation, or of the calibration."""
    kinds = ("added_errors", "errors", "data_errors")
    name = next((name for name in kinds if any(test.table(name) is not None for test in results.tests)), None)
    found = {test.test: table for test in results.tests if name and (table := test.table(name)) is not None}
    if not found:
        return []
    each = {test: columns_of_errors(table) for test, table in found.items()}
    heads = list(dict.fromkeys(head for columns in each.values() for head, _ in columns))
    out: dict[str, list[str]] = {"test": TextCells(), **{head: TextCells() if head == "data" else [] for head in heads}}
    for test, columns in each.items():
        cells = dict(columns)
        number = len(cells["data"])
        out["test"] += [test] * number
        for head in heads:
            out[head] += cells.get(head, [UNKNOWN] * number)
    return list(out.items())


def inside(errors: pd.DataFrame, predictions: pd.DataFrame, column: str) -> list[str]:
    """How many values of each group lie inside their interval."""
    own = [predictions[column][predictions["group"] == group] for group in errors["group"]]
    return [f"{sum(map(flag, values))} of {len(values)}" for values in own]


def columns_of_stages(table: pd.DataFrame, labels: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Columns of the frequencies, errors and MAC of all modes at each stage that ``labels`` names."""
    stages = {stage: words for stage, words in labels.items() if f"error_{stage}" in table}
    return [
        *((f"{w}, Hz", [fixed(value, 3) for value in table[f"freq_{s}"]]) for s, w in stages.items()),
        *((f"error {w}, %", [percent(value, sign=True) for value in table[f"error_{s}"]]) for s, w in stages.items()),
        *((f"MAC {w}", [fixed(value, 3) for value in table[f"mac_{s}"]]) for s, w in stages.items()),
    ]
