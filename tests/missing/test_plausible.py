"""Reasons not to believe a fitted model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.missing.plausible import implausible, strain
from calib.missing.rules import RULES


def test_strain_is_a_standard_normal_variate_in_a_right_model(toy):
    toy = toy(parameters=6, reach=1.0)
    rng = np.random.default_rng(1)
    tables = [strain(toy.drawn(rng).calibrated()) for _ in range(300)]
    scores = np.array([t["standardised"] for t in tables])
    np.testing.assert_allclose(scores.std(axis=0), 1.0, atol=4 / np.sqrt(600))
    assert stats.kstest(scores.ravel(), "norm").pvalue > 0.005
    assert np.mean([t["strained"].any() for t in tables]) == pytest.approx(RULES.strain, abs=0.025)


def test_the_limit_grows_with_the_number_of_parameters(toy):
    for count in (1, 5, 12):
        table = strain(toy(parameters=count).calibrated())
        assert len(table) == count
        assert table["limit"].iloc[0] == pytest.approx(stats.norm.isf(RULES.strain / (2 * count)))


def test_a_parameter_that_had_to_go_far_is_named(toy):
    toy = toy(prior=0.2, reach=10.0).drawn(np.random.default_rng(2), {"P2": -0.9})
    state = toy.calibrated()
    table = strain(state).set_index("parameter")
    assert table["strained"].tolist() == [False, False, True, False]
    row = table.loc["P2"]
    assert row["value"] == pytest.approx(-0.9, abs=0.06) and row["adopted"] == 0.0 and row["prior_sd"] == 0.2
    told = 0.2**2 - state.covariance[2, 2]
    assert row["standardised"] == pytest.approx(row["value"] / np.sqrt(told))
    assert "P2 had to move -4." in implausible(state, ())


def test_what_the_data_say_little_of_is_judged_by_how_far_they_could_move_it(toy):
    """Of a parameter told to a tenth of its prior variance, a move of one prior deviation is a strong pull."""
    toy = toy(parameters=1, reach=1 / 3)
    pulled = replace(toy, data=9.0 * toy.columns["P0"] / np.linalg.norm(toy.columns["P0"]) * 1.3)
    row = strain(pulled.calibrated()).iloc[0]
    assert abs(row["value"]) < 4.0 and row["strained"]
    assert row["standardised"] == pytest.approx(row["value"] / np.sqrt(0.1), rel=1e-3)


def test_parameters_of_effects_are_not_under_strain(toy):
    toy = toy(bump=True).drawn(np.random.default_rng(3), {"hung": 8.0, "at": 5.0})
    state = toy.calibrated("hung", start={"hung": 6.0, "at": 5.0})
    own = [e for e in toy.effects if e.name == "hung"]
    assert state.shift[state.names.index("hung")] > 5
    assert list(strain(state, own)["parameter"]) == ["P0", "P1", "P2", "P3"]
    assert implausible(state, own) == ""


@pytest.mark.parametrize(
    ("signed", "value", "reason"),
    [
        (False, 0.0, ""),
        (False, 50.0, "E0 is on its limit of 50"),
        (True, -50.0, "E0 is on its limit of -50"),
        (True, 0.0, ""),
        (True, 50.0, "E0 is on its limit of 50"),
        (True, 49.0, ""),
    ],
)
def test_a_strength_on_its_limit(toy, signed, value, reason):
    toy = toy(signed=("E0",) if signed else ())
    state = toy.calibrated("E0")
    state = replace(state, values={**state.values, "E0": value})
    words = implausible(state, toy.effects[:1])
    assert words.startswith(reason) and bool(words) == bool(reason)


def test_a_wide_range_puts_no_strength_on_its_limit(toy):
    """Less than a thousandth of the range from a limit, but many standard deviations: nothing holds it there."""
    toy = toy(signed=("E0",)).drawn(np.random.default_rng(4), {"E0": 0.3})
    wide = replace(toy.effects[0].strength, lower=-0.5, upper=1000.0)
    own = replace(toy.effects[0], strength=wide)
    state = replace(toy, effects=(own, *toy.effects[1:])).calibrated("E0")
    reach = state.covariance[state.names.index("E0"), state.names.index("E0")] ** 0.5
    distance = state.values["E0"] + 0.5
    assert 3 * reach < distance < 1e-3 * (wide.upper - wide.lower)
    assert "limit" not in implausible(state, [own])
    there = replace(state, values={**state.values, "E0": -0.5})
    assert "E0 is on its limit of -0.5" in implausible(there, [own])


@pytest.mark.parametrize(
    ("sd", "value", "reason"),
    [
        (1.0, 3.5, ""),
        (1.0, 3.5 + 0.99 * RULES.nuisance, ""),
        (1.0, 3.5 + 1.01 * RULES.nuisance, "at = 5.52 Hz is far from 3.5"),
        (1.0, 3.5 - 1.01 * RULES.nuisance, "at = 1.48 Hz is far from 3.5"),
        (5.0, 7.99999, "at is on its limit of 8 Hz"),
        (5.0, -1.0, "at is on its limit of -1 Hz"),
        (5.0, 7.9, ""),
    ],
)
def test_a_nuisance_parameter_out_of_its_range(toy, sd, value, reason):
    toy = toy(bump=True, effects=0)
    (hung,) = toy.effects
    hung = replace(hung, nuisance=(replace(hung.nuisance[0], upper=8.0, prior_sd=sd),))
    toy = replace(toy, effects=(hung,)).drawn(np.random.default_rng(5), {"hung": 1.0, "at": 3.0})
    state = toy.calibrated("hung", start={"hung": 1.0, "at": 3.0})
    state = replace(state, values={**state.values, "at": value})
    assert implausible(state, [hung]) == reason


def test_all_reasons_are_given(toy):
    toy = toy(prior=0.2, reach=10.0).drawn(np.random.default_rng(2), {"P2": -0.9, "P0": 1.0})
    state = toy.calibrated("E0")
    state = replace(state, values={**state.values, "E0": 50.0})
    words = implausible(state, toy.effects[:1]).split("; ")
    assert len(words) == 3 and words[0].startswith("P0") and words[1].startswith("P2") and words[2].startswith("E0")
