"""Points drawn from a posterior: its mean, covariance and limits, and the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.draws import drawn


@pytest.fixture
def state(toy):
    return toy(signed=("E1",)).drawn(np.random.default_rng(1), {"E1": 1.3}).calibrated("E1")


def table(state, count=2000, seed=1):
    return np.array([[p[n] for n in state.names] for p in drawn(state, count, seed)])


def test_they_have_mean_and_covariance_of_the_posterior(state):
    points, std = table(state), np.sqrt(np.diag(state.covariance))
    centre = np.array([state.values[n] for n in state.names])
    np.testing.assert_allclose(points.mean(axis=0), centre, atol=0.05 * std.min())
    np.testing.assert_allclose(np.cov(points.T) / np.outer(std, std), state.covariance / np.outer(std, std), atol=0.1)


def test_a_few_of_them_cover_the_strength_evenly(state):
    """One in each tenth of its distribution."""
    k = state.names.index("E1")
    points = np.sort(table(state, 10)[:, k])
    std = state.covariance[k, k] ** 0.5
    tenths = np.quantile(np.random.default_rng(2).normal(state.values["E1"], std, 100_000), np.arange(1, 10) / 10)
    assert list(np.searchsorted(tenths, points)) == list(range(10))


def test_the_same_seed_draws_the_same_points_and_another_one_others(state):
    assert drawn(state, 5, 3) == drawn(state, 5, 3) != drawn(state, 5, 4)


def test_a_posterior_that_has_shrunk_is_a_point(state):
    sharp = replace(state, slope=1e9 * state.slope)
    for point in drawn(sharp, 5, 1):
        assert point == pytest.approx(state.values, abs=1e-6)


def test_they_keep_to_the_limits_and_still_fill_what_is_inside(toy):
    """The strength was fitted at its limit of 0: half of the Gaussian is left."""
    state = toy().drawn(np.random.default_rng(1), {"E1": 0.0}).calibrated("E1")
    at_limit = replace(state, values={**state.values, "E1": 0.0})
    k = state.names.index("E1")
    points, std = table(at_limit)[:, k], state.covariance[k, k] ** 0.5
    assert points.min() >= 0 and np.mean(points == 0) < 0.01
    assert points.mean() == pytest.approx(np.sqrt(2 / np.pi) * std, rel=0.1)


def test_what_was_not_fitted_stays(state):
    values = {**state.values, "place": 3.0}
    assert all(p["place"] == 3.0 for p in drawn(replace(state, values=values), 4, 1))
