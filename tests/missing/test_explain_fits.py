"""Fits and starts of a decision, and their independence of order and history; on toys whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.execution.stage import silent
from calib.missing.decision import Settings, decide
from calib.missing.effect_pairs import fit_pairs
from calib.missing.linearised_fit import FINE, least_squares_fit
from calib.missing.refits import Refits
from calib.missing.rules import RULES

pytestmark = pytest.mark.usefixtures("fewer_samples")


def test_integers_move_back_once_the_effect_is_added(toy):
    """An integer that absorbed part of an effect moves back to its neighbour once the effect is added."""
    toy = toy(places=6, effects=3, size=6.0)
    rng = np.random.default_rng(4)
    places = toy.columns["place"].copy()
    places[:, 3] = places[:, 2] + 0.7 * 3 * toy.columns["E2"] + 0.8 * rng.standard_normal(len(toy.rows))
    toy = replace(toy, columns={**toy.columns, "place": places})
    found = decide(toy.drawn(rng, {"place": 2, "E2": 3.0}))
    assert found.base.fit.values["place"] == 3
    assert found.credible == ("E2",) and found.chosen.fit.values["place"] == 2


@pytest.mark.medium
def test_the_same_seed_gives_the_same_explanation(toy):
    toy = toy(bump=True, places=3).drawn(np.random.default_rng(5), {"E1": 1.2, "hung": 1.0, "at": 2.2, "place": 1})
    one, other = decide(toy), decide(replace(toy, count=[0]))
    assert one.verdict == other.verdict and one.credible == other.credible
    assert one.base_adequacy.p_family == other.base_adequacy.p_family
    assert [(t.names, t.ln_evidence) for t in one.candidate_fits] == [
        (t.names, t.ln_evidence) for t in other.candidate_fits
    ]
    assert one.chosen.fit.values == other.chosen.fit.values


@pytest.mark.medium
def test_earlier_evaluations_do_not_change_the_explanation(toy):
    """Evaluations made before do not matter."""
    toy = toy(signed=("E4",)).drawn(np.random.default_rng(1), {"E0": 1.2, "E4": -1.2})
    settings = Settings(budget=30)
    first = decide(toy, settings)
    assert first.verdict == "two_effects"
    for _ in range(3):
        assert decide(toy, settings).verdict == first.verdict


@pytest.mark.medium
def test_pairs_keep_their_part_of_the_budget(toy, monkeypatch):
    """Two effects are missing and single effects use up the budget: the pair is still named."""
    toy = toy(signed=("E4",)).drawn(np.random.default_rng(1), {"E0": 1.2, "E4": -1.2})
    whole, spent = decide(toy), []

    def telling(fits, *given):
        spent.append(fits.spent())
        return fit_pairs(fits, *given)

    monkeypatch.setattr("calib.missing.decision.fit_pairs", telling)
    found = decide(replace(toy, count=[0]), Settings(budget=6))
    assert spent == [True]
    assert found.verdict == whole.verdict == "two_effects" and set(found.credible) == set(whole.credible)


@pytest.mark.medium
def test_the_order_of_the_library_does_not_matter(toy):
    toy = toy(signed=("E0",)).drawn(np.random.default_rng(6), {"E0": -1.0, "E3": 0.9})
    one, other = decide(toy), decide(replace(toy, effects=toy.effects[::-1], perturbations=toy.perturbations[::-1]))
    assert one.verdict == other.verdict and set(one.credible) == set(other.credible)
    assert one.chosen.ln_evidence == pytest.approx(other.chosen.ln_evidence, abs=5e-3)


def test_a_base_model_that_cannot_be_solved_is_an_error(toy):
    with pytest.raises(EvaluationError):
        decide(replace(toy(), fails=lambda values: True))


def test_an_effect_that_can_never_be_solved_is_skipped(toy):
    """No grid point can be evaluated for an effect with a nuisance parameter, and no fit for one without."""
    toy = toy(bump=True).drawn(np.random.default_rng(8), {"E1": 1.5})
    toy = replace(toy, fails=lambda values: values.get("hung", 0.0) > 0 or values.get("E0", 0.0) > 0)
    found = decide(toy)
    assert found.verdict == "effect" and found.credible == ("E1",)


def test_refits_are_limited(toy):
    weak = toy(effects=9).drawn(np.random.default_rng(9), {"E1": 0.7})
    assert len(decide(weak, Settings(refits=3)).singles) == 3
    assert len(decide(weak).singles) == 6
    strong = toy(effects=9).drawn(np.random.default_rng(10), {"E1": 3.0})
    assert [t.names for t in decide(strong).singles] == [("E1",)]  # the predicted gain of the others is negligible


def test_evidence_does_not_depend_on_the_start(toy):
    toy = toy(bump=True).drawn(np.random.default_rng(10), {"hung": 1.5, "at": 2.6})
    found = decide(toy)
    fit_problem = toy.fit_problem(("hung",))
    misfits = [
        least_squares_fit(fit_problem, ("hung",), {**fit_problem.space.values, "hung": 1.0, "at": q}).misfit
        for q in np.linspace(0, 7, 15)
    ]
    assert found.chosen.fit.misfit == pytest.approx(min(misfits), abs=0.01)


@pytest.mark.slow
def test_the_second_best_point_of_a_grid_is_tried_too(toy):
    """The best grid point belongs to another effect; a fit from the second best may end lower."""
    toy = toy(bump=True, effects=1, perturbations=0)
    hung, bump = toy.effects[-1], toy.bumps["hung"]
    hung = replace(hung, grid=tuple({"hung": 2.0, "at": q} for q in (1.0, 4.4)))
    toy = replace(toy, effects=(toy.effects[0], hung), columns={**toy.columns, "decoy": bump.at({"at": 1.0})})
    rng, second = np.random.default_rng(1), 0
    for _ in range(10):
        one = toy.drawn(rng, {"hung": 2.0, "at": 5.4, "decoy": 1.4})
        found = decide(one)
        if found.noise_scale != 1.0:
            continue
        (candidate_fit,) = [t for t in found.singles if t.names == ("hung",)]
        fit_problem = one.fit_problem(("hung",))
        both = [least_squares_fit(fit_problem, ("hung",), {**found.base.fit.values, **point}) for point in hung.grid]
        assert candidate_fit.fit.misfit == pytest.approx(min(b.misfit for b in both), abs=0.06)
        best = found.base_adequacy.named.points[found.base_adequacy.named.best("hung")]
        second += best["at"] == 1.0 and candidate_fit.fit.values["at"] > 4.4
    assert second >= 1


def test_fits_start_where_a_linear_model_ends(toy):
    """Two for the base model, one for each fitted effect, perturbation and refinement, two to confirm the base."""
    toy = toy().drawn(np.random.default_rng(7), {"E1": 1.5})
    decide(toy)
    assert toy.evaluations <= 8


def test_the_base_fit_starts_at_the_best_neighbouring_integers(toy):
    """The nearer a place, the more similar its signature; a first fit from the wrong one absorbs much."""
    toy = toy(places=7, effects=2)
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(7), np.arange(7)) / 3.0) ** 2)
    toy = replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})
    for place in (1, 5, 6):
        for f in toy.explained({"place": place}, 3):
            assert f.base.fit.values["place"] == place and f.verdict == "nothing_detectable"


def test_integers_are_followed_by_fits_beyond_the_budget_up_to_a_limit(toy):
    """Two places off, the fit walks there; the nearer a place, the more similar its signature. No budget, no walk."""
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(7), np.arange(7)) / 3.0) ** 2)
    toy = toy(places=7, effects=2, curvature=0.05)
    toy = replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})
    made = toy.drawn(np.random.default_rng(2), {"place": 5})
    fits = Refits(made, Settings(budget=20), 1.0, silent)
    wrong = fits.candidate_fit((), {**made.base.values, "place": 3})
    before = fits.allowance.used
    found = fits.beside_whole(wrong)
    assert found.fit.values["place"] == 5 and found.fit.misfit < wrong.fit.misfit
    assert fits.allowance.used == before and made.evaluations > before + 10
    assert fits.beside_whole(found) is found
    assert Refits(made, Settings(budget=0), 1.0, silent).beside_whole(wrong) is wrong
    poor, before = Refits(made, Settings(budget=1), 1.0, silent), made.evaluations
    for _ in range(20):
        poor.beside_whole(wrong)
    spent = made.evaluations - before
    assert RULES.beyond < spent < RULES.beyond + 4 * RULES.least_residuals


SHORT = replace(FINE, iterations=1)
"""As many parameters need more iterations than there are."""


def test_fits_that_do_not_converge_at_once_are_continued_before_they_are_compared(toy):
    made = toy(curvature=0.3).correlated("E1", "E0", 0.97).drawn(np.random.default_rng(5), {"E0": 1.5})
    fits = Refits(made, Settings(budget=1), 1.0, silent)
    start = fits.candidate_fit(("E0",), {**made.base.values, "E0": 0.2}, settings=SHORT)
    assert not start.fit.converged
    before = fits.allowance.used
    finished = fits.finished(start)
    assert finished.fit.converged and finished.fit.misfit < start.fit.misfit and fits.allowance.used == before
    assert fits.finished(finished) is finished


def test_near_rivals_are_fitted_as_far_as_the_leader(toy):
    """Whichever is ahead at first, both are compared where they converge."""
    made = toy(curvature=0.3).correlated("E1", "E0", 0.97).drawn(np.random.default_rng(5), {"E0": 1.5})
    exact = {t.names: t.ln_evidence for t in decide(made).singles}
    fits = Refits(made, Settings(), 1.0, silent)
    starts = {"E0": 0.1, "E1": 1.5}
    ends = [fits.candidate_fit((n,), {**made.base.values, n: size}, settings=SHORT) for n, size in starts.items()]
    assert not any(one.fit.converged for one in ends)
    ranked = fits.settled(ends, 1e6)
    assert all(one.fit.converged for one in ranked) and ranked[0].ln_evidence >= ranked[1].ln_evidence
    for one in ranked:
        assert one.ln_evidence == pytest.approx(exact[one.names], abs=0.05)
    assert fits.settled(ends, -1.0)[0] in ends  # nothing is near to the best
