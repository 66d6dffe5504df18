"""Priors that a matrix correlates: against the closed form of a linear model, in every analysis that has a prior."""

import math

import numpy as np
import pytest
from scipy import stats

import calib
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.inference.profile_likelihood import profile_likelihood, profile_table
from calib.missing.linearised_fit import least_squares_fit
from calib.problem.parameter import Parameter
from calib.problem.prior import Prior
from calib.problem.sampling import sample
from calib.problem.space import ParameterSpace
from calib.study.several import load

NAMES = ("a", "b", "c")
MATRIX = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, 0.0], [-0.3, 0.0, 1.0]])
SD = np.array([0.5, 2.0, 1.0])
CENTRE = np.array([1.0, 10.0, 3.0])
PRECISION = np.linalg.inv(MATRIX * np.outer(SD, SD))
SLOPE = {"y": np.array([1.0, 0.5, 0.0]), "z": np.array([0.0, 1.0, -2.0])}
STD = {"y": 0.4, "z": 1.5}
MEASURED = {"y": 7.5, "z": 5.0}


def space(matrix=MATRIX, **changes):
    known = (Parameter(n, float(v), float(v) - 30, float(v) + 30, prior_sd=float(s))
             for n, v, s in zip(NAMES, CENTRE, SD, strict=True))  # fmt: skip
    return ParameterSpace((*known, Parameter("d", 1.0, 0.5, 1.5))).correlated(NAMES, matrix)


def problem(own=None):
    model = calib.FunctionModel(
        "linear", (own or space()).freeze({"d": 1.0}),
        lambda v: {name: float(g @ [v[n] for n in NAMES]) for name, g in SLOPE.items()},
    )  # fmt: skip
    test = calib.ResponseTest({name: (value, STD[name]) for name, value in MEASURED.items()})
    return calib.Problem(model, test)


def closed_form():
    """Optimum and posterior covariance."""
    g = np.array([SLOPE[n] / STD[n] for n in SLOPE])
    y = np.array([MEASURED[n] / STD[n] for n in SLOPE])
    covariance = np.linalg.inv(g.T @ g + PRECISION)
    mean = covariance @ (g.T @ y + PRECISION @ CENTRE)
    return mean, covariance


@pytest.fixture(scope="module")
def fitted():
    return problem().calibrate(starts=1, progress=False)


def test_priors_add_the_form_of_their_inverse_covariance():
    own, values = Prior.of(space().freeze({"d": 1.0})), {"a": 1.7, "b": 7.0, "c": 3.5}
    off = np.array([values[n] for n in NAMES]) - CENTRE
    rows, slope = own.rows(values, NAMES)
    assert rows @ rows == pytest.approx(off @ PRECISION @ off)
    np.testing.assert_allclose(slope.T @ slope, PRECISION, atol=1e-12)
    density = own.log_density(values) - own.log_density(dict(zip(NAMES, CENTRE, strict=True)))
    assert density == pytest.approx(-0.5 * off @ PRECISION @ off)
    beside, slope = own.beside(values, NAMES)  # of a subset the others count at their values
    for found, known in zip(own.beside(values, ("c", "a")), (beside, slope[:, [2, 0]]), strict=True):
        np.testing.assert_allclose(found, known, atol=1e-12)


def test_a_linear_model_has_the_posterior_of_the_closed_form(fitted):
    mean, covariance = closed_form()
    table = fitted.parameters
    np.testing.assert_allclose([fitted.values[n] for n in NAMES], mean, atol=1e-4)
    np.testing.assert_allclose(table.loc[list(NAMES), "std"], np.sqrt(np.diag(covariance)), rtol=1e-6)
    share = 1 - np.diag(covariance) / SD**2
    np.testing.assert_allclose(table.loc[list(NAMES), "data_share"], share, rtol=1e-6)


@pytest.mark.medium
def test_profiles_and_samples_of_the_posterior_are_those_of_the_closed_form(fitted):
    mean, covariance = closed_form()
    found = fitted.intervals(progress=False).table.set_index("parameter")
    reach = 1.96 * np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.loc[list(NAMES), "lower"], mean - reach, rtol=2e-3)
    np.testing.assert_allclose(found.loc[list(NAMES), "upper"], mean + reach, rtol=2e-3)
    assert not found["differs"].any() and found["lower_misfit_at"].isna().all()
    drawn = fitted.robustness(samples=4000, progress=False).of.samples
    np.testing.assert_allclose(np.cov(drawn[list(NAMES)].T), covariance, atol=0.06 * np.diag(covariance).max())


@pytest.mark.medium
def test_sampled_posteriors_are_those_of_the_closed_form(fitted):
    pytest.importorskip("emcee")
    mean, covariance = closed_form()
    drawn = fitted.intervals(samples=1500, progress=False).of.sampled.samples
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((drawn.mean() - mean) / std, 0.0, atol=0.1)
    np.testing.assert_allclose(drawn.std() / std, 1.0, atol=0.1)


def test_one_that_is_held_leaves_the_others_their_own_priors():
    own = space().freeze({"d": 1.0, "b": 10.0})
    rows, slope = Prior.of(own).rows({"a": 1.5, "b": 12.0, "c": 3.0}, ("a", "c"))
    left = np.linalg.inv(MATRIX[np.ix_([0, 2], [0, 2])] * np.outer(SD[[0, 2]], SD[[0, 2]]))
    np.testing.assert_allclose(slope.T @ slope, left, atol=1e-12)
    assert rows @ rows == pytest.approx(0.25 * left[0, 0])


@pytest.mark.parametrize("count", [2, 400])
def test_hypercubes_keep_their_columns_and_have_the_correlations(count):
    free = space().freeze({"d": 1.0})
    points = sample(free, count, 3).points
    cells = np.floor((points - free.lower) / (free.upper - free.lower) * count)
    assert (np.sort(cells, axis=0) == np.arange(count)[:, None]).all()
    if count > 2:
        scores = stats.norm.ppf((stats.rankdata(points, axis=0) - 0.5) / count)
        np.testing.assert_allclose(np.corrcoef(scores.T), MATRIX, atol=0.02)
    others = sample(space(), 400, 3).points
    assert abs(stats.spearmanr(others[:, 3], others[:, 0]).statistic) < 0.15


def test_a_log_normal_prior_is_correlated_by_its_logarithm():
    k = Parameter("k", 100.0, 1.0, 1e4, scale="log", prior_sd=30.0)
    m = Parameter("m", 5.0, 0.0, 10.0, prior_sd=1.0)
    own = Prior.of(ParameterSpace((k, m)).correlated(("k", "m"), [[1.0, 0.6], [0.6, 1.0]]))
    t = np.array([math.log(2.0) / 0.3, 1.5])
    rows, slope = own.rows({"k": 200.0, "m": 6.5}, ("k", "m"))
    assert rows @ rows == pytest.approx(t @ np.linalg.inv([[1.0, 0.6], [0.6, 1.0]]) @ t)
    above = own.rows({"k": 200.001, "m": 6.5}, ("k", "m"))[0]
    np.testing.assert_allclose((above - rows) / 1e-3, slope[:, 0], rtol=1e-4, atol=1e-9)


def test_least_squares_alone_follows_the_correlation_of_what_is_not_measured():
    class OnlyA:
        def residual(self, values):
            return np.array([(values["a"] - 2.0) / 1e-3])

        def jacobian(self, values, names):
            return np.array([[1e3 if n == "a" else 0.0 for n in names]])

    own = space().freeze({"d": 1.0})
    found = fit(OnlyA(), own)
    assert found.values["a"] == pytest.approx(2.0, abs=1e-4)
    assert found.values["b"] == pytest.approx(10.0 + 0.8 * 2.0 / 0.5, abs=0.01)  # regression on a
    assert found.misfit == pytest.approx(4.0, abs=1e-3)  # a alone is two standard deviations off
    prior = Prior.of(own)
    rows = np.vstack([found.jacobian, prior.beside(found.values, NAMES)[1]])
    known = posterior(NAMES, rows, prior.widths(found.values, NAMES), alone=SD)
    assert known.std[1] == pytest.approx(2.0 * 0.6, rel=1e-4) and known.data_share[1] == pytest.approx(0.64, rel=1e-4)
    one = profile_table([profile_likelihood(OnlyA(), own, found.values, known, "b")], found.values,
                        dict(zip(NAMES, known.std.tolist(), strict=True)), found.misfit).iloc[0]  # fmt: skip
    assert (one["lower"], one["upper"]) == pytest.approx((13.2 - 1.96 * 1.2, 13.2 + 1.96 * 1.2), rel=2e-3)


@pytest.mark.parametrize(
    ("names", "matrix", "words"),
    [
        (("a", "b"), [[1.0, 1.2], [1.2, 1.0]], "1.2 and 1.2"),
        (("a", "b", "c"), [[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]], "not positive definite"),
        (("a", "b"), [[1.0, 1.0], [1.0, 1.0]], "not positive definite"),
        (("a", "b"), [[1.0, 0.5], [0.4, 1.0]], "0.5 and 0.4"),
        (("a", "b"), [[2.0, 0.5], [0.5, 1.0]], "2 and 2"),
        (("a", "b"), [[1.0, 0.5]], "1 rows of 2 numbers for 2"),
        (("a", "b"), [[1.0, math.nan], [math.nan, 1.0]], "a and b"),
        (("a", "a"), [[1.0, 0.5], [0.5, 1.0]], "twice"),
        (("a", "elsewhere"), [[1.0, 0.5], [0.5, 1.0]], "'elsewhere'"),
    ],
)
def test_wrong_matrices_are_refused(names, matrix, words):
    with pytest.raises(InputError, match=words):
        space().correlated(names, matrix)


def test_integers_and_uniform_priors_are_refused():
    for changes in ({"integer": True}, {"prior": "uniform"}):
        own = ParameterSpace((Parameter("a", 1.0, 0.0, 9.0), Parameter("n", 2.0, 0.0, 9.0, **changes)))
        with pytest.raises(InputError, match="parameter n"):
            own.correlated(("a", "n"), [[1.0, 0.5], [0.5, 1.0]])


STATE = """
[prior_correlation]
parameters = ["K_base", "m_top"]
matrix = [[1.0, 0.6], [0.6, 1.0]]
"""


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [("[[1.0, 0.6]", "[[1.0, 0.5]", "0.5 and 0.6"), ('"m_top"]', '"m_tip"]', "m_tip"), (", [0.6, 1.0]", "", "1 rows")],
)
def test_a_study_states_them(tmp_path, before, after, words):
    write_example(tmp_path / "mast")
    file = tmp_path / "mast" / "study.toml"
    text = file.read_text()
    file.write_text(text + STATE)
    own = load(tmp_path / "mast").search_space
    assert dict(own["K_base"].prior_correlation) == {"m_top": 0.6}
    file.write_text(text + STATE.replace(before, after))
    with pytest.raises(InputError, match=words) as fault:
        load(tmp_path / "mast")
    assert "study.toml, line" in str(fault.value)


def test_the_fit_of_an_explanation_is_an_optimum_with_the_posterior_of_the_closed_form():
    class Linear:
        space = space().freeze({"d": 1.0})

        def residual(self, values):
            return np.array(
                [(g @ [values[n] for n in NAMES] - MEASURED[name]) / STD[name] for name, g in SLOPE.items()]
            )

        def jacobian(self, values, names):
            return np.array([[SLOPE[row][NAMES.index(n)] / STD[row] for n in names] for row in SLOPE])

    mean, covariance = closed_form()
    found = least_squares_fit(Linear(), (), Linear.space.values)
    np.testing.assert_allclose([found.values[n] for n in NAMES], mean, atol=0.05)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6)
    np.testing.assert_allclose(found.projected, found.augmented, atol=0.05)  # nothing is left to move
    moved = found.update(np.array([0.1, 0.0]))
    np.testing.assert_allclose(moved, covariance @ (-found.slope.T @ [0.1, 0.0]) * -1.0, rtol=1e-6)
