"""Modes from CalculiX's .frd: fixed columns of text, with the nodes as CalculiX itself has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.errors.place import Place
from calib.imports.elements import AREAS, LINE, LINE_3_LAST, SOLIDS, Edge, Element
from calib.measurement.places import Point

Found = tuple[np.ndarray, dict[tuple[int, int], np.ndarray], dict[int, Point], tuple[str, ...]]
"""Frequencies (Hz), motions by node and direction, places of nodes in the file's unit, and notes."""

_COMPONENTS = 3
_WIDTH, _FIRST = 12, 13
"""Columns of a number, and before the first one of a line of values."""


def read_frd(file: Path) -> Found:
    """Frequencies, displacements and places of nodes; see `calib.imports.fe_modes.read_fe_modes`.

    The frequency of a mode is that of its header, in Hz, with six digits. Shells and beams are written as the solids
    that CalculiX makes of them, unless ``*NODE FILE, OUTPUT=2D`` asks for their own nodes.

    Raises
    ------
    InputError
        With the line, for one that cannot be read, for a binary file, and where there are no displacements of modes.
    """
    lines = file.read_text("ascii", errors="replace").splitlines()
    points: dict[int, Point] = {}
    freq: list[float] = []
    found: list[dict[int, np.ndarray]] = []
    block, is_modal = "", False
    other = 0
    for number, line in enumerate(lines, start=1):
        key = line[:5].strip()
        try:
            if key == "2C" or line.startswith("    2C"):
                block = "nodes"
                _require_text(file, number, line)
            elif line.startswith("  100C"):
                block, is_modal = "header", "MODAL" in line[58:72].upper()
                value = float(line[12:24])
                _require_text(file, number, line)
            elif key == "-4":
                name = line[5:13].strip()
                block = "motion" if name == "DISP" and is_modal else ""
                if block:
                    freq.append(value)
                    found.append({})
                other += name == "DISP" and not is_modal
            elif key == "-3":
                block = ""
            elif key == "-1" and block == "nodes":
                x, y, z = _numbers(line)
                points[int(line[3:13])] = (x, y, z)
            elif key == "-1" and block == "motion":
                found[-1][int(line[3:13])] = np.array(_numbers(line))
        except ValueError:
            raise InputError(
                f"it cannot be read: {line.strip()[:60]!r}", place=Place.in_lines(str(file), lines, number),
                remedy="write the file again; it may be cut off",
            ) from None  # fmt: skip
    if not freq:
        words = "it holds displacements, but none of modes" if other else "it holds no displacements of modes"
        raise InputError(words, place=file, remedy="ask for *NODE FILE with U in a *FREQUENCY step")
    nodes = {node: None for one in found for node in one}
    nothing = np.full(_COMPONENTS, np.nan)
    motions = {
        (node, d): np.array([one.get(node, nothing)[d] for one in found]) for node in nodes for d in range(_COMPONENTS)
    }
    return np.array(freq), motions, points, ()


_EDGES: Mapping[int, Sequence[Edge]] = {
    1: SOLIDS[8], 2: SOLIDS[6], 3: SOLIDS[4], 4: SOLIDS[20], 5: SOLIDS[15], 6: SOLIDS[10],
    7: AREAS[3], 8: AREAS[6], 9: AREAS[4], 10: AREAS[8], 11: LINE, 12: LINE_3_LAST,
}  # fmt: skip
"""Edges by the type of an element; corners come first (CalculiX GraphiX, result format)."""


def frd_elements(file: Path) -> Iterator[Element]:
    """Elements of a text file, each a line ``-1`` with its number and type and lines ``-2`` with its nodes.

    Numbers of nodes have ten columns, or five in the short form; where a line cannot be read the elements end.
    """
    inside, wide, number, nodes = False, 10, 0, list[int]()
    edges: Sequence[Edge] = ()
    for line in file.read_text("ascii", errors="replace").splitlines():
        key = line[:3].strip()
        try:
            if line.startswith("    3C"):
                inside, wide = True, 5 if line.split()[-1] == "0" else 10
            elif inside and key == "-2":
                nodes += [int(line[k : k + wide]) for k in range(3, len(line.rstrip()), wide)]
            elif inside:
                if nodes:
                    yield Element(number, "", tuple(nodes), edges)
                nodes = []
                if key != "-1":
                    return
                number, edges = int(line[3 : 3 + wide]), _EDGES.get(int(line[3 + wide : 8 + wide]), ())
        except ValueError:
            return


def _numbers(line: str) -> tuple[float, float, float]:
    """Three numbers of twelve columns each, which may touch."""
    x, y, z = (float(line[_FIRST + k * _WIDTH : _FIRST + (k + 1) * _WIDTH]) for k in range(_COMPONENTS))
    return x, y, z


def _require_text(file: Path, number: int, line: str) -> None:
    """InputError for a binary block: the last number of a header is 0 or 1 for text, 2 or 3 for binary."""
    if line.split()[-1] in ("2", "3"):
        raise InputError("its values are binary", place=f"{file}, line {number}", remedy="write it as text (ccx)")
