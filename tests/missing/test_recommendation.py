"""Experimental design, against projections by plain least squares."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.missing.competing import CandidateMeasurement
from calib.missing.recommendation import AVERAGED, COLUMNS, recommend, score_gain_words
from tests.missing.measurement_designs import (
    SENSOR,
    TWICE,
    M,
    apart,
    design,
    measurements,
    projected,
    sentence_of,
    sizes,
    with_columns,
)


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), measurements)
def test_expected_scores_are_residuals_of_least_squares(seed, prior, measurement):
    p = design(seed, prior)
    np.testing.assert_allclose(
        sizes(p, measurement), np.linalg.norm(projected(p, measurement), axis=0), rtol=1e-6, atol=1e-8
    )


@given(st.integers(0, 10_000), st.floats(0.01, 100.0))
def test_twice_the_repeats_multiply_scores_by_no_more_than_root_two(seed, prior):
    p = design(seed, prior)
    gain = sizes(p, TWICE) / sizes(p)
    assert np.all(gain >= 1 - 1e-12) and np.all(gain <= math.sqrt(2) + 1e-12)


def test_twice_the_repeats_give_root_two_without_absorption_or_priors():
    p = design(1, prior=1.0)
    known = sizes(p, TWICE) / sizes(p)
    assert np.all(known < math.sqrt(2) - 1e-4)  # priors do not narrow with the repeats
    flat = design(1, prior=1e7)
    np.testing.assert_allclose(sizes(flat, TWICE) / sizes(flat), math.sqrt(2), rtol=1e-9)
    (linearisation,) = p.linearisations
    slope, columns = linearisation.slope[p.measured], linearisation.columns.copy()
    columns[p.measured] -= slope @ np.linalg.lstsq(slope, columns[p.measured], rcond=None)[0]
    alone = with_columns(p, columns)
    np.testing.assert_allclose(sizes(alone, TWICE) / sizes(alone), math.sqrt(2), rtol=1e-12)


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.lists(st.booleans(), min_size=20, max_size=20))
def test_more_rows_never_lower_a_score(seed, prior, rows):
    p = design(seed, prior)
    assert np.all(sizes(p, CandidateMeasurement("", "sensor", rows=np.array(rows))) >= sizes(p) * (1 - 1e-9))


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.sampled_from(["P0", "P1", "P2"]), st.floats(1e-3, 10.0))
def test_a_bench_test_never_lowers_a_score(seed, prior, name, sd):
    """A bench test less accurate than the prior does not lower it either."""
    p = design(seed, prior)
    there, now = sizes(p, CandidateMeasurement("", "bench", prior_sd={name: sd})), sizes(p)
    assert np.all(there >= now * (1 - 1e-9))
    if sd >= p.linearisations[0].prior_sd[p.linearisations[0].names.index(name)]:
        np.testing.assert_array_equal(there, now)
    else:
        assert np.any(there > now)


def test_a_parameter_known_exactly_absorbs_nothing():
    p = design(3, prior=2.0)
    bench = CandidateMeasurement("all parts", "bench", prior_sd=dict.fromkeys(p.linearisations[0].names, 1e-9))
    np.testing.assert_allclose(
        sizes(p, bench), np.linalg.norm(p.linearisations[0].columns[p.measured], axis=0), rtol=1e-9
    )


def test_an_effect_of_the_model_does_not_absorb_itself():
    p = design(3)
    (linearisation,) = p.linearisations
    has = replace(
        linearisation, names=(*linearisation.names, "E1"), prior_sd=np.append(linearisation.prior_sd, 5.0),
        slope=np.column_stack([linearisation.slope, linearisation.columns[:, 1]]),
    )  # fmt: skip
    there = replace(p, linearisations=(has,))
    assert sizes(there)[1] == pytest.approx(sizes(p)[1])
    assert np.all(np.delete(sizes(there), 1) < np.delete(sizes(p), 1))  # it absorbs part of the others


# -- tables ------------------------------------------------------------------------------------------------------------


def test_the_table_lists_gain_and_smallest_magnitude_best_first():
    p = design(4)
    table = recommend(p)
    assert tuple(table.columns) == COLUMNS and len(table) == 2 * M
    assert table["gain"].is_monotonic_decreasing and table["ln_bayes"].isna().all()
    for row in table.itertuples():
        measurement = next(o for o in p.measurements if o.name == row.measurement)
        k = p.effects.index(row.effect)
        assert row.kind == measurement.kind
        assert row.gain == pytest.approx(np.linalg.norm(projected(p, measurement)[:, k]) / sizes(p)[k])
        assert row.magnitude_min == pytest.approx(4.0 / np.linalg.norm(projected(p, measurement)[:, k]))
        assert row.gain_low == row.gain == row.gain_high  # one linearisation only
        assert (
            row.words
            == f"{measurement.name}: {row.gain:.2g} times the score of {row.effect} ({row.gain:.2g} to {row.gain:.2g})"
        )


def test_an_effect_that_the_present_data_hardly_show_has_no_number_of_times():
    assert score_gain_words(2.44) == "2.4" and score_gain_words(9.7e20) == "more than 1000"


def test_an_absorbed_effect_has_no_gain():
    p = design(5)
    columns = p.linearisations[0].columns.copy()
    columns[:, 0] = 0.0
    columns[p.measured, 1] = 0.0
    table = recommend(with_columns(p, columns)).set_index(["measurement", "effect"])
    assert math.isnan(table.loc[("twice the repeats", "E0"), "gain"])
    assert table.loc[("twice the repeats", "E0"), "magnitude_min"] == math.inf
    assert table.loc[("twice the repeats", "E1"), "magnitude_min"] == math.inf
    assert table.loc[("a sensor on the roof", "E1"), "magnitude_min"] < math.inf


# -- averaged ----------------------------------------------------------------------------------------------------------


def test_the_gain_is_averaged_over_all_samples():
    several = [design(seed) for seed in range(10)]
    weights = np.random.default_rng(1).uniform(0.5, 2.0, 10)
    linearisations = tuple(replace(p.linearisations[0], weight=w) for p, w in zip(several, weights, strict=True))
    table = recommend(replace(several[0], linearisations=linearisations)).set_index(["measurement", "effect"])
    for measurement in (TWICE, SENSOR):
        each = np.array([sizes(p, measurement) / sizes(p) for p in several])
        for k in range(M):
            row = table.loc[(measurement.name, f"E{k}")]
            assert row["gain"] == pytest.approx(np.average(each[:, k], weights=weights))
            assert each[:, k].min() <= row["gain_low"] <= np.median(each[:, k]) <= row["gain_high"] <= each[:, k].max()
            assert np.sum(weights[each[:, k] < row["gain_low"]]) <= 0.1 * weights.sum()
            size = np.average([sizes(p, measurement)[k] for p in several], weights=weights)
            assert row["magnitude_min"] == pytest.approx(4.0 / size)


def test_equal_samples_give_the_gain_of_one():
    one = design(2)
    pd.testing.assert_frame_equal(recommend(one), recommend(replace(one, linearisations=one.linearisations * 7)))


def test_a_mode_missing_at_half_of_the_samples_gains_half():
    p = design(4)
    (linearisation,) = p.linearisations
    there = SENSOR.rows[:, None]
    lost = replace(
        linearisation,
        slope=np.where(there, 0.0, linearisation.slope),
        columns=np.where(there, 0.0, linearisation.columns),
    )
    both = replace(p, linearisations=(linearisation, lost))
    whole, half = (recommend(one).set_index(["measurement", "effect"])["gain"][SENSOR.name] for one in (p, both))
    assert (whole > 1.05).all()
    np.testing.assert_allclose(half - 1, (whole - 1) / 2)
    low = recommend(both).set_index(["measurement", "effect"])["gain_low"][SENSOR.name]
    np.testing.assert_allclose(low, 1.0)


# -- telling two effects apart -----------------------------------------------------------------------------------------


def test_the_measurement_that_tells_a_pair_apart_comes_first():
    table = recommend(apart())
    assert table["ln_bayes"].is_monotonic_decreasing
    assert table["measurement"].iloc[0] == "a sensor on the roof" and table["effect"].iloc[0] == "E0"
    assert tuple(table.iloc[0][["ln_bayes", "ln_bayes_low", "ln_bayes_high", "chance"]]) == (5.0, 3.0, 7.0, 0.9)


def test_the_sentence_about_a_pair_names_the_best_measurement_with_its_bayes_factor():
    assert sentence_of(recommend(apart()), ("E0", "E1"), []) == (
        "To tell them apart, measure next: a sensor on the roof: odds of 150:1 for the true one of E0 and E1 (20:1 to "
        f"1100:1), beyond 20:1 with a chance of 90 %. {AVERAGED}"
    )


def test_the_sentence_says_when_nothing_tells_a_pair_apart():
    sentence = sentence_of(recommend(apart(2.9, -0.1)), ("E0", "E1"), [])
    assert sentence.startswith(
        "No measurement looked at would tell E0 from E1; the best gives a sensor on the roof: odds "
    )
    assert "(2.5:1 to 130:1)" in sentence and AVERAGED in sentence


@pytest.mark.parametrize(
    ("ln_bayes", "words"),
    [(0.0, "1:1"), (-1.1, "1:3"), (9.0, "8100:1"), (10.0, "over 10,000:1"), (-10.0, "under 1:10,000")],
)
def test_log_bayes_factors_are_written_as_ratios(ln_bayes, words):
    table = recommend(apart(5.0, ln_bayes))
    own = table[(table["effect"] == "E0") & (table["kind"] == "repeats")].iloc[0]
    assert own["words"].startswith(f"twice the repeats: odds of {words} for the true one of E0 and E1 (1:2.7 to 7.4:1)")
