"""Derivatives of equilibria and modes by a parameter of the wall, from the tangent of the state at hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from models.tire.contact import Pressed
from models.tire.harmonics import HoopModes, of_order, pressure_of_order, rings, sector
from models.tire.inflated import Inflated, Wall, spread
from models.tire.tire import Tire

STEP = 1e-5
"""Of a difference, over the range of a parameter: of smooth formulas and of states that are moved along their
derivatives, none of which is solved again. The error is of the order of its square."""


@dataclass(frozen=True)
class Change:
    """Derivatives of a tire's data by a parameter that leaves profile and grid as they are.

    Attributes
    ----------
    stiffness : (2 n_meridian, 6, 6) ndarray
        Of the laminate at ``grid.s_quarter``.
    areal_density : (2 n_meridian,) ndarray
        kg/m2.
    compliance : float
        Of the tread, m/Pa.
    pressure : float
        Pa.
    follows : float
        Of the share of the pressure that follows the wall.
    """

    stiffness: np.ndarray
    areal_density: np.ndarray
    compliance: float = 0.0
    pressure: float = 0.0
    follows: float = 0.0


def change(tire: Callable[[float], Tire], value: float, lower: float, upper: float, s: np.ndarray) -> Change:
    """Change of a tire by a parameter: central differences of its formulas, one-sided of second order at a limit.

    Parameters
    ----------
    tire : callable
        The tire at a value of the parameter.
    value, lower, upper : float
    s : (2 n_meridian,) ndarray
        ``grid.s_quarter``, m.
    """
    h = STEP * (upper - lower)
    if value - h < lower:
        weights = {0: -1.5, 1: 2.0, 2: -0.5}
    elif value + h > upper:
        weights = {0: 1.5, -1: -2.0, -2: 0.5}
    else:
        weights = {1: 0.5, -1: -0.5}
    at = {k: tire(value + k * h) for k in weights}
    return Change(
        sum(weight / h * at[k].stiffness(s) for k, weight in weights.items()),
        sum(weight / h * at[k].areal_density(s) for k, weight in weights.items()),
        sum(weight / h * at[k].tread_compliance for k, weight in weights.items()),
        follows=-sum(weight / h * at[k].dead_pressure for k, weight in weights.items()),
    )


class StripTangent:
    """Tangent of the inflated strip, factorised once for all parameters."""

    def __init__(self, inflated: Inflated):
        strip, q = inflated.strip, inflated.strip_displacement
        self.factor = strip.tangent(q, inflated.pressure)[1].factor()
        self.force = _Force(strip, q, inflated.pressure)

    def slope(self, by: Change) -> np.ndarray:
        """Derivative of the displacement of the axisymmetric strip, (n_strip_dof,), m."""
        return self.factor.solve(-self.force.by(by))


def along(inflated: Inflated, slope: np.ndarray, by: Change, step: float) -> Inflated:
    """The inflated state a step along its derivative."""
    strip_displacement = inflated.strip_displacement + step * slope
    return replace(
        inflated,
        strip_displacement=strip_displacement,
        displacement=spread(inflated.strip, inflated.wall, strip_displacement),
        pressure=inflated.pressure + step * by.pressure,
    )


class Tangent:
    """Tangent of an equilibrium on the ground, factorised once for all parameters."""

    def __init__(self, pressed: Pressed):
        self.pressed = pressed
        ground = pressed.ground
        _, band = ground.inflated.wall.tangent(pressed.displacement, ground.inflated.pressure)
        self.factor = band.factor()
        self.force = _Force(ground.inflated.wall, pressed.displacement, ground.inflated.pressure)
        self.active = np.flatnonzero(pressed.force > 0.0)
        self.rows = ground.rows[self.active]
        self.shift = self.factor.solve(self.rows.T.toarray(order="F"))
        matrix = self.rows @ self.shift
        self.matrix = (matrix + matrix.T) / 2 + np.diag(ground.softness[self.active])

    def slope(self, by: Change, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of displacement (n_dof,), m, and contact forces (n_candidates,), N, at a fixed deflection.

        The active nodes stay active: at a parameter where one comes or goes the forces have a kink.

        Parameters
        ----------
        by : Change
        radius : float
            Derivative of the inflated radius, from which the deflection is measured, m.
        """
        ground = self.pressed.ground
        free = self.factor.solve(-self.force.by(by))
        given = by.compliance * self.pressed.force[self.active] / ground.area[self.active]
        force = np.linalg.solve(self.matrix, self.rows @ free - radius - given)
        every = np.zeros(ground.nodes.size)
        every[self.active] = force
        return free - self.shift @ force, every

    def along(self, inflated: Inflated, slope: tuple[np.ndarray, np.ndarray], step: float) -> Pressed:
        """The equilibrium a step along its derivative, above the ``inflated`` state there."""
        displacement, force = slope
        return replace(
            self.pressed, ground=replace(self.pressed.ground, inflated=inflated),
            displacement=self.pressed.displacement + step * displacement, force=self.pressed.force + step * force,
        )  # fmt: skip


def frequency_slopes(inflated: Inflated, modes: HoopModes, slope: np.ndarray, by: Change, step: float) -> np.ndarray:
    """Derivatives of the frequencies (n_orders, n_each), Hz: the Rayleigh quotient of each shape is stationary.

    Parameters
    ----------
    inflated : Inflated
        On a grid with ``grading = 0``.
    modes : HoopModes
    slope : (n_strip_dof,) ndarray
        From `StripTangent`.
    by : Change
    step : float
        By which the state is moved to difference its geometric stiffness.
    """
    wall, q = inflated.wall, inflated.displacement
    own = sector(wall)
    moved = spread(inflated.strip, wall, slope)
    local = sector(_with_stiffness(wall, by)).local_tangent(q)
    local = local + (own.local_tangent(q + step * moved) - own.local_tangent(q - step * moved)) / (2 * step)
    mass = replace(wall, areal_density=by.areal_density).mass[rings(wall.grid)[:, 0]]
    out = np.empty_like(modes.frequencies)
    curving = by.pressure * wall.follows + inflated.pressure * by.follows
    for k, order in enumerate(modes.orders):
        matrix = of_order(wall, local, int(order)) - curving * pressure_of_order(wall, int(order))
        for j, shape in enumerate(modes.shapes[k].T):
            omega = 2 * np.pi * modes.frequencies[k, j]
            stiffer, heavier = (shape.conj() @ matrix @ shape).real, (mass * np.abs(shape) ** 2).sum()
            out[k, j] = (stiffer - omega**2 * heavier) / (2 * omega) / (2 * np.pi)
    return out


class _Force:
    """Derivative of the unbalanced force at fixed displacements; the elastic part is linear in the stiffness."""

    def __init__(self, wall: Wall, q: np.ndarray, pressure: float):
        self.cells, self.elastic = wall.cells, wall.cells.at(q)
        self.pressed, self.following = wall.push(q), pressure * (wall.volume.curvature @ q)

    def by(self, change: Change) -> np.ndarray:
        """(n_dof,), N."""
        pushed = change.pressure * self.pressed + change.follows * self.following
        return self.elastic(self.cells.each(change.stiffness)) - pushed


def _with_stiffness(wall: Wall, by: Change) -> Wall:
    return replace(wall, cells=wall.cells.with_stiffness(by.stiffness))
