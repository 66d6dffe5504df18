"""Hung masses and flexible mounts against closed forms of one or two degrees of freedom."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import AffineMatrix, Monomial, Term, parameter
from calib.structure.effects.attach import (
    GRAVITY,
    between,
    elongation,
    hung_masses,
    loosened_masses,
    maxwell_branches,
    motion,
    moved_masses,
    outer_term,
    part_of,
    scaled_part,
    soft_mounts,
    softened_part,
)
from calib.structure.effects.extend import extend
from calib.structure.geometry import DofMap, Mesh
from calib.structure.model import Part, StructuralModel

M0, K0 = 3.0, 3.0 * (2 * np.pi * 4.0) ** 2


class Corner:
    """One body at the origin that moves in x, y and z; two others at rest."""

    def row(self, point, direction, on=None):
        return np.eye(3)[direction] * (on != "ground"), 0.0


@pytest.fixture
def body():
    """A mass of 3 kg on springs of 4, 5 and 6 Hz with a damper c in x."""
    space = ParameterSpace((Parameter("c", 30.0, 0.0, 500.0, "Ns/m"),))
    across = sp.csr_array(np.diag([1.0, 0.0, 0.0]))
    springs = sp.csr_array(np.diag(K0 * np.array([1.0, 25 / 16, 36 / 16])))
    return StructuralModel(
        name="body",
        space=space,
        stiffness=AffineMatrix(3, (Term("springs", springs),)),
        damping=AffineMatrix(3, (Term("damper", across, parameter("c")),)),
        mass=AffineMatrix(3, (Term("mass", sp.csr_array(M0 * np.eye(3))),)),
        mesh=Mesh(np.zeros((1, 3)), np.zeros((0, 2), dtype=int), ()),
        dofs=DofMap(sp.csr_array(np.eye(6)[:, :3]), np.zeros(3, dtype=int), np.arange(3)),
        clusters={"all": np.arange(3)},
        locator=Corner(),
    )


def eigenvalues(modes):
    return 2 * np.pi * (1j * modes.damped_freq - modes.damping_ratio * modes.natural_freq)


def quadratic(m, c, k):
    """Eigenvalues and shapes of ``(l^2 m + l c + k) x = 0`` with positive imaginary part."""
    n = len(m)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-la.solve(m, k), -la.solve(m, c)]])
    values, vectors = la.eig(state)
    order = [i for i in np.argsort(values.imag) if values[i].imag > 1e-9]
    return values[order], vectors[:n, order]


def with_hung(body, rows, share=1.0, ratio=0.03):
    magnitude = Parameter("m", 0.0, 0.0, 5.0, "kg", prior_sd=1.0)
    freq = Parameter("f", 4.0, 1.0, 20.0, "Hz")
    build = lambda model: hung_masses(rows, "m", "f", ratio, share)  # noqa: E731
    return extend(body, [Effect("m", "m", "", "", magnitude, build, (freq,), ({"m": 1.0, "f": 4.0},))])


@pytest.mark.parametrize("mass", [1e-6, 0.05, 0.7, 4.0])
@pytest.mark.parametrize("freq", [2.0, 4.0, 11.0])
@pytest.mark.parametrize("ratio", [0.0, 0.08])
def test_a_hung_mass_is_the_two_mass_oscillator(body, mass, freq, ratio):
    model = with_hung(body, [np.array([1.0, 0.0, 0.0])], ratio=ratio)
    k, c = mass * (2 * np.pi * freq) ** 2, 2 * ratio * mass * 2 * np.pi * freq
    link = np.array([[1.0, -1.0], [-1.0, 1.0]])
    expected, shapes = quadratic(np.diag([M0, mass]), np.diag([30.0, 0.0]) + c * link, np.diag([K0, 0.0]) + k * link)
    modes = model.modes({"m": mass, "f": freq}, 4)
    moving = [k for k in range(4) if abs(modes.shapes[1:3, k]).max() < 1e-9 * abs(modes.shapes[:, k]).max()]
    moving.sort(key=lambda k: eigenvalues(modes)[k].imag)
    assert len(moving) == 2
    np.testing.assert_allclose(eigenvalues(modes)[moving], expected, rtol=1e-6)
    # The added coordinate is the relative motion times the square root of the mass.
    relative = modes.shapes[3, moving] / modes.shapes[0, moving] / np.sqrt(mass)
    np.testing.assert_allclose(relative, shapes[1] / shapes[0] - 1, rtol=1e-5)


def test_several_hung_masses_share_the_mass(body):
    """Three at different motions, against separate oscillators with 1.2/3 of the mass each."""
    rows = [np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8]), np.array([0.3, 0.0, -0.5])]
    mass, freq, share = 2.0, 4.6, 1.2
    model = with_hung(body, rows, share)
    part, w = share * mass / 3, 2 * np.pi * freq
    m, c, k = (
        np.diag([M0] * 3 + [part] * 3),
        np.diag([30.0] + [0.0] * 5),
        np.diag([K0, K0 * 25 / 16, K0 * 36 / 16, 0, 0, 0]),
    )
    for j, b in enumerate(rows):
        link = np.concatenate([-b, np.eye(3)[j]])
        k = k + part * w**2 * np.outer(link, link)
        c = c + 2 * 0.03 * part * w * np.outer(link, link)
    found = np.sort_complex(eigenvalues(model.modes({"m": mass, "f": freq}, 6)))
    np.testing.assert_allclose(found, np.sort_complex(quadratic(m, c, k)[0]), rtol=1e-6)


def test_a_very_stiff_hung_mass_is_a_rigid_one(body):
    model = with_hung(body, [np.array([1.0, 0.0, 0.0])], ratio=0.0)
    modes = model.modes({"m": 1.5, "f": 3000.0, "c": 0.0}, 1)
    assert modes.natural_freq[0] == pytest.approx(np.sqrt(K0 / (M0 + 1.5)) / 2 / np.pi, rel=1e-5)


@pytest.mark.parametrize("sag", [1e-6, 0.4, 9.0, 150.0])
@pytest.mark.parametrize("ratio", [0.0, 0.08])
def test_a_loosened_mass_is_the_two_mass_oscillator_of_the_same_weight(body, sag, ratio):
    """1.2 of the body's 3 kg are released in x; the sag is in mm."""
    part, w = 1.2, np.sqrt(GRAVITY / (sag * 1e-3))
    magnitude = Parameter("sag", 1e-6, 1e-6, 500.0, "mm", prior_sd=5.0)
    build = lambda m: loosened_masses([np.sqrt(part) * np.array([1.0, 0.0, 0.0])], "sag", ratio)  # noqa: E731
    model = extend(body, [Effect("sag", "sag", "", "", magnitude, build)])
    link = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for lam in (0.3j, 9j - 1, 70j):
        k, c, m = (a.toarray()[np.ix_([0, 3], [0, 3])] for a in model.matrices({"sag": sag}))
        z = k + lam * c + lam**2 * m
        single = np.diag([K0 + 30.0 * lam + (M0 - part) * lam**2, part * lam**2])
        single = single + part * (w**2 + 2 * ratio * w * lam) * link
        expected = single[0, 0] - single[0, 1] ** 2 / single[1, 1]
        assert z[0, 0] - z[0, 1] ** 2 / z[1, 1] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("stiffness", [1e-3, 50.0, 4e3])
def test_a_maxwell_branch_is_soft_below_its_corner_and_stiff_above(body, stiffness):
    magnitude = Parameter("k", 0.0, 0.0, 1e5, "N/m", prior_sd=1e3)
    corner = Parameter("f", 3.0, 0.1, 50.0, "Hz")
    build = lambda m: maxwell_branches([np.array([0.0, 1.0, 0.0])], "k", "f")  # noqa: E731
    model = extend(body, [Effect("k", "k", "", "", magnitude, build, (corner,), ({"k": 1e3, "f": 3.0},))])
    k, c, m = (a.toarray()[np.ix_([1, 3], [1, 3])] for a in model.matrices({"k": stiffness, "f": 3.0}))
    for lam in (0.01j, 19j - 2, 4e4j):
        z, along = k + lam * c + lam**2 * m, lam / (2 * np.pi * 3.0)
        branch = stiffness * along / (1 + along)
        assert z[0, 0] - z[0, 1] ** 2 / z[1, 1] == pytest.approx(K0 * 25 / 16 + M0 * lam**2 + branch, rel=1e-10)


def with_parts(body):
    parts = (
        Part("spring", "stiffness", sp.csr_array(np.diag([1.0, 0.0, 0.0])), parameter("k"), (0.0, 0.0, 0.0)),
        Part("spring", "mass", sp.csr_array(np.diag([0.0, 2.0, 0.0])), Monomial(3.0), (0.0, 0.0, 0.0)),
    )
    return replace(body, parts=parts)


def test_parts_are_scaled_and_softened(body):
    model, values = with_parts(body), {"k": 400.0, "e": 0.3, "s": 1e-3}
    scaled = scaled_part(model, "stiffness", "spring", "e", -1.0)
    assert scaled.coefficient(values) * scaled.matrix[0, 0] == pytest.approx(-0.3 * 400.0)
    softened = softened_part(model, "spring", "s")
    assert 400.0 + softened.coefficient(values) * softened.matrix[0, 0] == pytest.approx(1 / (1 / 400.0 + 1e-3))
    assert scaled_part(model, "mass", "spring", "e").coefficient(values) == pytest.approx(0.9)
    with pytest.raises(InputError, match="0 parts 'spring' of damping"):
        part_of(model, "damping", "spring")


def with_soft(body):
    magnitude = Parameter("s", 0.0, 0.0, 1e7, "mm/MN", prior_sd=1e5)
    build = lambda model: soft_mounts([np.array([1.0, 0.0, 0.0])], "c", "s")  # noqa: E731
    return extend(body, [Effect("s", "s", "", "", magnitude, build)])


@pytest.mark.parametrize("damping", [3.0, 30.0, 300.0])
@pytest.mark.parametrize("flexibility", [1e-9, 1e-5, 5e-4, 8e-3])
def test_a_soft_mount_is_a_maxwell_element(body, damping, flexibility):
    """Dynamic stiffness ``k + m l^2 + c l/(1 + c s l)``, a cubic in l."""
    model = with_soft(body)
    cubic = np.roots([M0 * damping * flexibility, M0, damping + K0 * damping * flexibility, K0])
    pair = cubic[cubic.imag > 0]
    modes = model.modes({"c": damping, "s": flexibility * 1e9}, 3)
    along = np.abs(modes.shapes[0]) > 1e-3 * np.abs(modes.shapes).max(axis=0)
    np.testing.assert_allclose(eigenvalues(modes)[along], pair, rtol=1e-6)
    np.testing.assert_allclose(np.sort(modes.natural_freq[~along]), [5.0, 6.0], rtol=1e-7)


@pytest.mark.parametrize("flexibility", [1e-6, 1e-4, 1e-2])
def test_the_dynamic_stiffness_of_a_soft_mount(body, flexibility):
    model = with_soft(body)
    k, c, m = (a.toarray() for a in model.matrices({"c": 80.0, "s": flexibility * 1e9}))
    for lam in (0.5j, 20j, -3 + 40j, 500j):
        z = lam**2 * m + lam * c + k
        condensed = z[:3, :3] - np.outer(z[:3, 3], z[3, :3]) / z[3, 3]
        exact = lam * 80.0 / (1 + 80.0 * flexibility * lam)
        assert condensed[0, 0] == pytest.approx(K0 + M0 * lam**2 + exact, rel=1e-10)


def test_sum_of_springs():
    rows = [np.array([1.0, -1.0, 0.0]), np.array([0.0, 2.0, 0.5])]
    term = outer_term("two", rows, Monomial(3.0), n_added=2)
    expected = np.zeros((5, 5))
    expected[:3, :3] = sum(np.outer(b, b) for b in rows)
    np.testing.assert_allclose(term.matrix.toarray(), expected)
    assert term.coefficient({}) == 3.0 and term.name == "two"
    np.testing.assert_allclose(outer_term("one", [rows[0]], Monomial()).matrix.toarray(), np.outer(rows[0], rows[0]))


class Line:
    """Points between 0 and 19 m along x."""

    def row(self, point, direction, on=None):
        foot = min(max(point[0], 0.0), 19.0)
        return np.eye(20)[round(foot)], float(np.linalg.norm(np.subtract(point, (foot, 0.0, 0.0))))


def test_a_point_farther_off_than_the_model_is_large_is_refused(ladder):
    """The model is 19 m long."""
    model = replace(ladder(20), locator=Line())
    near, far = (None, (5.0, 18.999, 0.0)), (None, (38.1, 0.0, 0.0))
    assert motion(model, near, 0).any()
    with pytest.raises(InputError, match=r"point \(38\.1, 0, 0\) lies 19\.1 m from the model; coordinates are in m"):
        motion(model, far, 0)
    with pytest.raises(InputError, match=r"the point \(9000, 250, 0\) lies 8984 m from the tip"):
        motion(model, ("tip", (9000.0, 250.0, 0.0)), 0)
    with pytest.raises(InputError, match="coordinates are in m"):
        elongation(model, near, far)
    with pytest.raises(InputError, match="coordinates are in m"):
        between(model, near, far, 1)


def test_a_distance_within_the_sensor_tolerance_is_accepted(body):
    """A model of one node has no extent."""

    class Off(Corner):
        def row(self, point, direction, on=None):
            return np.eye(3)[direction], float(np.linalg.norm(point))

    model = replace(body, locator=Off(), sensor_tolerance=0.25)
    assert motion(model, (None, (0.25, 0.0, 0.0)), 0).any()
    with pytest.raises(InputError):
        motion(model, (None, (1.01 * 0.25, 0.0, 0.0)), 0)
    assert motion(replace(model, sensor_tolerance=None), (None, (3.0, 0.0, 0.0)), 0).any()


def test_motions_of_points(body):
    here, ground = ("body", (0.0, 0.0, 0.0)), ("ground", (3.0, 4.0, 0.0))
    np.testing.assert_array_equal(motion(body, here, 1), [0, 1, 0])
    np.testing.assert_array_equal(between(body, here, ground, 2), [0, 0, 1])
    np.testing.assert_array_equal(between(body, here, here, 2), [0, 0, 0])
    np.testing.assert_allclose(elongation(body, here, ground), [-0.6, -0.8, 0.0])
    np.testing.assert_allclose(elongation(body, ground, here), [-0.6, -0.8, 0.0])


@pytest.mark.parametrize("shift", [-0.9, -0.6, -0.13, 0.0, 0.2, 0.6, 0.75, 0.9])
def test_moved_masses_load_the_carrier_at_their_new_position(shift):
    # Cubics in the shift, a different one on either side of the masses' position, are reproduced exactly.
    own, above, below = np.random.default_rng(3).standard_normal((3, 2, 4))

    def motions(e):
        return own + (above * e + 0.3 * above * e**3 if e >= 0 else below * e - below * e**2)

    terms = moved_masses(motions, "e", 0.9, 3)
    added = sum(t.matrix.toarray() * t.coefficient({"e": shift}) for t in terms)
    np.testing.assert_allclose(added, motions(shift).T @ motions(shift) - own.T @ own, atol=1e-12)
    slope = sum(t.matrix.toarray() * t.coefficient.derivative({"e": shift}, "e") for t in terms)
    if shift not in (-0.9, -0.6, 0.0, 0.6, 0.9):
        h = 1e-6
        up, down = (motions(shift + s).T @ motions(shift + s) for s in (h, -h))
        np.testing.assert_allclose(slope, (up - down) / (2 * h), rtol=1e-6, atol=1e-8)
    if shift == 0.0:
        assert not added.any()
        first = (above + below).T @ own / 2
        np.testing.assert_allclose(slope, first + first.T, atol=1e-12)
