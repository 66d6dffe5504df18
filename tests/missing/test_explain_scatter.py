"""Whether the scatter is taken for understated, and the decision begun anew."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calib.missing.explain import explain
from calib.missing.goodness import goodness, noise_scale
from calib.missing.refits import Refits, Settings
from calib.missing.rules import RULES

pytestmark = pytest.mark.usefixtures("fewer_draws")

ANEW = "beginning anew"


def spread(toy, *names):
    """The toy with effects that spoil the shapes of all modes alike."""
    rng = np.random.default_rng(7)
    shape = np.array([row.kind == "shape" for row in toy.rows])
    columns = dict(toy.columns)
    for name in names:
        signs = shape * rng.choice((-1.0, 1.0), len(shape))
        columns[name] = signs * np.linalg.norm(columns[name]) / np.linalg.norm(signs)
    return replace(toy, columns=columns)


def asked(toy, seed, truth, noise=1.0):
    """Findings and what was told: until a new beginning, and from it on."""
    told = []
    found = explain(toy.drawn(np.random.default_rng(seed), truth, noise), progress=told.append)
    cut = next((k for k, words in enumerate(told) if ANEW in words), len(told))
    return found, told[:cut], told[cut:]


@pytest.mark.parametrize("seed", range(3))
def test_two_effects_that_spoil_all_modes_alike_are_no_reason_to_doubt_the_scatter(toy, seed):
    made = spread(toy(modes=10, sensors=20), "E0", "E1")
    found, _, anew = asked(made, seed, {"E0": 3.0, "E1": 2.5})
    modes = goodness(found.singles[0].state, made)[1]
    assert noise_scale(modes) > 1.3 * RULES.guard  # one effect alone asks for a larger scatter
    assert anew == [] and found.noise_scale == 1.0 and found.measured_scale < RULES.guard
    assert found.verdict == "two_effects" and set(found.credible) == {"E0", "E1"}
    values = found.chosen.state.values
    assert [values["E0"], values["E1"]] == pytest.approx([3.0, 2.5], abs=0.5)


@pytest.mark.parametrize("seed", [0, 2, 3])
@pytest.mark.parametrize(
    ("truth", "verdict", "credible"), [({}, "noise_underestimated", ()), ({"E2": 3.0}, "effect", ("E2",))]
)
def test_a_scatter_stated_half_as_large_is_begun_anew_before_pairs_are_tried(toy, seed, truth, verdict, credible):
    found, before, anew = asked(toy(modes=10, sensors=20), seed, truth, 2.0)
    assert found.verdict == verdict and found.credible == credible
    assert found.noise_scale == pytest.approx(2.0, rel=0.1) and found.measured_scale == pytest.approx(1.0, rel=0.1)
    assert anew[0] == f"the scatter seems understated by a factor of {found.noise_scale:.2f}: beginning anew"
    assert anew[1] == "calibrating the base model" and sum(ANEW in words for words in anew) == 1
    assert not any(" with " in words for words in before)


@pytest.mark.parametrize("seed", range(3))
def test_the_second_decision_has_a_budget_of_its_own(toy, seed, monkeypatch):
    """What the first one has fitted is fitted again with the larger scatter, although it took most of its budget."""
    tried, singles = [], Refits.singles

    def telling(fits, base, groups, named, starts):
        found = singles(fits, base, groups, named, starts)
        tried.append((set(starts) - {()}, {t.names for t in found}))
        return found

    monkeypatch.setattr(Refits, "singles", telling)
    one = toy(modes=10, sensors=20, curvature=0.02).drawn(np.random.default_rng(seed), {"E2": 3.0}, 2.0)
    assert explain(one, Settings(budget=60.0)).noise_scale > 1.5
    known, again = tried[-1]
    assert len(tried) == 2 and len(known) >= 4 and again >= known


def test_a_scatter_stated_right_is_never_begun_anew(toy):
    for truth in ({}, {"E2": 3.0}):
        found, _, anew = asked(toy(modes=10, sensors=20), 0, truth)
        assert anew == [] and found.noise_scale == 1.0


@pytest.mark.parametrize("factor", [1.3, 2.0])
def test_a_scatter_stated_too_small_is_told_from_an_effect(toy, factor):
    toy = toy(modes=12, sensors=60)
    found = toy.explained({}, 6, noise=factor)
    assert Counter(f.verdict for f in found)["noise_underestimated"] >= 5
    for f in found:
        assert f.credible == () or f.verdict != "noise_underestimated"
        assert f.noise_scale == pytest.approx(factor, rel=0.1)


def test_an_effect_is_named_in_spite_of_a_scatter_stated_too_small(toy):
    toy = toy(modes=12, sensors=60, size=20.0)
    for f in toy.explained({"E2": 1.0}, 5, noise=2.0):
        assert f.verdict == "effect" and f.credible == ("E2",)
        assert f.noise_scale == pytest.approx(2.0, rel=0.1)
        std = np.sqrt(f.chosen.state.covariance[-1, -1])
        assert std == pytest.approx(2.0 / 20, rel=0.25)


def test_a_strong_effect_is_no_reason_to_doubt_the_scatter(toy):
    toy = toy(modes=10, sensors=30)
    for f in toy.explained({"E2": 9.0}, 4):
        assert f.noise_scale == 1.0 and f.credible == ("E2",)


def test_a_scatter_from_few_repeats_makes_no_alarms(toy):
    toy = replace(toy(atoms=4, modes=0, sensors=40), scatter_freedom={"response": 4.0})
    rng = np.random.default_rng(3)
    found, blind = Counter(), Counter()
    for _ in range(30):
        one = replace(toy.drawn(rng), sd=np.full(40, np.sqrt(rng.chisquare(4.0) / 4.0)))
        found[explain(one).verdict] += 1
        blind[explain(replace(one, scatter_freedom={})).verdict] += 1
    assert found["nothing_detectable"] >= 28
    assert blind["nothing_detectable"] < 25
