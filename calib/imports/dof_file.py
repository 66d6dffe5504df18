"""The names of matrix rows from files: a table of node and direction, CalculiX .dof, ANSYS mapping."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from calib.errors.errors import InputError
from calib.imports.coordinates import DECKS
from calib.imports.elements import held_motions, only_solids
from calib.imports.harwell_boeing import is_mapping, read_mapping
from calib.imports.keywords import deck_text

_SEPARATOR = r"[;,\t ]+"
COLUMNS = ("node", "direction")


def read_dofs(file: Path) -> pd.DataFrame:
    """Node and direction of each row of the matrices, in their order.

    Parameters
    ----------
    file : Path
        A table with a header ``node, direction[, x, y, z]``; two columns of numbers; one column such as ``12.3`` (.dof
        of CalculiX) or ``12.03``; or a mapping file of ANSYS.

    Returns
    -------
    DataFrame
        ``node, direction[, x, y, z]``; node is missing in rows of no node.

    Raises
    ------
    InputError
        For a file that is none of these.
    """
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    lines = [line.strip() for line in file.read_text("latin-1").replace("\ufeff", "").replace("ï»¿", "").splitlines()]
    if is_mapping(lines):
        return table_of_dofs(read_mapping(file, lines))
    kept = [line for line in lines if line and line[0] not in "#*%"]
    if not kept:
        raise InputError("it names no rows", place=file, remedy="give a table node, direction")
    if re.search(r"[A-Za-z]{2}", kept[0]):
        return _headed(file, kept)
    cells = [re.split(_SEPARATOR, line) for line in kept]
    width = {len(row) for row in cells}
    if width == {1}:
        return _packed(file, [row[0] for row in cells])
    if width != {2}:
        raise InputError("its lines have no header and not two columns", place=file,
                         remedy="give a table with the header node,direction")  # fmt: skip
    return pd.DataFrame(cells, columns=list(COLUMNS))


def _headed(file: Path, lines: list[str]) -> pd.DataFrame:
    separator = next((one for one in ",;\t" if one in lines[0]), None)
    rows = [
        [cell.strip().strip('"') for cell in (line.split(separator) if separator else line.split())] for line in lines
    ]
    head = [cell.lower() for cell in rows[0]]
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise InputError(f"the column {missing[0]!r} is missing among {', '.join(head)}", place=file,
                         remedy="give a table node, direction[, x, y, z]")  # fmt: skip
    wrong = next((k for k, row in enumerate(rows) if len(row) != len(head)), None)
    if wrong is not None:
        raise InputError(f"row {wrong} has {len(rows[wrong])} entries for {len(head)} columns", place=file,
                         remedy="give each row all columns")  # fmt: skip
    table = pd.DataFrame(rows[1:], columns=head)
    table = table[[name for name in (*COLUMNS, "x", "y", "z") if name in head]].replace("", np.nan)
    for name in "xyz":
        if name in table:
            table[name] = pd.to_numeric(table[name], errors="coerce")
    return table


def _packed(file: Path, cells: list[str]) -> pd.DataFrame:
    """Node and direction of ``12.3`` by its characters: as a number, 1234567890.3 would lose its direction."""
    found = [re.fullmatch(r"(\d+)\.0?(\d)", cell) for cell in cells]
    k = next((k for k, one in enumerate(found) if one is None), None)
    if k is not None:
        raise InputError(f"row {k + 1} is {cells[k][:40]!r}", place=file, remedy="write node.direction, such as 12.3")
    return pd.DataFrame([(int(one[1]), int(one[2])) for one in found if one is not None], columns=list(COLUMNS))


def table_of_dofs(labels: np.ndarray) -> pd.DataFrame:
    """Rows named by node and direction, (n, 2) int, as a table; what is no motion of a node has none."""
    node, direction = labels.T
    named = (node > 0) & (direction >= 1) & (direction <= 6)
    out = pd.DataFrame({name: pd.array(column, dtype="Int64") for name, column in zip(COLUMNS, labels.T, strict=True)})
    out.loc[~named] = pd.NA
    return out


def require_layers(table: pd.DataFrame, file: Path) -> None:
    """InputError for rows of one name where the deck has neither shells nor beams, which alone have layers."""
    again = table[table["node"].notna() & table.duplicated(["node", "direction"])]
    if len(again) and only_solids(deck_text(file)):
        words = f"direction {again['direction'].iloc[0]} of node {again['node'].iloc[0]} is named twice"
        remedy = f"write the .dof again: {file.name} has no shells or beams, whose layers bear one name"
        raise InputError(words, place=f"row {again.index[0] + 1} of the matrices", remedy=remedy)


def without_held(table: pd.DataFrame, file: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """The table without the names of rows that move a supported node: the stretch of a shell's thickness there."""
    held = held_motions(deck_text(file)) if file.suffix.lower() in DECKS else set()
    if not held:
        return table, ()
    rows = np.array([pair in held for pair in zip(table["node"], table["direction"], strict=True)])
    if not rows.any():
        return table, ()
    out = table.copy()
    out.loc[rows, ["node", "direction"]] = pd.NA
    words = (
        f"At supported nodes {int(rows.sum())} rows remain, in which a shell's thickness stretches: no sensor reads "
    )
    return out, (words + "them.",)
