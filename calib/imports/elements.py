"""Of a deck: elements, their edges and their sets, and supports; of Abaqus, CalculiX, Nastran and ANSYS."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from calib.imports.bulk import bulk_entries
from calib.imports.keywords import fields_between, is_keyword, keyword_blocks, value_of

Edge = tuple[int, int]

LINE: Sequence[Edge] = ((0, 1),)
LINE_3: Sequence[Edge] = ((0, 1), (1, 2))
LINE_3_LAST: Sequence[Edge] = ((0, 2), (2, 1))


def ring(*corners: int) -> tuple[Edge, ...]:
    """Edges around an area."""
    return tuple(zip(corners, (*corners[1:], corners[0]), strict=True))


_RING_3, _RING_4 = ring(0, 1, 2), ring(0, 1, 2, 3)
_TETRA = (*_RING_3, (0, 3), (1, 3), (2, 3))
_WEDGE = (*_RING_3, *ring(3, 4, 5), (0, 3), (1, 4), (2, 5))
_BRICK = (*_RING_4, *ring(4, 5, 6, 7), (0, 4), (1, 5), (2, 6), (3, 7))

SOLIDS: Mapping[int, Sequence[Edge]] = {4: _TETRA, 10: _TETRA, 6: _WEDGE, 15: _WEDGE, 8: _BRICK, 20: _BRICK}
"""Edges between the corners of solids by the number of their nodes; corners come first."""
AREAS: Mapping[int, Sequence[Edge]] = {3: _RING_3, 6: _RING_3, 4: _RING_4, 8: _RING_4, 9: _RING_4}
"""Edges of shells likewise."""
_LINES: Mapping[int, Sequence[Edge]] = {2: LINE, 3: LINE_3}
_KEYS: Mapping[str, tuple[int, int, int, Mapping[int, Sequence[Edge]]]] = {
    **dict.fromkeys(("CBAR", "CBEAM", "CROD", "CTUBE"), (2, 2, 2, _LINES)),
    "CTRIA3": (2, 3, 3, AREAS), "CTRIA6": (2, 3, 6, AREAS), "CQUAD4": (2, 4, 4, AREAS), "CQUAD8": (2, 4, 8, AREAS),
    "CTETRA": (2, 4, 10, SOLIDS), "CPENTA": (2, 6, 15, SOLIDS), "CHEXA": (2, 8, 20, SOLIDS),
}  # fmt: skip
"""Of entries of Nastran: the first field with a node, the number of corners and of nodes at most, and the edges."""
_ORIENTED: Mapping[int, Sequence[Edge]] = {2: LINE, 3: LINE}
_BLOCKS = "EBLOCK"
"""Elements in the database that ANSYS's CDWRITE writes."""
_TYPES: Mapping[str, Mapping[int, Sequence[Edge]]] = {
    **dict.fromkeys(("4", "8", "180", "188"), _ORIENTED), "189": {3: LINE_3_LAST, 4: LINE_3_LAST},
    **dict.fromkeys(("63", "93", "181", "281"), AREAS),
    **dict.fromkeys(("45", "92", "95", "185", "186", "187", "190", "285"), SOLIDS),
}  # fmt: skip
"""Edges by the number of nodes of types of ANSYS; the third node of a beam orients it."""


class Element(NamedTuple):
    """An element with edges: its number, the set that its own entry names, its nodes, and pairs of these."""

    number: int
    group: str
    nodes: tuple[int, ...]
    edges: Sequence[Edge]


def elements(text: str) -> Iterator[Element]:
    """Elements of a deck of Abaqus, CalculiX, Nastran or ANSYS (CDWRITE), in its order.

    Springs, masses and elements of other codes have no edges and are passed over. Nastran's elements are in the group
    of their property, ``property 7``.
    """
    lines = text.splitlines()
    if re.search(r"^\s*\*ELEMENT\b", text, re.MULTILINE | re.IGNORECASE):
        yield from _abaqus(lines)
    elif _BLOCKS in text:
        yield from _ansys(lines)
    else:
        yield from _nastran(text)


def read_edges(text: str) -> list[Edge]:
    """Edges between nodes of all elements that have any, each once, in the order of the deck.

    Midside nodes of beams are their nodes, those of shells and solids are passed over.
    """
    return edges_of(elements(text))


def edges_of(found: Iterable[Element]) -> list[Edge]:
    """As `read_edges`, of elements that were read."""
    pairs = ((one.nodes[i], one.nodes[j]) for one in found for i, j in one.edges)
    return list(dict.fromkeys((min(pair), max(pair)) for pair in pairs if pair[0] != pair[1]))


def element_sets(text: str) -> dict[str, set[int]]:
    """Nodes of the elements of each set: of ELSET, of a property of Nastran, of a component of ANSYS.

    Sets of the same elements under another name, such as that of all elements, stay apart.
    """
    every, lines = list(elements(text)), text.splitlines()
    members: dict[str, set[int]] = {}
    for one in every:
        if one.group:
            members.setdefault(one.group, set()).add(one.number)
    return sets_of(every, _components(lines) if _BLOCKS in text else _named_sets(lines, "*ELSET", members))


def sets_of(every: Sequence[Element], listed: Mapping[str, set[int]]) -> dict[str, set[int]]:
    """Nodes of the elements of each set: that which an element names itself, and those that list elements."""
    found: dict[str, set[int]] = {}
    of_element = {one.number: one.nodes for one in every}
    for one in every:
        if one.group:
            found.setdefault(one.group, set()).update(one.nodes)
    for name, numbers in listed.items():
        nodes = {node for number in numbers for node in of_element.get(number, ())}
        if nodes:
            found.setdefault(name, set()).update(nodes)
    return found


def _abaqus(lines: Iterable[str]) -> Iterator[Element]:
    for key, data in keyword_blocks(lines):
        edges = _of_type(key) if key.startswith("*ELEMENT,") else {}
        group, pending = value_of(key, "ELSET"), list[int]()
        for line in data if edges else ():
            pending += map(int, re.findall(r"-?\d+", line))
            if line.endswith(","):
                continue
            (number, *nodes), pending = pending, []
            if len(nodes) in edges:
                yield Element(number, group, tuple(nodes), edges[len(nodes)])


def _of_type(key: str) -> Mapping[int, Sequence[Edge]]:
    """Edges by the number of nodes, of a type of element such as S8R or C3D20."""
    match = re.search(r"TYPE=([A-Z]+\d?[A-Z]?)", key)
    kind = "" if match is None else match[1]
    if kind.startswith("C3D"):
        return SOLIDS
    if re.match(r"(S|SC|STRI|CPS|CPE|CAX|M3D)\d", kind) or kind.startswith("STRI"):
        return AREAS
    return _LINES if re.match(r"(B|PIPE|T)\d|T3D", kind) else {}


def _nastran(text: str) -> Iterator[Element]:
    for name, fields in bulk_entries(text):
        if name not in _KEYS:
            continue
        first, corners, most, edges = _KEYS[name]
        nodes = tuple(int(one) for one in fields[first : first + most] if re.fullmatch(r"\d+", one))
        if len(nodes) >= corners and fields[0].isdigit():
            yield Element(int(fields[0]), f"property {fields[1] or fields[0]}", nodes, edges[corners])


def _ansys(lines: Sequence[str]) -> Iterator[Element]:
    """Elements of EBLOCK: eleven numbers, of which the 2nd, 9th and 11th are type, count and number, then nodes."""
    types: dict[int, str] = {}
    at = 0
    while at < len(lines):
        line = lines[at].upper()
        at += 1
        if line.startswith("ET,"):
            _, number, name = (one.strip() for one in [*line.split(","), ""][:3])
            types[int(number)] = re.sub(r"\D", "", name)
        if not line.startswith(_BLOCKS):
            continue
        width = int(columns[1]) if (columns := re.search(r"I(\d+)", lines[at].upper())) else 10
        at += 1
        while at < len(lines) and lines[at].strip() not in ("", "-1"):
            cells = _cells(lines[at], width)
            at += 1
            if len(cells) > 11 and len(cells) < 11 + cells[8] and at < len(lines):
                cells += _cells(lines[at], width)
                at += 1
            nodes = tuple(cells[11 : 11 + cells[8]])
            edges = _TYPES.get(types.get(cells[1], ""), {}).get(len(nodes))
            if edges is not None:
                yield Element(cells[10], "", nodes, edges)


def _cells(line: str, width: int) -> list[int]:
    return [int(line[k : k + width]) for k in range(0, len(line.rstrip()), width)]


def _components(lines: Sequence[str]) -> dict[str, set[int]]:
    """Elements of each component (CMBLOCK), whose lists write a range by its negative end."""
    found: dict[str, set[int]] = {}
    numbers: list[int] | None = None
    for line in lines:
        if line.upper().startswith("CMBLOCK"):
            _, name, kind, *_ = (one.strip() for one in line.upper().split(","))
            numbers = [] if kind.startswith("ELEM") else None
            if numbers is not None:
                found[name] = set()
        elif numbers is not None and re.fullmatch(r"[\s\d-]+", line):
            for one in map(int, line.split()):
                found[name] |= set(range(numbers[-1], -one + 1)) if one < 0 else {one}
                numbers.append(abs(one))
        elif not line.startswith("("):
            numbers = None
    return found


def _named_sets(lines: Iterable[str], keyword: str, sets: dict[str, set[int]]) -> dict[str, set[int]]:
    """Sets of Abaqus that ``*NSET`` or ``*ELSET`` list by number, range or name; ``sets`` are those known before."""
    for key, data in keyword_blocks(lines):
        name = value_of(key, keyword[1:]) if key.startswith(f"{keyword},") else ""
        for line in data if name else ():
            fields, own = [field for field in fields_between(line) if field], sets.setdefault(name, set())
            if "GENERATE" in key:
                first, last, step = (*map(int, fields[:3]), 1)[:3]
                own |= set(range(first, last + 1, step))
            else:
                own.update(*({int(field)} if field.isdigit() else sets.get(field, set()) for field in fields))
    return sets


def _node_sets(text: str) -> dict[str, set[int]]:
    """Sets of nodes that ``*NODE`` and ``*NSET`` of a deck of Abaqus or CalculiX name."""
    lines, sets = text.splitlines(), dict[str, set[int]]()
    for key, data in keyword_blocks(lines):
        if key.startswith("*NODE,") and (name := value_of(key, "NSET")):
            sets.setdefault(name, set()).update(int(line.split(",")[0]) for line in data)
    return _named_sets(lines, "*NSET", sets)


def transformed_nodes(text: str) -> set[int]:
    """Nodes to which ``*TRANSFORM`` of a deck of Abaqus or CalculiX gives directions of their own."""
    keys = [key for key, _ in keyword_blocks(text.splitlines()) if is_keyword(key, "*TRANSFORM")]
    sets = _node_sets(text) if keys else {}
    return {node for key in keys for node in sets.get(value_of(key, "NSET"), ())}


def only_solids(text: str) -> bool:
    """Whether a deck of CalculiX has no elements but solids, springs and masses, so that no node gets layers."""
    keys = [key for key, _ in keyword_blocks(text.splitlines()) if is_keyword(key, "*ELEMENT", "*RIGIDBODY")]
    return bool(keys) and all(re.match("C3D|SPRING|MASS|DASHPOT", value_of(key, "TYPE")) for key in keys)


def held_motions(text: str) -> set[tuple[int, int]]:
    """Node and direction (1 to 6) of every motion that ``*BOUNDARY`` of a deck of Abaqus or CalculiX holds.

    Of a node with directions of its own (``*TRANSFORM``) three translations, or rotations, are told only where it holds
    all three.
    """
    sets, own_axes = _node_sets(text), transformed_nodes(text)
    held: set[tuple[int, int]] = set()
    for key, data in keyword_blocks(text.splitlines()):
        for fields in map(fields_between, data if is_keyword(key, "*BOUNDARY") else ()):
            if len(fields) > 1 and fields[1].isdigit():
                nodes = {int(fields[0])} if fields[0].isdigit() else sets.get(fields[0], set())
                last = int(fields[2]) if len(fields) > 2 and fields[2].isdigit() else int(fields[1])
                held |= {(node, d) for node in nodes for d in range(int(fields[1]), last + 1)}
    parts = {(node, first): [(node, d) for d in range(first, first + 3)] for node in own_axes for first in (1, 4)}
    return held - {one for own in parts.values() if not held.issuperset(own) for one in own}
