"""What to measure next, against projections done another way."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.missing.advice import (
    COLUMNS,
    WITHHELD,
    WORTHWHILE,
    Option,
    Prospects,
    advice_sentence,
    advise,
    expected_odds,
)
from calib.questions.prospects import _mode_in_words

P, M, MORE = 3, 4, 6
TWICE = Option("twice the repeats", "repeats", scale=1 / math.sqrt(2))
SENSOR = Option("a sensor on the roof", "sensor", rows=np.arange(20) >= 20 - MORE)


def prospects(seed=0, prior=1.0, options=(TWICE, SENSOR), scale=1.0):
    rng = np.random.default_rng(seed)
    n = 20
    return Prospects(
        names=tuple(f"P{k}" for k in range(P)),
        prior_sd=prior * rng.uniform(0.5, 2.0, P),
        slope=scale * rng.standard_normal((n, P)),
        effects=tuple(f"E{k}" for k in range(M)),
        columns=rng.standard_normal((n, M)),
        measured=np.arange(n) < n - MORE,
        options=tuple(options),
    )


def projected(p, option=None):
    """Fingerprints less what parameters and priors can follow of them, by plain least squares."""
    rows = p.measured if option is None or option.rows is None else p.measured | option.rows
    scale = 1.0 if option is None else option.scale
    sd = [min(s, ({} if option is None else option.prior_sd).get(n, np.inf)) for n, s in zip(p.names, p.prior_sd)]  # noqa: B905
    a = np.vstack([p.slope[rows] / scale, np.diag(1 / np.array(sd))])
    c = np.vstack([p.columns[rows] / scale, np.zeros((P, M))])
    return c - a @ np.linalg.lstsq(a, c, rcond=None)[0]


def sizes(p, option=None):
    return np.sqrt(np.diag(p.seen(option)))


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
    rest = projected(p, option)
    np.testing.assert_allclose(p.seen(option), rest.T @ rest, rtol=1e-6, atol=1e-8)


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
    across = (
        p.columns[p.measured]
        - p.slope[p.measured] @ np.linalg.lstsq(p.slope[p.measured], p.columns[p.measured], rcond=None)[0]
    )
    columns = p.columns.copy()
    columns[p.measured] = across
    alone = replace(p, columns=columns)
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
    if sd >= p.prior_sd[p.names.index(name)]:
        np.testing.assert_array_equal(there, now)
    else:
        assert np.any(there > now)


def test_a_part_that_is_known_exactly_absorbs_nothing():
    p = prospects(3, prior=2.0)
    bench = Option("all parts", "bench", prior_sd=dict.fromkeys(p.names, 1e-9))
    np.testing.assert_allclose(sizes(p, bench), np.linalg.norm(p.columns[p.measured], axis=0), rtol=1e-9)


# -- tables ------------------------------------------------------------------------------------------------------------


def test_the_table_tells_gain_and_smallest_strength_best_first():
    p = prospects(4)
    table = advise(p, [1.0] * M)
    assert tuple(table.columns) == COLUMNS and len(table) == 2 * M
    assert table["gain"].is_monotonic_decreasing and table["ln_bayes"].isna().all()
    for row in table.itertuples():
        option = next(o for o in p.options if o.name == row.option)
        k = p.effects.index(row.effect)
        assert row.kind == option.kind
        assert row.gain == pytest.approx(np.linalg.norm(projected(p, option)[:, k]) / sizes(p)[k])
        assert row.phi_min == pytest.approx(4.0 / np.linalg.norm(projected(p, option)[:, k]))
        assert row.words == f"{option.name}: {row.gain:.2g} times the score of {row.effect}"


def test_an_effect_that_leaves_no_trace_is_no_division_by_zero():
    p = prospects(5)
    columns = p.columns.copy()
    columns[:, 0] = 0.0
    columns[p.measured, 1] = 0.0
    table = advise(replace(p, columns=columns), [1.0] * M).set_index(["option", "effect"])
    assert math.isnan(table.loc[("twice the repeats", "E0"), "gain"])
    assert table.loc[("twice the repeats", "E0"), "phi_min"] == math.inf
    assert table.loc[("twice the repeats", "E1"), "phi_min"] == math.inf
    assert table.loc[("a sensor on the roof", "E1"), "phi_min"] < math.inf


# -- telling two effects apart -----------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.floats(0.1, 10.0), options)
def test_the_odds_to_expect_are_half_of_what_the_other_effect_cannot_follow(seed, strength, option):
    """With the true effect in the data, fitting the other one leaves the part outside its fingerprint."""
    p = replace(prospects(seed), options=() if option is None else (option,))
    rest = strength * projected(p, option)
    other = rest[:, 2]
    left = rest[:, 0] - other * (other @ rest[:, 0]) / (other @ other)
    strengths = [strength, np.nan, 17.0, np.nan]
    if option is None:
        found = expected_odds(p, strengths, ("E0", "E2"))
    else:
        found = advise(p, strengths, ("E0", "E2"))["ln_bayes"].iloc[0]
    assert found == pytest.approx(0.5 * left @ left, rel=1e-6, abs=1e-8)


def test_effects_of_one_fingerprint_are_never_told_apart():
    p = prospects(6)
    columns = p.columns.copy()
    columns[:, 1], columns[:, 2] = -3.0 * columns[:, 0], 0.0
    p = replace(p, columns=columns)
    assert expected_odds(p, [50.0] * M, ("E0", "E1")) == pytest.approx(0.0, abs=1e-6)
    assert expected_odds(p, [50.0] * M, ("E0", "E2")) == 0.0
    table = advise(p, [50.0] * M, ("E0", "E1"))
    assert table["ln_bayes"].abs().max() < 1e-6
    assert advice_sentence(table, ("E0", "E1"), []).startswith("No measurement looked at would tell E0 from E1")


def apart(seed=0):
    """Two effects that only the roof tells apart, and one that it shows even better."""
    p = prospects(seed)
    columns = p.columns.copy()
    columns[p.measured, 1] = columns[p.measured, 0]
    columns[~p.measured, 0], columns[~p.measured, 1] = 8.0, -8.0
    return replace(p, columns=columns)


def test_the_option_that_tells_a_pair_apart_comes_first():
    p = apart()
    table = advise(p, [1.0] * M, ("E0", "E1"))
    assert table["ln_bayes"].is_monotonic_decreasing
    assert table["option"].iloc[0] == "a sensor on the roof"
    assert table["ln_bayes"].iloc[0] > 3 > expected_odds(p, [1.0] * M, ("E0", "E1"))


@pytest.mark.parametrize(
    "gain",
    [0.1, 100.0],
)
def test_the_sentence_about_a_pair_names_the_best_option_with_its_odds(gain):
    """Whichever effect the option shows best: what it does for a third one is not what was asked."""
    p = apart()
    columns = p.columns.copy()
    columns[~p.measured, 2] *= gain
    table = advise(replace(p, columns=columns), [1.0] * M, ("E0", "E1"))
    told = advice_sentence(table, ("E0", "E1"), [])
    assert told.startswith("To tell them apart, measure next: a sensor on the roof: odds of ")
    assert told.endswith(" between E0 and E1.")


def test_odds_are_told_as_odds():
    p = apart()
    words = []
    for strength in (0.1, 0.5, 5.0):
        table = advise(p, [strength] * M, ("E0", "E1"))
        row = table[(table["effect"] == "E0") & (table["kind"] == "sensor")].iloc[0]
        ln_odds = row["ln_bayes"]
        odds = "over 10,000:1" if ln_odds > math.log(1e4) else f"{float(f'{math.exp(ln_odds):.2g}'):g}:1"
        assert row["words"] == f"a sensor on the roof: odds of {odds} between E0 and E1"
        words.append(odds)
    assert words[-1] == "over 10,000:1" and words[0] != words[-1]


# -- seeing more -------------------------------------------------------------------------------------------------------


def table_of(*rows):
    full = [
        (option, "sensor", effect, gain, 1.0, math.nan, f"{option}: {gain:.2g} times the score of {effect}")
        for option, effect, gain in rows
    ]
    return pd.DataFrame(full, columns=list(COLUMNS)).sort_values("gain", ascending=False, ignore_index=True)


def test_the_best_option_is_named_for_every_effect_that_is_not_visible():
    table = table_of(("A", "E0", 1.5), ("B", "E0", 4.0), ("A", "E1", 3.0), ("B", "E1", 2.0), ("A", "E2", 9.0))
    told = advice_sentence(table, None, ["E1", "E0"])
    assert told == "To see more, measure next: A: 3 times the score of E1; B: 4 times the score of E0."


def test_what_is_not_worthwhile_is_not_advised():
    table = table_of(("A", "E0", WORTHWHILE - 0.01), ("A", "E1", WORTHWHILE), ("A", "E2", math.nan))
    assert (
        advice_sentence(table, None, ["E0", "E1", "E2"]) == "To see more, measure next: A: 1.2 times the score of E1."
    )
    assert advice_sentence(table, None, ["E0", "E2"]) == ""
    assert advice_sentence(table, None, []) == ""
    assert advice_sentence(table.head(0), ("E0", "E1"), ["E0"]) == ""


def test_no_more_than_three_are_told():
    table = table_of(*[("A", f"E{k}", 5.0) for k in range(6)])
    assert advice_sentence(table, None, [f"E{k}" for k in range(6)]).count("times the score") == 3


VERIFIES = " A withheld mode that is used no longer verifies the result."


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
    assert new == "To see more, measure next: A: 5 times the score of E0."


def test_so_it_is_where_a_pair_is_told_apart():
    p = apart()
    held = replace(p.options[1], name=f"mode 4BT{WITHHELD}", kind="mode")
    told = advice_sentence(advise(replace(p, options=(TWICE, held)), [1.0] * M, ("E0", "E1")), ("E0", "E1"), [])
    assert told.startswith(f"To tell them apart, measure next: {held.name}: odds of ") and told.endswith(VERIFIES)
    assert " (new: twice the repeats: odds of 1:1 between E0 and E1)." in told


def test_withheld_modes_are_known_by_the_end_of_their_name():
    assert _mode_in_words(10.1, {"4BT": 10.0}) == f"mode 4BT{WITHHELD}"
    assert WITHHELD not in _mode_in_words(20.0, {"4BT": 10.0})
