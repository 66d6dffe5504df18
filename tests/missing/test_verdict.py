"""The verdict in words: it is complete, and every number is that of the tables."""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.explain import explain
from calib.missing.local import interval_words, local_perturbation, range_words
from calib.missing.nearly import is_nearly, spread_of
from calib.missing.recommendation import Recommendation
from calib.missing.suspect import sentence
from calib.missing.tables import effects_table
from calib.missing.verdict import MOST
from calib.missing.verdict import verdict as verdict_of

pytestmark = pytest.mark.usefixtures("fewer_samples")

WORST = "the worst kind of data or mode shape"
UNITS = {"E0": "kg", "E1": "-", "E2": "kN/m", "E3": "-", "E4": "kg"}
VERDICTS = (
    "nothing_detectable", "effect", "indistinguishable", "two_effects", "several_effects", "partial",
    "none_explains",    "noise_underestimated",
)  # fmt: skip


def dressed(toy):
    """Effects as an engineer would call them, with units."""
    effects = tuple(
        replace(
            e, title=f"Title of {e.name}", phrase=f"a lack of {e.name}",
            lacks=f"No {e.name}.", look_for=f"Look at {e.name}.",
            magnitude=replace(e.magnitude, unit=UNITS.get(e.name, "kg")),
        )
        for e in toy.effects
    )  # fmt: skip
    return replace(toy, effects=effects)


def first(toy, truth, verdict, noise=1.0, seed=1):
    """The first simulated data set with a given verdict."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        found = explain(toy.drawn(rng, truth, noise))
        if found.verdict == verdict:
            return found
    raise AssertionError(f"no draw is {verdict}")


@pytest.fixture(scope="module")
def cases(toy):
    """Explanations of every verdict."""
    plain = dressed(toy(effects=5))
    partly = toy(effects=3, perturbations=6)
    hidden = 0.25 * sum(partly.columns[f"A{k}"] for k in range(6))
    partly = dressed(replace(partly, columns={**partly.columns, "hidden": hidden}))
    return {
        "nothing_detectable": first(plain, {}, "nothing_detectable"),
        "effect": first(plain, {"E2": 1.5}, "effect"),
        "indistinguishable": first(plain.correlated("E3", "E2", 0.9), {"E2": 0.9}, "indistinguishable"),
        "two_effects": first(plain, {"E0": 1.2, "E3": 1.2}, "two_effects"),
        "several_effects": first(plain, {"E0": 1.2, "E3": 1.2, "E4": 1.5}, "several_effects"),
        "partial": first(partly, {"E1": 3.0, "hidden": 2.0}, "partial"),
        "none_explains": first(plain, {"A7": 1.5}, "none_explains"),
        "noise_underestimated": first(dressed(toy(modes=12, sensors=60)), {}, "noise_underestimated", 2.0),
    }


def errors(**more):
    rows = [
        ("fit", 1.4, 0.7, 0.97),
        ("left_out", 3.28, 1.16, 1.19),
        ("held_out_sensors", 1.93, 0.89, 1.04),
        ("held_out_modes", 0.97, 0.94, 1.0),
    ]
    table = [
        (g, stage, value, floor, 0.5)
        for g, b, a, floor in rows
        for stage, value in (("before", b), ("after", more.get(g, a)))
    ]
    return pd.DataFrame(table, columns=["group", "stage", "rms", "expected", "p"])


def text_of(found, intervals=None, recommendation="", some_errors=None, change=None):
    table = effects_table(found, intervals or {}, {})
    for (name, column), value in (change or {}).items():
        table.loc[table["name"] == name, column] = value
    advised = Recommendation(recommendation) if recommendation else None
    return " ".join(verdict_of(found, table, errors() if some_errors is None else some_errors, advised).sentences)


def sized(row):
    """An effect of the table with its magnitude."""
    interval = (row["magnitude_low"], row["magnitude_high"], row["unit"])
    return f"a lack of {row['name']}, {interval_words(row['magnitude'], *interval)}"


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


def with_p(p):
    return f"p {chance(p)}" if p < 1 / 4000 else f"p = {chance(p)}"


def chance(p):
    return "< 0.0004" if p < 3 / 8000 else f"{p:.2g}"


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
    counts = f"{len(found.groups)} effects and {len(set(adequacy.perturbations.owners))} local perturbations"
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
    warned = "outside the library" in text_of(cases[verdict])
    assert warned == (verdict in ("effect", "indistinguishable", "two_effects", "several_effects", "partial"))


def test_a_datum_on_which_all_rests_is_stated_with_how_sure(cases):
    found = cases["effect"]
    table = pd.DataFrame({"what": ["frequency of M2", "mode M2"], "explains": [True, True]})
    asked = replace(found, suspects=table.assign(p=1e-9, p_fit_without=0.1))
    words = sentence(asked.suspects, "E2")
    assert "Without frequency of M2" in words and words in text_of(asked) and "frequency of M2" not in text_of(found)
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
    assert "model_probability" not in text and "held-out sensors" not in text and "nan" not in text


@pytest.mark.parametrize(("after", "p", "worse"), [(1.05, 0.3, False), (1.05, 1e-4, True), (0.9, 1e-4, False)])
def test_a_larger_error_counts_when_it_is_significant(cases, after, p, worse):
    table = errors(held_out_modes=after)
    table.loc[(table["group"] == "held_out_modes") & (table["stage"] == "after"), "p"] = p
    assert ("held-out modes got worse" in text_of(cases["effect"], some_errors=table)) == worse


# -- one by one --------------------------------------------------------------------------------------------------------


def test_nothing_names_no_effect(cases):
    text = text_of(cases["nothing_detectable"])
    assert "a lack of" not in text and "Look" not in text


def test_one_effect_is_named_with_magnitude_interval_and_where_to_look(cases):
    found = cases["effect"]
    table = effects_table(found, {"E2": (1.25, 1.875)}, {}).set_index("name")
    text = text_of(found, {"E2": (1.25, 1.875)})
    row = table.loc["E2"]
    magnitude = f"about {row['magnitude']:.2f} kN/m (95 %: 1.25 to 1.88)"
    assert text.startswith(f"The model lacks a lack of E2, {magnitude}. ")
    probable = 100 * row["model_probability"]
    assert (f"more than {MOST:g} % probable" if probable > MOST else f"{probable:.0f} % probable") in text
    assert "The model assumes: No E2." in text and "Look for: Look at E2." in text
    assert text.count("a lack of") == 1
    after = found.chosen_adequacy
    assert f"(p = {after.p_family:.2g})" in text and "which is poor" not in text
    assert f"p = {after.p_fit:.2g} ({found.alpha:g} or less would be poor)." in text


def test_a_poor_fit_of_a_named_effect_is_stated(cases):
    found = cases["effect"]
    poor = replace(found, chosen_adequacy=replace(found.chosen_adequacy, p_fit=0.004))
    assert f"{WORST} has p = 0.004, which is poor" in text_of(poor)


def test_data_that_can_show_no_effect_are_said_to(cases):
    found = cases["nothing_detectable"]
    blind = {(f"E{k}", "visible"): False for k in range(5)}
    assert "cannot show any effect" in text_of(found, change=blind)
    assert "cannot show any effect" not in text_of(found, change=blind | {("E3", "visible"): True})


def test_what_was_not_tested_is_not_called_invisible(cases):
    found = cases["nothing_detectable"]
    table = effects_table(found, {}, {}, untested=[g.effect for g in found.groups if g.effect.name == "E1"])
    text = " ".join(verdict_of(found, table, errors().head(0)).sentences)
    assert "Not tested, since the model fails with it: E1." in text and "E1 of any" not in text


def test_a_magnitude_without_a_unit_has_none(toy):
    found = first(dressed(toy(effects=5)), {"E1": 1.5}, "effect")
    row = effects_table(found, {}, {}).set_index("name").loc["E1"]
    text = text_of(found)
    assert f"{sized(row.to_dict() | {'name': 'E1'})}." in text and "(95 %" in text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_answer_tells_what_was_found_how_sure_and_what_to_do(cases, verdict):
    """Also without a recommended measurement, and where no local perturbation was fitted."""
    found = replace(cases[verdict], perturbation=None)
    answer = verdict_of(found, effects_table(found, {}, {}), errors()).answer
    assert all(words.endswith(".") for words in (answer.found, answer.sure, answer.then))


def test_indistinguishable_effects_are_all_named_with_their_bayes_factor(cases):
    found = cases["indistinguishable"]
    table = effects_table(found, {}, {})
    text = text_of(found)
    assert set(found.credible) == {"E2", "E3"}
    best, other = table[table["name"].isin(found.credible)].to_dict("records")
    assert best["ln_bayes"] >= other["ln_bayes"]
    parts = [sized(best), sized(other)]
    assert 0 < text.index(parts[0]) < text.index(parts[1])
    bayes_factor = math.exp(best["ln_bayes"] - other["ln_bayes"])
    assert f"The odds of the first against the second are {bayes_factor:.2g}:1." in text and 1 <= bayes_factor < 20.1


def test_a_measurement_fault_is_stated_beside_the_effect(toy):
    made = dressed(toy(effects=5)).correlated("A5", "E2", 0.999)
    perturbations = tuple(
        replace(a, of_measurement=a.name == "A5", look_for=f"How {a.name} was measured.") for a in made.perturbations
    )
    found = first(replace(made, perturbations=perturbations), {"E2": 1.0}, "indistinguishable")
    text = text_of(found)
    assert found.untold == ("E2", "A5") and "a lack of E2, " in text and "lack of E3" not in text
    assert f"a fault of the measurement: {local_perturbation(found.fault).told}" in text
    bayes_factor = math.exp(abs(found.chosen.ln_evidence - found.fault.ln_evidence))
    assert f"The odds of the first against the second are {bayes_factor:.2g}:1." in text and 1 <= bayes_factor < 20.1
    assert "Look for: Look at E2. Or: How A5 was measured." in text


def test_two_effects_are_named_with_both_magnitudes_and_places(cases):
    found = cases["two_effects"]
    text = text_of(found)
    for name, unit in (("E0", " kg"), ("E3", "")):
        k = found.chosen.fit.names.index(name)
        std = math.sqrt(found.chosen.fit.covariance[k, k])
        value, own = found.chosen.fit.values[name], next(e.magnitude for e in found.chosen.effects if e.name == name)
        ends = (max(value - 1.96 * std, own.lower), min(value + 1.96 * std, own.upper))
        assert f"a lack of {name}, {interval_words(value, *ends, unit.strip() or '-')}" in text
        assert f"Look at {name}." in text


def test_a_partial_explanation_is_stated_as_such(cases):
    found = cases["partial"]
    text = text_of(found)
    (name,) = found.chosen.names
    assert f"a lack of {name}, about " in text
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    assert f"lowers the sum of squares from {before:.0f} to {after:.0f}" in text and after < before
    assert f"leaves {with_p(found.chosen_adequacy.p_family)}" in text and found.chosen_adequacy.p_family <= 0.01
    assert "Look for" not in text


@pytest.fixture(scope="module")
def nearly(toy):
    """An effect whose real form differs a little from the listed one, where no other effect or perturbation acts."""
    listed = toy(effects=3, perturbations=6)
    rng = np.random.default_rng(3)
    other = rng.standard_normal(len(listed.columns["E1"]))
    column = listed.columns["E1"]
    form = column + 0.12 * np.linalg.norm(column) / np.linalg.norm(other) * other
    other_place = {"A2": other / np.linalg.norm(other) * np.linalg.norm(listed.columns["A2"])}
    real = dressed(replace(listed, columns={**listed.columns, **other_place, "hidden": form}))
    return first(real, {"hidden": 12.0}, "partial")


def test_something_like_an_effect_is_told_with_a_range(nearly):
    assert nearly.chosen.names == ("E1",) and is_nearly(nearly)
    text = text_of(nearly)
    assert text.startswith("The model lacks something like a lack of E1, but not exactly that; ")
    low, high = spread_of(nearly)
    value, std = nearly.chosen.magnitude("E1")
    assert low <= value - 1.9 * std and high >= value + 1.9 * std
    assert range_words(low, high, nearly.chosen.effects[0].magnitude.unit) in text and "Look for: Look at E1." in text
    assert not nearly.names_something and not nearly.credible


def test_an_effect_is_not_nearly_the_cause_where_much_is_left_or_something_else_is_close(cases, nearly):
    assert not is_nearly(cases["partial"]) and not is_nearly(cases["effect"]) and not is_nearly(cases["none_explains"])
    base, best = nearly.base, nearly.chosen
    close = base.ln_evidence + 0.6 * (best.ln_evidence - base.ln_evidence)
    rival = replace(nearly.perturbation, ln_evidence=close)
    assert is_nearly(replace(nearly, perturbation=rival))  # which leaves far more
    rival = replace(rival, fit=replace(rival.fit, residual=2 * best.fit.residual))
    assert best.fit.misfit < rival.fit.misfit < 5 * best.fit.misfit
    assert not is_nearly(replace(nearly, perturbation=rival))
    left = replace(nearly.chosen_adequacy.perturbations, z=nearly.chosen_adequacy.perturbations.z * 100)
    assert not is_nearly(replace(nearly, chosen_adequacy=replace(nearly.chosen_adequacy, perturbations=left)))


def test_an_unexplained_misfit_is_stated_with_the_place_to_look_at(cases):
    found = cases["none_explains"]
    text = text_of(found)
    change = local_perturbation(found.perturbation)
    assert change.effect.name == "A7" and change.low < change.value < change.high
    size = f"A7, about {change.value:.2g} [{change.low:.2g}, {change.high:.2g}]"
    assert f"{size}; it fits better than every listed effect" in text
    assert "is not believed" in text and "Look for" not in text


def test_the_reason_against_the_best_attempt_is_stated(cases):
    found = cases["none_explains"]
    left = min(found.chosen_adequacy.p_family, found.chosen_adequacy.p_fit)
    assert left <= 0.01 and f"is not believed: what is left still has {with_p(left)}." in text_of(found)
    pulled = replace(found, chosen=replace(found.chosen, implausible="P1 has a pull of +5.0 (limit 3.3)"))
    assert "is not believed: P1 has a pull of +5.0 (limit 3.3)." in text_of(pulled)
    kinds = found.chosen_adequacy.kinds
    assert (found.refused, pulled.refused) == ("misfit", "implausible")
    few = replace(
        found.chosen_adequacy, p_named=1.0, p_perturbations=1.0, p_fit=1.0, kinds=kinds.assign(dof=1.4 / len(kinds))
    )
    assert "it leaves 1.4 effective degrees of freedom" in text_of(replace(found, chosen_adequacy=few))
    for p in (1.0, 1e-9):  # below two degrees of freedom the misfit is not the reason
        assert replace(found, chosen_adequacy=replace(few, p_fit=p)).refused == "dof"


def test_a_best_attempt_without_misfit_is_refused_for_its_evidence(toy):
    """It only has less evidence than a local perturbation."""
    made = dressed(toy().correlated("A5", "E2", 0.9))
    for seed in range(1, 30):
        found = first(made, {"A5": 0.9}, "none_explains", seed=seed)
        if found.chosen_adequacy.passes(0.01) and not found.chosen.implausible:
            break
    assert found.chosen_adequacy.passes(0.01) and not found.chosen.implausible
    text = text_of(found)
    assert ": A5, about " in text and "fits better than every listed effect" in text
    assert "still has p" not in text


def test_an_understated_standard_deviation_is_stated_with_its_factor(cases):
    found = cases["noise_underestimated"]
    text = text_of(found)
    assert f"the residuals of all modes are {found.noise_scale:.2g} times too large" in text
    assert found.noise_scale == pytest.approx(2.0, rel=0.1) and "a lack of" not in text


def test_a_larger_standard_deviation_behind_a_named_effect_is_stated(toy):
    found = first(dressed(toy(modes=12, sensors=60, size=20.0)), {"E2": 1.0}, "effect", 2.0)
    assert f"The standard deviation was taken {found.noise_scale:.2g} times as large as stated." in text_of(found)


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
    assert f"Look at {first_of}. Or: Look at {second_of}." in text


def test_a_collinear_effect_that_was_not_fitted_is_named_too(toy):
    merged = dressed(toy(effects=5).correlated("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5}, "indistinguishable")
    one, other = (t.names[0] for t in found.singles[:2])
    alone = replace(found, candidate_fits=tuple(t for t in found.candidate_fits if t.names != (other,)))
    assert f"or a lack of {other}, with the signature of {one}." in text_of(alone)


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
        "held-out sensors 1.93 -> 0.89 (noise floor 1.04), held-out modes 0.97 -> 0.94 (noise floor 1.00)." in text
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
