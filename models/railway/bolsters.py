"""Connection of a bogie's frame to the floor: bolsters, secondary suspension, tilting rods, yaw dampers.

Axes and origin as in `models.railway.bogie`. The load bolster rests on the secondary springs, the tilting bolster
hangs above it on rods, and four pads carry the car's floor. The case study gives the stiffness and damping values and
the kinematic constraints; sections, places and masses are lost there and assumed (see `ASSUMPTIONS`).
"""

from __future__ import annotations

from dataclasses import dataclass

from calib.structure import Assumption
from models.fem.discrete import PointMass, Spring
from models.fem.member import Member, Point, Suppression
from models.fem.rbe3 import Rbe3
from models.fem.section import Section
from models.railway.bogie import GIRDER_Y, GIRDER_Z, LOST, RY, SEAT_X, SIDES, UX, UZ

FLOOR_Y = 1.15
FLOOR_X, FLOOR_Z = (-0.50, 0.0, 0.50), (0.70, 1.10)
"""Lines of the floor, from the bogie's centre, whose crossings carry the feet of the parts below."""

LOAD_BOLSTER_Y, LOAD_BOLSTER_TIP = 0.86, 1.17
TILTING_BOLSTER_Y, TILTING_BOLSTER_TIP = 1.04, 0.90
ROD_Z = 0.35
PAD_X, PAD_Z = 0.35, 0.90
BRACKET_X, BRACKET_TOP, YAW_FLOOR_X = 0.75, 1.02, -0.10

BOLSTER = Section(1.2e-2, 1.5e-4, 6.0e-5, 1.5e-4, shear_coefficient=0.5)
BRACKET = Section(6.0e-3, 6.0e-6, 6.0e-6, 1.0e-5, shear_coefficient=0.5)

K_PAD, K_TRACTION, K_LATERAL = 2.0e6, 100e6, 40e6

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("secondary springs and dampers (4 a bogie): x, z", "+-0.30, +-1.17", "m", LOST),
    Assumption("load bolster: height, half length", "0.86, 1.17", "m", LOST),
    Assumption("tilting bolster: height, half length", "1.04, 0.90", "m", LOST),
    Assumption("bolsters: A, Iv, Il, J", "1.2e-2, 6.0e-5, 1.5e-4, 1.5e-4", "m2, m4", LOST),
    Assumption("load bolster at z +-1.17, tilting bolster at z +-0.35: mass each", "60", "kg", LOST),
    Assumption("tilting rods: z", "+-0.35", "m", LOST),
    Assumption("floor pads (4 a bogie): x, z, stiffness", "+-0.35, +-0.90, 2.0", "m, MN/m", LOST),
    Assumption("traction and lateral links (2 a bogie): z, stiffness", "+-0.90, 100, 40", "m, MN/m",
               "stiff, so that sway and lengthwise motion stay out of the band of the measured modes"),
    Assumption("yaw dampers: height, z, x of bracket and floor end", "1.02, +-1.05, 0.75, -0.10", "m",
               LOST),
    Assumption("yaw-damper bracket: height, A, I, J", "0.40, 6.0e-3, 6.0e-6, 1.0e-5", "m, m2, m4",
               "its bending is what lets the frame pitch behind the locked damper"),
    Assumption("feet on the floor, from the bogie's centre: x, z", "0, +-0.50; +-0.70, +-1.10", "m", LOST),
)  # fmt: skip
"""Every number of the bolsters that is an engineering assumption."""


@dataclass(frozen=True)
class Bolsters:
    """Parts between one bogie and the floor.

    Attributes
    ----------
    members, suppressions, masses, rbe3s
        As of a structure; the RBE3s stand on the group ``base`` of the car.
    springs : mapping from str to tuple of Spring
        ``secondary`` and ``rod_tilting`` carry parameters; ``floor_fixed`` holds constant ones.
    dampers : mapping from str to tuple of Spring
        ``secondary`` and ``yaw``.
    """

    members: tuple[Member, ...]
    suppressions: tuple[Suppression, ...]
    masses: tuple[PointMass, ...]
    springs: dict[str, tuple[Spring, ...]]
    dampers: dict[str, tuple[Spring, ...]]
    rbe3s: tuple[Rbe3, ...]


def bolsters(size: float, outward: float = 1.0) -> Bolsters:
    """Bolsters, secondary suspension and yaw dampers of a bogie, with the RBE3s that attach them to the floor.

    Parameters
    ----------
    size : float
        Largest element length, m.
    outward : float
        1 or -1: direction along x towards the near end of the car, where the yaw-damper brackets stand.
    """
    suppressed = Suppression((UX, UZ, RY), groups=("load_bolster", "tilting_bolster"))
    return Bolsters(_members(size, outward), (suppressed,), _masses(), _springs(), _dampers(outward), _rbe3s())


def _members(size: float, outward: float) -> tuple[Member, ...]:
    def across(name: str, y: float, tip: float, through: tuple[float, ...]) -> Member:
        marks = tuple((0.0, y, s * z) for z in through for s in (-1, 1))
        return Member(name, name, BOLSTER, (0.0, y, -tip), (0.0, y, tip), size, marks, part=name.replace("_", " "))

    foot = outward * BRACKET_X
    brackets = (
        Member(
            "frame", "bracket", BRACKET, (foot, GIRDER_Y, s * GIRDER_Z), (foot, BRACKET_TOP, s * GIRDER_Z), size,
            up=(1.0, 0.0, 0.0), part=f"yaw-damper bracket {side}",
        )
        for side, s in SIDES
    )  # fmt: skip
    return (
        across("load_bolster", LOAD_BOLSTER_Y, LOAD_BOLSTER_TIP, (0.0, ROD_Z)),
        across("tilting_bolster", TILTING_BOLSTER_Y, TILTING_BOLSTER_TIP, (0.0, ROD_Z)),
        *brackets,
    )


def _masses() -> tuple[PointMass, ...]:
    out = []
    for side, s in SIDES:
        out.append(
            PointMass(
                ("load_bolster", (0.0, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP)), 60.0, name=f"load bolster seat {side}"
            )
        )
        out.append(
            PointMass(("tilting_bolster", (0.0, TILTING_BOLSTER_Y, s * ROD_Z)), 60.0, name=f"tilting bolster {side}")
        )
    return tuple(out)


def _secondary() -> list[tuple[str, Point, Point]]:
    return [
        (f"{end} {side}", (x, GIRDER_Y, s * LOAD_BOLSTER_TIP), (x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP))
        for end, x in (("front", SEAT_X), ("rear", -SEAT_X))
        for side, s in SIDES
    ]


def _springs() -> dict[str, tuple[Spring, ...]]:
    secondary = [
        Spring(("load_bolster", high), ("frame", low), (0, 1, 0), name=f"secondary spring {corner}")
        for corner, low, high in _secondary()
    ]
    rods, pads, links = [], [], []
    for side, s in SIDES:
        low, high = (0.0, LOAD_BOLSTER_Y, s * ROD_Z), (0.0, TILTING_BOLSTER_Y, s * ROD_Z)
        rods.append(Spring(("tilting_bolster", high), ("load_bolster", low), (0, 1, 0), name=f"tilting rod {side}"))
        for end, x in (("front", PAD_X), ("rear", -PAD_X)):
            name = f"floor_{end}_{side}"
            low, high = (x, TILTING_BOLSTER_Y, s * PAD_Z), (x, FLOOR_Y, s * PAD_Z)
            pads.append(
                Spring((name, high), ("tilting_bolster", low), (0, 1, 0), False, K_PAD, f"floor pad {end} {side}")
            )
        meet = (0.0, TILTING_BOLSTER_Y, s * PAD_Z)
        ends = (f"floor_{side}", meet), ("tilting_bolster", meet)
        links.append(Spring(*ends, (1, 0, 0), False, K_TRACTION, f"traction link {side}"))
        links.append(Spring(*ends, (0, 0, 1), False, K_LATERAL, f"lateral link {side}"))
    return {
        "secondary": tuple(secondary),
        "rod_tilting": tuple(rods),
        "floor_fixed": (*pads, *links),
    }


def _dampers(outward: float) -> dict[str, tuple[Spring, ...]]:
    secondary = [
        Spring(("load_bolster", high), ("frame", low), (0, 1, 0), name=f"secondary damper {corner}")
        for corner, low, high in _secondary()
    ]
    yaw = [
        Spring(
            (f"floor_{side}", (outward * YAW_FLOOR_X, BRACKET_TOP, s * GIRDER_Z)),
            ("bracket", (outward * BRACKET_X, BRACKET_TOP, s * GIRDER_Z)),
            (1, 0, 0),
            name=f"yaw damper {side}",
        )
        for side, s in SIDES
    ]
    return {"secondary": tuple(secondary), "yaw": tuple(yaw)}


def _rbe3s() -> tuple[Rbe3, ...]:
    out = []
    for side, s in SIDES:
        feet = [(x, FLOOR_Y, s * z) for x in FLOOR_X for z in FLOOR_Z]
        out.append(Rbe3(f"floor_{side}", "base", tuple(feet)))
        out.append(Rbe3(f"floor_front_{side}", "base", tuple(f for f in feet if f[0] >= 0)))
        out.append(Rbe3(f"floor_rear_{side}", "base", tuple(f for f in feet if f[0] <= 0)))
    return tuple(out)
