"""Damped modes corrected from a smaller problem, against the whole problem and closed forms."""

import numpy as np
import pytest
import scipy.linalg as la

from calib.structure.eigenproblem import compression as module
from calib.structure.eigenproblem.compression import corrected_eigenpairs, static_eigenpairs
from calib.structure.eigenproblem.damped_problem import DampedProblem, Eigenpairs, real_times
from calib.structure.eigenproblem.derivatives import eigen_derivatives
from calib.structure.eigenproblem.eigenvalues import damped_modes, vibrates
from calib.structure.modes import Modes

ACCURACY = 1e-9
SIZE, COUNT = 120, 10


def problem(seed=0, dampers=6, strength=1.0, structural=1e-4, omega=None):
    """Undamped modes 10 to 1000 rad/s, discrete dampers at random places, and a little damping everywhere."""
    rng = np.random.default_rng(seed)
    omega = np.sort(10 ** rng.uniform(1, 3, SIZE)) if omega is None else omega
    places = rng.standard_normal((SIZE, dampers)) / omega[:, None]
    damping = strength * places @ places.T + structural * np.eye(SIZE)
    return DampedProblem(1.0 / omega**2, damping, 1e-4)


def whole(one):
    """All eigenpairs of the whole problem, by modulus: modes above the real axis, and real eigenvalues."""
    inverses, states = la.eig(one.inverse_matrix())
    lam, motions = one.shift + 1.0 / inverses, states[: one.size]
    modes = np.flatnonzero(vibrates(lam, one.shift))
    modes = modes[np.argsort(np.abs(lam[modes]))]
    real = np.sort(lam[np.abs(lam.imag) <= 1e-7 * np.abs(lam)].real)[::-1]
    return lam[modes], motions[:, modes], real


def split(one, found):
    values, motions = found
    modes = vibrates(values, one.shift)
    return values[modes], motions[:, modes], np.sort(values[~modes].real)[::-1]


@pytest.mark.parametrize("strength", [0.1, 1.0, 3.0, 100.0])
@pytest.mark.parametrize("seed", range(5))
def test_corrected_eigenpairs_are_those_of_the_whole_problem(seed, strength):
    one = problem(seed, strength=strength)
    lam, motions, real = whole(one)
    found = corrected_eigenpairs(one, COUNT, ACCURACY)
    assert found is not None
    values, shapes, roots = split(one, found)
    np.testing.assert_allclose(values, lam[:COUNT], rtol=1e-7)
    for mine, theirs in zip(shapes.T, motions.T, strict=False):
        likeness = abs(np.vdot(mine, theirs)) ** 2 / (np.vdot(mine, mine) * np.vdot(theirs, theirs)).real
        assert 1 - likeness < 1e-7
    expected = real[np.abs(real) <= np.abs(lam[COUNT - 1])]
    assert len(roots) == len(expected)
    np.testing.assert_allclose(roots, expected, rtol=0.02)


@pytest.mark.medium
def test_the_cases_above_hold_heavily_damped_modes_and_overdamped_roots():
    found = [whole(problem(seed, strength=strength)) for seed in range(5) for strength in (1.0, 3.0, 100.0)]
    ratios = np.concatenate([-lam[:COUNT].real / np.abs(lam[:COUNT]) for lam, _, _ in found])
    assert np.any(ratios > 0.5)
    assert sum(np.count_nonzero(np.abs(real) < np.abs(lam[COUNT - 1])) for lam, _, real in found) >= 5


def test_one_damper_on_one_mode_follows_the_closed_form():
    """A coordinate with its own damper has ``lambda = omega (-zeta + i sqrt(1 - zeta^2))`` whatever the others do."""
    omega = np.linspace(10.0, 1000.0, SIZE)
    zeta = np.full(SIZE, 0.02)
    zeta[[1, 3]] = 0.7, 1.5
    found = corrected_eigenpairs(DampedProblem(1 / omega**2, np.diag(2 * zeta / omega), 1e-4), 6, ACCURACY)
    assert found is not None
    values, _, roots = split(DampedProblem(1 / omega**2, np.eye(SIZE), 1e-4), found)
    oscillating = np.delete(np.arange(7), 3)
    z, w = zeta[oscillating], omega[oscillating]
    np.testing.assert_allclose(values, w * (-z + 1j * np.sqrt(1 - z**2)), rtol=1e-9)
    np.testing.assert_allclose(roots, [-omega[3] * (1.5 - np.sqrt(1.25))], rtol=1e-6)


def test_a_slow_motion_among_the_modes_left_out_is_not_missed(monkeypatch):
    """A stiff coordinate on so strong a damper that it creeps, uncoupled from the lowest modes."""
    one = problem(1, strength=0.3)
    damping = one.damping.copy()
    damping[-1, :] = damping[:, -1] = 0.0
    damping[-1, -1] = 1 / 15.0  # a root at about -15 rad/s, among the lowest modes
    creeping = DampedProblem(one.mass, damping, one.shift)
    lam, _, real = whole(creeping)
    assert np.any(np.abs(real + 15.0) < 0.1) and abs(lam[COUNT - 1]) > 15.0
    found = corrected_eigenpairs(creeping, COUNT, ACCURACY)
    assert found is not None
    values, _, roots = split(creeping, found)
    np.testing.assert_allclose(values, lam[:COUNT], rtol=1e-7)
    assert np.any(np.abs(roots + 15.0) < 0.1)
    # Without its direction added the smaller problem knows nothing of it, and that is noticed.
    monkeypatch.setattr(module, "_STRONG", 1e6)
    monkeypatch.setattr(DampedProblem, "overdamped", lambda self, speed: 0)
    assert corrected_eigenpairs(creeping, COUNT, ACCURACY) is None


def test_an_overdamped_root_that_the_smaller_problem_lacks_is_counted(monkeypatch):
    one = problem(2, strength=3.0)
    assert corrected_eigenpairs(one, COUNT, ACCURACY) is not None
    honest = DampedProblem.overdamped
    monkeypatch.setattr(DampedProblem, "overdamped", lambda self, speed: honest(self, speed) + (self.size == SIZE))
    assert corrected_eigenpairs(one, COUNT, ACCURACY) is None


@pytest.mark.parametrize("speed", [5.0, 9.0, 9.9, 10.1, 12.0])
@pytest.mark.parametrize("zeta", [0.0, 0.07, 0.9, 1.1, 3.0])
def test_a_left_out_part_is_regular_as_far_as_its_lowest_root(zeta, speed):
    """Of one coordinate the roots are known: a pair of modulus 10 rad/s, or the slower of two real ones."""
    slowest = 10.0 * (zeta - np.sqrt(max(zeta**2 - 1, 0.0)) if zeta > 1 else 1.0)
    one = DampedProblem(np.array([1.0, 1e-2]), np.diag([0.0, 2 * zeta / 10.0]), 1e-6)
    assert module._is_regular(one, 1, np.zeros((1, 0)), speed) == (speed < slowest)


def test_many_damped_oscillators_just_above_the_modes_wanted():
    """As seats on the floor of a car: sixty at nearly one frequency, 5 % above the highest mode wanted."""
    seats = np.random.default_rng(5).uniform(99.9, 100.1, 60)
    omega = np.sort(np.concatenate([np.linspace(10.0, 95.0, 10), seats, np.geomspace(120, 1e3, 50)]))
    one = problem(5, strength=0.1, omega=omega)
    damping = one.damping.copy()
    damping[10:70, 10:70] += 2 * 0.072 / 100.0 * np.eye(60)
    one = DampedProblem(one.mass, damping, one.shift)
    lam, _, _ = whole(one)
    found = corrected_eigenpairs(one, COUNT, ACCURACY)
    assert found is not None
    np.testing.assert_allclose(split(one, found)[0], lam[:COUNT], rtol=1e-6)


def test_damping_that_couples_everything_is_left_to_the_whole_problem():
    rng = np.random.default_rng(4)
    one = problem(4)
    full = rng.standard_normal((SIZE, SIZE)) / np.sqrt(SIZE)
    coupled = DampedProblem(one.mass, 0.05 * full @ full.T, one.shift)
    assert corrected_eigenpairs(coupled, COUNT, ACCURACY) is None
    assert corrected_eigenpairs(one, SIZE // 2, ACCURACY) is None


def test_an_accuracy_that_is_not_reached_gives_nothing(monkeypatch):
    one = problem(3, strength=3.0)
    assert corrected_eigenpairs(one, COUNT, 0.0) is None
    monkeypatch.setattr(module, "_STEPS", 0)
    assert corrected_eigenpairs(one, COUNT, ACCURACY) is None
    assert corrected_eigenpairs(one, COUNT, 1.0) is not None


def test_corrections_that_lead_to_one_mode_are_noticed():
    one = problem(0)
    lam, motions, _ = whole(one)
    pairs = Eigenpairs(one, lam[:4], motions[:, :4], real_times(one.damping, motions[:, :4]))
    assert module._independent(pairs)
    assert not module._independent(pairs.subset(np.array([0, 1, 2, 1])))


@pytest.mark.parametrize("turned", [False, True])
def test_repeated_modes_are_both_found(turned):
    """Two like halves, dampers and all; in any turned coordinates of each pair of modes."""
    half = problem(5, strength=1.0)
    one = DampedProblem(np.repeat(half.mass, 2), np.kron(half.damping, np.eye(2)), half.shift)
    if turned:
        angles = np.random.default_rng(8).uniform(0, np.pi, SIZE)
        blocks = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
        turn = la.block_diag(*blocks)
        one = DampedProblem(one.mass, turn.T @ one.damping @ turn, one.shift)
    lam = whole(half)[0][: COUNT // 2]
    found = corrected_eigenpairs(one, COUNT, ACCURACY)
    if found is not None:  # or else the whole problem is solved
        np.testing.assert_allclose(split(one, found)[0].reshape(-1, 2), np.column_stack([lam, lam]), rtol=1e-7)


def test_derivatives_of_corrected_modes_are_those_of_exact_ones():
    """By least squares' way of using them: derivatives of eigenvalues and shapes by the strength of the dampers."""
    one = problem(6, strength=1.0, structural=0.0)
    found = corrected_eigenpairs(one, COUNT, ACCURACY)
    assert found is not None
    lam, exact, _ = whole(one)
    matrices = np.eye(SIZE), one.damping, np.diag(one.mass)
    nothing = np.zeros((SIZE, SIZE))
    out = []
    for values, shapes in (split(one, found)[:2], (lam[:COUNT], exact[:, :COUNT])):

        def shape_of(which: np.ndarray, shapes=shapes) -> np.ndarray:
            return shapes[:, which]

        modes: Modes = damped_modes(values, shape_of, one.damping, matrices[2], COUNT, one.shift, lambda shape: 0.0)
        out.append(eigen_derivatives(*matrices, [(nothing, one.damping, nothing)], modes, ("strength",)))
    mine, theirs = out
    np.testing.assert_allclose(mine.eigenvalue, theirs.eigenvalue, atol=1e-4 * np.abs(theirs.eigenvalue).max())
    sign = np.sign(np.einsum("pij,pij->pj", mine.shapes.conj(), theirs.shapes).real)[:, None]
    size = np.linalg.norm(theirs.shapes, axis=1, keepdims=True)
    assert np.max(np.linalg.norm(mine.shapes * sign - theirs.shapes, axis=1, keepdims=True) / size) < 1e-3


def test_static_corrections_suffice_for_small_problems_or_give_nothing():
    one = problem(7, dampers=2, strength=0.3, structural=0.0)
    lam = whole(one)[0]
    found = static_eigenpairs(one, COUNT, 1e-6)
    assert found is not None
    np.testing.assert_allclose(split(one, found)[0], lam[:COUNT], rtol=1e-5)
    assert static_eigenpairs(one, COUNT, 0.0) is None
    assert static_eigenpairs(one, SIZE, ACCURACY) is None


def test_static_corrections_miss_no_overdamped_root():
    """A high mode with a strong damper of its own has a slow root, and no part in the response to low ones."""
    omega = np.linspace(10.0, 1000.0, 40)
    zeta = np.full(40, 0.02)
    assert static_eigenpairs(DampedProblem(1 / omega**2, np.diag(2 * zeta / omega), 1e-4), 3, ACCURACY) is not None
    zeta[30] = 20.0  # roots near -omega/40 and -40 omega
    one = DampedProblem(1 / omega**2, np.diag(2 * zeta / omega), 1e-4)
    lam, _, real = whole(one)
    assert np.count_nonzero(np.abs(real) <= np.abs(lam[2])) == 1
    assert static_eigenpairs(one, 3, ACCURACY) is None
