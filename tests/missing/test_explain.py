"""The decision, on toys whose truth is known."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.missing.decision import Settings, decide
from calib.missing.explanation import SEVERAL
from calib.missing.settings import DEFAULT, too_few
from calib.missing.steps_table import steps_sentence
from calib.problem.joint import JointRows

pytestmark = pytest.mark.usefixtures("fewer_samples")


def without(toy, *names):
    """The toy without some effects in its library, although its data may contain them."""
    return replace(toy, effects=tuple(e for e in toy.effects if e.name not in names))


def test_false_alarms_are_rare(toy):
    """Two tests at 1 % each; an effect that passes them must still be named."""
    found = Counter(f.verdict for f in toy(effects=8, perturbations=20, signed=("E1", "E5")).explained({}, 20))
    assert found["nothing_detectable"] >= 18
    assert found["effect"] + found["indistinguishable"] + found["two_effects"] <= 1


def test_nothing_missing_with_a_nuisance_parameter(toy):
    found = Counter(f.verdict for f in toy(bump=True).explained({}, 20))
    assert found["nothing_detectable"] >= 18


def test_without_a_finding_only_the_base_model_is_fitted(toy):
    (found,) = toy().explained({}, 1)
    assert found.verdict == "nothing_detectable"
    assert found.base_adequacy.passes(0.01) and found.base.effects == () and found.base.names == ()
    assert found.candidate_fits == () and found.perturbation is None and found.chosen is None and found.credible == ()
    assert found.evaluations > 0 and found.noise_scale == 1.0 and found.measured_scale == pytest.approx(1, abs=0.3)


@pytest.mark.medium
def test_one_effect_is_named_and_measured(toy):
    """One in 100 correctly specified models has a pulled parameter: no effect is named then."""
    found = toy(signed=("E1",)).explained({"E3": 1.0}, 15)
    assert all(f.chosen.names == ("E3",) for f in found)
    right = [f for f in found if f.verdict == "effect"]
    assert len(right) >= 13
    for f in found:
        assert f.credible == (("E3",) if f.verdict == "effect" else ())
        assert f.verdict == "effect" or f.chosen.implausible or not f.chosen_adequacy.passes(0.01)
    z = [(f.chosen.fit.values["E3"] - 1.0) / np.sqrt(f.chosen.fit.covariance[-1, -1]) for f in right]
    assert 0.6 < np.std(z) < 1.4 and abs(np.mean(z)) < 0.7
    assert all(f.chosen_adequacy.passes(0.01) and not f.chosen.implausible for f in right)
    assert all(f.ln_bayes(f.chosen) > np.log(5) + 3 for f in right)
    one = right[0]
    assert [t.ln_evidence for t in one.singles] == sorted((t.ln_evidence for t in one.singles), reverse=True)
    assert one.singles[0].names == ("E3",) and "E3" not in one.chosen_adequacy.named.owners


@pytest.mark.medium
def test_a_negative_magnitude_of_a_signed_effect_is_named(toy):
    found = toy(signed=("E1",)).explained({"E1": -1.2}, 8)
    assert all("E1" in f.chosen.names and f.chosen.fit.values["E1"] < -0.5 for f in found)
    assert Counter(f.credible for f in found)[("E1",)] >= 6


@pytest.mark.medium
def test_an_impossible_negative_magnitude_is_not_named(toy):
    for f in toy(perturbations=1).explained({"E1": -2.0}, 5):
        assert f.verdict in ("none_explains", "misfit_unlocated") and f.credible == ()


@pytest.mark.medium
def test_the_nuisance_parameter_of_an_effect_is_found(toy):
    toy = toy(bump=True)
    for place in (1.3, 5.6):
        found = toy.explained({"hung": 1.5, "at": place}, 4, seed=int(place))
        assert [f.credible for f in found] == [("hung",)] * 4
        assert all(f.chosen.fit.values["at"] == pytest.approx(place, abs=0.3) for f in found)


@pytest.mark.medium
def test_an_effect_with_an_implausible_nuisance_parameter_is_not_named(toy):
    """The effect fits, but only at an implausible place."""
    toy = toy(bump=True, effects=2)
    hung = toy.effects[-1]
    grid = tuple({"hung": 1.0, "at": q} for q in (2.5, 3.0, 3.5, 4.0, 4.5))
    toy = replace(
        toy, effects=(*toy.effects[:-1], replace(hung, nuisance=(replace(hung.nuisance[0], prior_sd=0.5),), grid=grid))
    )
    for f in toy.explained({"hung": 3.0, "at": 6.0}, 3):
        assert f.verdict == "none_explains" and f.credible == ()
        if f.chosen.names == ("hung",):
            assert "at = " in f.chosen.implausible


@pytest.mark.medium
def test_an_effect_that_pulls_a_parameter_is_not_named(toy):
    """The missing effect is E0 less a parameter's signature: E0 fits only with the parameter far off."""
    toy = toy(prior=0.5, reach=5.0, perturbations=0, effects=3, size=20.0)
    columns = {**toy.columns, "hidden": toy.columns["E0"] - 4.0 * toy.columns["P1"]}
    toy = replace(toy, columns=columns)
    for f in toy.explained({"hidden": 1.0}, 4):
        assert f.verdict == "none_explains"
        assert f.chosen.names == ("E0",) and "P1 has shifted" in f.chosen.implausible


@pytest.mark.medium
def test_collinear_effects_are_one_group(toy):
    toy = toy().correlated("E4", "E2", 0.995)
    found = toy.explained({"E4": 1.0}, 8)
    for f in found:
        assert {"E2", "E4"} in [set(g.names) for g in f.groups] and len(f.groups) == 4
        assert f.chosen.names[0] in ("E2", "E4") and f.verdict != "effect"
    assert Counter(frozenset(f.credible) for f in found)[frozenset(("E2", "E4"))] >= 6
    apart = decide(toy.drawn(np.random.default_rng(1), {"E4": 1.0}), Settings(merge=0.999))
    assert len(apart.groups) == 5 and set(apart.credible) == {"E2", "E4"} and apart.verdict == "indistinguishable"


@pytest.mark.slow
def test_weak_collinear_effects_are_both_reported(toy):
    toy = toy(effects=4).correlated("E3", "E1", 0.9)
    found = toy.explained({"E1": 0.9}, 10)
    named = [f for f in found if f.verdict in ("effect", "indistinguishable")]
    assert len(named) >= 8
    both = [f for f in named if f.verdict == "indistinguishable"]
    assert all(set(f.credible) == {"E1", "E3"} for f in both) and len(both) >= len(named) / 3
    assert np.mean(["E1" in f.credible for f in named]) >= 0.9
    for f in both:  # the worse one is within 20:1 of the better
        assert f.singles[0].ln_evidence - f.singles[1].ln_evidence < 3.0
    strong = toy.explained({"E1": 5.0}, 4)
    assert all(f.credible == ("E1",) for f in strong)


@pytest.mark.medium
def test_two_effects_are_named_together(toy):
    found = toy(signed=("E4",)).explained({"E0": 1.2, "E4": -1.2}, 6)
    assert Counter(f.verdict for f in found)["two_effects"] >= 5
    for f in found:
        if f.verdict == "two_effects":
            assert set(f.credible) == {"E0", "E4"} == set(f.chosen.names)
            assert f.chosen.fit.values["E4"] < 0 and f.chosen_adequacy.passes(0.01)
            assert f.chosen.ln_evidence > f.singles[0].ln_evidence + 3
            assert any(len(t.effects) == 2 for t in f.candidate_fits) and all(len(t.effects) == 1 for t in f.singles)


@pytest.mark.medium
@pytest.mark.parametrize("truth", [{"E0": 1.2, "E4": -1.2}, {"E0": 1.5, "E1": 1.2, "E4": -1.3}])
def test_of_several_effects_that_are_named_together_at_most_one_is_generic(toy, truth):
    """Nobody listed the others: they may imitate a cause that is in no form of them."""
    made = toy(signed=("E4",), perturbations=6)
    for generic in ("E0",), ("E0", "E4"):
        own = tuple(replace(e, generic=e.name in generic) for e in made.effects)
        found = replace(made, effects=own).explained(truth, 3)
        several = [f for f in found if f.verdict in SEVERAL]
        if len(generic) == 1:
            assert len(several) >= 2
            continue
        assert not several and {f.verdict for f in found} <= {"partial", "none_explains"}
        told = [words for f in found if (words := steps_sentence(f)).startswith("Together ")]
        assert len(told) >= 2 and all("they are not named" in words for words in told)


@pytest.mark.medium
def test_a_local_perturbation_locates_what_the_library_lacks(toy):
    for f in toy(perturbations=12).explained({"A7": 1.5}, 4):
        assert f.verdict == "none_explains" and f.credible == ()
        assert f.perturbation.names == ("A7",) and f.perturbation.ln_evidence > f.chosen.ln_evidence
        assert f.chosen_adequacy.p_family < 0.01


@pytest.mark.slow
def test_goodness_of_fit_sees_what_no_score_does(toy):
    """A change orthogonal to all signatures, spread over one shape."""
    toy = toy(effects=3, perturbations=3, sensors=20)
    spoiled = np.zeros(len(toy.rows))
    spoiled[[k for k, row in enumerate(toy.rows) if (row.mode, row.kind) == ("M5", "shape")]] = 3.0
    known = np.column_stack([c for c in toy.columns.values()])
    hidden = spoiled - known @ np.linalg.lstsq(known, spoiled, rcond=None)[0]
    toy = replace(toy, columns={**toy.columns, "hidden": hidden})
    for f in toy.explained({"hidden": 1.0}, 6):
        assert f.base_adequacy.p_fit < 0.01
        assert f.verdict == ("misfit_unlocated" if f.base_adequacy.p_family > 0.01 else "none_explains")
        worst = f.base_adequacy.modes.sort_values("p").iloc[0]
        assert (worst["mode"], worst["kind"]) == ("M5", "shape") and f.credible == ()


@pytest.mark.slow
def test_an_effect_outside_the_library_is_rarely_misnamed(toy):
    found = without(toy(effects=8, perturbations=0), "E6").explained({"E6": 2.0}, 8)
    assert not any(f.credible for f in found)
    verdicts = Counter(f.verdict for f in found)
    assert verdicts["none_explains"] + verdicts["misfit_unlocated"] >= 6 and verdicts["none_explains"] >= 4


@pytest.mark.slow
def test_an_incomplete_explanation_is_partial(toy):
    """An effect and a change orthogonal to the library that a local perturbation sees only together with others."""
    toy = toy(effects=3, perturbations=6)
    hidden = 0.25 * sum(toy.columns[f"A{k}"] for k in range(6))
    toy = replace(toy, columns={**toy.columns, "hidden": hidden})
    found = Counter(f.verdict for f in toy.explained({"E1": 3.0, "hidden": 3.0}, 5))
    assert found["partial"] >= 4 and not found["effect"]


def test_a_longer_library_does_not_raise_false_alarms(toy):
    toy = toy(effects=50, perturbations=0, sensors=20)
    found = Counter(f.verdict for f in toy.explained({}, 12))
    assert found["nothing_detectable"] >= 11 and not found["effect"]


@pytest.mark.medium
def test_scalar_responses_need_no_modes(toy):
    found = toy(modes=0, sensors=60).explained({"E1": 1.3}, 10)
    assert all(f.chosen.names[0] == "E1" and np.isnan(f.measured_scale) for f in found)
    assert Counter(f.credible for f in found)[("E1",)] >= 8


def test_progress_is_reported(toy):
    messages = []
    decide(toy().drawn(np.random.default_rng(7), {"E1": 1.5}), progress=lambda stage, *more: messages.append(stage))
    assert messages[0] == "calibrating the base model" and "fitting E1" in messages


@pytest.mark.parametrize("budget", [DEFAULT.budget, math.inf])
def test_progress_has_a_whole_where_the_budget_has(toy, budget):
    told = []
    data = toy().drawn(np.random.default_rng(7), {"E1": 1.5})
    decide(data, Settings(budget=budget), lambda stage, done=0, total=0, best=0: told.append((done, total)))
    assert max(done for done, _ in told) > 0
    assert all(done <= total == budget if math.isfinite(budget) else total == 0 for done, total in told)


def test_too_few_data_are_refused(toy):
    with pytest.raises(InputError, match="3 measured modes cannot tell"):
        decide(toy(modes=3))
    assert "3 measured modes" in too_few(toy(modes=3).rows, 1) and too_few(toy(modes=4).rows, 1) == ""
    several = JointRows({name: toy(modes=2) for name in "ab"}).rows
    assert too_few(several, 1) == "" and "5 fitted" in too_few(toy(modes=0, sensors=6).rows, 5)


def test_without_effects_the_local_perturbation_is_reported(toy):
    found = decide(toy(effects=0).drawn(np.random.default_rng(7), {"A5": 1.5}))
    assert found.verdict == "none_explains" and found.perturbation is not None and found.perturbation.names == ("A5",)
    assert found.groups == () and found.chosen is None and not found.names_something
    complete = decide(toy(effects=0).drawn(np.random.default_rng(7), {}))
    assert complete.verdict == "nothing_detectable" and complete.perturbation is None


@pytest.mark.medium
def test_no_effect_is_named_when_a_local_perturbation_fits_better(toy):
    """A collinear effect leaves no visible misfit, but the evidence favours the local perturbation."""
    toy = toy().correlated("A5", "E2", 0.9)
    competing = 0
    for f in toy.explained({"A5": 0.9}, 8):
        if f.chosen is None or f.perturbation is None or len(f.chosen.effects) > 1:
            continue
        competitor = (
            f.perturbation.ln_evidence - np.log(len(toy.perturbations)) + np.log(len(f.groups))
            > f.singles[0].ln_evidence
        )
        assert f.verdict != "effect" or not competitor
        competing += competitor and f.chosen_adequacy.passes(0.01) and not f.chosen.implausible
    assert competing >= 2


@pytest.mark.medium
def test_a_magnitude_beyond_the_plausible_one_is_no_misfit(toy):
    """Thirty times the plausible size: a local perturbation must not explain the pull by the prior."""
    toy = toy().correlated("A5", "E2", 0.6)
    usual, large = (toy.explained({"E2": magnitude}, 4) for magnitude in (1.2, 30.0))
    assert min(f.chosen.fit.shift[f.chosen.fit.names.index("E2")] for f in large) > 28
    assert [f.verdict for f in large] == [f.verdict for f in usual]
    assert Counter(f.verdict for f in large)["effect"] >= 3 and all(f.chosen.names == ("E2",) for f in large)


@pytest.mark.slow
def test_a_local_perturbation_collinear_with_the_effect_does_not_compete(toy):
    toy = toy().correlated("A5", "E2", 0.99)
    found = toy.explained({"E2": 1.2}, 10)
    assert all(f.perturbation is None or f.perturbation.names != ("A5",) for f in found)
    assert Counter(f.credible for f in found)[("E2",)] >= 8


@pytest.mark.slow
def test_of_two_equal_explanations_the_plausible_one_leads(toy):
    """The slightly better one pulls a parameter."""
    toy = toy(prior=0.5, reach=5.0, perturbations=0, effects=3, size=20.0)
    hidden = toy.columns["E0"] - 2.4 * toy.columns["P1"]
    toy = replace(toy, columns={**toy.columns, "hidden": hidden}).correlated("E2", "hidden", 0.994)
    passed_over = 0
    for f in toy.explained({"hidden": 0.7}, 15):
        near = [t for t in f.singles if t.ln_evidence > f.singles[0].ln_evidence - 3 and not t.implausible]
        if near and f.singles[0].implausible and f.verdict in ("effect", "indistinguishable"):
            assert f.chosen.names == near[0].names and f.singles[0].names[0] not in f.credible
            passed_over += 1
    assert passed_over >= 2


@pytest.mark.slow
def test_one_of_two_equally_good_pairs_is_not_named(toy):
    """Beside the first effect two others explain the rest about as well: neither is named."""
    toy = toy(effects=4).correlated("E3", "E1", 0.95)
    equal = 0
    for f in toy.explained({"E0": 1.4, "E1": 0.9}, 8):
        pairs = sorted(
            (t for t in f.candidate_fits if len(t.effects) == 2 and not t.implausible), key=lambda t: -t.ln_evidence
        )
        if len(pairs) < 2:
            continue
        tied = pairs[0].ln_evidence - pairs[1].ln_evidence < 3
        assert not (tied and f.verdict == "two_effects")
        equal += tied and pairs[0].ln_evidence > f.singles[0].ln_evidence + 10
    assert equal >= 2
