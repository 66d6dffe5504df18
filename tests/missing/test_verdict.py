"""The verdict in words: what an engineer needs is in it, and every number is that of the tables."""

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.explain import explain
from calib.missing.local import local_change
from calib.missing.tables import effects_table
from calib.missing.verdict import sentences

UNITS = {"E0": "kg", "E1": "-", "E2": "kN/m", "E3": "-", "E4": "kg"}
VERDICTS = (
    "nothing_detectable", "effect", "indistinguishable", "two_effects", "partial", "none_explains",
    "noise_underestimated",
)  # fmt: skip


def dressed(toy):
    """Effects as an engineer would call them, with units."""
    effects = tuple(
        replace(
            e, title=f"Title of {e.name}", lacks=f"No {e.name}.", look_for=f"Look at {e.name}.",
            strength=replace(e.strength, unit=UNITS.get(e.name, "kg")),
        )
        for e in toy.effects
    )  # fmt: skip
    return replace(toy, effects=effects)


def first(toy, truth, verdict, noise=1.0, seed=1):
    """The first draw with a verdict."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        found = explain(toy.drawn(rng, truth, noise))
        if found.verdict == verdict:
            return found
    raise AssertionError(f"no draw is {verdict}")


@pytest.fixture(scope="module")
def cases(toy):
    """Findings of every verdict."""
    plain = dressed(toy(effects=5))
    partly = toy(effects=3, atoms=6)
    hidden = 0.25 * sum(partly.columns[f"A{k}"] for k in range(6))
    partly = dressed(replace(partly, columns={**partly.columns, "hidden": hidden}))
    return {
        "nothing_detectable": first(plain, {}, "nothing_detectable"),
        "effect": first(plain, {"E2": 1.5}, "effect"),
        "indistinguishable": first(plain.alike("E3", "E2", 0.9), {"E2": 0.9}, "indistinguishable"),
        "two_effects": first(plain, {"E0": 1.2, "E3": 1.2}, "two_effects"),
        "partial": first(partly, {"E1": 3.0, "hidden": 2.0}, "partial"),
        "none_explains": first(plain, {"A7": 1.5}, "none_explains"),
        "noise_underestimated": first(dressed(toy(modes=12, sensors=60)), {}, "noise_underestimated", 2.0),
    }


def errors(**more):
    rows = [
        ("fit", 1.4, 0.7, 0.97),
        ("left_out", 3.28, 1.16, 1.19),
        ("withheld_sensors", 1.93, 0.89, 1.04),
        ("withheld_modes", 0.97, 0.94, 1.0),
    ]
    table = [
        (g, stage, value, floor, 0.5)
        for g, b, a, floor in rows
        for stage, value in (("before", b), ("after", more.get(g, a)))
    ]
    return pd.DataFrame(table, columns=["group", "stage", "rms", "expected", "p"])


def told(found, intervals=None, advice="", some_errors=None, change=None):
    table = effects_table(found, intervals or {}, {})
    for (name, column), value in (change or {}).items():
        table.loc[table["name"] == name, column] = value
    return " ".join(sentences(found, table, errors() if some_errors is None else some_errors, advice))


# -- all verdicts ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_a_text_of_whole_sentences(cases, verdict):
    text = told(cases[verdict], advice="To see more, measure next: mode 9.")
    assert text[0].isupper() and text.endswith(".") and "\n" not in text
    assert "nan" not in text.lower() and "None" not in text and "inf " not in text
    assert "..." not in text and ".." not in text


@pytest.mark.parametrize("verdict", VERDICTS)
def test_no_verdict_tells_a_coefficient_of_determination_or_a_p_of_one_test_among_many(cases, verdict):
    found = cases[verdict]
    text = told(found)
    assert "R2" not in text and "R^2" not in text and "significan" not in text
    allowed = {chance(found.base_check.p_family), chance(found.base_check.p_fit)}
    if found.chosen_check is not None:
        after = found.chosen_check
        allowed |= {chance(after.p_family), chance(after.p_fit)}
    for p in re.findall(r"p = (< 0\.0003|[0-9.e+-]*[0-9])", text):
        assert p in allowed


def with_p(p):
    return f"p {chance(p)}" if p < 1 / 4000 else f"p = {chance(p)}"


def chance(p):
    return "< 0.0003" if p < 1 / 4000 else f"{p:.2g}"


@pytest.mark.parametrize("verdict", VERDICTS)
def test_units_are_told_and_a_missing_unit_is_left_out(cases, verdict):
    found = cases[verdict]
    text = told(
        found,
        change={("E1", "visible"): False, ("E2", "visible"): False, ("E1", "phi_min"): 0.123, ("E2", "phi_min"): 0.456},
    )
    assert " -," not in text and " -." not in text and " - " not in text and " -)" not in text
    chosen = found.chosen.names if verdict in ("effect", "indistinguishable", "two_effects") else ()
    assert ("E1 below 0.12" in text) == ("E1" not in chosen) and "E1 below 0.12 -" not in text
    assert ("E2 below 0.46 kN/m" in text) == ("E2" not in chosen)  # what was found can be seen


@pytest.mark.parametrize("verdict", [v for v in VERDICTS if v not in ("noise_underestimated",)])
def test_the_chance_is_that_of_the_family_and_of_the_fit(cases, verdict):
    found = cases[verdict]
    check = found.base_check
    counts = f"{len(found.groups)} effects and {len(set(check.atoms.owners))} local changes"
    other = replace(found, base_check=replace(check, p_named=0.002, p_atoms=1.0, p_fit=0.03))
    assert f"is 0.004 (family-wise over {counts}) and of such a misfit as a whole 0.03" in told(other)


def test_a_chance_is_told_down_to_what_draws_can_tell(cases):
    found = cases["nothing_detectable"]

    def with_p(p):
        return told(replace(found, base_check=replace(found.base_check, p_named=1.0, p_atoms=1.0, p_fit=p)))

    assert "as a whole 0.23." in with_p(0.2345) and "as a whole < 0.0003." in with_p(1e-30)
    assert "as a whole 0.001." in with_p(0.001)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_advice_ends_what_can_be_acted_on(cases, verdict):
    advice = "To see more, measure next: mode 9."
    assert (advice in told(cases[verdict], advice=advice)) == (verdict != "noise_underestimated")


@pytest.mark.parametrize("verdict", VERDICTS)
def test_only_a_name_brings_the_warning_about_the_library(cases, verdict):
    warned = "Explanations outside the library cannot be excluded." in told(cases[verdict])
    assert warned == (verdict in ("effect", "indistinguishable", "two_effects", "partial"))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_errors_are_told_where_something_is_named(cases, verdict):
    text = told(cases[verdict])
    assert ("Error in units of the scatter" in text) == (verdict in ("effect", "indistinguishable", "two_effects"))


def test_what_withheld_data_contradict_is_told_with_their_error(cases):
    found = cases["effect"].unconfirmed()
    table = errors()
    after = table["stage"] == "after"
    table.loc[after & (table["group"] == "withheld_modes"), ["rms", "p"]] = (4.567, 1e-5)
    table.loc[after, "stage"] = "attempt"
    text = told(found, some_errors=table)
    assert "Title of E2 (E2)" in text and "0.97 -> 4.57 (noise floor 1.00, p < 0.0003)" in text
    assert "posterior" not in text and "withheld sensors" not in text and "nan" not in text


@pytest.mark.parametrize(("after", "p", "worse"), [(1.05, 0.3, False), (1.05, 1e-4, True), (0.9, 1e-4, False)])
def test_a_larger_error_counts_where_it_is_no_chance(cases, after, p, worse):
    table = errors(withheld_modes=after)
    table.loc[(table["group"] == "withheld_modes") & (table["stage"] == "after"), "p"] = p
    assert ("withheld modes got worse" in told(cases["effect"], some_errors=table)) == worse


# -- one by one --------------------------------------------------------------------------------------------------------


def test_nothing_names_no_effect(cases):
    text = told(cases["nothing_detectable"])
    assert text.startswith("Nothing detectable is missing: with the model complete the chance of such scores is ")
    assert "Title" not in text and "Look" not in text


def test_one_effect_is_named_with_strength_interval_and_where_to_look(cases):
    found = cases["effect"]
    table = effects_table(found, {"E2": (1.25, 1.875)}, {}).set_index("name")
    text = told(found, {"E2": (1.25, 1.875)})
    row = table.loc["E2"]
    assert text.startswith("Something is missing: ")
    strength = f"{row['phi']:.3g} kN/m (95 %: 1.25 to 1.88 kN/m)"
    assert f"Best explanation: Title of E2 (E2), {strength}; posterior {100 * row['posterior']:.0f} % within" in text
    assert "As it is, the model says: No E2. Look for: Look at E2." in text and text.count("Title") == 1
    after = found.chosen_check
    assert f"no effect or local change stands out (p = {after.p_family:.2g}); the fit as a whole has p = " in text
    assert f"p = {after.p_fit:.2g}." in text and "poor" not in text


def test_a_poor_fit_behind_a_name_is_told(cases):
    found = cases["effect"]
    poor = replace(found, chosen_check=replace(found.chosen_check, p_fit=0.004))
    assert "the fit as a whole has p = 0.004, which is poor: the scatter may be larger than stated" in told(poor)


def test_data_that_show_no_effect_at_all_can_tell_nothing(cases):
    found = cases["nothing_detectable"]
    blind = {(f"E{k}", "visible"): False for k in range(5)}
    assert told(found, change=blind).startswith(
        "Nothing can be told: no effect of the library would show in these data"
    )
    assert told(found, change=blind | {("E3", "visible"): True}).startswith("Nothing detectable is missing: ")


def test_what_was_not_tested_is_not_called_invisible(cases):
    found = cases["nothing_detectable"]
    table = effects_table(found, {}, {}, untested=[g.effect for g in found.groups if g.effect.name == "E1"])
    text = " ".join(sentences(found, table, errors().head(0), ""))
    assert "Not tested, since the model fails with it: E1." in text and "E1 of any" not in text


def test_a_strength_without_a_unit_has_none(toy):
    found = first(dressed(toy(effects=5)), {"E1": 1.5}, "effect")
    row = effects_table(found, {}, {}).set_index("name").loc["E1"]
    text = told(found)
    assert f"(E1), {row['phi']:.3g} (95 %: {row['phi_low']:.3g} to {row['phi_high']:.3g});" in text


def test_those_that_cannot_be_told_apart_are_all_told_with_their_odds(cases):
    found = cases["indistinguishable"]
    table = effects_table(found, {}, {})
    text = told(found)
    assert set(found.credible) == {"E2", "E3"}
    best, other = table[table["name"].isin(found.credible)].to_dict("records")
    assert best["ln_bayes"] >= other["ln_bayes"]
    parts = [
        f"Title of {r['name']} ({r['name']}), {r['phi']:.3g}{' kN/m' if r['name'] == 'E2' else ''} (95 %"
        for r in (best, other)
    ]
    assert 0 < text.index(parts[0]) < text.index(parts[1])
    odds = math.exp(best["ln_bayes"] - other["ln_bayes"])
    assert f"The odds of the first against the second are {odds:.2g}:1." in text and 1 <= odds < 20.1


def test_a_fault_of_the_measurement_is_told_beside_the_effect(toy):
    made = dressed(toy(effects=5)).alike("A5", "E2", 0.999)
    atoms = tuple(replace(a, of_measurement=a.name == "A5", look_for=f"How {a.name} was measured.") for a in made.atoms)
    found = first(replace(made, atoms=atoms), {"E2": 1.0}, "indistinguishable")
    text = told(found)
    assert found.untold == ("E2", "A5") and "(E2), " in text and "E3 (" not in text
    assert f"a fault of the measurement: {local_change(found.fault).told}" in text
    odds = math.exp(abs(found.chosen.ln_evidence - found.fault.ln_evidence))
    assert f"The odds of the first against the second are {odds:.2g}:1." in text and 1 <= odds < 20.1
    assert "Look for: Look at E2. Or: How A5 was measured." in text


def test_two_effects_are_told_with_both_strengths_and_places(cases):
    found = cases["two_effects"]
    text = told(found)
    assert text.startswith("Two effects are missing: ") and "no single effect" in text
    for name, unit in (("E0", " kg"), ("E3", "")):
        k = found.chosen.state.names.index(name)
        std = math.sqrt(found.chosen.state.covariance[k, k])
        assert (
            f"Title of {name} ({name}), {found.chosen.state.values[name]:.3g} +- {1.96 * std:.2g}{unit} (95 %)" in text
        )
        assert f"Look at {name}." in text
    assert "After adding both no effect or local change stands out" in text


def test_half_an_answer_is_told_as_such(cases):
    found = cases["partial"]
    text = told(found)
    (name,) = found.chosen.names
    assert text.startswith("Organised misfit that no listed effect removes: ")
    assert f"Title of {name} ({name})" in text
    before, after = found.base.state.misfit, found.chosen.state.misfit
    assert f"lowers the sum of squares from {before:.0f} to {after:.0f}" in text and after < before
    assert f"leaves {with_p(found.chosen_check.p_family)}" in text and found.chosen_check.p_family <= 0.01
    assert "Look for" not in text


def test_what_nothing_explains_is_told_with_the_place_to_look_at(cases):
    found = cases["none_explains"]
    text = told(found)
    assert text.startswith("Organised misfit that no listed effect explains: ")
    change = local_change(found.atom)
    assert change.effect.name == "A7" and change.low < change.value < change.high
    size = f"A7, about {change.value:.2g} [{change.low:.2g}, {change.high:.2g}]"
    assert f"{size}, fits better than every listed effect; that is a place to look at" in text
    assert "is not believed" in text and "Look for" not in text and "95 %" not in text


def test_the_reason_against_the_best_attempt_is_told(cases):
    found = cases["none_explains"]
    left = min(found.chosen_check.p_family, found.chosen_check.p_fit)
    assert left <= 0.01 and f"is not believed: what is left still has {with_p(left)}." in told(found)
    strained = replace(found, chosen=replace(found.chosen, implausible="P1 had to move +5.0 prior standard deviations"))
    assert "is not believed: P1 had to move +5.0 prior standard deviations." in told(strained)
    kinds = found.chosen_check.kinds
    assert (found.refused, strained.refused) == ("misfit", "implausible")
    few = replace(found.chosen_check, p_named=1.0, p_atoms=1.0, p_fit=1.0, kinds=kinds.assign(freedom=1.4 / len(kinds)))
    assert "it leaves 1.4 effective degrees of freedom" in told(replace(found, chosen_check=few))
    for p in (1.0, 1e-9):  # below two degrees of freedom what is left is no reason
        assert replace(found, chosen_check=replace(few, p_fit=p)).refused == "freedom"


def test_a_best_attempt_that_leaves_nothing_is_not_said_to_leave_something(toy):
    """It only has less evidence than a local change."""
    made = dressed(toy().alike("A5", "E2", 0.9))
    for seed in range(1, 30):
        found = first(made, {"A5": 0.9}, "none_explains", seed=seed)
        if found.chosen_check.passes(0.01) and not found.chosen.implausible:
            break
    assert found.chosen_check.passes(0.01) and not found.chosen.implausible
    text = told(found)
    assert "A local change, A5, about " in text and "fits better than every listed effect" in text
    assert "still has p" not in text


def test_a_scatter_stated_too_small_is_told_with_its_factor(cases):
    found = cases["noise_underestimated"]
    text = told(found)
    assert text.startswith(
        f"The misfit is spread over all modes by a common factor of {found.noise_scale:.2g}: check the scatter"
    )
    assert f"With the scatter {found.noise_scale:.2g} times as large nothing detectable is missing." in text
    assert found.noise_scale == pytest.approx(2.0, rel=0.1) and "Title" not in text


def test_a_larger_scatter_behind_a_name_is_told(toy):
    found = first(dressed(toy(modes=12, sensors=60, size=20.0)), {"E2": 1.0}, "effect", 2.0)
    assert f"The scatter was taken {found.noise_scale:.2g} times as large as stated." in told(found)


# -- merged effects, visibility, errors --------------------------------------------------------------------------------


def test_effects_that_look_exactly_the_same_are_named_along(toy):
    merged = dressed(toy(effects=5).alike("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5}, "indistinguishable")
    text = told(found)
    assert set(found.credible) == {"E2", "E4"}
    first_of, second_of = (t.names[0] for t in found.singles[:2])
    odds = math.exp(found.singles[0].ln_evidence - found.singles[1].ln_evidence)
    assert f"The odds of the first against the second are {float(f'{odds:.2g}'):g}:1." in text
    assert "Title of E2 (E2), " in text and "Title of E4 (E4), " in text and "whose fingerprint" not in text
    assert f"Look at {first_of}. Or: Look at {second_of}." in text


def test_one_that_looks_the_same_and_was_not_fitted_is_named_along(toy):
    merged = dressed(toy(effects=5).alike("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5}, "indistinguishable")
    one, other = (t.names[0] for t in found.singles[:2])
    alone = replace(found, trials=tuple(t for t in found.trials if t.names != (other,)))
    assert f"or Title of {other} ({other}), whose fingerprint is that of {one}." in told(alone)


def test_merged_effects_are_named_along_in_a_pair(toy):
    merged = dressed(toy(effects=5).alike("E4", "E2", 0.995))
    found = first(merged, {"E2": 1.5, "E0": 1.5}, "two_effects")
    assert set(found.credible) == {"E0", "E2", "E4"}
    named, other = ("E2", "E4") if "E2" in found.chosen.names else ("E4", "E2")
    assert set(found.chosen.names) == {"E0", named}
    assert f"Title of {named} ({named}, or what looks the same here: {other})" in told(found)


def test_what_cannot_be_seen_is_told_with_the_smallest_strength_that_could(cases):
    found = cases["effect"]
    change = {("E0", "visible"): False, ("E0", "phi_min"): 3.456, ("E4", "visible"): False, ("E4", "phi_min"): 51.0}
    text = told(found, change=change)
    assert "Not visible with these data: E0 below 3.5 kg, E4 of any possible strength." in text or (
        "Not visible with these data: E4 of any possible strength, E0 below 3.5 kg." in text
    )
    assert "Not visible" not in told(found, change={(f"E{k}", "visible"): True for k in range(5)})
    hopeless = told(found, change={("E0", "visible"): False, ("E0", "phi_min"): math.inf})
    assert "E0 of any possible strength." in hopeless


def test_errors_are_those_of_the_table_with_the_noise_floor(cases):
    text = told(cases["effect"])
    assert (
        "Error in units of the scatter: data left out in turn 3.28 -> 1.16 (noise floor 1.19), "
        "withheld sensors 1.93 -> 0.89 (noise floor 1.04), withheld modes 0.97 -> 0.94 (noise floor 1.00)." in text
    )
    assert "got worse" not in text
    assert "Error in units" not in told(cases["effect"], some_errors=errors().head(0))
    some = errors()
    some = some[some["group"].isin(["fit", "left_out"])]
    assert "data left out in turn 3.28 -> 1.16 (noise floor 1.19)." in told(cases["effect"], some_errors=some)


def test_no_gap_is_left_where_nothing_is_said(cases):
    assert "  " not in told(replace(cases["partial"], atom=None))
    assert "  " not in told(replace(cases["none_explains"], atom=None))


def test_a_small_chance_is_told_without_an_equals_sign(cases):
    found = replace(cases["partial"], chosen_check=replace(cases["partial"].chosen_check, p_named=1e-9))
    assert "p = <" not in told(found) and "p < 0.0003" in told(found)


def test_a_strength_on_its_limit_is_told_without_the_unit_it_does_not_have(toy):
    made = dressed(toy(effects=1, atoms=3))
    (e,) = made.effects
    e = replace(e, strength=replace(e.strength, unit="-", upper=0.5))
    found = first(replace(made, effects=(e,)), {"E0": 3.0}, "none_explains")
    text = told(found)
    assert "E0 is on its limit of 0.5" in text and "0.5 -" not in text
