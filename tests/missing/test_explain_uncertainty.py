"""Detection of an understated standard deviation, and the repeated decision."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calib.missing import decision
from calib.missing.decision import decide
from calib.missing.goodness import goodness, noise_scale
from calib.missing.rules import RULES
from calib.missing.settings import Settings

pytestmark = pytest.mark.usefixtures("fewer_samples")

REPEATED = "repeating with it"


def spread(toy, *names):
    """The toy with effects that change the shapes of all modes alike."""
    rng = np.random.default_rng(7)
    shape = np.array([row.kind == "shape" for row in toy.rows])
    columns = dict(toy.columns)
    for name in names:
        signs = shape * rng.choice((-1.0, 1.0), len(shape))
        columns[name] = signs * np.linalg.norm(columns[name]) / np.linalg.norm(signs)
    return replace(toy, columns=columns)


def decided(toy, seed, truth, noise=1.0):
    """Explanation, and its progress messages before and after the decision is repeated."""
    messages = []
    found = decide(
        toy.drawn(np.random.default_rng(seed), truth, noise), progress=lambda stage, *more: messages.append(stage)
    )
    cut = next((k for k, words in enumerate(messages) if REPEATED in words), len(messages))
    return found, messages[:cut], messages[cut:]


@pytest.mark.parametrize("seed", range(3))
def test_two_effects_on_all_modes_do_not_count_as_an_understated_standard_deviation(toy, seed):
    made = spread(toy(modes=10, sensors=20), "E0", "E1")
    found, _, repeated = decided(made, seed, {"E0": 3.0, "E1": 2.5})
    modes = goodness(found.singles[0].fit, made)[1]
    assert (
        noise_scale(modes) > 1.3 * RULES.guard
    )  # with one effect alone the modes call for a larger standard deviation
    assert repeated == [] and found.noise_scale == 1.0 and found.measured_scale < RULES.guard
    assert found.verdict == "two_effects" and set(found.credible) == {"E0", "E1"}
    values = found.chosen.fit.values
    assert [values["E0"], values["E1"]] == pytest.approx([3.0, 2.5], abs=0.5)


@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("seed", [0, 2, 3])
@pytest.mark.parametrize(
    ("truth", "verdict", "credible"), [({}, "noise_underestimated", ()), ({"E2": 3.0}, "effect", ("E2",))]
)
def test_an_understated_standard_deviation_is_corrected_before_pairs_are_tried(toy, seed, truth, verdict, credible):
    found, before, repeated = decided(toy(modes=10, sensors=20), seed, truth, 2.0)
    assert found.verdict == verdict and found.credible == credible
    assert found.noise_scale == pytest.approx(2.0, rel=0.1) and found.measured_scale == pytest.approx(1.0, rel=0.1)
    factor = f"{found.noise_scale:.2f}"
    assert repeated[0] == f"the standard deviation seems understated by a factor of {factor}: repeating with it"
    assert repeated[1] == "calibrating the base model" and sum(REPEATED in words for words in repeated) == 1
    assert not any(" with " in words for words in before)


@pytest.mark.parametrize("seed", range(3))
def test_the_second_decision_has_its_own_budget(toy, seed, monkeypatch):
    """The second decision refits the effects of the first, although these took most of its budget."""
    tried, singles = [], decision.fit_singles

    def telling(fits, base, groups, named, starts):
        found = singles(fits, base, groups, named, starts)
        tried.append((set(starts) - {()}, {t.names for t in found}))
        return found

    monkeypatch.setattr(decision, "fit_singles", telling)
    one = toy(modes=10, sensors=20, curvature=0.02).drawn(np.random.default_rng(seed), {"E2": 3.0}, 2.0)
    assert decide(one, Settings(budget=60.0)).noise_scale > 1.5
    known, again = tried[-1]
    assert len(tried) == 2 and len(known) >= 4 and again >= known


def test_a_correct_standard_deviation_is_kept(toy):
    for truth in ({}, {"E2": 3.0}):
        found, _, repeated = decided(toy(modes=10, sensors=20), 0, truth)
        assert repeated == [] and found.noise_scale == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.3, pytest.param(2.0, marks=pytest.mark.slow)])
def test_an_understated_standard_deviation_is_told_from_an_effect(toy, factor):
    toy = toy(modes=12, sensors=60)
    found = toy.explained({}, 6, noise=factor)
    assert Counter(f.verdict for f in found)["noise_underestimated"] >= 5
    for f in found:
        assert f.credible == () or f.verdict != "noise_underestimated"
        assert f.noise_scale == pytest.approx(factor, rel=0.1)


@pytest.mark.slow
def test_an_effect_is_named_despite_an_understated_standard_deviation(toy):
    toy = toy(modes=12, sensors=60, size=20.0)
    for f in toy.explained({"E2": 1.0}, 5, noise=2.0):
        assert f.verdict == "effect" and f.credible == ("E2",)
        assert f.noise_scale == pytest.approx(2.0, rel=0.1)
        std = np.sqrt(f.chosen.fit.covariance[-1, -1])
        assert std == pytest.approx(2.0 / 20, rel=0.25)


@pytest.mark.medium
def test_a_strong_effect_does_not_count_as_an_understated_standard_deviation(toy):
    toy = toy(modes=10, sensors=30)
    for f in toy.explained({"E2": 9.0}, 4):
        assert f.noise_scale == 1.0 and f.credible == ("E2",)


@pytest.mark.slow
def test_a_standard_deviation_from_few_repeats_raises_no_false_alarms(toy):
    toy = replace(toy(perturbations=4, modes=0, sensors=40), std_dof={"response": 4.0})
    rng = np.random.default_rng(3)
    found, blind = Counter(), Counter()
    for _ in range(15):
        one = replace(toy.drawn(rng), sd=np.full(40, np.sqrt(rng.chisquare(4.0) / 4.0)))
        found[decide(one).verdict] += 1
        blind[decide(replace(one, std_dof={})).verdict] += 1
    assert found["nothing_detectable"] >= 14
    assert blind["nothing_detectable"] < 13
