"""The vehicle, rebuilt with each of its effects modelled in the mesh itself.

Masses move or are added, sections are reduced, bushes and bodies are added; no term of the library is used. Every
function takes the effect's parameters and the number of pieces of every edge.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise, product

import numpy as np
import pytest
import scipy.sparse as sp

from calib.structure.affine import AffineMatrix, Term
from calib.structure.attach import GRAVITY
from calib.structure.model import StructuralModel
from models.fem.discrete import PointMass, Spring
from models.fem.member import Member, Particle, Point, Suppression
from models.fem.rbe3 import Rbe3
from models.railway.bogie import BOX_ARM, ENDS, RX, RY, RZ, SIDES, UX, UY
from models.railway.bolsters import FLOOR_Y, LOAD_BOLSTER_TIP, LOAD_BOLSTER_Y, PAD_Z
from models.railway.car_lines import BASE_Z, BOGIE_X, HALF_LENGTH, HEADER, PILLARS, SILL, WALL
from models.railway.equipment import COUPLER_Y, UNDER_FLOOR
from models.railway.parameters import BOGIE, CAR
from models.railway.vehicle import BOGIES, Assembly, vehicle
from models.railway.vehicle_effects_body import DAMPING_FREQ
from models.railway.vehicle_effects_equipment import SEAT_RATIO

Values = Mapping[str, float]
Change = Callable[[Assembly], Assembly]

RIGID, RIGID_TURN = 1e10, 1e9
"""Stiffness in N/m and Nm/rad of connections between two bodies where the real parts are one."""
SI = {p.name: p.value * 1e3 for p in (*CAR, *BOGIE) if p.unit in ("kN/m", "kNs/m")}
MODULE = sys.modules["models.railway.vehicle"]


def rebuilt(change: Change | None = None, refine: int = 1, distributed: bool = False) -> StructuralModel:
    """The vehicle on rigid seats with its parts changed."""
    whole = MODULE.assembly
    with pytest.MonkeyPatch.context() as patch:
        if change is not None:
            patch.setattr(MODULE, "assembly", lambda *given: change(whole(*given)))
        return vehicle(refine, distributed, seats="rigid")


def with_matrix(model: StructuralModel, kind: str, name: str, full: sp.csr_array) -> StructuralModel:
    """The model with a constant matrix over all nodal motions added to its K, C or M."""
    own: AffineMatrix = getattr(model, kind)
    term = Term(name, sp.csr_array(model.dofs.expansion.T @ full @ model.dofs.expansion))
    return replace(model, **{kind: AffineMatrix(own.n_dof, (*own.terms, term), own.selected)})


def with_springs(whole: Assembly, springs: Sequence[Spring] = (), dampers: Sequence[Spring] = ()) -> Assembly:
    """More springs, and dampers whose weight is in Ns/m while the yaw dampers are at their nominal values."""
    fixed = whole.springs | {"floor_fixed": (*whole.springs["floor_fixed"], *springs)}
    more = tuple(replace(d, weight=d.weight / SI["c_yaw"]) for d in dampers)
    return replace(whole, springs=fixed, dampers=whole.dampers | {"c_yaw": (*whole.dampers["c_yaw"], *more)})


def with_bodies(whole: Assembly, members: Sequence[Member] = (), masses: Sequence[PointMass] = ()) -> Assembly:
    """More members and masses."""
    structure = replace(whole.structure, members=(*whole.structure.members, *members))
    return replace(whole, structure=structure, masses=(*whole.masses, *masses))


def stub(body: str, at: Point) -> Member:
    """A massless rigid body that stands on one place."""
    return Member(body, "front_box", BOX_ARM, at, (at[0] + 0.05, at[1], at[2]), 1.0)


def held(body: str, other: str, at: Point, free: Sequence[int] = ()) -> list[Spring]:
    """Springs that hold two bodies together at a place, but for the directions that are free."""
    units = np.eye(3).tolist()
    return [
        Spring((body, at), (other, at), tuple(units[d % 3]), d >= 3, RIGID_TURN if d >= 3 else RIGID)
        for d in range(6)
        if d not in free
    ]


# -- the body ----------------------------------------------------------------------------------------------------------


def thin_edges(v: Values, refine: int) -> StructuralModel:
    """Floor and cross-beams that bend more easily across between their outermost lines."""
    share, (inner, outer) = v["floor_joint"], BASE_Z[-2:]

    def change(whole: Assembly) -> Assembly:
        members: list[Member] = []
        for m in whole.structure.members:
            if m.group in ("floor_beam", "bolster_beam"):
                members += cut(m, [-inner, inner], lambda middle: abs(middle[2]) > inner, share)
            else:
                members.append(m)
        return replace(whole, structure=replace(whole.structure, members=tuple(members)))

    model = rebuilt(change, refine)
    structure = model.locator.frame
    middle = structure.points[structure.corners].mean(axis=1)
    strip = (np.abs(middle[:, 2]) > inner) & (np.abs(middle[:, 2]) < outer)
    bending = []
    for left in (1.0, 1 - share):
        panels = []
        for p in structure.panels:
            if p.group == "base":
                sheet = replace(p.sheet, young_modulus_across=left * p.sheet.young_modulus)
                p = replace(p, along=(1.0, 0.0, 0.0), sheet=sheet)
            panels.append(p)
        bending.append(replace(structure, panels=tuple(panels)).shells(("base",), strip).bending)
    full, soft = bending
    return with_matrix(model, "stiffness", "edges", soft - full)


def cut(m: Member, at: Sequence[float], inside: Callable[[np.ndarray], bool], share: float) -> list[Member]:
    """A member across the car cut at some z; stretches inside lose a share of their bending upright."""
    marks = sorted({*at, m.start[2], m.end[2]}, reverse=m.start[2] > m.end[2])
    out = []
    for a, b in pairwise(marks):
        start, end = (m.start[0], m.start[1], a), (m.end[0], m.end[1], b)
        through = tuple(p for p in m.through if min(a, b) < p[2] - 1e-9 < p[2] + 1e-9 < max(a, b))
        section = m.section
        if inside(np.add(start, end) / 2):
            section = replace(section, i_z=(1 - share) * section.i_z)
        out.append(replace(m, start=start, end=end, through=through, section=section))
    return out


def thin_pillars(v: Values, refine: int) -> StructuralModel:
    """Window pillars of a reduced section."""
    low, high = WALL[SILL][0], WALL[HEADER][0]

    def change(whole: Assembly) -> Assembly:
        members = []
        for m in whole.structure.members:
            beside = low - 1e-6 < min(m.start[1], m.end[1]) and max(m.start[1], m.end[1]) < high + 1e-6
            if m.group in ("pillar", "post") and beside and min(abs(m.start[0] - x) for x in PILLARS) < 1e-6:
                m = replace(m, section=replace(m.section, i_z=(1 - v["window_corners"]) * m.section.i_z))
            members.append(m)
        return replace(whole, structure=replace(whole.structure, members=tuple(members)))

    return rebuilt(change, refine)


def glazed(v: Values, refine: int) -> StructuralModel:
    """Panes as pairs of diagonal rods that are as stiff in shear."""

    def change(whole: Assembly) -> Assembly:
        rods = []
        for a, b in pairwise(PILLARS):
            for _, s in SIDES:
                (low_y, low_z), (high_y, high_z) = WALL[SILL], WALL[HEADER]
                width, height = b - a, float(np.hypot(high_y - low_y, high_z - low_z))
                square = width**2 + height**2
                weight = v["window_glass"] * 1e6 * square / (2 * width * height)
                for one, other in ((a, b), (b, a)):
                    low, high = (one, low_y, s * low_z), (other, high_y, s * high_z)
                    along = tuple(float(c) for c in np.subtract(high, low))
                    rods.append(Spring(("walls", low), ("walls", high), along, weight=weight))
        return with_springs(whole, rods)

    return rebuilt(change, refine)


def lossy_body(v: Values, refine: int) -> StructuralModel:
    """A body whose aluminium loses energy in proportion to its strain energy and frequency."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    aluminium = {m.group for m in structure.members if m.section.young_modulus == 70e9}
    full = structure.beams(aluminium)[0] + structure.shells().stiffness
    return with_matrix(model, "damping", "loss", 2 * v["body_damping"] * 1e-2 / (2 * np.pi * DAMPING_FREQ) * full)


def coupled(v: Values, refine: int) -> StructuralModel:
    """The rear coupler on springs to the ground."""
    at = ("coupler_rear", (-HALF_LENGTH, COUPLER_Y, 0.0))
    springs = [Spring(at, None, d, weight=v["neighbour_coupling"] * 1e3) for d in ((1, 0, 0), (0, 1, 0))]
    return rebuilt(lambda whole: with_springs(whole, springs), refine)


def top_heavy(v: Values, refine: int) -> StructuralModel:
    """A body whose weight works at every pillar on the square of the roll there, that of the floor's two edges."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    rows = []
    for x in PILLARS:
        left, right = (structure.motion((x, FLOOR_Y, s * BASE_Z[-1]), "base")[0][UY] for _, s in SIDES)
        rows.append((left - right) / (2 * BASE_Z[-1]))
    stacked = sp.csr_array(np.array(rows))
    return with_matrix(model, "stiffness", "weight", -v["tipping"] * 1e3 / len(PILLARS) * (stacked.T @ stacked))


# -- equipment ---------------------------------------------------------------------------------------------------------


UNIT_BOXES = {"traction converter": (2.4, 0.7, 1.8), "front roof unit": (2.4, 0.3, 1.8)}
"""Sides along x, y and z in m of hung units, even boxes."""


def hung(
    v: Values, refine: int, name: str, item: str, box: Sequence[float] | None = None, distributed: bool = False
) -> StructuralModel:
    """A unit as a rigid body that shifts and turns, each of its feet on a spring and a damper in every direction.

    Mounts stand on what carries them foot by foot, so that they also hold it against warping.
    """
    omega = float(np.sqrt(GRAVITY / (v[name] * 1e-3)))
    # An even box turns as eight corners do of one that is smaller by the root of 3.
    corners = np.array(list(product((0.5, -0.5), repeat=3))) * (box or UNIT_BOXES[item]) / np.sqrt(3)

    def change(whole: Assembly) -> Assembly:
        (old,) = (m for m in whole.masses if m.name == item)
        (rbe3,) = (s for s in whole.structure.rbe3s if s.name == item)
        centre = (old.at[1][0], old.at[1][1] - v[f"{name}_drop"], old.at[1][2])
        mass = PointMass(("unit", centre), old.mass, spread=tuple(map(tuple, corners.tolist())), name=item)
        springs, dampers = [], []
        for foot in rbe3.feet:
            for d, unit in enumerate(np.eye(3).tolist()):
                part = old.mass / len(rbe3.feet) * (1.0 if d == UY else v[f"{name}_sideways"])
                mount = Spring(("unit", foot), (rbe3.on, foot), tuple(unit))
                springs.append(replace(mount, weight=omega**2 * part))
                dampers.append(replace(mount, weight=2 * v[f"{name}_damping"] * omega * part))
        structure = replace(whole.structure, particles=(*whole.structure.particles, Particle("unit", "unit", centre)))
        masses = tuple(mass if m is old else m for m in whole.masses)
        return with_springs(replace(whole, structure=structure, masses=masses), springs, dampers)

    return rebuilt(change, refine, distributed)


def sprung_seats(v: Values, refine: int) -> StructuralModel:
    """Sixty oscillators: bodies of their own on mounts that give upright."""
    omega, units = float(np.sqrt(GRAVITY / (v["soft_seats"] * 1e-3))), np.eye(3).tolist()

    def change(whole: Assembly) -> Assembly:
        bodies, masses, springs, dampers = [], [], [], []
        for k, m in enumerate(whole.masses):
            if not m.name.startswith("seats"):
                masses.append(m)
                continue
            body = f"seat_{k}"
            bodies.append(Particle(body, "let go", m.at[1]))
            masses.append(replace(m, at=(body, m.at[1])))
            for d, unit in enumerate(units):
                mount = Spring((body, m.at[1]), m.at, tuple(unit))
                springs.append(replace(mount, weight=omega**2 * m.mass if d == UY else RIGID))
                dampers += [replace(mount, weight=2 * SEAT_RATIO * omega * m.mass)] if d == UY else []
        structure = replace(
            whole.structure,
            particles=(*whole.structure.particles, *bodies),
            suppressions=(*whole.structure.suppressions, Suppression((RX, RY, RZ), groups=("let go",))),
        )
        return with_springs(replace(whole, structure=structure, masses=tuple(masses)), springs, dampers)

    return rebuilt(change, refine)


def moved_equipment(v: Values, refine: int) -> StructuralModel:
    """Everything under the floor on feet elsewhere on the cross-beams."""
    shift, under = v["equipment_offset"] * 1e-3, {item.name for item in UNDER_FLOOR}

    def aside(p: Point) -> Point:
        return (p[0], p[1], p[2] + shift)

    def change(whole: Assembly) -> Assembly:
        rbe3s = tuple(
            Rbe3(s.name, "floor_beam", tuple(aside(f) for f in s.feet)) if s.name in under else s
            for s in whole.structure.rbe3s
        )
        masses = tuple(replace(m, at=(m.at[0], aside(m.at[1]))) if m.name in under else m for m in whole.masses)
        return replace(whole, structure=replace(whole.structure, rbe3s=rbe3s), masses=masses)

    return rebuilt(change, refine)


# -- suspension --------------------------------------------------------------------------------------------------------


def anti_roll_bars(v: Values, refine: int) -> StructuralModel:
    """Two levers on one axis, one on both ends of the bolster and one below it on the frame, joined by a bar."""

    def change(whole: Assembly) -> Assembly:
        springs, members = [], []
        for bogie, x in BOGIES:
            at: Point = (x, LOAD_BOLSTER_Y, 0.0)
            levers = []
            for part in ("frame", "load_bolster"):
                lever, on = f"{bogie}_lever of {part}", f"{bogie}_{part}"
                levers.append(lever)
                members.append(stub(lever, at))
                springs += held(lever, on, at, (UY, RX))
                for _, s in SIDES:
                    end: Point = (x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP)
                    springs.append(Spring((lever, end), (on, end), (0, 1, 0), weight=RIGID))
            one, other = ((lever, at) for lever in levers)
            springs.append(Spring(one, other, (1, 0, 0), True, v["anti_roll_bar"] * 1e6))
        return with_bodies(with_springs(whole, springs), members)

    return rebuilt(change, refine)


def scaled(kind: str, factors: Callable[[Values], Mapping[str, float]], v: Values, refine: int) -> StructuralModel:
    """Springs or dampers, some of them stronger or weaker by name."""
    wanted = factors(v)

    def change(whole: Assembly) -> Assembly:
        own = getattr(whole, kind)
        names = {s.name for group in own.values() for s in group}
        assert set(wanted) <= names
        new = {
            group: tuple(replace(s, weight=wanted.get(s.name, 1.0) * s.weight) for s in some)
            for group, some in own.items()
        }
        return replace(whole, **{kind: new})

    return rebuilt(change, refine)


def air_springs(v: Values, refine: int) -> StructuralModel:
    """Bellows as a spring and an orifice in a row, with a piston between."""
    stiffness = v["air_spring"] * 1e3
    orifice = stiffness / (2 * np.pi * v["air_spring_freq"])

    def change(whole: Assembly) -> Assembly:
        members, springs, dampers = [], [], []
        for bogie, x in BOGIES:
            for side, s in SIDES:
                at: Point = (x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP)
                body = f"{bogie}_piston_{side}"
                members.append(stub(body, at))
                springs += held(body, f"{bogie}_frame", at, (UY,))
                springs.append(Spring((f"{bogie}_load_bolster", at), (body, at), (0, 1, 0), weight=stiffness))
                dampers.append(Spring((body, at), (f"{bogie}_frame", at), (0, 1, 0), weight=orifice))
        return with_bodies(with_springs(whole, springs, dampers), members)

    return rebuilt(change, refine)


def on_bushes(
    kind: str, keys: Sequence[str], chosen: Callable[[str], bool], flexibility: str, v: Values, refine: int
) -> StructuralModel:
    """Springs or dampers whose end sits in an eye on a bush that gives along them."""
    bush, units = 1 / (v[flexibility] * 1e-9), np.eye(3).tolist()

    def change(whole: Assembly) -> Assembly:
        members, springs, own = [], [], dict(getattr(whole, kind))
        for key in keys:
            new = []
            for k, s in enumerate(own[key]):
                if chosen(s.name):
                    (part, at), body = s.end, f"front_eye {key} {k}"
                    along = np.asarray(s.direction, dtype=float) / np.linalg.norm(s.direction)
                    square = np.linalg.svd(along[None])[2][1:]
                    members.append(stub(body, at))
                    springs += [Spring((body, at), (part, at), tuple(u), weight=RIGID) for u in square.tolist()]
                    springs += [Spring((body, at), (part, at), tuple(u), True, RIGID_TURN) for u in units]
                    springs.append(Spring((body, at), (part, at), tuple(along.tolist()), weight=bush))
                    s = replace(s, end=(body, at))
                new.append(s)
            own[key] = tuple(new)
        return with_bodies(with_springs(replace(whole, **{kind: own}), springs), members)

    return rebuilt(change, refine)


def lossy_pads(v: Values, refine: int) -> StructuralModel:
    """Dampers within the floor pads."""

    def change(whole: Assembly) -> Assembly:
        pads = [s for s in whole.springs["floor_fixed"] if "floor pad" in s.name]
        return with_springs(whole, dampers=[replace(s, weight=v["pad_damping"] * 1e3) for s in pads])

    return rebuilt(change, refine)


# -- bogies and track --------------------------------------------------------------------------------------------------


def soft_track(v: Values, refine: int) -> StructuralModel:
    """A massless rail under every wheel, on a bush to the ground."""
    bush = 1 / (v["track_compliance"] * 1e-9)

    def change(whole: Assembly) -> Assembly:
        members, springs, contacts = [], [], []
        units = np.eye(3).tolist()
        for k, s in enumerate(whole.springs["K_rail"]):
            (_, at), body = s.end, f"front_rail {k}"
            members.append(stub(body, at))
            springs += [Spring((body, at), None, tuple(units[d]), weight=RIGID) for d in (0, 2)]
            springs += [Spring((body, at), None, tuple(u), True, RIGID_TURN) for u in units]
            springs.append(Spring((body, at), None, (0, 1, 0), weight=bush))
            contacts.append(replace(s, other=(body, at)))
        whole = replace(whole, springs=whole.springs | {"K_rail": tuple(contacts)})
        return with_bodies(with_springs(whole, springs), members)

    return rebuilt(change, refine)


def loaded_bolster(v: Values, refine: int) -> StructuralModel:
    """A mass on the middle of the front load bolster."""
    mass = PointMass(("front_load_bolster", (BOGIE_X, LOAD_BOLSTER_Y, 0.0)), v["bolster_mass"])
    return rebuilt(lambda whole: with_bodies(whole, masses=[mass]), refine)


def tight_pivots(v: Values, refine: int) -> StructuralModel:
    """Springs lengthwise between the floor's pads and the ground that resist turning and nothing else on the whole."""
    model = rebuilt(refine=refine)
    structure = model.locator.frame
    rows = []
    for bogie, x in BOGIES:
        left, right = (structure.motion((x, FLOOR_Y, s * PAD_Z), f"{bogie}_floor_{side}")[0] for side, s in SIDES)
        rows.append((left[UX] - right[UX]) / (2 * PAD_Z))
    stacked = sp.csr_array(np.array(rows))
    return with_matrix(model, "stiffness", "pivots", v["pivot_yaw"] * 1e6 * (stacked.T @ stacked))


def _dampers(v: Values) -> dict[str, float]:
    return {
        f"{bogie} bogie, secondary damper {end} {side}": 1 + s * v["damper_asymmetry"]
        for bogie, _ in BOGIES for end, _ in ENDS for side, s in SIDES
    }  # fmt: skip


def _springs(v: Values) -> dict[str, float]:
    return {
        f"front bogie, secondary spring {end} {side}": 1 + s * v["secondary_asymmetry"]
        for end, _ in ENDS for side, s in SIDES
    }  # fmt: skip


def _pads(v: Values) -> dict[str, float]:
    return {f"{bogie} bogie, floor pad {end} left": 1 - v["soft_pads"] for bogie, _ in BOGIES for end, _ in ENDS}


VEHICLES: dict[str, Callable[[Values, int], StructuralModel]] = {
    "floor_joint": thin_edges,
    "window_corners": thin_pillars,
    "window_glass": glazed,
    "body_damping": lossy_body,
    "neighbour_coupling": coupled,
    "tipping": top_heavy,
    "hung_converter": partial(hung, name="hung_converter", item="traction converter"),
    "hung_roof_unit": partial(hung, name="hung_roof_unit", item="front roof unit"),
    "soft_seats": sprung_seats,
    "equipment_offset": moved_equipment,
    "anti_roll_bar": anti_roll_bars,
    "damper_asymmetry": partial(scaled, "dampers", _dampers),
    "secondary_asymmetry": partial(scaled, "springs", _springs),
    "air_spring": air_springs,
    "yaw_damper_mount": partial(on_bushes, "dampers", ("c_yaw",), lambda name: True, "yaw_damper_mount"),
    "soft_pads": partial(scaled, "springs", _pads),
    "pad_damping": lossy_pads,
    "track_compliance": soft_track,
    "rod_bushes": partial(
        on_bushes, "springs", ("K_rod_upper", "K_rod_lower"), lambda name: name.startswith("front"), "rod_bushes"
    ),
    "tilting_rod_bush": partial(
        on_bushes,
        "springs",
        ("K_rod_tilting",),
        lambda name: name == "front bogie, tilting rod left",
        "tilting_rod_bush",
    ),
    "bolster_mass": loaded_bolster,
    "pivot_yaw": tight_pivots,
}
"""The rebuilt vehicle of every effect by name."""
