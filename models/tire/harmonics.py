"""Modes of the inflated tire by hoop order: the grid repeats around the hoop, so each order is a small problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import linalg

from calib import EvaluationError, InputError
from models.tire.cells import Cells
from models.tire.grid import Grid
from models.tire.inflated import Inflated, Wall


@dataclass(frozen=True)
class HoopModes:
    """Lowest modes of every hoop order; those of orders above 0 come in pairs, one a quarter wave further round.

    Attributes
    ----------
    orders : (n_orders,) int ndarray
        Waves around the hoop.
    frequencies : (n_orders, n_each) ndarray
        Hz, ascending in each order.
    shapes : (n_orders, n_ring, n_each) complex ndarray
        Amplitudes over one ring in the order of `rings`, times exp(i n theta); mass normalised.
    """

    orders: np.ndarray
    frequencies: np.ndarray
    shapes: np.ndarray


@lru_cache(maxsize=8)
def rings(grid: Grid) -> np.ndarray:
    """Degrees of freedom (n_ring, n_hoop): u, then v, then w, each from bead to bead."""
    return np.concatenate([number[number[:, 0] >= 0] for number in grid.numbers])


def hoop_modes(inflated: Inflated, orders: np.ndarray, n_each: int = 1) -> HoopModes:
    """Modes about the inflated state by hoop order.

    Stiffness and mass are circulant blocks on a grid without grading, so a discrete Fourier transform around the hoop
    separates the orders (Davis 1979), and the cells of one sector give the matrix of each.

    Parameters
    ----------
    inflated : Inflated
        On a grid with ``grading = 0``.
    orders : (n_orders,) int array
        From 0 to a quarter of the hoop cells.
    n_each : int

    Raises
    ------
    InputError
        For a graded grid, or orders that its hoop cells cannot show.
    EvaluationError
        Where the inflated state is unstable.
    """
    wall = inflated.wall
    orders = np.atleast_1d(np.asarray(orders, int))
    if wall.grid.grading:
        raise InputError(f"hoop orders need equal hoop cells, but the grading of the grid is {wall.grid.grading:g}")
    if orders.min() < 0 or orders.max() > wall.grid.n_hoop // 4:
        raise InputError(
            f"hoop orders from {orders.min()} to {orders.max()} on {wall.grid.n_hoop} hoop cells; allowed are 0 to "
            f"{wall.grid.n_hoop // 4}",
            remedy="take more hoop cells",
        )
    ring = rings(wall.grid)
    root = np.sqrt(wall.mass[ring[:, 0]])
    frequencies, shapes = np.empty((len(orders), n_each)), np.empty((len(orders), len(ring), n_each), complex)
    local = sector(wall).local_tangent(inflated.displacement)
    for k, order in enumerate(orders):
        stiffness = of_order(wall, local, order) - inflated.pressure * wall.follows * pressure_of_order(wall, order)
        matrix = stiffness / np.outer(root, root)
        squares, vectors = linalg.eigh((matrix + matrix.conj().T) / 2, subset_by_index=[0, n_each - 1])
        if squares[0] <= 0.0:
            raise EvaluationError(f"the inflated tire is unstable in hoop order {order}")
        frequencies[k] = np.sqrt(squares) / (2 * np.pi)
        shapes[k] = vectors / root[:, None]
    return HoopModes(orders, frequencies, shapes)


def sector(wall: Wall) -> Cells:
    """The cells of one hoop position; the others repeat them."""
    return wall.cells.every(wall.grid.n_hoop)


def of_order(wall: Wall, local: np.ndarray, order: int) -> np.ndarray:
    """Matrix of a hoop order (n_ring, n_ring) from those of the sector's cells (n_cells, n_local, n_local)."""
    dofs = sector(wall).dofs
    row, phase = _wave(wall.grid, order, dofs)
    return _summed(
        row[:, :, None], row[:, None, :], phase.conj()[:, :, None] * local * phase[:, None, :], len(rings(wall.grid))
    )


def pressure_of_order(wall: Wall, order: int) -> np.ndarray:
    """Curvature of the enclosed volume for a hoop order, (n_ring, n_ring), m; see `EnclosedVolume`."""
    ring = rings(wall.grid)
    part = wall.volume.curvature[ring[:, 0]].tocoo()
    col, phase = _wave(wall.grid, order, part.col)
    return _summed(part.row, col, part.data * phase, len(ring))


def _wave(grid: Grid, order: int, dofs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place in the ring and phase of degrees of freedom of any shape."""
    ring = rings(grid)
    row, hoop = np.empty(grid.n_dof, int), np.empty(grid.n_dof, int)
    row[ring], hoop[ring] = np.arange(len(ring))[:, None], np.arange(grid.n_hoop)[None, :]
    return row[dofs], np.exp(2j * np.pi * order * hoop[dofs] / grid.n_hoop)


def _summed(row: np.ndarray, col: np.ndarray, entry: np.ndarray, size: int) -> np.ndarray:
    """Square matrix of complex entries, those at one place summed."""
    flat = np.broadcast_to(row * size + col, entry.shape).ravel()
    real, imaginary = (np.bincount(flat, part.ravel(), minlength=size**2) for part in (entry.real, entry.imag))
    return (real + 1j * imaginary).reshape(size, size)
