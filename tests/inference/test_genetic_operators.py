"""Mutation and mating of the genetic algorithm."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.inference.genetic import GeneticSettings, reflect
from calib.problem.space import Parameter, ParameterSpace
from tests.inference.genetic_searches import box, copied, play

# -- mutation ----------------------------------------------------------------------------------------------------------


def test_the_deviation_falls_linearly():
    settings = GeneticSettings()
    assert settings.sigma(2) == 0.10 and settings.sigma(250) == pytest.approx(0.01)
    assert settings.sigma(126) == pytest.approx(0.055)
    steps = np.diff([settings.sigma(g) for g in range(2, 251)])
    np.testing.assert_allclose(steps, -0.09 / 248)
    assert GeneticSettings(generations=2).sigma(2) == 0.10


@pytest.mark.medium
def test_mutations_measured():
    # Every parent in the middle: whatever differs has mutated, far from the limits.
    n, settings = 40, GeneticSettings(population=200, generations=4, sigma_start=0.08, sigma_end=0.02)
    space = box(n, -3.0, 5.0)
    populations, _ = play(space, settings, initial=np.full((200, n), 1.0), misfit=lambda x: np.zeros(len(x)))
    moved = populations[1][populations[1] != 1.0]
    assert len(moved) / (200 * n) == pytest.approx(0.15, abs=5 * np.sqrt(0.15 * 0.85 / (200 * n)))
    assert moved.mean() == pytest.approx(1.0, abs=0.08)
    for generation, sigma in ((1, 0.08), (2, 0.05), (3, 0.02)):
        fresh = ~copied(populations[generation], populations[generation - 1])
        parents = np.unique(populations[generation - 1].ravel())
        gaps = populations[generation][fresh]
        if generation == 1:
            assert np.std(gaps - 1.0) / 8.0 == pytest.approx(sigma, rel=0.1)
        else:
            assert len(parents) > 1
            nearest = np.abs(gaps - 1.0) / 8.0  # three quarters of the parents' genes are still in the middle
            assert np.median(nearest) == pytest.approx(0.6745 * sigma, rel=0.35)


@given(st.integers(0, 2**32), st.floats(0.01, 50.0))
def test_reflection_stays_inside_and_is_a_mirror(seed, reach):
    rng = np.random.default_rng(seed)
    lower, upper = np.array([-2.0, 0.0, 1e6]), np.array([1.0, 1e-3, 3e6])
    inside = lower + (upper - lower) * rng.random((20, 3))
    np.testing.assert_array_equal(reflect(inside, lower, upper), inside)
    far = inside + reach * (upper - lower) * rng.standard_normal((20, 3))
    folded = reflect(far, lower, upper)
    assert np.all((folded >= lower) & (folded <= upper))
    step = 0.3 * (upper - lower) * rng.random((20, 3))
    np.testing.assert_allclose(reflect(lower - step, lower, upper), lower + step)
    np.testing.assert_allclose(reflect(upper + step, lower, upper), upper - step)


def test_limits_are_kept_and_do_not_collect_individuals():
    settings = GeneticSettings(population=20, generations=30, mutation=0.5, sigma_start=0.8, sigma_end=0.5)
    populations, _ = play(box(4), settings)
    assert np.all((populations >= 0) & (populations <= 1))
    assert not np.any((populations[1:] == 0) | (populations[1:] == 1))


def test_integers_stay_whole():
    mixed = ParameterSpace((Parameter("n", 1, 1, 5, integer=True), Parameter("x", 0.5, 0.0, 1.0)))
    settings = GeneticSettings(population=12, generations=20, sigma_start=0.3, sigma_end=0.3)
    populations, _ = play(mixed, settings, misfit=lambda x: (x[:, 0] - 4) ** 2 + x[:, 1])
    assert set(np.unique(populations[..., 0])) <= {1.0, 2.0, 3.0, 4.0, 5.0}
    assert len(np.unique(populations[1:, :, 0])) == 5
    assert np.mean(populations[-1][:, 0] == 4.0) > 0.5
    assert np.all((populations[..., 1] >= 0) & (populations[..., 1] <= 1))


def test_a_space_with_fewer_points_than_individuals():
    populations, _ = play(box(1, 0.0, 2.0, integer=True), GeneticSettings(population=10, generations=5))
    assert populations.shape == (5, 10, 1)


# -- mating ------------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_crossover_measured():
    # Individual k has k in every gene: a child of a crossed pair holds two numbers, a copy holds one. A mutation too
    # small to hide that makes all children different, so that none is replaced.
    n, count, pairs = 30, 100, 50
    initial = np.repeat(np.linspace(0, 1, count)[:, None], n, axis=1)
    for rate in (0.0, 0.5, 0.8):
        settings = GeneticSettings(count, 2, crossover=rate, mutation=1.0, sigma_start=1e-6, sigma_end=1e-6)
        crossed, matings = 0, 0
        for seed in range(8):
            populations, _ = play(box(n), settings, seed, lambda x: np.zeros(len(x)), initial=initial)
            numbers = np.array([len(np.unique(np.round(child * (count - 1)))) for child in populations[1]])
            assert set(numbers.tolist()) <= {1, 2}
            crossed += np.sum(numbers == 2) / 2
            matings += pairs
        # One pair in a hundred consists of one individual twice.
        assert crossed / matings == pytest.approx(rate, abs=0.02 + 3 * np.sqrt(rate * (1 - rate) / matings))


def test_crossover_takes_half_of_the_genes_from_each_parent():
    n = 40
    initial = np.repeat(np.linspace(0, 1, 50)[:, None], n, axis=1)
    populations, _ = play(box(n), GeneticSettings(50, 2, crossover=1.0, mutation=0.0), initial=initial)
    shares = [np.mean(child == child.max()) for child in populations[1] if len(np.unique(child)) == 2]
    assert len(shares) > 30 and np.mean(shares) == pytest.approx(0.5, abs=0.05)
    assert np.std(shares) == pytest.approx(np.sqrt(0.25 / n), rel=0.4)


def test_children_differ_from_each_other():
    populations, _ = play(box(2), GeneticSettings(population=20, generations=20, mutation=0.05))
    for children in populations[1:]:
        assert len(np.unique(children, axis=0)) == 20


def test_better_parents_have_more_children():
    initial = np.linspace(0.01, 0.99, 60)[:, None] * np.ones(6)
    populations, _ = play(box(6), GeneticSettings(60, 2, mutation=0.0), misfit=lambda x: x[:, 0], initial=initial)
    # In a tournament of two the better half wins three of four times.
    assert np.mean(populations[1] < 0.5) == pytest.approx(0.75, abs=0.1)
