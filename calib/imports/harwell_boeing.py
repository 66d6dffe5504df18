"""Matrices in Harwell-Boeing form, as ANSYS writes them (HBMAT), and the mapping of their rows to nodes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.imports.stored import Stored

_TYPE = re.compile(r"([RPC])([SUHZR])([AE])\s", re.IGNORECASE)
_FORM = re.compile(r"\(?.*?(\d*)([IEDFG])(\d+)(?:\.\d+)?(?:E\d+)?\)", re.IGNORECASE)
"""Numbers a line and columns of each, in formats such as ``(8I10)`` and ``(1P,4D20.13)``."""
_DIRECTIONS = {name: k for k, name in enumerate(("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"), start=1)}


def is_harwell_boeing(lines: list[str]) -> bool:
    """Whether the third line of a text states a type such as RSA."""
    return len(lines) > 3 and _TYPE.match(lines[2].ljust(14)) is not None and "(" in lines[3]


def read_harwell_boeing(file: Path, lines: list[str]) -> Stored:
    """An assembled real matrix, symmetric (RSA: one triangle) or not (RUA); right-hand sides are passed over.

    Source of the format: Duff, Grimes and Lewis, Users' guide for the Harwell-Boeing sparse matrix collection, 1992.

    Parameters
    ----------
    file : Path
        Its stem is the name of the matrix.
    lines : list of str

    Raises
    ------
    InputError
        For complex, unassembled and patterned matrices, and a file that is cut off or inconsistent.
    """
    kind = lines[2][:3].upper()
    if kind[0] != "R" or kind[2] != "A" or kind[1] not in "SU":
        raise InputError(f"its matrix is of type {kind}", place=f"{file}, line 3",
                         remedy="RSA and RUA are read: real, assembled, symmetric or not")  # fmt: skip
    try:
        pointer_lines, index_lines, value_lines = (int(lines[1][k : k + 14]) for k in (14, 28, 42))
        right_hand = int(lines[1][56:70] or 0)
        n_rows, n_columns, count = (int(lines[2][k : k + 14]) for k in (14, 28, 42))
        forms = [lines[3][:16], lines[3][16:32], lines[3][32:52]]
        at = 5 if right_hand else 4
        cut = []
        for n_lines, form in zip((pointer_lines, index_lines, value_lines), forms, strict=True):
            cut.append(_cells(lines[at : at + n_lines], form, at))
            at += n_lines
        pointers = np.array([int(cell) for cell in cut[0][: n_columns + 1]])
        rows = np.array([int(cell) for cell in cut[1][:count]])
        values = np.array([float(cell.upper().replace("D", "E")) for cell in cut[2][:count]])
    except (ValueError, IndexError) as fault:
        raise InputError(f"it cannot be read ({fault})", place=file, remedy="write it again in ASCII form") from None
    if n_rows != n_columns:
        raise InputError(f"it has {n_rows} rows and {n_columns} columns", place=file, remedy="write a square matrix")
    if len(pointers) <= n_columns or len(rows) < count or len(values) < count:
        raise InputError("it is cut off", place=file, remedy="write it again")
    lengths = np.diff(pointers)
    if pointers[0] != 1 or np.any(lengths < 0) or pointers[-1] != count + 1 or np.any((rows < 1) | (rows > n_rows)):
        raise InputError(
            f"its column pointers go from {pointers[0]} to {pointers[-1]}, for {count} entries of {n_rows} rows",
            place=file, remedy="they count from 1: write it again, by a later version of the code",
        )  # fmt: skip
    columns = np.repeat(np.arange(n_columns), lengths)
    return Stored(file.stem, sp.coo_array((values, (rows - 1, columns)), shape=(n_rows, n_rows)))


def _cells(lines: list[str], form: str, first: int) -> list[str]:
    """Numbers of fixed columns, which may touch."""
    found = _FORM.search(form.strip())
    if found is None:
        raise ValueError(f"the format {form.strip()!r} is unknown")
    count, width = int(found[1] or 1), int(found[3])
    out: list[str] = []
    for line in lines:
        own = line.rstrip("\n")
        out += [own[k * width : (k + 1) * width] for k in range(count) if own[k * width : (k + 1) * width].strip()]
    return out


def is_mapping(lines: list[str]) -> bool:
    """Whether a text lists equation, node and degree of freedom, as UX or ROTZ, below a head."""
    return any(_mapped(line) is not None for line in lines[:20])


def read_mapping(file: Path, lines: list[str]) -> np.ndarray:
    """Node and direction of each row of a mapping file, (n_rows, 2) int; direction 0 for TEMP, WARP and others.

    Raises
    ------
    InputError
        For an equation that is missing or named twice.
    """
    found: dict[int, tuple[int, int]] = {}
    for number, line in enumerate(lines, start=1):
        row = _mapped(line)
        if row is None:
            continue
        equation, node, name = row
        if equation in found:
            raise InputError(f"equation {equation} is named twice", place=f"{file}, line {number}",
                             remedy="write the mapping again")  # fmt: skip
        found[equation] = node, _DIRECTIONS.get(name, 0)
    missing = next((k for k in range(1, len(found) + 1) if k not in found), None)
    if missing is not None:
        raise InputError(f"equation {missing} is missing", place=file, remedy="it may be cut off: write it again")
    return np.array([found[k] for k in range(1, len(found) + 1)], dtype=int).reshape(-1, 2)


def _mapped(line: str) -> tuple[int, int, str] | None:
    match = re.match(r"\s*(\d+)\s+(\d+)\s+(?!(?:nan|inf|infinity)\s*$)([A-Za-z]\w*)\s*$", line, re.IGNORECASE)
    return None if match is None else (int(match[1]), int(match[2]), match[3].upper())
