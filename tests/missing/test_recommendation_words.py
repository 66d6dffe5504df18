"""The recommended measurement in words, for effects that are invisible or named, and for held-out modes."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.hypotheses.design.imagined_measurement import _modes_in_words
from calib.missing.competing import BayesFactor, at_effect
from calib.missing.recommendation import (
    AVERAGED,
    COLUMNS,
    HELD_OUT,
    KEPT,
    MANY,
    USED,
    Interval,
    recommend,
    recommendation,
    with_few_rows,
)
from calib.missing.rules import RULES
from calib.report.verification import best_candidates
from tests.missing.measurement_designs import (
    SENSOR,
    TWICE,
    Told,
    design,
    sentence_of,
)

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
    sentence = sentence_of(table, None, ["E1", "E0"])
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
    words = "measure A: 1.7 times the score of E0. More sensors where E0 acts add little (1.02 times its score)."
    assert found.sentence.startswith(f"To narrow the magnitude of E0, {words} To see further effects, measure next: B")
    held = table_of((f"mode 4BT{HELD_OUT}", "E0", 5.0), ("A", "E0", 2.0))
    assert recommendation(held, None, [], ["E0"]).short == f"To narrow the magnitude of E0, {USE_4BT}."


def test_the_width_of_the_interval_is_told_now_and_with_the_measurement():
    held = f"mode 4BT{HELD_OUT}"
    intervals = {"E0": Interval(54.4, 74.2, "kg"), "E1": Interval(-0.5, 0.7, "-"), "E2": Interval(1.0, math.nan, "kg")}
    table = table_of(("A", "E0", 1.7))
    found = recommendation(table, None, [], ["E0"], intervals)
    width = "about 20 kg wide now, about 12 kg with"
    assert found.short == f"To narrow the magnitude of E0, measure A (95 % interval {width} it)."
    assert found.sentence.endswith(f"1.7 times the score of E0. Its 95 % interval is {width} A.")
    both = recommendation(table_of((held, "E0", 5.0), ("A", "E0", 1.7)), None, [], ["E0"], intervals)
    assert both.short == f"To narrow the magnitude of E0, {USE_4BT} (95 % interval {width[:-10]}4 kg with it)."
    assert both.sentence.endswith(f"Its 95 % interval is {width[:-10]}4 kg with mode 4BT.")
    several = table_of(("A", "E0", 1.7), ("A", "E1", 2.0), ("A", "E2", 3.0))
    short = recommendation(several, None, [], ["E0", "E1", "E2"], intervals).short
    told = f"E0 {width} it; E1 about 1.2 wide now, about 0.6 with it"
    assert short == f"To narrow the magnitudes of E0, E1 and E2, measure A (95 % interval {told})."


def test_a_named_effect_that_no_measurement_narrows_is_said_to_need_none():
    found = recommendation(table_of(("A", "E0", RULES.worthwhile - 0.01), ("B", "E1", 9.0)), None, ["E0", "E1"], ["E0"])
    none = "E0 needs no further measurement: none looked at raises its score 1.2 times."
    assert found.short == "To see further effects, measure next: B." and none in found.sentence
    assert recommendation(table_of(("A", "E0", 1.0)), None, [], ["E0"]).short == none


@pytest.mark.parametrize("competing", [False, True])
def test_a_shortened_table_draws_and_recommends_what_the_whole_one_does(competing):
    rng, effects = np.random.default_rng(4), [f"E{k}" for k in range(60)]
    rows = [(f"{k} sensors", e, float(1 + rng.random())) for k in range(100) for e in effects]
    table = table_of(*rows)
    if competing:
        odds = table["measurement"].str.split(" ").str[0].astype(float)
        table = table.assign(ln_bayes=odds, ln_bayes_low=odds, ln_bayes_high=odds, chance=0.9)
        table = table.sort_values(["ln_bayes", "gain"], ascending=False, ignore_index=True)
    short = with_few_rows(table)
    assert len(table) > MANY and len(short) == KEPT * len(effects)
    pd.testing.assert_frame_equal(best_candidates(short), best_candidates(table))
    pair = ("E1", "E2") if competing else None
    assert recommendation(short, pair, effects) == recommendation(table, pair, effects)
    assert recommendation(short, None, effects, ["E5"]) == recommendation(table, None, effects, ["E5"])
    assert len(with_few_rows(table.head(MANY))) == MANY


def test_a_measurement_of_little_gain_is_not_recommended():
    table = table_of(("A", "E0", RULES.worthwhile - 0.01), ("A", "E1", RULES.worthwhile), ("A", "E2", math.nan))
    assert (
        sentence_of(table, None, ["E0", "E1", "E2"])
        == f"To see further effects, measure next: A: 1.2 times the score of E1. {AVERAGED}"
    )
    assert sentence_of(table, None, ["E0", "E2"]) == ""
    assert sentence_of(table, None, []) == ""
    assert sentence_of(table.head(0), ("E0", "E1"), ["E0"]) == ""


def test_at_most_three_measurements_are_recommended():
    table = table_of(*[("A", f"E{k}", 5.0) for k in range(6)])
    assert sentence_of(table, None, [f"E{k}" for k in range(6)]).count("times the score") == 3


USE_4BT = "let the fit use mode 4BT, measured as validation data so far"
VERIFIES = f" {AVERAGED} {USED}"


def test_a_held_out_mode_is_recommended_with_the_best_new_measurement():
    held = f"mode 4BT{HELD_OUT}"
    table = table_of(
        (held, "E0", 5.0), ("mode 9BT, validation data so far", "E0", 4.0), ("A", "E0", 2.0), ("B", "E0", 1.9)
    )
    sentence = sentence_of(table, None, ["E0"])
    assert sentence == (
        f"To see further effects, {USE_4BT}: 5 times the score of E0, or measure A: 2 times the score of E0.{VERIFIES}"
    )
    alone = sentence_of(table_of((held, "E0", 5.0), ("A", "E0", RULES.worthwhile - 0.01)), None, ["E0"])
    assert alone == f"To see further effects, {USE_4BT}: 5 times the score of E0.{VERIFIES}"
    new = sentence_of(table_of((held, "E0", 2.0), ("A", "E0", 5.0)), None, ["E0"])
    assert new == f"To see further effects, measure next: A: 5 times the score of E0. {AVERAGED}"
    both = sentence_of(table_of((held, "E0", 5.0), ("A", "E1", 2.0)), None, ["E0", "E1"])
    told = f"{USE_4BT}: 5 times the score of E0; measure A: 2 times the score of E1"
    assert both == f"To see further effects, {told}.{VERIFIES}"


def test_in_short_a_held_out_mode_is_not_to_be_measured_but_used():
    held = f"mode 4BT{HELD_OUT}"
    table = table_of((held, "E0", 5.0), ("A", "E1", 2.0), ("B", "E2", 1.9))
    short = recommendation(table, None, ["E0", "E1", "E2"]).short
    assert short == f"To see further effects, {USE_4BT}; or measure A or B."
    alone = recommendation(table, None, ["E0"]).short
    assert alone == "To see further effects, let the fit use mode 4BT, measured as validation data so far."


def test_a_held_out_mode_for_a_pair_is_recommended_with_the_best_new_measurement():
    held = replace(SENSOR, name=f"mode 4BT{HELD_OUT}", kind="mode")
    bayes_factor = {held.name: BayesFactor(5.0, 3.0, 7.0, 0.9), TWICE.name: BayesFactor(0.0, -1.0, 1.0, 0.1)}
    p = replace(design(measurements=(TWICE, held)), competing=Told(bayes_factor))
    sentence = sentence_of(recommend(p), ("E0", "E1"), [])
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
