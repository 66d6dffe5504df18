"""Frames: members cut into beam elements and tied together, with the motion of any point."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from calib import InputError
from calib.structure import DofMap, Mesh
from models.fem import beam
from models.fem.member import Member, Particle, Suppression, Tie
from models.fem.nodes import MERGE, NodeTable, assemble


class Carrier(NamedTuple):
    """Nearest place of an element to a point: its distance, its nodes and the point's motion over theirs.

    ``problem`` says why the place cannot carry the point.
    """

    distance: float
    nodes: np.ndarray
    motion: np.ndarray
    problem: InputError | None = None


class Lines(NamedTuple):
    """Axes of elements: both ends (n, 3), m, their difference and its square (n,)."""

    start: np.ndarray
    end: np.ndarray
    along: np.ndarray
    square: np.ndarray


Place = tuple[float, float, float, str | None]
"""A point, m, and the part that carries it."""


@dataclass(frozen=True)
class Frame:
    """Members, ties and suppressions, cut into elements.

    Attributes
    ----------
    members : tuple of Member
    ties : tuple of Tie
    suppressions : tuple of Suppression
    particles : tuple of Particle
    """

    members: tuple[Member, ...]
    ties: tuple[Tie, ...] = ()
    suppressions: tuple[Suppression, ...] = ()
    particles: tuple[Particle, ...] = ()
    points: np.ndarray = field(init=False, repr=False, compare=False)
    bodies: tuple[str, ...] = field(init=False, repr=False, compare=False)
    ends: np.ndarray = field(init=False, repr=False, compare=False)
    member_of: np.ndarray = field(init=False, repr=False, compare=False)
    particle_nodes: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        table = NodeTable()
        self._fill(table)
        object.__setattr__(self, "points", np.array(table.points).reshape(-1, 3))
        object.__setattr__(self, "bodies", tuple(table.bodies))

    def _fill(self, table: NodeTable) -> None:
        """Cut everything into elements and number their nodes."""
        ends: list[tuple[int, int]] = []
        owner: list[int] = []
        for m, member in enumerate(self.members):
            chain = [table.number(member.body, station) for station in member.stations()]
            ends += list(pairwise(chain))
            owner += [m] * (len(chain) - 1)
        object.__setattr__(self, "ends", np.array(ends, dtype=int).reshape(-1, 2))
        object.__setattr__(self, "member_of", np.array(owner, dtype=int))
        nodes = [table.number(p.body, np.array(p.point, dtype=float)) for p in self.particles]
        object.__setattr__(self, "particle_nodes", np.array(nodes, dtype=int))

    # -- places --------------------------------------------------------------------------------------------------------

    @property
    def n_full(self) -> int:
        """Number of nodal motions, 6 a node."""
        return 6 * len(self.points)

    def node(self, body: str, point: Sequence[float]) -> int:
        """Index of the node of a body at a place; InputError when there is none."""
        own = np.array([b == body for b in self.bodies])
        if not own.any():
            raise InputError(f"there is no body {body!r}", place="frame")
        distance = np.where(own, np.linalg.norm(self.points - np.asarray(point), axis=1), np.inf)
        nearest = int(np.argmin(distance))
        if distance[nearest] > 10 * MERGE:
            raise InputError(f"body {body!r} has no node at {tuple(point)}", place="frame")
        return nearest

    @property
    def groups(self) -> frozenset[str]:
        """Names of all groups."""
        return frozenset([*(m.group for m in self.members), *(p.group for p in self.particles)])

    @property
    def parts(self) -> frozenset[str]:
        """Names of everything that carries points."""
        return self.groups | set(self.bodies)

    def group_nodes(self, groups: Iterable[str]) -> np.ndarray:
        """Sorted indices of the nodes touched by the named groups."""
        wanted = set(groups)
        known_groups(wanted, self.groups)
        return np.unique(self._touched(wanted))

    def _touched(self, wanted: set[str]) -> np.ndarray:
        members = np.array([m.group in wanted for m in self.members], dtype=bool)[self.member_of]
        particles = np.array([p.group in wanted for p in self.particles], dtype=bool)
        return np.concatenate([self.ends[members].ravel(), self.particle_nodes[particles]])

    def motion(self, point: Sequence[float] | np.ndarray, on: str | None = None) -> tuple[np.ndarray, float]:
        """Six motions of a point that a rigid arm ties to the nearest place of the structure.

        Parameters
        ----------
        point : (3,) coordinates in m
        on : str, optional
            Body or group that carries the point; by default the nearest of all.

        Returns
        -------
        rows : ndarray (6, n_full)
            Over all nodal motions; interpolated with the element's own shape functions.
        distance : float
            Length of the rigid arm, m.
        """
        nearest = self._nearest(np.asarray(point, dtype=float), on)
        rows = np.zeros((6, self.n_full))
        for k, node in enumerate(nearest.nodes):
            rows[:, 6 * node : 6 * node + 6] += nearest.motion[:, 6 * k : 6 * k + 6]
        return rows, nearest.distance

    def _nearest(self, p: np.ndarray, on: str | None) -> Carrier:
        """Carrier of a point; kept, since every direction of a sensor and of a spring needs it."""
        key = (float(p[0]), float(p[1]), float(p[2]), on)
        if key not in self._known:
            found = self._carriers(p, on)
            if not found:
                known = ", ".join(sorted(self.parts))
                raise InputError(f"the model has no part {on!r}", place="frame", remedy=f"its parts are {known}")
            nearest = min(found, key=lambda carrier: round(carrier.distance, 9))
            if nearest.problem is not None:
                raise nearest.problem
            self._known[key] = nearest
        return self._known[key]

    def _carriers(self, p: np.ndarray, on: str | None) -> list[Carrier]:
        """The nearest place of every kind of element; of equally near ones the first is taken."""
        found = self._particle_carriers(p, on)
        own = self._elements_of.get(on)
        if own is None:
            return found
        start, end, along, square = (a[own] for a in self._lines)
        t = np.clip(np.einsum("ij,ij->i", p - start, along) / square, 0.0, 1.0)
        foot = start + t[:, None] * along
        distance = np.linalg.norm(foot - p, axis=1)
        k = int(np.argmin(distance))
        e = int(own[k])
        member = self.members[self.member_of[e]]
        length, rotation = beam.axes(start[k : k + 1], end[k : k + 1], np.array(member.up))
        arms = np.broadcast_to(np.array(member.arm), (1, 2, 3))
        local = beam.motion(member.section, float(length[0]), float(t[k])) @ self._follow(e, length)
        r6 = np.kron(np.eye(2), rotation[0])
        at_axis = r6.T @ local @ beam.transformation(rotation, arms)[0]
        at_axis[:3] += beam.arm_matrix(p - foot[k]) @ at_axis[3:]
        return [*found, Carrier(float(distance[k]), self.ends[e], at_axis)]

    @cached_property
    def _known(self) -> dict[Place, Carrier]:
        """Carriers of the points found so far."""
        return {}

    @cached_property
    def _lines(self) -> Lines:
        """Axes of all elements."""
        arm = np.array([m.arm for m in self.members]).reshape(-1, 3)[self.member_of]
        start, end = self.points[self.ends[:, 0]] + arm, self.points[self.ends[:, 1]] + arm
        along = end - start
        return Lines(start, end, along, np.einsum("ij,ij->i", along, along))

    @cached_property
    def _elements_of(self) -> dict[str | None, np.ndarray]:
        """Indices of the elements of every body and group that has any, and of all elements under None."""
        return indices_of([(m.body, m.group) for m in self.members], self.member_of)

    def _particle_carriers(self, p: np.ndarray, on: str | None) -> list[Carrier]:
        own = np.array([on is None or on in (part.body, part.group) for part in self.particles], dtype=bool)
        if not own.any():
            return []
        nodes = self.particle_nodes[own]
        arms = p - self.points[nodes]
        k = int(np.argmin(np.linalg.norm(arms, axis=1)))
        rigid = np.eye(6)
        rigid[:3, 3:] = beam.arm_matrix(arms[k])
        return [Carrier(float(np.linalg.norm(arms[k])), nodes[k : k + 1], rigid)]

    # -- degrees of freedom and matrices -------------------------------------------------------------------------------

    def dof_map(self) -> DofMap:
        """Free degrees of freedom after ties and suppressions."""
        leader = np.arange(self.n_full)
        for tie in self.ties:
            a, b = self.node(tie.body, tie.point), self.node(tie.other, tie.point)
            for d in tie.directions:
                low, high = sorted((leader[6 * a + d], leader[6 * b + d]))
                leader[leader == high] = low
        blocked = np.zeros(self.n_full, dtype=bool)
        for suppression in self.suppressions:
            if suppression.point is not None:
                nodes = np.array([self.node(suppression.body, suppression.point)])
            else:
                nodes = self.group_nodes(suppression.groups)
            for d in suppression.directions:
                blocked[leader[6 * nodes + d]] = True
        kept = np.flatnonzero((leader == np.arange(self.n_full)) & ~blocked)
        column = np.full(self.n_full, -1)
        column[kept] = np.arange(len(kept))
        target = column[leader]
        rows = np.flatnonzero(target >= 0)
        expansion = sp.csr_array((np.ones(len(rows)), (rows, target[rows])), shape=(self.n_full, len(kept)))
        return DofMap(expansion, kept // 6, kept % 6)

    def mesh(self) -> Mesh:
        """Nodes and lines for figures."""
        return Mesh(self.points, self.ends, tuple(self.members[m].group for m in self.member_of))

    def beams(
        self, groups: Iterable[str] | None = None, chosen: np.ndarray | None = None
    ) -> tuple[sp.csr_array, sp.csr_array]:
        """Stiffness and consistent mass (n_full, n_full) of the named groups, all by default.

        ``chosen`` (n_elements,), bool, keeps only some of their elements.
        """
        stiff, heavy = [], []
        for elements, member, length, rotation, arms in self._chunks(groups, chosen):
            k, m = beam.stiffness(member.section, length), beam.mass(member.section, length)
            for where, released in self._releases(member, len(elements)):
                k[where], m[where] = beam.release(k[where], m[where], released)
            kept = np.ones(len(elements), dtype=bool) if chosen is None else chosen[elements]
            stiff.append((elements[kept], beam.to_global(k, rotation, arms)[kept]))
            heavy.append((elements[kept], beam.to_global(m, rotation, arms)[kept]))
        return self._assemble(stiff), self._assemble(heavy)

    def added_mass(self, groups: Iterable[str], distributed: bool) -> sp.csr_array:
        """Mass matrix (n_full, n_full) of 1 kg/m on the named groups, consistently distributed or lumped at nodes."""
        parts = []
        for elements, member, length, rotation, arms in self._chunks(groups):
            if distributed:
                m = beam.distributed_mass(member.section, length, 1.0)
            else:
                m = beam.lumped_mass(length, 1.0)
            parts.append((elements, beam.to_global(m, rotation, arms)))
        return self._assemble(parts)

    def _follow(self, e: int, length: np.ndarray) -> np.ndarray:
        """Local end motions of element ``e`` over those of its nodes, (12, 12); they differ at hinges."""
        follow = np.eye(12)
        elements = np.flatnonzero(self.member_of == self.member_of[e])
        member = self.members[self.member_of[e]]
        hinges = [released for where, released in self._releases(member, len(elements)) if e in elements[where]]
        if hinges:
            k = beam.stiffness(member.section, length)
            for released in hinges:
                t = beam.released_motion(k, released)
                k = beam.congruent(k, t)
                follow = follow @ t[0]
        return follow

    def _chunks(
        self, groups: Iterable[str] | None, chosen: np.ndarray | None = None
    ) -> Iterator[tuple[np.ndarray, Member, np.ndarray, np.ndarray, np.ndarray]]:
        """Members of the named groups with all their elements; those without a chosen one are passed over."""
        wanted = None if groups is None else set(groups)
        if wanted is not None:
            known_groups(wanted, {m.group for m in self.members})
        for m, member in enumerate(self.members):
            if wanted is not None and member.group not in wanted:
                continue
            elements = np.flatnonzero(self.member_of == m)
            if chosen is not None and not chosen[elements].any():
                continue
            arms = np.broadcast_to(np.array(member.arm), (len(elements), 2, 3))
            length, rotation = beam.axes(
                self.points[self.ends[elements, 0]], self.points[self.ends[elements, 1]], np.array(member.up)
            )
            yield elements, member, length, rotation, arms

    @staticmethod
    def _releases(member: Member, n: int) -> Iterator[tuple[slice, np.ndarray]]:
        for at, motions, shift in ((0, member.released_start, 0), (n - 1, member.released_end, 6)):
            if motions:
                released = np.zeros(12, dtype=bool)
                released[[shift + d for d in motions]] = True
                yield slice(at, at + 1), released

    def _assemble(self, parts: list[tuple[np.ndarray, np.ndarray]]) -> sp.csr_array:
        n = self.n_full
        if not parts:
            return sp.csr_array((n, n))
        elements = np.concatenate([e for e, _ in parts])
        return assemble(self.ends[elements], np.concatenate([b for _, b in parts]), n)


def indices_of(parts: Sequence[tuple[str, str]], owner: np.ndarray) -> dict[str | None, np.ndarray]:
    """Indices of the elements of every body and group that has any, and of all elements under None.

    Parameters
    ----------
    parts : sequence of (body, group)
        Of every owner.
    owner : ndarray (n_elements,) of int
    """
    if not len(owner):
        return {}
    out: dict[str | None, np.ndarray] = {None: np.arange(len(owner))}
    for name in {name for both in parts for name in both}:
        found = np.flatnonzero(np.array([name in both for both in parts])[owner])
        if len(found):
            out[name] = found
    return out


def known_groups(wanted: set[str], groups: Iterable[str]) -> None:
    """Raise InputError for a wanted name that is not a group."""
    unknown = wanted - set(groups)
    if unknown:
        raise InputError(f"there is no group {sorted(unknown)[0]!r}", place="frame")
