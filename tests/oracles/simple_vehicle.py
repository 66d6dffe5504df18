"""The vehicle in a form that other finite-element codes take: what they share with the model, and the model's own side.

They have no averaging constraint, so that attachments act on each foot of their RBE3 by itself; and there are no
seats, whose feet stand between nodes.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.geometry import DofMap
from calib.structure.modes import Modes
from models.fem.discrete import PointMass, Spring, mass_matrix, spring_matrix
from models.fem.sheet import Sheet
from models.fem.structure import Structure
from models.railway.parameters import BOGIE, CAR, OTHERS
from models.railway.vehicle import assembly

SHARES = {"base": 0.70, "walls": 0.20, "cover": 0.10}
"""Of the further equipment's mass."""
ADDED = {"girder_centre": "m_girder_centre", "girder_end": "m_girder_ends", "crossbar": "m_crossbar", "axle": "m_axle"}
"""Parameters of the mass per length that groups of members bear beside their own."""


@dataclass(frozen=True)
class SimpleVehicle:
    """Structure, springs with their stiffness in N/m, and point masses, all at the adopted parameters."""

    structure: Structure
    springs: tuple[tuple[Spring, float], ...]
    masses: tuple[PointMass, ...]

    def added_mass(self, group: str) -> float:
        """Mass per length beside a member's own, kg/m."""
        values = {p.name: p.value for p in BOGIE}
        return values.get(ADDED.get(group.partition("_")[2], ""), 0.0)

    def sheets(self) -> dict[str, Sheet]:
        """Sheet of every group of panels, the further equipment spread over its density."""
        first = {p.group: p.sheet for p in reversed(self.structure.panels)}
        spread = {group: SHARES.get(group, 0.0) * OTHERS / self.structure.area((group,)) for group in first}
        return {g: replace(s, density=s.density + spread[g] / s.thickness) for g, s in first.items()}

    def near(self, part: str, point) -> tuple[int, float]:
        """The node of a part that is nearest to a place, and how far it is, m."""
        own = self._nodes(part)
        distance = np.linalg.norm(self.structure.points[own] - np.asarray(point), axis=1)
        return int(own[np.argmin(distance)]), float(distance.min())

    def _nodes(self, part: str) -> np.ndarray:
        body = np.array([b == part for b in self.structure.bodies])
        return np.flatnonzero(body) if body.any() else self.structure.group_nodes([part])

    def held(self) -> dict[int, set[int]]:
        """Suppressed motions 0..5 of every node that has any."""
        held: dict[int, set[int]] = defaultdict(set)
        for s in self.structure.suppressions:
            at = self.structure.group_nodes(s.groups) if s.point is None else [self.structure.node(s.body, s.point)]
            for node in at:
                held[int(node)] |= set(s.directions)
        return dict(held)

    def tied(self) -> Iterator[tuple[int, int, tuple[int, ...]]]:
        """Pairs of nodes with the motions that they share."""
        for tie in self.structure.ties:
            one, other = (self.structure.node(body, tie.point) for body in (tie.body, tie.other))
            yield one, other, tie.directions

    @cached_property
    def dofs(self) -> DofMap:
        """Free degrees of freedom of the model's own side."""
        return self.structure.dof_map()

    def matrices(self) -> tuple[sp.csc_array, sp.csc_array]:
        """K and M of the model's own side."""
        structure = self.structure
        shells, (stiff, heavy) = structure.shells(), structure.beams()
        k = stiff + shells.stiffness + spring_matrix(structure, [replace(s, weight=w) for s, w in self.springs])
        m = heavy + shells.mass + shells.rotary + mass_matrix(structure, self.masses)
        for group, share in SHARES.items():
            m = m + structure.area_mass((group,)) * (share * OTHERS / structure.area((group,)))
        for group in sorted({g.group for g in structure.members}):
            if added := self.added_mass(group):
                m = m + structure.added_mass((group,), False) * added
        t = self.dofs.expansion
        return sp.csc_array(t.T @ k @ t), sp.csc_array(t.T @ m @ t)

    def modes(self, stiffness: sp.csc_array, mass: sp.csc_array, count: int) -> Modes:
        """Undamped modes of the model's own side."""
        return solve_modes(stiffness, None, mass, count, self.dofs.direction >= 3)

    def translations(self, shapes: np.ndarray) -> np.ndarray:
        """Of all nodes, (3 n_nodes, n_modes), from shapes over the free degrees of freedom."""
        count = shapes.shape[1]
        return (self.dofs.expansion @ shapes).reshape(-1, 6, count)[:, :3].reshape(-1, count)


def simple_vehicle() -> SimpleVehicle:
    """The vehicle without seats, with attachments on single feet."""
    whole = assembly()
    old = whole.structure
    feet = {s.name: s.feet for s in old.rbe3s}
    kept = tuple(s for s in old.suppressions if s.groups != ("seat",))
    structure = replace(old, particles=(), rbe3s=(), suppressions=kept)
    values = {p.name: p.value * p.si_factor for p in CAR + BOGIE}
    springs: list[tuple[Spring, float]] = []
    for name, some in whole.springs.items():
        for spring in some if name != "seats" else ():
            stiffness = spring.weight * values.get(name, 1.0)
            if spring.end[0] not in feet:
                springs.append((spring, stiffness))
                continue
            assert spring.other is not None
            own = feet[spring.end[0]]
            for foot in own:
                single = replace(spring, end=("car", foot), other=(spring.other[0], foot))
                springs.append((single, stiffness / len(own)))
    masses: list[PointMass] = []
    for mass in whole.masses:
        own = feet.get(mass.at[0])
        if own:
            masses += [PointMass(("car", foot), mass.mass / len(own)) for foot in own]
        elif not mass.at[0].startswith("seat"):
            masses.append(mass)
    return SimpleVehicle(structure, tuple(springs), tuple(masses))
