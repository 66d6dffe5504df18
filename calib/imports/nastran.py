"""Matrices of Nastran: DMIG entries of a punch file or a deck, whose rows are named by node and direction."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.imports.bulk import fields_of, real
from calib.imports.stored import Stored, named

_SYMMETRIC, _SQUARE = 6, 1
_COMPLEX = (3, 4)


@dataclass
class _Matrix:
    """Entries of one matrix, as they are read."""

    form: int
    is_complex: bool
    rows: list[tuple[int, int]] = field(default_factory=list)
    columns: list[tuple[int, int]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)


def is_dmig(text: str) -> bool:
    """Whether a text holds DMIG entries."""
    return re.search(r"^DMIG[ *,]", text, re.MULTILINE | re.IGNORECASE) is not None


def read_dmig(file: Path, text: str) -> tuple[list[Stored], tuple[str, ...]]:
    """Matrices of DMIG entries, in fields of 8 or 16 columns or between commas.

    Of a symmetric matrix (form 6) one triangle is written, whichever; both are taken where they agree. Rows are those
    that have an entry. Scalar points have direction 0.

    Parameters
    ----------
    file : Path
        For messages.
    text : str
        Punch file (``PARAM,EXTOUT,DMIGPCH``) or deck.

    Returns
    -------
    matrices : list of Stored
    notes : tuple of str
        Matrices that are not square, which are no stiffness, mass or damping.

    Raises
    ------
    InputError
        With the line, for an entry that cannot be read or has no header, and for complex entries.
    """
    lines = text.splitlines()
    found: dict[str, _Matrix] = {}
    for number, fields in _entries(lines):
        place = Place.in_lines(str(file), lines, number)
        try:
            name = fields[0].upper()
            if fields[1] == "0":
                found[name] = _Matrix(int(fields[2]), int(fields[3]) in _COMPLEX)
                continue
            own = found[name]
            column = int(fields[1]), int(fields[2] or 0)
            for k in range(4, len(fields), 4):
                node, direction, value, imaginary = (fields[k : k + 4] + [""] * 4)[:4]
                if not node:
                    continue
                if own.is_complex and imaginary and real(imaginary) != 0:
                    raise InputError(
                        f"{name} is complex", place=place, remedy="write stiffness, damping and mass as real matrices"
                    )
                own.rows.append((int(node), int(direction or 0)))
                own.columns.append(column)
                own.values.append(real(value))
        except InputError:
            raise
        except KeyError:
            raise InputError(f"{fields[0]} has no header", place=place, remedy="the file is cut off: punch it again"
                             ) from None  # fmt: skip
        except (ValueError, IndexError):
            raise InputError("this DMIG entry cannot be read", place=place, remedy="punch the matrix again") from None
    square = {name: own for name, own in found.items() if own.form in (_SYMMETRIC, _SQUARE) and own.values}
    notes = tuple(
        f"DMIG {name} of form {own.form} with {len(own.values)} entries was left out." for name, own in found.items()
        if name not in square
    )  # fmt: skip
    return [
        named(name, np.array(own.rows), np.array(own.columns), np.array(own.values), f"{file}, DMIG {name}")
        for name, own in square.items()
    ], notes


def _entries(lines: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each DMIG entry with its continuations, from the second field on."""
    entry: list[str] = []
    start = 0
    for number, line in enumerate(lines, start=1):
        bare = line.split("$", 1)[0].rstrip("\n")
        if not bare.strip():
            continue
        if re.match(r"DMIG[ *,]", bare.upper()):
            if entry:
                yield start, entry
            entry, start = fields_of(bare), number
        elif entry and (bare[0] in "+*, "):
            entry = [*entry, *fields_of(bare)]
        elif entry:
            yield start, entry
            entry = []
    if entry:
        yield start, entry
