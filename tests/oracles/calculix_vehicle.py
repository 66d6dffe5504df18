"""The simple vehicle as a deck for CalculiX."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from calculix import Deck
from simple_vehicle import SimpleVehicle

from models.fem.section import Section


def deck_of(vehicle: SimpleVehicle) -> Deck:
    """Nodes, shells, beams, springs and masses; see `calculix` for what CalculiX makes of sections."""
    structure, deck = vehicle.structure, Deck()
    for point in structure.points:
        deck.node(point)
    for group, sheet in vehicle.sheets().items():
        own = np.array([p.group == group for p in structure.panels])[structure.panel_of]
        deck.shells(structure.corners[own] + 1, sheet)
    _beams(vehicle, deck)
    for node, directions in vehicle.held().items():
        deck.fixed(node + 1, directions)
    for one, other, directions in vehicle.tied():
        for d in directions:
            deck.equation([(one + 1, d, 1.0), (other + 1, d, -1.0)])
    tips: dict[tuple, int] = {}

    def at(part: str, point) -> int:
        nearest, distance = vehicle.near(part, point)
        if distance < 1e-6:
            return nearest + 1
        key = (nearest, *np.round(point, 6).tolist())
        if key not in tips:
            tips[key] = deck.arm(nearest + 1, structure.points[nearest], point)
        return tips[key]

    for spring, stiffness in vehicle.springs:
        one, other = at(*spring.end), None if spring.other is None else at(*spring.other)
        along = np.flatnonzero(np.abs(spring.direction) > 1e-9)
        deck.spring(stiffness, one, other, int(along[0]) if len(along) == 1 else None)
    for mass in vehicle.masses:
        deck.mass(at(*mass.at), mass.at[1], mass.mass)
    return deck


def _beams(vehicle: SimpleVehicle, deck: Deck) -> None:
    """One set of elements for each section; members that run along the same nodes are one beam."""
    structure = vehicle.structure
    by_ends: dict[tuple[int, int], list[int]] = defaultdict(list)
    for ends, k in zip(structure.ends.tolist(), structure.member_of.tolist(), strict=True):
        by_ends[min(ends), max(ends)].append(k)
    sets: dict[tuple, list[tuple[int, int]]] = defaultdict(list)
    for ends, owners in by_ends.items():
        members = [structure.members[k] for k in owners]
        first = members[0].section
        joined = Section(
            sum(m.section.area for m in members), sum(m.section.i_y for m in members),
            sum(m.section.i_z for m in members), 1.0, first.young_modulus, first.poisson_ratio,
            sum(m.section.density * m.section.area for m in members) / sum(m.section.area for m in members),
        )  # fmt: skip
        added = sum(vehicle.added_mass(m.group) for m in members)
        sets[joined, _across(structure.points[list(ends)], members[0].up), added].append(ends)
    for (section, up, added), pairs in sets.items():
        deck.beams([(a + 1, b + 1) for a, b in pairs], section, up, added)


def _across(ends: np.ndarray, up: tuple[float, ...]) -> tuple[float, ...]:
    """The part of the reference direction that is square to a beam."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    rest = np.array(up, dtype=float) - (np.array(up) @ along) * along
    return tuple((np.round(rest / np.linalg.norm(rest), 9) + 0.0).tolist())
