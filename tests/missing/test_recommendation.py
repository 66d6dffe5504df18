"""Experimental design, against projections by plain least squares."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.analyses.imagined_measurement import _modes_in_words
from calib.missing.candidate_measurement import CandidateMeasurement, at_effect
from calib.missing.competing import BayesFactor
from calib.missing.recommendation import (
    AVERAGED,
    COLUMNS,
    HELD_OUT,
    USED,
    ExperimentalDesign,
    Linearisation,
    recommend,
    recommendation,
)
from calib.missing.rules import RULES

P, M, MORE = 3, 4, 6


def _sentence(*given):
    """The recommendation in words; empty without one. Its short form names the same measurements."""
    found = recommendation(*given)
    if found is None:
        return ""
    table = given[0]
    names = [name.removesuffix(HELD_OUT) for name in table["measurement"].unique()]
    named = [name for name in names if name in found.short]
    assert all(name in found.sentence for name in named) and (named or "No measurement" in found.short)
    return found.sentence


TWICE = CandidateMeasurement("twice the repeats", "repeats", scale=1 / math.sqrt(2))
SENSOR = CandidateMeasurement("a sensor on the roof", "sensor", rows=np.arange(20) >= 20 - MORE)


def design(seed=0, prior=1.0, measurements=(TWICE, SENSOR), scale=1.0):
    rng = np.random.default_rng(seed)
    n = 20
    prior_sd = prior * rng.uniform(0.5, 2.0, P)
    slope, columns = scale * rng.standard_normal((n, P)), rng.standard_normal((n, M))
    linearisation = Linearisation(tuple(f"P{k}" for k in range(P)), prior_sd, slope, columns)
    return ExperimentalDesign(
        tuple(f"E{k}" for k in range(M)), np.arange(n) < n - MORE, tuple(measurements), (linearisation,)
    )


def with_columns(p, columns):
    return replace(p, linearisations=(replace(p.linearisations[0], columns=columns),))


def projected(p, measurement=None):
    """Signatures after projection, by plain least squares."""
    (linearisation,) = p.linearisations
    rows = p.measured if measurement is None or measurement.rows is None else p.measured | measurement.rows
    scale = 1.0 if measurement is None else measurement.scale
    known = {} if measurement is None else measurement.prior_sd
    sd = [min(s, known.get(n, np.inf)) for n, s in zip(linearisation.names, linearisation.prior_sd, strict=True)]
    a = np.vstack([linearisation.slope[rows] / scale, np.diag(1 / np.array(sd))])
    c = np.vstack([linearisation.columns[rows] / scale, np.zeros((P, M))])
    return c - a @ np.linalg.lstsq(a, c, rcond=None)[0]


def sizes(p, measurement=None):
    return p.sizes(measurement)[0]


measurements = st.sampled_from(
    [
        None,
        TWICE,
        SENSOR,
        CandidateMeasurement("a bench test", "bench", prior_sd={"P1": 0.05}),
        CandidateMeasurement("all at once", "bench", rows=SENSOR.rows, scale=0.7, prior_sd={"P0": 0.1, "P2": 0.01}),
    ]
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


class Told:
    """Competing models with a given Bayes factor."""

    names = ("E0", "E1")

    def __init__(self, bayes_factor):
        self.bayes_factor = lambda measurement: bayes_factor[measurement.name]


def apart(roof=5.0, twice=0.5):
    bayes_factor = {
        SENSOR.name: BayesFactor(roof, roof - 2, roof + 2, 0.9),
        TWICE.name: BayesFactor(twice, -1.0, 2.0, 0.1),
    }
    return replace(design(), competing=Told(bayes_factor))


def test_the_measurement_that_tells_a_pair_apart_comes_first():
    table = recommend(apart())
    assert table["ln_bayes"].is_monotonic_decreasing
    assert table["measurement"].iloc[0] == "a sensor on the roof" and table["effect"].iloc[0] == "E0"
    assert tuple(table.iloc[0][["ln_bayes", "ln_bayes_low", "ln_bayes_high", "chance"]]) == (5.0, 3.0, 7.0, 0.9)


def test_the_sentence_about_a_pair_names_the_best_measurement_with_its_bayes_factor():
    assert _sentence(recommend(apart()), ("E0", "E1"), []) == (
        "To tell them apart, measure next: a sensor on the roof: odds of 150:1 for the true one of E0 and E1 (20:1 to "
        f"1100:1), beyond 20:1 with a chance of 90 %. {AVERAGED}"
    )


def test_the_sentence_says_when_nothing_tells_a_pair_apart():
    sentence = _sentence(recommend(apart(2.9, -0.1)), ("E0", "E1"), [])
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


# -- seeing more -------------------------------------------------------------------------------------------------------


def table_of(*rows):
    full = [
        (
            measurement,
            "sensor",
            effect,
            gain,
            gain,
            gain,
            1.0,
            *[math.nan] * 4,
            f"{measurement}: {gain:.2g} times the score of {effect}",
        )
        for measurement, effect, gain in rows
    ]
    return pd.DataFrame(full, columns=list(COLUMNS)).sort_values("gain", ascending=False, ignore_index=True)


def test_the_best_measurement_is_named_for_every_invisible_effect():
    table = table_of(("A", "E0", 1.5), ("B", "E0", 4.0), ("A", "E1", 3.0), ("B", "E1", 2.0), ("A", "E2", 9.0))
    sentence = _sentence(table, None, ["E1", "E0"])
    words = "B: 4 times the score of E0; A: 3 times the score of E1"
    assert sentence == f"To see further effects, measure next: {words}. {AVERAGED}"


def test_measurements_are_told_by_gain_whatever_the_order_of_effects_and_kinds():
    held = f"mode 9BT{HELD_OUT}"
    table = table_of(("twice the repeats", "E0", 1.4), (held, "E1", 7.9), ("A", "E2", 3.0), ("A", "E3", 1.3))
    found = recommendation(table, None, ["E0", "E3", "E2", "E1"])
    in_order = (held.removesuffix(HELD_OUT), "A", "twice the repeats")
    for words in (found.short, found.sentence):
        places = [words.index(name) for name in in_order]
        assert places == sorted(places) and "E3" not in words  # three are told: the largest
    assert found.short.count("measure ") == 1  # neighbours of one kind share their verb


def test_what_narrows_a_named_effect_is_told_first():
    at = f"{at_effect('E0')}, (1.00, 0.00, 0.00)"
    table = table_of(("A", "E0", 1.7), (at, "E0", 1.02), ("B", "E1", 9.0), ("A", "E1", 3.0))
    found = recommendation(table, None, ["E1"], ["E0"])
    assert found.short == "To narrow the magnitude of E0, measure A." and "To see further effects" in found.sentence
    words = "measure A: 1.7 times the score of E0. Sensors where E0 acts are not needed: 1.02 times its score."
    assert found.sentence.startswith(f"To narrow the magnitude of E0, {words} To see further effects, measure next: B")
    held = table_of((f"mode 4BT{HELD_OUT}", "E0", 5.0), ("A", "E0", 2.0))
    assert recommendation(held, None, [], ["E0"]).short == f"To narrow the magnitude of E0, {USE_4BT}."


def test_a_named_effect_that_no_measurement_narrows_is_said_to_need_none():
    found = recommendation(table_of(("A", "E0", RULES.worthwhile - 0.01), ("B", "E1", 9.0)), None, ["E0", "E1"], ["E0"])
    none = "E0 needs no further measurement: none looked at raises its score 1.2 times."
    assert found.short == "To see further effects, measure next: B." and none in found.sentence
    assert recommendation(table_of(("A", "E0", 1.0)), None, [], ["E0"]).short == none


def test_a_measurement_of_little_gain_is_not_recommended():
    table = table_of(("A", "E0", RULES.worthwhile - 0.01), ("A", "E1", RULES.worthwhile), ("A", "E2", math.nan))
    assert (
        _sentence(table, None, ["E0", "E1", "E2"])
        == f"To see further effects, measure next: A: 1.2 times the score of E1. {AVERAGED}"
    )
    assert _sentence(table, None, ["E0", "E2"]) == ""
    assert _sentence(table, None, []) == ""
    assert _sentence(table.head(0), ("E0", "E1"), ["E0"]) == ""


def test_at_most_three_measurements_are_recommended():
    table = table_of(*[("A", f"E{k}", 5.0) for k in range(6)])
    assert _sentence(table, None, [f"E{k}" for k in range(6)]).count("times the score") == 3


USE_4BT = "let the fit use mode 4BT, measured and held out so far"
VERIFIES = f" {AVERAGED} {USED}"


def test_a_held_out_mode_is_recommended_with_the_best_new_measurement():
    held = f"mode 4BT{HELD_OUT}"
    table = table_of((held, "E0", 5.0), ("mode 9BT, held out so far", "E0", 4.0), ("A", "E0", 2.0), ("B", "E0", 1.9))
    sentence = _sentence(table, None, ["E0"])
    assert sentence == (
        f"To see further effects, {USE_4BT}: 5 times the score of E0, or measure A: 2 times the score of E0.{VERIFIES}"
    )
    alone = _sentence(table_of((held, "E0", 5.0), ("A", "E0", RULES.worthwhile - 0.01)), None, ["E0"])
    assert alone == f"To see further effects, {USE_4BT}: 5 times the score of E0.{VERIFIES}"
    new = _sentence(table_of((held, "E0", 2.0), ("A", "E0", 5.0)), None, ["E0"])
    assert new == f"To see further effects, measure next: A: 5 times the score of E0. {AVERAGED}"
    both = _sentence(table_of((held, "E0", 5.0), ("A", "E1", 2.0)), None, ["E0", "E1"])
    told = f"{USE_4BT}: 5 times the score of E0; measure A: 2 times the score of E1"
    assert both == f"To see further effects, {told}.{VERIFIES}"


def test_in_short_a_held_out_mode_is_not_to_be_measured_but_used():
    held = f"mode 4BT{HELD_OUT}"
    table = table_of((held, "E0", 5.0), ("A", "E1", 2.0), ("B", "E2", 1.9))
    short = recommendation(table, None, ["E0", "E1", "E2"]).short
    assert short == f"To see further effects, {USE_4BT}; or measure A or B."
    alone = recommendation(table, None, ["E0"]).short
    assert alone == "To see further effects, let the fit use mode 4BT, measured and held out so far."


def test_a_held_out_mode_for_a_pair_is_recommended_with_the_best_new_measurement():
    held = replace(SENSOR, name=f"mode 4BT{HELD_OUT}", kind="mode")
    bayes_factor = {held.name: BayesFactor(5.0, 3.0, 7.0, 0.9), TWICE.name: BayesFactor(0.0, -1.0, 1.0, 0.1)}
    p = replace(design(measurements=(TWICE, held)), competing=Told(bayes_factor))
    sentence = _sentence(recommend(p), ("E0", "E1"), [])
    assert sentence.startswith(f"To tell them apart, {USE_4BT}: odds of ") and sentence.endswith(VERIFIES)
    assert ", or measure twice the repeats: odds of 1:1 for the true one of E0 and E1 " in sentence


def test_held_out_modes_are_recognised_by_their_suffix():
    assert _modes_in_words([10.1], {"4BT": 10.0}) == [f"mode 4BT{HELD_OUT}"]
    assert HELD_OUT not in _modes_in_words([20.0], {"4BT": 10.0})[0]


def test_mode_names_are_unique():
    computed = "a further mode, computed at"
    assert _modes_in_words([9.8, 10.1], {"4BT": 10.0}) == [f"{computed} 9.8 Hz", f"mode 4BT{HELD_OUT}"]
    same = [f"{computed} 22 Hz (1 of 2)", f"{computed} 22 Hz (2 of 2)"]
    assert _modes_in_words([22.01, 22.02, 30.0], {}) == [*same, f"{computed} 30 Hz"]
    assert _modes_in_words([], {"4BT": 10.0}) == []
