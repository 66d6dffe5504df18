"""Dense solver of small problems against the full-order one and closed forms."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem import solve_dense as module
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.eigenproblem.solve_dense import solve_dense


def nothing(shape):
    return 0.0


def system(n, seed, rank=3, magnitude=30.0):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, n, n))
    k = a @ np.diag(10 ** rng.uniform(2, 9, n)) @ a.T
    m = b @ b.T + n * np.eye(n)
    d = rng.standard_normal((n, rank))
    return k, magnitude * n * d @ d.T, m


def eigenvalues_of(modes):
    return 2 * np.pi * (-modes.damping_ratio * modes.natural_freq + 1j * modes.damped_freq)


@pytest.mark.parametrize("magnitude", [1.0, 60.0, 3000.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_damped_modes_are_those_of_the_full_order_solver(monkeypatch, magnitude, seed):
    k, c, m = system(70, seed, magnitude=magnitude)
    full = solve_modes(sp.csc_array(k), sp.csc_array(c), sp.csc_array(m), 8)
    # Corrected modes of a smaller problem where they are certain, and those of the whole one.
    for accuracy in (module.ACCURACY, 0.0):
        monkeypatch.setattr(module, "ACCURACY", accuracy)
        found = solve_dense(k, c, m, 8, nothing)
        np.testing.assert_allclose(eigenvalues_of(found), eigenvalues_of(full), rtol=1e-7)
        for lam, shape in zip(eigenvalues_of(found), found.shapes.T, strict=True):
            assert shape @ ((2 * lam * m + c) @ shape) == pytest.approx(1.0, abs=1e-8)


def test_distributed_damping_is_not_lost_in_the_reduction():
    k, _, m = system(60, 4)
    c = 0.02 * m + 1e-3 * k
    squares = la.eigh(k, m, eigvals_only=True)[:6]
    found = solve_dense(k, c, m, 6, nothing)
    omega = np.sqrt(squares)
    np.testing.assert_allclose(2 * np.pi * found.natural_freq, omega, rtol=1e-6)
    np.testing.assert_allclose(found.damping_ratio, 0.5 * (0.02 / omega + 1e-3 * omega), rtol=1e-5)


@pytest.mark.parametrize("damped", [True, False])
def test_repeated_and_zero_eigenvalues_are_distinguished(damped):
    omega = np.concatenate([np.zeros(2), np.full(12, 50.0), np.linspace(60.0, 900.0, 46)])
    turn = np.linalg.qr(np.random.default_rng(7).standard_normal((60, 60)))[0]
    k = turn @ np.diag(omega**2) @ turn.T
    found = solve_dense(k, 2e-4 * k if damped else None, np.eye(60), 14, nothing)
    np.testing.assert_allclose(2 * np.pi * found.natural_freq, omega[2:16], rtol=1e-6)
    assert [r.kind for r in found.excluded] == ["zero"] * (4 if damped else 2)


def test_overdamped_eigenvalues_among_the_wanted_ones_are_listed():
    k, m = np.diag([25.0, 100.0, 400.0, 1e4]), np.eye(4)
    c = np.diag([0.1, 2 * 1.5 * 10.0, 0.1, 2 * 1.5 * 100.0])
    found = solve_dense(k, c, m, 2, nothing)
    np.testing.assert_allclose(found.natural_freq * 2 * np.pi, [5.0, 20.0], rtol=1e-9)
    # The second of the pair lies beyond the last wanted mode.
    assert [r.kind for r in found.excluded] == ["overdamped"]
    assert found.excluded[0].eigenvalue.real == pytest.approx(-10 * (1.5 - np.sqrt(1.25)))


@pytest.mark.parametrize("broken", [0, 1, 2])
def test_matrices_that_are_not_finite_are_refused(broken):
    matrices = list(system(10, 1))
    matrices[broken][2, 3] = np.nan
    with pytest.raises(EvaluationError, match="not finite"):
        solve_dense(*matrices, 2, nothing)


@pytest.mark.parametrize("magnitude", [1.0, 60.0])
def test_a_partial_eigensolution_agrees_with_the_full_one(monkeypatch, magnitude):
    """Inverse iteration against the full eigensolution, with repeated and overdamped eigenvalues."""
    k, c, m = system(90, 5, rank=6, magnitude=magnitude)
    twice = [np.kron(np.eye(2), a) for a in (k, c, m)]
    results = {}
    for few in (0, 1000):
        monkeypatch.setattr(module, "_FEW", few)
        results[few] = solve_dense(*twice, 10, nothing)
    np.testing.assert_allclose(eigenvalues_of(results[0]), eigenvalues_of(results[1000]), rtol=1e-7)
    pairs = np.sort(results[0].natural_freq).reshape(5, 2)
    np.testing.assert_allclose(pairs[:, 0], pairs[:, 1], rtol=1e-7)
    assert len(results[0].excluded) == len(results[1000].excluded)
