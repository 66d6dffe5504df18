"""Elastic energy of quarter cells: gradient and tangent with moderate rotations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from models.tire.band import SymmetricBand
from models.tire.grid import Grid
from models.tire.strains import StrainRows

_BY_CELL = ("dofs", "rows", "share", "stiffness", "area", "node", "corner")
STRAINS = ("e1", "e2", "g12", "c1", "c2", "t12")  # the order of N and M


@dataclass(frozen=True)
class BandLayout:
    """Where the entries of all cells' matrices go in the band of the whole.

    Attributes
    ----------
    chosen : (n_entries,) int ndarray
        Of the raveled (n_cells, n_local, n_local) entries, those of the lower triangle.
    target : (n_entries,) int ndarray
        Place of each in the raveled (n_dof, bandwidth + 1) columns.
    bandwidth : int
    """

    chosen: np.ndarray
    target: np.ndarray
    bandwidth: int

    @classmethod
    def of(cls, dofs: np.ndarray, used: np.ndarray) -> BandLayout:
        """Layout for degrees of freedom (n_cells, n_local), of which some entries are used."""
        row, col = dofs[:, :, None], dofs[:, None, :]
        valid = used[:, :, None] & used[:, None, :] & (row >= col)
        chosen = np.flatnonzero(valid)
        row, col = (np.broadcast_to(x, valid.shape).ravel()[chosen] for x in (row, col))
        bandwidth = int((row - col).max())
        return cls(chosen, col * (bandwidth + 1) + (row - col), bandwidth)


@dataclass(frozen=True)
class Cells:
    """Every quarter cell joins one node, one corner, one place of u and one of v, hence one value of each strain.

    The quadratic form of its six strains is the laminate's own, so the energy is positive also with extension-shear
    coupling, which nodes and corners apart could not guarantee.

    Attributes
    ----------
    dofs : (n_cells, n_local) int ndarray
        Degrees of freedom of each cell; unused entries have zero rows.
    rows : (n_cells, 12, n_local) ndarray
        Rows of the six strains, then of six rotations: b1 before and after the node, b2 before and after the node,
        mean b1 and mean b2 at the corner.
    share : (n_cells,) ndarray
        Part of the node's hoop angle that lies before it.
    stiffness : (n_cells, 6, 6) ndarray
        Laminate stiffness, N/m, N and N m.
    area : (n_cells,) ndarray
        m2.
    node, corner : (n_cells,) int ndarray
        Which node and corner the cell joins.
    n_dof : int
    band : BandLayout
    """

    dofs: np.ndarray
    rows: np.ndarray
    share: np.ndarray
    stiffness: np.ndarray
    area: np.ndarray
    node: np.ndarray
    corner: np.ndarray
    n_dof: int
    band: BandLayout

    @classmethod
    def build(cls, grid: Grid, rows: StrainRows, stiffness: np.ndarray) -> Cells:
        """Gather the rows of every quarter cell.

        Parameters
        ----------
        grid : Grid
        rows : StrainRows
        stiffness : (2 n_meridian, 6, 6) ndarray
            Laminate stiffness at ``grid.s_quarter``.
        """
        n, m = grid.n_meridian, grid.n_hoop
        # Half cells along the meridian: node i and half place; around the hoop: node j and half place.
        k, side, j = np.meshgrid(np.arange(2 * n), np.arange(2), np.arange(m), indexing="ij")
        half, i, along = k // 2, (k + 1) // 2, (j - side) % m
        node, corner = (i * m + j).ravel(), (half * m + along).ravel()
        # Beyond a clamped bead b1 is odd, and its square the same as before it.
        before, after = np.maximum(i - 1, 0), np.minimum(i, n - 1)
        mean_b1 = (grid.both(sparse.eye_array(n), grid.at_up) @ rows.b1).tocsr()
        mean_b2 = (grid.both(grid.as_up) @ rows.b2).tocsr()
        gathered = [
            *(getattr(rows, name)[corner if name in ("g12", "t12") else node] for name in STRAINS),
            *(rows.b1[(place * m + j).ravel()] for place in (before, after)),
            *(rows.b2[(i * m + place % m).ravel()] for place in (j - 1, j)),
            mean_b1[corner],
            mean_b2[corner],
        ]
        parts = [part.tocoo() for part in gathered]
        keys = [part.row.astype(np.int64) * grid.n_dof + part.col for part in parts]
        every = np.unique(np.concatenate(keys))
        cell, dof = every // grid.n_dof, every % grid.n_dof
        start = np.searchsorted(cell, np.arange(node.size))
        slot = np.arange(every.size) - start[cell]
        dofs = np.zeros((node.size, slot.max() + 1), int)
        used = np.zeros(dofs.shape, bool)
        dofs[cell, slot], used[cell, slot] = dof, True
        local = np.zeros((node.size, len(parts), dofs.shape[1]))
        for number, (part, key) in enumerate(zip(parts, keys, strict=True)):
            local[part.row, number, slot[np.searchsorted(every, key)]] = part.data
        # A quarter's angle is half the step between its node and the next or last one.
        area = (grid.rings[k] * grid.step_half[along] / 2).ravel()
        share = (np.roll(grid.step_half, 1) / (2 * grid.step_node))[j].ravel()
        return cls(dofs, local, share, stiffness[k.ravel()], area, node, corner, grid.n_dof, BandLayout.of(dofs, used))

    def with_stiffness(self, stiffness: np.ndarray) -> Cells:
        """The same cells with another laminate stiffness (2 n_meridian, 6, 6), as in `build`."""
        return replace(self, stiffness=self.each(stiffness))

    def each(self, stiffness: np.ndarray) -> np.ndarray:
        """Stiffness of every cell, (n_cells, 6, 6), from that along the meridian, (2 n_meridian, 6, 6)."""
        return np.repeat(stiffness, len(self.dofs) // len(stiffness), axis=0)

    # Kinematics -------------------------------------------------------------------------------------------------------
    def strains(self, q: np.ndarray, linear: bool = False) -> np.ndarray:
        """Strains (n_cells, 6) and rotations (n_cells, 6) side by side.

        The squares are means over the places around a node. With one square in each quarter a wall that hardly
        stretches could hardly bend either.

        Parameters
        ----------
        q : (n_dof,) ndarray
            m.
        linear : bool
            Leave out the squares of the rotations.
        """
        out = np.einsum("ckm,cm->ck", self.rows, q[self.dofs])
        if not linear:
            squares = out[:, 6:10] ** 2
            out[:, 0] += (squares[:, 0] + squares[:, 1]) / 4
            out[:, 1] += (self.share * squares[:, 2] + (1 - self.share) * squares[:, 3]) / 2
            out[:, 2] += out[:, 10] * out[:, 11]
        return out

    def resultants(self, q: np.ndarray, linear: bool = False) -> np.ndarray:
        """Forces N1, N2, N12 (N/m) and moments M1, M2, M12 (N), (n_cells, 6)."""
        return np.einsum("ckl,cl->ck", self.stiffness, self.strains(q, linear)[:, :6])

    def at_nodes(self, values: np.ndarray) -> np.ndarray:
        """Mean of cell values (n_cells, k) over the cells of each node, (n_nodes, k)."""
        weight = np.bincount(self.node, self.area)
        return np.stack([np.bincount(self.node, self.area * column) / weight for column in values.T], axis=1)

    # Energy -----------------------------------------------------------------------------------------------------------
    def energy(self, q: np.ndarray) -> float:
        """Elastic energy, J."""
        strain = self.strains(q)[:, :6]
        return float(np.einsum("c,ck,ckl,cl->", self.area, strain, self.stiffness, strain, optimize=True) / 2)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        """Derivative of the energy, (n_dof,), N."""
        return self.at(q)(self.stiffness)

    def at(self, q: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The derivative of the energy as a linear function of the stiffness, (n_cells, 6, 6)."""
        strain = self.strains(q)
        rows = self._tangent_rows(strain)

        def gradient(stiffness: np.ndarray) -> np.ndarray:
            force = np.matmul(stiffness, strain[:, :6, None])[:, :, 0] * self.area[:, None]
            return self._spread(np.matmul(force[:, None, :], rows)[:, 0, :])

        return gradient

    def tangent(self, q: np.ndarray) -> tuple[np.ndarray, SymmetricBand]:
        """Gradient (n_dof,), N, and second derivative of the energy, N/m."""
        strain = self.strains(q)
        rows = self._tangent_rows(strain)
        force = np.einsum("ckl,cl->ck", self.stiffness, strain[:, :6]) * self.area[:, None]
        gradient = self._spread(np.einsum("ckm,ck->cm", rows, force))
        return gradient, self._band(rows, self._weighted, force)

    def linear_stiffness(self) -> SymmetricBand:
        """Stiffness of the unstressed wall, N/m."""
        return self._band(self.rows[:, :6], self._weighted, np.zeros((self.area.size, 6)))

    def geometric_stiffness(self, resultants: np.ndarray) -> SymmetricBand:
        """Stiffness of the membrane forces (n_cells, 6), of which the first three count, N/m."""
        nothing = np.zeros_like(self.stiffness)
        return self._band(self.rows[:, :6], nothing, resultants * self.area[:, None])

    @cached_property
    def _weighted(self) -> np.ndarray:
        return self.stiffness * self.area[:, None, None]

    def _tangent_rows(self, strain: np.ndarray) -> np.ndarray:
        out = self.rows[:, :6].copy()
        b = strain[:, 6:, None]
        share, row = self.share[:, None], self.rows[:, 6:]
        out[:, 0] += (b[:, 0] * row[:, 0] + b[:, 1] * row[:, 1]) / 2
        out[:, 1] += share * b[:, 2] * row[:, 2] + (1 - share) * b[:, 3] * row[:, 3]
        out[:, 2] += b[:, 4] * row[:, 5] + b[:, 5] * row[:, 4]
        return out

    def _spread(self, local: np.ndarray) -> np.ndarray:
        return np.bincount(self.dofs.ravel(), local.ravel(), minlength=self.n_dof)

    def local_tangent(self, q: np.ndarray) -> np.ndarray:
        """Second derivative of each cell's energy, (n_cells, n_local, n_local), N/m; linear in the stiffness."""
        strain = self.strains(q)
        force = np.einsum("ckl,cl->ck", self.stiffness, strain[:, :6]) * self.area[:, None]
        return self._local(self._tangent_rows(strain), self._weighted, force)

    def _local(self, rows: np.ndarray, stiffness: np.ndarray, force: np.ndarray) -> np.ndarray:
        stress = np.zeros((force.shape[0], 6, 6))
        stress[:, 0, 0] = stress[:, 1, 1] = force[:, 0] / 2
        stress[:, 2, 2], stress[:, 3, 3] = self.share * force[:, 1], (1 - self.share) * force[:, 1]
        stress[:, 4, 5] = stress[:, 5, 4] = force[:, 2]
        local = np.matmul(rows.transpose(0, 2, 1), np.matmul(stiffness, rows))
        turned = self.rows[:, 6:]
        local += np.matmul(turned.transpose(0, 2, 1), np.matmul(stress, turned))
        return local

    def _band(self, rows: np.ndarray, stiffness: np.ndarray, force: np.ndarray) -> SymmetricBand:
        entry = self._local(rows, stiffness, force).ravel()[self.band.chosen]
        flat = np.bincount(self.band.target, entry, minlength=(self.band.bandwidth + 1) * self.n_dof)
        return SymmetricBand(flat.reshape(self.n_dof, self.band.bandwidth + 1).T)

    def every(self, step: int) -> Cells:
        """Each ``step``-th cell, the first included; with a step of the hoop cells it is one sector."""
        taken = {name: getattr(self, name)[::step] for name in _BY_CELL}
        return replace(self, **taken)

    def banded(self, matrix: sparse.sparray) -> SymmetricBand:
        """Return a symmetric sparse matrix in the band of the cells."""
        part = sparse.tril(matrix).tocoo()
        lower = np.zeros((self.n_dof, self.band.bandwidth + 1))
        lower[part.col, part.row - part.col] = part.data
        return SymmetricBand(lower.T)
