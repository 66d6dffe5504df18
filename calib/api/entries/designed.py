"""What a table of designs has to say."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from calib.analyses.designs import Designs
from calib.api.entries.entry import Entry, Rows, Words, decimals, off
from calib.problem.parameter import unit_words

_HEADS = ("rank", "design", "case", "generation", "objective", "mean error", "mean MAC")


def designs_entries(found: Designs, best: int, design: int | None = None) -> list[Entry]:
    """The best designs and the values of the best one of each case, or one design with all its values.

    Parameters
    ----------
    found : Designs
    best : int
        Rows of the ranked table.
    design : int, optional
        Number of the only design that is told.
    """
    if design is not None:
        return _one(found, design)
    rows = [_row(row) for row in found.table.head(best).to_dict("records")]
    return [Rows.of("The best designs:", _HEADS, rows, most=best), *_of_cases(found)]


def _row(row: Mapping[Hashable, Any]) -> tuple[str, ...]:
    head = (str(row["rank"]), str(row["design"]), str(row["case"]))
    generation = "" if pd.isna(row["generation"]) else f"{row['generation']:.0f}"
    if row["status"] != "ok":
        return (*head, generation, "failed", "", "")
    mac = "" if pd.isna(row["mean_mac"]) else decimals(row["mean_mac"], 4)
    return (*head, generation, f"{row['objective']:.5g}", f"{100 * row['mean_error']:.2f} %", mac)


def _of_cases(found: Designs) -> list[Entry]:
    """Free parameters of the best design of each case, between their limits."""
    best = found.best_of_cases
    if best.empty:
        return []
    rows = [
        (p.name, *(f"{value:.5g}" for value in best[p.name]), f"{p.lower:.5g}", f"{p.upper:.5g}", unit_words(p.unit))
        for p in found.space.free
    ]
    heads = ("parameter", *map(str, best["case"]), "lower", "upper", "unit")
    return [Rows.of("The best design of each:", heads, rows, left=("unit",), most=20)]


def _one(found: Designs, design: int) -> list[Entry]:
    """One design: its free parameters, its errors, and the line that begins a calibration there."""
    values = found.values(design)
    (row,) = found.table[found.table["design"] == design].to_dict("records")
    parameters = [(p.name, f"{values[p.name]:.6g}{unit_words(p.unit)}") for p in found.space.free]
    errors = [
        (str(name).removeprefix("error "), off(value))
        for name, value in row.items()
        if str(name).startswith("error ") and not pd.isna(value)
    ]
    return [
        Rows.of("", _HEADS, [_row(row)]),
        Rows.of("Values:", ("parameter", "value"), parameters, most=len(parameters)),
        Rows.of("Errors, model - measured:", ("response", "error"), errors),
        Words(
            f'\nTo begin least squares there, in study.toml below [calibration]: begin_at = "design {design}"', "always"
        ),
    ]
