"""Decks for CalculiX, an independent finite-element code with a command line, and the frequencies that it answers.

CalculiX makes solids of shells (S4) and beams (B31), both without sections of their own: a wall is a solid sheet, a
beam a solid rectangle. Sheets and sections are therefore replaced by those that have the same stiffness in stretching
and bending and the same mass; transverse shear, torsion and rotary inertia then follow from the thickness and differ.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from models.fem.section import Section
from models.fem.sheet import Sheet

COMMAND = shutil.which("ccx")
"""Path of CalculiX; None where it is not installed."""
MISSING = "CalculiX (the command ccx) is not installed"

_LEAST_DENSITY = 1e-3
_STIFF = 1e9
"""N/m; hundreds of Hz with the masses that hang on it."""
_ARM = Section(1e-2, 1e-4 / 12, 1e-4 / 12, 1e-4 / 6, 2e13, 0.3, 0.0)


@dataclass
class Deck:
    """An input file that grows by nodes, elements and constraints; nodes and elements are numbered from 1."""

    lines: list[str] = field(default_factory=list)
    constraints: list[str] = field(default_factory=list)
    nodes: int = 0
    elements: int = 0
    materials: int = 0

    def node(self, point: Sequence[float]) -> int:
        """A new node."""
        self.nodes += 1
        self.lines += ["*NODE, NSET=ALL", ", ".join([str(self.nodes), *map(number, point)])]
        return self.nodes

    def shells(self, corners: Iterable[Sequence[int]], sheet: Sheet) -> None:
        """Four-node shells of one isotropic sheet."""
        name = self._elements("S4", corners)
        thickness = sheet.thickness * math.sqrt(sheet.rmi)  # E t and E t^3 RMI in a solid sheet
        scale = sheet.thickness / thickness
        material = self._material(sheet.young_modulus * scale, sheet.poisson_ratio, sheet.density * scale)
        self.lines += [f"*SHELL SECTION, ELSET={name}, MATERIAL={material}", number(thickness)]

    def beams(self, ends: Iterable[Sequence[int]], section: Section, up: Sequence[float], added: float = 0.0) -> None:
        """Beams of one section whose local y axis points towards ``up``; ``added`` is further mass in kg/m."""
        name = self._elements("B31", ends)
        high, wide = (math.sqrt(12 * i / section.area) for i in (section.i_z, section.i_y))
        scale = section.area / (high * wide)
        density = (section.density + added / section.area) * scale
        material = self._material(section.young_modulus * scale, section.poisson_ratio, density)
        self.lines += [f"*BEAM SECTION, ELSET={name}, MATERIAL={material}, SECTION=RECT"]
        self.lines += [", ".join([number(high), number(wide)]), ", ".join(map(number, up))]

    def spring(self, stiffness: float, one: int, other: int | None, direction: int | None) -> None:
        """Along a global direction 0..2 (None: the line between its nodes), to another node (None: the ground)."""
        kind = "SPRINGA" if direction is None else "SPRING1" if other is None else "SPRING2"
        along = "" if direction is None else str(direction + 1)
        name = self._elements(kind, [(one,) if other is None else (one, other)])
        self.lines += [f"*SPRING, ELSET={name}", f"{along}, {along}" if kind == "SPRING2" else along, number(stiffness)]

    def mass(self, node: int, point: Sequence[float], mass: float) -> None:
        """A point mass without inertia of its own, on stiff springs: CalculiX takes none at nodes that it expands."""
        own = self.node(point)
        name = self._elements("MASS", [(own,)])
        self.lines += [f"*MASS, ELSET={name}", number(mass)]
        for direction in range(3):
            self.spring(_STIFF, own, node, direction)

    def fixed(self, node: int, directions: Iterable[int]) -> None:
        """Suppressed motions 0..5."""
        self.constraints += ["*BOUNDARY", *(f"{node}, {d + 1}" for d in sorted(directions))]

    def equation(self, terms: Sequence[tuple[int, int, float]]) -> None:
        """The sum of motions (node, direction 0..5, factor) is zero; the first one follows from the others."""
        self.constraints += ["*EQUATION", str(len(terms))]
        self.constraints += [f"{node}, {d + 1}, {number(factor)}" for node, d, factor in terms]

    def arm(self, node: int, start: Sequence[float], end: Sequence[float]) -> int:
        """A new node at the end of a stiff beam without weight: arms by equations leave motions without stiffness."""
        tip, along = self.node(end), np.subtract(end, start)
        up = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        self.beams([(node, tip)], _ARM, up / np.linalg.norm(up))
        return tip

    def text(self, count: int) -> str:
        """The deck, asking for the lowest modes."""
        step = ["*STEP", "*FREQUENCY", str(count), "*END STEP", ""]
        return "\n".join([*self.lines, *self.constraints, *step])

    def _elements(self, kind: str, nodes: Iterable[Sequence[int]]) -> str:
        name = f"E{self.elements + 1}"
        self.lines.append(f"*ELEMENT, TYPE={kind}, ELSET={name}")
        for own in nodes:
            self.elements += 1
            self.lines.append(", ".join(str(int(n)) for n in (self.elements, *own)))
        return name

    def _material(self, young: float, poisson: float, density: float) -> str:
        self.materials += 1
        name = f"M{self.materials}"
        self.lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{number(young)}, {number(poisson)}"]
        self.lines += ["*DENSITY", number(max(density, _LEAST_DENSITY))]
        return name


def number(value: float) -> str:
    """As CalculiX reads it: with a point and a two-digit exponent."""
    return f"{float(value):.6E}"


@dataclass(frozen=True)
class Answer:
    """Natural frequencies in Hz, ascending, and the number of equations that were solved."""

    natural_freq: np.ndarray
    equations: int


def run(deck: str, folder: Path) -> Answer:
    """Let CalculiX solve a deck in a folder, on one thread; RuntimeError with its words where it cannot."""
    assert COMMAND is not None, MISSING
    (folder / "deck.inp").write_text(deck, "ascii")
    threads = {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1", "CCX_NPROC_STIFFNESS": "1"}
    done = subprocess.run(
        [COMMAND, "deck"], cwd=folder, env=os.environ | threads, capture_output=True, text=True, check=False
    )
    if done.returncode or "*ERROR" in done.stdout or "Job finished" not in done.stdout:
        raise RuntimeError(f"CalculiX failed: {done.stdout[-2000:]}{done.stderr[-500:]}")
    found = re.search(r"number of equations\s+(\d+)", done.stdout)
    return Answer(_frequencies(folder / "deck.dat"), int(found.group(1)) if found else 0)


def _frequencies(file: Path) -> np.ndarray:
    """Third column of numbers of the table of eigenvalues: cycles per time; the fourth is an imaginary part."""
    text = file.read_text("ascii") if file.exists() else ""
    _, _, rest = text.partition("E I G E N V A L U E   O U T P U T")
    rest = rest.partition("P A R T I C I P A T I O N")[0]
    rows = re.findall(r"^\s+\d+\s+(\S+E\S+)\s+(\S+E\S+)\s+(\S+E\S+)\s+(\S+E\S+)\s*$", rest, re.MULTILINE)
    return np.array([float(row[2]) for row in rows])
