"""Frames and plates given as matrices alone, with what each lacks, and which generic effects name it rightly."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import scipy.sparse as sp
from rates_frame import DENSITY, LIKE, SECTIONS, STEEL, Frame

import calib
from calib.measurement.modal import MeasuredModes, Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.composed import Connection, PointMass, ScaledParts, SoftJoint
from calib.structure.model import StructuralModel
from models.fem import thin_plate

COARSE, FINE = 6, 12
MODES, SOLVED = 7, 10
FREQ, SHAPE = 1e-3, 0.01
"""Standard deviations: of a frequency over it, of a shape over its largest entry."""
INSIDE = ("mass", "support", "thin", "strut", "joint")
OUTSIDE = ("notch", "storey")
PLATES, PLATE_INSIDE, PLATE_OUTSIDE = 1000, ("mass", "support", "thin", "stop"), ("cut", "layer")
"""Number of the first plate, and what they lack."""
PANEL, FINER = 4, 6
"""Elements along each panel of a plate."""
Place = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Case:
    """One structure with its test; ``clean`` is without noise, with the effect and without it."""

    hidden: str
    parts: bool
    model: StructuralModel
    measured: MeasuredModes
    clean: tuple[MeasuredModes, MeasuredModes]
    right: Callable[[Effect], bool]
    size: float


def case(number: int) -> Case:
    """The case of a number."""
    rng = np.random.default_rng([20261129, number])
    if number >= PLATES:
        return _plate_case(number, rng)
    kinds = ("", *INSIDE, *INSIDE, *OUTSIDE)
    hidden, parts = kinds[number % len(kinds)], bool(rng.random() < 0.5)
    spans = rng.uniform(4.0, 7.0, 1 + int(rng.random() < 0.6)).round(2).tolist()
    height, storeys = round(float(rng.uniform(3.0, 4.0)), 2), 2 + int(rng.random() < 0.2)
    coarse, fine = (Frame(n, spans, height, storeys) for n in (COARSE, FINE))
    model = coarse.model() if parts else _as_one(coarse)
    sensors = _sensors(coarse, rng)
    names = ("E_columns", "E_beams", "m_floors", "k_ground") if parts else ("stiffness",)
    values = {n: 1 + 0.5 * float(model.space[n].prior_width) * float(rng.standard_normal()) for n in names}
    true = values if parts else dict.fromkeys(("E_columns", "E_beams", "k_ground"), values["stiffness"])
    stiffness, mass, right, size = _made(hidden, coarse, fine, rng, parts)
    with_it, without = (_measured(fine.model(k, m), true, sensors) for k, m in ((stiffness, mass), ({}, {})))
    noisy = _noisy(with_it, rng)
    return Case(hidden, parts, model, noisy, (with_it, without), right, size)


def _as_one(one: Frame | Plate) -> StructuralModel:
    """A structure as one K and one M, as codes export it."""
    whole = one.model()
    k, _, m = whole.matrices({})
    moves = ("x", "z", "ry") if isinstance(one, Frame) else Plate.moves
    dofs = [(n + 1, d, *one.points[n]) for n in range(len(one.points)) for d in moves]
    return calib.StructuralModel.from_matrices(
        {"K": (k, "stiffness")}, {"M": m}, dofs=pd.DataFrame(dofs, columns=["node", "direction", "x", "y", "z"]),
        parameters=[Parameter("stiffness", 1.0, 0.5, 1.5, "-", prior_sd=0.1)], name=whole.name,
    )  # fmt: skip


def _sensors(frame: Frame, rng: np.random.Generator) -> tuple[Sensor, ...]:
    """Columns sideways at the middle and the top, beams upright at two places of three; one in ten is left out."""
    out = []
    for member in frame.members:
        column = member.startswith("column")
        along = [("x", 0.5), ("x", 1.0)] if column else [("z", 0.5), ("z", float(rng.choice([0.25, 0.75])))]
        out += [(frame.node(member, at), d) for d, at in along if rng.random() > 0.1]
    return tuple(Sensor(n + 1, d, frame.points[n]) for n, d in dict.fromkeys(out))


def _measured(model: StructuralModel, values: dict[str, float], sensors: tuple[Sensor, ...]) -> MeasuredModes:
    """What a test without noise would measure."""
    own = {name: value for name, value in values.items() if name in model.space}
    found = model.modes(own, MODES)
    rows = np.array([model.locator.row(s.point, "xyz".index(s.direction))[0] for s in sensors])  # type: ignore[arg-type]
    shapes = (rows @ found.shapes).real
    shapes = shapes / np.abs(shapes).max(axis=0)
    freq = np.asarray(found.natural_freq)
    return MeasuredModes(
        tuple(f"F{k + 1}" for k in range(MODES)), freq, freq, FREQ * freq, np.full(MODES, 0.01), np.full(MODES, np.nan),
        sensors, shapes, np.full(shapes.shape, SHAPE), 5, True,
    )  # fmt: skip


def _noisy(clean: MeasuredModes, rng: np.random.Generator) -> MeasuredModes:
    freq = clean.natural_freq * (1 + FREQ * rng.standard_normal(MODES))
    shapes = clean.shapes + SHAPE * rng.standard_normal(clean.shapes.shape)
    return replace(clean, natural_freq=freq, damped_freq=freq, shapes=shapes)


Made = tuple[dict[str, Any], dict[str, Any], Callable[[Effect], bool], float]


def _made(hidden: str, coarse: Frame, fine: Frame, rng: np.random.Generator, parts: bool) -> Made:
    """Terms of stiffness and mass on the finer mesh, what is right, and the size of the effect."""
    members = list(coarse.members)
    member = str(rng.choice(members))
    part = member.split()[0]
    column, beam = (str(rng.choice([m for m in members if m.startswith(kind)])) for kind in ("column", "beam"))
    bays, size = len(coarse.spans), float(rng.uniform(0.6, 1.6))
    ends = np.array([coarse.points[coarse.members[member][k]] for k in (0, -1)])
    near = float(np.linalg.norm(ends[1] - ends[0])) / 3

    def nothing(effect: Effect) -> bool:
        return False

    if hidden == "mass":
        along, kg = float(rng.uniform(0.2, 0.8)), 250.0 * size
        at = ends[0] + along * (ends[1] - ends[0])
        return {}, {"hidden": kg * fine.spread(member, along, 0.9)}, lambda e: _kind(e) == "mass" and (
            _within(e, at, near) or _on(e, member)
        ), kg  # fmt: skip
    if hidden == "support":
        foot, x = 1 + int(rng.integers(bays + 1)), min(0.55 * size, 0.9)
        change = -x * fine.support(foot, (0.9, 1.0, 1.0))
        at = np.array(coarse.points[foot - 1])
        return {"hidden": (change, "k_ground")}, {}, lambda e: _kind(e) in ("support", "stiffness") and (
            _within(e, at, near) or _on(e, f"support {foot}")
        ), x  # fmt: skip
    if hidden in ("thin", "notch"):
        x, high = (0.25 * size, 1.0) if hidden == "thin" else (min(0.5 * size, 0.8), 0.5)
        stiffness = (-x * fine.stiffness(member, 0.0, high), f"E_{part}s")
        lost = -x * fine.mass(member, DENSITY * SECTIONS[part][0], 0.0, high)
        return {"hidden": stiffness}, {"hidden": lost}, lambda e: hidden == "thin" and _on(e, member), x
    if hidden == "strut":
        level, bay = int(column.split()[1][0]), int(rng.integers(bays))
        names = [f"column {level}{bay + 1}", f"column {level}{bay + 2}"]
        k = 1.5e6 * size
        one, other = (fine.node(name, 0.5) for name in names)
        row = np.zeros(fine.size)
        row[3 * one], row[3 * other] = -1.0, 1.0
        length = math.dist(fine.points[one], fine.points[other])
        weight = k * length**2 * DENSITY / STEEL / 2 * (fine.lump(one) + fine.lump(other))
        tie = sp.csr_array(row[None])
        zs = coarse.points[coarse.node(names[0], 0.5)][2]
        xs = sorted(coarse.points[coarse.node(name, 0.5)][0] for name in names)
        return {"hidden": k * (tie.T @ tie)}, {"hidden": weight}, lambda e: _joins(e, xs, zs), k
    if hidden == "joint":
        x = min(0.5 * size, 0.85)
        flexible = LIKE * coarse.spans[0] / 8 / (STEEL * SECTIONS["beam"][1]) * x / (1 - x)
        change = fine.stiffness(beam, 0, 1 / FINE, flexible) - fine.stiffness(beam, 0, 1 / FINE)
        first, after = (coarse.points[n] for n in coarse.members[beam][:2])
        return {"hidden": (change, "E_beams")}, {}, lambda e: _turns(e, coarse, first, after), x
    if hidden == "storey":
        soft = [fine.stiffness(m) for m in members if m.startswith("column 2")]
        return {"hidden": (-0.15 * size * sum(soft[1:], soft[0]), "E_columns")}, {}, nothing, 0.15 * size
    return {}, {}, nothing, 0.0


# -- plates ------------------------------------------------------------------------------------------------------------


class Plate:
    """A thin plate of three by two panels on springs, with so many elements along each panel."""

    moves: ClassVar = ("z", "rx", "ry")

    def __init__(
        self, elements: int, sides: tuple[float, float], thickness: float, stands: list[tuple[float, float]]
    ) -> None:
        self.elements, self.thickness = elements, thickness
        self.nx, self.ny = 3 * elements, 2 * elements
        self.a, self.b = sides[0] / self.nx, sides[1] / self.ny
        self.points = [(i * self.a, j * self.b, 0.0) for j in range(self.ny + 1) for i in range(self.nx + 1)]
        self.stands = [self.near((x * sides[0], y * sides[1]), 0.0)[0] for x, y in stands]
        self.size = 3 * len(self.points)

    def near(self, at: tuple[float, float], within: float) -> list[int]:
        """The nearest node, and the others within a distance."""
        away = np.hypot(*(np.array(self.points)[:, :2] - at).T)
        return [int(np.argmin(away)), *(n for n in np.flatnonzero(away <= within).tolist() if n != np.argmin(away))]

    def sum(self, element: np.ndarray, kept: Callable[[int, int], bool]) -> sp.csr_array:
        """The same matrix of all elements (i, j) that are kept."""
        rows, columns, numbers = [], [], []
        for j in range(self.ny):
            for i in range(self.nx):
                if kept(i, j):
                    first = j * (self.nx + 1) + i
                    corners = (first, first + 1, first + self.nx + 2, first + self.nx + 1)
                    dofs = np.concatenate([3 * n + np.arange(3) for n in corners])
                    rows.append(np.repeat(dofs, 12))
                    columns.append(np.tile(dofs, 12))
                    numbers.append(element.ravel())
        place = (np.concatenate(rows), np.concatenate(columns))
        return sp.csr_array(sp.coo_array((np.concatenate(numbers), place), (self.size, self.size)))

    def stiffness(self, kept: Callable[[int, int], bool]) -> sp.csr_array:
        """Bending of some elements."""
        return self.sum(STEEL * thin_plate.stiffness(self.a, self.b, self.thickness, 0.3), kept)

    def mass(self, kept: Callable[[int, int], bool], per_area: float = 0.0) -> sp.csr_array:
        """Of some elements, of their own or of so many kg/m^2."""
        return self.sum(thin_plate.mass(self.a, self.b, per_area or DENSITY * self.thickness), kept)

    def on(self, nodes: list[int], number: float) -> sp.csr_array:
        """A mass or a spring along z, shared by some nodes."""
        dofs = 3 * np.array(nodes)
        return sp.csr_array(
            sp.coo_array((np.full(len(dofs), number / len(dofs)), (dofs, dofs)), (self.size, self.size))
        )

    def panel(self, k: int) -> Callable[[int, int], bool]:
        """The elements of a panel, counted from 0."""
        return lambda i, j: i // self.elements == k % 3 and j // self.elements == k // 3

    def model(self, stiffness: dict[str, Any] | None = None, mass: dict[str, Any] | None = None) -> StructuralModel:
        """The plate as matrices of its panels and supports; further terms have the multiplier given with them."""
        own: dict[str, Any] = {f"panel {k + 1}": (self.stiffness(self.panel(k)), "E_plate") for k in range(6)}
        own |= {f"support {k + 1}": (self.on([n], SPRING), "k_supports") for k, n in enumerate(self.stands)}
        masses: dict[str, Any] = {f"steel of panel {k + 1}": (self.mass(self.panel(k)), "m_plate") for k in range(6)}
        dofs = [(n + 1, d, *point) for n, point in enumerate(self.points) for d in self.moves]
        priors = {"E_plate": 0.08, "m_plate": 0.05, "k_supports": 0.25}
        return calib.StructuralModel.from_matrices(
            own | dict(stiffness or {}), masses | dict(mass or {}), name="plate",
            dofs=pd.DataFrame(dofs, columns=["node", "direction", "x", "y", "z"]),
            parameters=[Parameter(name, 1.0, 0.5, 1.8, "-", prior_sd=sd) for name, sd in priors.items()],
        )  # fmt: skip


SPRING = 4e5
"""Of each support of a plate, N/m."""


def _plate_case(number: int, rng: np.random.Generator) -> Case:
    """A plate with its test."""
    kinds = ("", *PLATE_INSIDE, *PLATE_INSIDE, *PLATE_OUTSIDE)
    hidden, parts = kinds[number % len(kinds)], bool(rng.random() < 0.5)
    sides = (float(rng.uniform(1.4, 2.2)), float(rng.uniform(0.8, 1.2)))
    thickness = float(rng.uniform(0.006, 0.012))
    stands = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.0), (0.5, 1.0)][: int(rng.choice([4, 5, 6]))]
    coarse, fine = (Plate(n, sides, thickness, stands) for n in (PANEL, FINER))
    model = coarse.model() if parts else _as_one(coarse)
    grid = [(i / 6 * sides[0], j / 4 * sides[1]) for j in range(5) for i in range(7)]
    nodes = [coarse.near(at, 0.0)[0] for at in grid if rng.random() < 0.7]
    sensors = tuple(Sensor(n + 1, "z", coarse.points[n]) for n in nodes)
    names = ("E_plate", "m_plate", "k_supports") if parts else ("stiffness",)
    values = {n: 1 + 0.5 * float(model.space[n].prior_width) * float(rng.standard_normal()) for n in names}
    true = values if parts else dict.fromkeys(("E_plate", "k_supports"), values["stiffness"])
    stiffness, mass, right, size = _made_of_plate(hidden, coarse, fine, sides, rng)
    with_it, without = (_measured(fine.model(k, m), true, sensors) for k, m in ((stiffness, mass), ({}, {})))
    return Case(hidden, parts, model, _noisy(with_it, rng), (with_it, without), right, size)


def _made_of_plate(
    hidden: str, coarse: Plate, fine: Plate, sides: tuple[float, float], rng: np.random.Generator
) -> Made:
    """Terms of stiffness and mass on the other mesh, what is right, and the size of the effect."""
    size, panel = math.exp(float(rng.uniform(math.log(0.12), math.log(1.2)))), int(rng.integers(6))
    x, y = (float(rng.uniform(0.15, 0.85)) * side for side in sides)
    near = max(sides[0] / 6, sides[1] / 4)
    at, touched = np.array([x, y, 0.0]), fine.near((x, y), 1.2 * max(fine.a, fine.b))
    on_panel = f"panel {1 + int(3 * x / sides[0]) + 3 * int(2 * y / sides[1])}"
    if hidden == "mass":
        kg = 0.04 * size * DENSITY * coarse.thickness * sides[0] * sides[1]
        return {}, {"hidden": fine.on(touched, kg)}, lambda e: _kind(e) == "mass" and (
            _within(e, at, near) or _on(e, on_panel)
        ), kg  # fmt: skip
    if hidden == "stop":
        k = 0.08 * SPRING * size
        return {"hidden": fine.on(touched, k)}, {}, lambda e: _stops(e, at, near), k
    if hidden == "support":
        k, share = int(rng.integers(len(coarse.stands))), min(0.45 * size, 0.9)
        place = np.array(coarse.points[coarse.stands[k]])
        change = -share * fine.on([fine.stands[k]], SPRING)
        return {"hidden": (change, "k_supports")}, {}, lambda e: _kind(e) in ("support", "stiffness") and (
            _within(e, place, near) or _on(e, f"support {k + 1}")
        ), share  # fmt: skip
    if hidden == "thin":
        less = 0.12 * size
        stiffness = (-(1 - (1 - less) ** 3) * fine.stiffness(fine.panel(panel)), "E_plate")
        lost = (-less * fine.mass(fine.panel(panel)), "m_plate")
        return {"hidden": stiffness}, {"hidden": lost}, lambda e: _on(e, f"panel {panel + 1}"), less
    if hidden == "cut":
        row, length = int(rng.integers(1, fine.nx - 1)), max(round(fine.ny * min(0.6 * size, 0.7)), 2)
        change = -0.85 * fine.stiffness(lambda i, j: i == row and j < length)
        return {"hidden": (change, "E_plate")}, {}, lambda e: False, length * fine.b
    if hidden == "layer":
        kg = 0.08 * size * DENSITY * coarse.thickness
        return {}, {"hidden": fine.mass(lambda i, j: i < fine.nx // 2, kg)}, lambda e: False, kg
    return {}, {}, lambda e: False, 0.0


def _stops(effect: Effect, at: np.ndarray, near: float) -> bool:
    """Whether a candidate is one spring to the ground along z near a place."""
    build = effect.build
    if not isinstance(build, Connection) or build.direction != 2 or len(build.ends) != 1 or build.ends[0][1]:
        return False
    (_, point), _ = build.ends[0]
    return math.dist(point, at.tolist()) <= near


# -- what is right -----------------------------------------------------------------------------------------------------


def _kind(effect: Effect) -> str:
    """What a candidate changes."""
    build = effect.build
    if isinstance(build, PointMass):
        return "mass"
    if isinstance(build, SoftJoint):
        return "support" if len(build.places) == 1 else "joint"
    if isinstance(build, ScaledParts):
        return build.parts[0][0]
    return "spring"


def _within(effect: Effect, at: np.ndarray, near: float) -> bool:
    """Whether a candidate that acts at one point does so near a place."""
    build, places = effect.build, list[Place]()
    if isinstance(build, PointMass):
        places = [point for _, point in build.places]
    elif isinstance(build, SoftJoint):
        places = list(build.places)
    return len(places) == 1 and math.dist(places[0], at.tolist()) <= near


def _on(effect: Effect, member: str) -> bool:
    """Whether a candidate changes that member or support alone."""
    build = effect.build
    if not isinstance(build, ScaledParts):
        return False
    names = {name.removeprefix("steel of ").removeprefix("floor on ") for _, name in build.parts}
    return names == {member}


def _turns(effect: Effect, frame: Frame, node: Place, after: Place) -> bool:
    """Whether a candidate is a soft joint of that end of a beam; where only two meet, of either."""
    build = effect.build
    if not isinstance(build, SoftJoint) or len(build.places) != 2 or math.dist(build.places[0], node) > 1e-6:
        return False
    ends = [frame.members[m][k] for m in frame.members for k in (0, -1)]
    return math.dist(build.places[1], after) < 1e-6 or ends.count(frame.points.index(node)) == 2


def _joins(effect: Effect, xs: list[float], z: float) -> bool:
    """Whether a candidate is a horizontal spring between those columns at that height."""
    build = effect.build
    if not isinstance(build, Connection) or len(build.ends) != 1 or build.ends[0][1] is None or build.direction != 0:
        return False
    (_, one), (_, other) = build.ends[0]  # type: ignore[misc]
    return sorted([one[0], other[0]]) == xs and max(abs(one[2] - z), abs(other[2] - z)) < 1e-6
