"""Geometry lines of the car body: joints of panels, edges of windows and doors, frames and equipment.

Axes: x longitudinal, y up, z transverse (left positive), origin mid-car on top of rail. Every line is geometry: a
finer mesh halves the cells between them. Length, width and height are public; all else is assumed.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib.structure import Assumption
from models.railway.bolsters import FLOOR_X, FLOOR_Y

BOGIE_X = 9.50
HALF_LENGTH = 12.95

PILLARS = tuple(-9.0 + 2.0 * k for k in range(10))
"""Windows lie between neighbouring pillars; the outermost two are the edges of the walls' solid ends."""

DOOR = (10.9, 11.9)
_CELL = 0.5

BASE_Z = (-1.40, -1.10, -0.70, -0.35, 0.0, 0.35, 0.70, 1.10, 1.40)
WALL = ((FLOOR_Y, 1.40), (1.475, 1.44), (1.80, 1.46), (2.275, 1.44), (2.75, 1.38), (3.05, 1.27))
"""Half of the wall's outline, (y, z) from the sole bar to the cantrail."""

SOLE, SILL, HEADER, CANTRAIL = 0, 2, 4, 5
"""Lines of `WALL`: foot, lower and upper edge of the windows, head of walls and doors."""

_HALF_COVER = ((3.05, 1.27), (3.27, 1.08), (3.44, 0.76), (3.535, 0.40))
COVER = (*_HALF_COVER, (3.56, 0.0), *((y, -z) for y, z in reversed(_HALF_COVER)))
"""Outline of the cover, (y, z) from the left cantrail to the right one."""

GANGWAY_X = (3, 5)
"""Lines of an end wall between which its opening reaches from the floor to the header."""

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("car body: length, width, height", "25.90, 2.92, 3.56", "m", "public figures of the train"),
    Assumption("bogie centres", "+-9.50", "m", "usual distance of 19 m"),
    Assumption("floor, sill, header and cantrail: y", "1.15, 1.80, 2.75, 3.05", "m", "lost; plausible for the height"),
    Assumption("outline of walls and cover", "6 and 9 lines", "m", "lost; polygon through the public width and height"),
    Assumption("windows: 9 a side between pillars 2.0 apart", "-9.0..9.0", "m",
               "lost; bands of glass whose pillars are beams, so that their flexibility does not hang on the mesh"),
    Assumption("doors: x, from the floor to the cantrail", "+-10.9..11.9", "m", "lost; one at each corner"),
    Assumption("gangway openings: half width at the floor", "0.35", "m", "lost; from the floor to the header"),
)  # fmt: skip
"""Every line of the car body that is an engineering assumption."""


def stations() -> dict[str, tuple[float, ...]]:
    """Lines across the car, x in m, of the zones ``rear``, ``windows`` and ``front``, which share their first and last.

    All cells of a window have the same size: shells with linear rotations and beams then represent the bending between
    pillars best.
    """
    first, last = PILLARS[0], PILLARS[-1]
    windows = tuple(float(x) for x in np.linspace(first, last, round((last - first) / _CELL) + 1))
    beyond = (BOGIE_X, BOGIE_X + FLOOR_X[-1], DOOR[0], sum(DOOR) / 2, DOOR[1], (DOOR[1] + HALF_LENGTH) / 2, HALF_LENGTH)
    front = (last, *beyond)
    return {"rear": tuple(-x for x in reversed(front)), "windows": windows, "front": front}


def line(xs: tuple[float, ...], x: float) -> int:
    """Number of the line at ``x``."""
    return int(np.argmin(np.abs(np.array(xs) - x)))


def openings(zone: str, xs: tuple[float, ...]) -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
    """Windows or door of a zone's wall, as cells of a panel over lines along x and lines of `WALL`."""
    if zone == "windows":
        return tuple(((line(xs, a), line(xs, b)), (SILL, HEADER)) for a, b in pairwise(PILLARS))
    return ((door(zone, xs), (SOLE, CANTRAIL)),)


def door(zone: str, xs: tuple[float, ...]) -> tuple[int, int]:
    """First and last line of the door in an end zone."""
    side = 1.0 if zone == "front" else -1.0
    first, last = sorted(line(xs, side * x) for x in DOOR)
    return first, last


def end_wall(side: float) -> np.ndarray:
    """Grid (n_z, n_y, 3) of an end wall, spanned between base, walls and cover; ``side`` is the sign of its x."""
    bottom = np.array([(FLOOR_Y, z) for z in reversed(BASE_Z)])
    top, left = np.array(COVER), np.array(WALL)
    right = left * [1.0, -1.0]
    u = ((bottom[0, 1] - bottom[:, 1]) / (bottom[0, 1] - bottom[-1, 1]))[:, None, None]
    v = ((left[:, 0] - left[0, 0]) / (left[-1, 0] - left[0, 0]))[None, :, None]
    # A Coons patch: both ruled surfaces less the bilinear one that they have in common.
    ruled = (1 - v) * bottom[:, None] + v * top[:, None] + (1 - u) * left[None] + u * right[None]
    corners = (1 - u) * ((1 - v) * bottom[0] + v * top[0]) + u * ((1 - v) * bottom[-1] + v * top[-1])
    yz = ruled - corners
    return np.concatenate([np.full((*yz.shape[:2], 1), side * HALF_LENGTH), yz], axis=2)
