"""The bogie on its rig with effects really built into the mesh, one of them or several together.

Masses move or are added, sections are reduced, bushes and bodies are added; no term of the library is used. Every
function takes the effect's parameters and tells what is built otherwise. Nothing here is a candidate of any analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any
from unittest import mock

import numpy as np

from calib import StructuralModel
from models.fem.discrete import PointMass, Spring, rod
from models.fem.member import Member, Point, Tie
from models.fem.section import Section
from models.railway import rig
from models.railway.bogie import (
    AXLE,
    AXLE_X,
    AXLE_Y,
    BOX_ARM,
    CROSSBAR,
    CROSSBAR_X,
    ENDS,
    GIRDER_END,
    GIRDER_TIP,
    GIRDER_Y,
    GIRDER_Z,
    RX,
    RY,
    SIDES,
    UX,
    UY,
    UZ,
    WHEEL_Z,
    Bogie,
    bogie,
)
from models.railway.effects_frame import BRAKE_UNIT_RATIO, BRAKE_UNIT_Z, JOINT_LENGTH
from models.railway.parameters import BOGIE, RIG

Values = Mapping[str, float]

FINE = 0.0375
RIGID, RIGID_TURN = 2e10, 2e9
"""Stiffness in N/m and Nm/rad of connections between two bodies where the real parts are one."""
ADOPTED = {p.name: p.value for p in (*BOGIE, *RIG)}
C_PRIMARY = ADOPTED["c_primary"] * 1e3


def adopted(v: Values, name: str) -> float:
    """A parameter of the structure that is built, of which the weights of parts added to its group are shares."""
    return v.get(name, ADOPTED[name])


@dataclass(frozen=True)
class Otherwise:
    """What is built otherwise.

    Attributes
    ----------
    change : callable
        Changes the parts of the bogie.
    of_rig : mapping from str to object
        Names of the rig's module that are replaced.
    """

    change: Callable[[Bogie], Bogie] = lambda bogie: bogie
    of_rig: Mapping[str, object] = field(default_factory=dict)


def rebuilt(*parts: Otherwise, element_size: float = FINE, distributed: bool = False) -> StructuralModel:
    """The bogie on its rig with parts built otherwise, by default with half the element size of the fitted mesh."""

    def changed(size: float, spread: bool) -> Bogie:
        whole = bogie(size, spread)
        for part in parts:
            whole = part.change(whole)
        return whole

    with ExitStack() as stack:
        for name, value in {"bogie": changed, **{n: v for part in parts for n, v in part.of_rig.items()}}.items():
            stack.enter_context(mock.patch.object(rig, name, value))
        return rig.bogie_on_rig(element_size=element_size, distributed=distributed)


# -- rig ---------------------------------------------------------------------------------------------------------------


def flexible_actuators(v: Values) -> Otherwise:
    """Supports that are as soft as oil column and frame in series."""
    return Otherwise(of_rig={"K_SUPPORT": 1 / (1 / rig.K_SUPPORT + v["actuator_flexibility"] * 1e-9)})


def wide_blocks(v: Values) -> Otherwise:
    """Every elastic block stands on two lines as far apart as its resistance to tilting tells."""
    half = float(np.sqrt(v["block_tilt"] / adopted(v, "K_block")))
    block, contact, restraint = rig._rig_springs()
    wide = []
    for spring in block:
        assert spring.other is not None
        for s in (half, -half):
            (x, y, z), (a, b, c) = spring.end[1], spring.other[1]
            end, other = (spring.end[0], (x, y, z + s)), (spring.other[0], (a, b, c + s))
            wide.append(replace(spring, end=end, other=other, weight=spring.weight / 2))
    return Otherwise(of_rig={"_rig_springs": lambda: (tuple(wide), contact, restraint)})


def blocks_with_dampers(v: Values) -> Otherwise:
    """Dampers within the elastic blocks."""
    weight = v["block_damping"] / adopted(v, "c_primary")
    dampers = [replace(s, weight=s.weight * weight) for s in rig._rig_springs()[0]]
    return Otherwise(lambda b: replace(b, dampers=(*b.dampers, *dampers)))


# -- frame -------------------------------------------------------------------------------------------------------------


def reduced(section: Section, share: float) -> Section:
    """A section that has lost a share of what resists bending and torsion."""
    left = 1 - share
    return replace(section, i_y=left * section.i_y, i_z=left * section.i_z, torsion=left * section.torsion)


def recut(member: Member, cuts: Sequence[tuple[float, Section]]) -> list[Member]:
    """A straight member cut into stretches, each given by where it ends (m from the start) and its section."""
    start, along = np.array(member.start), np.subtract(member.end, member.start)
    length, out, at = float(np.linalg.norm(along)), [], 0.0
    for to, section in cuts:
        one, other = (tuple(float(c) for c in start + along * s / length) for s in (at, to))
        through = [p for p in member.through if at < np.linalg.norm(np.subtract(p, start)) < to]
        out.append(replace(member, start=one, end=other, section=section, through=tuple(through)))
        at = to
    return out


def thin_joints(v: Values) -> Otherwise:
    """Crossbars of a reduced section next to the girders."""
    thin = reduced(CROSSBAR, v["crossbar_joint"])

    def change(b: Bogie) -> Bogie:
        members: list[Member] = []
        for m in b.members:
            if m.group == "crossbar":
                tip = abs(m.start[2])
                stretches = [
                    (tip - GIRDER_Z, CROSSBAR), (tip - GIRDER_Z + JOINT_LENGTH, thin),
                    (tip + GIRDER_Z - JOINT_LENGTH, CROSSBAR), (tip + GIRDER_Z, thin), (2 * tip, CROSSBAR),
                ]  # fmt: skip
                members += recut(m, stretches)
            else:
                members.append(m)
        return replace(b, members=tuple(members))

    return Otherwise(change)


def thin_girder_ends(v: Values) -> Otherwise:
    """Girder ends of a reduced section between crossbar and axle."""
    stretches = [
        (AXLE_X - CROSSBAR_X, reduced(GIRDER_END, v["girder_end"])), (GIRDER_TIP - CROSSBAR_X, GIRDER_END)
    ]  # fmt: skip

    def change(b: Bogie) -> Bogie:
        members = [n for m in b.members for n in (recut(m, stretches) if m.group == "girder_end" else [m])]
        return replace(b, members=tuple(members))

    return Otherwise(change)


def loaded_crossbar(v: Values) -> Otherwise:
    """A mass on the crossbar's middle."""
    mass = PointMass(("crossbar", (CROSSBAR_X, GIRDER_Y, 0.0)), v["crossbar_mass"])
    return Otherwise(lambda b: replace(b, masses=(*b.masses, mass)))


def stub(body: str, at: Point) -> Member:
    """A massless rigid body that stands on one place."""
    return Member(body, "box", BOX_ARM, at, (at[0] + 0.05, at[1], at[2]), 1.0)


def held(
    body: str, other: str, at: Point, free: Sequence[int] = (), shift: float = RIGID, turn: float = RIGID_TURN
) -> list[Spring]:
    """Springs that hold two bodies together at a place, but for the directions that are free."""
    units = np.eye(3).tolist()
    return [
        Spring((body, at), (other, at), tuple(units[d % 3]), d >= 3, turn if d >= 3 else shift)
        for d in range(6) if d not in free
    ]  # fmt: skip


def damped(spring: Spring, constant: float) -> Spring:
    """The same as a damper, of a constant in Ns/m while the model's own dampers are at their nominal values."""
    return replace(spring, weight=constant / C_PRIMARY)


def with_parts(
    b: Bogie, members: Sequence[Member] = (), springs: Sequence[Spring] = (), dampers: Sequence[Spring] = ()
) -> Bogie:
    """The bogie with more members, springs and dampers."""
    fixed = b.springs | {"suspension_fixed": (*b.springs["suspension_fixed"], *springs)}
    return replace(b, members=(*b.members, *members), springs=fixed, dampers=(*b.dampers, *dampers))


def hung_brake_unit(v: Values) -> Otherwise:
    """A body of its own on bushes that give upright."""
    at: Point = (CROSSBAR_X, GIRDER_Y, BRAKE_UNIT_Z)
    mass, omega = v["brake_unit"], 2 * np.pi * v["brake_unit_freq"]
    bush = Spring(("unit", at), ("crossbar", at), (0, 1, 0), weight=mass * omega**2)
    loss = damped(bush, 2 * BRAKE_UNIT_RATIO * omega * mass)

    def change(b: Bogie) -> Bogie:
        b = with_parts(b, [stub("unit", at)], [*held("unit", "crossbar", at, (UY,)), bush], [loss])
        return replace(b, masses=(*b.masses, PointMass(("unit", at), mass)))

    return Otherwise(change)


# -- suspension --------------------------------------------------------------------------------------------------------


def scaled(springs: Sequence[Spring], factors: Mapping[str, float]) -> tuple[Spring, ...]:
    """Springs or dampers, some of them stronger or weaker by name."""
    assert set(factors) <= {s.name for s in springs}
    return tuple(replace(s, weight=factors.get(s.name, 1.0) * s.weight) for s in springs)


def stiffer(group: str, factors: Callable[[Values], Mapping[str, float]], v: Values) -> Otherwise:
    """Some springs of a group stiffer or softer."""
    return Otherwise(lambda b: replace(b, springs=b.springs | {group: scaled(b.springs[group], factors(v))}))


def leaking_damper(v: Values) -> Otherwise:
    """One damper weaker."""
    lost = {"primary damper front left": 1 - v["weak_damper"]}
    return Otherwise(lambda b: replace(b, dampers=scaled(b.dampers, lost)))


def damper_eyes(v: Values) -> Otherwise:
    """An eye between each damper and its box, on a bush."""
    bush = 1 / (v["damper_mount"] * 1e-9)

    def change(b: Bogie) -> Bogie:
        members, springs, dampers = [], [], []
        for k, damper in enumerate(b.dampers):
            (box, at), body = damper.end, f"eye_{k}"
            members.append(stub(body, at))
            springs += [*held(body, box, at, (UY,)), Spring((body, at), (box, at), (0, 1, 0), weight=bush)]
            dampers.append(replace(damper, end=(body, at)))
        return with_parts(replace(b, dampers=tuple(dampers)), members, springs)

    return Otherwise(change)


def turning_wheels(v: Values) -> Otherwise:
    """Rims that turn freely on the axles and roll on the rails without slip."""

    def change(b: Bogie) -> Bogie:
        members, ties, masses, grip = [], [], [], []
        for end, s in ENDS:
            for side, t in SIDES:
                at: Point = (s * AXLE_X, AXLE_Y, t * WHEEL_Z)
                body, axle = f"rim_{end}_{side}", f"axle_{end}"
                members.append(stub(body, at))
                ties.append(Tie(axle, body, at, (UX, UY, UZ, RX, RY)))
                (wheel,) = (m for m in b.masses if m.name == f"wheel {end} {side}")
                polar = v["rolling_wheels"] * wheel.inertia[2]
                masses.append(PointMass((body, at), 0.0, (0.0, 0.0, polar)))
                grip.append(Spring((body, (at[0], 0.0, at[2])), None, (1, 0, 0), weight=RIGID))
        b = with_parts(b, members, grip)
        return replace(b, ties=(*b.ties, *ties), masses=(*b.masses, *masses))

    return Otherwise(change)


def moved_gear_case(v: Values) -> Otherwise:
    """The gear case elsewhere on its axle."""

    def change(b: Bogie) -> Bogie:
        (case,) = (m for m in b.masses if m.name == "gear case")
        body, (x, y, z) = case.at
        moved = replace(case, at=(body, (x, y, z + 1e-3 * v["gear_case_offset"])))
        return replace(b, masses=tuple(moved if m is case else m for m in b.masses))

    return Otherwise(change)


def linked_gear_case(v: Values) -> Otherwise:
    """A link as a spring between an arm of the gear case and the crossbar."""
    low, high = (CROSSBAR_X, AXLE_Y, 0.0), (CROSSBAR_X, GIRDER_Y, 0.0)
    link = rod(("axle_front", low), ("crossbar", high), v["torque_link"] * 1e3)
    return Otherwise(lambda b: with_parts(b, springs=[link]))


def rods_with_dampers(v: Values) -> Otherwise:
    """Dampers along the connecting rods."""

    def change(b: Bogie) -> Bogie:
        rods = (*b.springs["rod_upper"], *b.springs["rod_lower"])
        weight = v["rod_damping"] / adopted(v, "c_primary")
        return with_parts(b, dampers=[replace(s, weight=weight) for s in rods])

    return Otherwise(change)


def rods_as_bars(v: Values) -> Otherwise:
    """Connecting rods as bars of their own between bushes that resist turning."""
    bush = v["stiff_bushes"] * 1e3
    across = replace(AXLE, density=0.0, area=1.0, i_y=1e-2, i_z=1e-2, torsion=1e-2, shear_coefficient=10.0)

    def change(b: Bogie) -> Bogie:
        members, springs, axial = [], [], {}
        for group in ("rod_upper", "rod_lower"):
            along = []
            for s in b.springs[group]:
                assert s.other is not None
                (box, one), (bracket, other), body = s.end, s.other, f"bar of {s.name}"
                members.append(Member(body, "box", across, one, other, 1.0))
                springs += held(body, box, one, (5,))
                d = np.subtract(other, one) / np.linalg.norm(np.subtract(other, one))
                square = (float(-d[1]), float(d[0]), 0.0)
                springs.append(Spring((body, other), (bracket, other), square, weight=RIGID))
                springs += [
                    Spring((body, at), (part, at), (0, 0, 1), True, bush) for at, part in ((one, box), (other, bracket))
                ]
                along.append(replace(s, end=(body, other), other=(bracket, other)))
            axial[group] = tuple(along)
        return with_parts(replace(b, springs=b.springs | axial), members, springs)

    return Otherwise(change)


BOGIES: dict[str, Callable[[Values], Otherwise]] = {
    "actuator_flexibility": flexible_actuators,
    "block_tilt": wide_blocks,
    "block_damping": blocks_with_dampers,
    "crossbar_joint": thin_joints,
    "girder_end": thin_girder_ends,
    "crossbar_mass": loaded_crossbar,
    "brake_unit": hung_brake_unit,
    "primary_uneven": partial(stiffer, "primary", lambda v: {"primary springs front left": 1 + v["primary_uneven"]}),
    "weak_damper": leaking_damper,
    "damper_mount": damper_eyes,
    "wheel_contact": partial(
        stiffer,
        "rail",
        lambda v: {f"wheel-rail contact front {side}": 1 + s * v["wheel_contact"] for side, s in SIDES},
    ),
    "rolling_wheels": turning_wheels,
    "gear_case_offset": moved_gear_case,
    "torque_link": linked_gear_case,
    "rod_damping": rods_with_dampers,
    "stiff_bushes": rods_as_bars,
}
"""What is built otherwise for every effect of the library, by name."""


def built(names: Sequence[str], values: Values, **mesh: Any) -> StructuralModel:
    """The bogie on its rig with some effects really built into it; ``mesh`` is that of `rebuilt`."""
    return rebuilt(*(BOGIES[name](values) for name in names), **mesh)
