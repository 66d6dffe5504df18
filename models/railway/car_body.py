"""The car body: base, side walls with windows and doors, cover and end walls as shells, its frames as beams.

The case study gives the equivalent thicknesses, modulus and density of the panels and the meaning of their ratios of
moments of inertia; the frames' sections are assumed (see `ASSUMPTIONS`). Frames carry loads that would otherwise depend
on the mesh: moments of a pillar go into rails and posts, those of the floor into cross-beams.
"""

from __future__ import annotations

from typing import NamedTuple

from calib.structure import Assumption
from models.fem.member import Member, Point
from models.fem.panel import Panel, sheet_panel
from models.fem.section import Section
from models.fem.sheet import Sheet
from models.railway.bogie import SIDES
from models.railway.bolsters import FLOOR_X, FLOOR_Y
from models.railway.car_lines import (
    BASE_Z,
    BOGIE_X,
    CANTRAIL,
    COVER,
    GANGWAY_X,
    HEADER,
    PILLARS,
    SILL,
    SOLE,
    WALL,
    door,
    end_wall,
    line,
    openings,
    stations,
)

BODY = "car"
E_ALUMINIUM, NU_ALUMINIUM, RHO_ALUMINIUM = 70e9, 0.33, 2700.0


def _sheet(thickness: float, rmi: float) -> Sheet:
    return Sheet(thickness, E_ALUMINIUM, NU_ALUMINIUM, RHO_ALUMINIUM, rmi=rmi)


SHEETS = {
    "base": _sheet(10.2e-3, 225.0),
    "walls": _sheet(10.3e-3, 90.0),
    "cover": _sheet(8.8e-3, 300.0),
    "ends": _sheet(10.3e-3, 90.0),
}
"""Sheet of every group of panels, at the nominal parameters."""


def _section(area: float, in_plane: float, out_of_plane: float, torsion: float) -> Section:
    """Second moments for bending in and out of the plane of the member and its reference direction."""
    return Section(area, out_of_plane, in_plane, torsion, E_ALUMINIUM, NU_ALUMINIUM, RHO_ALUMINIUM, 0.5)


SECTIONS = {
    "sole_bar": _section(1.5e-2, 1e-4, 1e-4, 1e-4),
    "cantrail": _section(1.2e-2, 1e-4, 1e-4, 1e-4),
    "rail": _section(4.0e-3, 2e-5, 2e-6, 5e-5),
    "pillar": _section(1.0e-2, 8e-5, 1e-7, 2e-6),
    "post": _section(2.5e-3, 1e-5, 2e-5, 5e-7),
    "ring": _section(2.5e-3, 5e-6, 5e-6, 5e-6),
    "gangway": _section(2.5e-3, 5e-6, 5e-6, 5e-6),
    "floor_beam": _section(4.0e-3, 3e-5, 5e-6, 5e-6),
    "bolster_beam": _section(6.0e-3, 4e-5, 1e-5, 1e-5),
}
"""Section of every group of frames: bending upright (or lengthwise for upright members), then the other plane."""

CROSS_BEAMS = {
    "rear": (("bolster_beam", -BOGIE_X), ("floor_beam", -BOGIE_X + FLOOR_X[0])),
    "windows": tuple(("floor_beam", x) for x in PILLARS),
    "front": (("bolster_beam", BOGIE_X), ("floor_beam", BOGIE_X + FLOOR_X[-1])),
}
"""Beams across the floor by zone: group of frames and place along the car, m."""

PILLAR_WIDTH = 0.07
PILLAR_WALL = Section(
    1e-6, SHEETS["walls"].rmi * PILLAR_WIDTH * SHEETS["walls"].thickness ** 3 / 12, 1e-9, 1e-9, E_ALUMINIUM,
    NU_ALUMINIUM, 0.0, shear_coefficient=1e6,
)  # fmt: skip
"""The wall's strip between two windows as a beam that only bends across the wall; its stiffness is proportional to the
ratio of moments of inertia, like that of the panels."""

_UP: Point = (0.0, 1.0, 0.0)
_ALONG: Point = (1.0, 0.0, 0.0)

_REASON = "lost; plausible sizes, chosen so that distortion, bending and torsion fall between 8 and 14 Hz"

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("aluminium: Poisson's ratio", "0.33", "-", "usual value"),
    Assumption("frames: shear coefficient", "0.5", "-", "hollow sections"),
    Assumption("end walls", "as the side walls", "-", "the case study names no panel of their own"),
    Assumption("RMI", "scales D11, D22, D12 and D66", "-", "the case study defines it by bending inertia alone"),
    Assumption("sole bar, cantrail: A", "1.5e-2, 1.2e-2", "m2", _REASON),
    Assumption("sole bar, cantrail: Iv, Il, J", "1e-4", "m4", "lost; large hollow extrusions"),
    Assumption("window rails at sill and header: A, Iv, Il, J", "4.0e-3, 2e-5, 2e-6, 5e-5", "m2, m4",
               "lost; hollow, so that they and not a corner of shell take a pillar's moments"),
    Assumption("window pillars (8 a side): A, I in the wall, J", "1.0e-2, 8e-5, 2e-6", "m2, m4",
               "lost; beams instead of strips of shell, which would converge slowly"),
    Assumption("window pillars: width of wall that bends across it with RMI_walls", "0.07", "m",
               "lost; lets the side walls' ratio of moments of inertia rule the distortion, as the case study found"),
    Assumption("posts under and over the pillars: A, I in and across the wall, J", "2.5e-3, 1e-5, 2e-5, 5e-7", "m2, m4",
               "lost; they lead the pillars' moments on into the wall"),
    Assumption("door posts, end rings, gangway frames: A, I, J", "2.5e-3, 5e-6, 5e-6", "m2, m4", _REASON),
    Assumption("floor cross-beams at every pillar and beside the bogies: A, Iv, Il, J", "4.0e-3, 3e-5, 5e-6, 5e-6",
               "m2, m4", "lost; they carry the equipment"),
    Assumption("bolster cross-beams: A, Iv, Il, J", "6.0e-3, 4e-5, 1e-5, 1e-5", "m2, m4", _REASON),
)  # fmt: skip
"""Every number of the car body's walls and frames that is an engineering assumption."""


class CarBody(NamedTuple):
    """Panels and frames of the body ``car``."""

    panels: tuple[Panel, ...]
    members: tuple[Member, ...]


def car_body(refinement: int = 0) -> CarBody:
    """The empty car body.

    Parameters
    ----------
    refinement : int
        How many times every edge of shells and frames is halved.
    """
    panels: list[Panel] = []
    members: list[Member] = []
    for zone, xs in stations().items():
        base = sheet_panel(
            BODY, "base", SHEETS["base"], xs, [(FLOOR_Y, z) for z in BASE_Z], refinement=refinement, part=f"base {zone}"
        )
        cover = sheet_panel(
            BODY, "cover", SHEETS["cover"], xs, COVER, refinement=refinement, part=f"cover {zone}"
        )  # fmt: skip
        panels += [base, cover]
        members += _floor_frames(base, zone, xs)
        if zone != "windows":
            members += [*_frame(base, "ring", u=_far(zone, xs)), *_frame(cover, "ring", u=_far(zone, xs))]
        for side, s in SIDES:
            wall = sheet_panel(
                BODY, "walls", SHEETS["walls"], xs, [(y, s * z) for y, z in WALL], openings=openings(zone, xs),
                refinement=refinement, part=f"wall {side} {zone}",
            )  # fmt: skip
            panels.append(wall)
            members += _wall_frames(wall, zone, xs)
    for end, s in (("front", 1.0), ("rear", -1.0)):
        hole = (GANGWAY_X, (SOLE, HEADER))
        wall = Panel(BODY, "ends", SHEETS["ends"], end_wall(s), (hole,), refinement, part=f"end wall {end}")
        panels.append(wall)
        members += [*_frame(wall, "gangway", u=GANGWAY_X[0]), *_frame(wall, "gangway", u=GANGWAY_X[1])]
        members += _frame(wall, "gangway", v=HEADER)
    return CarBody(tuple(panels), tuple(members))


def _frame(
    panel: Panel, group: str, u: int | None = None, v: int | None = None, between: tuple[int, int] | None = None
) -> tuple[Member, ...]:
    lengthwise_or_across = panel.group == "base" or (v is not None and panel.group != "ends")
    up = _UP if lengthwise_or_across else _ALONG
    return panel.stiffener(group, SECTIONS[group], up, u=u, v=v, between=between, part=group.replace("_", " "))


def _far(zone: str, xs: tuple[float, ...]) -> int:
    return len(xs) - 1 if zone == "front" else 0


def _floor_frames(base: Panel, zone: str, xs: tuple[float, ...]) -> list[Member]:
    return [member for group, x in CROSS_BEAMS[zone] for member in _frame(base, group, u=line(xs, x))]


def _wall_frames(wall: Panel, zone: str, xs: tuple[float, ...]) -> list[Member]:
    out = [*_frame(wall, "sole_bar", v=SOLE), *_frame(wall, "cantrail", v=CANTRAIL)]
    if zone == "windows":
        for v in (SILL, HEADER):
            out += _frame(wall, "rail", v=v)
        for x in PILLARS:
            group = "post" if x in (PILLARS[0], PILLARS[-1]) else "pillar"
            for name, between in (("post", (SOLE, SILL)), (group, (SILL, HEADER)), ("post", (HEADER, CANTRAIL))):
                out += _frame(wall, name, u=line(xs, x), between=between)
            if group == "pillar":
                out += wall.stiffener(
                    "pillar_wall", PILLAR_WALL, _ALONG, u=line(xs, x), between=(SILL, HEADER), part="window pillars"
                )
    else:
        for u in (*door(zone, xs), _far(zone, xs)):
            out += _frame(wall, "ring", u=u)
    return out
