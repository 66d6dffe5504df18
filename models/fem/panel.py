"""Panels: structured shell patches between geometry lines, with openings, refined by halving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib import InputError
from models.fem.member import Member, Point
from models.fem.section import Section
from models.fem.sheet import Sheet

Cells = tuple[tuple[int, int], tuple[int, int]]
"""A block of cells between lines: ``((first, last), (first, last))`` of the line numbers that bound it, both ways."""


@dataclass(frozen=True, eq=False)
class Panel:
    """A shell patch on a grid of geometry points.

    Every cell between neighbouring lines is one element, or ``2**refinement`` by ``2**refinement`` elements when
    refined. New nodes lie on the cell's own bilinear patch, a plane facet where the cell is flat: the geometry, and
    with it the area, the mass and every attachment, is the same at every refinement. A curved wall is the polygon of
    its lines; give more lines where that is too coarse.

    Attributes
    ----------
    body : str
        Panels and members of one body share the nodes where they meet.
    group : str
        Name under which its stiffness and mass are assembled.
    sheet : Sheet
    points : ndarray (n_u, n_v, 3)
        Places where the lines of both families cross, m. The normal points along u x v.
    openings : tuple of Cells
        Blocks of cells left out: windows and doors.
    refinement : int
        How many times every edge is halved.
    along : (3,) float or None
        Reference direction of an orthotropic sheet; None is the u direction of each element.
    part : str
        Panels of one part form one unit for local perturbations; the group by default.
    """

    body: str
    group: str
    sheet: Sheet
    points: np.ndarray
    openings: tuple[Cells, ...] = ()
    refinement: int = 0
    along: Point | None = None
    part: str = ""

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if points.ndim != 3 or points.shape[2] != 3 or min(points.shape[:2]) < 2 or not np.isfinite(points).all():
            raise InputError(
                f"its points have the shape {points.shape} or are not finite",
                place=self.place,
                remedy="give finite coordinates of shape (n_u, n_v, 3), at least two lines each way",
            )
        if self.refinement < 0 or self.refinement != int(self.refinement):
            raise InputError(
                f"its refinement is {self.refinement}", place=self.place, remedy="give 0, 1, 2, ... halvings"
            )
        for opening in self.openings:
            for (first, last), lines in zip(opening, points.shape[:2], strict=True):
                if not 0 <= first < last < lines:
                    raise InputError(
                        f"the opening {opening} leaves its lines 0..{points.shape[0] - 1}, 0..{points.shape[1] - 1}",
                        place=self.place,
                        remedy="give the numbers of the bounding lines, the lower one first",
                    )
        if not self._cells().any():
            raise InputError("its openings leave nothing of it", place=self.place)
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @property
    def place(self) -> str:
        """Label in messages."""
        return f"panel {self.body}/{self.group}"

    def _cells(self) -> np.ndarray:
        """Cells that are not openings (bool), shape (n_u - 1, n_v - 1)."""
        there = np.ones(np.subtract(self.points.shape[:2], 1), dtype=bool)
        for (i, j), (k, m) in self.openings:
            there[i:j, k:m] = False
        return there

    def grid(self) -> np.ndarray:
        """Places of all lines after refinement, shape (n_u', n_v', 3)."""
        return _refined(_refined(self.points, self.refinement).transpose(1, 0, 2), self.refinement).transpose(1, 0, 2)

    def elements(self) -> tuple[np.ndarray, np.ndarray]:
        """Places (n_nodes, 3) that are used, and the corners (n_elements, 4) of the elements among them."""
        grid, times = self.grid(), 2**self.refinement
        number = np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
        there = np.kron(self._cells(), np.ones((times, times), dtype=bool))
        turn = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
        corners = np.stack([n[there] for n in turn], axis=1)
        used, inverse = np.unique(corners, return_inverse=True)
        return grid.reshape(-1, 3)[used], inverse.reshape(-1, 4)

    def stiffener(
        self,
        group: str,
        section: Section,
        up: Point,
        *,
        u: int | None = None,
        v: int | None = None,
        between: tuple[int, int] | None = None,
        arm: Point = (0.0, 0.0, 0.0),
        part: str = "",
    ) -> tuple[Member, ...]:
        """Beams on the panel's own nodes along one line, one member for every straight segment.

        Parameters
        ----------
        group, section, up, arm, part
            As of a `Member`.
        u, v : int
            Its line: the points of ``points[u]`` or of ``points[:, v]``; one of the two.
        between : (2,) int, optional
            First and last crossing line; all of them by default.
        """
        if (u is None) == (v is None):
            raise InputError("a stiffener follows one line", place=self.place, remedy="name either u or v")
        lines = self.points if u is not None else self.points.transpose(1, 0, 2)
        line, last = (u if u is not None else v), lines.shape[1] - 1
        first, end = between or (0, last)
        if line is None or not (0 <= line < len(lines) and 0 <= first < end <= last):
            raise InputError(
                f"there is no line {line} from {first} to {end}",
                place=self.place,
                remedy=f"its lines are 0..{len(lines) - 1}, crossed by 0..{last}",
            )
        chain = lines[line, first : end + 1]
        step = np.diff(chain, axis=0)
        step /= np.linalg.norm(step, axis=1)[:, None]
        bends = np.flatnonzero(np.linalg.norm(np.diff(step, axis=0), axis=1) > 1e-9) + 1
        cuts = [0, *bends.tolist(), len(chain) - 1]
        members = []
        for a, b in pairwise(cuts):
            nodes = _refined(chain[a : b + 1], self.refinement)
            size = float(np.linalg.norm(nodes[-1] - nodes[0]))
            start, *through, stop = (_point(p) for p in nodes)
            members.append(Member(self.body, group, section, start, stop, size, tuple(through), up, arm, part=part))
        return tuple(members)


def sheet_panel(
    body: str,
    group: str,
    sheet: Sheet,
    stations: Sequence[float],
    outline: Sequence[Sequence[float]],
    direction: int = 0,
    openings: tuple[Cells, ...] = (),
    refinement: int = 0,
    along: Point | None = None,
    part: str = "",
) -> Panel:
    """A prismatic panel: an outline extruded along a coordinate axis.

    Parameters
    ----------
    stations : sequence of float
        Coordinates along the axis: the u lines.
    outline : sequence of (2,) float
        The other two coordinates in the order of their axes (x, y, z): the v lines.
    direction : int
        0, 1 or 2 for x, y or z.
    body, group, sheet, openings, refinement, along, part
        As of a `Panel`.
    """
    points = np.zeros((len(stations), len(outline), 3))
    points[:, :, direction] = np.asarray(stations, dtype=float)[:, None]
    others = [d for d in range(3) if d != direction]
    points[:, :, others] = np.asarray(outline, dtype=float)
    return Panel(body, group, sheet, points, openings, refinement, along, part)


def _refined(points: np.ndarray, times: int) -> np.ndarray:
    """Points (n, ..., 3) with every step of the first axis halved a number of times."""
    for _ in range(times):
        finer = np.empty((2 * len(points) - 1, *points.shape[1:]))
        finer[::2], finer[1::2] = points, (points[:-1] + points[1:]) / 2
        points = finer
    return points


def _point(place: np.ndarray) -> Point:
    x, y, z = (float(c) for c in place)
    return (x, y, z)
