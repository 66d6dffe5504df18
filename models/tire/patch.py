"""The contact patch: length and width between interpolated edges, and how far the sidewalls bulge beside it."""

from __future__ import annotations

import numpy as np

from models.tire.contact import Pressed
from models.tire.tire import TREAD_WIDTH


def patch_length(pressed: Pressed) -> float:
    """Length of the patch along the crown, m, 0 where nothing touches."""
    gap, load, place, grid = *_fields(pressed), pressed.ground.inflated.wall.grid
    ring = int(np.argmax(pressed.ground.inflated.radii))
    theta = grid.theta_node.copy()
    theta[theta > np.pi] -= 2 * np.pi
    around = np.argsort(theta)
    around = around[place[ring, around]]
    along = pressed.ground.inflated.radius * theta[around]
    return _length(along, gap[ring, around], load[ring, around], _scale(pressed, float(np.diff(along).min())))


def patch_width(pressed: Pressed) -> float:
    """Width of the patch below the axle along the undeformed wall, m, 0 where nothing touches."""
    gap, load, place = _fields(pressed)
    grid = pressed.ground.inflated.wall.grid
    rings = np.flatnonzero(place[:, 0])
    along = grid.s_node[rings]
    return _length(along, gap[rings, 0], load[rings, 0], _scale(pressed, grid.spacing))


def bulge(pressed: Pressed) -> float:
    """Largest axial displacement of the wall below the axle since inflation, m."""
    wall, inflated = pressed.ground.inflated.wall, pressed.ground.inflated.displacement
    moved = (wall.axial @ (pressed.displacement - inflated)).reshape(-1, wall.grid.n_hoop)[:, 0]
    return float(np.abs(moved).max())


def shoulder(pressed: Pressed) -> float:
    """Rise of the tread's edges below the axle since inflation, m, the mean of both sides."""
    wall, inflated = pressed.ground.inflated.wall, pressed.ground.inflated.displacement
    moved = (wall.height @ (pressed.displacement - inflated)).reshape(-1, wall.grid.n_hoop)[:, 0]
    edges = np.array([0.5 - TREAD_WIDTH / 2, 0.5 + TREAD_WIDTH / 2]) * wall.grid.profile.length
    return float(-np.interp(edges, wall.grid.s_node, moved).mean())


def _fields(pressed: Pressed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gap (m) and contact pressure (Pa) of all nodes, and which can touch, (n_meridian + 1, n_hoop) each."""
    grid = pressed.ground.inflated.wall.grid
    shape = grid.n_meridian + 1, grid.n_hoop
    gap, load, place = np.full(shape, np.inf), np.zeros(shape), np.zeros(shape, bool)
    nodes = pressed.ground.nodes
    gap.flat[nodes], load.flat[nodes], place.flat[nodes] = pressed.gap, pressed.pressure, True
    return gap, load, place


def _scale(pressed: Pressed, spacing: float) -> float:
    """Gap for a contact pressure, m/Pa: what the curvature opens over one spacing, over the inflation pressure."""
    inflated = pressed.ground.inflated
    return spacing**2 / (2 * inflated.radius * max(inflated.pressure, 1e3))


def _length(along: np.ndarray, gap: np.ndarray, load: np.ndarray, scale: float) -> float:
    """Distance between the outermost sign changes of the gap less the scaled pressure.

    A count of nodes would jump whenever one more touches. This passes through a node just when its gap and its pressure
    both vanish, so that it changes continuously.
    """
    level = np.where(load > 0.0, -scale * load, np.maximum(gap, 0.0))
    touching = np.flatnonzero(load > 0.0)
    if touching.size == 0:
        return 0.0
    first, last = touching[0], touching[-1]

    def edge(inside: int, outside: int) -> float:
        if not 0 <= outside < len(along):
            return float(along[inside])
        share = level[inside] / (level[inside] - level[outside])
        return float(along[inside] + share * (along[outside] - along[inside]))

    return edge(last, last + 1) - edge(first, first - 1)
