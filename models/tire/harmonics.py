"""Modes of the inflated tire by hoop order: the grid repeats around the hoop, so each order is a small problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from calib.errors import EvaluationError, InputError
from models.tire.inflated import Inflated


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
        Amplitudes over one ring in the order of `Grid.numbers`, times exp(i n theta); mass normalised.
    """

    orders: np.ndarray
    frequencies: np.ndarray
    shapes: np.ndarray


def hoop_modes(inflated: Inflated, orders: np.ndarray, n_each: int = 1) -> HoopModes:
    """Modes about the inflated state by hoop order.

    Stiffness and mass are circulant blocks on a grid without grading, so a discrete Fourier transform around the hoop
    separates the orders (Davis 1979).

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
    grid = inflated.wall.grid
    orders = np.atleast_1d(np.asarray(orders, int))
    if grid.grading:
        raise InputError(f"hoop orders need equal hoop cells, but the grading of the grid is {grid.grading:g}")
    if orders.min() < 0 or orders.max() > grid.n_hoop // 4:
        raise InputError(
            f"hoop orders from {orders.min()} to {orders.max()} on {grid.n_hoop} hoop cells; allowed are 0 to "
            f"{grid.n_hoop // 4}",
            remedy="take more hoop cells",
        )
    ring = np.concatenate([number[number[:, 0] >= 0] for number in grid.numbers])  # (n_ring, n_hoop)
    n_ring = len(ring)
    stiffness = inflated.stiffness.matrix()
    blocks = np.stack([stiffness[ring[:, 0]][:, ring[:, j]].toarray() for j in range(grid.n_hoop)])
    root = np.sqrt(inflated.wall.mass[ring[:, 0]])
    frequencies, shapes = np.empty((len(orders), n_each)), np.empty((len(orders), n_ring, n_each), complex)
    for k, order in enumerate(orders):
        phase = np.exp(2j * np.pi * order * np.arange(grid.n_hoop) / grid.n_hoop)
        matrix = np.tensordot(phase, blocks, axes=1) / np.outer(root, root)
        squares, vectors = linalg.eigh((matrix + matrix.conj().T) / 2, subset_by_index=[0, n_each - 1])
        if squares[0] <= 0.0:
            raise EvaluationError(f"the inflated tire is unstable in hoop order {order}")
        frequencies[k] = np.sqrt(squares) / (2 * np.pi)
        shapes[k] = vectors / root[:, None]
    return HoopModes(orders, frequencies, shapes)
