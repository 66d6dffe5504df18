"""Walls of several panels: the patch test across their joints, folds, and distorted meshes in a whole structure."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from models.fem.panel import Panel
from models.fem.sheet import Sheet
from models.fem.structure import Structure

SHEET = Sheet(0.1, 1e7, 0.3, 1.0)


def grid(x: np.ndarray, y: np.ndarray, lean: float = 0.0) -> np.ndarray:
    """Points of a flat patch; inner lines across lean, alternately either way."""
    points = np.zeros((len(x), len(y), 3))
    points[..., 0], points[..., 1] = x[:, None], y
    side = np.linspace(-1, 1, len(y))
    points[1:-1, :, 0] += lean * np.outer((-1.0) ** np.arange(len(x) - 2), side)
    return points


def three(fold: float = 0.0) -> Structure:
    """Rectangles between trapezoids and a panel of rectangles turned out of the plane about their common edge."""
    y = np.array([0.0, 0.3, 0.5])
    left, middle, right = grid(np.linspace(-2, 0, 5), y, 0.2), grid(np.arange(3.0), y), grid(np.arange(2.0, 5.0), y)
    right[..., 2] = np.tan(fold) * (right[..., 0] - 2.0)
    panels = tuple(Panel("b", name, SHEET, p) for name, p in (("left", left), ("middle", middle), ("right", right)))
    return Structure((), panels=panels)


def shares(s: Structure) -> list[float]:
    """Of bent edges, panel by panel."""
    out = []
    for k in range(len(s.panels)):
        (own,) = set(s._quads.allman[s.panel_of == k].tolist())
        out.append(own)
    return out


def test_edges_bend_alike_up_to_the_next_fold():
    flat, gentle, sharp = (shares(three(np.radians(angle))) for angle in (0.0, 30.0, 40.0))
    assert flat[0] == flat[1] == flat[2] > 0.9 and gentle == pytest.approx(flat)
    assert sharp[0] == sharp[1] == flat[0] and sharp[2] == 0.0
    assert shares(Structure((), panels=three().panels[1:])) == [0.0, 0.0]


@pytest.mark.parametrize("strain", np.eye(3), ids=["along", "across", "shear"])
def test_constant_strain_is_exact_across_joints_of_panels(strain):
    s = three()
    x, y, _ = s.points.T
    u = np.zeros((len(x), 6))
    u[:, 0], u[:, 1], u[:, 5] = strain[0] * x + strain[2] * y, strain[1] * y, -strain[2] / 2
    edge = (x < -2 + 1e-9) | (x > 4 - 1e-9) | (y < 1e-9) | (y > 0.5 - 1e-9)
    free = np.flatnonzero(np.repeat(~edge, 6))
    held = np.setdiff1d(np.arange(s.n_full), free)
    k = sp.csc_array(s.shells().stiffness)
    found = spla.spsolve(k[free][:, free], -k[free][:, held] @ u.ravel()[held])
    np.testing.assert_allclose(found, u.ravel()[free], atol=1e-10)
    # Panels left to themselves are not in equilibrium at their joint, unless only shear acts on it.
    alone = replace(s._quads, allman=np.where(s.panel_of == 0, s._quads.allman, 0.0))
    object.__setattr__(s, "_quads", alone)
    k = sp.csc_array(s.shells().stiffness)
    worst = np.abs(spla.spsolve(k[free][:, free], -k[free][:, held] @ u.ravel()[held]) - u.ravel()[free]).max()
    assert worst > 1e-3 or strain[2]


def deflection(s: Structure) -> float:
    """Of the end at x = 6 under a unit shear force, clamped at x = 0."""
    held = np.repeat(s.points[:, 0] < 1e-9, 6).reshape(-1, 6)
    held[:, 2:5] = True
    free = np.flatnonzero(~held.ravel())
    tip = np.flatnonzero(s.points[:, 0] > 6 - 1e-9)
    load = np.zeros((len(s.points), 6))
    load[tip, 1] = 1 / len(tip)
    k = sp.csc_array(s.shells().stiffness)
    return float(load.ravel()[free] @ spla.spsolve(k[free][:, free], load.ravel()[free]))


@pytest.mark.parametrize("pieces", [1, 2, 4])
def test_a_cantilever_of_mixed_panels_bends_like_a_beam(pieces):
    # Rectangles, trapezoids and rectangles in line: neither panel spoils the other, at any density.
    y = np.linspace(0, 0.2, pieces + 1)
    x = (np.linspace(0, 2, 2 * pieces + 1), np.linspace(2, 4, 2 * pieces + 1), np.linspace(4, 6, 2 * pieces + 1))
    panels = [Panel("b", "g", SHEET, grid(own, y, lean)) for own, lean in zip(x, (0.0, 0.1 / pieces, 0.0), strict=True)]
    s = Structure((), panels=tuple(panels))
    assert deflection(s) / 0.1081 == pytest.approx(1.0, abs=[0, 0.009, 0.004, 0, 0.003][pieces])
