"""Reasons why a fitted model is implausible."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.missing.plausible import implausible, parameter_pulls
from calib.missing.rules import RULES


@pytest.mark.medium
def test_the_pull_is_standard_normal_in_a_correctly_specified_model(toy):
    toy = toy(parameters=6, reach=1.0)
    rng = np.random.default_rng(1)
    tables = [parameter_pulls(toy.drawn(rng).calibrated()) for _ in range(150)]
    scores = np.array([t["standardised"] for t in tables])
    np.testing.assert_allclose(scores.std(axis=0), 1.0, atol=4 / np.sqrt(300))
    assert stats.kstest(scores.ravel(), "norm").pvalue > 0.005
    assert np.mean([t["pulled"].any() for t in tables]) == pytest.approx(RULES.pull, abs=0.035)


def test_the_limit_grows_with_the_number_of_parameters(toy):
    for count in (1, 5, 12):
        table = parameter_pulls(toy(parameters=count).calibrated())
        assert len(table) == count
        assert table["limit"].iloc[0] == pytest.approx(stats.norm.isf(RULES.pull / (2 * count)))


def test_a_pulled_parameter_is_named(toy):
    toy = toy(prior=0.2, reach=10.0).drawn(np.random.default_rng(2), {"P2": -0.9})
    fit = toy.calibrated()
    table = parameter_pulls(fit).set_index("parameter")
    assert table["pulled"].tolist() == [False, False, True, False]
    row = table.loc["P2"]
    assert row["value"] == pytest.approx(-0.9, abs=0.06) and row["nominal"] == 0.0 and row["prior_sd"] == 0.2
    variance = 0.2**2 - fit.covariance[2, 2]
    assert row["standardised"] == pytest.approx(row["value"] / np.sqrt(variance))
    assert "P2 has shifted by -4." in implausible(fit, ())


def test_of_many_pulled_parameters_the_most_pulled_are_named_with_their_number(toy):
    shifts = {"P0": -0.9, "P1": 0.7, "P2": -0.8, "P3": 1.0}
    toy = toy(prior=0.2, reach=10.0).drawn(np.random.default_rng(2), shifts)
    fit = toy.calibrated()
    table = parameter_pulls(fit).set_index("parameter")
    assert table["pulled"].all()
    told = implausible(fit, ())
    assert told.startswith("4 of 4 parameters") and "P3 by +" in told
    assert [name for name in table.index if f"{name} by " in told] == ["P0", "P2", "P3"]


def test_the_pull_is_relative_to_what_the_data_determine(toy):
    """For a parameter whose variance the data reduce by a tenth, one prior standard deviation is a strong pull."""
    toy = toy(parameters=1, reach=1 / 3)
    pulled = replace(toy, data=9.0 * toy.columns["P0"] / np.linalg.norm(toy.columns["P0"]) * 1.3)
    row = parameter_pulls(pulled.calibrated()).iloc[0]
    assert abs(row["value"]) < 4.0 and row["pulled"]
    assert row["standardised"] == pytest.approx(row["value"] / np.sqrt(0.1), rel=1e-3)


def test_parameters_of_effects_have_no_pull(toy):
    toy = toy(bump=True).drawn(np.random.default_rng(3), {"hung": 8.0, "at": 5.0})
    fit = toy.calibrated("hung", start={"hung": 6.0, "at": 5.0})
    own = [e for e in toy.effects if e.name == "hung"]
    assert fit.shift[fit.names.index("hung")] > 5
    assert list(parameter_pulls(fit, own)["parameter"]) == ["P0", "P1", "P2", "P3"]
    assert implausible(fit, own) == ""


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
def test_a_magnitude_on_its_limit(toy, signed, value, reason):
    toy = toy(signed=("E0",) if signed else ())
    fit = toy.calibrated("E0")
    fit = replace(fit, values={**fit.values, "E0": value})
    words = implausible(fit, toy.effects[:1])
    assert words.startswith(reason) and bool(words) == bool(reason)


def test_a_wide_range_puts_no_magnitude_on_its_limit(toy):
    """Less than a thousandth of the range from a limit, but many standard deviations: the limit does not hold it."""
    toy = toy(signed=("E0",)).drawn(np.random.default_rng(4), {"E0": 0.3})
    wide = replace(toy.effects[0].magnitude, lower=-0.5, upper=1000.0)
    own = replace(toy.effects[0], magnitude=wide)
    fit = replace(toy, effects=(own, *toy.effects[1:])).calibrated("E0")
    reach = fit.covariance[fit.names.index("E0"), fit.names.index("E0")] ** 0.5
    distance = fit.values["E0"] + 0.5
    assert 3 * reach < distance < 1e-3 * (wide.upper - wide.lower)
    assert "limit" not in implausible(fit, [own])
    there = replace(fit, values={**fit.values, "E0": -0.5})
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
    fit = toy.calibrated("hung", start={"hung": 1.0, "at": 3.0})
    fit = replace(fit, values={**fit.values, "at": value})
    assert implausible(fit, [hung]) == reason


def test_all_reasons_are_given(toy):
    toy = toy(prior=0.2, reach=10.0).drawn(np.random.default_rng(2), {"P2": -0.9, "P0": 1.0})
    fit = toy.calibrated("E0")
    fit = replace(fit, values={**fit.values, "E0": 50.0})
    words = implausible(fit, toy.effects[:1]).split("; ")
    assert len(words) == 3 and words[0].startswith("P0") and words[1].startswith("P2") and words[2].startswith("E0")
