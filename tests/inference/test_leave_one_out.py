"""Leave-one-group-out prediction in closed form against real refits."""

import numpy as np
import pytest
from scipy import stats

from calib.errors.errors import InputError
from calib.inference.leave_one_out import leave_one_out


def fit(a, y, s, c):
    """Optimum of a linear model ``y = a theta + noise`` with prior mean c, and its covariance."""
    information = a.T @ a + np.diag(1 / s**2)
    return np.linalg.solve(information, a.T @ y + c / s**2), np.linalg.inv(information)


def problem(sizes, p=4, seed=0, prior=1.0):
    rng = np.random.default_rng(seed)
    groups = np.repeat([f"M{k}" for k in range(len(sizes))], sizes)
    a = rng.standard_normal((len(groups), p)) * np.logspace(-2, 3, p)
    s = prior / np.logspace(-2, 3, p)
    c = rng.standard_normal(p) * s
    y = a @ (c + s * rng.standard_normal(p)) + rng.standard_normal(len(groups))
    mixed = rng.permutation(len(groups))
    return a[mixed], y[mixed], s, c, groups[mixed]


def refits(a, y, s, c, groups):
    """Residual, variance, log density and chi-square of every group from true refits."""
    names = tuple(dict.fromkeys(groups.tolist()))
    out, variance, density, chi2 = np.empty(len(y)), np.empty(len(y)), [], []
    for name in names:
        b = groups == name
        theta, v = fit(a[~b], y[~b], s, c)
        spread = np.eye(b.sum()) + a[b] @ v @ a[b].T
        out[b], variance[b] = y[b] - a[b] @ theta, np.diag(spread)
        log = stats.multivariate_normal(np.zeros(b.sum()), spread, allow_singular=False).logpdf(out[b])
        density.append(log + 0.5 * b.sum() * np.log(2 * np.pi))
        chi2.append(out[b] @ np.linalg.solve(spread, out[b]))
    return names, out, variance, np.array(density), np.array(chi2)


@pytest.mark.parametrize("sizes", [(1,) * 9, (2, 3, 1, 5), (40, 30, 2), (3, 50)])
@pytest.mark.parametrize("prior", [0.3, 30.0])
def test_equals_true_refits(sizes, prior):
    a, y, s, c, groups = problem(sizes, prior=prior)
    theta, _ = fit(a, y, s, c)
    found = leave_one_out(y - a @ theta, a, s, groups.tolist())
    names, out, variance, density, chi2 = refits(a, y, s, c, groups)
    assert found.names == names
    np.testing.assert_allclose(found.residual, out, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.variance, variance, rtol=1e-8)
    np.testing.assert_allclose(found.elpd, density, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.chi2, chi2, rtol=1e-7)
    assert found.n_rows.tolist() == [int(np.sum(groups == n)) for n in names]


def test_a_parameter_that_one_group_alone_informs_returns_to_its_prior():
    a, y, s, c, groups = problem((6, 7, 5), seed=3, prior=1e3)
    a[groups != "M1", 2] = 0.0
    y = y + 40.0
    theta, _ = fit(a, y, s, c)
    found = leave_one_out(y - a @ theta, a, s, groups.tolist())
    _, out, variance, density, _ = refits(a, y, s, c, groups)
    np.testing.assert_allclose(found.residual, out, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(found.variance, variance, rtol=1e-7)
    np.testing.assert_allclose(found.elpd, density, rtol=1e-7)
    without = fit(a[groups != "M1"], y[groups != "M1"], s, c)[0]
    assert without[2] == pytest.approx(c[2])
    with pytest.raises(InputError, match="informed by the group 'M1' only"):
        leave_one_out(y - a @ theta, a, np.where(np.arange(4) == 2, np.inf, s), groups.tolist())


def test_a_nearly_free_parameter_is_not_lost_by_cancellation():
    slope = np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 0.0], [1.0, 0.0]])
    found = leave_one_out(np.zeros(4), slope, np.array([1e9, 1e9]), ["a", "a", "b", "b"])
    np.testing.assert_allclose(found.variance[:2], 1e18, rtol=1e-6)
    # H = diag(4, 2) with, and diag(2, 1e-18) without the group that alone informs the second parameter.
    assert found.elpd[0] == pytest.approx(0.5 * np.log(2e-18 / 8), rel=1e-6)


def test_units_of_parameters_do_not_matter():
    a, y, s, c, groups = problem((4, 5, 3))
    e = y - a @ fit(a, y, s, c)[0]
    unit = np.array([1e9, 1e-7, 3.0, 1e4])
    one, other = leave_one_out(e, a, s, groups.tolist()), leave_one_out(e, a * unit, s / unit, groups.tolist())
    np.testing.assert_allclose(one.residual, other.residual, rtol=1e-9)
    np.testing.assert_allclose(one.elpd, other.elpd, rtol=1e-9)


@pytest.mark.medium
def test_chance_of_the_worst_group_keeps_its_level():
    a, _, s, c, groups = problem((6, 9, 5, 4), prior=2.0)
    rng = np.random.default_rng(1)
    low = 0
    for _ in range(400):
        y = a @ (c + s * rng.standard_normal(4)) + rng.standard_normal(len(a))
        e = y - a @ fit(a, y, s, c)[0]
        low += leave_one_out(e, a, s, groups.tolist()).p() < 0.2
    assert 0.12 < low / 400 < 0.25
    spoiled = leave_one_out(e + 8.0 * (groups == "M2"), a, s, groups.tolist())
    assert spoiled.p() < 1e-6
    assert spoiled.p() < spoiled.p(std_dof=10)
    assert leave_one_out(e, a, s, groups.tolist()).p({"M0": 6, "M1": 9, "M2": 5, "M3": 4}) == 1.0


def test_input_that_does_not_belong_together():
    a, y, s, _, groups = problem((4, 5, 3))
    for bad in ((y[:-1], a, s), (y, a[:, :3], s), (y[:0], a[:0], s)):
        with pytest.raises(InputError, match="do not belong together"):
            leave_one_out(*bad, groups.tolist())
    with pytest.raises(InputError, match="not a usable number"):
        leave_one_out(np.where(y == y[0], np.nan, y), a, s, groups.tolist())
    nothing = leave_one_out(y, a[:, :0], s[:0], groups.tolist())
    np.testing.assert_array_equal(nothing.residual, y)
