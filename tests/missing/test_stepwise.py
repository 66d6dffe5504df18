"""Stepwise search for several effects, on toys whose truth is known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.execution.stage import silent
from calib.missing.adequacy import adequacy_of, beside
from calib.missing.decision import decide
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.settings import DEFAULT
from calib.missing.steps_table import WHY, step_fits, steps_sentence, steps_tables
from calib.missing.stepwise import Stepwise, further_price
from calib.missing.tables import effects_table
from calib.problem import degrees_of_freedom

pytestmark = pytest.mark.usefixtures("fewer_samples")
THREE = {"E0": 1.5, "E1": 1.2, "E2": 1.3}


def drawn(toy, truth, seed, **more):
    return toy(seed=seed, effects=10, perturbations=12, **more).drawn(np.random.default_rng(seed), truth)


def errors_of(found):
    """Made-up errors of every step, as an adapter gives them."""
    rows = [(stage, "fit", 5, 1.0, 1.0, 0.5, 0) for stage in step_fits(found)]
    return pd.DataFrame(rows, columns=["stage", "group", "rows", "rms", "expected", "p", "unpaired"])


# -- several effects ---------------------------------------------------------------------------------------------------


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("truth", [THREE, {**THREE, "E3": 1.6}])
def test_three_and_four_effects_are_named_and_no_other(toy, truth):
    for seed in range(2):
        found = decide(drawn(toy, truth, seed))
        assert found.verdict == "several_effects" and set(found.credible) == set(truth)
        for name, true in truth.items():
            value, std = found.chosen.magnitude(name)
            assert abs(value - true) < 4 * std
        assert found.steps.last.left_out == min(step.left_out for step in found.steps.steps)
        assert [step.candidate_fit.ln_evidence for step in found.steps.steps] == sorted(
            step.candidate_fit.ln_evidence for step in found.steps.steps
        )
        assert found.steps.last.candidate_fit is found.chosen and found.measured_scale < RULES.guard


@pytest.mark.slow
def test_of_three_effects_one_that_no_library_has_leaves_the_others_unnamed(toy):
    named = 0
    for seed in range(5):
        one = drawn(toy, THREE, seed)
        found = decide(replace(one, effects=tuple(e for e in one.effects if e.name != "E0")))
        assert set(found.credible) <= {"E1", "E2"}
        named += found.names_something
        if not found.names_something and found.steps is not None:
            assert steps_sentence(found) and not any(name in steps_sentence(found) for name in ("E1", "E2"))
    assert named <= 2


@pytest.mark.medium
def test_the_order_of_the_library_does_not_change_the_steps(toy):
    one = drawn(toy, THREE, 2)
    found, other = decide(one), decide(replace(one, effects=one.effects[::-1], count=[0]))
    assert set(found.credible) == set(other.credible) == set(THREE)
    assert [step.candidate_fit.names for step in found.steps.steps] == [
        step.candidate_fit.names for step in other.steps.steps
    ]


# -- rules of a step ---------------------------------------------------------------------------------------------------


def searched(one, *start):
    """The stepwise search from given effects, whatever the decision would do."""
    fits = Refits(one, DEFAULT, 1.0, silent)
    base = fits.candidate_fit((), one.base.values)
    able = sorted(one.effects, key=lambda e: e.name)
    adequacy = adequacy_of(fits, base, beside(fits, base, able))
    nominal = {e.name: e.plausible for e in able}
    first = fits.candidate_fit(start, {**base.fit.values, **{name: nominal[name] for name in start}})
    return Stepwise(fits, base, adequacy, able).steps(first)


def test_an_effect_that_stood_in_for_two_others_is_left_out_again(toy):
    one = toy(seed=1, effects=6, perturbations=12)
    own = one.columns["E4"] / 2
    one = replace(one, columns={**one.columns, "E4": one.columns["E0"] + one.columns["E1"] + own})
    one = one.drawn(np.random.default_rng(1), {"E0": 2.0, "E1": 2.0})
    found = searched(one, "E4")
    assert found.explains and set(found.last.candidate_fit.names) == {"E0", "E1"}
    assert any(t.what.name == "E4" and t.why == "no_longer_needed" for t in found.trials)


def test_a_search_stops_where_no_effect_has_evidence(toy):
    """What is left after one effect is a local perturbation."""
    one = drawn(toy, {"E0": 1.5, "A3": 1.5}, 3)
    found = searched(one, "E0")
    assert found.stopped == "rejected" and found.last.candidate_fit.names == ("E0",)
    assert {t.why for t in found.trials} == {"evidence"} and len(found.trials) >= RULES.further
    assert all(t.ln_bayes < further_price(9) and t.beside == ("E0",) for t in found.trials)


def test_an_effect_that_predicts_left_out_data_worse_is_not_taken_in(toy, monkeypatch):
    one = drawn(toy, THREE, 0)
    known = {}

    def worse(fits, candidate_fit):
        return known.setdefault(len(candidate_fit.names), 1.0 + len(candidate_fit.names))

    monkeypatch.setattr("calib.missing.stepwise.left_out_error", worse)
    found = searched(one, "E0")
    assert found.stopped == "rejected" and {t.why for t in found.trials} <= {"left_out", "evidence"}
    assert any(t.why == "left_out" for t in found.trials)


def test_no_effect_is_taken_in_that_leaves_fewer_than_two_degrees_of_freedom(toy, monkeypatch):
    one = drawn(toy, THREE, 0)
    first, second = (step.adequacy.dof for step in searched(one, "E0").steps[1:3])
    assert second < first - 0.5
    monkeypatch.setattr(degrees_of_freedom, "RULES", replace(degrees_of_freedom.RULES, least=first - 0.5))
    found = searched(one, "E0")
    assert found.stopped == "rejected" and found.last.candidate_fit.names == ("E0",)
    assert any(t.why == "dof" for t in found.trials) and {t.why for t in found.trials} <= {"dof", "evidence"}


def test_no_more_than_four_effects_are_taken_in(toy):
    truth = {f"E{k}": 1.5 for k in range(6)}
    found = searched(drawn(toy, truth, 1), "E0")
    assert found.stopped == "most" and len(found.last.candidate_fit.names) == RULES.most_effects


# -- what may be named -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_place_that_explains_as_well_as_one_of_the_effects_keeps_them_unnamed(toy):
    """The third cause is a local perturbation that an effect of the library resembles."""
    doubtful = 0
    for seed in (0, 3, 5):  # in others the place is collinear with the effect, or noise prefers the effect
        one = toy(seed=seed, effects=10, perturbations=12).correlated("E2", "A5", 0.9)
        found = decide(one.drawn(np.random.default_rng(seed), {"E0": 1.5, "E1": 1.3, "A5": 1.3}))
        assert not found.names_something
        doubtful += found.steps.stopped == "doubtful"
        assert any(t.what.name == "A5" and t.why == "local_perturbation" for t in found.steps.trials)
    assert doubtful == 3


@pytest.mark.medium
def test_a_collinear_effect_is_named_beside_the_one_taken_in(toy):
    one = toy(seed=2, effects=10, perturbations=12).correlated("E7", "E2", 0.9999)
    found = decide(one.drawn(np.random.default_rng(2), THREE))
    assert found.verdict == "several_effects" and set(found.credible) == {*THREE, "E7"}
    ((name, other),) = found.steps.competing
    assert {name, other} == {"E2", "E7"}


# -- tables ------------------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_tables_tell_every_step_and_every_rejection(toy):
    found = decide(drawn(toy, THREE, 1))
    tables = steps_tables(found, errors_of(found))
    steps, rejected = tables["steps"], tables["steps_rejected"]
    assert steps["step"].tolist() == list(range(len(found.steps.steps))) and steps["effects"].iloc[0] == "none"
    assert set(steps["effects"].iloc[-1].split(" + ")) == set(THREE)
    assert set(", ".join(filter(None, steps["added"])).split(", ")) == set(THREE) and not any(steps["left_again"])
    assert steps["ln_bayes"].iloc[-1] == pytest.approx(found.ln_bayes(found.chosen)) and steps["ln_bayes"].iloc[0] == 0
    assert steps["p_family"].iloc[0] < found.alpha < steps["p_family"].iloc[-1]
    assert tables["steps_errors"]["effects"].tolist() == steps["effects"].tolist()
    assert len(rejected) == len(found.steps.trials) > 0 and set(rejected["why"]) <= set(WHY.values())


@pytest.mark.medium
def test_effects_that_are_named_together_have_the_probability_of_their_model(toy):
    found = decide(drawn(toy, THREE, 1))
    table = effects_table(found, {}, {}).set_index("name")
    assert table.loc[list(THREE), "model_probability"].to_numpy() == pytest.approx(1.0, abs=1e-3)
    assert table.loc[list(THREE), "ln_bayes"].to_numpy() == pytest.approx(found.ln_bayes(found.chosen))
    assert (table.drop(list(THREE))["model_probability"] < 1e-3).all()


def test_one_effect_has_no_steps(toy):
    found = decide(drawn(toy, {"E0": 1.5}, 0))
    assert found.verdict == "effect" and found.steps is None and steps_tables(found, pd.DataFrame()) == {}


def test_a_pair_found_at_once_is_told_as_steps_too(toy):
    found = decide(drawn(toy, {"E0": 1.5, "E1": 1.2}, 0))
    assert found.verdict == "two_effects"
    assert [len(step.candidate_fit.names) for step in found.steps.steps] == [0, 1, 2]
