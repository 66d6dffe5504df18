"""Tables of a results folder, read and checked for the figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from calib.errors import InputError


def read_table(
    path: Path,
    text: Sequence[str],
    numbers: Sequence[str] = (),
    *,
    complete: Sequence[str] = (),
    unbounded: Sequence[str] = (),
    flags: Sequence[str] = (),
    if_there: Sequence[str] = (),
    blank: Sequence[str] = (),
    others_are_numbers: bool = False,
    unique: str | None = None,
    may_be_empty: bool = False,
) -> pd.DataFrame:
    """Read a CSV table and check the columns that a figure needs; other columns are left out.

    Parameters
    ----------
    path : Path
    text, numbers, flags : sequence of str
        Columns of words, of numbers (empty or nan where unknown) and of ``True``/``False`` (empty where unknown).
    complete : sequence of str
        Those of `numbers` that must not be unknown.
    unbounded : sequence of str
        Those of `numbers` that may be infinite.
    if_there : sequence of str
        Further columns of numbers that a table may have.
    blank : sequence of str
        Columns of words that may be empty, or missing altogether.
    others_are_numbers : bool
        Whether every other column is kept and holds numbers.
    unique : str, optional
        Column in which no value may occur twice.
    may_be_empty : bool
        Whether a table without rows is right.

    Raises
    ------
    InputError
        Naming the file, the column and the line.
    """
    try:
        raw = pd.read_csv(path, dtype=str, keep_default_na=False, skipinitialspace=True)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as problem:
        raise InputError(f"the table cannot be read: {' '.join(str(problem).split())}", place=path) from problem
    wanted = [*text, *numbers, *flags]
    for column in wanted:
        if column not in raw.columns:
            raise InputError(f"column {column!r} is missing", place=path, remedy="run the study again to write it anew")
    if raw.empty and not may_be_empty:
        raise InputError("the table has no rows", place=path, remedy="run the study again to write it anew")
    wanted += [column for column in if_there if column in raw.columns]
    others = [c for c in raw.columns if c not in [*wanted, *blank]] if others_are_numbers else []
    if others_are_numbers and not others and not raw.empty:
        raise InputError(f"there is no column beside {', '.join(text)}", place=path)
    out: dict[str, pd.Series] = {}
    for column in blank:
        cells = raw[column] if column in raw else pd.Series("", index=raw.index)
        out[column] = cells.str.strip().replace("nan", "")
    for column in [*wanted, *others]:
        cells = raw[column].fillna("").str.strip()
        if column in text:
            _reject(cells == "", cells, column, path, "a name")
            out[column] = cells
        elif column in flags:
            known = cells.str.lower().map({"true": True, "false": False, "": None, "nan": None})
            _reject(known.isna() & ~cells.str.lower().isin(["", "nan"]), cells, column, path, "True or False")
            out[column] = known.astype(object)
        else:
            values = pd.to_numeric(cells, errors="coerce").astype(float)
            unknown = cells.str.lower().isin(["", "nan"])
            bad = (values.isna() & ~unknown) | (np.isinf(values) & (column not in unbounded))
            _reject(bad | (unknown & (column in complete)), cells, column, path, "a number")
            out[column] = values
    if unique is not None and raw[unique].duplicated().any():
        row = int(raw[unique].duplicated().to_numpy().argmax())
        raise InputError(f"column {unique!r} holds {raw[unique].iloc[row]!r} twice", place=f"{path}, line {row + 2}")
    return pd.DataFrame(out)


def _reject(bad: pd.Series, cells: pd.Series, column: str, path: Path, expected: str) -> None:
    if bad.any():
        row = int(bad.to_numpy().argmax())
        raise InputError(
            f"column {column!r} holds {cells.iloc[row]!r}, which is not {expected}", place=f"{path}, line {row + 2}"
        )
