"""Modes by hoop order: against those of the whole wall, and against closed forms of ring and cylinder."""

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from meridians import Cylinder

from models.tire import base_tire
from models.tire.cells import Cells
from models.tire.grid import Grid
from models.tire.harmonics import hoop_modes
from models.tire.inflated import Wall, inflate
from models.tire.laminate import Ply, abd
from models.tire.micromechanics import isotropic

AREAL_DENSITY = 5.0
RADIUS = 0.3


@dataclass(frozen=True)
class StressedCells(Cells):
    """Cells that carry given membrane forces N1 and N2 without being strained, N/m."""

    membrane: tuple[float, float] = (0.0, 0.0)

    def local_tangent(self, q):
        forces = np.zeros((len(self.area), 6))
        forces[:, :2] = self.area[:, None] * self.membrane
        return self._local(self.rows[:, :6], self._weighted, forces)


def stressed(surface, n, m, laminate, n1, n2, pressure):
    """An undeformed wall under given membrane forces and a pressure: what `hoop_modes` asks of an inflated tire."""
    wall = Wall.build(Grid(surface, n, m, 0.0), np.broadcast_to(laminate, (2 * n, 6, 6)), np.full(2 * n, AREAL_DENSITY))
    parts = {f.name: getattr(wall.cells, f.name) for f in fields(Cells)}
    wall = replace(wall, cells=StressedCells(**parts, membrane=(n1, n2)))
    return SimpleNamespace(wall=wall, pressure=pressure, displacement=np.zeros(wall.grid.n_dof))


def orders_of(errors):
    return np.log2(np.divide(errors[:-1], errors[1:]))


def test_modes_by_hoop_order_are_those_of_the_whole_wall():
    tire = base_tire()
    even = inflate(tire.wall(12, 24, 0.0), tire.wall(12, 1), 2e5)
    found = hoop_modes(even, np.arange(7), 3)
    each = np.repeat(found.frequencies, np.where(found.orders == 0, 1, 2), axis=0)
    whole, shapes = even.modes(16)
    assert np.sort(each.ravel())[:16] == pytest.approx(whole, rel=1e-9)
    assert whole[-1] < found.frequencies.max(axis=1).min()  # orders and numbers within each are enough
    # The shape of an order, carried around the hoop, lies in the plane of its two modes.
    grid, order = even.wall.grid, 2
    pair = np.abs(whole / found.frequencies[order, 0] - 1) < 1e-8
    ring = np.concatenate([number[number[:, 0] >= 0] for number in grid.numbers])
    carried = np.zeros(grid.n_dof, complex)
    carried[ring] = found.shapes[order, :, :1] * np.exp(1j * order * grid.theta_node)
    plane = shapes[:, pair].T @ (even.wall.mass * carried)
    assert pair.sum() == 2
    assert np.linalg.norm(plane) ** 2 == pytest.approx(float((even.wall.mass * np.abs(carried) ** 2).sum()), rel=1e-8)


def test_an_inextensional_ring_under_pressure():
    """f = n sqrt((n^2 - 1) ((n^2 - 1) D + p R^3) / (n^2 + 1) / m) / (2 pi R^2) (Love 1927, Levy 1884 for the pressure).

    Without stiffness between them the rings of a cylinder are alone.
    """
    laminate, pressure = np.diag([1e7, 1e9, 0.0, 0.0, 2.0, 0.0]), 1e3
    n = np.array([2, 3, 4])
    square = n**2 * (n**2 - 1) / (n**2 + 1) * ((n**2 - 1) * laminate[4, 4] + pressure * RADIUS**3)
    exact = np.sqrt(square / AREAL_DENSITY) / (2 * np.pi * RADIUS**2)
    errors = []
    for m in (32, 64, 128):
        wall = stressed(Cylinder(RADIUS, 0.02), 4, m, laminate, 0.0, pressure * RADIUS, pressure)
        errors.append(np.abs(hoop_modes(wall, n).frequencies[:, 0] / exact - 1))
    assert (errors[2] < 4e-3).all()
    assert orders_of(errors) == pytest.approx(np.full((2, 3), 2.0), abs=0.1)


def test_torsion_of_a_clamped_cylinder():
    """Waves of a hoop displacement alone: twist and shear work together, and pressure and hoop force cancel."""
    laminate, length, pressure = np.diag([1e8, 1e9, 1e5, 1.0, 1.0, 1e3]), 0.5, 2e5
    laminate[2, 5] = laminate[5, 2] = 2e3
    k = 1 / RADIUS
    shear = laminate[2, 2] + 3 * k * laminate[2, 5] + 9 / 4 * k**2 * laminate[5, 5]  # t12 = 3/2 k2 v'
    exact = np.arange(1, 4) * np.sqrt(shear / AREAL_DENSITY) / (2 * length)
    errors = []
    for n in (16, 32, 64):
        wall = stressed(Cylinder(RADIUS, length), n, 4, laminate, 3e3, pressure * RADIUS, pressure)
        errors.append(np.abs(hoop_modes(wall, [0], 3).frequencies[0] / exact - 1))
    assert (errors[2] < 5e-3).all()
    assert orders_of(errors) == pytest.approx(np.full((2, 3), 2.0), abs=0.1)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("order", "cells", "tolerance"),
    [(3, (10, 20), 4e-3), *(pytest.param(n, (16, 32, 64), 2e-4, marks=pytest.mark.slow) for n in (1, 2, 5))],
)
def test_a_clamped_cylinder_under_pressure_has_its_exact_frequencies(order, cells, tolerance):
    pytest.importorskip("sympy", reason="needs sympy: pip install calib[dev]")
    from clamped_cylinder import ClampedCylinder

    surface, pressure = Cylinder(RADIUS, 0.4), 2e4
    laminate = abd([Ply(5e-3, 0.0, isotropic(1e8, 0.3))])
    n1, n2 = pressure * RADIUS / 2, pressure * RADIUS
    found = [
        hoop_modes(stressed(surface, n, 2 * n, laminate, n1, n2, pressure), [order], 3).frequencies[0] for n in cells
    ]
    cylinder = ClampedCylinder(surface, laminate, AREAL_DENSITY, n1, n2, pressure)
    limit = (4 * found[-1] - found[-2]) / 3
    exact = np.array([cylinder.frequency(order, 0.97 * f, 1.03 * f, k % 2 == 0) for k, f in enumerate(limit)])
    assert limit == pytest.approx(exact, rel=tolerance)
    for rate in orders_of(np.abs(np.array(found) - exact))[1:]:
        assert rate == pytest.approx(np.full(3, 2.0), abs=0.2)
