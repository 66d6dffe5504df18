"""What to measure next, against projections done another way."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.missing.advice import (
    AVERAGED,
    COLUMNS,
    WITHHELD,
    WORTHWHILE,
    Prospects,
    View,
    advice_sentence,
    advise,
)
from calib.missing.option import Option
from calib.missing.rivals import Odds
from calib.questions.prospects import _modes_in_words

P, M, MORE = 3, 4, 6
TWICE = Option("twice the repeats", "repeats", scale=1 / math.sqrt(2))
SENSOR = Option("a sensor on the roof", "sensor", rows=np.arange(20) >= 20 - MORE)


def prospects(seed=0, prior=1.0, options=(TWICE, SENSOR), scale=1.0):
    rng = np.random.default_rng(seed)
    n = 20
    prior_sd = prior * rng.uniform(0.5, 2.0, P)
    slope, columns = scale * rng.standard_normal((n, P)), rng.standard_normal((n, M))
    view = View(tuple(f"P{k}" for k in range(P)), prior_sd, slope, columns)
    return Prospects(tuple(f"E{k}" for k in range(M)), np.arange(n) < n - MORE, tuple(options), (view,))


def with_columns(p, columns):
    return replace(p, views=(replace(p.views[0], columns=columns),))


def projected(p, option=None):
    """Fingerprints less what parameters and priors can follow of them, by plain least squares."""
    (view,) = p.views
    rows = p.measured if option is None or option.rows is None else p.measured | option.rows
    scale = 1.0 if option is None else option.scale
    known = {} if option is None else option.prior_sd
    sd = [min(s, known.get(n, np.inf)) for n, s in zip(view.names, view.prior_sd, strict=True)]
    a = np.vstack([view.slope[rows] / scale, np.diag(1 / np.array(sd))])
    c = np.vstack([view.columns[rows] / scale, np.zeros((P, M))])
    return c - a @ np.linalg.lstsq(a, c, rcond=None)[0]


def sizes(p, option=None):
    return p.sizes(option)[0]


options = st.sampled_from(
    [
        None,
        TWICE,
        SENSOR,
        Option("a bench test", "bench", prior_sd={"P1": 0.05}),
        Option("all at once", "bench", rows=SENSOR.rows, scale=0.7, prior_sd={"P0": 0.1, "P2": 0.01}),
    ]
)


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), options)
def test_what_is_seen_is_what_least_squares_leave(seed, prior, option):
    p = prospects(seed, prior)
    np.testing.assert_allclose(sizes(p, option), np.linalg.norm(projected(p, option), axis=0), rtol=1e-6, atol=1e-8)


@given(st.integers(0, 10_000), st.floats(0.01, 100.0))
def test_twice_the_repeats_multiply_scores_by_no_more_than_root_two(seed, prior):
    p = prospects(seed, prior)
    gain = sizes(p, TWICE) / sizes(p)
    assert np.all(gain >= 1 - 1e-12) and np.all(gain <= math.sqrt(2) + 1e-12)


def test_twice_the_repeats_give_root_two_where_nothing_is_absorbed_or_nothing_is_known_beforehand():
    p = prospects(1, prior=1.0)
    known = sizes(p, TWICE) / sizes(p)
    assert np.all(known < math.sqrt(2) - 1e-4)  # priors do not sharpen with the test
    flat = prospects(1, prior=1e7)
    np.testing.assert_allclose(sizes(flat, TWICE) / sizes(flat), math.sqrt(2), rtol=1e-9)
    (view,) = p.views
    slope, columns = view.slope[p.measured], view.columns.copy()
    columns[p.measured] -= slope @ np.linalg.lstsq(slope, columns[p.measured], rcond=None)[0]
    alone = with_columns(p, columns)
    np.testing.assert_allclose(sizes(alone, TWICE) / sizes(alone), math.sqrt(2), rtol=1e-12)


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.lists(st.booleans(), min_size=20, max_size=20))
def test_more_rows_never_lower_a_score(seed, prior, rows):
    p = prospects(seed, prior)
    assert np.all(sizes(p, Option("", "sensor", rows=np.array(rows))) >= sizes(p) * (1 - 1e-9))


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.sampled_from(["P0", "P1", "P2"]), st.floats(1e-3, 10.0))
def test_a_test_of_a_part_by_itself_never_lowers_a_score(seed, prior, name, sd):
    """Nor does one that says less than is known already make it known worse."""
    p = prospects(seed, prior)
    there, now = sizes(p, Option("", "bench", prior_sd={name: sd})), sizes(p)
    assert np.all(there >= now * (1 - 1e-9))
    if sd >= p.views[0].prior_sd[p.views[0].names.index(name)]:
        np.testing.assert_array_equal(there, now)
    else:
        assert np.any(there > now)


def test_a_part_that_is_known_exactly_absorbs_nothing():
    p = prospects(3, prior=2.0)
    bench = Option("all parts", "bench", prior_sd=dict.fromkeys(p.views[0].names, 1e-9))
    np.testing.assert_allclose(sizes(p, bench), np.linalg.norm(p.views[0].columns[p.measured], axis=0), rtol=1e-9)


def test_an_effect_that_the_model_has_is_not_absorbed_by_itself():
    p = prospects(3)
    (view,) = p.views
    has = replace(
        view, names=(*view.names, "E1"), prior_sd=np.append(view.prior_sd, 5.0),
        slope=np.column_stack([view.slope, view.columns[:, 1]]),
    )  # fmt: skip
    there = replace(p, views=(has,))
    assert sizes(there)[1] == pytest.approx(sizes(p)[1])
    assert np.all(np.delete(sizes(there), 1) < np.delete(sizes(p), 1))  # it absorbs of the others


# -- tables ------------------------------------------------------------------------------------------------------------


def test_the_table_tells_gain_and_smallest_strength_best_first():
    p = prospects(4)
    table = advise(p)
    assert tuple(table.columns) == COLUMNS and len(table) == 2 * M
    assert table["gain"].is_monotonic_decreasing and table["ln_bayes"].isna().all()
    for row in table.itertuples():
        option = next(o for o in p.options if o.name == row.option)
        k = p.effects.index(row.effect)
        assert row.kind == option.kind
        assert row.gain == pytest.approx(np.linalg.norm(projected(p, option)[:, k]) / sizes(p)[k])
        assert row.phi_min == pytest.approx(4.0 / np.linalg.norm(projected(p, option)[:, k]))
        assert row.gain_low == row.gain == row.gain_high  # seen from one point only
        assert (
            row.words
            == f"{option.name}: {row.gain:.2g} times the score of {row.effect} ({row.gain:.2g} to {row.gain:.2g})"
        )


def test_an_effect_that_leaves_no_trace_is_no_division_by_zero():
    p = prospects(5)
    columns = p.views[0].columns.copy()
    columns[:, 0] = 0.0
    columns[p.measured, 1] = 0.0
    table = advise(with_columns(p, columns)).set_index(["option", "effect"])
    assert math.isnan(table.loc[("twice the repeats", "E0"), "gain"])
    assert table.loc[("twice the repeats", "E0"), "phi_min"] == math.inf
    assert table.loc[("twice the repeats", "E1"), "phi_min"] == math.inf
    assert table.loc[("a sensor on the roof", "E1"), "phi_min"] < math.inf


# -- averaged ----------------------------------------------------------------------------------------------------------


def test_the_gain_is_averaged_over_all_points():
    several = [prospects(seed) for seed in range(10)]
    weights = np.random.default_rng(1).uniform(0.5, 2.0, 10)
    views = tuple(replace(p.views[0], weight=w) for p, w in zip(several, weights, strict=True))
    table = advise(replace(several[0], views=views)).set_index(["option", "effect"])
    for option in (TWICE, SENSOR):
        each = np.array([sizes(p, option) / sizes(p) for p in several])
        for k in range(M):
            row = table.loc[(option.name, f"E{k}")]
            assert row["gain"] == pytest.approx(np.average(each[:, k], weights=weights))
            assert each[:, k].min() <= row["gain_low"] <= np.median(each[:, k]) <= row["gain_high"] <= each[:, k].max()
            assert np.sum(weights[each[:, k] < row["gain_low"]]) <= 0.1 * weights.sum()
            size = np.average([sizes(p, option)[k] for p in several], weights=weights)
            assert row["phi_min"] == pytest.approx(4.0 / size)


def test_points_that_are_all_the_same_give_what_one_gives():
    one = prospects(2)
    pd.testing.assert_frame_equal(advise(one), advise(replace(one, views=one.views * 7)))


def test_a_mode_that_is_lost_at_half_of_the_points_gains_half():
    p = prospects(4)
    (view,) = p.views
    there = SENSOR.rows[:, None]
    lost = replace(view, slope=np.where(there, 0.0, view.slope), columns=np.where(there, 0.0, view.columns))
    both = replace(p, views=(view, lost))
    whole, half = (advise(one).set_index(["option", "effect"])["gain"][SENSOR.name] for one in (p, both))
    assert (whole > 1.05).all()
    np.testing.assert_allclose(half - 1, (whole - 1) / 2)
    low = advise(both).set_index(["option", "effect"])["gain_low"][SENSOR.name]
    np.testing.assert_allclose(low, 1.0)


# -- telling two effects apart -----------------------------------------------------------------------------------------


class Told:
    """Rivals whose odds are given."""

    names = ("E0", "E1")

    def __init__(self, odds):
        self.odds = lambda option: odds[option.name]


def apart(roof=5.0, twice=0.5):
    odds = {SENSOR.name: Odds(roof, roof - 2, roof + 2, 0.9), TWICE.name: Odds(twice, -1.0, 2.0, 0.1)}
    return replace(prospects(), rivals=Told(odds))


def test_the_option_that_tells_a_pair_apart_comes_first():
    table = advise(apart())
    assert table["ln_bayes"].is_monotonic_decreasing
    assert table["option"].iloc[0] == "a sensor on the roof" and table["effect"].iloc[0] == "E0"
    assert tuple(table.iloc[0][["ln_bayes", "ln_bayes_low", "ln_bayes_high", "chance"]]) == (5.0, 3.0, 7.0, 0.9)


def test_the_sentence_about_a_pair_names_the_best_option_with_its_odds():
    assert advice_sentence(advise(apart()), ("E0", "E1"), []) == (
        "To tell them apart, measure next: a sensor on the roof: odds of 150:1 for the true one of E0 and E1 (20:1 to "
        f"1100:1), beyond 20:1 with a chance of 90 %. {AVERAGED}"
    )


def test_that_nothing_tells_them_apart_is_said():
    told = advice_sentence(advise(apart(2.9, -0.1)), ("E0", "E1"), [])
    assert told.startswith("No measurement looked at would tell E0 from E1; the best gives a sensor on the roof: odds ")
    assert "(2.5:1 to 130:1)" in told and AVERAGED in told


@pytest.mark.parametrize(
    ("ln_odds", "words"),
    [(0.0, "1:1"), (-1.1, "1:3"), (9.0, "8100:1"), (10.0, "over 10,000:1"), (-10.0, "under 1:10,000")],
)
def test_odds_are_told_as_odds(ln_odds, words):
    table = advise(apart(5.0, ln_odds))
    own = table[(table["effect"] == "E0") & (table["kind"] == "repeats")].iloc[0]
    assert own["words"].startswith(f"twice the repeats: odds of {words} for the true one of E0 and E1 (1:2.7 to 7.4:1)")


# -- seeing more -------------------------------------------------------------------------------------------------------


def table_of(*rows):
    full = [
        (
            option,
            "sensor",
            effect,
            gain,
            gain,
            gain,
            1.0,
            *[math.nan] * 4,
            f"{option}: {gain:.2g} times the score of {effect}",
        )
        for option, effect, gain in rows
    ]
    return pd.DataFrame(full, columns=list(COLUMNS)).sort_values("gain", ascending=False, ignore_index=True)


def test_the_best_option_is_named_for_every_effect_that_is_not_visible():
    table = table_of(("A", "E0", 1.5), ("B", "E0", 4.0), ("A", "E1", 3.0), ("B", "E1", 2.0), ("A", "E2", 9.0))
    told = advice_sentence(table, None, ["E1", "E0"])
    assert told == f"To see more, measure next: A: 3 times the score of E1; B: 4 times the score of E0. {AVERAGED}"


def test_what_is_not_worthwhile_is_not_advised():
    table = table_of(("A", "E0", WORTHWHILE - 0.01), ("A", "E1", WORTHWHILE), ("A", "E2", math.nan))
    assert (
        advice_sentence(table, None, ["E0", "E1", "E2"])
        == f"To see more, measure next: A: 1.2 times the score of E1. {AVERAGED}"
    )
    assert advice_sentence(table, None, ["E0", "E2"]) == ""
    assert advice_sentence(table, None, []) == ""
    assert advice_sentence(table.head(0), ("E0", "E1"), ["E0"]) == ""


def test_no_more_than_three_are_told():
    table = table_of(*[("A", f"E{k}", 5.0) for k in range(6)])
    assert advice_sentence(table, None, [f"E{k}" for k in range(6)]).count("times the score") == 3


VERIFIES = f" {AVERAGED} A withheld mode that is used no longer verifies the result."


def test_a_withheld_mode_is_said_to_verify_no_more_and_something_new_stands_beside_it():
    held = f"mode 4BT{WITHHELD}"
    table = table_of((held, "E0", 5.0), ("mode 9BT, withheld so far", "E0", 4.0), ("A", "E0", 2.0), ("B", "E0", 1.9))
    told = advice_sentence(table, None, ["E0"])
    assert told == (
        f"To see more, measure next: {held}: 5 times the score of E0 (new: A: 2 times the score of E0).{VERIFIES}"
    )
    alone = advice_sentence(table_of((held, "E0", 5.0), ("A", "E0", WORTHWHILE - 0.01)), None, ["E0"])
    assert alone == f"To see more, measure next: {held}: 5 times the score of E0.{VERIFIES}"
    new = advice_sentence(table_of((held, "E0", 2.0), ("A", "E0", 5.0)), None, ["E0"])
    assert new == f"To see more, measure next: A: 5 times the score of E0. {AVERAGED}"


def test_so_it_is_where_a_pair_is_told_apart():
    held = replace(SENSOR, name=f"mode 4BT{WITHHELD}", kind="mode")
    odds = {held.name: Odds(5.0, 3.0, 7.0, 0.9), TWICE.name: Odds(0.0, -1.0, 1.0, 0.1)}
    p = replace(prospects(options=(TWICE, held)), rivals=Told(odds))
    told = advice_sentence(advise(p), ("E0", "E1"), [])
    assert told.startswith(f"To tell them apart, measure next: {held.name}: odds of ") and told.endswith(VERIFIES)
    assert " (new: twice the repeats: odds of 1:1 for the true one of E0 and E1 " in told


def test_withheld_modes_are_known_by_the_end_of_their_name():
    assert _modes_in_words([10.1], {"4BT": 10.0}) == [f"mode 4BT{WITHHELD}"]
    assert WITHHELD not in _modes_in_words([20.0], {"4BT": 10.0})[0]


def test_no_two_modes_are_called_the_same():
    computed = "the mode computed at"
    assert _modes_in_words([9.8, 10.1], {"4BT": 10.0}) == [f"{computed} 9.8 Hz", f"mode 4BT{WITHHELD}"]
    alike = [f"{computed} 22 Hz (1 of 2)", f"{computed} 22 Hz (2 of 2)"]
    assert _modes_in_words([22.01, 22.02, 30.0], {}) == [*alike, f"{computed} 30 Hz"]
    assert _modes_in_words([], {"4BT": 10.0}) == []
