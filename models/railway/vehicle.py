"""The whole vehicle: the car body on its two bogies (second phase of the case study)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import scipy.sparse as sp

from calib import InputError, ParameterSpace, StructuralModel
from calib.structure import AffineMatrix, Assumption, DofMap, Monomial, Part, Term, parameter
from models.fem.discrete import FrameLocator, PointMass, Spring, mass_matrix, spring_matrix
from models.fem.parts import (
    Reduced,
    beam_parts,
    mass_parts,
    shell_coefficients,
    shell_parts,
    shell_terms,
    spring_parts,
)
from models.fem.structure import Structure
from models.railway.bogie import ASSUMPTIONS as BOGIE_ASSUMPTIONS
from models.railway.bogie import AXES
from models.railway.bolsters import ASSUMPTIONS as BOLSTER_ASSUMPTIONS
from models.railway.car_body import ASSUMPTIONS as BODY_ASSUMPTIONS
from models.railway.car_body import BODY, E_ALUMINIUM, RHO_ALUMINIUM, SECTIONS, SHEETS, car_body
from models.railway.car_lines import ASSUMPTIONS as LINE_ASSUMPTIONS
from models.railway.car_lines import BOGIE_X
from models.railway.equipment import ASSUMPTIONS as EQUIPMENT_ASSUMPTIONS
from models.railway.equipment import SEAT_DAMPING, SEAT_STIFFNESS, couplers, equipment, passenger_seats
from models.railway.parameters import BOGIE, CAR, OTHERS
from models.railway.running_gear import running_gear

BOGIES = (("front", BOGIE_X), ("rear", -BOGIE_X))
_SIZE = 0.15
_REFINEMENTS = (1, 2, 4, 8, 16)

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("mass of the further equipment that m_base, m_walls and m_cover share", f"{OTHERS:g}", "kg",
               "lost; brings the car to the train's mean of about 50 t"),
    Assumption("shares of the further equipment", "uniform over panels less openings; none on end walls", "-",
               "the case study spreads them uniformly"),
    Assumption("structural damping", "none", "-", "the case study names dampers only"),
)  # fmt: skip
"""Assumptions of the assembly itself."""

_RULES = {
    group: {"modulus": "E_aluminium", "thickness": f"t_{kind}", "rmi": f"RMI_{kind}", "density": "rho_aluminium"}
    for group, kind in (("base", "base"), ("walls", "walls"), ("cover", "cover"), ("ends", "walls"))
}
"""Parameters that replace values of every group of panels, as `shell_coefficients` names them."""

_SHARES = {"m_base": "base", "m_walls": "walls", "m_cover": "cover"}

_ADDED = {
    "m_girder_centre": "girder_centre",
    "m_girder_ends": "girder_end",
    "m_crossbar": "crossbar",
    "m_axle": "axle",
}

_NO_PARAMETER = ("suspension_fixed", "floor_fixed", "seats")

_STEEL = ("girder_centre", "girder_end", "crossbar", "axle", "box", "load_bolster", "tilting_bolster", "bracket")


@dataclass(frozen=True)
class Assembly:
    """Parts of the vehicle before matrices are assembled.

    Attributes
    ----------
    structure : Structure
    masses : tuple of PointMass
    springs, dampers : mapping from str to tuple of Spring
        By their parameter; ``suspension_fixed``, ``floor_fixed`` and ``seats`` have none. Only sprung seats have an
        entry.
    """

    structure: Structure
    masses: tuple[PointMass, ...]
    springs: dict[str, tuple[Spring, ...]]
    dampers: dict[str, tuple[Spring, ...]]


SeatMounting = Literal["sprung", "rigid"]
"""Mounting of the seats on the floor."""


def assembly(refine: int = 1, distributed: bool = False, seats: SeatMounting = "sprung") -> Assembly:
    """Geometry, springs and masses; for the arguments see `vehicle`."""
    if refine not in _REFINEMENTS:
        raise InputError(f"refine is {refine}", place="vehicle", remedy="give 1, 2, 4, 8 or 16: edges are halved")
    if seats not in get_args(SeatMounting):
        raise InputError(f"seats are {seats!r}", place="vehicle", remedy='give "sprung" or "rigid"')
    body, fitted, seated = car_body(refine.bit_length() - 1), equipment(), passenger_seats(seats == "sprung")
    front, rear = gears = tuple(running_gear(name, x, _SIZE / refine, distributed) for name, x in BOGIES)

    def both(key: str) -> tuple[Spring, ...]:
        return front.springs[key] + rear.springs[key]

    structure = Structure(
        members=(*body.members, *(m for g in gears for m in g.members)),
        ties=tuple(t for g in gears for t in g.ties),
        suppressions=(*(s for g in gears for s in g.suppressions), *seated.suppressions),
        particles=seated.particles,
        panels=body.panels,
        rbe3s=(*fitted.rbe3s, *seated.rbe3s, *couplers(), *(s for g in gears for s in g.rbe3s)),
    )
    springs = {
        "K_primary": both("primary"),
        "K_rod_upper": both("rod_upper"),
        "K_rod_lower": both("rod_lower"),
        "K_rail": both("rail"),
        "K_secondary_front": front.springs["secondary"],
        "K_secondary_rear": rear.springs["secondary"],
        "K_rod_tilting": both("rod_tilting"),
        "suspension_fixed": both("suspension_fixed"),
        "floor_fixed": both("floor_fixed"),
    }
    dampers = {
        "c_primary": front.dampers["primary"] + rear.dampers["primary"],
        "c_secondary": front.dampers["secondary"] + rear.dampers["secondary"],
        "c_yaw": front.dampers["yaw"] + rear.dampers["yaw"],
    }
    if seated.springs:
        springs["seats"] = dampers["seats"] = seated.springs
    masses = (*fitted.masses, *seated.masses, *(m for g in gears for m in g.masses))
    return Assembly(structure, masses, springs, dampers)


def vehicle(refine: int = 1, distributed: bool = False, seats: SeatMounting = "sprung") -> StructuralModel:
    """The vehicle as a structural model of about 1800 nodes.

    Parameters
    ----------
    refine : int
        1, 2, 4, ...: number of pieces of every edge of shells and frames; attachments, openings and panel edges keep
        their coordinates. Beams of the bogies are refined as well.
    distributed : bool
        Consistent instead of lumped added masses of the bogies, and their point masses distributed over the length they
        represent.
    seats : {"sprung", "rigid"}
        Each seat is an oscillator of one degree of freedom, or a mass on the floor without a spring. Equipment is
        always rigid on its feet.

    Returns
    -------
    StructuralModel
        Parameters of `models.railway.parameters` (Tables 1 and 3); clusters ``<substructure>.<x|y|z|r>`` with the
        substructures car, front_frame, front_bolsters, front_wheelsets, the same of the rear bogie, and seats
        where they are sprung.
    """
    whole = assembly(refine, distributed, seats)
    structure = whole.structure
    dofs = structure.dof_map()

    def reduced(full: sp.csr_array) -> sp.csr_array:
        return sp.csr_array(dofs.expansion.T @ full @ dofs.expansion)

    stiffness, mass, pieces = _body(structure, reduced)
    mass += _gear_mass(structure, reduced, distributed)
    mass.append(Term("points", reduced(mass_matrix(structure, whole.masses))))
    pieces += mass_parts(structure, reduced, whole.masses)
    damping: list[Term] = []
    for name, springs in whole.springs.items():
        coefficient = _coefficient(name, SEAT_STIFFNESS)
        stiffness.append(Term(name, reduced(spring_matrix(structure, springs)), coefficient))
        pieces += spring_parts(structure, reduced, springs, coefficient)
    for name, dampers in whole.dampers.items():
        coefficient = _coefficient(name, SEAT_DAMPING)
        damping.append(Term(name, reduced(spring_matrix(structure, dampers)), coefficient))
        pieces += spring_parts(structure, reduced, dampers, coefficient, "damping")
    n = dofs.n_dof
    return StructuralModel(
        name="vehicle",
        space=ParameterSpace(CAR + BOGIE),
        stiffness=AffineMatrix(n, tuple(stiffness)),
        damping=AffineMatrix(n, tuple(damping)),
        mass=AffineMatrix(n, tuple(mass)),
        mesh=replace(structure.mesh(), axes=AXES),
        dofs=dofs,
        clusters=_clusters(structure, dofs),
        locator=FrameLocator(structure, dofs.expansion),
        assumptions=(
            LINE_ASSUMPTIONS + BODY_ASSUMPTIONS + EQUIPMENT_ASSUMPTIONS + BOLSTER_ASSUMPTIONS + BOGIE_ASSUMPTIONS
            + ASSUMPTIONS
        ),
        sensor_tolerance=0.05,
        parts=tuple(pieces),
    )  # fmt: skip


def _body(structure: Structure, reduced: Reduced) -> tuple[list[Term], list[Term], list[Part]]:
    """Stiffness, mass and parts of all walls and beams."""
    young, density = parameter("E_aluminium", 1 / E_ALUMINIUM), parameter("rho_aluminium", 1 / RHO_ALUMINIUM)
    rules = {group: shell_coefficients(SHEETS[group], **rule) for group, rule in _RULES.items()}
    strips = rules["walls"].bending
    frames, frames_mass = structure.beams(SECTIONS)
    steel, steel_mass = structure.beams(_of_both(_STEEL))
    stiffness = [
        Term("frames", reduced(frames), young),
        Term("pillars", reduced(structure.beams(("pillar_wall",))[0]), strips),
        Term("steel", reduced(steel)),
    ]
    mass = [Term("frames", reduced(frames_mass), density), Term("steel", reduced(steel_mass))]
    for group, rule in _RULES.items():
        stiff, heavy = shell_terms(structure, reduced, group, **rule)
        stiffness += stiff
        mass += heavy
    pieces = beam_parts(structure, reduced, dict.fromkeys(SECTIONS, young) | {"pillar_wall": strips})
    pieces += shell_parts(structure, reduced, rules)
    for name, group in _SHARES.items():
        spread, share = reduced(structure.area_mass((group,))), parameter(name, OTHERS / structure.area((group,)))
        mass.append(Term(name, spread, share))
        x, y, z = (float(c) for c in structure.points[structure.group_nodes((group,))].mean(axis=0))
        pieces.append(Part(f"further equipment of the {group}", "mass", spread, share, (x, y, z)))
    return stiffness, mass, pieces


def _gear_mass(structure: Structure, reduced: Reduced, distributed: bool) -> list[Term]:
    return [
        Term(name, reduced(structure.added_mass(_of_both((group,)), distributed)), parameter(name))
        for name, group in _ADDED.items()
    ]


def _coefficient(name: str, of_seats: float) -> Monomial:
    """The parameter itself; springs without one have their stiffness as a weight, except for the seats."""
    if name in _NO_PARAMETER:
        return Monomial(of_seats if name == "seats" else 1.0)
    return parameter(name)


def _of_both(groups: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{name}_{group}" for name, _ in BOGIES for group in groups)


def _substructure(body: str) -> str:
    if body == BODY:
        return "car"
    bogie, _, part = body.partition("_")
    if bogie == "seat":
        return "seats"
    kind = "frame" if part == "frame" else "bolsters" if part.endswith("bolster") else "wheelsets"
    return f"{bogie}_{kind}"


def _clusters(structure: Structure, dofs: DofMap) -> dict[str, np.ndarray]:
    """Degrees of freedom by substructure and direction."""
    owner = np.array([_substructure(body) for body in structure.bodies])[dofs.node]
    clusters = {}
    for name in dict.fromkeys(owner.tolist()):
        for letter, mask in (*(("xyz"[d], dofs.direction == d) for d in range(3)), ("r", dofs.direction >= 3)):
            index = np.flatnonzero((owner == name) & mask)
            if len(index):
                clusters[f"{name}.{letter}"] = index
    return clusters
