"""Posterior samples: mean, covariance, limits and seed."""

from dataclasses import replace

import numpy as np
import pytest

from calib.hypotheses.design.imagined import truncated_samples


@pytest.fixture
def fit(toy):
    return toy(signed=("E1",)).drawn(np.random.default_rng(1), {"E1": 1.3}).calibrated("E1")


def table(fit, count=2000, seed=1):
    return np.array([[p[n] for n in fit.names] for p in truncated_samples(fit, count, seed)])


def test_samples_have_mean_and_covariance_of_the_posterior(fit):
    points, std = table(fit), np.sqrt(np.diag(fit.covariance))
    centre = np.array([fit.values[n] for n in fit.names])
    np.testing.assert_allclose(points.mean(axis=0), centre, atol=0.05 * std.min())
    np.testing.assert_allclose(np.cov(points.T) / np.outer(std, std), fit.covariance / np.outer(std, std), atol=0.1)


def test_few_samples_fill_the_magnitude_evenly(fit):
    """One in each tenth of its distribution."""
    k = fit.names.index("E1")
    points = np.sort(table(fit, 10)[:, k])
    std = fit.covariance[k, k] ** 0.5
    tenths = np.quantile(np.random.default_rng(2).normal(fit.values["E1"], std, 100_000), np.arange(1, 10) / 10)
    assert list(np.searchsorted(tenths, points)) == list(range(10))


def test_the_seed_determines_the_samples(fit):
    assert truncated_samples(fit, 5, 3) == truncated_samples(fit, 5, 3) != truncated_samples(fit, 5, 4)


def test_a_narrow_posterior_gives_equal_samples(fit):
    sharp = replace(fit, slope=1e9 * fit.slope)
    for point in truncated_samples(sharp, 5, 1):
        assert point == pytest.approx(fit.values, abs=1e-6)


def test_samples_stay_within_the_limits_and_fill_them(toy):
    """The magnitude was fitted at its limit of 0: half of the Gaussian is left."""
    fit = toy().drawn(np.random.default_rng(1), {"E1": 0.0}).calibrated("E1")
    at_limit = replace(fit, values={**fit.values, "E1": 0.0})
    k = fit.names.index("E1")
    points, std = table(at_limit)[:, k], fit.covariance[k, k] ** 0.5
    assert points.min() >= 0 and np.mean(points == 0) < 0.01
    assert points.mean() == pytest.approx(np.sqrt(2 / np.pi) * std, rel=0.1)


def test_parameters_that_were_not_fitted_keep_their_values(fit):
    values = {**fit.values, "place": 3.0}
    assert all(p["place"] == 3.0 for p in truncated_samples(replace(fit, values=values), 4, 1))
