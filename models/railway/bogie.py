"""The bogie: frame, wheelsets, axle boxes, primary suspension and connecting rods.

Axes: x longitudinal, y up, z transverse (left positive), origin at the bogie's centre on top of rail. The case study
gives the lengths of girders and crossbars and the kinematic constraints; sections, places and masses are lost there and
one coherent set is assumed (see `ASSUMPTIONS`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.structure import Assumption
from models.fem.discrete import PointMass, Spring, rod
from models.fem.member import Member, Point, Suppression, Tie
from models.fem.section import Section

UX, UY, UZ, RX, RY, RZ = range(6)

GIRDER_Y, GIRDER_Z, GIRDER_TIP = 0.62, 1.05, 2.005
CROSSBAR_X, CROSSBAR_TIP = 1.115, 1.315
AXLE_X, AXLE_Y, AXLE_END, WHEEL_Z = 1.45, 0.43, 1.05, 0.87
SPRING_SEAT = 0.28
BOX_UP, BOX_DOWN = 0.20, 0.17
ROD_UPPER_Y, ROD_LOWER_X, ROD_LOWER_Y = 0.70, 0.75, 0.36
SEAT_X, OUTWARD = 0.30, 0.25

GIRDER_CENTRE = Section(2.0e-2, 1.0e-4, 1.1e-4, 4.0e-5, shear_coefficient=0.5)
GIRDER_END = Section(1.0e-2, 6.0e-5, 6.0e-5, 3.0e-5, shear_coefficient=0.5)
CROSSBAR = Section(1.05e-2, 9.0e-5, 9.0e-5, 3.0e-5, shear_coefficient=0.5)
AXLE = Section(2.01e-2, 3.22e-5, 3.22e-5, 6.43e-5, shear_coefficient=0.9)
BOX_ARM = Section(6.0e-3, 6.0e-5, 6.0e-5, 8.0e-5, density=0.0)

K_PRIMARY_LATERAL = 300e3
K_GUIDANCE = 20e6

AXES = "x to the front, y up, z to the left"
"""What the words of `SIDES` and `ENDS` mean in coordinates."""
SIDES = (("left", 1.0), ("right", -1.0))
ENDS = (("front", 1.0), ("rear", -1.0))

LOST = "lost in the case study; one coherent plausible set whose modes fall near the surviving figures"
"""Reason given for a number that no surviving figure gives."""

_TABLE_2 = "Table 2 is lost; one coherent plausible set whose modes fall near the surviving figures"

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("wheelbase", "2.90", "m", LOST),
    Assumption("girder axis: height, transverse place", "0.62, +-1.05", "m", LOST),
    Assumption("crossbars: longitudinal place", "+-1.115", "m", "follows from the printed total lengths by symmetry"),
    Assumption("axle axis height, axle ends, wheel contacts", "0.43, +-1.05, +-0.87", "m", LOST),
    Assumption("axle-box arms: spring seats, upper rod, lower rod", "+-0.28, 0.20, 0.17", "m", LOST),
    Assumption("rod brackets on the girder: upper (x, y), lower (x, y)", "2.005, 0.70; 0.75, 0.36", "m", LOST),
    Assumption("girder centre: A, Iv, Il, J", "2.0e-2, 1.1e-4, 1.0e-4, 4.0e-5", "m2, m4", _TABLE_2),
    Assumption("girder ends: A, Iv, Il, J", "1.0e-2, 6.0e-5, 6.0e-5, 3.0e-5", "m2, m4", _TABLE_2),
    Assumption("crossbar: A, Iv, Il, J", "1.05e-2, 9.0e-5, 9.0e-5, 3.0e-5", "m2, m4", _TABLE_2),
    Assumption("axle: A, I, J (diameter 0.16 m)", "2.01e-2, 3.22e-5, 6.43e-5", "m2, m4", _TABLE_2),
    Assumption("axle-box arm: A, I, J; massless", "6.0e-3, 6.0e-5, 8.0e-5", "m2, m4", LOST),
    Assumption("steel: E, nu, density", "210 GPa, 0.3, 7850 kg/m3", "-", "usual values"),
    Assumption("shear coefficients: frame, axle and arms", "0.5, 0.9, 5/6", "-", "thin-walled box, round, solid"),
    Assumption("wheel: mass, Jx = Jy, Jz", "330, 24, 48", "kg, kgm2", LOST),
    Assumption("axle box: mass, J", "80, 1.5", "kg, kgm2", LOST),
    Assumption("gear case on the front axle: mass, Jx, Jy, Jz", "300, 15, 120, 30", "kg, kgm2", "one driven axle"),
    Assumption("crossbar tips (4)", "40", "kg", LOST),
    Assumption("girder middle (2), 0.25 m outwards", "220", "kg", LOST),
    Assumption("secondary spring seats (4), x +-0.30, 0.25 m outwards", "150", "kg", LOST),
    Assumption("primary spring, lateral part in x and z", "300", "kN/m", LOST),
    Assumption("axle-box guidance in z", "20", "MN/m", LOST),
    Assumption("mid-axle: transverse motion and spin held", "-", "-", "rail contact; spin would be a zero mode"),
)  # fmt: skip
"""Every number of the bogie that is an engineering assumption."""


@dataclass(frozen=True)
class Bogie:
    """Parts of one bogie for a frame.

    Attributes
    ----------
    members, ties, suppressions
        Beams and their connections.
    masses : tuple of PointMass
    springs : mapping from str to tuple of Spring
        ``primary``, ``rod_upper``, ``rod_lower``, ``rail`` carry parameters; ``suspension_fixed`` holds constant ones.
    dampers : tuple of Spring
        The primary dampers.
    """

    members: tuple[Member, ...]
    ties: tuple[Tie, ...]
    suppressions: tuple[Suppression, ...]
    masses: tuple[PointMass, ...]
    springs: dict[str, tuple[Spring, ...]]
    dampers: tuple[Spring, ...]


def bogie(size: float, distributed: bool = False) -> Bogie:
    """The bogie without secondary suspension and bolsters.

    Parameters
    ----------
    size : float
        Largest element length, m.
    distributed : bool
        Distribute point masses over the length of the components they represent.
    """
    return Bogie(
        _members(size), _ties(), _suppressions(), _masses(distributed), _springs(), _dampers(),
    )  # fmt: skip


def box_name(end: str, side: str) -> str:
    """Body name of one axle box."""
    return f"box_{end}_{side}"


def _members(size: float) -> tuple[Member, ...]:
    members = []
    for side, z in SIDES:
        z = z * GIRDER_Z
        marks = {0.0, SEAT_X, SPRING_SEAT, ROD_LOWER_X}
        outer = {AXLE_X - SPRING_SEAT, AXLE_X, AXLE_X + SPRING_SEAT}
        members.append(
            Member(
                "frame", "girder_centre", GIRDER_CENTRE, (-CROSSBAR_X, GIRDER_Y, z), (CROSSBAR_X, GIRDER_Y, z), size,
                through=tuple((s * x, GIRDER_Y, z) for x in sorted(marks) for s in (-1, 1)), part=f"girder {side}",
            )
        )  # fmt: skip
        for end, s in ENDS:
            members.append(
                Member(
                    "frame", "girder_end", GIRDER_END, (s * CROSSBAR_X, GIRDER_Y, z), (s * GIRDER_TIP, GIRDER_Y, z),
                    size, through=tuple((s * x, GIRDER_Y, z) for x in sorted(outer)), part=f"girder end {end} {side}",
                )
            )  # fmt: skip
    for end, s in ENDS:
        members.append(
            Member(
                "frame", "crossbar", CROSSBAR, (s * CROSSBAR_X, GIRDER_Y, -CROSSBAR_TIP),
                (s * CROSSBAR_X, GIRDER_Y, CROSSBAR_TIP), size,
                through=((s * CROSSBAR_X, GIRDER_Y, -GIRDER_Z), (s * CROSSBAR_X, GIRDER_Y, GIRDER_Z)),
                part=f"crossbar {end}",
            )
        )  # fmt: skip
    for end, s in ENDS:
        x = s * AXLE_X
        members.append(
            Member(
                f"axle_{end}", "axle", AXLE, (x, AXLE_Y, -AXLE_END), (x, AXLE_Y, AXLE_END), size,
                through=((x, AXLE_Y, -WHEEL_Z), (x, AXLE_Y, 0.0), (x, AXLE_Y, WHEEL_Z)), part=f"axle {end}",
            )
        )  # fmt: skip
        for side, t in SIDES:
            centre: Point = (x, AXLE_Y, t * AXLE_END)
            tips = (
                ((x - SPRING_SEAT, AXLE_Y, t * AXLE_END), (0.0, 1.0, 0.0)),
                ((x + SPRING_SEAT, AXLE_Y, t * AXLE_END), (0.0, 1.0, 0.0)),
                ((x, AXLE_Y + BOX_UP, t * AXLE_END), (1.0, 0.0, 0.0)),
                ((x, AXLE_Y - BOX_DOWN, t * AXLE_END), (1.0, 0.0, 0.0)),
            )
            body, part = box_name(end, side), f"axle box {end} {side}"
            members += [Member(body, "box", BOX_ARM, centre, tip, size, up=up, part=part) for tip, up in tips]
    return tuple(members)


def _ties() -> tuple[Tie, ...]:
    """The axle box rotates freely about the axle and shares every other motion of the axle's end."""
    return tuple(
        Tie(f"axle_{end}", box_name(end, side), (s * AXLE_X, AXLE_Y, t * AXLE_END), (UX, UY, UZ, RX, RY))
        for end, s in ENDS
        for side, t in SIDES
    )


def _suppressions() -> tuple[Suppression, ...]:
    """Girders keep vertical translation and rotations about x and z (case study); see ASSUMPTIONS for mid-axle."""
    middle = tuple(Suppression((UZ, RZ), body=f"axle_{end}", point=(s * AXLE_X, AXLE_Y, 0.0)) for end, s in ENDS)
    return (Suppression((UX, UZ, RY), groups=("girder_centre", "girder_end")), *middle)


def _masses(distributed: bool) -> tuple[PointMass, ...]:
    def spread(axis: int, half: float) -> tuple[Point, ...]:
        if not distributed:
            return ((0.0, 0.0, 0.0),)
        offsets = np.zeros((7, 3))
        offsets[:, axis] = np.linspace(-half, half, 7)
        return tuple((float(a), float(b), float(c)) for a, b, c in offsets)

    masses = []
    for end, s in ENDS:
        x = s * AXLE_X
        for side, t in SIDES:
            masses += [
                PointMass(
                    (f"axle_{end}", (x, AXLE_Y, t * WHEEL_Z)), 330.0, (24.0, 24.0, 48.0), spread(2, 0.09),
                    f"wheel {end} {side}",
                ),
                PointMass(
                    (box_name(end, side), (x, AXLE_Y, t * AXLE_END)), 80.0, (1.5, 1.5, 1.5),
                    name=f"axle box {end} {side}",
                ),
                PointMass(
                    ("crossbar", (s * CROSSBAR_X, GIRDER_Y, t * CROSSBAR_TIP)), 40.0, spread=spread(2, 0.04),
                    name=f"crossbar tip {end} {side}",
                ),
                PointMass(
                    ("frame", (s * SEAT_X, GIRDER_Y, t * (GIRDER_Z + OUTWARD))), 150.0, spread=spread(0, 0.10),
                    name=f"spring seat {end} {side}",
                ),
            ]  # fmt: skip
    masses += [
        PointMass(
            ("frame", (0.0, GIRDER_Y, t * (GIRDER_Z + OUTWARD))), 220.0, spread=spread(0, 0.10),
            name=f"girder middle {side}",
        )
        for side, t in SIDES
    ]  # fmt: skip
    gear_case: Point = (AXLE_X, AXLE_Y, 0.0)
    masses.append(PointMass(("axle_front", gear_case), 300.0, (15.0, 120.0, 30.0), spread(2, 0.12), "gear case"))
    return tuple(masses)


def _springs() -> dict[str, tuple[Spring, ...]]:
    primary, fixed, upper, lower, rail = [], [], [], [], []
    for end, s in ENDS:
        x = s * AXLE_X
        for side, t in SIDES:
            box, z, corner = box_name(end, side), t * GIRDER_Z, f"{end} {side}"
            for seat in (x - SPRING_SEAT, x + SPRING_SEAT):
                above, name = (seat, GIRDER_Y, z), f"primary springs {corner}"
                primary.append(Spring((box, (seat, AXLE_Y, z)), ("frame", above), (0, 1, 0), name=name))
                meet: Point = (seat, (AXLE_Y + GIRDER_Y) / 2, z)
                for direction in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
                    lateral = f"primary springs {corner}, {'x' if direction[0] else 'z'}"
                    fixed.append(Spring((box, meet), ("frame", meet), direction, False, K_PRIMARY_LATERAL, lateral))
            centre: Point = (x, (AXLE_Y + GIRDER_Y) / 2, z)
            guidance = f"guidance {corner}"
            fixed.append(Spring((box, centre), ("frame", centre), (0, 0, 1), weight=K_GUIDANCE, name=guidance))
            high, low = (s * GIRDER_TIP, ROD_UPPER_Y, z), (s * ROD_LOWER_X, ROD_LOWER_Y, z)
            upper.append(rod((box, (x, AXLE_Y + BOX_UP, z)), ("frame", high), name=f"upper rod {corner}"))
            lower.append(rod((box, (x, AXLE_Y - BOX_DOWN, z)), ("frame", low), name=f"lower rod {corner}"))
            wheel = (x, AXLE_Y, t * WHEEL_Z)
            rail.append(Spring((f"axle_{end}", wheel), None, (0, 1, 0), name=f"wheel-rail contact {corner}"))
    return {
        "primary": tuple(primary),
        "suspension_fixed": tuple(fixed),
        "rod_upper": tuple(upper),
        "rod_lower": tuple(lower),
        "rail": tuple(rail),
    }


def _dampers() -> tuple[Spring, ...]:
    return tuple(
        Spring(
            (box_name(end, side), (s * AXLE_X, AXLE_Y, t * GIRDER_Z)),
            ("frame", (s * AXLE_X, GIRDER_Y, t * GIRDER_Z)),
            (0, 1, 0),
            name=f"primary damper {end} {side}",
        )
        for end, s in ENDS
        for side, t in SIDES
    )
