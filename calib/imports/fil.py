"""Modes from the results file of Abaqus (.fil) in text form: items of stated width, in lines of 80 characters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.imports.frd import Found
from calib.measurement.places import Point

_ITEM = re.compile(r"I(?P<width>[ \d]\d)|D(?P<real>.{22})|A(?P<text>.{8})|(?P<start>\*)")
"""An integer with the number of its digits before it, a real number, a text, or the start of a record."""
_NODE, _DIRECTIONS, _MODE, _DISPLACEMENT = 1901, 1902, 1980, 101
"""Keys of records: place of a node, columns of the degrees of freedom, a mode, and the displacement of a node."""
_MOTIONS = 6


def read_fil(file: Path) -> Found:
    """Frequencies, displacements and places of nodes; see `calib.imports.fe_modes.read_fe_modes`.

    Source: Abaqus Analysis User's Guide, results file output format. Displacements are those of ``*NODE FILE`` with U,
    of each mode below its record 1980, in global axes unless ``GLOBAL=NO``.

    Raises
    ------
    InputError
        For a binary file, one that is cut off, and where there are no displacements of modes.
    """
    raw = file.read_bytes()
    if b"\0" in raw[:400] or not raw.lstrip().startswith(b"*"):
        raise InputError("it is binary, or no results file", place=file, remedy="write it as text: *FILE FORMAT, ASCII")
    text = "".join(line.ljust(80) for line in raw.decode("latin-1").splitlines())
    points: dict[int, Point] = {}
    columns = {d: d for d in range(_MOTIONS)}
    freq: list[float] = []
    found: list[dict[int, list[float]]] = []
    try:
        for key, items in _records(text):
            if key == _NODE:
                x, y, z = (*(float(one) for one in items[1:4]), 0.0, 0.0)[:3]
                points[int(items[0])] = (x, y, z)
            elif key == _DIRECTIONS:
                at = [int(one) for one in items[:_MOTIONS]]
                columns = {d: column - 1 for d, column in enumerate(at) if column > 0}
            elif key == _MODE:
                freq.append(float(np.sqrt(max(float(items[1]), 0.0))) / (2 * np.pi))
                found.append({})
            elif key == _DISPLACEMENT and found:
                found[-1][int(items[0])] = [float(one) for one in items[1:]]
    except (ValueError, IndexError) as fault:
        raise InputError(f"it cannot be read ({fault})", place=file, remedy="write it again; it may be cut off"
                         ) from None  # fmt: skip
    if not any(found):
        raise InputError("it holds no displacements of modes", place=file,
                         remedy="ask for *NODE FILE with U in a *FREQUENCY step")  # fmt: skip
    motions = {}
    for node in {node: None for one in found for node in one}:
        held = [one.get(node, []) for one in found]
        for d, column in columns.items():
            motions[node, d] = np.array([own[column] if column < len(own) else np.nan for own in held])
    return np.array(freq), motions, points, ()


def _records(text: str) -> Iterator[tuple[int, list[int | float | str]]]:
    """Key and items of each record, whose first item counts all of them."""
    items: list[int | float | str] = []
    at = 0
    while match := _ITEM.search(text, at):
        at = match.end()
        if match["start"]:
            if items:
                yield _record(items)
            items = []
        elif match["width"]:
            digits = int(match["width"])
            items.append(int(text[at : at + digits]))
            at += digits
        elif match["real"]:
            items.append(float(match["real"].replace("D", "E")))
        else:
            items.append(match["text"])
    if items:
        yield _record(items)


def _record(items: list[int | float | str]) -> tuple[int, list[int | float | str]]:
    if len(items) < 2 or len(items) != items[0]:
        raise ValueError(f"a record of {items[0]} items has {len(items)}")
    return int(items[1]), items[2:]
