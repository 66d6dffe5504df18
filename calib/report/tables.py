"""Read and check the tables of a results folder; duplicate rows are refused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import pandas as pd

from calib.errors.errors import InputError
from calib.results import table

KEYS = {
    "added_errors": ("group", "stage"),
    "added_modes": ("mode",),
    "added_parameters": ("parameter",),
    "comac": ("sensor",),
    "confounding": ("effect",),
    "confounded": ("parameter_a", "parameter_b"),
    "considered": ("parameter", "std"),
    "convergence": ("case", "generation"),
    "cross_orthogonality": ("mode",),
    "data_errors": ("group",),
    "deflection": ("mode", "point"),
    "effects": ("name",),
    "expanded_shapes": ("mode", "point"),
    "expansion": ("mode",),
    "frf": ("response", "reference", "freq"),
    "frf_lines": ("freq",),
    "frf_misfit": ("stage", "function", "freq"),
    "errors": ("group", "stage"),
    "variance_share": ("parameter",),
    "input_correlation": ("parameter",),
    "mac": ("mode",),
    "mesh_points": ("point",),
    "misfit_kinds": ("stage", "mode", "kind"),
    "model_modes": ("mode",),
    "modes": ("mode",),
    "parameter_space": ("parameter",),
    "parameters": ("case", "parameter"),
    "partial": ("parameter",),
    "posterior_correlation": ("parameter",),
    "predictions": ("mode",),
    "prognosis": ("response",),
    "prognosis_inputs": ("response", "parameter"),
    "proposals": ("rank",),
    "proposal_places": ("rank", "kind", "at", "x", "y", "z"),
    "response_misfit": ("stage", "response"),
    "selection": ("parameter",),
    "self_orthogonality": ("mode",),
    "sensitivity": ("parameter",),
    "sensor_misfit": ("stage", "mode", "sensor"),
    "sensors": ("sensor",),
    "shapes": ("mode", "sensor"),
    "pulls": ("model", "parameter"),
    "reduction_by_test": ("effects", "test"),
    "steps": ("step",),
    "steps_errors": ("step", "group"),
    "between_tests": ("parameter", "what"),
    "std_by_test": ("parameter", "test"),
    "test_differences": ("parameter", "test"),
    "unexplained": ("parameter",),
    "unexplained_calibrated": ("parameter",),
    "unexplained_errors": ("group",),
    "verdicts": ("parameter",),
    "versions": ("version", "group"),
    "where_it_fails": ("kind", "what"),
    "why": ("effect", "kind", "mode", "sensor", "part"),
    "why_parameters": ("effects", "effect", "parameter"),
    "why_places": ("effect", "perturbation"),
}
"""Columns that identify a row, by the name of the table without its stage."""
TEST = "test"
"""Column of tables of several tests: the name of the test."""
_SUFFIXES = ("_initial", "_before", "_after", "_added")


def without_stage(name: str) -> str:
    """Name of a table without the stage of the model that it is of."""
    for stage in _SUFFIXES:
        name = name.removesuffix(stage)
    return name


def unique_columns(name: str) -> tuple[str, ...]:
    """Columns that identify a row of a table; empty where rows may be equal."""
    return KEYS.get(without_stage(name), ())


def has_column(path: Path, column: str) -> bool:
    """Whether the first line of a table names a column; a damaged table has none, and its reader tells the fault."""
    try:
        with path.open(encoding="utf-8") as stream:
            return column in stream.readline().rstrip("\r\n").split(",")
    except (OSError, UnicodeDecodeError):
        return False


def read_results(path: Path, text: Sequence[str], numbers: Sequence[str] = (), **more: Any) -> pd.DataFrame:
    """Read a table as `calib.results.table.read_table` does, with rows unique by their `KEYS`, in each test."""
    key = unique_columns(path.stem)
    more.setdefault("unique", (TEST, *key) if key and TEST not in key and has_column(path, TEST) else key)
    return table.read_table(path, text, numbers, **more)


def read_square(path: Path, key: str = "parameter", may_be_empty: bool = False) -> pd.DataFrame:
    """Read a table whose rows and columns name the same things; InputError where they do not."""
    table = read_results(path, [key], others_are_numbers=True, unique=key, may_be_empty=may_be_empty)
    if len(table) and table[key].tolist() != [c for c in table.columns if c != key]:
        raise InputError(
            f"rows and columns do not name the same {key}s",
            place=path,
            remedy="run the study again to write it anew",
        )
    return table


Kind = Literal["modes", "responses", "frf"]

_TEXT = {"frf": ["response", "reference"], "comparison": ["response", "reference", "unit"], "frf_lines": []}
_NUMBERS = {
    "frf": ["freq", "measured_re", "measured_im", "model_re", "model_im", "std"],
    "comparison": ["lines", "frac", "amplitude", "error", "in_std"],
    "frf_lines": ["freq", "assurance", "amplitude", "in_std"],
}
"""Columns of each table of FRFs by its name without the stage."""


def comparison_kind(path: Path) -> Kind:
    """Kind of the data in a table of a measurement or a comparison."""
    if not has_column(path, "response"):
        return "modes"
    return "frf" if has_column(path, "reference") else "responses"


def read_stages(folder: Folder, name: str, stages: Iterable[str]) -> dict[str, pd.DataFrame]:
    """The tables of FRFs of that name by stage: ``frf``, ``comparison`` or ``frf_lines``; empty for other kinds."""
    found = {}
    for stage in stages:
        path = folder / f"{name}_{stage}.csv"
        if path.exists() and (name != "comparison" or comparison_kind(path) == "frf"):
            found[stage] = read_results(path, _TEXT[name], _NUMBERS[name])
    return found


@dataclass(frozen=True)
class CurrentFolder:
    """A folder in which some files count as missing, since they belong to another state of the study.

    Attributes
    ----------
    folder : Path
    hidden : frozenset of str
        Names of the hidden files.
    """

    folder: Path
    hidden: frozenset[str]

    def __truediv__(self, name: str) -> Path:
        """Return the path of a file; for a hidden one a path that does not exist."""
        return self.folder / ".hidden" / name if name in self.hidden else self.folder / name


Folder: TypeAlias = Path | CurrentFolder
