"""Members, ties and suppressions of a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib import InputError
from models.fem.nodes import MERGE
from models.fem.section import Section

_MOST_ELEMENTS = 10_000
"""Largest number of elements of one member; more is an input error."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Member:
    """A straight beam of one section.

    Attributes
    ----------
    body : str
        Members of one body share the nodes where they meet; those of different bodies never do.
    group : str
        Name under which its stiffness and mass are assembled.
    section : Section
    start, end : (3,) coordinates in m
    size : float
        Largest element length in m.
    through : tuple of points
        Places on the axis that must be nodes: attachments and crossings.
    up : (3,) float
        Reference direction of the local y axis.
    arm : (3,) float
        Rigid arm from the nodes to the beam's axis, m.
    released_start, released_end : tuple of int
        Local motions 0..5 (ux, uy, uz, rx, ry, rz) hinged at either end.
    part : str
        Members of one part form one unit for local perturbations; the group by default.
    """

    body: str
    group: str
    section: Section
    start: Point
    end: Point
    size: float
    through: tuple[Point, ...] = ()
    up: Point = (0.0, 1.0, 0.0)
    arm: Point = (0.0, 0.0, 0.0)
    released_start: tuple[int, ...] = ()
    released_end: tuple[int, ...] = ()
    part: str = ""

    def stations(self) -> np.ndarray:
        """Node places along the member, shape (n_nodes, 3)."""
        start, end = np.array(self.start), np.array(self.end)
        length = np.linalg.norm(end - start)
        if not length > MERGE:
            raise InputError("its ends coincide", place=f"member {self.body}/{self.group}")
        if not np.linalg.norm(np.cross(end - start, self.up)) > 1e-6 * length * np.linalg.norm(self.up):
            raise InputError(
                f"its reference direction up = {self.up} lies along it",
                place=f"member {self.body}/{self.group}",
                remedy="choose one across the beam",
            )
        if not length / _MOST_ELEMENTS <= self.size < math.inf:
            raise InputError(
                f"its largest element length is {self.size} m",
                place=f"member {self.body}/{self.group}",
                remedy=f"give a positive one that makes at most {_MOST_ELEMENTS} elements, such as 0.075",
            )
        cuts = [0.0, 1.0]
        for point in self.through:
            t = float((np.array(point) - start) @ (end - start) / length**2)
            if np.linalg.norm(start + t * (end - start) - point) > MERGE or not -1e-9 <= t <= 1 + 1e-9:
                raise InputError(f"point {point} is not on its axis", place=f"member {self.body}/{self.group}")
            cuts.append(t)
        cuts = sorted({round(min(max(t, 0.0), 1.0), 9) for t in cuts})
        fine: list[float] = [cuts[0]]
        for a, b in pairwise(cuts):
            n = max(1, int(np.ceil((b - a) * length / self.size - 1e-9)))
            fine.extend(a + (b - a) * np.arange(1, n + 1) / n)
        return start + np.array(fine)[:, None] * (end - start)


@dataclass(frozen=True)
class Particle:
    """A body of one node, such as an oscillator on springs.

    Attributes
    ----------
    body : str
    group : str
        Name by which several of them are suppressed or selected.
    point : (3,) coordinates in m
    """

    body: str
    group: str
    point: Point


@dataclass(frozen=True)
class Tie:
    """Two bodies share some motions (global directions 0..5) at a place where each of them has a node."""

    body: str
    other: str
    point: Point
    directions: tuple[int, ...]


@dataclass(frozen=True)
class Suppression:
    """Some motions (global directions 0..5) are zero: at one node of a body, or at all nodes of the named groups."""

    directions: tuple[int, ...]
    groups: tuple[str, ...] = ()
    body: str = ""
    point: Point | None = None
