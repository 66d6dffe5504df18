"""Which fits a decision makes, from where, and that nothing else sways it; over toys in which every answer is known."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import EvaluationError
from calib.missing.explain import Settings, explain
from calib.missing.pairs import fit_pairs
from calib.missing.state import fitted


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


def test_what_single_effects_have_spent_leaves_pairs_their_part(toy, monkeypatch):
    """Two effects are missing, and the single ones use up the budget: the pair is named as with any budget."""
    toy = toy(signed=("E4",)).drawn(np.random.default_rng(1), {"E0": 1.2, "E4": -1.2})
    whole, spent = explain(toy), []

    def telling(fits, *given):
        spent.append(fits.spent())
        return fit_pairs(fits, *given)

    monkeypatch.setattr("calib.missing.explain.fit_pairs", telling)
    found = explain(replace(toy, count=[0]), Settings(budget=6))
    assert spent == [True]
    assert found.verdict == whole.verdict == "two_effects" and set(found.credible) == set(whole.credible)


def test_the_order_of_the_library_does_not_matter(toy):
    toy = toy(signed=("E0",)).drawn(np.random.default_rng(6), {"E0": -1.0, "E3": 0.9})
    one, other = explain(toy), explain(replace(toy, effects=toy.effects[::-1], atoms=toy.atoms[::-1]))
    assert one.verdict == other.verdict and set(one.credible) == set(other.credible)
    assert one.chosen.ln_evidence == pytest.approx(other.chosen.ln_evidence, abs=5e-3)


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
    strong = toy(effects=9).drawn(np.random.default_rng(10), {"E1": 3.0})
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


def test_a_base_model_starts_at_the_best_neighbouring_places(toy):
    """Places on the way to the right one look ever more like it; a first fit from the wrong one absorbs much."""
    toy = toy(places=7, effects=2)
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(7), np.arange(7)) / 3.0) ** 2)
    toy = replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})
    for place in (1, 5, 6):
        for f in toy.explained({"place": place}, 3):
            assert f.base.state.values["place"] == place and f.verdict == "nothing_detectable"
