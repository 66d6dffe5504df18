"""The words of each verdict, one by one."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.missing.local import interval_words, local_perturbation, range_words
from calib.missing.partial import is_simpler_form, magnitude_range
from calib.missing.place import beyond_places
from calib.missing.tables import effects_table
from calib.missing.verdict import verdict_of as verdict_of
from calib.missing.verdict_words import look_for, look_for_one_of
from calib.missing.words_by_verdict import MOST
from tests.missing.verdict_cases import VERDICTS, WORST, dressed, errors, first, sized, text_of, with_p

pytestmark = pytest.mark.usefixtures("fewer_samples")


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
    assert "The model assumes: No E2." in text and "Look for a broken E2." in text
    assert text.count("a lack of") == 1
    after = found.chosen_adequacy
    assert f"(p = {after.p_family:.2g})" in text and "which is poor" not in text
    assert f"p = {after.p_fit:.2g} ({found.alpha:g} or less would be poor)." in text


@pytest.mark.parametrize(
    ("text", "request_of"),
    [
        ("A brake unit: knock on it.", "Look for a brake unit: knock on it."),
        ("FRF peaks that split", "Look for FRF peaks that split."),
        ("E2 modulus of the skin.", "Look for E2 modulus of the skin."),
        ("Whether the brakes are released.", "Check whether the brakes are released."),
        ("Where the gear case sits.", "Check where the gear case sits."),
        ("How it was measured.", "Check how it was measured."),
        ("Look at 4.5 m.", "Look at 4.5 m."),
        ("Measure where it sits.", "Measure where it sits."),
    ],
)
def test_what_to_look_for_is_one_sentence_without_a_colon_of_its_own(cases, text, request_of):
    (e,) = cases["effect"].chosen.effects
    assert look_for((replace(e, look_for=text),)) == request_of
    lower = request_of[0].lower() + request_of[1:]
    assert look_for_one_of((e, replace(e, look_for=text))) == f"Look for a broken E2. Or {lower}"


KINDS = "frequencies, damping and mode shapes, corrected for their number"


def test_a_poor_fit_of_a_named_effect_is_stated(cases):
    found = cases["effect"]
    poor = replace(found, chosen_adequacy=replace(found.chosen_adequacy, p_fit=0.004))
    text, family = text_of(poor), f"p = {found.chosen_adequacy.p_family:.2g}"
    assert f"{WORST} has p = 0.004, which is poor" in text
    short = "With it no further cause or place stands out"
    assert (
        f"{short} ({family}), but what remains is more than noise (p = 0.004 for the worst of {KINDS}; "
        "limit 0.01)." in text
    )
    good = f"(p = {found.chosen_adequacy.p_fit:.2g} for the worst of {KINDS}; limit 0.01)"
    assert f"{short} ({family}), and what remains may be noise {good}." in text_of(found)


def test_data_that_can_show_no_effect_are_said_to(cases):
    found = cases["nothing_detectable"]
    blind = {(f"E{k}", "visible"): False for k in range(5)}
    assert "cannot show any listed" in text_of(found, change=blind)
    assert "cannot show any listed" not in text_of(found, change=blind | {("E3", "visible"): True})


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
    assert found.equally_good == ("E2", "A5") and "a lack of E2, " in text and "lack of E3" not in text
    assert f"a measurement error: {local_perturbation(found.fault).in_words}" in text
    bayes_factor = math.exp(abs(found.chosen.ln_evidence - found.fault.ln_evidence))
    assert f"The odds of the first against the second are {bayes_factor:.2g}:1." in text and 1 <= bayes_factor < 20.1
    assert "Look for a broken E2. Or check how A5 was measured." in text


def test_two_effects_are_named_with_both_magnitudes_and_places(cases):
    found = cases["two_effects"]
    text = text_of(found)
    for name, unit in (("E0", " kg"), ("E3", "")):
        k = found.chosen.fit.names.index(name)
        std = math.sqrt(found.chosen.fit.covariance[k, k])
        value, own = found.chosen.fit.values[name], next(e.magnitude for e in found.chosen.effects if e.name == name)
        ends = (max(value - 1.96 * std, own.lower), min(value + 1.96 * std, own.upper))
        assert f"a lack of {name}, {interval_words(value, *ends, unit.strip() or '-')}" in text
        assert f"Look for a broken {name}." in text


def test_a_partial_explanation_is_stated_as_such(cases):
    found = cases["partial"]
    text = text_of(found)
    (name,) = found.chosen.names
    assert f"a lack of {name}, about " in text
    before, after = found.base.fit.misfit, found.chosen.fit.misfit
    assert f"lowers the sum of squares from {before:.0f} to {after:.0f}" in text and after < before
    left = f"With it something is left ({with_p(found.chosen_adequacy.p_family)} for the largest score)."
    assert left in text and found.chosen_adequacy.p_family <= 0.01
    assert "Look for" not in text
    assert re.search(r"a lack of \w+, about [^(]+, is a part of it", text), "its interval would hold only if it were it"


def test_a_magnitude_that_its_plausible_size_draws_down_is_told_so(cases):
    found = cases["partial"]
    (e,), value = found.chosen.effects, found.chosen.fit.values[found.chosen.names[0]]

    def text(times):
        sized = replace(e, magnitude=replace(e.magnitude, prior_sd=value / times))
        return text_of(replace(found, chosen=replace(found.chosen, effects=(sized,))))

    assert "Its magnitude is 10 times its plausible size, which draws it down." in text(9.9)
    assert "plausible size" not in text(2.0)


def test_a_partial_explanation_far_beyond_every_place_points_where_it_acts(cases):
    found = cases["partial"]
    assert found.perturbation is not None
    ahead = replace(found.chosen, ln_evidence=found.perturbation.ln_evidence + 3.1)
    beyond = replace(found, chosen=ahead, place=None)
    assert beyond_places(beyond) and "Look first where it acts." in text_of(beyond)
    near = replace(found, chosen=replace(ahead, ln_evidence=ahead.ln_evidence - 0.2))
    assert not beyond_places(near) and "where it acts" not in text_of(near)


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


@pytest.mark.medium
def test_something_like_an_effect_is_told_with_a_range(nearly):
    assert nearly.chosen.names == ("E1",) and is_simpler_form(nearly)
    text = text_of(nearly)
    assert text.startswith("The model lacks something like a lack of E1, but not exactly that; ")
    low, high = magnitude_range(nearly)
    value, std = nearly.chosen.magnitude("E1")
    assert low <= value - 1.9 * std and high >= value + 1.9 * std
    assert range_words(low, high, nearly.chosen.effects[0].magnitude.unit) in text and "Look for a broken E1." in text
    assert not nearly.names_something and not nearly.credible


def test_an_effect_is_not_nearly_the_cause_where_much_is_left_or_something_else_is_close(cases, nearly):
    assert (
        not is_simpler_form(cases["partial"])
        and not is_simpler_form(cases["effect"])
        and not is_simpler_form(cases["none_explains"])
    )
    base, best = nearly.base, nearly.chosen
    close = base.ln_evidence + 0.6 * (best.ln_evidence - base.ln_evidence)
    rival = replace(nearly.perturbation, ln_evidence=close)
    assert is_simpler_form(replace(nearly, perturbation=rival))  # which leaves far more
    rival = replace(rival, fit=replace(rival.fit, residual=2 * best.fit.residual))
    assert best.fit.misfit < rival.fit.misfit < 5 * best.fit.misfit
    assert not is_simpler_form(replace(nearly, perturbation=rival))
    left = replace(nearly.chosen_adequacy.perturbations, z=nearly.chosen_adequacy.perturbations.z * 100)
    assert not is_simpler_form(replace(nearly, chosen_adequacy=replace(nearly.chosen_adequacy, perturbations=left)))


def test_an_unexplained_misfit_is_stated_with_the_place_to_look_at(cases):
    found = cases["none_explains"]
    text = text_of(found)
    change = local_perturbation(found.perturbation)
    assert change.effect.name == "A7" and change.low < change.value < change.high
    size = f"A7, {interval_words(change.value, change.low, change.high, change.effect.magnitude.unit)}"
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


@pytest.mark.medium
def test_a_larger_standard_deviation_behind_a_named_effect_is_stated(toy):
    found = first(dressed(toy(modes=12, sensors=60, size=20.0)), {"E2": 1.0}, "effect", 2.0)
    assert f"The standard deviation was taken {found.noise_scale:.2g} times as large as stated." in text_of(found)
