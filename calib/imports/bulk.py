"""Entries of Nastran's bulk data: narrow, wide or between commas, with continuations; nodes among them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.errors.errors import InputError

_GLOBAL = ("", "0", "-1")
"""What stands in place of a system for the basic one."""


def bulk_entries(text: str) -> Iterator[tuple[str, list[str]]]:
    """Name and fields of each entry of Nastran's bulk data with its continuations: narrow, wide or between commas.

    Fields are those from the second on, all that the lines have room for.

    Raises
    ------
    ValueError
        For a line that repeats an entry (``=``), which Nastran writes out itself.
    """
    entry: list[str] = []
    name = ""
    for line in text.splitlines():
        bare = line.split("$", 1)[0].rstrip().expandtabs(8)
        if not bare:
            continue
        if not re.match(r"[A-Za-z]", bare):
            if name and bare[0] == "=" and re.match(r"=\s*(,|\(?\d|$)", bare):
                raise ValueError(f"the line {bare[:30]!r} repeats an entry: let the code write all (ECHO=PUNCH)")
            if name and bare[0] in "+*, ":
                entry += fields_of(bare)
            continue
        if name:
            yield name, entry
        name, entry = re.split(r"[\s,*]", bare.upper(), maxsplit=1)[0][:8], fields_of(bare)
    if name:
        yield name, entry


def fields_of(line: str) -> list[str]:
    """Fields of a line without the first one, all that the format has room for."""
    if "," in line:
        fields = [part.strip() for part in line.split(",")][1:9]
        return fields + [""] * (8 - len(fields))
    width, count = (16, 4) if "*" in line[:8] else (8, 8)
    return [line[8 + k * width : 8 + (k + 1) * width].strip() for k in range(count)]


def real(text: str) -> float:
    """A number of Nastran, whose exponent may lack its letter: ``1.5-3``."""
    plain = re.sub(r"(?<=[\d.])([-+]\d+)$", r"E\1", text.upper().replace("D", "E")) if "E" not in text.upper() else text
    return float(plain) if plain else 0.0


@dataclass(frozen=True, eq=False)
class Grid:
    """A node: the system in which it is placed, its coordinates there (3,), and the system in which it moves.

    Systems are ``0`` where they are the basic one.
    """

    placed: str
    entry: np.ndarray
    moves: str


def grids(text: str) -> dict[int, Grid]:
    """Nodes of GRID entries by their numbers; GRDSET fills the systems that an entry leaves empty.

    InputError for a node that is there twice with other fields.
    """
    found: dict[int, list[str]] = {}
    usual = [""] * 8
    for name, fields in bulk_entries(text):
        if name == "GRDSET":
            usual = [*fields, *[""] * 8]
        elif name == "GRID":
            own = [*fields, *[""] * 8]
            before = found.setdefault(int(fields[0]), own)
            if [_number(one) for one in before[1:6]] != [_number(one) for one in own[1:6]]:
                twice = (", ".join(one or "0" for one in entry[2:5]) for entry in (before, own))
                raise InputError(f"it is there twice, at {' and '.join(twice)}", place=f"GRID {int(fields[0])}",
                                 remedy="keep one of them")  # fmt: skip
    return {
        node: Grid(
            _system(fields[1] or usual[1]),
            np.array([real(part) for part in fields[2:5]]),
            _system(fields[5] or usual[5]),
        )
        for node, fields in found.items()
    }


def _number(field: str) -> float | str:
    try:
        return real(field)
    except ValueError:
        return field


def _system(text: str) -> str:
    return "0" if text in _GLOBAL else text
