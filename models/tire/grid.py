"""Staggered grid of a clamped tire wall: places, 1-D operators, areas and numbering of degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from calib import InputError


class Meridian(Protocol):
    """What the grid asks of a profile: arc length s in [0, length] (m), both beads included."""

    length: float

    def r(self, s): ...  # noqa: D102  radius, m
    def z(self, s): ...  # noqa: D102  axial position, m
    def dr(self, s): ...  # noqa: D102  slope of the radius
    def dz(self, s): ...  # noqa: D102  slope of the axial position
    def k1(self, s): ...  # noqa: D102  curvature of the meridian, 1/m
    def k2(self, s): ...  # noqa: D102  curvature of the hoop, 1/m


@dataclass(frozen=True)
class Grid:
    """Marker-and-cell grid on a surface of revolution, beads clamped.

    w stands at the nodes (i, j), u half a cell further along the meridian, v half a cell further along the hoop; the
    staggering leaves no checkerboard mode without energy, as nested central differences would.

    Attributes
    ----------
    profile : Meridian
    n_meridian : int
        Cells from bead to bead; even numbers have nodes on the crown.
    n_hoop : int
        Cells around; 1 is the axisymmetric reduction of the same operators.
    grading : float
        In [0, 1); the hoop spacing at the patch is ``1 - grading`` times the mean, opposite ``1 + grading`` times.

    Raises
    ------
    InputError
        For fewer than 4 meridian cells, no hoop cell, or a grading outside [0, 1).
    """

    profile: Meridian
    n_meridian: int
    n_hoop: int = 1
    grading: float = 0.8

    def __post_init__(self) -> None:
        if self.n_meridian < 4 or self.n_hoop < 1:
            raise InputError(
                f"a grid of {self.n_meridian} x {self.n_hoop} cells is too small", remedy="take at least 4 x 1 cells"
            )
        if not 0.0 <= self.grading < 1.0:
            raise InputError(f"grading of the grid is {self.grading:g}, allowed is 0 to below 1")

    # Places -----------------------------------------------------------------------------------------------------------
    @cached_property
    def spacing(self) -> float:
        """Meridian cell length, m."""
        return self.profile.length / self.n_meridian

    @cached_property
    def s_node(self) -> np.ndarray:
        """Arc length at nodes, (n_meridian + 1,), m."""
        return np.linspace(0.0, self.profile.length, self.n_meridian + 1)

    @cached_property
    def s_half(self) -> np.ndarray:
        """Arc length at half places, (n_meridian,), m."""
        return (self.s_node[:-1] + self.s_node[1:]) / 2

    @cached_property
    def s_quarter(self) -> np.ndarray:
        """Arc length at the centres of half cells, (2 n_meridian,), m: after node 0, before node 1, and so on."""
        return (np.arange(2 * self.n_meridian) + 0.5) * self.spacing / 2

    @cached_property
    def _edges(self) -> np.ndarray:
        """Node angles with one more turn on both sides, (n_hoop + 2,), rad; the patch is at 0."""
        if self.n_hoop == 1:
            return 2 * np.pi * np.arange(-1.0, 2.0)
        x = np.arange(-1, self.n_hoop + 1) / self.n_hoop
        return 2 * np.pi * x - self.grading * np.sin(2 * np.pi * x)

    @cached_property
    def theta_node(self) -> np.ndarray:
        """Hoop angle at nodes, (n_hoop,), rad; node 0 is the centre of the patch."""
        return self._edges[1:-1]

    @cached_property
    def theta_half(self) -> np.ndarray:
        """Hoop angle midway to the next node, (n_hoop,), rad."""
        return (self._edges[1:-1] + self._edges[2:]) / 2

    @cached_property
    def step_half(self) -> np.ndarray:
        """Angle from each node to the next, (n_hoop,), rad."""
        return np.diff(self._edges)[1:]

    @cached_property
    def step_node(self) -> np.ndarray:
        """Angle between the half places around each node, (n_hoop,), rad."""
        return (self.step_half + np.roll(self.step_half, 1)) / 2

    # 1-D operators ----------------------------------------------------------------------------------------------------
    @cached_property
    def ds_up(self) -> sparse.csr_array:
        """Difference along the meridian, nodes to half places, 1/m."""
        n, h = self.n_meridian, self.spacing
        return sparse.diags_array([-1 / h, 1 / h], offsets=[0, 1], shape=(n, n + 1), format="csr")

    @cached_property
    def as_up(self) -> sparse.csr_array:
        """Average along the meridian, nodes to half places."""
        n = self.n_meridian
        return sparse.diags_array([0.5, 0.5], offsets=[0, 1], shape=(n, n + 1), format="csr")

    @cached_property
    def ds_down(self) -> sparse.csr_array:
        """Difference along the meridian, half places to nodes, 1/m; odd about the clamped beads."""
        n, h = self.n_meridian, self.spacing
        out = sparse.diags_array([-1 / h, 1 / h], offsets=[-1, 0], shape=(n + 1, n), format="lil")
        out[0, 0], out[n, n - 1] = 2 / h, -2 / h
        return out.tocsr()

    @cached_property
    def as_down(self) -> sparse.csr_array:
        """Average along the meridian, half places to nodes; zero at the clamped beads."""
        n = self.n_meridian
        out = sparse.diags_array([0.5, 0.5], offsets=[-1, 0], shape=(n + 1, n), format="lil")
        out[0, 0] = out[n, n - 1] = 0.0
        return out.tocsr()

    @cached_property
    def _ahead(self) -> sparse.csr_array:
        """Value of the next place around the hoop."""
        return sparse.eye_array(self.n_hoop, format="csr")[np.roll(np.arange(self.n_hoop), -1)]

    @cached_property
    def dt_up(self) -> sparse.csr_array:
        """Difference around the hoop, nodes to half places, 1/rad."""
        return self._scaled(1 / self.step_half, self._ahead - sparse.eye_array(self.n_hoop))

    @cached_property
    def dt_down(self) -> sparse.csr_array:
        """Difference around the hoop, half places to nodes, 1/rad."""
        return self._scaled(1 / self.step_node, sparse.eye_array(self.n_hoop) - self._ahead.T)

    @cached_property
    def at_up(self) -> sparse.csr_array:
        """Average around the hoop, nodes to half places."""
        return ((self._ahead + sparse.eye_array(self.n_hoop)) / 2).tocsr()

    @cached_property
    def at_down(self) -> sparse.csr_array:
        """Interpolation around the hoop, half places to nodes."""
        before = np.roll(self.step_half, 1)
        weight = before / (before + self.step_half)
        eye = sparse.eye_array(self.n_hoop)
        return self._scaled(weight, eye) + self._scaled(1 - weight, self._ahead.T)

    @staticmethod
    def _scaled(factor: np.ndarray, rows: sparse.sparray) -> sparse.csr_array:
        return (sparse.diags_array(factor) @ rows).tocsr()

    def both(self, along: sparse.sparray | None = None, around: sparse.sparray | None = None) -> sparse.csr_array:
        """2-D operator from a meridian and a hoop operator; None is the identity on nodes of the hoop.

        Parameters
        ----------
        along : sparse array or None
            Meridian operator; None is the identity on nodes.
        around : sparse array or None
            Hoop operator.
        """
        along = sparse.eye_array(self.n_meridian + 1) if along is None else along
        around = sparse.eye_array(self.n_hoop) if around is None else around
        return sparse.kron(along, around, format="csr")

    # Degrees of freedom -----------------------------------------------------------------------------------------------
    @cached_property
    def n_dof(self) -> int:
        """Number of degrees of freedom."""
        return self.n_hoop * (3 * self.n_meridian - 2)

    @cached_property
    def numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of u (n_meridian, n_hoop), v and w (n_meridian + 1, n_hoop); -1 at the clamped beads.

        Ring after ring, and within a ring alternately from both sides of the patch: the stiffness is then a narrow band
        although the hoop is closed.
        """
        n, m = self.n_meridian, self.n_hoop
        place = np.empty(m, int)
        place[[(k + 1) // 2 if k % 2 else -(k // 2) for k in range(m)]] = np.arange(m)
        ring, hoop = np.arange(n + 1)[:, None], place[None, :]
        u = 3 * m * ring[:-1] + np.where(ring[:-1] < n - 1, 3, 1) * hoop
        w = np.where((ring > 0) & (ring < n), 3 * m * (ring - 1) + 3 * hoop + 1, -1)
        v = np.where(w >= 0, w + 1, -1)
        return u, v, w

    @cached_property
    def take(self) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]:
        """Selections of u, v and w at all their places from the degrees of freedom, (n_places, n_dof) each."""
        out = []
        for number in self.numbers:
            rows = np.flatnonzero(number.ravel() >= 0)
            cols = number.ravel()[rows]
            out.append(sparse.csr_array((np.ones(rows.size), (rows, cols)), shape=(number.size, self.n_dof)))
        return tuple(out)

    def fields(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacements u, v, w at their places, shapes of `numbers`, m, from q (n_dof,)."""
        return tuple((take @ q).reshape(number.shape) for take, number in zip(self.take, self.numbers, strict=True))

    def gathered(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Degrees of freedom (n_dof,) from displacements that broadcast to their places; those at beads are dropped."""
        q = np.zeros(self.n_dof)
        for number, field in zip(self.numbers, (u, v, w), strict=True):
            free = number >= 0
            q[number[free]] = np.broadcast_to(field, number.shape)[free]
        return q

    # Areas ------------------------------------------------------------------------------------------------------------
    @cached_property
    def rings(self) -> np.ndarray:
        """Radius times length of each half cell along the meridian, (2 n_meridian,), m2."""
        return self.profile.r(self.s_quarter) * self.spacing / 2

    @cached_property
    def area_node(self) -> np.ndarray:
        """Area that belongs to each node, (n_meridian + 1, n_hoop), m2."""
        padded = np.concatenate([[0.0], self.rings, [0.0]])
        return (padded[::2] + padded[1::2])[:, None] * self.step_node

    @cached_property
    def area_u(self) -> np.ndarray:
        """Area that belongs to each place of u, (n_meridian, n_hoop), m2."""
        return (self.rings[::2] + self.rings[1::2])[:, None] * self.step_node

    @cached_property
    def area_v(self) -> np.ndarray:
        """Area that belongs to each place of v, (n_meridian + 1, n_hoop), m2."""
        padded = np.concatenate([[0.0], self.rings, [0.0]])
        return (padded[::2] + padded[1::2])[:, None] * self.step_half
