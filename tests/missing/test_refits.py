"""Fits of pairs after integers have moved, and the budget."""

from dataclasses import replace

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.missing import effect_pairs
from calib.missing.decision import _Decision, decide
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import scores
from calib.missing.settings import DEFAULT, Settings

pytestmark = pytest.mark.usefixtures("fewer_samples")

VERDICTS = {
    "nothing_detectable",
    "effect",
    "indistinguishable",
    "two_effects",
    "several_effects",
    "partial",
    "none_explains",
    "misfit_unlocated",
}


# -- pairs -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def astray(toy):
    """Place 2 resembles the true place 1 with E2, except for a part that four other effects resemble."""
    made = toy(seed=3, effects=8, places=4)
    places = made.columns["place"].copy()
    resembled = sum(made.columns[f"E{k}"] for k in (3, 4, 5, 6))
    places[:, 2] = places[:, 1] + 2.0 * made.columns["E2"] - 0.7 * resembled
    return replace(made, columns={**made.columns, "place": places})


@pytest.fixture
def started(monkeypatch):
    """Effects and place at which every fit starts."""
    starts, candidate_fit = [], Refits.candidate_fit

    def telling(fits, names, start, *more, **changes):
        starts.append((names, start.get("place")))
        return candidate_fit(fits, names, start, *more, **changes)

    monkeypatch.setattr(Refits, "candidate_fit", telling)
    return starts


@pytest.mark.medium
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_a_second_effect_is_found_although_integers_have_moved(astray, started, monkeypatch, seed):
    one = astray.drawn(np.random.default_rng(seed), {"place": 1, "E0": 2.0, "E2": 2.0})
    found = decide(one)
    single = found.singles[0]
    assert single.names == ("E0",) and single.fit.values["place"] == found.base.fit.values["place"] == 2
    beside = scores(single.fit, [e for e in one.effects if e.name != "E0"], {})
    magnitude = dict(zip(beside.owners, beside.magnitude, strict=True))
    assert (
        magnitude["E2"] < RULES.detectable / 2
        and sum(s > magnitude["E2"] for s in magnitude.values()) >= RULES.pairs_of_best
    )
    assert found.verdict == "two_effects" and set(found.credible) == {"E0", "E2"}
    values = found.chosen.fit.values
    assert values["place"] == 1 and [values["E0"], values["E2"]] == pytest.approx([2.0, 2.0], abs=0.5)
    assert next(place for names, place in started if names == ("E0", "E2")) == 1
    # Without neighbouring integers the second effect is not even tried.
    monkeypatch.setattr(effect_pairs, "neighbouring_integers", lambda fit: [])
    blind = decide(replace(one, count=[0]))
    assert blind.credible == () and not any(t.names == ("E0", "E2") for t in blind.candidate_fits)


@pytest.mark.medium
def test_a_pair_with_a_vanished_effect_is_never_named(toy):
    """The effect missing beside E0 is a negative E1, which is impossible."""
    made, vanished, named = toy(effects=3, perturbations=0), 0, 0
    for seed in range(5):
        one = made.drawn(np.random.default_rng(seed), {"E0": 2.0, "E1": -1.5, "E2": 1.0})
        found = decide(one)
        assert "E1" not in found.credible
        decision = _Decision(Refits(one, DEFAULT, 1.0, silent))
        for pair in (replace(t, implausible="") for t in found.candidate_fits if len(t.effects) == 2):
            gone = min(pair.fit.values[name] for name in pair.names) < 1e-5
            assert decision.pair([pair], -np.inf, found.groups) == (() if gone else (pair,))
            vanished, named = vanished + gone, named + (not gone)
    assert vanished >= 3 and named >= 3


# -- budget ------------------------------------------------------------------------------------------------------------


def test_the_budget_counts_from_the_start_of_an_explanation(toy):
    one = toy()
    one.count[0] = 7
    fits = Refits(one, Settings(budget=20.0), 1.0, silent)
    for evaluations, parts in ((7, ()), (17, ()), (18, (0.5,)), (27, (0.5,)), (28, (0.5, 1.0))):
        one.count[0] = evaluations
        assert tuple(part for part in (0.5, 1.0) if fits.spent(part)) == parts
    assert replace(fits, scale=2.0).allowance.used == 0 and fits.spent()
    with fits.allowance.uncharged():
        one.count[0] += 50
    assert fits.allowance.used == 21 and one.count[0] == 78


@pytest.mark.medium
def test_a_small_budget_ends_with_a_verdict_after_about_as_many_evaluations(toy):
    """Three effects are missing, so that everything is tried."""
    made = toy(seed=3, effects=8, places=6, curvature=0.03)
    made = made.drawn(np.random.default_rng(0), {"place": 3, "E0": 1.0, "E2": 1.0, "E4": 1.0})

    def explained(budget):
        one = replace(made, count=[1000])
        found = decide(one, Settings(budget=budget))
        assert found.verdict in VERDICTS and found.chosen is not None and found.evaluations == one.evaluations
        return one.evaluations - 1000

    least, whole = explained(0.0), explained(np.inf)
    assert least <= 20 and whole > 68  # what the verdict alone needs, and what a full search needs
    spent = [explained(budget) for budget in (20.0, 50.0)]
    assert spent == sorted(spent)
    for budget, evaluations in zip((20.0, 50.0), spent, strict=True):
        # The standard deviation counts as understated, so that everything, pairs and steps too, is decided twice; what
        # tells whether several effects may be named is not charged.
        assert budget <= evaluations <= (2 + RULES.anew + 2 * RULES.paired + 2 * RULES.stepped) * budget + 60
