"""A single wrong datum as a competing model of an effect: indistinguishable, or told apart by other data."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.execution.stage import silent
from calib.missing.decision import Settings, decide
from calib.missing.evidence import ln_wrong
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.suspect import suspects_table, wrong_datum
from calib.missing.tables import effects_table
from calib.missing.verdict import verdict_of

PLACE = ("M3", "frequency")


def beside(toy, share):
    """The toy whose effect E2 moves one frequency, with a given share of its signature in the other data.

    Parameters move shapes only, so that the frequency shows it whole.
    """
    one = np.array([(row.mode, row.kind) == PLACE for row in toy.rows])
    rest = np.where(one, 0.0, np.random.default_rng(5).standard_normal(len(one)))
    column = 8.0 * (np.sqrt(1 - share**2) * one + share * rest / np.linalg.norm(rest))
    held = {p.name: np.where(one, 0.0, toy.columns[p.name]) for p in toy.base.parameters}
    return replace(toy, columns={**toy.columns, **held, "E2": column})


def spoilt(toy, rng, size):
    """Data of a complete model, the frequency moved by ``size`` standard deviations."""
    one = toy.drawn(rng)
    return replace(one, data=one.data + size * np.array([(row.mode, row.kind) == PLACE for row in toy.rows]))


@pytest.mark.medium
@pytest.mark.parametrize("share", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_a_wrong_datum_is_not_named_an_effect(toy, share):
    made, rng = beside(toy(), share), np.random.default_rng(1)
    found = [decide(spoilt(made, rng, 12.0)) for _ in range(10)]
    assert not [f for f in found if f.verdict in ("effect", "two_effects")]
    told = [f for f in found if f.verdict == "indistinguishable"]
    assert len(told) >= 8
    for f in told:
        assert f.datum.what == "frequency of M3" and f.equally_good[-1] == f.datum.in_words
        assert f.datum.ln_evidence > f.chosen.ln_evidence - RULES.credible and f.datum.p_fit > f.alpha
        # Of one value in a linear model, half of z^2 - 1 - ln z^2 with z the studentised difference.
        z2 = f.suspects.set_index("what").loc[f.datum.what, "chi2"]
        ln_bayes = f.datum.ln_evidence - f.base.ln_evidence
        assert ln_bayes == pytest.approx(0.5 * (z2 - 1 - np.log(z2)), abs=0.01)


@pytest.mark.medium
def test_the_odds_of_a_datum_that_is_far_off_are_bounded(toy):
    found = decide(spoilt(beside(toy(), 0.3), np.random.default_rng(1), 60.0))
    assert found.verdict == "indistinguishable" and found.datum.ln_evidence - found.chosen.ln_evidence > 60
    answer = verdict_of(found, effects_table(found, {}, {}), pd.DataFrame(columns=["group", "stage"])).answer
    assert found.datum.what in answer.found and " over 10,000:1." in answer.sure


def test_a_wrong_datum_is_weighed_beside_the_effects_that_a_model_has(toy):
    """E0 is large and in the model; a frequency is off. Without E0 the other data would not fit."""
    made = beside(toy(effects=4), 0.3)
    true = spoilt(made, np.random.default_rng(2), 12.0)
    true = replace(true, data=true.data + 6.0 * made.columns["E0"])
    fits = Refits(true, Settings(), 1.0, silent)
    base = fits.candidate_fit(("E0",), {**true.base.values, "E0": 6.0})
    accused = suspects_table(base.fit, true, 0.01)
    found = wrong_datum(fits, base, accused, base)
    assert found is not None and found.what == "frequency of M3" and found.ln_evidence > base.ln_evidence + 10


@pytest.mark.medium
def test_a_wrong_datum_is_fitted_although_the_budget_is_used_up(toy):
    made, rng = beside(toy(), 0.0), np.random.default_rng(1)
    for _ in range(5):
        found = decide(spoilt(made, rng, 12.0), Settings(budget=3))
        assert found.evaluations > 3
        assert found.verdict == "indistinguishable" and found.datum.what == "frequency of M3"


@pytest.mark.slow
def test_an_effect_on_one_datum_is_indistinguishable_from_a_wrong_datum(toy):
    found = beside(toy(), 0.0).explained({"E2": 1.5}, 10)
    assert Counter(f.verdict for f in found)["effect"] == 0
    assert sum(f.verdict == "indistinguishable" and f.credible == ("E2",) for f in found) >= 8
    for f in (f for f in found if f.datum is not None):
        assert f.odds_against_datum == pytest.approx(f.chosen.ln_evidence - f.datum.ln_evidence)


@pytest.mark.slow
def test_an_effect_on_other_data_too_stays_named(toy):
    """The datum alone then explains nothing, or much less than the effect."""
    found = beside(toy(), 0.5).explained({"E2": 1.5}, 10)
    named = [f for f in found if f.verdict == "effect" and f.credible == ("E2",) and f.datum is None]
    assert len(named) >= 9
    assert any(f.suspects["explains"].any() for f in found)  # it was tested, and explained less


@pytest.mark.medium
def test_effects_on_two_modes_stay_named(toy):
    assert all(f.datum is None for f in toy().explained({"E2": 1.5}, 10))


@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_of_a_wrong_datum_is_that_of_its_most_likely_size(seed):
    """Against densities of the predicted difference under many sizes."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    covariance = np.eye(4) + root @ root.T
    d = 6.0 * rng.standard_normal(4)

    def ln(variance):
        c = covariance + variance * np.eye(4)
        return -0.5 * (np.linalg.slogdet(c)[1] + d @ np.linalg.solve(c, d))

    found = ln_wrong(d, covariance)
    assert found == pytest.approx(max(ln(v) for v in np.geomspace(1e-4, 1e3, 4000)), abs=1e-4)
    assert ln_wrong(1e-3 * d, covariance) == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1], abs=1e-4)


@pytest.mark.medium
def test_a_datum_that_shifts_the_parameters_far_is_left_out_and_refitted(toy):
    """In a nonlinear model the predicted gain of a datum far off exceeds the whole misfit."""
    made, rng = beside(toy(curvature=0.05), 0.0), np.random.default_rng(2)
    found = [f for f in (decide(spoilt(made, rng, 30.0)) for _ in range(6)) if f.datum is not None]
    assert found
    for f in found:
        assert 2 * (f.datum.ln_evidence - f.base.ln_evidence) < f.base.fit.misfit
