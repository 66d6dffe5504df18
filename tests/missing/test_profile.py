"""Intervals by profile likelihood."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from calib.missing.profile import profile_interval


def lowest(toy, state, name, value):
    """Lowest sum of squares with one parameter held, by another minimiser."""
    space = state.question.space
    others = [n for n in state.names if n != name]

    def misfit(x):
        values = {**state.values, **dict(zip(others, x, strict=True)), name: value}
        prior = [(values[n] - space[n].value) / space[n].prior_width for n in state.names]
        return np.sum(state.question.residual(values) ** 2) + np.sum(np.square(prior))

    start = [state.values[n] for n in others]
    return minimize(misfit, start, method="BFGS", options={"gtol": 1e-5}).fun


def profile(toy, state, name):
    """Ends of the exact interval."""

    def rise(value):
        return lowest(toy, state, name, value) - state.misfit - 1.96**2

    k = state.names.index(name)
    centre, std = state.values[name], float(np.sqrt(state.covariance[k, k]))
    return [brentq(rise, centre, centre + sign * 6 * std, xtol=1e-4 * std) for sign in (-1, 1)]


@pytest.mark.parametrize("name", ["E0", "P1", "E1"])
def test_it_is_the_linear_interval_of_a_linear_model(toy, name):
    toy = toy(signed=("E0", "E1")).drawn(np.random.default_rng(1), {"E0": 1.2, "E1": -0.4})
    state = toy.calibrated("E0", "E1")
    k = state.names.index(name)
    std = np.sqrt(state.covariance[k, k])
    low, high = profile_interval(state, name)
    assert (low - state.values[name]) / std == pytest.approx(-1.96, abs=0.03)
    assert (high - state.values[name]) / std == pytest.approx(1.96, abs=0.03)


@pytest.mark.parametrize(("curvature", "truth"), [(0.4, 0.7), (-0.06, 2.0)])
def test_it_is_the_exact_profile_of_a_curved_model(toy, curvature, truth):
    toy = toy(signed=("E0",), parameters=2, modes=4, sensors=4, size=4.0, reach=2.0, curvature=curvature)
    # All rows bend alike, so that the interval is lopsided.
    columns = {n: np.abs(c) for n, c in toy.columns.items()}
    toy = replace(toy, columns=columns).drawn(np.random.default_rng(2), {"E0": truth})
    state = toy.calibrated("E0")
    std = np.sqrt(state.covariance[-1, -1])
    low, high = profile_interval(state, "E0")
    exact = profile(toy, state, "E0")
    lopsided = (exact[1] - state.values["E0"]) / (state.values["E0"] - exact[0]) - 1
    assert abs(lopsided) > 0.04
    np.testing.assert_allclose([low, high], exact, atol=0.04 * std)


def test_it_holds_the_truth_at_its_level(toy):
    """Data drawn with a strength from its prior: the posterior interval then covers at the nominal rate."""
    toy = toy(signed=("E0",), parameters=2, modes=4, sensors=4, size=4.0, curvature=0.02)
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(300):
        truth = rng.normal()
        state = toy.drawn(rng, {"E0": truth}).calibrated("E0")
        low, high = profile_interval(state, "E0")
        inside += low <= truth <= high
    assert 0.91 <= inside / 300 <= 0.985


def test_it_stops_at_limits(toy):
    toy = toy(effects=1, size=2.0).drawn(np.random.default_rng(4), {"E0": 0.6})
    narrow = replace(toy.effects[0], strength=replace(toy.effects[0].strength, upper=0.9))
    toy = replace(toy, effects=(narrow,))
    assert profile_interval(toy.calibrated("E0"), "E0") == (0.0, 0.9)


def test_from_a_strength_of_0_it_goes_up_to_what_the_data_allow(toy):
    toy = toy(effects=1).drawn(np.random.default_rng(5), {"E0": -0.4})
    state = toy.calibrated("E0")
    assert state.values["E0"] == 0.0
    low, high = profile_interval(state, "E0")
    assert low == 0.0 < high
    assert 0.95 * 1.96**2 < lowest(toy, state, "E0", high) - state.misfit < 1.2 * 1.96**2  # rather too long


def test_it_ends_where_the_model_cannot_be_solved(toy):
    toy = toy(effects=1).drawn(np.random.default_rng(6), {"E0": 1.0})
    state = replace(toy, fails=lambda values: values.get("E0", 0.0) > 1.1).calibrated("E0", start={"E0": 0.9})
    low, high = profile_interval(state, "E0")
    assert low < 0.95 and np.isfinite(high) and high > state.values["E0"]
