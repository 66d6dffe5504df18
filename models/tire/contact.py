"""Frictionless contact with flat ground: complementarity solved by an active set inside Newton's method."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy import sparse

from calib import EvaluationError, InputError
from models.tire.band import BandFactor
from models.tire.grid import Grid
from models.tire.inflated import TOLERANCE, Inflated, node_motion

MAX_STEPS = 30
"""Of Newton's method."""


@dataclass(frozen=True)
class Ground:
    """Flat ground below an inflated tire.

    Attributes
    ----------
    inflated : Inflated
    compliance : float or (n_candidates,) ndarray
        Of the tread, m/Pa (thickness over modulus, Winkler); 0 is rigid.
    """

    inflated: Inflated
    compliance: float | np.ndarray = 0.0

    def __post_init__(self) -> None:
        least = np.min(self.compliance)
        if not np.isfinite(self.compliance).all() or least < 0.0:
            raise InputError(f"the tread compliance is {least:g} m/Pa, allowed is 0 and above")
        if self.inflated.wall.grid.n_hoop < 8:
            raise InputError(
                f"{self.inflated.wall.grid.n_hoop} hoop cells cannot show a contact patch", remedy="take at least 8"
            )

    @property
    def nodes(self) -> np.ndarray:
        """Nodes that can touch the ground, (n_candidates,): the lower half between the beads."""
        return _candidates(self.inflated.wall.grid)[0]

    @property
    def area(self) -> np.ndarray:
        """Area of the candidates, (n_candidates,), m2."""
        return self.inflated.wall.grid.area_node.ravel()[self.nodes]

    @property
    def softness(self) -> np.ndarray:
        """Indentation of the tread at each candidate per force, (n_candidates,), m/N."""
        return self.compliance / self.area

    @property
    def rows(self) -> sparse.csr_array:
        """Displacement of the candidates towards the ground, (n_candidates, n_dof).

        The ground's force is vertical and so is this displacement: a force along the wall's normal would not be the
        derivative of the energy by the deflection.
        """
        return _candidates(self.inflated.wall.grid)[1]

    @property
    def rest(self) -> np.ndarray:
        """Height below the axle of the undeformed candidates, (n_candidates,), m."""
        return _candidates(self.inflated.wall.grid)[2]


@lru_cache(maxsize=8)
def _candidates(grid: Grid) -> tuple[np.ndarray, sparse.csr_array, np.ndarray]:
    """Nodes, rows and heights of a grid's candidates, see `Ground`."""
    lower = (np.cos(grid.theta_node) > 0.0)[None, :]
    free = (grid.numbers[2][:, :1] >= 0) & lower
    nodes = np.flatnonzero(np.broadcast_to(free, grid.numbers[2].shape))
    theta = grid.theta_node[nodes % grid.n_hoop]
    height, _, around = node_motion(grid)
    rows = sparse.diags_array(np.cos(theta)) @ height[nodes] - sparse.diags_array(np.sin(theta)) @ around[nodes]
    return nodes, rows.tocsr(), grid.profile.r(grid.s_node)[nodes // grid.n_hoop] * np.cos(theta)


@dataclass(frozen=True)
class Pressed:
    """Equilibrium of a tire pressed on flat ground.

    Attributes
    ----------
    ground : Ground
    deflection : float
        Approach of axle and ground after first touch, m.
    displacement : (n_dof,) ndarray
        m, inflation included.
    force : (n_candidates,) ndarray
        Vertical contact force at each of ``ground.nodes``, N, never negative.
    stiffness : float
        Derivative of the load by the deflection, N/m.
    iterations : int
        Newton steps.
    """

    ground: Ground
    deflection: float
    displacement: np.ndarray
    force: np.ndarray = field(repr=False)
    stiffness: float
    iterations: int

    @property
    def load(self) -> float:
        """Vertical load, N."""
        return float(self.force.sum())

    @property
    def loaded_radius(self) -> float:
        """Distance from axle to ground, m."""
        return self.ground.inflated.radius - self.deflection

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure over the area of each candidate, (n_candidates,), Pa."""
        return self.force / self.ground.area

    @property
    def gap(self) -> np.ndarray:
        """Gap between each candidate and the ground, (n_candidates,), m; negative by what the tread gives way."""
        return self.loaded_radius - self.ground.rest - self.ground.rows @ self.displacement

    @property
    def largest_pressure(self) -> float:
        """Largest nodal contact pressure, Pa; see `largest_pressure_converges`."""
        return float(self.pressure.max())

    @property
    def largest_pressure_converges(self) -> bool:
        """Whether the largest pressure can converge with the mesh.

        A Kirchhoff shell on rigid ground has a line force at the patch's edge, so the nodal pressure there grows
        without limit as the mesh is refined; the compliance of a tread spreads it.
        """
        return bool(np.min(self.ground.compliance) > 0.0)

    @property
    def energy(self) -> float:
        """Potential energy U - pV and that of the tread, J."""
        wall, p = self.ground.inflated.wall, self.ground.inflated.pressure
        tread = float((self.force**2 * self.ground.softness).sum()) / 2
        return wall.energy(self.displacement, p) + tread

    @property
    def largest_rotation(self) -> float:
        """Largest rotation of the wall, rad, since it was laid out."""
        return float(np.abs(self.ground.inflated.wall.cells.strains(self.displacement, linear=True)[:, 6:]).max())


def equilibrium(ground: Ground, q: np.ndarray, active: np.ndarray, deflection: float) -> Pressed:
    """Equilibrium at a deflection by Newton's method.

    Parameters
    ----------
    ground : Ground
    q : (n_dof,) ndarray
        Displacement to start from, m.
    active : (n_candidates,) bool ndarray
        Nodes that touch, to start from.
    deflection : float
        m.

    Raises
    ------
    EvaluationError
        Where it does not converge.
    """
    wall, p = ground.inflated.wall, ground.inflated.pressure
    level = ground.inflated.radius - deflection
    length = wall.grid.profile.length
    for step in range(1, MAX_STEPS + 1):
        gradient, band = wall.tangent(q, p)
        linear = _Linearised(ground, q, gradient, band.factor(), level)
        was = active
        change, force, active, stiffness = linear.solve(active)
        q = q + change
        largest = np.abs(change).max()
        if not largest < length / 4:
            break
        if largest < TOLERANCE * length and (was == active).all():
            return Pressed(ground, deflection, q, force, stiffness, step)
    raise EvaluationError(f"Newton's method does not converge at a deflection of {deflection:g} m")


class _Linearised:
    """The contact problem of one tangent; the response to unit forces is kept from set to set."""

    def __init__(self, ground: Ground, q: np.ndarray, gradient: np.ndarray, factor: BandFactor, level: float):
        self.ground, self.factor = ground, factor
        self.free = factor.solve(-gradient)
        # Intrusion into the ground without contact forces.
        self.intrusion = ground.rest + ground.rows @ (q + self.free) - level
        self.known = np.zeros(ground.nodes.size, bool)
        self.shift = np.zeros((q.size, ground.nodes.size), order="F")
        self.response = np.zeros((ground.nodes.size, ground.nodes.size), order="F")

    def solve(self, active: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Displacement, forces, active set and stiffness of the linear complementarity problem.

        A primal-dual active set (Hintermueller, Ito and Kunisch 2002): forces that pull leave, nodes below the ground
        enter. Should sets return, one node at a time changes, the worst first.
        """
        active = active.copy()
        for attempt in range(400):
            self._learn(active)
            chosen = np.flatnonzero(active)
            force = np.zeros(active.size)
            matrix = self.response[np.ix_(chosen, chosen)]
            matrix = (matrix + matrix.T) / 2 + np.diag(self.ground.softness[chosen])
            stiffness = 0.0
            if chosen.size:
                both = np.linalg.solve(matrix, np.stack([self.intrusion[chosen], np.ones(chosen.size)], axis=1))
                force[chosen], stiffness = both[:, 0], float(both[:, 1].sum())
            below = self.intrusion - self.response[:, chosen] @ force[chosen]
            leave, enter = active & (force <= 0.0), ~active & (below > 1e-12)
            if not (leave.any() or enter.any()):
                return self.free - self.shift[:, chosen] @ force[chosen], force, active, stiffness
            if attempt < 40:
                active = (active & ~leave) | enter
            elif leave.any():
                active[np.argmin(np.where(leave, force, np.inf))] = False
            else:
                active[np.argmax(np.where(enter, below, -np.inf))] = True
        raise EvaluationError("the contact set does not settle")

    def _learn(self, active: np.ndarray) -> None:
        new = np.flatnonzero(active & ~self.known)
        if new.size:
            rows = self.ground.rows
            self.shift[:, new] = self.factor.solve(rows[new].T.toarray(order="F"))
            self.response[:, new] = rows @ self.shift[:, new]
            self.known[new] = True
