"""Tables of FRFs in a results folder, and which kind of measurement a table is of."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import pandas as pd

from calib.report.shown import Folder
from calib.report.tables import read_table

Kind = Literal["modes", "responses", "frf"]

_TEXT = {"frf": ["response", "reference"], "comparison": ["response", "reference", "unit"], "frf_lines": []}
_NUMBERS = {
    "frf": ["freq", "measured_re", "measured_im", "model_re", "model_im", "std"],
    "comparison": ["lines", "frac", "amplitude", "error", "in_std"],
    "frf_lines": ["freq", "assurance", "amplitude", "in_std"],
}
"""Columns of each table of FRFs by its name without the stage."""


def kind_of(path: Path) -> Kind:
    """Kind of the data in a table of a measurement or a comparison."""
    try:
        with path.open(encoding="utf-8") as stream:
            heads = stream.readline()
    except (OSError, UnicodeDecodeError):
        return "modes"  # the reader of the whole table reports the fault
    if heads.startswith("response,reference,"):
        return "frf"
    return "responses" if heads.startswith("response,") else "modes"


def read_stages(folder: Folder, name: str, stages: Iterable[str]) -> dict[str, pd.DataFrame]:
    """The tables of FRFs of that name by stage: ``frf``, ``comparison`` or ``frf_lines``; empty for other kinds."""
    found = {}
    for stage in stages:
        path = folder / f"{name}_{stage}.csv"
        if path.exists() and (name != "comparison" or kind_of(path) == "frf"):
            found[stage] = read_table(path, _TEXT[name], _NUMBERS[name])
    return found
