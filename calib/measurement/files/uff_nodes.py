"""Nodes of universal files: places (datasets 15, 781, 2411), coordinate systems (18, 2420) and units (164)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.files.csv_format import VALUE_LIMIT
from calib.measurement.files.uff_blocks import Dataset, extract_sets
from calib.measurement.frf_units import SAME_UNIT
from calib.measurement.modal import DIRECTIONS
from calib.measurement.places import Point
from calib.measurement.rules import RULES

NODES = (15, 781, 2411)
"""Datasets of nodes; the last two are alike but for the system of their coordinates."""
_PER_METRE = {1: 1.0, 2: 1 / 0.3048, 3: 1.0, 4: 1 / 0.3048, 5: 1e3, 6: 1e2, 7: 1 / 0.0254, 8: 1e3}
"""Length factor that belongs to each unit code of dataset 164 (9 is user-defined)."""
_CARTESIAN, _CYLINDRICAL, _SPHERICAL = 0, 1, 2
_ON_AXIS = 1e-6
"""Distance from the axis of a cylindrical or spherical system, over that from its origin, within which a node has no
radial direction; files have six digits."""


@dataclass(frozen=True, eq=False)
class CoordinateSystem:
    """A coordinate system in global axes.

    Attributes
    ----------
    kind : int
        0 Cartesian, 1 cylindrical (r, angle, z), 2 spherical (r, angle from z, angle from x); angles in degrees.
    axes : ndarray (3, 3)
        Unit vectors of its Cartesian axes, one a row.
    origin : ndarray (3,)
        In the file's unit of length.
    """

    kind: int
    axes: np.ndarray
    origin: np.ndarray

    def place(self, entry: np.ndarray) -> np.ndarray:
        """Global coordinates of a point given in this system, (3,)."""
        own = entry
        if self.kind == _CYLINDRICAL:
            angle = math.radians(entry[1])
            own = np.array([entry[0] * math.cos(angle), entry[0] * math.sin(angle), entry[2]])
        elif self.kind == _SPHERICAL:
            polar, azimuth = np.radians(entry[1:])
            flat = entry[0] * math.sin(polar)
            own = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), entry[0] * math.cos(polar)])
        return np.asarray(own @ self.axes + self.origin)

    def directions(self, point: np.ndarray) -> np.ndarray | None:
        """Unit vectors of its three directions at a global point, one a row, (3, 3); None on its axis."""
        if self.kind == _CARTESIAN:
            return self.axes
        own = self.axes @ (point - self.origin)
        flat, far = math.hypot(own[0], own[1]), float(np.linalg.norm(own))
        if flat <= _ON_AXIS * far or far == 0:
            return None
        radial, around = np.array([own[0], own[1], 0.0]) / flat, np.array([-own[1], own[0], 0.0]) / flat
        if self.kind == _CYLINDRICAL:
            local = np.array([radial, around, [0.0, 0.0, 1.0]])
        else:
            up = np.array([radial[0] * own[2], radial[1] * own[2], -flat]) / far
            local = np.array([own / far, up, around])
        return np.asarray(local @ self.axes)


@dataclass(frozen=True)
class Nodes:
    """Nodes of one file.

    Attributes
    ----------
    points : mapping from node to place in m
    axes : mapping from node to ndarray (3, 3) or str
        Unit vectors of the directions in which its motion is given, one a row, where these are not the global ones; or
        why they are not known.
    """

    points: Mapping[int, Point] = field(default_factory=dict)
    axes: Mapping[int, np.ndarray | str] = field(default_factory=dict)

    def turned(self, values: Mapping[tuple[int, str], np.ndarray], source: str) -> dict[tuple[int, str], np.ndarray]:
        """Values by node and direction in global axes.

        Parameters
        ----------
        values : mapping from (node, direction) to ndarray
            In the axes of the nodes, all of one size; only what was measured.
        source : str
            The file, for messages.

        Raises
        ------
        InputError
            For a node whose axes are not known, and one that lacks a direction which a global one needs.
        """
        out = {key: entry for key, entry in values.items() if key[0] not in self.axes}
        for node in dict.fromkeys(node for node, _ in values if node in self.axes):
            axes = self.axes[node]
            if isinstance(axes, str):
                raise InputError(axes, place=source, remedy="export the system too, or results in global axes")
            for group in (DIRECTIONS[:3], DIRECTIONS[3:]):
                own = {k: values[node, name] for k, name in enumerate(group) if (node, name) in values}
                for g, name in enumerate(group):
                    needed = [k for k in range(3) if abs(axes[k, g]) > RULES.local_axis]
                    if not set(needed) & set(own):
                        continue
                    if lacking := [group[k] for k in needed if k not in own]:
                        known = ", ".join(group[k] for k in own)
                        raise InputError(
                            f"node {node} was measured in {known} of its local axes, which are no global ones: its "
                            f"global {name} needs {', '.join(lacking)} too",
                            place=source, remedy="give all directions of the node, or leave it out of the export",
                        )  # fmt: skip
                    out[node, name] = np.sum([axes[k, g] * entry for k, entry in own.items()], axis=0)
        return out


def nodes_of(path: Path, blocks: Sequence[Dataset], per_metre: float, notes: list[str]) -> Nodes:
    """Nodes of a file from its units of length per metre.

    Coordinates of datasets 15 and 781 are in the node's definition system, those of 2411 in global axes (the part's).
    Systems 0 and, where the file does not define it, 1 are global.

    Raises
    ------
    InputError
        For a damaged dataset, a node at two places or in a system that the file does not define, and systems that refer
        to each other.
    """
    systems = _systems(path, blocks)
    points: dict[int, Point] = {}
    axes: dict[int, np.ndarray | str] = {}
    turned: set[int] = set()
    for block in blocks:
        if block.kind not in NODES:
            continue
        for node, defined, moves, entry in _node_lines(path, block):
            place = entry
            if block.kind != 2411 and not _is_global(defined, systems):
                if defined not in systems:
                    words = f"node {node} is placed in coordinate system {defined}, which the file does not define"
                    raise block.error(path, words, "export the systems (dataset 2420), or global coordinates")
                place = systems[defined].place(entry)
                turned.add(defined)
            with np.errstate(all="ignore"):
                metres = place / per_metre
            if not np.isfinite(metres).all() or np.max(np.abs(metres)) > VALUE_LIMIT:
                words = (
                    f"a node in the dataset {block.kind} that starts here is not a label and three finite coordinates"
                )
                raise block.error(path, words, "correct it")
            here: Point = (float(metres[0]), float(metres[1]), float(metres[2]))
            if points.setdefault(node, here) != here:
                raise block.error(path, f"node {node} has two places", "remove one of them")
            if _is_global(moves, systems):
                continue
            if moves not in systems:
                axes[node] = f"node {node} moves in coordinate system {moves}, which the file does not define"
                continue
            own = systems[moves].directions(place)
            turned.add(moves)
            axes[node] = own if own is not None else f"node {node} lies on the axis of its coordinate system {moves}"
    if turned:
        notes.append(f"{path}: turned from coordinate systems {', '.join(map(str, sorted(turned)))} into global axes")
    return Nodes(points, axes)


def _is_global(label: int, systems: Mapping[int, CoordinateSystem]) -> bool:
    return label <= 0 or (label == 1 and label not in systems)


def _node_lines(path: Path, block: Dataset) -> list[tuple[int, int, int, np.ndarray]]:
    """Label, definition system, displacement system and coordinates (3,) of every node."""
    lines = [line for line in block.lines if line.strip()]
    size = 1 if block.kind == 15 else 2
    out = []
    for k in range(0, len(lines), size):
        cells = _cells(" ".join(lines[k : k + size])) if size == 2 else _cells(lines[k])
        if len(cells) != 7 or len(lines) % size:
            words = f"the dataset {block.kind} that starts here has not 7 values a node"
            raise block.error(path, words, "export it again")
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            words = f"the dataset {block.kind} that starts here cannot be read"
            raise block.error(path, words, "export it again") from None
        whole = numbers[:4]
        if not np.isfinite(numbers).all() or any(n != int(n) for n in whole):
            words = f"a node in the dataset {block.kind} that starts here is not a label and three finite coordinates"
            raise block.error(path, words, "correct it")
        out.append((int(whole[0]), int(whole[1]), int(whole[2]), np.array(numbers[4:])))
    return out


def _cells(line: str) -> list[str]:
    """Entries of a line of integers in columns of ten and numbers in columns of 13, which may touch."""
    cells = line.split()
    if len(cells) < 7 and len(line.rstrip()) > 66:
        cells = [line[10 * k : 10 * (k + 1)].strip() for k in range(4)]
        cells += [line[40 + 13 * k : 40 + 13 * (k + 1)].strip() for k in range(3)]
    return cells


def _systems(path: Path, blocks: Sequence[Dataset]) -> dict[int, CoordinateSystem]:
    """Coordinate systems of datasets 18 and 2420 by their labels."""
    out: dict[int, CoordinateSystem] = {}
    waiting: list[tuple[Dataset, int, int, int, np.ndarray]] = []
    for block in blocks:
        if block.kind not in (18, 2420):
            continue
        given: list[tuple[int, int, np.ndarray]] = []
        try:
            if block.kind == 2420:
                given = _of_2420(block)
            else:
                waiting += [(block, *entry) for entry in _of_18(block)]
        except (ValueError, IndexError):
            words = f"the dataset {block.kind} that starts here cannot be read"
            raise block.error(path, words, "export it again") from None
        for label, kind, table in given:
            out[label] = _system(path, block, label, kind, table[:3], table[3])
    labels = {label for _, label, _, _, _ in waiting} | set(out)
    while waiting:  # a system may refer to one that is defined behind it
        later = []
        for block, label, kind, reference, points in waiting:
            if reference in out:
                points = np.array([out[reference].place(point) for point in points])
            elif reference > 1 or reference in labels:
                later.append((block, label, kind, reference, points))
                continue
            out[label] = _system(path, block, label, kind, _from_points(path, block, label, points), points[0])
        if len(later) == len(waiting):
            block, label, _, reference, _ = waiting[0]
            words = f"coordinate system {label} refers to {reference}, which the file does not define"
            raise block.error(path, words, "export all of them, or global axes")
        waiting = later
    return out


def _system(
    path: Path, block: Dataset, label: int, kind: int, axes: np.ndarray, origin: np.ndarray
) -> CoordinateSystem:
    square = np.all(np.isfinite(axes)) and np.allclose(axes @ axes.T, np.eye(3), atol=1e-3)
    if kind not in (_CARTESIAN, _CYLINDRICAL, _SPHERICAL) or not square or not np.isfinite(origin).all():
        what = f"is of type {kind}" if square else "has axes that are not perpendicular units"
        raise block.error(
            path, f"coordinate system {label} {what}", "correct it (0 Cartesian, 1 cylindrical, 2 spherical)"
        )
    u, _, v = np.linalg.svd(axes)  # the nearest rotation: files round
    return CoordinateSystem(kind, u @ v, origin)


def _of_2420(block: Dataset) -> list[tuple[int, int, np.ndarray]]:
    """Label, type and 4 x 3 matrix (axes one a row, origin) of every system; a part's label and name come first."""
    lines = block.lines[2:]
    while lines and not lines[-1].strip():
        lines = lines[:-1]
    if len(lines) % 6:
        raise ValueError("not six lines a system")
    out = []
    for k in range(0, len(lines), 6):
        label, kind = (int(cell) for cell in lines[k].split()[:2])
        out.append((label, kind, np.array([[float(cell) for cell in line.split()] for line in lines[k + 2 : k + 6]])))
        if out[-1][2].shape != (4, 3):
            raise ValueError("not four lines of three numbers")
    return out


def _of_18(block: Dataset) -> list[tuple[int, int, int, np.ndarray]]:
    """Label, type, system of reference, and three points (3, 3) of every system."""
    lines = list(block.lines)
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) % 4:
        raise ValueError("not four lines a system")
    out = []
    for k in range(0, len(lines), 4):
        label, kind, reference = (int(lines[k][10 * n : 10 * (n + 1)].strip() or 0) for n in range(3))
        text = lines[k + 2].ljust(78)[:78] + lines[k + 3]
        cells = [text[13 * n : 13 * (n + 1)].strip() for n in range(9)]
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            numbers = [float(cell) for cell in (lines[k + 2] + " " + lines[k + 3]).split()]
        out.append((label, kind, reference, np.array(numbers).reshape(3, 3)))
    return out


def _from_points(path: Path, block: Dataset, label: int, points: np.ndarray) -> np.ndarray:
    """Axes (3, 3), one a row, from the origin, a point on the x axis and one in the plane of x and z."""
    x, across = points[1] - points[0], points[2] - points[0]
    y = np.cross(across, x)  # z cross x
    if not np.linalg.norm(y) > 1e-6 * np.linalg.norm(x) * np.linalg.norm(across):
        raise block.error(path, f"the three points of coordinate system {label} lie on a line", "correct it")
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    return np.array([x, y, np.cross(x, y)])


def length_factor(path: Path, blocks: Sequence[Dataset], notes: list[str], length_unit: float | None = None) -> float:
    """Length units of the file per metre: dividing by the factor of dataset 164 gives SI.

    Parameters
    ----------
    path : Path
    blocks : sequence of Dataset
    notes : list of str
        Takes what is assumed.
    length_unit : float, optional
        Metres per unit of length where the file does not state it; a contradiction is refused.
    """
    own = [block for block in blocks if block.kind == 164]
    factors = set()
    for block, data in zip(own, extract_sets(path, own), strict=True):
        factor, code = float(data["length"]), int(data["units_code"])
        if not (math.isfinite(factor) and factor > 0):
            raise block.error(path, f"the length factor of dataset 164 is {factor:g}", "correct it")
        if code in _PER_METRE and abs(factor / _PER_METRE[code] - 1) > SAME_UNIT:
            raise block.error(
                path,
                f"dataset 164 states unit code {code} ({_PER_METRE[code]:g} units a metre) but factor {factor:g}",
                "correct the code or the factor (code 9 for own units)",
            )
        factors.add(factor)
    if len(factors) > 1:
        raise InputError("two datasets 164 state different units", place=path, remedy="keep one of them")
    if factors and length_unit is not None and abs(length_unit * next(iter(factors)) - 1) > SAME_UNIT:
        words = f"dataset 164 states {next(iter(factors)):g} units of length a metre, not the stated unit"
        raise own[0].error(path, words, "leave the unit out")
    if factors:
        return factors.pop()
    if length_unit is None and any(block.kind in NODES for block in blocks):
        notes.append(f"{path}: no units (dataset 164): lengths taken as metres; length_unit states another")
    return 1.0 if length_unit is None else 1 / length_unit
