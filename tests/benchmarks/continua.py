"""A roof of shells and a block of solids given as matrices, in ten zones of unknown stiffness each.

Next to the beams of ``grillage.py``, whose matrices have few entries a row: a node of the shells has six motions and
eight neighbours, one of the solids three and 26, and a factor of solids grows faster than one of surfaces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from grillage import ZONES

import calib
from models.fem import shell
from models.fem.quad import projected
from models.fem.sheet import Sheet

YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0
"""Of steel, Pa, 1, kg/m3."""
THICKNESS = 0.006
"""Of the roof, m."""
ROOF_HELD, BLOCK_HELD = 1e9, 5e10
"""Stiffness of all springs together in each direction, N/m: at the edges of the roof, under the block."""
SQUARE = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
CUBE = np.vstack([np.c_[SQUARE, np.full(4, z)] for z in (0, 1)])
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


class Continuum(NamedTuple):
    """Elements of one shape: matrices (n, k, k) at ``corners`` (n, c) of ``nodes`` (m, 3), with ``motions`` a node.

    ``place`` (n, 2) in [0, 1) along and across says in which zone an element is; ``held`` are the nodes of the springs.
    """

    nodes: np.ndarray
    corners: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    place: np.ndarray
    held: np.ndarray
    motions: int


def roof(size: int) -> calib.StructuralModel:
    """A cylindrical roof of 8 by 4 m on springs along its edges, with about ``size`` degrees of freedom."""
    return _model("roof of shells", shells(size), ROOF_HELD)


def block(size: int) -> calib.StructuralModel:
    """A block of 2 by 1 by 0.5 m on springs, with about ``size`` degrees of freedom."""
    return _model("block of solids", solids(size), BLOCK_HELD)


def shells(size: int) -> Continuum:
    """Flat shells with four nodes, of `models.fem.shell`."""
    across = round(math.sqrt(size / 12))
    counts = np.array([2 * across, across])
    x, angle = np.meshgrid(np.linspace(0, 8, counts[0] + 1), np.linspace(-0.4, 0.4, across + 1), indexing="ij")
    nodes = np.stack([x, 5 * np.sin(angle), 5 * np.cos(angle)], axis=-1).reshape(-1, 3)
    first = _cells(counts)
    corners = (first[:, None] + SQUARE) @ [across + 1, 1]
    elements = projected(nodes[corners])
    turned = elements.transformation()
    sheet = Sheet(THICKNESS, YOUNG, POISSON, DENSITY)
    stiffness = shell.to_global(sum(shell.stiffness(elements, sheet)), turned)
    mass = shell.to_global(shell.mass(elements, DENSITY * THICKNESS, DENSITY * THICKNESS**3 / 12), turned)
    held = np.flatnonzero((x == 0) | (x == 8) | (abs(angle) == 0.4))
    return Continuum(nodes, corners, stiffness, mass, first / counts, held, 6)


def solids(size: int) -> Continuum:
    """Hexahedra with linear shapes."""
    high = max(round((size / 24) ** (1 / 3)), 2)
    counts = np.array([4 * high, 2 * high, high])
    first, nodes = _cells(counts), _cells(counts + 1)
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    stiffness, mass = (np.broadcast_to(matrix, (len(first), 24, 24)) for matrix in _cube(0.5 / high))
    held = np.flatnonzero(nodes[:, 2] == 0)
    corners = (first[:, None] + CUBE) @ strides
    return Continuum(nodes * 0.5 / high, corners, stiffness, mass, (first / counts)[:, :2], held, 3)


def _cells(counts: np.ndarray) -> np.ndarray:
    """Indices of all cells of a grid, the last index first, shape (n, dimensions)."""
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(counts))


def _cube(edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and consistent mass of a cube with linear shapes, 2 x 2 x 2 points, each (24, 24)."""
    law = np.diag([YOUNG / (1 + POISSON)] * 3 + [YOUNG / (2 * (1 + POISSON))] * 3)
    law[:3, :3] += POISSON * YOUNG / ((1 + POISSON) * (1 - 2 * POISSON))
    stiffness, mass = np.zeros((24, 24)), np.zeros((24, 24))
    signs = 2 * CUBE - 1
    for at in signs / math.sqrt(3):
        factors = (1 + signs * at) / 2
        shapes = factors.prod(axis=1)
        slopes = [signs[:, d] / edge * np.delete(factors, d, axis=1).prod(axis=1) for d in range(3)]
        strain = np.zeros((6, 24))
        for d in range(3):
            strain[d, d::3] = slopes[d]
            one, other = (d + 1) % 3, (d + 2) % 3
            strain[3 + d, one::3], strain[3 + d, other::3] = slopes[other], slopes[one]
        stiffness += edge**3 / 8 * strain.T @ law @ strain
        mass += DENSITY * edge**3 / 8 * np.kron(np.outer(shapes, shapes), np.eye(3))
    return stiffness, mass


def _model(name: str, of: Continuum, held: float) -> calib.StructuralModel:
    """Its elements with springs of ``held`` N/m together to the ground, in each of three directions."""
    rows = (of.motions * of.corners[:, :, None] + np.arange(of.motions)).reshape(len(of.corners), -1)
    zone = np.floor(of.place * ZONES).astype(int) @ [1, ZONES[0]]
    size = of.motions * len(of.nodes)
    ends = (of.motions * of.held[:, None] + np.arange(3)).ravel()
    springs = sp.csr_array((np.full(len(ends), held / len(of.held)), (ends, ends)), shape=(size, size))
    names = [f"zone_{k + 1}" for k in range(math.prod(ZONES))]
    return calib.StructuralModel.from_matrices(
        stiffness={n: _sum(rows[zone == k], of.stiffness[zone == k], size) for k, n in enumerate(names)}
        | {"springs": springs},
        mass=_sum(rows, of.mass, size),
        dofs=[(node + 1, direction) for node in range(len(of.nodes)) for direction in DIRECTIONS[: of.motions]],
        parameters=[calib.Parameter(n, 1.0, 0.5, 2.0, "-", prior_sd=0.2) for n in names],
        name=name,
    )


def _sum(rows: np.ndarray, blocks: np.ndarray, size: int) -> sp.csr_array:
    """Element matrices (n, k, k) at their rows (n, k), added up."""
    k = rows.shape[1]
    where = (np.repeat(rows, k, axis=1).ravel(), np.tile(rows, (1, k)).ravel())
    return sp.coo_array((blocks.ravel(), where), shape=(size, size)).tocsr()
