"""What the page tells of errors in fitted, left-out and held-out data: groups, stages, counts within intervals."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from calib.report.numbers import fixed, flag, percent
from calib.report.style import added
from calib.report.verification import GROUPS


def group_words(group: str) -> str:
    """A group of data in words."""
    return GROUPS.get(group, group)


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


def inside(errors: pd.DataFrame, predictions: pd.DataFrame, column: str) -> list[str]:
    """How many values of each group lie inside their interval."""
    own = [predictions[column][predictions["group"] == group] for group in errors["group"]]
    return [f"{sum(map(flag, values))} of {len(values)}" for values in own]


def columns_of_stages(table: pd.DataFrame, labels: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Columns of the damped frequencies, errors and MAC of all modes at each stage that ``labels`` names."""
    stages = {stage: words for stage, words in labels.items() if f"error_{stage}" in table}
    return [
        *((f"{w}, Hz", [fixed(value, 3) for value in table[f"damped_freq_{s}"]]) for s, w in stages.items()),
        *((f"error {w}, %", [percent(value, sign=True) for value in table[f"error_{s}"]]) for s, w in stages.items()),
        *((f"MAC {w}", [fixed(value, 3) for value in table[f"mac_{s}"]]) for s, w in stages.items()),
    ]
