"""Structures: a frame whose members and panels of shell share one table of nodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from calib import InputError
from calib.structure import Mesh
from models.fem import shell, surface
from models.fem.frame import Carrier, Frame, indices_of, known_groups
from models.fem.nodes import MERGE, NodeTable, assemble
from models.fem.panel import Panel
from models.fem.quad import Quads, projected
from models.fem.rbe3 import Rbe3
from models.fem.walls import evened


class ShellMatrices(NamedTuple):
    """Contributions to the matrices of shells, each (n_full, n_full), at the values of their sheets.

    With the thickness t and a common factor E on all moduli: membrane, shear and drilling are proportional to E t,
    bending to RMI E t^3, mass to t and rotary inertia to t^3.
    """

    membrane: sp.csr_array
    bending: sp.csr_array
    shear: sp.csr_array
    drilling: sp.csr_array
    mass: sp.csr_array
    rotary: sp.csr_array

    @property
    def stiffness(self) -> sp.csr_array:
        """Sum of the four contributions."""
        return sp.csr_array(self.membrane + self.bending + self.shear + self.drilling)


@dataclass(frozen=True)
class Structure(Frame):
    """Members and panels, ties and suppressions, cut into elements.

    Members and panels of one body share the nodes where they meet. A node on an element's edge that is not a corner of
    it would leave a gap and is refused.

    Attributes
    ----------
    panels : tuple of Panel
    rbe3s : tuple of Rbe3
        Distributing couplings; springs, masses and sensors attach to them by name.
    reach : float
        Largest distance beside a free edge at which a panel still carries a point, m.
    """

    panels: tuple[Panel, ...] = ()
    rbe3s: tuple[Rbe3, ...] = ()
    reach: float = 0.05
    corners: np.ndarray = field(init=False, repr=False, compare=False)
    panel_of: np.ndarray = field(init=False, repr=False, compare=False)
    _quads: Quads = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = Counter([*self.groups, *set(self.bodies), *(s.name for s in self.rbe3s)])
        for rbe3 in self.rbe3s:
            if taken[rbe3.name] > 1:
                raise InputError("another part has its name", place=f"RBE3 {rbe3.name!r}", remedy="rename it")
        nodes = self.points[self.corners]
        flat = [projected(nodes[self.panel_of == k], _along(p), p.place) for k, p in enumerate(self.panels)]
        object.__setattr__(self, "_quads", evened(Quads.joined(flat), self.corners, self.panel_of))
        if flat:
            self._refuse_gaps()

    def _fill(self, table: NodeTable) -> None:
        super()._fill(table)
        corners, owner = [np.zeros((0, 4), dtype=int)], [np.zeros(0, dtype=int)]
        for k, panel in enumerate(self.panels):
            places, local = panel.elements()
            numbers = np.array([table.number(panel.body, place) for place in places])
            corners.append(numbers[local])
            owner.append(np.full(len(local), k))
        object.__setattr__(self, "corners", np.concatenate(corners))
        object.__setattr__(self, "panel_of", np.concatenate(owner))

    def _refuse_gaps(self) -> None:
        from scipy.spatial import KDTree  # slow to import, and frames need none

        edges = np.unique(surface.edges(self.corners), axis=0)
        start, end = self.points[edges[:, 0]], self.points[edges[:, 1]]
        length = np.linalg.norm(end - start, axis=1)
        near = KDTree(self.points).query_ball_point((start + end) / 2, length / 2 - MERGE)
        which = np.repeat(np.arange(len(edges)), [len(n) for n in near])
        if not len(which):
            return
        node = np.concatenate([np.array(n, dtype=int) for n in near if n])
        body = np.unique(np.array(self.bodies), return_inverse=True)[1].ravel()
        beside = np.linalg.norm(np.cross(self.points[node] - start[which], (end - start)[which]), axis=1)
        bad = np.flatnonzero((beside <= 10 * MERGE * length[which]) & (body[node] == body[edges[which, 0]]))
        if len(bad):
            x, y, z = self.points[node[bad[0]]]
            raise InputError(
                f"the node at ({x:.4g}, {y:.4g}, {z:.4g}) is on the edge of a shell element but is not a corner of it",
                place=f"body {self.bodies[node[bad[0]]]}",
                remedy="give panels and members that meet the same lines and the same refinement there",
            )

    # -- places --------------------------------------------------------------------------------------------------------

    @property
    def groups(self) -> frozenset[str]:
        """Names of all groups, of members and of panels."""
        return super().groups | {p.group for p in self.panels}

    @property
    def parts(self) -> frozenset[str]:
        """Names of everything that carries points: bodies, groups and RBE3s."""
        return super().parts | {s.name for s in self.rbe3s}

    def motion(self, point: Sequence[float] | np.ndarray, on: str | None = None) -> tuple[np.ndarray, float]:
        """Six motions (6, n_full) of a point, and the length in m of the rigid arm that ties it to the structure.

        An RBE3 is a rigid body: it carries any point, at a distance of 0. For all other parts, panels included, see
        `Frame.motion`. InputError for a point beside a panel's edge.
        """
        for rbe3 in self.rbe3s:
            if rbe3.name == on:
                return rbe3.motion(self, np.asarray(point, dtype=float)), 0.0
        return super().motion(point, on)

    def _touched(self, wanted: set[str]) -> np.ndarray:
        own = np.array([p.group in wanted for p in self.panels], dtype=bool)[self.panel_of]
        return np.concatenate([super()._touched(wanted), self.corners[own].ravel()])

    def _carriers(self, p: np.ndarray, on: str | None) -> list[Carrier]:
        found = super()._carriers(p, on)
        chosen = self._shells_of.get(on)
        if chosen is None:
            return found
        quads = self._quads_of(on)
        foot = surface.foot(quads, p)
        distance = float(np.linalg.norm(p - foot.place))
        problem = None
        if foot.edge >= 0 and foot.beside > self.reach:
            free = surface.free_edges(self.corners[chosen])[foot.element, foot.edge]
            if free:
                x, y, z = p
                problem = InputError(
                    f"the point ({x:.4g}, {y:.4g}, {z:.4g}) lies {foot.beside:.3g} m beside the edge of its panel",
                    place=self.panels[self.panel_of[chosen[foot.element]]].place,
                    remedy=f"move it within {self.reach:g} m of the panel, or name the part that carries it",
                )
        carrier = Carrier(distance, self.corners[chosen[foot.element]], surface.motion(quads, foot, p), problem)
        return [*found, carrier]

    @cached_property
    def _shells_of(self) -> dict[str | None, np.ndarray]:
        """Indices of the shells of every body and group that has any, and of all shells under None."""
        return indices_of([(p.body, p.group) for p in self.panels], self.panel_of)

    @cached_property
    def _taken(self) -> dict[str | None, Quads]:
        """Shells of the parts used so far."""
        return {}

    def _quads_of(self, on: str | None) -> Quads:
        """The shells of a part, selected once."""
        if on not in self._taken:
            self._taken[on] = self._quads.some(self._shells_of[on])
        return self._taken[on]

    # -- degrees of freedom and matrices -------------------------------------------------------------------------------

    def mesh(self) -> Mesh:
        """Nodes, lines and faces for figures; lines are the members, and the edges of shells that no member covers."""
        frame = super().mesh()
        edges = surface.edges(self.corners)
        owner = np.repeat(self.panel_of, 4)
        both = np.concatenate([np.sort(self.ends, axis=1), edges])
        _, first = np.unique(both, axis=0, return_index=True)
        kept = np.sort(first[first >= len(self.ends)]) - len(self.ends)
        groups = tuple(self.panels[owner[k]].group for k in kept)
        return Mesh(
            self.points,
            np.concatenate([frame.lines, edges[kept]]),
            frame.groups + groups,
            self.corners,
            tuple(self.panels[k].group for k in self.panel_of),
        )

    def area(self, groups: Iterable[str]) -> float:
        """Area of the panels of the named groups without their openings, m2."""
        return float(sum(quads.area.sum() for _, quads, _, _ in self._panels(groups, None)))

    def shells(self, groups: Iterable[str] | None = None, chosen: np.ndarray | None = None) -> ShellMatrices:
        """Matrices of the shells of the named groups, all by default.

        ``chosen`` (n_shells,), bool, keeps only some of their elements.
        """
        zero = sp.csr_array((self.n_full, self.n_full))
        sums = [zero] * len(ShellMatrices._fields)
        for panel, quads, t, nodes in self._panels(groups, chosen):
            sheet = panel.sheet
            heavy = sheet.density * sheet.thickness
            blocks = (
                *shell.stiffness(quads, sheet),
                shell.mass(quads, heavy),
                shell.mass(quads, 0.0, heavy * sheet.thickness**2 / 12),
            )
            sums = [
                sp.csr_array(whole + assemble(nodes, shell.to_global(block, t), self.n_full))
                for whole, block in zip(sums, blocks, strict=True)
            ]
        for matrix in sums:
            matrix.eliminate_zeros()
        return ShellMatrices(*sums)

    def area_mass(self, groups: Iterable[str]) -> sp.csr_array:
        """Mass matrix (n_full, n_full) of 1 kg/m2 on the panels of the named groups."""
        out = sp.csr_array((self.n_full, self.n_full))
        for _, quads, t, nodes in self._panels(groups, None):
            out = sp.csr_array(out + assemble(nodes, shell.to_global(shell.mass(quads, 1.0), t), self.n_full))
        out.eliminate_zeros()
        return out

    def _panels(
        self, groups: Iterable[str] | None, chosen: np.ndarray | None
    ) -> Iterator[tuple[Panel, Quads, np.ndarray, np.ndarray]]:
        """Panels of the named groups with their elements, transformations and nodes."""
        wanted = None if groups is None else set(groups)
        if wanted is not None:
            known_groups(wanted, {p.group for p in self.panels})
        for k, panel in enumerate(self.panels):
            own = self.panel_of == k if chosen is None else (self.panel_of == k) & chosen
            if (wanted is None or panel.group in wanted) and own.any():
                quads = self._quads.some(np.flatnonzero(own))
                yield panel, quads, quads.transformation(), self.corners[own]


def _along(panel: Panel) -> np.ndarray | None:
    return None if panel.along is None else np.array(panel.along, dtype=float)
