"""The verdict in words: it is complete, and every number is that of the tables."""

import math
import re
from dataclasses import replace

import pandas as pd
import pytest

from calib.missing.local import interval_words
from calib.missing.suspect import suspect_in_short, suspect_sentence
from calib.missing.verdict_words import family_in_short
from tests.missing.verdict_cases import VERDICTS, WORST, chance, dressed, errors, first, text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")

# -- all verdicts ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_a_text_of_whole_sentences(cases, verdict):
    text = text_of(cases[verdict], recommendation="To see further effects, measure next: mode 9.")
    assert text[0].isupper() and text.endswith(".") and "\n" not in text
    assert "nan" not in text.lower() and "None" not in text and "inf " not in text
    assert "..." not in text and ".." not in text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_no_verdict_states_a_coefficient_of_determination_or_a_single_p_value(cases, verdict):
    found = cases[verdict]
    text = text_of(found)
    assert "R2" not in text and "R^2" not in text and "significan" not in text
    allowed = {chance(found.base_adequacy.p_family), chance(found.base_adequacy.p_fit)}
    if found.chosen_adequacy is not None:
        after = found.chosen_adequacy
        allowed |= {chance(after.p_family), chance(after.p_fit)}
    for p in re.findall(r"p = (< 0\.0003|[0-9.e+-]*[0-9])", text):
        assert p in allowed


@pytest.mark.parametrize("verdict", VERDICTS)
def test_units_are_stated_and_a_missing_unit_is_left_out(cases, verdict):
    found = cases[verdict]
    text = text_of(
        found,
        change={
            ("E1", "visible"): False,
            ("E2", "visible"): False,
            ("E1", "magnitude_min"): 0.123,
            ("E2", "magnitude_min"): 0.456,
        },
    )
    assert " -," not in text and " -." not in text and " - " not in text and " -)" not in text
    chosen = found.chosen.names if verdict in ("effect", "indistinguishable", "two_effects", "several_effects") else ()
    assert ("E1 below 0.12" in text) == ("E1" not in chosen) and "E1 below 0.12 -" not in text
    assert ("E2 below 0.46 kN/m" in text) == ("E2" not in chosen)  # a chosen effect is visible


@pytest.mark.parametrize("verdict", [v for v in VERDICTS if v not in ("noise_underestimated",)])
def test_the_p_values_are_those_of_the_family_and_of_the_fit(cases, verdict):
    found = cases[verdict]
    adequacy = found.base_adequacy
    counts = (
        f"{len(found.groups)} effects and {len(set(adequacy.perturbations.owners))} local stiffness or mass changes"
    )
    other = replace(found, base_adequacy=replace(adequacy, p_named=0.002, p_perturbations=1.0, p_fit=0.03))
    assert f"p = 0.004 for the largest score of {counts}, p = 0.03 for {WORST}" in text_of(other)


def test_p_values_are_stated_down_to_the_resolution_of_the_samples(cases):
    found = cases["nothing_detectable"]

    def with_p(p):
        return text_of(
            replace(found, base_adequacy=replace(found.base_adequacy, p_named=1.0, p_perturbations=1.0, p_fit=p))
        )

    assert f"p = 0.23 for {WORST}." in with_p(0.2345) and f"p < 0.0004 for {WORST}." in with_p(1e-30)
    assert f"p = 0.001 for {WORST}." in with_p(0.001)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_recommendation_is_stated_where_it_applies(cases, verdict):
    recommendation = "To see further effects, measure next: mode 9."
    assert (recommendation in text_of(cases[verdict], recommendation=recommendation)) == (
        verdict != "noise_underestimated"
    )


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_warning_about_the_library_follows_a_named_effect(cases, verdict):
    warned = "A cause that is not listed" in text_of(cases[verdict])
    assert warned == (verdict in ("effect", "indistinguishable", "two_effects", "several_effects", "partial"))


def test_a_datum_on_which_all_rests_is_stated_with_how_sure(cases):
    found = cases["effect"]
    table = pd.DataFrame({"what": ["frequency of M2", "mode M2"], "explains": [True, True]})
    asked = replace(found, suspects=table.assign(p=1e-9, p_fit_without=0.1), odds_against_datum=5.0)
    words = suspect_sentence(asked.suspects, "E2", 5.0)
    assert "If the frequency of M2 were left out, the model would fit with nothing added" in words and "150:1" in words
    assert words in text_of(asked) and "frequency of M2" not in text_of(found)
    assert suspect_in_short(asked.suspects, 5.0) in text_of(asked)
    assert "frequency of M2" not in text_of(replace(asked, suspects=asked.suspects.assign(explains=False)))


def test_what_an_effect_has_beside_its_magnitude_is_told_with_its_interval(toy):
    found = toy(bump=True).explained({"hung": 1.5, "at": 5.6}, 1, seed=3)[0]
    assert found.verdict == "effect" and found.chosen.names == ("hung",)
    std = math.sqrt(found.chosen.fit.covariance[-1, -1])
    value = found.chosen.fit.values["at"]
    assert f"at: {interval_words(value, value - 1.96 * std, value + 1.96 * std, 'Hz')}." in text_of(found)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_errors_are_stated_where_an_effect_is_named(cases, verdict):
    text = text_of(cases[verdict])
    assert ("Error in standard deviations" in text) == (
        verdict in ("effect", "indistinguishable", "two_effects", "several_effects")
    )


def test_a_contradiction_by_held_out_data_is_stated_with_their_error(cases):
    found = cases["effect"].unconfirmed()
    table = errors()
    after = table["stage"] == "after"
    table.loc[after & (table["group"] == "held_out_modes"), ["rms", "p"]] = (4.567, 1e-5)
    table.loc[after, "stage"] = "attempt"
    text = text_of(found, some_errors=table)
    assert "a lack of E2" in text and "0.97 -> 4.57 (noise floor 1.00, p < 0.0004)" in text
    assert "model_probability" not in text and "validation sensors" not in text and "nan" not in text


@pytest.mark.parametrize(("after", "p", "worse"), [(1.05, 0.3, False), (1.05, 1e-4, True), (0.9, 1e-4, False)])
def test_a_larger_error_counts_when_it_is_significant(cases, after, p, worse):
    table = errors(held_out_modes=after)
    table.loc[(table["group"] == "held_out_modes") & (table["stage"] == "after"), "p"] = p
    assert ("validation modes got worse" in text_of(cases["effect"], some_errors=table)) == worse


# -- merged effects, visibility, errors --------------------------------------------------------------------------------


def test_collinear_effects_are_named_together(toy):
    merged = dressed(toy(effects=5).correlated("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5}, "indistinguishable")
    text = text_of(found)
    assert set(found.credible) == {"E2", "E4"}
    first_of, second_of = (t.names[0] for t in found.singles[:2])
    bayes_factor = math.exp(found.singles[0].ln_evidence - found.singles[1].ln_evidence)
    assert f"The odds of the first against the second are {float(f'{bayes_factor:.2g}'):g}:1." in text
    assert "a lack of E2, " in text and "a lack of E4, " in text and "signature" not in text
    assert f"Look for a broken {first_of}. Or look for a broken {second_of}." in text


def test_a_collinear_effect_that_was_not_fitted_is_named_too(toy):
    merged = dressed(toy(effects=5).correlated("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5}, "indistinguishable")
    one, other = (t.names[0] for t in found.singles[:2])
    alone = replace(found, candidate_fits=tuple(t for t in found.candidate_fits if t.names != (other,)))
    assert f"or a lack of {other}, with the change pattern of {one}." in text_of(alone)


def test_collinear_effects_of_a_pair_are_named_too(toy):
    merged = dressed(toy(effects=5).correlated("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5, "E0": 1.5}, "two_effects")
    assert set(found.credible) == {"E0", "E2", "E4"}
    named, other = ("E2", "E4") if "E2" in found.chosen.names else ("E4", "E2")
    assert set(found.chosen.names) == {"E0", named}
    assert f"Collinear with {named} in these data: {other}." in text_of(found)


def test_invisible_effects_are_stated_with_their_smallest_visible_magnitude(cases):
    found = cases["effect"]
    change = {
        ("E0", "visible"): False,
        ("E0", "magnitude_min"): 3.456,
        ("E4", "visible"): False,
        ("E4", "magnitude_min"): 51.0,
    }
    text = text_of(found, change=change)
    assert "Not visible with these data: E0 below 3.5 kg, E4 of any possible magnitude." in text or (
        "Not visible with these data: E4 of any possible magnitude, E0 below 3.5 kg." in text
    )
    assert "Not visible" not in text_of(found, change={(f"E{k}", "visible"): True for k in range(5)})
    hopeless = text_of(found, change={("E0", "visible"): False, ("E0", "magnitude_min"): math.inf})
    assert "E0 of any possible magnitude." in hopeless


def test_errors_are_those_of_the_table_with_the_noise_floor(cases):
    text = text_of(cases["effect"])
    assert (
        "Error in standard deviations, of the fits behind this answer: "
        "data left out in turn 3.28 -> 1.16 (noise floor 1.19), "
        "validation sensors 1.93 -> 0.89 (noise floor 1.04), validation modes 0.97 -> 0.94 (noise floor 1.00)." in text
    )
    assert "got worse" not in text
    assert "Error in units" not in text_of(cases["effect"], some_errors=errors().head(0))
    some = errors()
    some = some[some["group"].isin(["fit", "left_out"])]
    assert "data left out in turn 3.28 -> 1.16 (noise floor 1.19)." in text_of(cases["effect"], some_errors=some)


def test_empty_sentences_leave_no_gap(cases):
    assert "  " not in text_of(replace(cases["partial"], perturbation=None))
    assert "  " not in text_of(replace(cases["none_explains"], perturbation=None))


def test_a_small_p_value_is_written_without_an_equals_sign(cases):
    found = replace(cases["partial"], chosen_adequacy=replace(cases["partial"].chosen_adequacy, p_named=1e-9))
    assert "p = <" not in text_of(found) and "p < 0.0004" in text_of(found)


def test_a_dimensionless_magnitude_on_its_limit_has_no_unit(toy):
    made = dressed(toy(effects=1, perturbations=3))
    (e,) = made.effects
    e = replace(e, magnitude=replace(e.magnitude, unit="-", upper=0.5))
    found = first(replace(made, effects=(e,)), {"E0": 3.0}, "none_explains")
    text = text_of(found)
    assert "E0 is on its limit of 0.5" in text and "0.5 -" not in text


def test_the_summary_names_the_changes_that_were_tried_and_no_others(cases):
    found = cases["effect"]
    tests = found.base_adequacy
    without = replace(found, groups=(), base_adequacy=replace(tests, faults=None, pairs=None))
    number = len(set(tests.perturbations.owners))
    assert f"(the largest gain of {number} changes tried: stiffness or mass at single places)" in family_in_short(
        without
    )
    listed = family_in_short(replace(found, base_adequacy=replace(tests, faults=None, pairs=None)))
    assert "changes tried: listed causes and stiffness or mass at single places)" in listed
    none = replace(tests, faults=None, pairs=None, perturbations=replace(tests.perturbations, owners=()))
    assert "changes tried" not in family_in_short(replace(without, base_adequacy=none))
