"""Modes that codes print: Nastran .f06, .dat of Abaqus and of CalculiX, and PRNSOL listings of ANSYS."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.imports.frd import Found

_NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[EeDd][-+]?\d+|[-+]\d+)?(?![\d.])")
"""A number as Fortran prints it; two of them may touch, and an exponent may lack its letter."""
_LOCAL = re.compile(r"^[ \t]*\d+(?:[ \t]+[-+]?\d\.\d+E[-+]\d+){3}[ \t]+L[ \t]*$", re.MULTILINE)
"""A line of CalculiX for a node in local directions (*TRANSFORM)."""
_NASTRAN = ("T1", "T2", "T3", "R1", "R2", "R3")
_COLUMNS = (
    *((name, d) for d, name in enumerate(_NASTRAN)),
    *((name, d) for d, name in enumerate(("U1", "U2", "U3", "UR1", "UR2", "UR3"))),
    *((name, d) for d, name in enumerate(("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"))),
)
"""Names of directions in the heads of tables, and their index."""
_DIRECTION = dict(_COLUMNS)


def read_printed(file: Path) -> Found:
    """Frequencies and shapes that a code has printed; see `calib.imports.fe_modes.read_fe_modes`.

    Such files have no coordinates. A node is taken in the directions that the head of its table names; repeated heads,
    page breaks and totals are passed over.

    Raises
    ------
    InputError
        Where no table of modes is found, or shapes are printed without frequencies.
    """
    text = file.read_text("latin-1")
    squeezed = text.replace(" ", "").upper()
    if "REALEIGENVECTORNO." in squeezed:
        modes, shapes = _nastran(text)
    elif "EIGENVALUEOUTPUT" in squeezed:
        modes, shapes = _abaqus(text)
    elif "NODALSOLUTIONPERNODE" in squeezed or "NODALDEGREEOFFREEDOMLISTING" in squeezed:
        if (local := re.search(r"RESULTS ARE IN +(?!THE GLOBAL)(.*?)\s*$", text, re.MULTILINE)) is not None:
            raise InputError(f"its shapes are in {local[1].lower()}", place=file,
                             remedy="print them in the global system: RSYS,0")  # fmt: skip
        modes, shapes = _ansys(text)
    else:
        binary = file.suffix.lower() in (".rst", ".odb", ".rth")
        raise InputError(
            "it is a database that only its code reads" if binary
            else "no modes that Nastran, Abaqus, CalculiX or ANSYS print are in it", place=file,
            remedy="print the modes (ANSYS: PRNSOL,U,COMP after SET of each mode; Abaqus, CalculiX: *NODE PRINT; "
            "Nastran: DISPLACEMENT(PRINT)), or write a universal file",
        )  # fmt: skip
    if not modes:
        raise InputError("it has no frequencies of modes", place=file, remedy="let the code print its eigenvalues too")
    unknown = sorted(set(shapes) - set(modes))
    if unknown:
        raise InputError(
            f"it has the shape of mode {unknown[0]}, but not its frequency", place=file,
            remedy="let the code print its eigenvalues too",
        )  # fmt: skip
    numbers = [mode for mode in modes if mode in shapes] if shapes else list(modes)
    notes = []
    if own := {int(line.split()[0]) for line in _LOCAL.findall(text)}:
        notes.append(local_words(sorted(own)))
    if shapes and len(numbers) < len(modes):
        notes.append(f"{len(modes) - len(numbers)} modes of {file.name} without a printed shape were left out.")
    if not shapes:
        notes.append(f"{file.name} has frequencies alone: no shapes are printed.")
    places = {at: None for mode in numbers for at in shapes.get(mode, {})}
    motions = {at: np.array([shapes[mode].get(at, np.nan) for mode in numbers]) for at in places}
    return np.array([modes[mode] for mode in numbers]), motions, {}, tuple(notes)


def local_words(nodes: Sequence[int]) -> str:
    """What is told of nodes whose motions are printed in their own directions."""
    return (
        f"{len(nodes)} nodes, such as {nodes[0]}, are printed in directions of their own (*TRANSFORM), and left out: "
        "print them with *NODE PRINT, GLOBAL=YES."
    )


Modes = dict[int, float]
Shapes = dict[int, dict[tuple[int, int], float]]


def _numbers(line: str) -> list[float]:
    return [_number(one) for one in _NUMBER.findall(line)]


def _number(text: str) -> float:
    """A number of Fortran: ``1.0D-03`` and ``1.0-103`` have exponents too."""
    plain = text.upper().replace("D", "E")
    return float(re.sub(r"(?<=[\d.])([-+]\d+)$", r"E\1", plain) if "E" not in plain else plain)


def _head(line: str) -> list[int]:
    """Directions that the head of a table names; empty for any other line."""
    found = [_DIRECTION[word] for word in line.upper().split() if word in _DIRECTION]
    return found if len(found) == len(set(found)) else []


def _rows(line: str, directions: list[int], skip: int = 1) -> Iterator[tuple[tuple[int, int], float]]:
    """Motions of one line of a table; nothing of a line that is none."""
    values = _numbers(line)
    if not directions or len(values) < skip + len(directions) or not re.match(r"\s*\d+\s", line):
        return
    node = int(values[0])
    for d, value in zip(directions, values[skip:], strict=False):
        yield (node, d), value


def _nastran(text: str) -> tuple[Modes, Shapes]:
    """Cycles above every eigenvector, which also repeat on every page, and the grid points (type G) below."""
    modes, shapes = Modes(), Shapes()
    mode, directions, cycles = 0, list[int](), float("nan")
    for line in text.splitlines():
        squeezed = line.replace(" ", "").upper()
        if (match := re.search(r"CYCLES=([-+.\dED]+?)(?=REAL|$)", squeezed)) is not None:
            cycles = _number(match[1])
        if (match := re.search(r"REALEIGENVECTORNO\.(\d+)", squeezed)) is not None:
            mode, directions = int(match[1]), []
            modes[mode] = cycles
        elif mode and (own := _head(line)):
            directions = own
        elif mode and directions and re.match(r"\s*\d+\s+[A-Z]\s", line) is not None:
            node, kind = line.split()[:2]
            if kind == "G":
                values = _numbers(line[line.index(kind) + 1 :])
                own_shape = shapes.setdefault(mode, {})
                own_shape |= {(int(node), d): value for d, value in zip(directions, values, strict=False)}
        elif line.startswith("1") or squeezed.startswith("***"):
            directions = []
    return modes, shapes


def _abaqus(text: str) -> tuple[Modes, Shapes]:
    """The table of eigenvalues, fourth number in cycles per time, and what is printed below each of them.

    Abaqus and CalculiX head their tables alike. CalculiX prints displacements in three columns without a head of names.
    """
    modes, shapes = Modes(), Shapes()
    table, mode, directions = False, 0, list[int]()
    for line in text.splitlines():
        squeezed = line.replace(" ", "").upper()
        if "EIGENVALUEOUTPUT" in squeezed:
            table, mode = True, 0
        elif (match := re.search(r"EIGENVALUENUMBER(\d+)", squeezed)) is not None:
            table, mode, directions = False, int(match[1]), []
        elif table:
            values = _numbers(line)
            if re.match(r"\s*\d+\s", line) and len(values) >= 4:
                modes[int(values[0])] = values[3]
            elif modes and squeezed:
                table = False
        elif mode and "DISPLACEMENTS(VX,VY,VZ)" in squeezed:
            directions = [0, 1, 2]
        elif mode and (own := _head(line)):
            directions = own
        elif mode and squeezed.startswith(("MAXIMUM", "MINIMUM", "FORCES", "TOTAL", "THEFOLLOWING")):
            directions = [] if not squeezed.startswith("THEFOLLOWING") else directions
        elif mode and not line.endswith(" L"):
            shapes.setdefault(mode, {}).update(_rows(line, directions))
    return modes, {mode: own for mode, own in shapes.items() if own}


def _ansys(text: str) -> tuple[Modes, Shapes]:
    """Listings of PRNSOL,U and PRNSOL,ROT, one a mode: the substep is its number, FREQ its frequency."""
    modes, shapes = Modes(), Shapes()
    mode, directions = 0, list[int]()
    for line in text.splitlines():
        squeezed = line.replace(" ", "").upper()
        if (match := re.search(r"SUBSTEP=(\d+)", squeezed)) is not None:
            mode, directions = int(match[1]), []
        if (match := re.search(r"FREQ=([-+.\dED]+?)(?=LOAD|$)", squeezed)) is not None:
            modes[mode] = _number(match[1])
        elif mode and "NODE" in squeezed and (own := _head(line)):
            directions = own
        elif squeezed.startswith(("MAXIMUM", "MINIMUM", "VALUE", "NODE")):
            directions = []
        elif mode:
            shapes.setdefault(mode, {}).update(_rows(line, directions))
    return modes, {mode: own for mode, own in shapes.items() if own}
