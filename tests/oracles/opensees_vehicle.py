"""The simple vehicle in OpenSees: nodes, sections, springs and masses are shared, elements and solver are its own."""

from __future__ import annotations

from collections import defaultdict
from types import ModuleType

import numpy as np
from simple_vehicle import SimpleVehicle

from models.fem.discrete import Spring


class Twin:
    """The vehicle built there; walls are ASDShellQ4, beams ElasticTimoshenkoBeam with consistent mass."""

    def __init__(self, ops: ModuleType, vehicle: SimpleVehicle) -> None:
        self.ops, self.vehicle, self.structure, self.tags, self.nodes = ops, vehicle, vehicle.structure, 0, 0
        self.mass: dict[int, np.ndarray] = defaultdict(lambda: np.zeros(6))
        ops.wipe()
        ops.model("basic", "-ndm", 3, "-ndf", 6)
        for point in self.structure.points:
            self._node(point)
        self._beams()
        self._walls()
        self._constraints()
        for spring, stiffness in vehicle.springs:
            self._spring(spring, stiffness)
        for item in vehicle.masses:
            self.mass[self._at(*item.at)] += [item.mass] * 3 + list(item.inertia)
        for node, mass in self.mass.items():
            self.ops.mass(node, *(float(v) for v in mass))

    def solve(self, count: int, system: str | None = "UmfPack") -> tuple[np.ndarray, np.ndarray]:
        """The lowest undamped modes: natural frequencies in Hz, translations (3 n_nodes, count).

        ``system`` is the linear solver, None what OpenSees takes unasked.
        """
        self.ops.constraints("Transformation")
        self.ops.numberer("RCM")
        if system is not None:
            self.ops.system(system)
        squares = np.array(self.ops.eigen("-genBandArpack", count))
        nodes = range(1, len(self.structure.points) + 1)
        shapes = [[self.ops.nodeEigenvector(n, k + 1)[:3] for n in nodes] for k in range(count)]
        self.ops.wipe()
        return np.sqrt(squares) / (2 * np.pi), np.array(shapes).reshape(count, -1).T

    def _tag(self) -> int:
        self.tags += 1
        return self.tags

    def _node(self, point) -> int:
        self.nodes += 1
        self.ops.node(self.nodes, *(float(v) for v in point))
        return self.nodes

    def _at(self, part: str, point) -> int:
        """The node of a part at a place, or a new one on a rigid arm from the nearest."""
        nearest, distance = self.vehicle.near(part, point)
        if distance < 1e-6:
            return nearest + 1
        tip = self._node(point)
        self.ops.rigidLink("beam", nearest + 1, tip)
        return tip

    def _beams(self) -> None:
        structure = self.structure
        for (a, b), k in zip(structure.ends, structure.member_of, strict=True):
            member = structure.members[k]
            s, along = member.section, structure.points[b] - structure.points[a]
            turn, shear = self._tag(), s.shear_coefficient * s.area
            self.ops.geomTransf("Linear", turn, *(float(v) for v in np.cross(along, member.up)))
            self.ops.element(
                "ElasticTimoshenkoBeam", self._tag(), int(a) + 1, int(b) + 1, s.young_modulus, s.shear_modulus, s.area,
                s.torsion, s.i_y, s.i_z, shear, shear, turn, "-mass", s.density * s.area, "-cMass",
            )  # fmt: skip
            for end in (a, b):
                self.mass[int(end) + 1][:3] += self.vehicle.added_mass(member.group) * np.linalg.norm(along) / 2

    def _walls(self) -> None:
        structure = self.structure
        for group, sheet in self.vehicle.sheets().items():
            section = self._tag()
            self.ops.section(
                "ElasticMembranePlateSection", section, sheet.young_modulus, sheet.poisson_ratio, sheet.thickness,
                sheet.density, sheet.rmi,
            )  # fmt: skip
            own = np.array([p.group == group for p in structure.panels])[structure.panel_of]
            for corners in structure.corners[own]:
                self.ops.element("ASDShellQ4", self._tag(), *(int(n) + 1 for n in corners), section)

    def _constraints(self) -> None:
        for one, other, directions in self.vehicle.tied():
            self.ops.equalDOF(one + 1, other + 1, *(d + 1 for d in directions))
        for node, directions in self.vehicle.held().items():
            self.ops.fix(node + 1, *(int(d in directions) for d in range(6)))

    def _spring(self, spring: Spring, stiffness: float) -> None:
        a, material = self._at(*spring.end), self._tag()
        self.ops.uniaxialMaterial("Elastic", material, stiffness)
        if spring.other is None:
            b = self._node(spring.end[1])
            self.ops.fix(b, 1, 1, 1, 1, 1, 1)
        else:
            b = self._at(*spring.other)
        if spring.other is None or np.allclose(spring.end[1], spring.other[1]):
            direction = 1 + int(np.argmax(np.abs(spring.direction)))
            self.ops.element("zeroLength", self._tag(), a, b, "-mat", material, "-dir", direction)
        else:
            self.ops.element("twoNodeLink", self._tag(), a, b, "-mat", material, "-dir", 1)
