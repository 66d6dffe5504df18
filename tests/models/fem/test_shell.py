"""The shell element by itself: patch tests, rigid motions, rank, invariances, mass, exact shares."""

from dataclasses import replace

import numpy as np
import pytest

from calib import InputError
from models.fem import shell
from models.fem.quad import projected
from models.fem.sheet import Sheet

SHEET = Sheet(0.02, 70e9, 0.3, 2700.0)
ORTHOTROPIC = Sheet(
    0.03, 40e9, 0.25, 1500.0, young_modulus_across=10e9, shear_modulus=5e9, shear_modulus_through=(4e9, 3e9), rmi=7.0
)
# Five distorted elements round an inner quadrilateral (MacNeal and Harder 1985), nodes 4..7 inside.
PATCH = np.array([[0, 0], [0.24, 0], [0.24, 0.12], [0, 0.12], [0.04, 0.02], [0.18, 0.03], [0.16, 0.08], [0.08, 0.08]])
TURNS = np.array([[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]])


def rotation(seed: int) -> np.ndarray:
    q = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def turned(points: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.zeros((len(points), 1))], axis=1) @ q.T + [3.0, -2.0, 1.0]


def one(sheet: Sheet, nodes: np.ndarray, along=None) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness shares (4, 24, 24) and mass (24, 24) of one element over its nodal motions."""
    quads = projected(nodes[None], along)
    t = quads.transformation()
    heavy = sheet.density * sheet.thickness
    m = shell.mass(quads, heavy, heavy * sheet.thickness**2 / 12)
    return np.array([shell.to_global(k, t)[0] for k in shell.stiffness(quads, sheet)]), shell.to_global(m, t)[0]


def distorted(seed: int, warp: float = 0.0) -> np.ndarray:
    """An irregular quadrilateral in any orientation, out of its plane by ``warp``."""
    rng = np.random.default_rng(seed)
    flat = np.array([[0, 0], [1.0, 0.1], [1.2, 0.9], [-0.1, 0.7]]) + rng.uniform(-0.1, 0.1, (4, 2))
    nodes = np.concatenate([flat, warp * np.array([[1.0], [-1.0], [1.0], [-1.0]])], axis=1)
    return nodes @ rotation(seed).T + rng.standard_normal(3)


def patch(sheet: Sheet, q: np.ndarray, along=None) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (48, 48) and places of the patch."""
    points = turned(PATCH, q)
    quads = projected(points[TURNS], along)
    blocks = shell.to_global(np.sum(shell.stiffness(quads, sheet), axis=0), quads.transformation())
    k = np.zeros((48, 48))
    for nodes, block in zip(TURNS, blocks, strict=True):
        dofs = (6 * nodes[:, None] + np.arange(6)).ravel()
        k[np.ix_(dofs, dofs)] += block
    return k, points


def motions(field, q: np.ndarray) -> np.ndarray:
    """Nodal motions (48,) of a field that gives (ux, uy, uz, rx, ry, rz) in the patch's own axes."""
    local = np.array([field(x, y) for x, y in PATCH], dtype=float)
    return np.hstack([local[:, :3] @ q.T, local[:, 3:] @ q.T]).ravel()


MEMBRANE = {
    "stretch along": (lambda x, y: (x, 0, 0, 0, 0, 0), (1, 0, 0)),
    "stretch across": (lambda x, y: (0, y, 0, 0, 0, 0), (0, 1, 0)),
    "shear": (lambda x, y: (y, 0, 0, 0, 0, -0.5), (0, 0, 1)),
}
# w, rx = w,y and ry = -w,x of constant curvatures without transverse shear.
BENDING = {
    "along": (lambda x, y: (0, 0, x**2 / 2, 0, -x, 0), (-1, 0, 0)),
    "across": (lambda x, y: (0, 0, y**2 / 2, y, 0, 0), (0, -1, 0)),
    "twist": (lambda x, y: (0, 0, x * y, x, -y, 0), (0, 0, -2)),
}
SHEAR = {
    "tilt": (lambda x, y: (0, 0, x, 0, 0, 0), (1, 0)),
    "turn": (lambda x, y: (0, 0, 0, 1, 0, 0), (0, -1)),
}


@pytest.mark.parametrize("sheet", [SHEET, ORTHOTROPIC], ids=["isotropic", "orthotropic"])
@pytest.mark.parametrize("case", [*MEMBRANE.items(), *BENDING.items()], ids=[*MEMBRANE, *BENDING])
def test_patch_of_constant_strain_is_exact(sheet, case):
    name, (field, strain) = case
    q = rotation(1)
    k, _ = patch(sheet, q, q[:, 0])
    u = motions(field, q)
    free = np.arange(24, 48)
    found = np.linalg.solve(k[np.ix_(free, free)], -k[np.ix_(free, np.arange(24))] @ u[:24])
    np.testing.assert_allclose(found, u[24:], atol=1e-11 * np.abs(u).max())
    rigidity = sheet.membrane if name in MEMBRANE else sheet.bending
    energy = 0.24 * 0.12 * np.array(strain) @ rigidity @ strain
    assert u @ k @ u == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("case", SHEAR.items(), ids=SHEAR)
def test_patch_of_constant_transverse_shear_is_exact(case):
    # Equilibrium of shear needs moments that vary, so only the energy of the imposed field is compared.
    _, (field, angle) = case
    q = rotation(2)
    k, _ = patch(ORTHOTROPIC, q, q[:, 0])
    u = motions(field, q)
    assert u @ k @ u == pytest.approx(0.24 * 0.12 * np.array(angle) @ ORTHOTROPIC.shear @ angle, rel=1e-11)


def test_rigidities_of_an_orthotropic_sheet():
    compliance = np.linalg.inv(ORTHOTROPIC.membrane / 0.03)
    expected = [[1 / 40e9, -0.25 / 40e9, 0], [-0.25 / 40e9, 1 / 10e9, 0], [0, 0, 1 / 5e9]]
    np.testing.assert_allclose(compliance, expected, atol=1e-22)
    np.testing.assert_allclose(ORTHOTROPIC.bending, 7.0 * 0.03**2 / 12 * ORTHOTROPIC.membrane, rtol=1e-12)
    np.testing.assert_allclose(ORTHOTROPIC.shear, 5 / 6 * 0.03 * np.diag([4e9, 3e9]), rtol=1e-12)
    assert SHEET.in_plane_shear == pytest.approx(70e9 / 2.6) and SHEET.is_isotropic and not ORTHOTROPIC.is_isotropic


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("warp", [0.0, 0.08])
def test_six_rigid_motions_and_no_other_without_energy(rigid, seed, warp):
    nodes = distorted(seed, warp)
    shares, _ = one(ORTHOTROPIC if seed % 2 else SHEET, nodes, rotation(seed)[:, 0])
    k = shares.sum(axis=0)
    np.testing.assert_allclose(shares @ rigid(nodes), 0.0, atol=1e-10 * np.abs(k).max())
    values = np.linalg.eigvalsh(k)
    assert np.all(np.abs(values[:6]) < 1e-12 * values[-1])
    assert values[6] > 1e-7 * values[-1]


def test_shares_have_their_rank_and_are_nowhere_negative():
    shares, m = one(SHEET, distorted(3))
    # Membrane 8 - 3; bending and shear 12 - 3 together; drilling ties four rotations.
    for share, rank in zip(shares, (5, 5, 4, 4), strict=True):
        values = np.linalg.eigvalsh(share)
        assert values[0] > -1e-12 * values[-1]
        assert np.count_nonzero(values > 1e-9 * values[-1]) == rank
        np.testing.assert_allclose(share, share.T, atol=1e-12 * values[-1])
    assert np.linalg.matrix_rank(shares[1] + 1e-2 * shares[2], tol=1e-9 * np.abs(shares[1]).max()) == 9
    assert np.linalg.eigvalsh(m)[0] > -1e-12 * np.abs(m).max()
    assert np.count_nonzero(np.linalg.eigvalsh(m) > 1e-9 * np.abs(m).max()) == 20  # a sheet has no drilling inertia


@pytest.mark.parametrize("warp", [0.0, 0.05])
def test_turning_the_element_turns_its_matrices(warp):
    nodes, q = distorted(5, warp), rotation(7)
    along = rotation(5)[:, 0]
    here = one(ORTHOTROPIC, nodes, along)
    there = one(ORTHOTROPIC, nodes @ q.T + 1.0, q @ along)
    t = np.kron(np.eye(8), q)
    for a, b in zip((*here[0], here[1]), (*there[0], there[1]), strict=True):
        np.testing.assert_allclose(b, t @ a @ t.T, atol=1e-10 * np.abs(a).max())


@pytest.mark.parametrize("order", [[1, 2, 3, 0], [2, 3, 0, 1], [3, 2, 1, 0]])
@pytest.mark.parametrize(("sheet", "warp"), [(SHEET, 0.0), (SHEET, 0.05), (ORTHOTROPIC, 0.05)])
def test_the_corner_that_comes_first_does_not_matter(order, sheet, warp):
    nodes = distorted(6, warp)
    along = None if sheet is SHEET else rotation(6)[:, 0]
    here, there = one(sheet, nodes, along), one(sheet, nodes[order], along)
    dofs = (6 * np.array(order)[:, None] + np.arange(6)).ravel()
    for a, b in zip((*here[0], here[1]), (*there[0], there[1]), strict=True):
        np.testing.assert_allclose(b, a[np.ix_(dofs, dofs)], atol=1e-10 * np.abs(a).max())


def test_shares_follow_modulus_thickness_and_rmi_exactly():
    nodes = distorted(8, 0.03)
    base = Sheet(0.01, 70e9, 0.33, 2700.0)
    (membrane, bending, shear, drilling), _ = one(base, nodes)
    e, t, rmi = 55e9 / 70e9, 1.7, 120.0
    direct = one(replace(base, young_modulus=55e9, thickness=0.017, rmi=120.0), nodes)[0]
    composed = [e * t * membrane, rmi * e * t**3 * bending, e * t * shear, e * t * drilling]
    for a, b in zip(direct, composed, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13 * np.abs(a).max())


@pytest.mark.parametrize("seed", range(3))
def test_mass_holds_total_centre_and_inertia(rigid, seed):
    nodes = distorted(seed)
    _, m = one(SHEET, nodes)
    quads = projected(nodes[None])
    # Split into triangles: their mean of r r^T is exact with the middles of the edges.
    found = rigid(nodes).T @ m @ rigid(nodes)
    per_area = SHEET.density * SHEET.thickness
    total, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for a, b, c in (nodes[[0, 1, 2]], nodes[[0, 2, 3]]):
        area = np.linalg.norm(np.cross(b - a, c - a)) / 2
        middles = np.array([(a + b) / 2, (b + c) / 2, (c + a) / 2])
        total += per_area * area
        first += per_area * area * middles.mean(axis=0)
        second += per_area * area * middles.T @ middles / 3
    assert total == pytest.approx(per_area * quads.area[0], rel=1e-12)
    normal = quads.axes[0, 2]
    slab = total * SHEET.thickness**2 / 12 * (np.eye(3) - np.outer(normal, normal))
    scale = total * (1 + np.abs(second).max() / total)
    np.testing.assert_allclose(found[:3, :3], total * np.eye(3), atol=1e-12 * scale)
    for d in range(3):
        np.testing.assert_allclose(found[:3, 3 + d], np.cross(np.eye(3)[d], first), atol=1e-12 * scale)
    np.testing.assert_allclose(found[3:, 3:], np.trace(second) * np.eye(3) - second + slab, atol=1e-11 * scale)


def test_a_warped_element_keeps_its_mass_and_centre(rigid):
    nodes = distorted(4, 0.1)
    _, m = one(SHEET, nodes)
    found = rigid(nodes).T @ m @ rigid(nodes)
    total = SHEET.density * SHEET.thickness * projected(nodes[None]).area[0]
    np.testing.assert_allclose(found[:3, :3], total * np.eye(3), atol=1e-12 * total)


@pytest.mark.parametrize("factor", [0.01, 0.1, 1.0, 10.0])
def test_in_plane_bending_of_a_rectangle_is_exact_whatever_its_slenderness(factor):
    for length in (0.1, 1.0, 20.0):
        nodes = np.array([[0, 0, 0], [length, 0, 0], [length, 0.4, 0], [0, 0.4, 0]])
        k = one(replace(SHEET, drilling_factor=factor), nodes)[0].sum(axis=0)
        x, y, nu = nodes[:, 0] - length / 2, nodes[:, 1] - 0.2, SHEET.poisson_ratio
        u = np.zeros((4, 6))
        u[:, 0], u[:, 1], u[:, 5] = x * y, -(x**2) / 2 - nu * y**2 / 2, -x
        bent = SHEET.young_modulus * SHEET.thickness * 0.4**3 / 12 * length
        assert u.ravel() @ k @ u.ravel() == pytest.approx(bent, rel=1e-9)


BAD = {
    "two corners coincide": ([[0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0]], "not convex, or two"),
    "a triangle": ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], "not convex, or two"),
    "an arrow": ([[0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0]], "not convex, or two"),
    "a bow tie": ([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]], "not convex|no area"),
    "a line": ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], "no area"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_quadrilaterals_are_refused(name):
    nodes, message = BAD[name]
    with pytest.raises(InputError, match=message) as caught:
        projected(np.array([nodes], dtype=float), place="panel car/floor")
    assert "panel car/floor" in str(caught.value)


def test_a_direction_square_to_the_wall_is_refused():
    with pytest.raises(InputError, match="normal to the panel's direction"):
        projected(np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float), np.array([0, 0, 1.0]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thickness": 0.0}, "thickness is 0"),
        ({"young_modulus": -1.0}, "young_modulus is -1"),
        ({"rmi": 0.0}, "rmi is 0"),
        ({"drilling_factor": 0.0}, "drilling_factor is 0"),
        ({"density": -1.0}, "density is -1"),
        ({"poisson_ratio": 0.6}, "poisson_ratio is 0.6"),
        ({"young_modulus_across": 1e9, "poisson_ratio": 9.0}, "poisson_ratio is 9"),
        ({"shear_modulus_through": (1e9, 0.0)}, r"shear_modulus_through\[1\]"),
        ({"thickness": float("nan")}, "thickness is nan"),
    ],
)
def test_sheets_that_cannot_be_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(SHEET, **change)
