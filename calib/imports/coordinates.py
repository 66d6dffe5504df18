"""Coordinates of nodes from a table, a mesh or a deck: *NODE (Abaqus, CalculiX), GRID (Nastran), NBLOCK (ANSYS)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.imports.keywords import deck_text, is_keyword, keyword_blocks, value_of
from calib.imports.meshes import MESHES, read_element_mesh
from calib.imports.systems import placed_nodes
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
        ``NBLOCK`` (.cdb), with the files that it includes; or a mesh (.unv, .msh).
    metres : float
        Per unit of length of a deck, which does not state it.

    Raises
    ------
    InputError
        For another kind of file, one without nodes or of several part instances, and a node whose place is not known
        from the file alone.
    """
    if not file.is_file():
        raise InputError("there is no such file", place=file, remedy="check the path")
    suffix = file.suffix.lower()
    if suffix == ".csv":
        return {node: place for node, (place, _) in read_sensor_table(file).items()}
    if suffix in MESHES:
        return dict(read_element_mesh(file, metres).points)
    if suffix not in DECKS:
        remedy = f"give .csv, {', '.join((*DECKS, *MESHES))}"
        raise InputError(f"unknown kind of file {suffix!r}", place=file, remedy=remedy)
    lines = deck_text(file).splitlines()
    is_abaqus = any(line.upper().lstrip().startswith("*NODE") for line in lines)
    is_ansys = any(line.upper().startswith("NBLOCK") for line in lines)
    out: dict[int, Point] = {}
    try:
        for node, place in (_abaqus if is_abaqus else _ansys if is_ansys else _nastran)(file, lines):
            x, y, z = (metres * own for own in place)
            if out.setdefault(node, (x, y, z)) != (x, y, z):
                raise InputError(f"node {node} is there twice, at different places", place=file,
                                 remedy="keep one of them")  # fmt: skip
    except InputError:
        raise
    except ValueError as fault:
        raise InputError(f"a node cannot be read ({fault})", place=file, remedy="give a table node, x, y, z") from None
    if not out:
        raise InputError("it defines no nodes (*NODE, GRID or NBLOCK)", place=file, remedy="give the file that does")
    return out


def _abaqus(file: Path, lines: list[str]) -> Iterator[tuple[int, Point]]:
    """Nodes below ``*NODE``; those of other blocks, such as ``*NODE FILE``, are requests of output.

    Of a deck of parts the nodes of its one instance are taken, at the place of the instance.
    """
    blocks = list(keyword_blocks(lines))
    instances = [(key, data) for key, data in blocks if is_keyword(key, "*INSTANCE")]
    if len(instances) > 1:
        raise InputError(
            f"it has {len(instances)} part instances, each with node numbers of its own", place=file,
            remedy="write a deck without parts, in which each number is there once, or give a table node, x, y, z",
        )  # fmt: skip
    made = next((key for key, _ in blocks if is_keyword(key, "*NGEN", "*NFILL", "*NCOPY", "*NMAP")), "")
    if made:
        raise InputError(f"{made.split(',')[0]} makes or moves nodes, which is not read", place=file,
                         remedy="give a table node, x, y, z, or the deck with all nodes under *NODE")  # fmt: skip
    key, data = instances[0] if instances else ("", [])
    of_part, turn, offset, within = value_of(key, "PART"), *_instance(data), ""
    for key, data in blocks:
        if is_keyword(key, "*PART"):
            within = value_of(key, "NAME")
        within = "" if is_keyword(key, "*ENDPART") else "instance" if is_keyword(key, "*INSTANCE") else within
        within = "" if is_keyword(key, "*ENDINSTANCE") else within
        if key.startswith("*SYSTEM") and data:
            raise _local(file, "*SYSTEM")
        if not is_keyword(key, "*NODE") or (within not in ("", "instance", of_part)):
            continue
        if "SYSTEM=" in key and "SYSTEM=R" not in key:
            raise _local(file, "*NODE with SYSTEM")
        for line in data:
            parts = [part.strip() for part in line.split(",")]
            place = np.array(([float(part) if part else 0.0 for part in parts[1:4]] + [0.0] * 3)[:3])
            x, y, z = (turn @ place + offset if within else place).tolist()
            yield int(parts[0]), (x, y, z)


def _instance(data: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and offset (3,) of a part instance.

    Its first line is a translation, its second two points and the angle in degrees by which it then turns about their
    axis (Abaqus, keyword *INSTANCE).
    """
    rows = [[float(part) for part in line.split(",") if part.strip()] for line in data if re.match(r"[-+.\d]", line)]
    moved = np.array(rows[0][:3]) if rows else np.zeros(3)
    if len(rows) < 2:
        return np.eye(3), moved
    a, b, angle = np.array(rows[1][:3]), np.array(rows[1][3:6]), np.radians(rows[1][6])
    x, y, z = (b - a) / np.linalg.norm(b - a)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn, turn @ (moved - a) + a


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
    """Nodes of ``GRID`` entries in basic axes, whatever the system in which they are placed."""
    places, unknown = placed_nodes("\n".join(lines))
    for node, number in unknown.items():
        raise InputError(f"GRID {node} is placed in system {number}, which it does not define", place=file,
                         remedy="give the deck that does, or a table node, x, y, z")  # fmt: skip
    for node, (x, y, z) in places.items():
        yield node, (float(x), float(y), float(z))


def _local(file: Path, what: str) -> InputError:
    return InputError(
        f"{what} is in a local coordinate system", place=file,
        remedy="write the nodes in global axes, or give a table node, x, y, z",
    )  # fmt: skip
