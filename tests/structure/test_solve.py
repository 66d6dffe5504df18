"""Modal solvers against dense state-space solutions and closed forms."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem import solve
from calib.structure.eigenproblem.deflation import deflated_eigenvectors
from calib.structure.eigenproblem.solve import solve_modes
from models.railway import bogie_on_rig


def sparse(matrix):
    return sp.csc_array(matrix)


def random_system(n, seed, rank=3, magnitude=60.0, massless=0):
    """K, C, M with stiff and light parts mixed, heavy damping of low rank and optional massless motions."""
    rng = np.random.default_rng(seed)
    scale = 10 ** rng.uniform(-1, 1, n)
    a, b = rng.standard_normal((2, n, n))
    k = 1e4 * (a @ a.T / n + np.eye(n)) * np.outer(scale, scale)
    m = (b @ b.T / n + np.eye(n)) * np.outer(scale, scale)
    d = rng.standard_normal((n, rank)) * scale[:, None]
    idle = rng.permutation(n)[:massless]
    m[idle], m[:, idle], d[idle] = 0.0, 0.0, 0.0
    return k, magnitude * d @ d.T, m


def state_space(k, c, m):
    """All eigenvalues of ``lambda^2 M + lambda C + K`` by LAPACK, massless motions condensed out first."""
    heavy = np.flatnonzero(np.diag(m) > 0)
    light = np.flatnonzero(np.diag(m) == 0)
    if len(light):
        k = k[np.ix_(heavy, heavy)] - k[np.ix_(heavy, light)] @ np.linalg.solve(
            k[np.ix_(light, light)], k[np.ix_(light, heavy)]
        )
    n = len(heavy)
    mass, damping = m[np.ix_(heavy, heavy)], c[np.ix_(heavy, heavy)]
    zero = np.zeros((n, n))
    return la.eigvals(np.block([[zero, np.eye(n)], [-k, -damping]]), np.block([[np.eye(n), zero], [zero, mass]]))


def eigenvalues_of(modes):
    return 2 * np.pi * (-modes.damping_ratio * modes.natural_freq + 1j * modes.damped_freq)


def oscillating(eigenvalues):
    found = eigenvalues[eigenvalues.imag > 1e-9 * np.abs(eigenvalues)]
    return found[np.argsort(np.abs(found))]


CASES = [(6, 0), (40, 0), (40, 9), (110, 0), (110, 25)]


@pytest.mark.parametrize(("n", "massless"), CASES)
@pytest.mark.parametrize("seed", [0, 1])
def test_damped_eigenvalues_are_those_of_the_dense_state_space(n, massless, seed):
    k, c, m = random_system(n, seed, massless=massless)
    count = 12
    truth = oscillating(state_space(k, c, m))[:count]
    modes = solve_modes(sparse(k), sparse(c), sparse(m), count)
    assert modes.is_complex and modes.n_modes == min(count, len(truth))
    np.testing.assert_allclose(eigenvalues_of(modes), truth, rtol=1e-7)
    assert np.all(np.diff(modes.natural_freq) >= 0)
    assert np.all((modes.damping_ratio > -1e-12) & (modes.damping_ratio < 1))


@pytest.mark.parametrize(("n", "massless"), CASES)
def test_damped_shapes_solve_the_problem_and_are_normalised(n, massless):
    k, c, m = random_system(n, 2, massless=massless)
    modes = solve_modes(sparse(k), sparse(c), sparse(m), 10)
    for lam, shape in zip(eigenvalues_of(modes), modes.shapes.T, strict=True):
        residual = (lam**2 * m + lam * c + k) @ shape
        assert np.linalg.norm(residual) < 1e-8 * np.linalg.norm(k @ shape)
        assert shape @ ((2 * lam * m + c) @ shape) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("n", "massless"), CASES)
def test_undamped_modes_are_those_of_lapack(n, massless):
    k, _, m = random_system(n, 3, massless=massless)
    truth = np.sort(state_space(k, 0 * k, m).imag)
    truth = truth[truth > 0] / (2 * np.pi)
    for damping in (None, sparse(np.zeros((n, n)))):
        modes = solve_modes(sparse(k), damping, sparse(m), 10)
        count = min(10, n - massless)
        assert not modes.is_complex and modes.n_modes == count
        np.testing.assert_allclose(modes.natural_freq, truth[:count], rtol=1e-9)
        np.testing.assert_array_equal(modes.damped_freq, modes.natural_freq)
        assert not modes.damping_ratio.any()
        np.testing.assert_allclose(modes.shapes.T @ m @ modes.shapes, np.eye(count), atol=1e-8)
        squares = (2 * np.pi * modes.natural_freq) ** 2
        np.testing.assert_allclose(modes.shapes.T @ k @ modes.shapes, np.diag(squares), atol=1e-7 * squares.max())


@pytest.mark.parametrize("massless", [0, 7])
@pytest.mark.parametrize("n", [30, 100])
def test_more_modes_than_there_are_gives_all_of_them(n, massless):
    k, c, m = random_system(n, 4, massless=massless)
    eigenvalues = state_space(k, c, m)
    modes = solve_modes(sparse(k), sparse(c), sparse(m), 10 * n)
    np.testing.assert_allclose(eigenvalues_of(modes), oscillating(eigenvalues), rtol=1e-6)
    overdamped = [r for r in modes.excluded if r.kind == "overdamped"]
    real = eigenvalues[np.abs(eigenvalues.imag) <= 1e-9 * np.abs(eigenvalues)].real
    assert len(overdamped) == len(real) == len(modes.excluded) > 0
    np.testing.assert_allclose(sorted(r.eigenvalue.real for r in overdamped), np.sort(real), rtol=1e-6)
    assert solve_modes(sparse(k), None, sparse(m), 10 * n).n_modes == n - massless


@pytest.mark.parametrize("damped", [True, False])
def test_dense_and_iterative_paths_agree(monkeypatch, damped):
    k, c, m = random_system(60, 5, massless=11)
    results = []
    for limit in (10, 1000):
        monkeypatch.setattr(solve, "DENSE_LIMIT", limit)
        results.append(solve_modes(sparse(k), sparse(c) if damped else None, sparse(m), 9))
    one, other = results
    for name in ("natural_freq", "damped_freq", "damping_ratio"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-8, atol=1e-10)
    # shapes are defined up to their sign
    sign = np.sign(np.real(np.einsum("ij,ij->j", one.shapes.conj(), other.shapes)))
    np.testing.assert_allclose(one.shapes * sign, other.shapes, atol=1e-6 * np.abs(one.shapes).max())


@pytest.mark.parametrize("n", [30, 120])
@pytest.mark.parametrize("damped", [True, False])
def test_the_same_point_gives_the_same_digits(n, damped):
    k, c, m = (sparse(x) for x in random_system(n, 6))
    one, other = (solve_modes(k, c if damped else None, m, 8) for _ in range(2))
    for name in ("natural_freq", "damped_freq", "damping_ratio", "shapes"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("n", [20, 120])
@pytest.mark.parametrize("damped", [True, False])
def test_repeated_eigenvalues_are_all_found(n, damped):
    # Four equal oscillators at each of n/4 frequencies, mixed by a rotation.
    omega = 100.0 * (1 + np.arange(n // 4)).repeat(4) ** 0.5
    turn = np.linalg.qr(np.random.default_rng(7).standard_normal((n, n)))[0]
    k = turn @ np.diag(omega**2) @ turn.T
    modes = solve_modes(sparse(k), sparse(2e-4 * k) if damped else None, sparse(np.eye(n)), 10)
    np.testing.assert_allclose(2 * np.pi * modes.natural_freq, omega[:10], rtol=1e-8)
    assert np.linalg.matrix_rank(modes.shapes, tol=1e-6 * np.abs(modes.shapes).max()) == 10


@pytest.mark.medium
@pytest.mark.parametrize("damped", [True, False])
def test_many_copies_of_an_eigenvalue_are_all_found(damped):
    # Thirty equal oscillators among others, such as the seats of a car.
    omega = np.concatenate([np.full(30, 100.0), np.linspace(120.0, 500.0, 90)])
    turn = np.linalg.qr(np.random.default_rng(7).standard_normal((120, 120)))[0]
    k = turn @ np.diag(omega**2) @ turn.T
    for count in (20, 34):
        modes = solve_modes(sparse(k), sparse(2e-4 * k) if damped else None, sparse(np.eye(120)), count)
        np.testing.assert_allclose(2 * np.pi * modes.natural_freq, omega[:count], rtol=1e-8)
        assert np.linalg.matrix_rank(modes.shapes, tol=1e-6 * np.abs(modes.shapes).max()) == count


@pytest.mark.parametrize("ratio", [1e-6, 0.03, 0.6, 0.999])
def test_one_oscillator(ratio):
    mass, stiffness = 3.0, 5e4
    omega = np.sqrt(stiffness / mass)
    modes = solve_modes(sparse([[stiffness]]), sparse([[2 * ratio * mass * omega]]), sparse([[mass]]), 3)
    assert modes.n_modes == 1 and not modes.excluded
    assert modes.natural_freq[0] == pytest.approx(omega / (2 * np.pi), rel=1e-10)
    assert modes.damping_ratio[0] == pytest.approx(ratio, rel=1e-7)
    assert modes.damped_freq[0] == pytest.approx(modes.natural_freq[0] * np.sqrt(1 - ratio**2), rel=1e-8)


def test_an_overdamped_oscillator_is_not_a_mode():
    omega, ratio = 40.0, 1.7
    modes = solve_modes(sparse([[omega**2]]), sparse([[2 * ratio * omega]]), sparse([[1.0]]), 3)
    assert modes.n_modes == 0
    assert [r.kind for r in modes.excluded] == ["overdamped", "overdamped"]
    expected = -omega * (ratio + np.array([-1, 1]) * np.sqrt(ratio**2 - 1))
    np.testing.assert_allclose([r.eigenvalue for r in modes.excluded], expected, rtol=1e-9)


@pytest.mark.parametrize("omega", [2.0, 7.0, 40.0, 700.0])
def test_a_critically_damped_oscillator_is_not_a_mode(omega):
    # Its two real eigenvalues coincide, and rounding splits them by the square root of the machine precision.
    k, c = np.diag([omega**2, omega**2, 9.0]), np.diag([2 * omega, 2 * omega, 0.1])
    modes = solve_modes(sparse(k), sparse(c), sparse(np.eye(3)), 3)
    assert modes.n_modes == 1
    assert modes.natural_freq[0] == pytest.approx(3 / (2 * np.pi), rel=1e-9)
    assert len(modes.excluded) == 4


def chain(n, grounded=False):
    k = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    k[-1, -1] = 1.0
    if not grounded:
        k[0, 0] = 1.0
    return 1e5 * k


@pytest.mark.parametrize("n", [12, 120])
@pytest.mark.parametrize("damped", [True, False])
def test_rigid_body_motion_is_named_and_does_not_count(n, damped):
    k, m = chain(n), np.eye(n)
    pair = np.zeros(n)
    pair[2], pair[3] = 1.0, -1.0
    c = sparse(40.0 * np.outer(pair, pair)) if damped else None
    modes = solve_modes(sparse(k), c, sparse(m), 5, rotational=np.zeros(n, dtype=bool))
    truth = 2 * np.sqrt(1e5) * np.sin(np.arange(1, 6) * np.pi / (2 * n)) / (2 * np.pi)
    np.testing.assert_allclose(modes.natural_freq, truth, rtol=2e-2 if damped else 1e-8)
    zeros = [r for r in modes.excluded if r.kind == "zero"]
    assert len(zeros) == (2 if damped else 1)
    assert all(abs(r.eigenvalue) < 1e-3 * 2 * np.pi * truth[0] for r in zeros)


@pytest.mark.parametrize("n", [12, 120])
@pytest.mark.parametrize("damped", [True, False])
def test_a_part_that_turns_freely_is_named_spin(n, damped):
    # A grounded chain, and a free wheel.
    k, m = la.block_diag(chain(n, grounded=True), 0.0), np.diag([*np.ones(n), 48.0])
    c = np.zeros((n + 1, n + 1))
    c[1, 1] = 5.0
    rotational_share = np.zeros(n + 1, dtype=bool)
    rotational_share[-1] = True
    modes = solve_modes(sparse(k), sparse(c) if damped else None, sparse(m), 4, rotational=rotational_share)
    assert modes.n_modes == 4 and modes.natural_freq[0] > 0.5
    assert {r.kind for r in modes.excluded} == {"spin"}
    unnamed = solve_modes(sparse(k), sparse(c) if damped else None, sparse(m), 4)
    assert {r.kind for r in unnamed.excluded} == {"zero"}
    np.testing.assert_array_equal(unnamed.natural_freq, modes.natural_freq)


@pytest.mark.parametrize("n", [10, 120])
def test_a_soft_mode_among_stiff_ones_is_kept(n):
    # A mode five decades below the stiffest local frequency is kept.
    k, m = np.diag(np.linspace(0.5, 1.0, n) * 1e10), np.eye(n)
    k[0, 0] = 1.0
    for c in (None, sparse(0.001 * np.eye(n))):
        modes = solve_modes(sparse(k), c, sparse(m), 2)
        assert modes.natural_freq[0] == pytest.approx(1 / (2 * np.pi), rel=1e-4)


def test_the_first_mode_of_a_fine_mesh_is_found_alone():
    """A cantilever of 50 m in 504 elements: entries of K are 4e11 times its lowest square, and round to 1e-5 of it."""
    n, ei, mass, length = 504, 1e5, 50.0, 0.1
    a = 6 * length
    element = np.array([[12, a, -12, a], [a, 0.04, -a, 0.02], [-12, -a, 12, -a], [a, 0.02, -a, 0.04]]) * ei / length**3
    k = np.zeros((2 * n + 2, 2 * n + 2))
    for first in range(0, 2 * n, 2):
        k[first : first + 4, first : first + 4] += element
    m = sp.csc_array(sp.diags_array([mass * length, 0.0] * n))
    for stiffer in np.linspace(0.5, 1.5, 8):
        found = solve_modes(sparse(stiffer * k[2:, 2:]), None, m, 1)
        closed_form = 1.8751041**2 / (n * length) ** 2 * np.sqrt(stiffer * ei / mass) / (2 * np.pi)
        np.testing.assert_allclose(found.natural_freq, [closed_form], rtol=5e-3)


def test_rotations_of_very_small_inertia_hide_no_soft_mode():
    # A chain of masses on one soft spring; each has a rotation with the small inertia of a thin shell.
    n = 60
    row = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    row[0, 0] = row[-1, -1] = 1.0
    row = 1e8 * row
    row[0, 0] += 60.0
    k = sp.csc_array(np.kron(row, np.diag([1.0, 0.0])) + np.kron(np.eye(n), np.diag([0.0, 1e6])))
    m = sp.csc_array(np.kron(np.eye(n), np.diag([1.0, 1e-9])))
    modes = solve_modes(k, None, m, 1, rotational=np.arange(2 * n) % 2 == 1)
    assert modes.natural_freq[0] == pytest.approx(1 / (2 * np.pi), rel=1e-4)
    assert not modes.excluded


@pytest.mark.parametrize("n", [10, 120])
@pytest.mark.parametrize("broken", ["stiffness", "damping", "mass"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_matrices_that_are_not_finite_are_refused(n, broken, value):
    matrices = dict(zip(("stiffness", "damping", "mass"), map(sparse, random_system(n, 8)), strict=True))
    matrices[broken].data[3] = value
    with pytest.raises(EvaluationError, match=f"the {broken} matrix"):
        solve_modes(matrices["stiffness"], matrices["damping"], matrices["mass"], 3)


@pytest.mark.parametrize("n", [10, 120])
@pytest.mark.parametrize("damped", [True, False])
def test_motion_without_mass_and_stiffness_cannot_be_solved(n, damped):
    k, c, m = random_system(n, 9)
    for matrix in (k, c, m):
        matrix[2], matrix[:, 2] = 0.0, 0.0
    with pytest.raises(EvaluationError):
        solve_modes(sparse(k), sparse(c) if damped else None, sparse(m), 3)
    with pytest.raises(EvaluationError, match="no mass"):
        solve_modes(sparse(k), None, sparse(0 * m), 3)


def test_free_body_of_few_motions_is_as_precise_as_lapack():
    # Rigid-body motion makes the shifted stiffness nearly singular; frequencies must not suffer from it.
    for n in (5, 40):
        k = chain(n)
        k[-2:, -2:] += 1e9 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        truth = np.sqrt(la.eigvalsh(k)[1:]) / (2 * np.pi)
        modes = solve_modes(sparse(k), None, sparse(np.eye(n)), n)
        np.testing.assert_allclose(modes.natural_freq, truth, rtol=1e-8)


@pytest.mark.slow
def test_the_four_equal_axle_torsions_of_the_bogie_are_all_found():
    model = bogie_on_rig()
    stiffness, damping, mass = model.matrices({})
    undamped = solve_modes(stiffness, None, mass, 16).natural_freq
    assert np.count_nonzero(np.abs(undamped - 55.988) < 1e-3) == 4
    truth = 1 / np.sqrt(la.eigh(mass.toarray(), stiffness.toarray(), eigvals_only=True)[::-1][:16]) / (2 * np.pi)
    np.testing.assert_allclose(undamped, truth, rtol=1e-8)
    damped = [solve_modes(stiffness, damping, mass, count) for count in (14, 20)]
    for modes in damped:
        np.testing.assert_allclose(modes.natural_freq, damped[-1].natural_freq[: modes.n_modes], rtol=1e-8)
    assert np.count_nonzero(np.abs(damped[-1].natural_freq - 55.988) < 5e-3) == 4


@pytest.mark.medium
@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
@settings(max_examples=15)
def test_deflation_finds_every_missed_eigenvector(seed, left_out):
    rng = np.random.default_rng(seed)
    values = np.concatenate([np.full(12, 1.0), np.linspace(0.9, 0.01, 108)])
    turn = np.linalg.qr(rng.standard_normal((120, 120)))[0]
    matrix = turn @ np.diag(values) @ turn.T
    lost = rng.permutation(20)[:left_out]
    found = np.delete(turn[:, :40], lost, axis=1)
    while True:
        more, certain = deflated_eigenvectors(lambda x: matrix @ x, found, values[19] * (1 - 1e-6))
        assert certain
        if not more.shape[1]:
            break
        found = np.hstack([found, more])
    assert found.shape[1] == 40
    np.testing.assert_allclose(found.T @ found, np.eye(40), atol=1e-9)
    np.testing.assert_allclose(found @ (found.T @ turn[:, lost]), turn[:, lost], atol=1e-7)


@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("lost", [0, 3, 6])
def test_a_mode_that_the_iteration_misses_is_detected(monkeypatch, damped, lost):
    k, c, m = (sparse(x) for x in random_system(150, 11, magnitude=20.0))
    whole = solve_modes(k, c if damped else None, m, 8)
    name = "eigs" if damped else "eigsh"
    iterate = getattr(solve.spla, name)

    def forgetful(*args, **options):
        values, vectors = iterate(*args, **options)
        omega = 2 * np.pi * whole.natural_freq[lost]
        size = 1 / np.abs(values) if damped else np.sqrt(np.abs(values))
        kept = np.abs(size / omega - 1) > 1e-4
        assert np.count_nonzero(~kept) == (2 if damped else 1)
        return values[kept], vectors[:, kept]

    monkeypatch.setattr(solve.spla, name, forgetful)
    found = solve_modes(k, c if damped else None, m, 8)
    np.testing.assert_allclose(found.natural_freq, whole.natural_freq, rtol=1e-8)


def test_frequencies_beside_rigid_motions_are_as_good_as_their_shapes():
    """Squares that the iteration has wrong by 1e-6 are mended; those of rigid-body motions stay."""
    stiffness = sp.csc_array(2 * np.eye(12) - np.eye(12, k=1) - np.eye(12, k=-1) - np.diag([1.0, *[0.0] * 10, 1.0]))
    squares, shapes = np.linalg.eigh(stiffness.toarray())
    rough = shapes + 1e-6 * np.random.default_rng(1).standard_normal(shapes.shape)
    given = np.where(np.arange(12) > 0, squares * (1 + 1e-6), 1e-17)
    found = solve._refined(given, rough, stiffness, sp.csc_array(np.eye(12)), 1e-6)
    assert found[0] == 1e-17 and found[1:] == pytest.approx(squares[1:], rel=1e-9)


def test_rigid_motions_are_known_before_modes_are_requested(monkeypatch):
    """Three free chains of springs, each with its closed form: the iteration runs once, for three more than wanted."""
    size, asked = 300, []
    chain = sp.diags([np.ones(size - 1), -np.ones(size - 1)], [0, 1], shape=(size - 1, size))
    stiffness = sp.csc_array(sp.block_diag([1e4 * (chain.T @ chain)] * 3))
    iteration = solve.spla.eigsh
    monkeypatch.setattr(solve.spla, "eigsh", lambda *a, k, **more: asked.append(k) or iteration(*a, k=k, **more))
    found = solve_modes(stiffness, None, sp.csc_array(sp.identity(3 * size)), 9)
    omega = 2 * 1e2 * np.sin(np.pi * np.arange(1, 4) / (2 * size))
    np.testing.assert_allclose(found.natural_freq, np.repeat(omega, 3) / (2 * np.pi), rtol=1e-9)
    assert asked == [12] and len(found.excluded) == 3
