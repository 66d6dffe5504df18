"""Rows of a joint fit seen from one of its tests, against the joint fit itself, real refits and simulated data."""

import numpy as np
import pytest
from scipy import stats

from calib.inference.identify import posterior, with_held
from calib.inference.leave_one_out import leave_one_out
from calib.inference.other_rows import other_rows
from calib.problem.degrees_of_freedom import matched

OWN, PARAMS = np.arange(7), np.array([0, 1, 3])
"""Rows of one test, and its parameters; those of the other test are 0, 2, 3 and 4."""
UNITS = np.array([1.0, 1e6, 1e-4, 30.0, 1.0])
PRIOR = np.array([2.0, 1.0, 1.0, np.inf, 3.0]) / UNITS


def linear(seed=1):
    """A joint linear problem: slopes of 7 and 9 rows, of which each test lacks some parameters."""
    g = np.random.default_rng(seed).standard_normal((16, 5)) * UNITS
    g[:7, [2, 4]] = 0.0
    g[7:, 1] = 0.0
    return g


def optimum(g, y, s=PRIOR):
    """Residual and pull at the optimum of a linear model with priors about 0."""
    theta = np.linalg.solve(g.T @ g + np.diag(1 / s**2), g.T @ y)
    return y - g @ theta, theta / s


def seen(g, y, held=None):
    e, shift = optimum(g, y)
    return e, shift, other_rows(g, PRIOR, e, shift, OWN, PARAMS, held)


def test_the_part_has_the_posterior_of_the_joint_fit():
    g, rng = linear(), np.random.default_rng(2)
    held = rng.standard_normal((16, 2))
    _, _, others = seen(g, rng.standard_normal(16), held)
    own = np.vstack([g[np.ix_(OWN, PARAMS)], others.slope])
    names = ("a", "b", "c")
    joint = posterior("abcde", g, PRIOR)
    part = posterior(names, own, PRIOR[PARAMS])
    np.testing.assert_allclose(part.covariance, joint.covariance[np.ix_(PARAMS, PARAMS)], rtol=1e-9)
    place = [*PARAMS, 5, 6]
    np.testing.assert_allclose(
        with_held(part, own, np.vstack([held[OWN], others.held])),
        with_held(joint, g, held)[np.ix_(place, place)],
        rtol=1e-8, atol=1e-12,
    )  # fmt: skip


def test_the_part_is_at_the_joint_optimum():
    """The gradient over own and other rows and the own priors is 0, also where the others pull hard."""
    g, y = linear(), 20.0 * np.random.default_rng(3).standard_normal(16)
    e, shift, others = seen(g, y)
    pull = np.where(np.isfinite(PRIOR[PARAMS]), shift[PARAMS] / PRIOR[PARAMS], 0.0)
    own = g[np.ix_(OWN, PARAMS)]
    gradient = own.T @ e[OWN] + others.slope.T @ others.residual - pull
    assert np.abs(gradient / UNITS[PARAMS]).max() < 1e-9 * np.abs(own.T @ e[OWN] / UNITS[PARAMS]).max()


@pytest.mark.parametrize("groups", [list("abcdefg"), list("aabbccc"), list("aaaabbb")])
def test_left_out_rows_are_predicted_by_real_refits_of_all_tests(groups):
    g, y = linear(), np.random.default_rng(4).standard_normal(16)
    e, _, others = seen(g, y)
    found = leave_one_out(e[OWN], g[np.ix_(OWN, PARAMS)], PRIOR[PARAMS], groups, others.slope)
    for name in dict.fromkeys(groups):
        gone = np.flatnonzero([group == name for group in groups])
        kept = np.setdiff1d(np.arange(16), gone)
        information = g[kept].T @ g[kept] + np.diag(1 / PRIOR**2)
        theta = np.linalg.solve(information, g[kept].T @ y[kept])
        np.testing.assert_allclose(found.residual[gone], y[gone] - g[gone] @ theta, rtol=1e-8, atol=1e-10)
        spread = np.eye(len(gone)) + g[gone] @ np.linalg.inv(information) @ g[gone].T
        np.testing.assert_allclose(found.variance[gone], np.diag(spread), rtol=1e-8)
    alone = leave_one_out(e[OWN], g[np.ix_(OWN, PARAMS)], np.full(3, 1e3), groups)
    assert alone.variance.sum() > 1.2 * found.variance.sum()  # the other test says something


def test_a_test_without_a_common_parameter_changes_nothing():
    g = linear()
    g[7:, [0, 3]] = 0.0
    s = np.where(np.isfinite(PRIOR), PRIOR, 1.0)
    y = np.random.default_rng(5).standard_normal(16)
    e, shift = optimum(g, y, s)
    others = other_rows(g, s, e, shift, OWN, PARAMS)
    own = g[np.ix_(OWN, PARAMS)]
    np.testing.assert_allclose(others.slope / UNITS[PARAMS], 0.0, atol=1e-12)
    assert matched(own, s[PARAMS], others=others.slope) == pytest.approx(matched(own, s[PARAMS]))


def test_moments_are_those_of_the_residual_covariance():
    g = linear()
    m = np.eye(7) - (g @ np.linalg.inv(g.T @ g + np.diag(1 / PRIOR**2)) @ g.T)[:7, :7]
    others = seen(g, np.zeros(16))[2]
    scale, dof = matched(g[np.ix_(OWN, PARAMS)], PRIOR[PARAMS], others=others.slope)
    assert (scale * dof, scale**2 * dof) == pytest.approx((np.trace(m), np.sum(m**2)))
    assert matched(g[:7, :0], np.zeros(0), fitted_factors=2) == pytest.approx((1.0, 5.0))
    assert matched(np.eye(3), np.full(3, np.inf)) == pytest.approx((1.0, 0.0), abs=1e-12)  # nothing is left to test


@pytest.mark.medium
def test_chances_of_a_test_are_uniform_and_its_expected_error_is_the_mean():
    """Over noise and parameters; few rows that share three parameters with the other test, the hardest case."""
    g, s = linear(), np.array([2.0, 1.0, 1.0, 4.0, 3.0]) / UNITS
    rng = np.random.default_rng(6)
    theta = s[:, None] * rng.standard_normal((5, 4000))
    y = g @ theta + rng.standard_normal((16, 4000))
    e = y - g @ np.linalg.solve(g.T @ g + np.diag(1 / s**2), g.T @ y)
    others = other_rows(g, s, np.zeros(16), np.zeros(5), OWN, PARAMS)
    own = g[np.ix_(OWN, PARAMS)]
    squares = np.sum(e[OWN] ** 2, axis=0)
    scale, dof = matched(own, s[PARAMS], others=others.slope)
    assert np.mean(squares) == pytest.approx(scale * dof, rel=0.03)
    assert stats.kstest(stats.chi2.sf(squares / scale, dof), "uniform").statistic < 0.03
    alone = matched(own, s[PARAMS])
    assert stats.kstest(stats.chi2.sf(squares / alone[0], alone[1]), "uniform").statistic > 0.06
    out = np.array([leave_one_out(x, own, s[PARAMS], range(7), others.slope).residual for x in e[OWN].T[:200]])
    expected = leave_one_out(e[OWN, 0], own, s[PARAMS], range(7), others.slope).variance
    assert np.mean(out**2 / expected) == pytest.approx(1.0, abs=0.1)
