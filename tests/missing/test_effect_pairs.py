"""Effects of the best pair are fitted alone too: a single fit may have ended far from its optimum."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.execution.stage import silent
from calib.missing.effect_pairs import no_worse, singles_from_pairs
from calib.missing.evidence import at_lower
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.settings import DEFAULT

TRUE = {"E0": 3.0, "E1": 0.25}
"""The second one is too small to be seen, and yet not at its limit."""
LITTLE = {"E2": 0.4}
"""The same of a third one."""


@pytest.fixture
def fits(toy):
    return Refits(toy(effects=3).drawn(np.random.default_rng(4), TRUE | LITTLE), DEFAULT, 1.0, silent)


@pytest.fixture
def base(fits):
    return fits.candidate_fit((), dict(fits.fit_problem(()).space.values))


@pytest.fixture
def pair(fits, base):
    found = fits.candidate_fit(("E0", "E1"), {**base.fit.values, **TRUE})
    assert not any(at_lower(found.fit, effect) for effect in found.effects)
    return found


def test_an_effect_whose_single_fit_stayed_at_zero_is_fitted_from_the_best_pair(fits, base, pair):
    singles = [fits.grown((name,), base) for name in ("E1", "E0")]
    found = singles_from_pairs(fits, base, singles, [pair])
    assert [one.names for one in found] == [("E0",), ("E1",)]
    assert found[0].ln_evidence > pair.ln_evidence
    assert found[0].fit.misfit < singles[1].fit.misfit - 100
    assert found[0].fit.values["E0"] == pytest.approx(3.0, abs=0.5)


def test_it_is_so_although_the_budget_is_spent(fits, base, pair):
    singles = [fits.grown((name,), base) for name in ("E1", "E0")]
    fits.allowance.most = 0.0
    assert fits.spent()
    assert singles_from_pairs(fits, base, singles, [pair])[0].names == ("E0",)


def test_nothing_is_fitted_where_the_pair_is_no_better_than_its_effect(fits, base, pair):
    single = fits.candidate_fit(("E0",), {**base.fit.values, "E0": 3.0})
    singles = [single, fits.grown(("E1",), base)]
    used = fits.hypotheses.evaluations
    assert singles_from_pairs(fits, base, singles, [pair]) is singles
    assert fits.hypotheses.evaluations == used


def test_every_pair_about_as_good_as_the_best_is_taken_apart(fits, base, pair, monkeypatch):
    """Effects alike make pairs alike: none of them may be forgotten."""
    other = fits.candidate_fit(("E0", "E2"), {**base.fit.values, "E0": 3.0, **LITTLE})
    assert abs(other.ln_evidence - pair.ln_evidence) < RULES.credible
    assert not any(at_lower(other.fit, effect) for effect in other.effects)
    singles = [fits.grown((name,), base) for name in ("E1", "E2", "E0")]
    tried, without = [], Refits.without

    def telling(fits, model, effect, base):
        tried.append((model.names, effect.name))
        return without(fits, model, effect, base)

    monkeypatch.setattr(Refits, "without", telling)
    singles_from_pairs(fits, base, singles, sorted([pair, other], key=lambda t: -t.ln_evidence))
    assert (("E0", "E1"), "E0") in tried and (("E0", "E2"), "E0") in tried


def test_a_pair_that_may_not_be_named_leaves_the_next_one_the_best(fits, base, pair):
    singles = [fits.grown((name,), base) for name in ("E1", "E0")]
    refused = replace(pair, effects=pair.effects[::-1], ln_evidence=pair.ln_evidence + 50.0, implausible="P0 is pulled")
    found = singles_from_pairs(fits, base, singles, [refused, pair])
    assert found[0].names == ("E0",)


def test_an_effect_that_cannot_be_solved_alone_is_left_as_it_was(fits, base, pair, monkeypatch):
    singles = [fits.grown((name,), base) for name in ("E1", "E0")]

    def fails(*given, **more):
        raise EvaluationError("it cannot be solved there")

    monkeypatch.setattr(Refits, "candidate_fit", fails)
    assert singles_from_pairs(fits, base, singles, [pair]) is singles


def test_a_pair_is_no_worse_than_an_effect_of_it_alone(fits, base, pair):
    single = fits.candidate_fit(("E0",), {**base.fit.values, "E0": 3.0})
    worse = fits.grown(("E0", "E2"), base)
    assert worse.fit.misfit > single.fit.misfit
    found = no_worse(fits, [worse, pair], [single])
    assert [one.names for one in found if one is not pair] == [("E0", "E2")] and pair in found
    assert max(one.fit.misfit for one in found) == single.fit.misfit
