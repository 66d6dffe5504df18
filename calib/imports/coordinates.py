"""Coordinates of nodes from a table or a deck: *NODE of Abaqus and CalculiX, GRID of Nastran, NBLOCK of ANSYS."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import read_sensor_table
from calib.measurement.places import Point

DECKS = (".inp", ".bdf", ".dat", ".nas", ".blk", ".pch", ".cdb")
"""Suffixes of decks."""


def read_coordinates(file: Path, metres: float = 1.0) -> dict[int, Point]:
    """Places of nodes in m, by their number.

    Parameters
    ----------
    file : Path
        Table ``node, x, y, z`` in m (.csv); or a deck with ``*NODE`` (.inp), ``GRID`` (.bdf, .dat, .nas, .pch) or
        ``NBLOCK`` (.cdb).
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
    is_ansys = any(line.upper().startswith("NBLOCK") for line in lines)
    out: dict[int, Point] = {}
    try:
        for node, place in (_abaqus if is_abaqus else _ansys if is_ansys else _nastran)(file, lines):
            x, y, z = (metres * own for own in place)
            out[node] = (x, y, z)
    except ValueError as fault:
        raise InputError(f"a node cannot be read ({fault})", place=file, remedy="give a table node, x, y, z") from None
    if not out:
        raise InputError("it defines no nodes (*NODE, GRID or NBLOCK)", place=file, remedy="give the file that does")
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


def _ansys(file: Path, lines: list[str]) -> Iterator[tuple[int, Point]]:
    """Nodes of NBLOCK in the columns that its format states; coordinates of 0 at the end of a line may be missing.

    Three more numbers are angles of the axes in which a node moves, and do not change its place.
    """
    widths: tuple[int, int, int] | None = None
    for line in lines:
        if line.upper().startswith("NBLOCK"):
            widths = (0, 0, 0)
        elif widths == (0, 0, 0):
            found = re.search(r"(\d*)I(\d+),\s*\d*E(\d+)", line.upper())
            if found is None:
                raise ValueError(f"the format of NBLOCK is {line.strip()[:30]!r}")
            widths = int(found[1] or 1), int(found[2]), int(found[3])
        elif widths is not None and re.match(r"\s*\d", line):
            first = widths[0] * widths[1]
            cells = [line[first + k * widths[2] : first + (k + 1) * widths[2]].strip() for k in range(3)]
            x, y, z = (float(one) if one else 0.0 for one in cells)
            yield int(line[: widths[1]]), (x, y, z)
        else:
            widths = None


def _nastran(file: Path, lines: list[str]) -> Iterator[tuple[int, Point]]:
    """Nodes of ``GRID`` entries."""
    for name, fields in bulk_entries("\n".join(lines)):
        if name != "GRID":
            continue
        fields += [""] * 5
        if fields[1] not in ("", "0"):
            raise _local(file, f"GRID {fields[0]}")
        x, y, z = (real(part) for part in fields[2:5])
        yield int(fields[0]), (x, y, z)


def bulk_entries(text: str) -> Iterator[tuple[str, list[str]]]:
    """Name and fields of each entry of Nastran's bulk data with its continuations: narrow, wide or between commas.

    Fields are those from the second on, all that the lines have room for.
    """
    entry: list[str] = []
    name = ""
    for line in text.splitlines():
        bare = line.split("$", 1)[0].rstrip()
        if not bare:
            continue
        if not re.match(r"[A-Za-z]", bare):
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


def _local(file: Path, what: str) -> InputError:
    return InputError(
        f"{what} is in a local coordinate system", place=file,
        remedy="write the nodes in global axes, or give a table node, x, y, z",
    )  # fmt: skip
