"""The tire inflated: equilibrium, growth, tangent stiffness and lowest modes, free of the ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse import linalg

from calib import EvaluationError, InputError
from models.tire.band import SymmetricBand
from models.tire.cells import Cells
from models.tire.grid import Grid
from models.tire.pressure import EnclosedVolume
from models.tire.strains import strain_rows

TOLERANCE = 1e-8  # of the meridian length, for the last Newton step
REFUSED_STRAIN = 0.3
"""Of a theory of small strains: their squares, which it leaves out, are then 15 % of them."""


@lru_cache(maxsize=40)
def _laid_out(grid: Grid) -> tuple[Cells, EnclosedVolume]:
    """What depends on the grid alone: cells of unit stiffness, and the enclosed volume."""
    rows = strain_rows(grid)
    unit = np.broadcast_to(np.eye(6), (2 * grid.n_meridian, 6, 6))
    return Cells.build(grid, rows, unit), EnclosedVolume.build(grid, rows)


@dataclass(frozen=True)
class Wall:
    """A tire's wall on a grid, at any pressure: energy U - pV with its derivatives.

    Attributes
    ----------
    grid : Grid
    cells : Cells
        Elastic energy.
    volume : EnclosedVolume
    areal_density : (2 n_meridian,) ndarray
        At ``grid.s_quarter``, kg/m2.
    follows : float
        Share of the pressure that follows the wall as it turns and stretches; at 0 it is a dead load.
    """

    grid: Grid
    cells: Cells
    volume: EnclosedVolume
    areal_density: np.ndarray
    follows: float = 1.0

    @classmethod
    def build(cls, grid: Grid, stiffness: np.ndarray, areal_density: np.ndarray, follows: float = 1.0) -> Wall:
        """Compose a wall from stiffness (2 n_meridian, 6, 6) and mass (2 n_meridian,) at ``grid.s_quarter``."""
        cells, volume = _laid_out(grid)
        return cls(grid, cells.with_stiffness(stiffness), volume, areal_density, follows)

    @cached_property
    def _pressure_band(self) -> SymmetricBand:
        return self.cells.banded(-self.volume.curvature)

    def push(self, q: np.ndarray) -> np.ndarray:
        """Force of a pressure of 1 Pa at displacements q, (n_dof,), m2."""
        return self.volume.load + self.follows * (self.volume.curvature @ q)

    def energy(self, q: np.ndarray, pressure: float) -> float:
        """Potential energy U - pV, J, at displacements q (n_dof,), m, and the pressure, Pa."""
        volume = self.volume.load @ q + self.follows * q @ (self.volume.curvature @ q) / 2
        return self.cells.energy(q) - pressure * float(volume)

    def gradient(self, q: np.ndarray, pressure: float) -> np.ndarray:
        """Unbalanced force, (n_dof,), N."""
        return self.cells.gradient(q) - pressure * self.push(q)

    def tangent(self, q: np.ndarray, pressure: float) -> tuple[np.ndarray, SymmetricBand]:
        """Unbalanced force, N, and tangent stiffness, N/m: elastic, geometric and pressure part."""
        gradient, band = self.cells.tangent(q)
        gradient -= pressure * self.push(q)
        return gradient, band + self._pressure_band * (pressure * self.follows)

    @cached_property
    def mass(self) -> np.ndarray:
        """Lumped mass at each degree of freedom, (n_dof,), kg."""
        grid = self.grid
        weighed = np.asarray(self.areal_density) * grid.rings
        padded = np.concatenate([[0.0], weighed, [0.0]])
        half, node = weighed[::2] + weighed[1::2], padded[::2] + padded[1::2]
        return grid.gathered(
            half[:, None] * grid.step_node, node[:, None] * grid.step_half, node[:, None] * grid.step_node
        )

    @property
    def height(self) -> sparse.csr_array:
        """Outward radial displacement of the nodes from the degrees of freedom, (n_nodes, n_dof)."""
        return node_motion(self.grid)[0]

    @property
    def axial(self) -> sparse.csr_array:
        """Axial displacement of the nodes from the degrees of freedom, (n_nodes, n_dof)."""
        return node_motion(self.grid)[1]

    @property
    def around(self) -> sparse.csr_array:
        """Hoop displacement of the nodes from the degrees of freedom, (n_nodes, n_dof)."""
        return node_motion(self.grid)[2]


@lru_cache(maxsize=40)
def node_motion(grid: Grid) -> tuple[sparse.csr_array, sparse.csr_array, sparse.csr_array]:
    """Radial, axial and hoop displacement of the nodes, see `Wall.height`."""
    u, v, w = grid.take
    u_node = grid.both(grid.as_down) @ u

    def turned(of_w: np.ndarray, of_u: np.ndarray) -> sparse.csr_array:
        normal, along = (grid.both(sparse.diags_array(np.asarray(factor, float))) for factor in (of_w, of_u))
        return (normal @ w + along @ u_node).tocsr()

    slope, across = grid.profile.dr(grid.s_node), grid.profile.dz(grid.s_node)
    around = (grid.both(None, grid.at_down) @ v).tocsr()
    return turned(across, slope), turned(-np.asarray(slope), across), around


@dataclass(frozen=True)
class Inflated:
    """Equilibrium under pressure, free of the ground; axisymmetric.

    Attributes
    ----------
    wall : Wall
    pressure : float
        Pa.
    displacement : (n_dof,) ndarray
        m.
    iterations : int
        Newton steps on the axisymmetric strip.
    strip : Wall
        The wall with one hoop cell.
    strip_displacement : (n_strip_dof,) ndarray
        m.
    """

    wall: Wall
    pressure: float
    displacement: np.ndarray
    iterations: int
    strip: Wall
    strip_displacement: np.ndarray

    @cached_property
    def radii(self) -> np.ndarray:
        """Radius of the nodes along the meridian, (n_meridian + 1,), m."""
        grid = self.wall.grid
        return grid.profile.r(grid.s_node) + (self.wall.height @ self.displacement).reshape(-1, grid.n_hoop)[:, 0]

    @property
    def radius(self) -> float:
        """Largest radius, m: what a deflection is measured from."""
        return float(self.radii.max())

    @property
    def growth(self) -> float:
        """Radius gained by inflation, m."""
        return self.radius - float(self.wall.grid.profile.r(self.wall.grid.s_node).max())

    @property
    def widening(self) -> float:
        """Width of the section gained by inflation, m; the widest place lies between nodes."""
        grid = self.wall.grid
        before = grid.profile.z(grid.s_node)
        after = before + (self.wall.axial @ self.displacement).reshape(-1, grid.n_hoop)[:, 0]
        fine = np.linspace(0.0, grid.profile.length, 40 * grid.n_meridian + 1)
        both = CubicSpline(grid.s_node, np.stack([before, after], axis=1))(fine)
        gained = np.ptp(both, axis=0)
        return float(gained[1] - gained[0])

    @cached_property
    def stiffness(self) -> SymmetricBand:
        """Tangent stiffness, N/m, (n_dof, n_dof) in its band."""
        return self.wall.tangent(self.displacement, self.pressure)[1]

    def modes(self, n_modes: int = 6) -> tuple[np.ndarray, np.ndarray]:
        """Lowest modes about the inflated state.

        Parameters
        ----------
        n_modes : int

        Returns
        -------
        frequencies : (n_modes,) ndarray
            Hz, ascending.
        shapes : (n_dof, n_modes) ndarray
            Mass normalised, 1/sqrt(kg).

        Raises
        ------
        EvaluationError
            Where the inflated state is unstable.
        """
        n = self.displacement.size
        if not 1 <= n_modes < n - 1:
            raise InputError(f"{n_modes} modes are requested of a tire with {n} degrees of freedom")
        factor = self.stiffness.factor()
        if not factor.positive_definite:
            raise EvaluationError("the inflated tire is unstable: its tangent stiffness is not positive definite")
        # Substituted by sqrt(M) the problem is standard, and the eigenvectors are orthonormal.
        root = np.sqrt(self.wall.mass)
        inverse = linalg.LinearOperator((n, n), matvec=lambda x: root * factor.solve(root * np.ravel(x)), dtype=float)
        start = np.random.default_rng(0).standard_normal(n)
        largest, vectors = linalg.eigsh(inverse, k=n_modes, which="LA", v0=start)
        order = np.argsort(-largest)
        return 1 / (2 * np.pi * np.sqrt(largest[order])), vectors[:, order] / root[:, None]


def inflate(wall: Wall, strip: Wall, pressure: float, max_steps: int = 40) -> Inflated:
    """Inflate by Newton's method on the axisymmetric strip and carry the state over to the whole wall.

    Parameters
    ----------
    wall : Wall
    strip : Wall
        The same wall with one hoop cell.
    pressure : float
        Pa.
    max_steps : int
        Newton steps allowed for each part of the pressure.

    Raises
    ------
    InputError
        For a negative pressure.
    EvaluationError
        Where no stable equilibrium is found, or the wall stretches beyond small strains.
    """
    if not np.isfinite(pressure) or pressure < 0.0:
        raise InputError(f"the inflation pressure is {pressure:g} Pa, allowed is 0 and above")
    length = strip.grid.profile.length
    q, steps = np.zeros(strip.grid.n_dof), 0
    reached, part = 0.0, 1.0
    while reached < 1.0:
        trial = _equilibrium(strip, q, pressure * min(1.0, reached + part), length, max_steps)
        if trial is None:
            part /= 2
            if part < 1 / 64:
                raise EvaluationError(
                    f"no stable equilibrium of the tire beyond {pressure * reached:g} Pa of {pressure:g} Pa"
                )
            continue
        q, used = trial
        steps += used
        reached = min(1.0, reached + part)
    stretch = float(np.abs(strip.cells.strains(q)[:, :2]).max())
    if stretch > REFUSED_STRAIN:
        raise EvaluationError(
            f"the wall stretches by {stretch:.0%} at {pressure:g} Pa, beyond small strains ({REFUSED_STRAIN:.0%})"
        )
    return Inflated(wall, pressure, spread(strip, wall, q), steps, strip, q)


def spread(strip: Wall, wall: Wall, q: np.ndarray) -> np.ndarray:
    """Displacement of a whole wall (n_dof,) from that of its axisymmetric strip (n_strip_dof,)."""
    return wall.grid.gathered(*strip.grid.fields(q))


def _equilibrium(
    wall: Wall, q: np.ndarray, pressure: float, length: float, max_steps: int
) -> tuple[np.ndarray, int] | None:
    """Newton's method at one pressure; None without a stable state that moves less than a third of the meridian."""
    for step in range(1, max_steps + 1):
        gradient, band = wall.tangent(q, pressure)
        try:
            factor = band.factor()
            change = factor.solve(-gradient)
        except EvaluationError:
            return None
        q = q + change
        if not np.abs(q).max() < length / 3:
            return None
        if np.abs(change).max() < TOLERANCE * length:
            return (q, step) if factor.positive_definite else None
    return None
