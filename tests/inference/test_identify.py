"""Posterior covariance, confounded parameters and verdicts, against closed forms and against repeated noise."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.linalg as la
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy import stats

from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import InputError
from calib.inference.gauss_newton import fit
from calib.inference.identify import identify, posterior, prediction_interval
from calib.inference.integers import fit_mixed
from calib.inference.verdicts import identified_sentence, integer_std, parameter_verdicts
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace
from calib.study.study import LoadedStudy


def box(names, lower=0.0, upper=10.0, **options):
    return ParameterSpace(tuple(Parameter(n, 0.5 * (lower + upper), lower, upper, **options) for n in names))


# -- posterior ---------------------------------------------------------------------------------------------------------


@hypothesis_settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 8))
def test_posterior_is_the_inverse(seed, n, rows):
    rng = np.random.default_rng(seed)
    units = 10.0 ** rng.uniform(-6, 6, n)
    g, s = rng.standard_normal((rows, n)) / units, units * rng.uniform(0.1, 10, n)
    found = posterior([f"p{k}" for k in range(n)], g, s)
    inverse = np.linalg.inv(units[:, None] * (g.T @ g) * units + np.diag((units / s) ** 2))
    np.testing.assert_allclose(found.covariance / np.outer(units, units), inverse, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(found.covariance)))
    np.testing.assert_allclose(found.data_share, 1 - (found.std / s) ** 2, atol=1e-9)
    assert np.all(found.std <= s * (1 + 1e-9))  # data never make it worse


def test_held_parameters_that_are_not_known_exactly_widen_the_estimates():
    """Sampled again each time, but held at their expectation: estimates then vary with the reported covariance."""
    rng = np.random.default_rng(11)
    g, h = rng.standard_normal((12, 3)) * [1.0, 50.0, 0.02], rng.standard_normal((12, 2))
    found = posterior("abc", g, np.full(3, np.inf), h)
    noise, off = rng.standard_normal((200_000, 12)), rng.standard_normal((200_000, 2))
    estimates = (noise + off @ h.T) @ np.linalg.pinv(g).T
    np.testing.assert_allclose(np.cov(estimates.T) / np.outer(found.std, found.std), found.correlation, atol=0.02)
    alone = posterior("abc", g, np.full(3, np.inf))
    assert np.all(found.std > alone.std) and np.all(found.data_share == 1.0)
    # With priors: by hand for one parameter, two rows.
    one = posterior("a", np.array([[1.0], [1.0]]), np.array([1.0]), np.array([[3.0], [0.0]]))
    assert one.std**2 == pytest.approx(1 / 3 + (3 / 3) ** 2) and one.data_share == pytest.approx(2 / 3)


def test_without_data_and_prior_the_variance_is_infinite():
    found = posterior(["a", "b", "c"], np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]]), np.full(3, np.inf))
    assert np.isinf(found.std[:2]).all() and found.std[2] == pytest.approx(0.5)
    assert found.correlation[0, 1] == pytest.approx(-1.0) and found.correlation[0, 2] == pytest.approx(0.0)
    np.testing.assert_allclose(found.data_share, [0.0, 0.0, 1.0])
    silent = posterior(["a"], np.zeros((2, 1)), np.array([3.0]))
    assert silent.std[0] == pytest.approx(3.0) and silent.data_share[0] == 0.0
    with pytest.raises(InputError, match="2 parameters"):
        posterior(["a", "b"], np.zeros((2, 1)), np.ones(2))
    with pytest.raises(InputError, match="not a usable number"):
        posterior(["a"], np.array([[np.nan]]), np.ones(1))


# -- confounding -------------------------------------------------------------------------------------------------------


def test_a_pair_that_trades_is_named_and_the_third_is_not():
    space = box("abc", prior_sd=3.0)
    g = np.array([[50.0, 49.0, 0.0], [50.0, 51.0, 0.0], [0.0, 0.0, 40.0]]) / 10
    found = identify(space, space.names, g)
    assert found.confounded[["parameter_a", "parameter_b"]].to_numpy().tolist() == [["a", "b"]]
    assert found.confounded.loc[0, "correlation"] < -0.99
    assert found.confounded.loc[0, "words"] == (
        "a and b are confounded: raising one and lowering the other hardly changes the data."
    )
    assert found.parameters["identified"].tolist() == [False, False, True]
    assert found.parameters["needed"].tolist() == [0.5, 0.5, 0.5]  # a tenth of the nominal value
    assert found.parameters.loc[2, "std"] == pytest.approx(0.25, rel=1e-2)
    unseen = found.directions[~found.directions["seen"]]
    assert unseen["parameters"].tolist() == ["a, b"] or unseen["parameters"].tolist() == ["b, a"]
    np.testing.assert_allclose(found.directions["signal"], sorted(np.linalg.svd(3.0 * g)[1]))
    assert identified_sentence(parameter_verdicts(space, space.values, found)) == (
        "1 of 3 parameters are identified; not a, b."
    )


def test_a_parameter_that_partly_trades_is_reported_with_its_partner():
    """Sums of a and b are seen better than differences: -0.83 between them, short of confounded."""
    space = box(("a", "b", "c"))
    g = np.array([[1.0, 1.0, 0.0], [0.3, -0.3, 0.0], [0.0, 0.0, 1.0]])
    found = identify(space, space.names, g, prior_sd=np.full(3, np.inf))
    r = -(1 - 0.09) / (1 + 0.09)  # of the inverse of [[1.09, 0.91], [0.91, 1.09]]
    assert found.trades_with("a") == ("b", pytest.approx(r)) and found.trades_with("b") == ("a", pytest.approx(r))
    assert found.trades_with("c") is None and found.confounded.empty
    words = parameter_verdicts(space, dict.fromkeys("abc", 5.0), found).set_index("parameter")["sentence"]
    assert words["a"].endswith("It trades most with b (correlation -0.83).") and "trades" not in words["c"]


def test_identified_parameters_may_correlate():
    space = box("ab", prior_sd=3.0)
    found = identify(space, space.names, 1e4 * np.array([[1.0, 0.99], [1.0, 1.01]]))
    assert found.parameters["identified"].all()
    assert "yet both have small" in found.confounded.loc[0, "words"]
    assert not parameter_verdicts(space, space.values, found)["confounded_with"].any()


# -- chains ------------------------------------------------------------------------------------------------------------

N = 3
K, M = [1000.0, 1400.0, 900.0], [1.0, 1.3, 0.8]


def chain_freq(values, n=N, k=K, m=M):
    """Natural frequencies of a grounded chain of springs k1.. and masses m1.., Hz."""
    ks = [values.get(f"k{i + 1}", k[i]) for i in range(n)]
    ms = [values.get(f"m{i + 1}", m[i]) for i in range(n)]
    stiffness = np.diag([ks[i] + (ks[i + 1] if i + 1 < n else 0.0) for i in range(n)])
    stiffness -= np.diag(ks[1:], 1) + np.diag(ks[1:], -1)
    squares = la.eigh(stiffness, np.diag(ms), eigvals_only=True)
    return {f"f{i + 1}": float(f) for i, f in enumerate(np.sqrt(squares) / (2 * np.pi))}


def responses(function, targets, space):
    return ResponseResidual(FunctionProblem(space, function, targets, ""))


def chain_space(names, sd=0.1, truth=None):
    nominal = {f"k{i + 1}": K[i] for i in range(N)} | {f"m{i + 1}": M[i] for i in range(N)}
    centre = nominal if truth is None else truth
    return ParameterSpace(
        tuple(
            Parameter(n, centre[n], 0.2 * nominal[n], 2.5 * nominal[n], "N/m" if n[0] == "k" else "kg",
                      prior_sd=sd * nominal[n])
            for n in names
        )
    )  # fmt: skip


def test_a_chain_of_unknown_masses_and_stiffnesses_cannot_be_separated():
    """Equal springs and masses: spring i from the ground stands for mass i from the tip, and all for all."""
    k, m = [1000.0] * N, [1.0] * N
    names = ("k1", "k2", "k3", "m1", "m2", "m3")
    nominal = dict(zip(names, k + m, strict=True))
    space = ParameterSpace(tuple(Parameter(n, v, 0.5 * v, 1.5 * v, prior_sd=0.2 * v) for n, v in nominal.items()))
    freq = chain_freq(nominal, N, k, m)
    problem = responses(lambda v: chain_freq(v, N, k, m), {n: (f, 1e-3 * f) for n, f in freq.items()}, space)
    found = identify(space, names, problem.jacobian(nominal, names), values=nominal)
    assert not found.parameters["identified"].any()
    pairs = {frozenset(p) for p in found.confounded[["parameter_a", "parameter_b"]].to_numpy().tolist()}
    assert pairs == {frozenset(p) for p in (("k1", "m3"), ("k2", "m2"), ("k3", "m1"))}
    assert (found.confounded["correlation"] > 0.99).all()
    assert (~found.directions["seen"]).sum() == 3  # three frequencies, six unknowns
    assert found.common_scale < 1e-3
    assert any("by the same factor" in s for s in found.sentences())


def test_any_chain_has_a_common_scale_until_one_mass_is_known():
    names = ("k1", "k2", "k3", "m1", "m2", "m3")
    space = chain_space(names, sd=0.3)
    targets = {n: (f, 1e-3 * f) for n, f in chain_freq({}).items()}
    free = responses(chain_freq, targets, space)
    found = identify(space, names, free.jacobian({}, names), values=space.values)
    assert found.common_scale < 1e-3 and not found.parameters["identified"].any()
    known = chain_space(names[:3])
    found = identify(known, names[:3], responses(chain_freq, targets, known).jacobian({}, names[:3]),
                     values=known.values)  # fmt: skip
    assert found.common_scale > 10 and found.parameters["identified"].all()
    assert not any("by the same factor" in s for s in found.sentences())


def test_a_bad_fit_hides_nothing_from_the_data():
    """A misfit of 1e4 standard deviations makes parameters less certain, but not their signal in the data."""
    names = ("k1", "k2", "k3")
    space = chain_space(names)
    targets = {n: (f, 1e-3 * f) for n, f in chain_freq({}).items()}
    g = responses(chain_freq, targets, space).jacobian({}, names)
    held = g[:, :1] * 0.01 * K[0]
    good = identify(space, names, g, values=space.values, held=held)
    bad = identify(space, names, g, values=space.values, held=held, birge=1e4)
    assert good.common_scale == bad.common_scale > 10 and bad.directions["seen"].all()
    np.testing.assert_array_equal(good.directions["signal"], bad.directions["signal"])
    assert not [s for s in bad.sentences() if s not in bad.confounded["words"].tolist()]
    wider = posterior(names, g / 1e4, np.array([p.prior_sd for p in space.parameters]), held / 1e4)
    np.testing.assert_allclose(bad.posterior.std, wider.std)
    assert not bad.parameters["identified"].any()
    for told in bad.directions["words"]:  # what is seen but not identified is nowhere called determined
        assert "determine" not in told and "identif" not in told


def test_one_parameter_alone_has_no_common_factor():
    space = box("a", prior_sd=3.0)
    found = identify(space, space.names, np.array([[1e-3]]), values={"a": 5.0})
    assert np.isnan(found.common_scale)
    assert found.sentences() == tuple(found.directions["words"])  # reported once, as a direction


# -- coverage ----------------------------------------------------------------------------------------------------------


def expected_hits(draws, level=0.95):
    """Limits that a count of hits of the right probability leaves once in ten thousand times."""
    return stats.binom.ppf([5e-5, 1 - 5e-5], draws, level)


def test_coverage_of_a_linear_gaussian_problem():
    """True values sampled from the prior: the 95 % interval holds 95 % of them, for every parameter."""
    rng = np.random.default_rng(11)
    draws, s = 2000, np.array([1.0, 0.3, 2.0])
    g = rng.standard_normal((5, 3)) * [1.0, 0.2, 3.0]  # the second one is hardly seen
    found = posterior("abc", g, s)
    truth = s * rng.standard_normal((draws, 3))
    data = truth @ g.T + rng.standard_normal((draws, 5))
    estimate = data @ g @ found.covariance  # posterior mean for a prior about zero
    hits = (np.abs(estimate - truth) <= 1.96 * found.std).sum(axis=0)
    low, high = expected_hits(draws)
    assert np.all((low <= hits) & (hits <= high))
    direction = np.array([[1.0, -2.0, 0.5]])  # and so does the interval of a prediction
    table = prediction_interval(["f"], np.array([100.0]), 1e-3 * direction, found.covariance)
    error = 1e-3 * (estimate - truth) @ direction[0]
    hits = int((np.abs(error) <= np.log(table.loc[0, "upper"] / 100.0)).sum())
    assert low <= hits <= high


@pytest.mark.slow
def test_coverage_of_a_spring_mass_chain():
    """Refits with new noise and true values: intervals of parameters and of a frequency have the stated coverage."""
    rng = np.random.default_rng(12)
    draws, names = 150, ("k1", "k2", "k3")
    hits, predicted = np.zeros(3), 0
    space = chain_space(names)
    for _ in range(draws):
        truth = {n: p * (1 + 0.1 * z) for (n, p), z in zip(space.values.items(), rng.standard_normal(3), strict=True)}
        exact = chain_freq(truth)
        # Two of three frequencies are measured, the third is predicted.
        targets = {n: (exact[n] * (1 + 0.01 * rng.standard_normal()), 0.01 * exact[n]) for n in ("f1", "f3")}
        problem = responses(chain_freq, targets, space)
        found = fit(problem, space, prior=Prior.of(space))
        known = posterior(names, found.jacobian, Prior.of(space).widths(found.values, names))
        error = np.array([found.values[n] - truth[n] for n in names])
        hits += np.abs(error) <= 1.96 * known.std
        whole = responses(chain_freq, {"f2": (exact["f2"], exact["f2"])}, space)
        model = chain_freq(found.values)["f2"]
        slope = -whole.jacobian(found.values, names) * exact["f2"] / model
        table = prediction_interval(["f2"], np.array([model]), slope, known.covariance)
        predicted += bool(table.loc[0, "lower"] <= exact["f2"] <= table.loc[0, "upper"])
    low, high = expected_hits(draws)
    assert np.all((low <= hits) & (hits <= high)), hits
    assert low <= predicted <= high


def test_prediction_interval_by_hand():
    table = prediction_interval(["1", "2"], np.array([10.0, 20.0]), np.array([[0.1], [np.inf]]), np.array([[0.04]]))
    assert table.loc[0, "std"] == pytest.approx(0.2)
    assert table.loc[0, "upper"] == pytest.approx(10 * math.exp(1.959964 * 0.02))
    assert math.isinf(table.loc[1, "std"]) and table.loc[1, "lower"] == 0.0


# -- integers ----------------------------------------------------------------------------------------------------------


def test_integers_from_neighbouring_misfits():
    sure = integer_std(np.array([2.0, 3.0, 4.0]), np.array([300.0, 100.0, 250.0]))
    assert sure == pytest.approx(0.0, abs=1e-10)
    even = integer_std(np.array([5, 6]), np.array([7.0, 7.0]))
    assert even == pytest.approx(0.5)
    # Where many values are likely, the parabola of the misfit gives the usual standard deviation.
    n = np.arange(-30, 31)
    wide = integer_std(n, (n / 4.0) ** 2)
    assert wide == pytest.approx(4.0, rel=1e-6)
    assert integer_std(n, (n / 4.0) ** 2, 0.0, 3.0) == pytest.approx(1 / math.hypot(1 / 4, 1 / 3), rel=1e-6)
    assert integer_std([1, 2], [np.inf, 5.0]) == 0.0
    with pytest.raises(InputError, match="no value"):
        integer_std([1, 2], [np.inf, np.inf])


# -- verdicts ----------------------------------------------------------------------------------------------------------


def test_verdicts_say_what_is_wrong():
    space = ParameterSpace(
        (
            Parameter("good", 5.0, 0.0, 10.0, "MN/m"),
            Parameter("top", 5.0, 2.0, 10.0, "kg"),
            Parameter("zero", 5.0, 0.0, 10.0, "kg"),
            Parameter("low", 5.0, 2.0, 10.0, "kg"),
            Parameter("place", 5.0, 2.0, 8.0, integer=True),
            Parameter("spot", 5.0, 2.0, 8.0, integer=True),
        )
    )
    names = ("good", "top", "zero", "low")
    values = {"good": 4.0, "top": 10.0, "zero": 0.0, "low": 2.005, "place": 7.0, "spot": 8.0}
    g = np.array([[10.0, 0, 0, 0], [0, 10.0, 0, 0], [0, 0, 10.0, 10.0]])
    found = identify(space, names, g)
    table = parameter_verdicts(space, values, found, {"good": 0.02, "top": 0.3}, {"place": 0.01}, True).set_index(
        "parameter"
    )
    assert table["on_limit"].to_dict() == {
        "good": False, "top": True, "zero": True, "low": True, "place": False, "spot": True
    }  # fmt: skip
    assert table.loc["top", "suggested_limit"] == 14.0
    assert math.isnan(table.loc["zero", "suggested_limit"])  # no mass below zero
    assert table.loc["low", "suggested_limit"] == 1.0
    assert table.loc["good", "stable"] is True and table.loc["top", "stable"] is False
    assert table.loc["zero", "stable"] is None
    assert table.loc["zero", "confounded_with"] == "low" and table.loc["low", "confounded_with"] == "zero"
    assert table.loc["good", "identified"] is True and table.loc["place", "identified"] is True
    assert table.loc["spot", "identified"] is None
    assert table.loc["good", "sentence"] == "Identified, standard deviation 0.0999 MN/m (needed: 0.5 MN/m)."
    assert "Sits on its upper search limit: widen it to 14 kg" in table.loc["top", "sentence"]
    assert "Its spread over the cases is 30 % of its search range." in table.loc["top", "sentence"]
    assert "the limit is physical" in table.loc["zero", "sentence"]
    assert "is confounded with low" in table.loc["zero", "sentence"]
    assert table.loc["place", "sentence"] == "Identified: its other values fit much worse."
    assert table.loc["spot", "suggested_limit"] == 11.0
    assert "not assessed by derivatives" in table.loc["spot", "sentence"]
    assert table["fits_within_std"].all()
    assert not parameter_verdicts(space, values, found, fits=False)["fits_within_std"].any()
    unknown = parameter_verdicts(space, values, found)
    assert unknown["fits_within_std"].isna().all() and isinstance(unknown, pd.DataFrame)


def test_a_parameter_that_differs_between_equally_good_solutions_is_not_identified():
    """However small its standard deviation is at one of them; an integer that was not assessed neither."""
    space = ParameterSpace(
        (*(Parameter(name, 5.0, 0.0, 10.0) for name in "abc"), Parameter("n", 5.0, 2.0, 8.0, integer=True))
    )
    found = identify(space, "abc", np.diag([100.0, 100.0, 1.0]))
    values, differing = {"a": 4.0, "b": 4.0, "c": 4.0, "n": 5.0}, {"a": 0.5, "c": 0.3, "n": 0.4}
    alone, table = (
        parameter_verdicts(space, values, found, differing=given).set_index("parameter") for given in ({}, differing)
    )
    assert alone["identified"].to_dict() == {"a": True, "b": True, "c": False, "n": None}
    assert table["identified"].to_dict() == {"a": False, "b": True, "c": False, "n": False}
    assert table["not_identified"].to_dict() == {
        "a": "solutions", "b": "", "c": f"{alone.loc['c', 'not_identified']}, solutions", "n": "solutions"
    }  # fmt: skip
    pd.testing.assert_series_equal(table["std"], alone["std"])
    assert "50 %" in table.loc["a", "sentence"] and table.loc["b", "sentence"] == alone.loc["b", "sentence"]
    assert identified_sentence(table.reset_index()) == "1 of 4 parameters are identified; not a, c, n."


# -- the bogie ---------------------------------------------------------------------------------------------------------

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def bogie():
    study = LoadedStudy.load(ROOT / "studies" / "bogie")
    truth = json.loads((ROOT / "tests" / "truth" / "bogie.json").read_text("utf-8"))["parameters"]
    return ModalResidual(study.problem), study.search_space, truth


def errors_in_std(found, space, truth):
    known = posterior(found.names, found.jacobian, Prior.of(space).widths(found.values, found.names))
    return np.array([found.values[n] - truth[n] for n in found.names]) / known.std


@pytest.mark.slow
def test_the_bogie_is_found_within_its_standard_deviation(bogie):
    """From the nominal values, actuators at their places: a few iterations, errors within the intervals.

    The upper rods of the twin lie less than a standard deviation below the limit of the search, where the fit ends.
    """
    residual, space, truth = bogie
    places = {n: truth[n] for n in ("pos_long_left", "pos_long_right")}
    found = fit(residual, space, places)
    assert found.converged and found.iterations <= 8
    assert found.active_limits == ("K_rod_upper at its upper limit",)
    dof = residual.n_rows - residual.n_fitted_factors - len(found.names)
    assert found.data_misfit < stats.chi2.ppf(0.9999, dof)
    error = errors_in_std(found, space, truth)
    assert np.all(np.abs(error) < 3.5)
    assert error @ error < 3 * len(error)
    for name, width in (("K_primary", 0.05), ("m_crossbar", 0.1)):
        assert abs(found.values[name] - truth[name]) < width * (space[name].upper - space[name].lower)


@pytest.mark.slow
def test_the_bogies_actuators_are_found_from_the_nominal_places(bogie):
    residual, space, truth = bogie
    found = fit_mixed(residual, space)
    for name in ("pos_long_left", "pos_long_right"):
        assert found.best.values[name] == truth[name]
        assert integer_std(*found.profile(name)) < 0.01
    assert np.all(np.abs(errors_in_std(found.best, space, truth)) < 3.5)
