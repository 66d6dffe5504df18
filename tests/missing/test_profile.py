"""Profile-likelihood intervals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from calib.missing.decision import decide
from calib.missing.profile import profile_interval


def lowest(toy, fit, name, value):
    """Lowest sum of squares with one parameter held, by another minimiser."""
    space = fit.fit_problem.space
    others = [n for n in fit.names if n != name]

    def misfit(x):
        values = {**fit.values, **dict(zip(others, x, strict=True)), name: value}
        prior = [(values[n] - space[n].value) / space[n].prior_width for n in fit.names]
        return np.sum(fit.fit_problem.residual(values) ** 2) + np.sum(np.square(prior))

    start = [fit.values[n] for n in others]
    return minimize(misfit, start, method="BFGS", options={"gtol": 1e-5}).fun


def profile(toy, fit, name):
    """Ends of the exact interval."""

    def rise(value):
        return lowest(toy, fit, name, value) - fit.misfit - 1.96**2

    k = fit.names.index(name)
    centre, std = fit.values[name], float(np.sqrt(fit.covariance[k, k]))
    return [brentq(rise, centre, centre + sign * 6 * std, xtol=1e-4 * std) for sign in (-1, 1)]


@pytest.mark.parametrize("name", ["E0", "P1", "E1"])
def test_the_interval_of_a_linear_model_is_the_linearised_one(toy, name):
    toy = toy(signed=("E0", "E1")).drawn(np.random.default_rng(1), {"E0": 1.2, "E1": -0.4})
    fit = toy.calibrated("E0", "E1")
    k = fit.names.index(name)
    std = np.sqrt(fit.covariance[k, k])
    low, high = profile_interval(fit, name)
    assert (low - fit.values[name]) / std == pytest.approx(-1.96, abs=0.03)
    assert (high - fit.values[name]) / std == pytest.approx(1.96, abs=0.03)


@pytest.mark.parametrize(("curvature", "truth"), [(0.4, 0.7), (-0.06, 2.0)])
def test_the_interval_of_a_nonlinear_model_is_the_exact_profile(toy, curvature, truth):
    toy = toy(signed=("E0",), parameters=2, modes=4, sensors=4, size=4.0, reach=2.0, curvature=curvature)
    # All rows have the same curvature, so that the interval is asymmetric.
    columns = {n: np.abs(c) for n, c in toy.columns.items()}
    toy = replace(toy, columns=columns).drawn(np.random.default_rng(2), {"E0": truth})
    fit = toy.calibrated("E0")
    std = np.sqrt(fit.covariance[-1, -1])
    low, high = profile_interval(fit, "E0")
    exact = profile(toy, fit, "E0")
    lopsided = (exact[1] - fit.values["E0"]) / (fit.values["E0"] - exact[0]) - 1
    assert abs(lopsided) > 0.04
    np.testing.assert_allclose([low, high], exact, atol=0.04 * std)


@pytest.mark.medium
def test_the_interval_covers_the_truth_at_its_level(toy):
    """Data simulated with a magnitude from its prior: the interval then covers it at the nominal rate."""
    toy = toy(signed=("E0",), parameters=2, modes=4, sensors=4, size=4.0, curvature=0.02)
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(150):
        truth = rng.normal()
        fit = toy.drawn(rng, {"E0": truth}).calibrated("E0")
        low, high = profile_interval(fit, "E0")
        inside += low <= truth <= high
    assert 0.9 <= inside / 150 <= 0.99


def test_the_interval_stops_at_limits(toy):
    toy = toy(effects=1, size=2.0).drawn(np.random.default_rng(4), {"E0": 0.6})
    narrow = replace(toy.effects[0], magnitude=replace(toy.effects[0].magnitude, upper=0.9))
    toy = replace(toy, effects=(narrow,))
    assert profile_interval(toy.calibrated("E0"), "E0") == (0.0, 0.9)


def test_the_interval_of_a_magnitude_at_0_has_an_upper_end(toy):
    toy = toy(effects=1).drawn(np.random.default_rng(5), {"E0": -0.4})
    fit = toy.calibrated("E0")
    assert fit.values["E0"] == 0.0
    low, high = profile_interval(fit, "E0")
    assert low == 0.0 < high
    assert 0.95 * 1.96**2 < lowest(toy, fit, "E0", high) - fit.misfit < 1.2 * 1.96**2  # slightly too long


def test_the_interval_ends_where_the_model_cannot_be_solved(toy):
    toy = toy(effects=1).drawn(np.random.default_rng(6), {"E0": 1.0})
    fit = replace(toy, fails=lambda values: values.get("E0", 0.0) > 1.1).calibrated("E0", start={"E0": 0.9})
    low, high = profile_interval(fit, "E0")
    assert low < 0.95 and np.isfinite(high) and high > fit.values["E0"]


def sharing(toy, size=3.0):
    """The toy whose rows share an error that looks like its first effect, of so many standard deviations in all."""
    column = size * toy.columns["E0"] / np.linalg.norm(toy.columns["E0"])
    return replace(toy, shared=(column,))


@pytest.mark.medium
def test_errors_that_rows_share_widen_the_interval_to_its_level(toy):
    """A common error beside the noise of every row: the interval of independent errors misses, this one does not."""
    toy = sharing(toy(signed=("E0",), parameters=2, modes=4, sensors=4, size=4.0))
    rng, inside = np.random.default_rng(7), {False: 0, True: 0}
    for _ in range(150):
        truth = rng.normal()
        drawn = toy.drawn(rng, {"E0": truth})
        alone = replace(drawn, data=drawn.data + toy.shared[0] * rng.standard_normal()).calibrated("E0")
        for knows, fit in ((False, alone), (True, replace(alone, shared=toy.shared_errors))):
            low, high = profile_interval(fit, "E0")
            inside[knows] += low <= truth <= high
    assert inside[False] / 150 < 0.7 and 0.9 <= inside[True] / 150 <= 0.99


def test_what_rows_share_changes_intervals_and_no_verdict(toy):
    toy = toy(signed=("E0",), effects=3, parameters=2, modes=4, sensors=4, size=8.0)
    drawn = toy.drawn(np.random.default_rng(8), {"E0": 2.0})
    one, other = (decide(own) for own in (drawn, sharing(drawn)))
    assert one.verdict == other.verdict == "effect" and one.chosen.ln_evidence == other.chosen.ln_evidence
    assert one.chosen.fit.values == other.chosen.fit.values
    assert other.chosen.magnitude("E0")[1] > 2 * one.chosen.magnitude("E0")[1]
    (low, high), (wide_low, wide_high) = (profile_interval(found.chosen.fit, "E0") for found in (one, other))
    assert wide_high - wide_low > 2 * (high - low) and wide_low < low < high < wide_high


def test_a_limit_ends_a_widened_interval_too(toy):
    toy = sharing(toy(effects=1, size=2.0), 20.0).drawn(np.random.default_rng(4), {"E0": 0.6})
    narrow = replace(toy.effects[0], magnitude=replace(toy.effects[0].magnitude, upper=2.0))
    fit = replace(replace(toy, effects=(narrow,)).calibrated("E0"), shared=toy.shared_errors)
    assert profile_interval(fit, "E0") == (0.0, 2.0)
