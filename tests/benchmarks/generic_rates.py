"""How often generic effects name rightly what an imported frame or plate lacks.

    python tests/benchmarks/generic_rates.py run --cases 39
    python tests/benchmarks/generic_rates.py run --of plate --cases 21
    python tests/benchmarks/generic_rates.py report --write docs/rates_generic.csv

Every case is a structure of its own. A frame is plane: one or two bays, two or three storeys, spans, heights, sensors
and true parameters drawn anew. It is given as matrices without a library: in about every second case one K and one M,
else those of every member and support, which share parameters. The test comes from a mesh twice as fine, on which the
effect is made otherwise than the candidates are: a mass is spread over a length and lies anywhere on a member, a
support gives way less sideways, a thinner member loses mass too, a strut has a mass; a joint is a hinge at the end of a
beam. A section cut over half of a member, a storey with softer columns, and a thinner member where matrices name none
are in no form of the candidates.

A plate in bending stands on four to six springs, given as matrices of six panels and the supports, or as one K and one
M; the test comes from another mesh, of six elements along a panel for four. A mass is spread over some nodes, a panel
is thinner, a support gives way, a stop on some nodes touches it. A cut along a line, a layer on one half, and a thinner
panel where matrices name none are in no form of the candidates.

What is named is right if it is of the kind that was made and at its place: within a third of a member or half a panel
for masses, supports and stops, on that member or panel for sections, between those columns for struts. A place that is
free counts where it was fitted. The mass of the member or panel on which a mass lies is right too, and any change
of a panel that is thinner. Where no
candidate would be right, as without a sensor on one of the columns, what is missing is in no form of them. A set of
several that cannot be told apart is right if its best is; one that holds the truth elsewhere is no wrong name.
"Something
like it" of the right kind and place names nothing, and is counted apart.
"""

from __future__ import annotations

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import argparse
import json
import math
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import scipy.sparse as sp
from rates_frame import DENSITY, LIKE, SECTIONS, STEEL, Frame
from rates_subject import ROOT
from rates_table import NAMING, Rate, bound_of, write_rates
from rates_world import digest_of

import calib
from calib.analyses.explain import decision, decision_in_detail
from calib.analyses.hypotheses_of_study import adapter_for
from calib.execution.stage import silent
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.explanation import Explanation
from calib.missing.partial import is_far_ahead
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.composed import Connection, PointMass, ScaledParts, SoftJoint
from calib.structure.effects.compositions import generic_effects
from calib.structure.effects.free_place import FreePlace
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
DETECTABLE = 6.0
PRINTED = ("number", "of", "scenario", "parts", "visible", "verdict", "outcome", "best", "error", "seconds")
SOURCES = (
    "tests/benchmarks/generic_rates.py",
    "tests/benchmarks/rates_frame.py",
    "calib/hypotheses",
    "calib/analyses/explain.py",
    "calib/structure/effects",
)
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


def run(number: int, code: str) -> dict[str, Any]:
    """What is told of one case, beside the truth."""
    started, one = time.perf_counter(), case(number)
    library = generic_effects(one.model, [one.measured])
    problem = calib.Problem(one.model, calib.ModalTest(one.measured, mode_count=SOLVED))
    study = problem.study(effects={one.model.name: library})
    adapter = adapter_for(study, None, silent, {})
    found = decision(adapter, study.settings.explain, "case")
    adapter, found = decision_in_detail(adapter, found, study.settings.explain, "case")
    score = _score(one, found)
    group = "nothing" if not one.hidden else "single" if any(map(one.right, library)) else "outside"
    return {
        "number": number, "code": code, "group": group, "hidden": [one.hidden] if one.hidden else [],
        "of": one.model.name,
        "scenario": one.hidden or "nothing", "parts": one.parts, "magnitudes": {one.hidden: one.size},
        "n_dof": one.model.n_dof,
        "verdict": found.verdict, "credible": list(found.credible), "candidates": len(library),
        "best": [] if found.chosen is None else list(found.chosen.names), "outcome": _outcome(one, library, found),
        "visible": [round(score, 2)] * bool(one.hidden), "z": [round(score, 2)] * bool(one.hidden),
        "p_family": found.base_adequacy.p_family, "p_fit": found.base_adequacy.p_fit, "evaluations": found.evaluations,
        "blamed": [fault.name for fault, _ in found.faulty],
        "place": None if found.place is None else found.place.names[0],
        "seconds": round(time.perf_counter() - started, 1),
    }  # fmt: skip


def _outcome(one: Case, library: tuple[Effect, ...], found: Explanation) -> str:
    """See `rates_outcome.outcome`; a set is right if the best of it is, one that holds the truth is `second`."""
    of = {effect.name: effect for effect in library} | _at_fitted_places(library, found)
    if not found.names_something:
        like = found.verdict == "partial" and is_far_ahead(found) and found.chosen is not None
        return "like it" if like and all(one.right(of[n]) for n in found.chosen.names if n in of) else found.verdict
    assert found.chosen is not None
    best, credible = ([name for name in names if name in of] for names in (found.chosen.names, found.credible))
    if best and all(one.right(of[name]) for name in best):
        return "right"
    return "second" if any(one.right(of[name]) for name in credible) else "wrong"


def _at_fitted_places(library: tuple[Effect, ...], found: Explanation) -> dict[str, Effect]:
    """Effects at free places, each as one at the place where it was fitted."""
    out, fitted = {}, {t.names[0]: t.fit.values for t in found.singles}
    for effect in (e.richer for e in library if e.richer is not None):
        free = effect.build
        if isinstance(free, FreePlace) and effect.name in fitted:
            place = (None, free.moved(fitted[effect.name]))
            at = (
                PointMass(effect.name, (place,), free.directions)
                if free.matrix == "mass"
                else Connection(effect.name, "stiffness", ((place, None),), free.directions[0])
            )
            out[effect.name] = replace(effect, build=at)
    return out


def _score(one: Case, found: Explanation) -> float:
    """Change that the effect makes beyond what the parameters absorb, in standard deviations."""
    fit, tests = found.base.fit, (calib.ModalTest(clean, mode_count=SOLVED) for clean in one.clean)
    known = {name: value for name, value in fit.values.items() if name in one.model.space}
    with_it, without = (test.residual(test.problem(one.model)) for test in tests)
    change = with_it.of(with_it.solve(known)) - without.of(without.solve(known))
    if len(change) != len(fit.residual):
        return float("nan")
    return float(np.linalg.norm(fit.project_out(change[:, None])))


def counts(rows: list[dict[str, Any]]) -> list[Rate]:
    """The criteria of `rates_table.rates` that the cases are made for, with what is required of generic effects."""

    def rate(
        hidden: str, verdict: str, required: float, some: list[Any], is_so: Callable[[Any], bool], least: bool = True
    ) -> Rate:
        return Rate(hidden, verdict, required, least, sum(map(is_so, some)), len(some))

    single = [r for r in rows if r["group"] == "single"]
    strong = [r for r in single if r["visible"][0] >= DETECTABLE]
    outside, nothing = ([r for r in rows if r["group"] == name] for name in ("outside", "nothing"))
    seen = [r for r in outside if r["visible"][0] >= DETECTABLE]
    one = "an effect, generic candidates"
    return [
        rate(f"{one}, expected score 6 or more", "names it rightly", 0.9, strong, lambda r: r["outcome"] == "right"),
        rate(f"{one}, expected score 6 or more", "names it rightly, or something like it", 0.9, strong,
             lambda r: r["outcome"] in ("right", "like it")),
        rate(f"{one}, expected score 6 or more", "the truth is among the names, or nothing is named", 0.98, strong,
             lambda r: r["outcome"] != "wrong"),
        rate(f"{one} of any magnitude", "names a wrong effect", 0.0, single, lambda r: r["outcome"] == "wrong", False),
        rate("something in no form of the candidates", "names something", 0.02, outside,
             lambda r: r["verdict"] in NAMING, False),
        rate("something in no form of the candidates, expected score 6 or more", "says that something is missing",
             0.85, seen, lambda r: r["verdict"] != "nothing_detectable"),
        rate("nothing, generic candidates", "names something", 0.01, nothing, lambda r: r["verdict"] in NAMING, False),
    ]  # fmt: skip


def main() -> None:
    """Run or report."""
    arguments = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    arguments.add_argument("what", choices=("run", "report"))
    arguments.add_argument("--of", choices=("frame", "plate"), default="frame")
    arguments.add_argument("--cases", type=int, default=39)
    arguments.add_argument("--skip", type=int, default=0)
    arguments.add_argument("--folder", type=Path, default=ROOT / "results/generic")
    arguments.add_argument("--write", type=Path)
    given = arguments.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    file = given.folder / "cases.jsonl"
    if given.what == "report":
        report([json.loads(line) for line in file.read_text("utf-8").splitlines()], given.write, file)
        return
    code = digest_of(SOURCES)
    rows = map(json.loads, file.read_text("utf-8").splitlines() if file.exists() else ())
    done = {row["number"] for row in rows if row["code"] == code}
    with file.open("a", encoding="utf-8") as out:
        first = PLATES if given.of == "plate" else 0
        for number in range(first + given.skip, first + given.cases):
            if number in done:
                continue
            try:
                row = run(number, code)
            except Exception as fault:
                broke = {"error": repr(fault), "traceback": traceback.format_exc()}
                row = {"number": number, "code": code, "group": "failed", **broke}
            out.write(json.dumps(row) + "\n")
            out.flush()
            print({name: row.get(name) for name in PRINTED}, flush=True)


def report(rows: list[dict[str, Any]], write: Path | None, file: Path) -> None:
    """Rates with their one-sided 95 % bounds, then every case that is not right."""
    rows = [row for row in rows if row["code"] == rows[-1]["code"]]
    failed, rows = [r for r in rows if r["group"] == "failed"], [r for r in rows if r["group"] != "failed"]
    print(f"{len(rows)} cases, {len(failed)} broke; {min(r['candidates'] for r in rows)} to "
          f"{max(r['candidates'] for r in rows)} candidates")  # fmt: skip
    for rate in counts(rows):
        print(f"{rate.hidden}: {rate.verdict} in {rate.count} of {rate.n}, bound {100 * bound_of(rate):.0f} %")
    for r in rows:
        if r["outcome"] not in ("right", "nothing_detectable"):
            print(r["number"], r["scenario"], r["visible"], r["outcome"], r["verdict"], r["best"], r["credible"][:6])
    if write is not None:
        made = date.fromtimestamp(file.stat().st_mtime).isoformat()
        write_rates(counts(rows), write, rows[-1]["code"], made)


if __name__ == "__main__":
    main()
