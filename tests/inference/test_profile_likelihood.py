"""Profile likelihood and samples of the posterior against closed forms."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.inference.profile_likelihood import profile_likelihood, profile_table
from calib.inference.rules import WIDE
from calib.inference.sampled_posterior import sampled_posterior
from calib.problem.parameter import Parameter
from calib.problem.space import LinearConstraint, ParameterSpace


class Rows:
    """Residual from a function of named values; derivatives by central differences."""

    def __init__(self, function):
        self.function, self.count = function, 0

    def residual(self, values):
        self.count += 1
        return np.atleast_1d(np.asarray(self.function(**values), dtype=float))

    def jacobian(self, values, names):
        columns = []
        for name in names:
            h = 1e-6 * max(abs(values[name]), 1e-3)
            ends = [self.residual({**values, name: values[name] + s * h}) for s in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * h))
        return np.array(columns).T if columns else np.zeros((len(self.residual(values)), 0))


def space(**parameters):
    return ParameterSpace(tuple(Parameter(n, v, lo, up, prior_sd=sd) for n, (v, lo, up, sd) in parameters.items()))


def solved(problem, where):
    """The optimum and the posterior linearised there."""
    best = fit(problem, where)
    prior_sd = np.array([where[n].prior_width for n in best.names])
    known = posterior(best.names, problem.jacobian(best.values, best.names), prior_sd)
    return best, known


def profiled(problem, where, name):
    best, known = solved(problem, where)
    found = profile_likelihood(problem, where, best.values, known, name)
    std = dict(zip(known.names, known.std, strict=True))
    (row,) = profile_table([found], best.values, std, best.misfit).to_dict("records")
    return found, row


def test_the_interval_of_a_linear_model_is_the_linearised_one():
    rng = np.random.default_rng(3)
    g, y = rng.standard_normal((9, 3)) * [1.0, 30.0, 4.0], rng.standard_normal(9)
    where = space(a=(0.5, -20, 20, 4.0), b=(0.0, -1, 1, 0.2), c=(1.0, -9, 9, 1.0))
    problem = Rows(lambda a, b, c: g @ [a, b, c] - y)
    best, known = solved(problem, where)
    for name, std in zip("abc", known.std, strict=True):
        found, row = profiled(problem, where, name)
        half = WIDE * std
        np.testing.assert_allclose(found.interval, (best.values[name] - half, best.values[name] + half), rtol=2e-3)
        assert not row["differs"] and row["kind"] == "two-sided" and math.isnan(row["lower_misfit_at"])
        assert np.all(np.diff(found.at) > 0) and found.at[np.argmin(found.total)] == best.values[name]


def test_the_interval_of_a_curved_model_is_that_of_its_likelihood():
    """``exp(a)`` was measured as 2 +- 0.5; a broad prior."""
    found, row = profiled(Rows(lambda a: (math.exp(a) - 2.0) / 0.5), space(a=(0.5, -9, 9, 1e4)), "a")
    np.testing.assert_allclose(found.interval, np.log(2 + WIDE * 0.5 * np.array([-1, 1])), rtol=2e-2)
    assert row["kind"] == "two-sided" and row["differs"]
    assert f"{found.interval[0]:.4g} to {found.interval[1]:.4g}" in row["sentence"]


def test_a_saturating_response_bounds_on_one_side_only():
    """``1 - exp(-a)`` was measured as 1 +- 0.05: large values cannot be told apart."""
    found, row = profiled(Rows(lambda a: math.exp(-a) / 0.05), space(a=(6.0, 0.0, 12.0, 5.0)), "a")
    lower, upper = found.data_interval
    assert row["kind"] == "one-sided" and math.isnan(upper) and "upper" in found.ends
    assert lower == pytest.approx(-math.log(WIDE * 0.05), rel=2e-2)


def test_of_a_product_neither_factor_is_identified_but_by_its_prior():
    problem = Rows(lambda a, b: (a * b - 2.0) / 0.01)
    where = space(a=(1.4, 0.5, 4.0, 0.1), b=(1.4, 0.5, 4.0, 0.1))
    found, row = profiled(problem, where, "a")
    assert row["kind"] == "two-sided"  # through the prior of b, which the data do not replace
    wide = space(a=(1.4, 0.5, 4.0, 1e3), b=(1.4, 0.5, 4.0, 1e3))
    found, row = profiled(problem, wide, "a")
    assert row["kind"] == "unbounded" and found.ends == {"lower", "upper"}
    np.testing.assert_allclose([one["a"] * one["b"] for one in found.values], 2.0, rtol=1e-2)


def test_a_better_minimum_that_the_scan_meets_is_told():
    """Two wells, the second one deeper; the fit is in the first."""
    problem = Rows(lambda a: [(a**2 - 1) / 0.4, (a - 1) / 1.5])
    where = space(a=(-0.9, -2, 2, 1e3))
    best, known = solved(problem, where)
    assert best.values["a"] < 0
    found = profile_likelihood(problem, where, best.values, known, "a")
    (row,) = profile_table([found], best.values, {"a": 0.1}, best.misfit).to_dict("records")
    assert abs(row["lower_misfit_at"] - 1) < 0.4 and "better" in row["sentence"]


def test_values_that_cannot_be_solved_are_counted_and_the_rest_is_told():
    def function(a):
        if a > 0.6:
            raise EvaluationError("no mode")
        return a / 0.5

    found, row = profiled(Rows(function), space(a=(0.0, -2, 2, 1e3)), "a")
    assert found.failed and found.interval[0] == pytest.approx(-WIDE * 0.5, rel=1e-2) and math.isnan(found.interval[1])
    assert str(len(found.failed)) in row["sentence"]


def test_a_name_without_a_profile_is_refused():
    problem, where = Rows(lambda a: a), space(a=(0.0, -1, 1, 1.0))
    best, known = solved(problem, where)
    with pytest.raises(InputError, match="b has no profile"):
        profile_likelihood(problem, where, best.values, known, "b")


def sampled(problem, where, steps=600, **more):
    pytest.importorskip("emcee")
    best, known = solved(problem, where)
    return best, known, sampled_posterior(problem, where, best.values, known, steps, 4, **more)


@pytest.mark.slow
def test_samples_of_a_linear_model_have_its_posterior():
    rng = np.random.default_rng(3)
    g, y = rng.standard_normal((9, 2)) * [1.0, 30.0], rng.standard_normal(9)
    where = space(a=(0.5, -20, 20, 4.0), b=(0.0, -1, 1, 0.2))
    best, known, found = sampled(Rows(lambda a, b: g @ [a, b] - y), where, 1500)
    np.testing.assert_allclose(found.samples.cov() / known.covariance, 1.0, atol=0.25)
    for row, std in zip(found.table.to_dict("records"), known.std, strict=True):
        assert abs(row["mean"] - best.values[row["parameter"]]) < 0.25 * std
    assert found.converged and not found.table["differs"].any() and 0.2 < found.acceptance < 0.95
    again = sampled(Rows(lambda a, b: g @ [a, b] - y), where, 1500)[2]
    pd.testing.assert_frame_equal(found.samples, again.samples)


@pytest.mark.slow
def test_samples_stay_within_limits_and_constraints():
    """A parameter on its limit has a truncated normal posterior; a constraint cuts a half-plane off."""
    where = space(a=(0.5, 0.0, 20.0, 1e3), b=(0.0, -9, 9, 1e3))
    where = ParameterSpace(where.parameters, (LinearConstraint("order", (("a", 1.0), ("b", -1.0)), 0.0, math.inf),))
    best, _, found = sampled(Rows(lambda a, b: [(a + 1.0) / 0.5, (b + 4.0) / 0.1]), where, 1500)
    assert best.values["a"] == 0.0 and found.samples["a"].min() >= 0.0
    assert (found.samples["a"] >= found.samples["b"]).all()
    expected = stats.truncnorm(2.0, np.inf, loc=-1.0, scale=0.5)
    assert found.samples["a"].mean() == pytest.approx(expected.mean(), rel=0.12)
    assert found.table.set_index("parameter").loc["a", "upper"] == pytest.approx(expected.ppf(0.975), rel=0.15)


def test_too_few_steps_are_told():
    _, _, found = sampled(Rows(lambda a: a), space(a=(0.0, -9, 9, 1e3)), 20)
    assert not found.converged and "too few steps" in found.sentences[0]
