"""Shells against those of OpenSees: alone in bending, in their own plane, and as the walls of a stiffened box.

Its plate bending is the same element, so a skew plate must agree to rounding. Its membrane is the plain bilinear one
and its drilling stiffness another, so a box agrees to within what the meshes leave open. Irregular walls in their own
plane are compared with ASDShellQ4, whose membrane has drilling rotations but locks where elements are slender.
"""

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
import scipy.sparse as sp

from calib.structure.eigenproblem.solve import solve_modes
from models.fem.member import Suppression
from models.fem.panel import Panel, sheet_panel
from models.fem.section import Section
from models.fem.sheet import Sheet
from models.fem.structure import Structure

pytestmark = pytest.mark.oracle

SHEET = Sheet(0.004, 70e9, 0.33, 2700.0)
BAR = Section(2.4e-4, 5e-9, 1.2e-8, 1.2e-8, 70e9, 0.33, 2700.0)


def twin(ops: ModuleType, s: Structure, shell: str = "ShellMITC4") -> None:
    """The same nodes, walls and beams in OpenSees."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for i, point in enumerate(s.points, start=1):
        ops.node(i, *(float(v) for v in point))
    ops.section(
        "ElasticMembranePlateSection", 1, SHEET.young_modulus, SHEET.poisson_ratio, SHEET.thickness, SHEET.density
    )
    for tag, nodes in enumerate(s.corners, start=1):
        ops.element(shell, tag, *(int(n) + 1 for n in nodes), 1)
    for k, ((a, b), m) in enumerate(zip(s.ends, s.member_of, strict=True)):
        tag, bar = 10_000 + k, s.members[m].section
        z = np.cross(s.points[b] - s.points[a], s.members[m].up)
        ops.geomTransf("Linear", tag, *(float(v) for v in z))
        shear = bar.shear_coefficient * bar.area
        ops.element(
            "ElasticTimoshenkoBeam", tag, int(a) + 1, int(b) + 1, bar.young_modulus, bar.shear_modulus, bar.area,
            bar.torsion, bar.i_y, bar.i_z, shear, shear, tag, "-mass", bar.density * bar.area, "-cMass",
        )  # fmt: skip


def displacements(ops: ModuleType, s: Structure, loads: dict[int, tuple[float, ...]]) -> np.ndarray:
    """Of all nodes (n, 6) there, under forces and moments at some."""
    ops.timeSeries("Linear", 1)
    ops.pattern("Plain", 1, 1)
    for node, load in loads.items():
        ops.load(node + 1, *load)
    ops.system("UmfPack")
    ops.numberer("RCM")
    ops.constraints("Plain")
    ops.integrator("LoadControl", 1.0)
    ops.algorithm("Linear")
    ops.analysis("Static")
    assert ops.analyze(1) == 0
    found = np.array([ops.nodeDisp(i + 1) for i in range(len(s.points))])
    ops.wipe()
    return found


@pytest.mark.parametrize(("irregular", "allowed"), [(0.0, 1e-9), (0.06, 1e-5)])
def test_bending_of_a_skew_plate_is_the_same(opensees, irregular, allowed):
    # OpenSees turns shear angles with the directions of the centre's natural axes, which is exact in parallelograms.
    rng = np.random.default_rng(3)
    points = np.zeros((6, 6, 3))
    points[..., 0], points[..., 1] = np.array([0, 0.2, 0.5, 0.7, 1.0, 1.2])[:, None], np.linspace(0, 1.0, 6)
    points[..., 0] += 0.4 * points[..., 1]
    points[1:-1, 1:-1, :2] += rng.uniform(-irregular, irregular, (4, 4, 2))
    s = Structure((), panels=(Panel("b", "g", SHEET, points),))
    edge = np.flatnonzero(np.abs(s.points[:, 0] - 0.4 * s.points[:, 1]) < 1e-9)
    corner = int(np.argmax(s.points.sum(axis=1)))
    twin(opensees, s)
    for i in range(len(s.points)):
        opensees.fix(i + 1, *([1] * 6 if i in edge else [1, 1, 0, 0, 0, 1]))
    theirs = displacements(opensees, s, {corner: (0.0, 0.0, 1.0, 0.3, -0.2, 0.0)})

    held = np.concatenate(
        [(6 * np.arange(len(s.points))[:, None] + [0, 1, 5]).ravel(), (6 * edge[:, None] + np.arange(6)).ravel()]
    )
    free = np.setdiff1d(np.arange(s.n_full), held)
    load = np.zeros(s.n_full)
    load[6 * corner + 2 : 6 * corner + 5] = 1.0, 0.3, -0.2
    u = np.zeros(s.n_full)
    u[free] = sp.linalg.spsolve(sp.csc_matrix(s.shells().stiffness[free][:, free]), load[free])
    np.testing.assert_allclose(u.reshape(-1, 6), theirs, atol=allowed * np.abs(u).max())


def irregular_wall(ops: ModuleType, n: int) -> tuple[float, float]:
    """Deflection of a clamped wall of 3 n by n irregular elements under a shear force at its end, here and there."""
    rng = np.random.default_rng(1)
    points = np.zeros((3 * n + 1, n + 1, 3))
    points[..., 0], points[..., 1] = np.linspace(0, 6.0, 3 * n + 1)[:, None], np.linspace(0, 2.0, n + 1)
    points[1:-1, 1:-1, :2] += rng.uniform(-0.5, 0.5, (3 * n - 1, n - 1, 2)) / n
    points[1:-1, [0, -1], 0] += rng.uniform(-0.5, 0.5, (3 * n - 1, 2)) / n
    s = Structure((), panels=(Panel("b", "g", SHEET, points),))
    x, y, _ = s.points.T
    end, root = np.flatnonzero(x > 6 - 1e-9), x < 1e-9
    load = np.where((y[end] < 1e-9) | (y[end] > 2 - 1e-9), 0.5, 1.0) / n
    twin(ops, s, "ASDShellQ4")
    for i in range(len(s.points)):
        ops.fix(i + 1, *([1] * 6 if root[i] else [0, 0, 1, 1, 1, 0]))
    forces = {int(node): (0.0, float(force), 0.0, 0.0, 0.0, 0.0) for node, force in zip(end, load, strict=True)}
    theirs = displacements(ops, s, forces)
    held = np.repeat(root, 6).reshape(-1, 6)
    held[:, 2:5] = True
    free = np.flatnonzero(~held.ravel())
    pushed = np.zeros(s.n_full)
    pushed[6 * end + 1] = load
    own = sp.linalg.spsolve(sp.csc_array(s.shells().stiffness)[free][:, free], pushed[free])
    return float(pushed[free] @ own), float(load @ theirs[end, 1])


def test_irregular_walls_converge_to_the_same_deflection(opensees):
    own, theirs = np.array([irregular_wall(opensees, n) for n in (1, 2, 4, 8)]).T
    assert np.all(np.abs(own / theirs - 1) < [0.02, 0.05, 0.02, 0.006])
    # From two elements across on, the own ones hardly move any more.
    assert np.abs(own[1:] / own[-1] - 1).max() < 0.003


def box(refinement: int) -> Structure:
    """A tray of five walls, beams along its rim and across its bottom, pinned along both short edges below."""
    x, y, z = (np.linspace(0, size, n) for size, n in ((0.6, 5), (0.4, 3), (0.3, 3)))
    walls = [
        sheet_panel("box", "bottom", SHEET, x, [(v, 0.0) for v in y], refinement=refinement),
        sheet_panel("box", "side", SHEET, x, [(0.0, v) for v in z], refinement=refinement),
        sheet_panel("box", "side", SHEET, x, [(0.4, v) for v in z], refinement=refinement),
        sheet_panel("box", "end", SHEET, y, [(0.0, v) for v in z], direction=1, refinement=refinement),
        sheet_panel("box", "end", SHEET, y, [(0.6, v) for v in z], direction=1, refinement=refinement),
    ]
    bars = [b for wall in walls[1:] for b in wall.stiffener("rim", BAR, (0, 0, 1), v=2)]
    # The rib's torsion would end as a couple at one node in the plane of either side, which no mesh resolves.
    bars += walls[0].stiffener("rib", replace(BAR, torsion=1e-12), (0, 0, 1), u=2)
    places = np.linspace(0, 0.4, 2 ** (refinement + 1) + 1).tolist()
    held = tuple(Suppression((0, 1, 2), body="box", point=(a, b, 0.0)) for a in (0.0, 0.6) for b in places)
    return Structure(tuple(bars), (), held, panels=tuple(walls))


def box_modes(ops: ModuleType, refinement: int, count: int = 8) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Natural frequencies here and there, and the MAC of each pair."""
    s = box(refinement)
    twin(ops, s)
    for foot in s.suppressions:
        assert foot.point is not None
        ops.fix(s.node("box", foot.point) + 1, 1, 1, 1, 0, 0, 0)
    ops.constraints("Plain")
    ops.numberer("RCM")
    ops.system("UmfPack")
    theirs = np.sqrt(np.array(ops.eigen("-genBandArpack", count))) / (2 * np.pi)
    shapes = np.array(
        [[ops.nodeEigenvector(i + 1, k + 1)[:3] for i in range(len(s.points))] for k in range(count)]
    ).reshape(count, -1)
    ops.wipe()
    dofs = s.dof_map()
    t, beams, shells = dofs.expansion, s.beams(), s.shells()
    k = sp.csc_array(t.T @ (beams[0] + shells.stiffness) @ t)
    m = sp.csc_array(t.T @ (beams[1] + shells.mass) @ t)
    modes = solve_modes(k, None, m, count, dofs.direction >= 3)
    own = (t @ modes.shapes).reshape(-1, 6, count)[:, :3].reshape(-1, count)
    mac = np.einsum("kn,nk->k", shapes, own) ** 2 / ((shapes**2).sum(axis=1) * (own**2).sum(axis=0))
    return modes.natural_freq, theirs, mac


@pytest.mark.slow
def test_a_stiffened_box(opensees):
    coarse, fine = (box_modes(opensees, refinement) for refinement in (1, 2))
    gap = [np.abs(own / theirs - 1) for own, theirs, _ in (coarse, fine)]
    assert gap[1].max() < 1.2e-3 and gap[1].max() < 0.6 * gap[0].max()
    assert fine[2].min() > 0.9999
