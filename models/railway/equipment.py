"""Equipment under the floor and on the roof, passenger seats and couplers.

The case study has equipment as point masses and every seat as an oscillator of one degree of freedom; items, masses and
places are lost there and assumed (see `ASSUMPTIONS`). The couplers carry no load unless a neighbouring car is attached.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from calib.structure import Assumption
from models.fem.discrete import PointMass, Spring
from models.fem.member import Particle, Point, Suppression
from models.fem.rbe3 import Rbe3
from models.railway.bogie import ENDS, RX, RY, RZ, UX, UZ
from models.railway.bolsters import FLOOR_Y
from models.railway.car_lines import COVER, DOOR, HALF_LENGTH

UNDER_Y, UNDER_Z = 0.75, 0.70
ROOF_Y, _ROOF_LINE = 3.60, 2


@dataclass(frozen=True)
class Item:
    """A piece of equipment on four feet; ``half`` is half their distance along x, m."""

    name: str
    mass: float
    x: float
    half: float


UNDER_FLOOR = (
    Item("traction converter", 2600.0, -4.0, 1.0),
    Item("traction motor", 2200.0, 6.0, 1.0),
    Item("auxiliary converter", 1600.0, 0.0, 1.0),
    Item("compressor", 900.0, -2.0, 1.0),
    Item("batteries", 800.0, 2.0, 1.0),
)
ON_ROOF = (Item("front roof unit", 600.0, 4.0, 1.0), Item("rear roof unit", 600.0, -4.0, 1.0))

SEAT_X = tuple(float(x) for x in range(-7, 8))
SEAT_Z = (1.12, 0.62, -0.62, -1.12)
SEAT_Y, SEAT_FOOT = 1.60, (0.20, 0.15)
SEAT_MASS, SEAT_STIFFNESS, SEAT_DAMPING = 35.0, 670e3, 0.70e3

COUPLER_Y, COUPLER_Z = 1.00, 0.70
_BEHIND_DOOR = (DOOR[1] + HALF_LENGTH) / 2

_REASON = "lost in the case study; plausible for a motor car of 50 t"

ASSUMPTIONS: tuple[Assumption, ...] = (
    *(Assumption(f"{i.name}: mass, x, y, z of its feet", f"{i.mass:g}, {i.x:g}, {UNDER_Y:g}, +-{UNDER_Z:g}", "kg, m",
                 _REASON) for i in UNDER_FLOOR),
    *(Assumption(f"{i.name}: mass, x, y, z of its feet", f"{i.mass:g}, {i.x:g}, {ROOF_Y:g}, +-{COVER[_ROOF_LINE][1]:g}",
                 "kg, m", _REASON) for i in ON_ROOF),
    Assumption("couplers: y, z of their feet on the car's frame", f"{COUPLER_Y:g}, +-{COUPLER_Z:g}", "m", _REASON),
    Assumption("seats: 15 rows of 4, x from -7 to 7, z", "+-0.62, +-1.12", "m", _REASON),
    Assumption("seat: mass, stiffness, damping", "35, 670, 0.70", "kg, kN/m, kNs/m",
               "empty: 22 Hz and 7 %; with passengers 60 modes would lie among those of the bogies"),
)  # fmt: skip
"""Every number of equipment and seats that is an engineering assumption."""


class Equipment(NamedTuple):
    """Point masses and the RBE3s they stand on."""

    masses: tuple[PointMass, ...]
    rbe3s: tuple[Rbe3, ...]


def equipment() -> Equipment:
    """Equipment under the floor and on the roof; its feet stand on crossings of the panels' lines."""
    masses, rbe3s = [], []
    roof_y, roof_z = COVER[_ROOF_LINE]
    places = [("base", FLOOR_Y, UNDER_Z, UNDER_Y, i) for i in UNDER_FLOOR]
    places += [("cover", roof_y, roof_z, ROOF_Y, i) for i in ON_ROOF]
    for panel, y, z, height, item in places:
        feet = _feet((item.x, y, 0.0), item.half, z)
        rbe3s.append(Rbe3(item.name, panel, feet))
        masses.append(PointMass((item.name, (item.x, height, 0.0)), item.mass, name=item.name))
    return Equipment(tuple(masses), tuple(rbe3s))


class Seats(NamedTuple):
    """Seats as particles that move vertically only, on springs and dampers, or as masses on the floor."""

    particles: tuple[Particle, ...]
    suppressions: tuple[Suppression, ...]
    masses: tuple[PointMass, ...]
    rbe3s: tuple[Rbe3, ...]
    springs: tuple[Spring, ...]


def passenger_seats(sprung: bool = True) -> Seats:
    """All seats; ``springs`` hold for stiffness and damping alike. Seats that are not sprung move with the floor."""
    particles, masses, rbe3s, springs = [], [], [], []
    for k, x in enumerate(SEAT_X):
        third = ("rear", "middle", "front")[k * 3 // len(SEAT_X)]
        for j, z in enumerate(SEAT_Z):
            name, seat, floor = f"seat_{k + 1}{'abcd'[j]}", (x, SEAT_Y, z), (x, FLOOR_Y, z)
            foot = (f"floor_{name}", floor)
            rbe3s.append(Rbe3(foot[0], "base", _feet(floor, *SEAT_FOOT)))
            masses.append(PointMass((name, seat) if sprung else foot, SEAT_MASS, name=f"seats {third}"))
            if sprung:
                particles.append(Particle(name, "seat", seat))
                springs.append(Spring((name, seat), foot, (0, 1, 0), name=f"seats {third}"))
    held = (Suppression((UX, UZ, RX, RY, RZ), groups=("seat",)),) if sprung else ()
    return Seats(tuple(particles), held, tuple(masses), tuple(rbe3s), tuple(springs))


def couplers() -> tuple[Rbe3, ...]:
    """Attachments of the couplers at both ends of the car's frame; each follows the mean motion of its feet."""
    middle, half = (HALF_LENGTH + _BEHIND_DOOR) / 2, (HALF_LENGTH - _BEHIND_DOOR) / 2
    return tuple(Rbe3(f"coupler_{end}", "base", _feet((s * middle, FLOOR_Y, 0.0), half, COUPLER_Z)) for end, s in ENDS)


def _feet(centre: Point, half_x: float, half_z: float) -> tuple[Point, ...]:
    x, y, z = centre
    return tuple((x + a * half_x, y, z + b * half_z) for a in (1, -1) for b in (1, -1))
