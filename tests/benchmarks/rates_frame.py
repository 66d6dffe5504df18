"""A steel frame of three storeys and two bays, given as matrices, and its blind twins on a mesh three times finer.

Effects of the library change a few elements of the fitted mesh (351 degrees of freedom). In the twin (1,071) they are
made otherwise: masses are spread over a length, a cut section loses its mass too, a joint is a flexible hinge, a
support gives way less sideways, a brace has a mass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import scipy.sparse as sp
from rates_outcome import Measured
from rates_scenarios import MAGNITUDES, OWN, Scenario
from rates_subject import ROOT
from rates_world import World

import calib
from calib.correlation.basis import BasisRequirements
from calib.correlation.modal.problem import ModalProblem
from calib.hypotheses.library import effects_basis
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.explanation import Explanation
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition
from calib.structure.effects.perturbations import perturbations
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.study.loading import module_of

blind = module_of(ROOT / "studies/blind_twin.py")
SPANS, HEIGHT, STOREYS = (5.0, 6.5), 3.5, 3
STEEL, DENSITY = 2.1e11, 7850.0
SECTIONS = {"column": (78e-4, 5.7e-5), "beam": (54e-4, 8.4e-5)}
"""Area, m^2, and second moment of area, m^4."""
FLOORS = {1: 1500.0, 2: 1300.0, 3: 900.0}
"""Mass on the beams of each floor, kg/m."""
GROUND = (4e8, 6e8, 3e7)
"""Springs of a support: sideways and upright, N/m, and against rotation, Nm/rad."""
LOSS, GROUND_LOSS = 2e-4, 1e-3
"""Damping of members and of supports over their stiffness, s, where the frame is damped."""
COARSE, FINE = 8, 24
"""Elements of each member."""
LIKE = 0.47
"""Mean square of the bending moment over the first element of a clamped beam under its weight, the end's as unity: a
hinge at the end with so much of the element's flexibility has about the same effect."""
MODES = 8
COUNT = 12


class Frame:
    """Mesh with so many elements of each member, and its element matrices."""

    def __init__(
        self, elements: int, spans: Sequence[float] = SPANS, height: float = HEIGHT, storeys: int = STOREYS
    ) -> None:
        self.elements, self.spans = elements, spans
        across = np.cumsum([0.0, *spans])
        self.points = [(float(x), 0.0, height * s) for s in range(storeys + 1) for x in across]
        self.members: dict[str, list[int]] = {}
        width = len(across)
        for s in range(storeys):
            for c in range(width):
                self._member(f"column {s + 1}{c + 1}", s * width + c, (s + 1) * width + c)
            for b in range(len(spans)):
                self._member(f"beam {s + 1}{b + 1}", (s + 1) * width + b, (s + 1) * width + b + 1)
        self.size = 3 * len(self.points)

    def _member(self, name: str, first: int, last: int) -> None:
        ends = np.array([self.points[first], self.points[last]])
        inner = [tuple(ends[0] + (ends[1] - ends[0]) * k / self.elements) for k in range(1, self.elements)]
        nodes = range(len(self.points), len(self.points) + len(inner))
        self.points += [(float(x), float(y), float(z)) for x, y, z in inner]
        self.members[name] = [first, *nodes, last]

    def node(self, member: str, along: float) -> int:
        """The node of a member nearest to a fraction of its length."""
        return self.members[member][round(along * self.elements)]

    def _element(self, member: str, k: int) -> tuple[np.ndarray, np.ndarray, float, tuple[float, float]]:
        """Degrees of freedom, their rotation to the element's own, its length and section."""
        nodes = self.members[member][k : k + 2]
        a, b = (np.array(self.points[n]) for n in nodes)
        length = float(np.linalg.norm(b - a))
        c, s = (b - a)[[0, 2]] / length
        own = np.array([[c, s, 0], [-s, c, 0], [0, 0, -1]])  # a rotation about y turns x away from z
        return np.concatenate([3 * n + np.arange(3) for n in nodes]), np.kron(np.eye(2), own), length, SECTIONS[
            member.split()[0]
        ]  # fmt: skip

    def stiffness(self, member: str, low: float = 0.0, high: float = 1.0, hinge: float = 0.0) -> sp.csr_array:
        """Of a member between two fractions of its length; ``hinge`` is the flexibility of its first end, rad/Nm."""
        rows = []
        for k in range(round(low * self.elements), round(high * self.elements)):
            dofs, turn, n, (area, inertia) = self._element(member, k)
            axial, bend = STEEL * area / n, STEEL * inertia / n**3
            own = np.zeros((6, 6))
            own[np.ix_([0, 3], [0, 3])] = axial * np.array([[1, -1], [-1, 1]])
            own[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = bend * np.array([
                [12, 6 * n, -12, 6 * n], [6 * n, 4 * n**2, -6 * n, 2 * n**2],
                [-12, -6 * n, 12, -6 * n], [6 * n, 2 * n**2, -6 * n, 4 * n**2],
            ])  # fmt: skip
            if hinge and k == 0:
                own = own - np.outer(own[2], own[2]) * hinge / (1 + hinge * own[2, 2])
            rows.append((dofs, turn.T @ own @ turn))
        return self._sum(rows)

    def mass(self, member: str, per_metre: float, low: float = 0.0, high: float = 1.0) -> sp.csr_array:
        """Consistent mass along a member between two fractions of its length, of 1 or so many kg/m."""
        rows = []
        for k in range(round(low * self.elements), round(high * self.elements)):
            dofs, turn, n, _ = self._element(member, k)
            own = np.zeros((6, 6))
            own[np.ix_([0, 3], [0, 3])] = np.array([[140, 70], [70, 140]])
            own[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = np.array([
                [156, 22 * n, 54, -13 * n], [22 * n, 4 * n**2, 13 * n, -3 * n**2],
                [54, 13 * n, 156, -22 * n], [-13 * n, -3 * n**2, -22 * n, 4 * n**2],
            ])  # fmt: skip
            rows.append((dofs, turn.T @ own @ turn * per_metre * n / 420))
        return self._sum(rows)

    def lump(self, node: int) -> sp.csr_array:
        """1 kg at a node."""
        return self._sum([(3 * node + np.arange(2), np.eye(2))])

    def spread(self, member: str, along: float, over: float) -> sp.csr_array:
        """1 kg spread evenly over a length in metres about a fraction of a member."""
        at = np.array(self.points[self.node(member, along)])
        near = [n for n in self.members[member] if np.linalg.norm(np.array(self.points[n]) - at) <= over / 2 + 1e-9]
        return sp.csr_array(sum(self.lump(n) for n in near) / len(near))

    def support(self, column: int, factors: Sequence[float] = (1.0, 1.0, 1.0)) -> sp.csr_array:
        """Ground springs of one column, counted from 1."""
        return self._sum([(3 * (column - 1) + np.arange(3), np.diag(np.multiply(GROUND, factors)))])

    def brace(self) -> sp.csr_array:
        """Axial spring of 1 N/m from the foot of the first column to the top of the second."""
        a, b = 0, len(SPANS) + 2
        along = np.subtract(self.points[b], self.points[a])[[0, 2]]
        row = np.concatenate([-along, along]) / np.linalg.norm(along)
        return self._sum([(np.array([3 * a, 3 * a + 1, 3 * b, 3 * b + 1]), np.outer(row, row))])

    def _sum(self, rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> sp.csr_array:
        i = np.concatenate([np.repeat(d, len(d)) for d, _ in rows])
        j = np.concatenate([np.tile(d, len(d)) for d, _ in rows])
        out = sp.csr_array(sp.coo_array((np.concatenate([m.ravel() for _, m in rows]), (i, j)), (self.size, self.size)))
        out.eliminate_zeros()
        return out

    def model(
        self, stiffness: Mapping[str, Any] | None = None, mass: Mapping[str, Any] | None = None, damped: bool = False
    ) -> StructuralModel:
        """The frame as matrices with its parameters; further terms have the multiplier that is given with them.

        A damped one loses energy in its members and in the ground under its supports.
        """
        own: dict[str, Any] = {m: (self.stiffness(m), f"E_{m.split()[0]}s") for m in self.members}
        damping: dict[str, Any] = {}
        if damped:
            damping = {f"loss of {m}": (LOSS * matrix, "loss") for m, (matrix, _) in own.items()}
        supports = {f"support {c + 1}": self.support(c + 1) for c in range(len(self.spans) + 1)}
        own |= {name: (matrix, "k_ground") for name, matrix in supports.items()}
        if damped:
            damping |= {f"loss of {name}": (GROUND_LOSS * matrix, "c_ground") for name, matrix in supports.items()}
        masses: dict[str, Any] = {}
        for member in self.members:
            kind, level = member.split()[0], int(member.split()[1][0])
            masses[f"steel of {member}"] = self.mass(member, DENSITY * SECTIONS[kind][0])
            if kind == "beam":
                masses[f"floor on {member}"] = (self.mass(member, FLOORS[level]), "m_floors")
        dofs = pd.DataFrame([
            (n + 1, d, *self.points[n]) for n in range(len(self.points)) for d in ("x", "z", "ry")
        ], columns=["node", "direction", "x", "y", "z"])  # fmt: skip
        priors = {"E_columns": 0.08, "E_beams": 0.08, "m_floors": 0.08, "k_ground": 0.25}
        priors |= {"loss": 0.2, "c_ground": 0.25} if damped else {}
        parameters = [Parameter(name, 1.0, 0.5, 1.8, "-", prior_sd=sd) for name, sd in priors.items()]
        return calib.StructuralModel.from_matrices(
            own | dict(stiffness or {}), masses | dict(mass or {}), damping or None, dofs=dofs, parameters=parameters,
            name="frame",
        )  # fmt: skip


@cache
def frame(elements: int) -> Frame:
    """One mesh."""
    return Frame(elements)


def of(model: StructuralModel) -> Frame:
    """The mesh of a model."""
    return next(frame(n) for n in (COARSE, FINE) if frame(n).size == model.n_dof)


Terms = list[tuple[str, sp.csr_array, float, str]]
"""Kind, matrix, factor of the magnitude, parameter that scales it or nothing."""


def _effect(
    name: str, title: str, size: float, limits: tuple[float, float], terms: Callable[[Frame], Terms], unit: str = "-"
) -> Effect:
    def build(model: StructuralModel) -> Addition:
        made: dict[str, list[Term]] = {"stiffness": [], "mass": []}
        for k, (kind, matrix, factor, scaled) in enumerate(terms(of(model))):
            powers = ((name, 1.0), *([(scaled, 1.0)] if scaled else []))
            made[kind].append(Term(f"{name} {k}", matrix, Monomial(factor, powers)))
        return Addition(stiffness=tuple(made["stiffness"]), mass=tuple(made["mass"]))

    magnitude = Parameter(name, 0.0, *limits, unit, prior_sd=size)
    return Effect(name, title, "It is as drawn.", "Compare with the drawings.", magnitude, build)


def frame_effects() -> tuple[Effect, ...]:
    """The library."""
    return (
        _effect("mass_moved", "tank on the other roof beam", 120.0, (-300.0, 300.0), lambda f: [
            ("mass", f.lump(f.node("beam 31", 0.5)), 1.0, ""), ("mass", f.lump(f.node("beam 32", 0.5)), -1.0, ""),
        ], "kg"),
        _effect("machine", "unweighed machine on the second floor", 250.0, (0.0, 3000.0), lambda f: [
            ("mass", f.lump(f.node("beam 22", 0.25)), 1.0, ""),
        ], "kg"),
        _effect("cut_column", "corroded foot of the last column", 0.4, (0.0, 0.9), lambda f: [
            ("stiffness", f.stiffness("column 13", 0.0, 0.25), -1.0, "E_columns"),
        ]),
        _effect("cut_beam", "section cut for a pipe in a beam", 0.4, (0.0, 0.9), lambda f: [
            ("stiffness", f.stiffness("beam 11", 0.375, 0.625), -1.0, "E_beams"),
        ]),
        _effect("soft_joint", "loose joint of a beam", 0.4, (0.0, 0.95), lambda f: [
            ("stiffness", f.stiffness("beam 21", 0.0, 0.125), -1.0, "E_beams"),
        ]),
        _effect("support_gives_way", "scoured support of the first column", 0.6, (0.0, 0.97), lambda f: [
            ("stiffness", f.support(1), -1.0, "k_ground"),
        ]),
        _effect("brace", "infill wall in the first bay", 4e5, (0.0, 2e7), lambda f: [
            ("stiffness", f.brace(), 1.0, ""),
        ], "N/m"),
    )  # fmt: skip


def outside_effects() -> tuple[Effect, ...]:
    """Designs that are in no library."""
    return (
        _effect("soft_storey", "soft second storey", 0.15, (0.0, 0.9), lambda f: [
            ("stiffness", f.stiffness(f"column 2{c}"), -1.0, "E_columns") for c in (1, 2, 3)
        ]),
        _effect("heavy_bay", "heavier floors of the second bay", 0.15, (0.0, 2.0), lambda f: [
            ("mass", f.mass(f"beam {s}2", FLOORS[s]), 1.0, "m_floors") for s in (1, 2, 3)
        ]),
    )  # fmt: skip


def built(names: Sequence[str], values: Mapping[str, float], damped: bool = False) -> StructuralModel:
    """The finer mesh with effects of the library as they really are."""
    f, stiffness, mass = frame(FINE), dict[str, Any](), dict[str, Any]()
    for name in names:
        x = values[name]
        if name == "mass_moved":
            mass[name] = x * (f.spread("beam 31", 0.5, 0.9) - f.spread("beam 32", 0.5, 0.9))
        elif name == "machine":
            mass[name] = x * f.spread("beam 22", 0.25, 0.9)
        elif name in ("cut_column", "cut_beam"):
            member, low, high = ("column 13", 0.0, 6 / 24) if name == "cut_column" else ("beam 11", 9 / 24, 15 / 24)
            kind = member.split()[0]
            stiffness[name] = (-x * f.stiffness(member, low, high), f"E_{kind}s")
            mass[name] = -x * f.mass(member, DENSITY * SECTIONS[kind][0], low, high)
        elif name == "soft_joint":
            flexible = LIKE * SPANS[0] / COARSE / (STEEL * SECTIONS["beam"][1]) * x / (1 - x)
            change = f.stiffness("beam 21", 0, 1 / FINE, flexible) - f.stiffness("beam 21", 0, 1 / FINE)
            stiffness[name] = (change, "E_beams")
        elif name == "support_gives_way":
            stiffness[name] = (-x * f.support(1, (0.9, 1.0, 1.0)), "k_ground")
        else:
            stiffness[name] = x * f.brace()
            mass[name] = 1e-4 * x * (f.lump(0) + f.lump(len(SPANS) + 2))
    return f.model(stiffness, mass, damped)


def layout() -> tuple[Sensor, ...]:
    """Sensors: floors and columns sideways, beams upright, the roof beams both ways."""
    f, out = frame(COARSE), []
    for member in f.members:
        if member.startswith("column"):
            places = [("x", 0.5), ("x", 1.0)]
        else:
            places = [("z", 0.25), ("z", 0.5), *([("x", 0.5)] if member[5] == "3" else [])]
        for direction, along in places:
            node = f.node(member, along)
            out.append(Sensor(node + 1, direction, f.points[node]))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class FrameSpecimen(blind.Specimen):  # type: ignore[misc, name-defined]
    """As `blind_twin.Specimen`, without a study."""

    @cached_property
    def model(self) -> StructuralModel:
        """The fitted mesh."""
        model: StructuralModel = self.base
        return model

    def problem(self, whole: MeasuredModes, held_out: bool = True) -> ModalProblem:
        """Problem of the base model and all measured modes."""
        return ModalProblem(self.model, whole, {}, COUNT)


@cache
def specimen() -> FrameSpecimen:
    """What is measured."""
    base, names = frame(COARSE).model(), tuple(f"F{k}" for k in range(1, MODES + 1))
    nominal = base.sensor_rows(layout()) @ base.modes(base.space.values, MODES).shapes
    return FrameSpecimen(
        file=ROOT, base=base, fine=frame(FINE).model(), library=frame_effects(), outside=outside_effects(),
        modes=names, layout=layout(), nominal=nominal, built=built,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class FrameWorld(World):
    """Model, twin and library; nothing is held out."""

    @cached_property
    def maker(self) -> Any:
        """What draws and measures."""
        return SimpleNamespace(blind=blind)

    @cached_property
    def specimen(self) -> Any:
        """The frame."""
        return specimen()

    @property
    def library(self) -> tuple[Effect, ...]:
        """What the model may lack."""
        library: tuple[Effect, ...] = self.specimen.library
        return library

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """What may be hidden."""
        out = [Scenario("nothing", "nothing", each=8)]
        out += [Scenario(f"{e.name}/{s}", "single", (e.name,), f) for s, f in MAGNITUDES.items() for e in self.library]
        out += [
            Scenario(f"outside/{n}/{s}", "outside", (n,), MAGNITUDES[s]) for s in "ML" for n in self.subject.outside
        ]
        out += [Scenario(f"without/{e.name}/M", "removed", (e.name,), 1.0, True) for e in self.library]
        return tuple(out)

    @cached_property
    def libraries(self) -> dict[str, Variants]:
        """The model with its library on a reduced basis."""
        rng = np.random.default_rng(1)
        names, modes, shapes = self.specimen.seen(self.model, 0, self.space.values, rng)
        problem = self.specimen.problem(self.specimen.noiseless(names, modes, shapes))
        tested = perturbations(self.model, self.specimen.layout[::4], self.space.values, 1.0)
        folder = self.folder / "own"
        folder.mkdir(parents=True, exist_ok=True)
        wanted = BasisRequirements.of(problem, 1e-4, 1)
        basis = effects_basis(self.model, self.space, self.library, tested, wanted, folder)
        return {OWN: Variants(self.model, self.library, tuple(p.effect for p in tested), basis)}

    def _held_out(self, found: Explanation, hypotheses: Any, measured: Measured) -> dict[str, Any]:
        return {}
