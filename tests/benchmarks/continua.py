"""A roof of shells and a block of solids given as matrices, in ten zones of unknown stiffness each.

Next to the beams of ``grillage.py``, whose matrices have few entries a row: a node of the shells has six motions and
eight neighbours, one of the solids three and 26, and a factor of solids grows faster than one of surfaces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from grillage import ZONES, assembled

import calib
from models.fem.panel import Panel
from models.fem.sheet import Sheet
from models.fem.structure import Structure

YOUNG, POISSON, DENSITY = 2.1e11, 0.3, 7850.0
"""Of steel, Pa, 1, kg/m3."""
THICKNESS = 0.006
"""Of the roof, m."""
ROOF_HELD, BLOCK_HELD = 1e9, 5e10
"""Stiffness of all springs together in each direction, N/m: at the edges of the roof, under the block (assumed)."""
CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


class Continuum(NamedTuple):
    """A body of finite elements over the motions of its nodes (m, 3), in m.

    Stiffness of each zone and mass are (n, n), n a multiple of m; ``held`` are the nodes that stand on springs.
    """

    nodes: np.ndarray
    stiffness: list[sp.csr_array]
    mass: sp.csr_array
    held: np.ndarray


def roof(size: int) -> calib.StructuralModel:
    """A cylindrical roof of 8 by 4 m on springs along its edges, with about ``size`` degrees of freedom."""
    return _model("roof of shells", shells(size), ROOF_HELD)


def block(size: int) -> calib.StructuralModel:
    """A block of 2 by 1 by 0.5 m on springs, with about ``size`` degrees of freedom."""
    return _model("block of solids", solids(size), BLOCK_HELD)


def shells(size: int) -> Continuum:
    """The roof of flat shells with four nodes, of `models.fem.shell`."""
    across = round(math.sqrt(size / 12))
    x, angle = np.meshgrid(np.linspace(0, 8, 2 * across + 1), np.linspace(-0.4, 0.4, across + 1), indexing="ij")
    points = np.stack([x, 5 * np.sin(angle), 5 * np.cos(angle)], axis=-1)
    structure = Structure((), panels=(Panel("roof", "roof", Sheet(THICKNESS, YOUNG, POISSON, DENSITY), points),))
    nodes = structure.points
    middle = nodes[structure.corners].mean(axis=1)
    zone = _zones(np.column_stack([middle[:, 0] / 8, np.arctan2(middle[:, 1], middle[:, 2]) / 0.8 + 0.5]))
    stiffness = [structure.shells(chosen=zone == k).stiffness for k in range(math.prod(ZONES))]
    own = structure.shells()
    angle = np.arctan2(nodes[:, 1], nodes[:, 2])
    held = np.flatnonzero((nodes[:, 0] < 1e-9) | (nodes[:, 0] > 8 - 1e-9) | (abs(angle) > 0.4 - 1e-9))
    return Continuum(nodes, stiffness, sp.csr_array(own.mass + own.rotary), held)


def solids(size: int) -> Continuum:
    """The block of hexahedra with linear shapes."""
    high = max(round((size / 24) ** (1 / 3)), 2)
    counts = np.array([4 * high, 2 * high, high])
    first, nodes = _cells(counts), _cells(counts + 1)
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    rows = (3 * ((first[:, None] + CUBE) @ strides)[:, :, None] + np.arange(3)).reshape(len(first), 24)
    zone = _zones((first / counts)[:, :2])
    stiff, heavy = (np.broadcast_to(matrix, (len(first), 24, 24)) for matrix in _cube(0.5 / high))
    stiffness = [assembled(rows[zone == k], stiff[zone == k], 3 * len(nodes)) for k in range(math.prod(ZONES))]
    mass = assembled(rows, heavy, 3 * len(nodes))
    return Continuum(nodes * 0.5 / high, stiffness, mass, np.flatnonzero(nodes[:, 2] == 0))


def _zones(place: np.ndarray) -> np.ndarray:
    """Zone of each place (n, 2) in [0, 1) along and across, shape (n,)."""
    return np.floor(place * ZONES).astype(int) @ [1, ZONES[0]]


def _cells(counts: np.ndarray) -> np.ndarray:
    """Indices of all cells of a grid, in the order of the last index first, shape (n, dimensions)."""
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
    size = of.mass.shape[0]
    motions = size // len(of.nodes)
    ends = (motions * of.held[:, None] + np.arange(3)).ravel()
    springs = sp.csr_array((np.full(len(ends), held / len(of.held)), (ends, ends)), shape=(size, size))
    zones = {f"zone_{k + 1}": matrix for k, matrix in enumerate(of.stiffness)}
    return calib.StructuralModel.from_matrices(
        stiffness=zones | {"springs": springs},
        mass=of.mass,
        dofs=[(node + 1, direction) for node in range(len(of.nodes)) for direction in DIRECTIONS[:motions]],
        parameters=[calib.Parameter(zone, 1.0, 0.5, 2.0, "-", prior_sd=0.2) for zone in zones],
        name=name,
    )
