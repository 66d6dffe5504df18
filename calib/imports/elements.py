"""Of a deck: supports, and edges of elements, which figures draw; of Abaqus, CalculiX and Nastran."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from calib.imports.coordinates import bulk_entries

Edge = tuple[int, int]

_LINE = ((0, 1),)
_LINE_3 = ((0, 1), (1, 2))
_RING_3, _RING_4 = ((0, 1), (1, 2), (2, 0)), ((0, 1), (1, 2), (2, 3), (3, 0))
_TETRA = (*_RING_3, (0, 3), (1, 3), (2, 3))
_WEDGE = (*_RING_3, (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_BRICK = (*_RING_4, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))

_SOLIDS: Mapping[int, Sequence[Edge]] = {4: _TETRA, 10: _TETRA, 6: _WEDGE, 15: _WEDGE, 8: _BRICK, 20: _BRICK}
"""Edges between the corners of solids by the number of their nodes."""
_AREAS: Mapping[int, Sequence[Edge]] = {3: _RING_3, 6: _RING_3, 4: _RING_4, 8: _RING_4, 9: _RING_4}
_LINES: Mapping[int, Sequence[Edge]] = {2: _LINE, 3: _LINE_3}
_KEYS: Mapping[str, tuple[int, int, Mapping[int, Sequence[Edge]]]] = {
    **dict.fromkeys(("CBAR", "CBEAM", "CROD", "CTUBE"), (2, 2, _LINES)),
    "CTRIA3": (2, 3, _AREAS), "CTRIA6": (2, 3, _AREAS), "CQUAD4": (2, 4, _AREAS), "CQUAD8": (2, 4, _AREAS),
    "CTETRA": (2, 4, _SOLIDS), "CPENTA": (2, 6, _SOLIDS), "CHEXA": (2, 8, _SOLIDS),
}  # fmt: skip
"""Of entries of Nastran: the first field with a node, the number of corners, and the edges."""


def element_edges(text: str) -> list[Edge]:
    """Edges between nodes of all elements that have any, each once, in the order of the deck.

    Parameters
    ----------
    text : str
        Of a deck. Springs, masses and elements of other codes have no edges; midside nodes of beams are their nodes,
        those of shells and solids are passed over.
    """
    is_abaqus = re.search(r"^\s*\*ELEMENT\b", text, re.MULTILINE | re.IGNORECASE) is not None
    found = _abaqus(text.splitlines()) if is_abaqus else _nastran(text)
    return list(dict.fromkeys((min(pair), max(pair)) for pair in found if pair[0] != pair[1]))


def _abaqus(lines: Iterable[str]) -> Iterator[Edge]:
    edges: Mapping[int, Sequence[Edge]] = {}
    pending: list[int] = []
    for line in lines:
        bare = line.strip()
        if not bare or bare.startswith("**"):
            continue
        if bare.startswith("*"):
            key = bare.upper().replace(" ", "")
            edges = _of_type(key) if key.startswith("*ELEMENT,") else {}
            pending = []
            continue
        if not edges:
            continue
        numbers = re.findall(r"-?\d+", bare)
        pending += [int(one) for one in numbers]
        if bare.endswith(","):
            continue
        nodes, pending = pending[1:], []
        yield from ((nodes[i], nodes[j]) for i, j in edges.get(len(nodes), ()))


def _of_type(key: str) -> Mapping[int, Sequence[Edge]]:
    """Edges by the number of nodes, of a type of element such as S8R or C3D20."""
    match = re.search(r"TYPE=([A-Z]+\d?[A-Z]?)", key)
    kind = "" if match is None else match[1]
    if kind.startswith("C3D"):
        return _SOLIDS
    if re.match(r"(S|SC|STRI|CPS|CPE|CAX|M3D)\d", kind) or kind.startswith("STRI"):
        return _AREAS
    return _LINES if re.match(r"(B|PIPE|T)\d|T3D", kind) else {}


def _nastran(text: str) -> Iterator[Edge]:
    for name, fields in bulk_entries(text):
        if name not in _KEYS:
            continue
        first, corners, edges = _KEYS[name]
        numbers = fields[first : first + corners]
        if len(numbers) == corners and all(re.fullmatch(r"\d+", one) for one in numbers):
            yield from ((int(numbers[i]), int(numbers[j])) for i, j in edges[corners])


def held_motions(text: str) -> set[tuple[int, int]]:
    """Node and direction (1 to 6) of every motion that ``*BOUNDARY`` of a deck of Abaqus or CalculiX holds."""
    sets: dict[str, set[int]] = {}
    held: set[tuple[int, int]] = set()
    key = name = ""
    for line in text.splitlines():
        bare = line.strip()
        if not bare or bare.startswith("**"):
            continue
        if bare.startswith("*"):
            key = bare.upper().replace(" ", "")
            match = re.search(r"NSET=([^,]+)", key)
            name = match[1] if match is not None else ""
            continue
        fields = [field.strip().upper() for field in bare.split(",")]
        if key.startswith("*NODE,") and name:
            sets.setdefault(name, set()).add(int(fields[0]))
        elif key.startswith("*NSET") and "GENERATE" in key:
            first, last, step = (*map(int, filter(None, fields[:3])), 1)[:3]
            sets.setdefault(name, set()).update(range(first, last + 1, step))
        elif key.startswith("*NSET"):
            for field in filter(None, fields):
                sets.setdefault(name, set()).update({int(field)} if field.isdigit() else sets.get(field, ()))
        elif key.startswith("*BOUNDARY") and len(fields) > 1 and fields[1].isdigit():
            nodes = {int(fields[0])} if fields[0].isdigit() else sets.get(fields[0], set())
            last = int(fields[2]) if len(fields) > 2 and fields[2].isdigit() else int(fields[1])
            held |= {(node, d) for node in nodes for d in range(int(fields[1]), last + 1)}
    return held
