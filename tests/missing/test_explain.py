"""The decision, over toys in which every answer is known."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import EvaluationError, InputError
from calib.missing.explain import Settings, explain
from calib.missing.state import fitted


def like(toy, name, of, share, seed=1):
    """The toy with a column of unchanged length whose direction correlates with another's by a share."""
    other = np.random.default_rng(seed).standard_normal(len(toy.rows))
    one = toy.columns[of]
    other -= one * (one @ other) / (one @ one)
    column = share * one + np.sqrt(1 - share**2) * np.linalg.norm(one) * other / np.linalg.norm(other)
    return replace(toy, columns={**toy.columns, name: column})


def without(toy, *names):
    """The toy whose library lacks some effects although its answers can hold them."""
    return replace(toy, effects=tuple(e for e in toy.effects if e.name not in names))


def verdicts(toy, truth, draws, seed=1, noise=1.0):
    rng = np.random.default_rng(seed)
    return [explain(toy.drawn(rng, truth, noise)) for _ in range(draws)]


def test_nothing_missing_is_seldom_taken_for_something(toy):
    """Two gates at 1 % each; what passes them still has to be named."""
    found = Counter(f.verdict for f in verdicts(toy(effects=8, atoms=20, signed=("E1", "E5")), {}, 120))
    assert found["nothing_detectable"] >= 112
    assert found["effect"] + found["indistinguishable"] + found["two_effects"] <= 2


def test_nothing_missing_with_a_nuisance_parameter(toy):
    found = Counter(f.verdict for f in verdicts(toy(bump=True), {}, 60))
    assert found["nothing_detectable"] >= 56


def test_nothing_found_ends_at_the_base_model(toy):
    (found,) = verdicts(toy(), {}, 1)
    assert found.verdict == "nothing_detectable"
    assert found.base_check.passes(0.01) and found.base.effects == () and found.base.names == ()
    assert found.trials == () and found.atom is None and found.chosen is None and found.credible == ()
    assert found.evaluations > 0 and found.noise_scale == 1.0 and found.measured_scale == pytest.approx(1, abs=0.3)


def test_one_effect_is_named_and_measured(toy):
    """Parameters drawn from their prior are strained in one of 100 right models: such a name is withheld."""
    found = verdicts(toy(signed=("E1",)), {"E3": 1.0}, 60)
    assert all(f.chosen.names == ("E3",) for f in found)
    right = [f for f in found if f.verdict == "effect"]
    assert len(right) >= 54
    for f in found:
        assert f.credible == (("E3",) if f.verdict == "effect" else ())
        assert f.verdict == "effect" or f.chosen.implausible or not f.chosen_check.passes(0.01)
    z = [(f.chosen.state.values["E3"] - 1.0) / np.sqrt(f.chosen.state.covariance[-1, -1]) for f in right]
    assert 0.75 < np.std(z) < 1.25 and abs(np.mean(z)) < 0.5
    assert all(f.chosen_check.passes(0.01) and not f.chosen.implausible for f in right)
    assert all(f.ln_bayes(f.chosen) > np.log(5) + 3 for f in right)
    one = right[0]
    assert [t.ln_evidence for t in one.singles] == sorted((t.ln_evidence for t in one.singles), reverse=True)
    assert one.singles[0].names == ("E3",) and "E3" not in one.chosen_check.named.owners


def test_a_negative_strength_of_a_signed_effect_is_named(toy):
    found = verdicts(toy(signed=("E1",)), {"E1": -1.2}, 8)
    assert all("E1" in f.chosen.names and f.chosen.state.values["E1"] < -0.5 for f in found)
    assert Counter(f.credible for f in found)[("E1",)] >= 6


def test_a_negative_strength_of_one_that_cannot_be_is_not_named(toy):
    for f in verdicts(toy(atoms=1), {"E1": -2.0}, 5):
        assert f.verdict == "none_explains" and f.credible == ()


def test_an_effect_with_a_nuisance_parameter_is_found_where_it_lies(toy):
    toy = toy(bump=True)
    for place in (1.3, 5.6):
        found = verdicts(toy, {"hung": 1.5, "at": place}, 4)
        assert [f.credible for f in found] == [("hung",)] * 4
        assert all(f.chosen.state.values["at"] == pytest.approx(place, abs=0.3) for f in found)


def test_an_unbelievable_nuisance_parameter_is_not_named(toy):
    """The effect fits, but only at a place where it cannot be."""
    toy = toy(bump=True, effects=2)
    hung = toy.effects[-1]
    grid = tuple({"hung": 1.0, "at": q} for q in (2.5, 3.0, 3.5, 4.0, 4.5))
    toy = replace(
        toy, effects=(*toy.effects[:-1], replace(hung, nuisance=(replace(hung.nuisance[0], prior_sd=0.5),), grid=grid))
    )
    for f in verdicts(toy, {"hung": 3.0, "at": 6.0}, 3):
        assert f.verdict == "none_explains" and f.credible == ()
        if f.chosen.names == ("hung",):
            assert "at = " in f.chosen.implausible


def test_a_strained_parameter_forbids_a_name(toy):
    """What is missing acts as an effect less what a parameter does: the effect fits only with the parameter far off."""
    toy = toy(prior=0.5, reach=5.0, atoms=0, effects=3, size=20.0)
    columns = {**toy.columns, "hidden": toy.columns["E0"] - 4.0 * toy.columns["P1"]}
    toy = replace(toy, columns=columns)
    for f in verdicts(toy, {"hidden": 1.0}, 4):
        assert f.verdict == "none_explains"
        assert f.chosen.names == ("E0",) and "P1 had to move" in f.chosen.implausible


def test_effects_of_one_fingerprint_are_one(toy):
    toy = like(toy(), "E4", "E2", 0.995)
    found = verdicts(toy, {"E4": 1.0}, 8)
    for f in found:
        assert {g.effect.name: g.names for g in f.groups}["E2"] == ("E2", "E4") and len(f.groups) == 4
        assert f.chosen.names[0] == "E2" and f.verdict != "effect"
    assert Counter(f.credible for f in found)[("E2", "E4")] >= 6
    apart = explain(toy.drawn(np.random.default_rng(1), {"E4": 1.0}), Settings(merge=0.999))
    assert len(apart.groups) == 5 and set(apart.credible) == {"E2", "E4"} and apart.verdict == "indistinguishable"


def test_weak_effects_that_look_alike_are_both_told(toy):
    toy = like(toy(effects=4), "E3", "E1", 0.9)
    found = verdicts(toy, {"E1": 0.9}, 30)
    named = [f for f in found if f.verdict in ("effect", "indistinguishable")]
    assert len(named) >= 25
    both = [f for f in named if f.verdict == "indistinguishable"]
    assert all(set(f.credible) == {"E1", "E3"} for f in both) and len(both) >= len(named) / 3
    assert np.mean(["E1" in f.credible for f in named]) >= 0.9
    for f in both:  # whoever is worse is still within odds of 20:1
        assert f.singles[0].ln_evidence - f.singles[1].ln_evidence < 3.0
    strong = verdicts(toy, {"E1": 5.0}, 4)
    assert all(f.credible == ("E1",) for f in strong)


def test_two_effects_are_named_together(toy):
    found = verdicts(toy(signed=("E4",)), {"E0": 1.2, "E4": -1.2}, 12)
    assert Counter(f.verdict for f in found)["two_effects"] >= 10
    for f in found:
        if f.verdict == "two_effects":
            assert set(f.credible) == {"E0", "E4"} == set(f.chosen.names)
            assert f.chosen.state.values["E4"] < 0 and f.chosen_check.passes(0.01)
            assert f.chosen.ln_evidence > f.singles[0].ln_evidence + 3
            assert any(len(t.effects) == 2 for t in f.trials) and all(len(t.effects) == 1 for t in f.singles)


def test_what_the_library_lacks_is_pointed_at_by_a_local_change(toy):
    for f in verdicts(toy(atoms=12), {"A7": 1.5}, 8):
        assert f.verdict == "none_explains" and f.credible == ()
        assert f.atom.names == ("A7",) and f.atom.ln_evidence > f.chosen.ln_evidence
        assert f.chosen_check.p_family < 0.01


def test_what_nothing_points_at_is_seen_by_the_goodness_of_fit(toy):
    """A direction orthogonal to all that is tested, spread over one shape."""
    toy = toy(effects=3, atoms=3, sensors=20)
    spoiled = np.zeros(len(toy.rows))
    spoiled[[k for k, row in enumerate(toy.rows) if (row.mode, row.kind) == ("M5", "shape")]] = 3.0
    known = np.column_stack([c for c in toy.columns.values()])
    hidden = spoiled - known @ np.linalg.lstsq(known, spoiled, rcond=None)[0]
    toy = replace(toy, columns={**toy.columns, "hidden": hidden})
    for f in verdicts(toy, {"hidden": 1.0}, 6):
        assert f.verdict == "none_explains" and f.base_check.p_fit < 0.01
        worst = f.base_check.modes.sort_values("p").iloc[0]
        assert (worst["mode"], worst["kind"]) == ("M5", "shape") and f.credible == ()


def test_an_effect_outside_the_library_is_hardly_ever_named_after_another(toy):
    found = verdicts(without(toy(effects=8, atoms=0), "E6"), {"E6": 2.0}, 15)
    assert not any(f.credible for f in found)
    assert Counter(f.verdict for f in found)["none_explains"] >= 12


def test_half_an_answer_is_partial(toy):
    """An effect together with something orthogonal to the library that an atom sees only together with others."""
    toy = toy(effects=3, atoms=6)
    hidden = 0.25 * sum(toy.columns[f"A{k}"] for k in range(6))
    toy = replace(toy, columns={**toy.columns, "hidden": hidden})
    found = Counter(f.verdict for f in verdicts(toy, {"E1": 3.0, "hidden": 2.0}, 8))
    assert found["partial"] >= 6 and not found["effect"]


@pytest.mark.parametrize("factor", [1.3, 2.0])
def test_a_scatter_stated_too_small_is_told_from_an_effect(toy, factor):
    toy = toy(modes=12, sensors=60)
    found = verdicts(toy, {}, 10, noise=factor)
    assert Counter(f.verdict for f in found)["noise_underestimated"] >= 9
    for f in found:
        assert f.credible == () or f.verdict != "noise_underestimated"
        assert f.noise_scale == pytest.approx(factor, rel=0.1)


def test_an_effect_is_named_in_spite_of_a_scatter_stated_too_small(toy):
    toy = toy(modes=12, sensors=60, size=20.0)
    for f in verdicts(toy, {"E2": 1.0}, 5, noise=2.0):
        assert f.verdict == "effect" and f.credible == ("E2",)
        assert f.noise_scale == pytest.approx(2.0, rel=0.1)
        std = np.sqrt(f.chosen.state.covariance[-1, -1])
        assert std == pytest.approx(2.0 / 20, rel=0.25)


def test_a_strong_effect_is_no_reason_to_doubt_the_scatter(toy):
    toy = toy(modes=10, sensors=30)
    for f in verdicts(toy, {"E2": 9.0}, 4):
        assert f.noise_scale == 1.0 and f.credible == ("E2",)


def test_a_longer_library_does_not_make_more_alarms(toy):
    toy = toy(effects=50, atoms=0, sensors=20)
    found = Counter(f.verdict for f in verdicts(toy, {}, 40))
    assert found["nothing_detectable"] >= 37 and not found["effect"]


def test_a_scatter_from_few_repeats_makes_no_alarms(toy):
    toy = replace(toy(atoms=4, modes=0, sensors=40), scatter_freedom={"response": 4.0})
    rng = np.random.default_rng(3)
    found, blind = Counter(), Counter()
    for _ in range(60):
        one = replace(toy.drawn(rng), sd=np.full(40, np.sqrt(rng.chisquare(4.0) / 4.0)))
        found[explain(one).verdict] += 1
        blind[explain(replace(one, scatter_freedom={})).verdict] += 1
    assert found["nothing_detectable"] >= 56
    assert blind["nothing_detectable"] < 50


def test_places_follow_what_was_missing_and_come_back(toy):
    """A whole number that took part of an effect upon itself moves to its neighbour once the effect is added."""
    toy = toy(places=6, effects=3, size=6.0)
    rng = np.random.default_rng(4)
    places = toy.columns["place"].copy()
    places[:, 3] = places[:, 2] + 0.7 * 3 * toy.columns["E2"] + 0.8 * rng.standard_normal(len(toy.rows))
    toy = replace(toy, columns={**toy.columns, "place": places})
    found = explain(toy.drawn(rng, {"place": 2, "E2": 3.0}))
    assert found.base.state.values["place"] == 3
    assert found.credible == ("E2",) and found.chosen.state.values["place"] == 2


def test_plain_responses_need_no_modes(toy):
    found = verdicts(toy(modes=0, sensors=60), {"E1": 1.3}, 10)
    assert all(f.chosen.names[0] == "E1" and np.isnan(f.measured_scale) for f in found)
    assert Counter(f.credible for f in found)[("E1",)] >= 8


def test_same_seed_same_findings(toy):
    toy = toy(bump=True, places=3).drawn(np.random.default_rng(5), {"E1": 1.2, "hung": 1.0, "at": 2.2, "place": 1})
    one, other = explain(toy), explain(replace(toy, count=[0]))
    assert one.verdict == other.verdict and one.credible == other.credible
    assert one.base_check.p_family == other.base_check.p_family
    assert [(t.names, t.ln_evidence) for t in one.trials] == [(t.names, t.ln_evidence) for t in other.trials]
    assert one.chosen.state.values == other.chosen.state.values


def test_asking_again_gives_the_same_findings(toy):
    """What was solved before, by whomever, decides nothing."""
    toy = toy(signed=("E4",)).drawn(np.random.default_rng(1), {"E0": 1.2, "E4": -1.2})
    settings = Settings(budget=30)
    first = explain(toy, settings)
    assert first.verdict == "two_effects"
    for _ in range(3):
        assert explain(toy, settings).verdict == first.verdict


def test_beyond_the_budget_no_pairs_are_fitted(toy):
    toy = toy(signed=("E4",)).drawn(np.random.default_rng(1), {"E0": 1.2, "E4": -1.2})
    assert any(len(t.effects) == 2 for t in explain(toy).trials)
    found = explain(replace(toy, count=[0]), Settings(budget=1))
    assert all(len(t.effects) == 1 for t in found.trials) and found.credible == ()


def test_the_order_of_the_library_does_not_matter(toy):
    toy = toy(signed=("E0",)).drawn(np.random.default_rng(6), {"E0": -1.0, "E3": 0.9})
    one, other = explain(toy), explain(replace(toy, effects=toy.effects[::-1], atoms=toy.atoms[::-1]))
    assert one.verdict == other.verdict and set(one.credible) == set(other.credible)
    assert one.chosen.ln_evidence == pytest.approx(other.chosen.ln_evidence, abs=5e-3)


def test_progress_is_told(toy):
    told = []
    explain(toy().drawn(np.random.default_rng(7), {"E1": 1.5}), progress=told.append)
    assert told[0] == "calibrating the base model" and "fitting E1" in told


def test_too_little_to_decide_on(toy):
    with pytest.raises(InputError, match="3 measured modes cannot tell"):
        explain(toy(modes=3))
    with pytest.raises(InputError, match="no effect to look for"):
        explain(toy(effects=0))


def test_a_base_model_that_cannot_be_solved_is_said(toy):
    with pytest.raises(EvaluationError):
        explain(replace(toy(), fails=lambda values: True))


def test_an_effect_that_can_never_be_solved_is_passed_over(toy):
    """Of an effect with a nuisance parameter no grid point, of a plain one no fit can be evaluated."""
    toy = toy(bump=True).drawn(np.random.default_rng(8), {"E1": 1.5})
    toy = replace(toy, fails=lambda values: values.get("hung", 0.0) > 0 or values.get("E0", 0.0) > 0)
    found = explain(toy)
    assert found.verdict == "effect" and found.credible == ("E1",)


def test_refits_are_limited(toy):
    weak = toy(effects=9).drawn(np.random.default_rng(9), {"E1": 0.7})
    assert len(explain(weak, Settings(refits=3)).singles) == 3
    assert len(explain(weak).singles) == 6
    strong = toy(effects=9).drawn(np.random.default_rng(9), {"E1": 3.0})
    assert [t.names for t in explain(strong).singles] == [("E1",)]  # the others promise next to nothing of it


def test_evidence_is_that_of_a_fit_from_elsewhere(toy):
    toy = toy(bump=True).drawn(np.random.default_rng(10), {"hung": 1.5, "at": 2.6})
    found = explain(toy)
    question = toy.question(("hung",))
    misfits = [
        fitted(question, ("hung",), {**question.space.values, "hung": 1.0, "at": q}).misfit
        for q in np.linspace(0, 7, 15)
    ]
    assert found.chosen.state.misfit == pytest.approx(min(misfits), abs=0.01)


def test_the_second_best_point_of_a_grid_is_tried_too(toy):
    """The best point is the place of something else; beside the second best may lie what fits better in the end."""
    toy = toy(bump=True, effects=1, atoms=0)
    hung, bump = toy.effects[-1], toy.bumps["hung"]
    hung = replace(hung, grid=tuple({"hung": 2.0, "at": q} for q in (1.0, 4.4)))
    toy = replace(toy, effects=(toy.effects[0], hung), columns={**toy.columns, "decoy": bump.at({"at": 1.0})})
    rng, second = np.random.default_rng(1), 0
    for _ in range(10):
        one = toy.drawn(rng, {"hung": 2.0, "at": 5.4, "decoy": 1.4})
        found = explain(one)
        if found.noise_scale != 1.0:
            continue
        (trial,) = [t for t in found.singles if t.names == ("hung",)]
        question = one.question(("hung",))
        both = [fitted(question, ("hung",), {**found.base.state.values, **point}) for point in hung.grid]
        assert trial.state.misfit == pytest.approx(min(b.misfit for b in both), abs=0.06)
        best = found.base_check.named.points[found.base_check.named.best("hung")]
        second += best["at"] == 1.0 and trial.state.values["at"] > 4.4
    assert second >= 1


def test_fits_start_where_a_linear_model_ends(toy):
    """Two evaluations for the base model, one for each effect that is fitted, for the atom and for fits to the end."""
    toy = toy().drawn(np.random.default_rng(7), {"E1": 1.5})
    explain(toy)
    assert toy.evaluations <= 6


def test_a_local_change_that_fits_better_forbids_a_name(toy):
    """A named effect that is alike leaves nothing that could be seen, but the evidence is for the local change."""
    toy = like(toy(), "A5", "E2", 0.9)
    rivals = 0
    for f in verdicts(toy, {"A5": 0.9}, 25):
        if f.chosen is None or f.atom is None or len(f.chosen.effects) > 1:
            continue
        rival = f.atom.ln_evidence - np.log(len(toy.atoms)) + np.log(len(f.groups)) > f.singles[0].ln_evidence
        assert f.verdict != "effect" or not rival
        rivals += rival and f.chosen_check.passes(0.01) and not f.chosen.implausible
    assert rivals >= 4


def test_a_local_change_that_says_the_same_is_no_rival(toy):
    toy = like(toy(), "A5", "E2", 0.99)
    found = verdicts(toy, {"E2": 1.2}, 10)
    assert all(f.atom is None or f.atom.names != ("A5",) for f in found)
    assert Counter(f.credible for f in found)[("E2",)] >= 8


def test_of_two_that_explain_about_as_well_the_believable_one_goes_first(toy):
    """The better one by little needs a parameter far from where it can be."""
    toy = toy(prior=0.5, reach=5.0, atoms=0, effects=3, size=20.0)
    hidden = toy.columns["E0"] - 2.4 * toy.columns["P1"]
    toy = like(replace(toy, columns={**toy.columns, "hidden": hidden}), "E2", "hidden", 0.994)
    passed_over = 0
    for f in verdicts(toy, {"hidden": 0.7}, 25):
        near = [t for t in f.singles if t.ln_evidence > f.singles[0].ln_evidence - 3 and not t.implausible]
        if near and f.singles[0].implausible and f.verdict in ("effect", "indistinguishable"):
            assert f.chosen.names == near[0].names and f.singles[0].names[0] not in f.credible
            passed_over += 1
    assert passed_over >= 2


def test_a_base_model_starts_at_the_best_neighbouring_places(toy):
    """Places on the way to the right one look ever more like it; a first fit from the wrong one absorbs much."""
    toy = toy(places=7, effects=2)
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(7), np.arange(7)) / 3.0) ** 2)
    toy = replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})
    for place in (1, 5, 6):
        for f in verdicts(toy, {"place": place}, 3):
            assert f.base.state.values["place"] == place and f.verdict == "nothing_detectable"


def test_a_pair_that_another_equals_is_not_named(toy):
    """Beside the first effect two others explain the rest about as well: neither can be told."""
    toy = like(toy(effects=4), "E3", "E1", 0.95)
    equal = 0
    for f in verdicts(toy, {"E0": 1.4, "E1": 0.9}, 20):
        pairs = sorted((t for t in f.trials if len(t.effects) == 2 and not t.implausible), key=lambda t: -t.ln_evidence)
        if len(pairs) < 2:
            continue
        tied = pairs[0].ln_evidence - pairs[1].ln_evidence < 3
        assert not (tied and f.verdict == "two_effects")
        equal += tied and pairs[0].ln_evidence > f.singles[0].ln_evidence + 10
    assert equal >= 3
