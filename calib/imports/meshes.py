"""Meshes from universal files (datasets 2411, 2412 and groups) and from Gmsh's text files (.msh)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calib.errors.errors import InputError
from calib.imports.elements import AREAS, LINE, LINE_3, LINE_3_LAST, SOLIDS, Edge, Element, ring
from calib.measurement.files.read import UFF_SUFFIXES
from calib.measurement.files.uff_blocks import Dataset, read_blocks
from calib.measurement.files.uff_nodes import length_factor, nodes_of
from calib.measurement.places import Point

MESHES = (*UFF_SUFFIXES, ".msh")
"""Suffixes of files that hold a mesh and no lines for a code."""

_ELEMENTS = 2412
_GROUPS = (2435, 2452, 2467, 2477)
"""Datasets of groups, alike but for what their heads mean."""
_OF_ELEMENT = 8
"""Kind of a member of a group."""
_BEAMS = (11, 21, 22, 23, 24)
"""Kinds of elements with a line for the orientation of a beam."""
_AROUND: Mapping[int, Sequence[Edge]] = {3: ring(0, 1, 2), 6: ring(0, 2, 4), 4: ring(0, 1, 2, 3), 8: ring(0, 2, 4, 6)}
"""Edges between the corners of shells, whose midside nodes stand between them."""
_AROUND_SOLID: Mapping[int, Sequence[Edge]] = {
    4: SOLIDS[4], 6: SOLIDS[6], 8: SOLIDS[8],
    10: (*ring(0, 2, 4), (0, 9), (2, 9), (4, 9)),
    15: (*ring(0, 2, 4), *ring(9, 11, 13), (0, 9), (2, 11), (4, 13)),
    20: (*ring(0, 2, 4, 6), *ring(12, 14, 16, 18), (0, 12), (2, 14), (4, 16), (6, 18)),
}  # fmt: skip
_GMSH: Mapping[int, tuple[int, int, Sequence[Edge]]] = {
    1: (1, 2, LINE), 8: (1, 3, LINE_3_LAST), 2: (2, 3, AREAS[3]), 9: (2, 6, AREAS[6]), 3: (2, 4, AREAS[4]),
    10: (2, 9, AREAS[9]), 16: (2, 8, AREAS[8]), 4: (3, 4, SOLIDS[4]), 11: (3, 10, SOLIDS[10]), 5: (3, 8, SOLIDS[8]),
    17: (3, 20, SOLIDS[20]), 6: (3, 6, SOLIDS[6]), 18: (3, 15, SOLIDS[15]),
}  # fmt: skip
"""Dimension, number of nodes and edges of each type of element of Gmsh."""


@dataclass(frozen=True, eq=False)
class ElementMesh:
    """Nodes, elements and named groups of elements.

    Attributes
    ----------
    points : mapping from node to (x, y, z)
        In m.
    elements : tuple of Element
    groups : mapping from name to numbers of elements
    """

    points: Mapping[int, Point]
    elements: tuple[Element, ...] = ()
    groups: Mapping[str, set[int]] = field(default_factory=dict)


def read_element_mesh(file: Path, metres: float = 1.0) -> ElementMesh:
    """Read a universal file or a text file of Gmsh (versions 2.2 and 4.1).

    Universal files give elements of dataset 2412 in the group of their physical property and groups of datasets 2435,
    2452, 2467 and 2477; Gmsh gives physical groups.

    Parameters
    ----------
    file : Path
    metres : float
        Per unit of length, where the file does not state it.

    Raises
    ------
    InputError
        For a file that cannot be read, is binary, or has no nodes.
    """
    read = _gmsh if file.suffix.lower() == ".msh" else _universal
    try:
        mesh = read(file, metres)
    except (ValueError, IndexError) as fault:
        raise InputError(f"its mesh cannot be read ({fault})", place=file, remedy="export it again, as text") from None
    if not mesh.points:
        raise InputError("it defines no nodes", place=file, remedy="export nodes too, or give a table node, x, y, z")
    return mesh


def has_elements(file: Path) -> bool:
    """Whether a universal file holds elements of a mesh, which one of measured modes does not."""
    try:
        return any(block.kind == _ELEMENTS for block in read_blocks(file))
    except InputError:  # told where it is read
        return False


def _universal(file: Path, metres: float) -> ElementMesh:
    blocks, notes = read_blocks(file), list[str]()
    is_stated = any(block.kind == 164 for block in blocks)
    points = nodes_of(file, blocks, length_factor(file, blocks, notes, None if is_stated else metres), notes).points
    found = [one for block in blocks if block.kind == _ELEMENTS for one in _elements(block)]
    groups: dict[str, set[int]] = {}
    for block in blocks:
        for name, members in _groups(block) if block.kind in _GROUPS else ():
            groups.setdefault(name, set()).update(members)
    return ElementMesh(points, tuple(found), groups)


def _elements(block: Dataset) -> Iterator[Element]:
    lines = iter(line for line in block.lines if line.strip())
    for head in lines:
        number, kind, thickness, _, _, count = map(int, head.split())
        if kind in _BEAMS:
            next(lines)
        nodes: list[int] = []
        while len(nodes) < count:
            nodes += map(int, next(lines, "x").split())
        is_solid = 101 <= kind <= 118
        edges: Sequence[Edge] = ()
        if kind in _BEAMS:
            edges = LINE if count == 2 else LINE_3
        elif is_solid or 41 <= kind <= 100:
            edges = (_AROUND_SOLID if is_solid else _AROUND).get(count, ())
        if edges:
            yield Element(number, f"property {thickness}", tuple(nodes), edges)


def _groups(block: Dataset) -> Iterator[tuple[str, set[int]]]:
    """Name and elements of each group; members are listed two a line, kind and number first of four integers each."""
    lines = [line for line in block.lines if line.strip()]
    at = 0
    while at + 1 < len(lines):
        count, name = int(lines[at].split()[-1]), lines[at + 1].strip()
        rows = lines[at + 2 : at + 2 + -(-count // 2)]
        cells = [int(cell) for row in rows for cell in row.split()]
        yield name, {number for kind, number in zip(cells[::4], cells[1::4], strict=True) if kind == _OF_ELEMENT}
        at += 2 + len(rows)


def _gmsh(file: Path, metres: float) -> ElementMesh:
    raw = file.read_bytes()
    parts = {name: body.split("\n") for name, body in _sections(raw.decode("latin-1").replace("\r\n", "\n"))}
    version, is_binary, *_ = parts["MeshFormat"][0].split() if "MeshFormat" in parts else ("none", "0")
    if is_binary != "0" or version not in ("2.2", "4.1"):
        words = "its values are binary" if is_binary != "0" else f"it is of version {version}"
        raise InputError(words, place=file, remedy="save it as text of version 2.2 or 4.1")
    names = {
        (int(dim), int(tag)): name
        for line in parts.get("PhysicalNames", ["0"])[1:]
        for dim, tag, name in re.findall(r"(\d+)\s+(\d+)\s+\"(.*)\"", line)
    }
    points, listed = (_gmsh_2 if version == "2.2" else _gmsh_4)(parts)
    elements, groups = [], dict[str, set[int]]()
    for number, kind, physical, nodes in listed:
        if kind not in _GMSH:
            continue
        dimension, count, edges = _GMSH[kind]
        elements.append(Element(number, "", tuple(nodes[:count]), edges))
        for tag in physical:
            groups.setdefault(names.get((dimension, tag), f"group {tag}"), set()).add(number)
    placed: dict[int, Point] = {}
    for node, at in points:
        if placed.setdefault(node, _scaled(at, metres)) != _scaled(at, metres):
            raise InputError(f"node {node} is there twice, at different places", place=file, remedy="keep one of them")
    return ElementMesh(placed, tuple(elements), groups)


def _sections(text: str) -> Iterator[tuple[str, str]]:
    for found in re.finditer(r"^\$(\w+)[ \t]*\n(.*?)^\$End\1", text, re.MULTILINE | re.DOTALL):
        yield found[1], found[2].strip("\n")


_Listed = list[tuple[int, int, Sequence[int], Sequence[int]]]
"""Number, type, physical groups and nodes of elements."""
_Places = list[tuple[int, list[str]]]


def _gmsh_2(parts: Mapping[str, Sequence[str]]) -> tuple[_Places, _Listed]:
    places = [(int(one[0]), one[1:4]) for one in _rows(parts["Nodes"][1:])]
    listed: _Listed = []
    for row in _rows(parts["Elements"][1:]):
        number, kind, tags, *rest = map(int, row)
        listed.append((number, kind, [tag for tag in rest[:1] if tag and tags], rest[tags:]))
    return places, listed


def _gmsh_4(parts: Mapping[str, Sequence[str]]) -> tuple[_Places, _Listed]:
    """Blocks of nodes and elements; physical groups are those of the entity (dimension and tag) of a block."""
    physical: dict[tuple[int, int], list[int]] = {}
    entities = _rows(parts.get("Entities", ["0 0 0 0"]))
    counts = list(map(int, next(entities)))
    for dimension, count in enumerate(counts):
        for _ in range(count):
            tag, *rest = next(entities)
            rest = rest[3 if dimension == 0 else 6 :]
            physical[dimension, int(tag)] = [abs(int(one)) for one in rest[1 : 1 + int(rest[0])]]
    places: _Places = []
    rows = _rows(parts["Nodes"])
    for _ in range(int(next(rows)[0])):
        count = int(next(rows)[3])
        numbers = [int(next(rows)[0]) for _ in range(count)]
        places += [(number, next(rows)[:3]) for number in numbers]
    listed: _Listed = []
    rows = _rows(parts["Elements"])
    for _ in range(int(next(rows)[0])):
        dimension, entity, kind, count = map(int, next(rows))
        for _ in range(count):
            number, *nodes = map(int, next(rows))
            listed.append((number, kind, physical.get((dimension, entity), ()), nodes))
    return places, listed


def _rows(lines: Iterable[str]) -> Iterator[list[str]]:
    return (line.split() for line in lines if line.strip())


def _scaled(place: Sequence[str], metres: float) -> Point:
    x, y, z = (metres * float(one) for one in place)
    return x, y, z
