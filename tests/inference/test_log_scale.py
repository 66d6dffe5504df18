"""Logarithmic scales and priors that are not normal, against closed forms and against the same in logarithms."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calib.errors.errors import InputError
from calib.inference.gauss_newton import FitSettings, fit
from calib.inference.genetic import GeneticSearch, GeneticSettings
from calib.inference.identify import identify, needed_std, posterior
from calib.inference.profile_likelihood import profile_likelihood, profile_table
from calib.inference.sampled_posterior import sampled_posterior
from calib.inference.verdicts import parameter_verdicts
from calib.problem.differences import central_jacobian
from calib.problem.prior import Density, Prior
from calib.problem.sampling import sample
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.sensitivity.prognosis import prognosis
from calib.sensitivity.variance import morris_design, sobol_design

K = Parameter("k", 1e5, 1e3, 1e9, "N/m", scale="log")
M = Parameter("m", 10.0, 8.0, 12.0, "kg")


class Joint:
    """Logarithm of a frequency of ``k`` in series with a stiffness, and a mass: whitened by 0.5 %."""

    def __init__(self, k=2.25e4, m=10.0, logarithm=False):
        self.data, self.logarithm = np.zeros(3), logarithm
        self.data = self.predicted({"k": math.log(k) if logarithm else k, "m": m})

    def predicted(self, values):
        k = math.exp(values["k"]) if self.logarithm else values["k"]
        series, mass = math.log(k / (k + 3e4)), math.log(values["m"])
        return np.array([series - mass, series - 0.6 * mass, series - 0.8 * mass]) / 0.005

    def residual(self, values):
        return self.predicted(values) - self.data

    def jacobian(self, values, names):
        space = ParameterSpace((K, M) if not self.logarithm else (in_logarithms(K), M))
        return central_jacobian(self.residual, space, values, names)


def in_logarithms(p):
    """The same parameter as its own logarithm on a linear scale."""
    ends = (math.log(value) for value in (p.value, p.lower, p.upper))
    return Parameter(p.name, *ends, prior_sd=p.prior_width / p.value)


@pytest.mark.parametrize("start", [1.2e3, 1e5, 5e8])
def test_a_fit_on_a_logarithmic_scale_is_that_of_the_logarithm(start):
    tight = FitSettings(gain=1e-12)
    found = fit(Joint(), ParameterSpace((K, M)), {"k": start}, settings=tight)
    same = fit(Joint(logarithm=True), ParameterSpace((in_logarithms(K), M)), {"k": math.log(start)}, settings=tight)
    assert found.converged and found.values["k"] == pytest.approx(math.exp(same.values["k"]), rel=1e-5)
    assert found.misfit == pytest.approx(same.misfit, abs=1e-6) and found.evaluations == same.evaluations
    np.testing.assert_allclose(found.jacobian[:, 0] * found.values["k"], same.jacobian[:, 0], rtol=1e-4)


def test_standard_deviations_and_intervals_are_those_of_the_logarithm():
    space, other = ParameterSpace((K, M)), ParameterSpace((in_logarithms(K), M))
    found, same = fit(Joint(), space), fit(Joint(logarithm=True), other)
    first, second = (
        identify(s, end.names, end.jacobian, values=end.values) for s, end in ((space, found), (other, same))
    )
    assert first.posterior.std[0] == pytest.approx(found.values["k"] * second.posterior.std[0], rel=1e-3)
    assert first.posterior.data_share == pytest.approx(second.posterior.data_share, rel=1e-4)
    row = parameter_verdicts(space, found.values, first).set_index("parameter").loc["k"]
    assert row["ratio"] == pytest.approx(math.log10(2.25e4 / 1e3) / 6, abs=1e-3)
    reach = math.exp(1.96 * row["std"] / row["value"])
    assert (row["low"], row["high"]) == pytest.approx((row["value"] / reach, row["value"] * reach))
    assert row["needed"] == needed_std(K, row["value"]) == pytest.approx(0.1 * row["value"])


def test_profiles_go_along_the_scale():
    space, other = ParameterSpace((K, M)), ParameterSpace((in_logarithms(K), M))
    ends = []
    for s, problem in ((space, Joint()), (other, Joint(logarithm=True))):
        end = fit(problem, s)
        known = posterior(end.names, end.jacobian, Prior.of(s).widths(end.values, end.names))
        profile = profile_likelihood(problem, s, end.values, known, "k")
        std = dict(zip(known.names, known.std.tolist(), strict=True))
        table = profile_table([profile], end.values, std, end.misfit)
        assert not table["differs"].any()
        ends.append(table[["lower", "upper", "linear_lower", "linear_upper"]].to_numpy()[0])
    np.testing.assert_allclose(np.log(ends[0]), ends[1], rtol=1e-4)


def test_samples_and_searches_spread_evenly_over_decades():
    space = ParameterSpace((K, M))
    points = sample(space, 600, 1).points
    counts = np.histogram(np.log10(points[:, 0]), bins=6, range=(3, 9))[0]
    assert counts.tolist() == [100] * 6
    for design in (morris_design(space, 20, 4), sobol_design(space, 64, 1)):
        assert stats.spearmanr(design.points[:, 0], design.unit[:, 0]).statistic == pytest.approx(1.0)
        np.testing.assert_allclose(np.log10(design.points[:, 0]), 3 + 6 * design.unit[:, 0], atol=1e-9)
    settings = GeneticSettings(population=30, generations=40)
    search = GeneticSearch(space, settings, sample(space, 30, 2).points, seed=3)
    best, seen = math.inf, []
    while not search.done:
        asked = search.ask()
        assert np.all((asked >= space.lower) & (asked <= space.upper))
        misfit = (np.log10(asked[:, 0]) - 4.3) ** 2 + (asked[:, 1] - 9.0) ** 2
        seen.append(np.log10(asked[:, 0]))
        best = min(best, misfit.min())
        search.tell(misfit, np.zeros(30))
    assert best < 0.01


def test_a_metamodel_and_its_shares_follow_the_logarithm():
    space = ParameterSpace((K, M))
    points = pd.DataFrame(sample(space, 120, 1).points, columns=["k", "m"])
    responses = pd.DataFrame({"y": np.log10(points["k"]) + points["m"]})
    (one,) = prognosis(space, points, responses).models
    assert one.kind == "linear" and one.cop > 0.999
    variances = {"k": 36 / 12, "m": 16 / 12}
    for name, variance in variances.items():
        assert one.shares.loc[name, "cop"] == pytest.approx(variance / sum(variances.values()), abs=0.03)


def test_where_a_value_is_on_a_limit_counts_along_the_scale():
    assert K.limit_at(1.05e3) is None  # 0.0005 % of the range, and 0.35 % of its logarithm
    assert K.limit_at(1.001e3) == "lower" and K.limit_at(1.04e3, 1e3) is None and K.limit_at(9.99e8) == "upper"
    assert K.moved(1e5, -2e5) == pytest.approx(1e5 * math.exp(-2)) and M.moved(10.0, -2.0) == 8.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lower": 0.0}, "logarithmic scale"),
        ({"integer": True}, "an integer has no place"),
        ({"scale": "ln"}, "unknown scale"),
        ({"prior": "gamma"}, "unknown prior"),
        ({"prior": "uniform", "prior_sd": 5.0}, "both a prior"),
        ({"prior": ((1e3, 1.0), (1e8, 0.0))}, "go beyond"),
        ({"prior": ((1e3, 1.0), (1e4, 0.0), (1e9, 1.0))}, "not positive"),
        ({"prior": ((1e4, 1.0), (1e3, 1.0))}, "do not ascend"),
        ({"prior": (1.0, 2.0)}, "list of pairs"),
    ],
)
def test_wrong_scales_and_priors_are_refused(changes, words):
    fields = {"name": "k", "value": 1e5, "lower": 1e3, "upper": 1e9, "scale": "log"} | changes
    with pytest.raises(InputError, match=words):
        Parameter(**fields)


def test_a_sum_of_logarithms_is_refused():
    with pytest.raises(InputError, match="logarithmic scale and is in a sum"):
        ParameterSpace((K, M), (LinearConstraint("total", (("k", 1.0), ("m", 1.0)), 0.0, 1e9),))


# -- priors ------------------------------------------------------------------------------------------------------------


def test_a_log_normal_prior_on_a_linear_scale():
    p = Parameter("k", 100.0, 1.0, 1000.0, prior="log-normal", prior_sd=20.0)
    assert p.pull(100.0 * math.exp(0.2)) == pytest.approx(1.0) and p.prior_width_at(50.0) == pytest.approx(10.0)
    step = 1e-6
    slope = (p.pull(50.0 + step) - p.pull(50.0 - step)) / (2 * step)
    assert 1 / slope == pytest.approx(p.prior_width_at(50.0))
    density = np.exp([p.log_prior(x) for x in np.linspace(10.0, 300.0, 50)])
    exact = stats.lognorm.pdf(np.linspace(10.0, 300.0, 50), 0.2, scale=100.0)
    np.testing.assert_allclose(density / density.sum(), exact / exact.sum(), rtol=1e-9)


def test_a_heavy_tailed_prior_is_as_high_as_a_normal_one_and_hardly_draws_what_is_far_off():
    p = Parameter("m", 1.0, -50.0, 50.0, prior="heavy-tailed", prior_sd=0.2)
    x = np.array([-20.0, 0.5, 1.0, 1.3, 40.0])
    density = np.exp([p.log_prior(v) - math.log(p.span_at(v)) - 0.5 * math.log(2 * math.pi) for v in x])
    np.testing.assert_allclose(density, stats.cauchy.pdf(x, 1.0, 0.2 * math.sqrt(2 / math.pi)), rtol=1e-9)
    assert density[2] == pytest.approx(stats.norm.pdf(0.0, scale=0.2)) and p.prior_width_at(1.0) == p.prior_width
    assert p.pull(1.0) == 0.0 and p.pull(3.0) == pytest.approx(1.955, abs=0.001) and p.pull(-1.0) == -p.pull(3.0)
    slopes = [(p.pull(v + 1e-6) - p.pull(v - 1e-6)) / 2e-6 for v in x]
    np.testing.assert_allclose(1 / np.array(slopes), [p.prior_width_at(v) for v in x], rtol=1e-4)


def test_a_uniform_prior_pulls_to_no_value():
    space = ParameterSpace((Parameter("p", 1.0, 0.0, 10.0, prior="uniform"),))

    class Vague:
        def residual(self, values):
            return np.array([(values["p"] - 7.0) / 50.0])

        def jacobian(self, values, names):
            return np.array([[1 / 50.0]])

    found = fit(Vague(), space)
    assert found.values["p"] == pytest.approx(7.0, abs=0.2) and found.prior_misfit == 0.0
    (std,) = posterior(("p",), found.jacobian, Prior.of(space).widths(found.values, ("p",))).std
    assert std == pytest.approx(1 / math.sqrt(1 / 50**2 + 12 / 100))


def test_a_tabulated_prior_is_the_distribution_that_it_tabulates():
    x = np.linspace(-6.0, 6.0, 2001)
    normal = Density.of(list(zip(20 + 3 * x, np.exp(-(x**2) / 2), strict=True)), "p")
    assert normal.std == pytest.approx(3.0, rel=1e-4)
    for value in (14.0, 20.0, 24.5):
        assert normal.score(value) == pytest.approx((value - 20) / 3, abs=1e-4)
        assert normal.width(value) == pytest.approx(3.0, rel=1e-4)
    triangle = Parameter("t", 1.0, 0.0, 2.0, prior=((0, 0), (1, 5), (2, 0)))
    assert triangle.prior_width == pytest.approx(1 / math.sqrt(6))
    assert stats.norm.cdf(triangle.pull(0.5)) == pytest.approx(0.125)
    density = [math.exp(triangle.log_prior(value)) for value in (0.25, 0.5, 1.0, 1.5)]
    np.testing.assert_allclose(np.array(density) / density[2], [0.25, 0.5, 1.0, 0.5], rtol=1e-6)
    assert triangle.prior_width_at(0.0) > 0 and math.isfinite(triangle.pull(0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("p", "exact"),
    [
        (Parameter("p", 1.0, 0.0, 2.0, prior=((0, 0), (1, 1), (2, 0))), stats.triang(0.5, 0.0, 2.0)),
        (Parameter("p", 10.0, 1.0, 1e3, scale="log", prior="uniform"), stats.loguniform(1.0, 1e3)),
    ],
)
def test_samples_without_data_are_those_of_the_prior(p, exact):
    pytest.importorskip("emcee")

    class Nothing:
        def residual(self, values):
            return np.zeros(1)

    known = posterior(("p",), np.zeros((1, 1)), np.array([p.prior_width]))
    drawn = sampled_posterior(Nothing(), ParameterSpace((p,)), {"p": p.value}, known, 900, 1).samples["p"]
    quantiles = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(exact.cdf(np.quantile(drawn, quantiles)), quantiles, atol=0.05)
