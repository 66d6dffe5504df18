"""Coordinates of nodes from a table or from the deck of a code: *NODE of Abaqus and CalculiX, GRID of Nastran."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import read_sensor_table
from calib.measurement.places import Point

DECKS = (".inp", ".bdf", ".dat", ".nas", ".blk")
"""Suffixes of decks."""


def read_coordinates(file: Path, metres: float = 1.0) -> dict[int, Point]:
    """Places of nodes in m, by their number.

    Parameters
    ----------
    file : Path
        Table ``node, x, y, z`` in m (.csv); or a deck with ``*NODE`` (.inp) or ``GRID`` (.bdf, .dat, .nas).
    metres : float
        Per unit of length of a deck, which does not state it.

    Raises
    ------
    InputError
        For another kind of file, one without nodes, and a node in a local system, whose place is not known from it
        alone.
    """
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    suffix = file.suffix.lower()
    if suffix == ".csv":
        return {node: place for node, (place, _) in read_sensor_table(file).items()}
    if suffix not in DECKS:
        raise InputError(f"unknown kind of file {suffix!r}", place=file, remedy=f"give .csv, {', '.join(DECKS)}")
    lines = file.read_text("latin-1").splitlines()
    is_abaqus = any(line.upper().lstrip().startswith("*NODE") for line in lines)
    out: dict[int, Point] = {}
    try:
        for node, place in (_abaqus if is_abaqus else _nastran)(file, lines):
            x, y, z = (metres * own for own in place)
            out[node] = (x, y, z)
    except ValueError as fault:
        raise InputError(f"a node cannot be read ({fault})", place=file, remedy="give a table node, x, y, z") from None
    if not out:
        raise InputError("it defines no nodes (*NODE or GRID)", place=file, remedy="give the file that does")
    return out


def _abaqus(file: Path, lines: list[str]) -> Iterator[tuple[int, Point]]:
    """Nodes below ``*NODE``; those of other blocks, such as ``*NODE FILE``, are requests of output."""
    inside = False
    for line in lines:
        if line.startswith("**"):
            continue
        if line.lstrip().startswith("*"):
            key = line.upper().replace(" ", "")
            inside = key == "*NODE" or key.startswith("*NODE,")
            if inside and "SYSTEM=" in key and "SYSTEM=R" not in key:
                raise _local(file, "*NODE with SYSTEM")
            if key.startswith("*SYSTEM") and key != "*SYSTEM":
                raise _local(file, "*SYSTEM")
            continue
        if inside and line.strip():
            parts = [part.strip() for part in line.split(",")]
            x, y, z = ([float(part) if part else 0.0 for part in parts[1:4]] + [0.0] * 3)[:3]
            yield int(parts[0]), (x, y, z)


def _nastran(file: Path, lines: list[str]) -> Iterator[tuple[int, Point]]:
    """``GRID`` entries with short, long or free fields."""
    for k, line in enumerate(lines):
        if not re.match(r"GRID[\s*,]", line.upper()):
            continue
        if "," in line:
            fields = [part.strip() for part in line.split(",")]
        elif line[4:8].strip() == "*" or "*" in line[:8]:
            below = lines[k + 1] if k + 1 < len(lines) else ""
            fields = [line[:8], *(line[8 + 16 * j : 24 + 16 * j] for j in range(4)), below[8:24]]
        else:
            fields = [line[8 * j : 8 * j + 8] for j in range(6)]
        fields = [part.strip() for part in fields] + [""] * 6
        if fields[2] not in ("", "0"):
            raise _local(file, f"GRID {fields[1]}")
        x, y, z = (_real(part) for part in fields[3:6])
        yield int(fields[1]), (x, y, z)


def _real(text: str) -> float:
    """A number of Nastran, whose exponent may lack its letter: ``1.5-3``."""
    plain = re.sub(r"(?<=[\d.])([-+]\d+)$", r"E\1", text.upper().replace("D", "E")) if "E" not in text.upper() else text
    return float(plain) if plain else 0.0


def _local(file: Path, what: str) -> InputError:
    return InputError(
        f"{what} is in a local coordinate system", place=file,
        remedy="write the nodes in global axes, or give a table node, x, y, z",
    )  # fmt: skip
