"""Explanation of a function of scalar responses, against closed forms and with functions that fail."""

import math

import numpy as np
import pytest

import calib
from calib.errors.errors import EvaluationError, InputError
from calib.missing.decision import Settings, decide
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel
from tests.analyses.function_toys import STD, Counted, E, Linear, curved, effect, hypotheses_of

# -- against closed forms ----------------------------------------------------------------------------------------------


def test_scores_are_those_of_the_marginal_distribution_of_linear_data():
    problem = Linear(0, 0.3)
    found = decide(problem.hypotheses()).base_adequacy
    z, unabsorbed, _ = problem.closed_form()
    assert found.named.owners == tuple(f"e{k}" for k in range(E))
    np.testing.assert_allclose(found.named.z, z, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(found.named.unabsorbed, unabsorbed, rtol=1e-5)


@pytest.mark.parametrize("hidden", range(E))
def test_the_verdict_is_that_of_exact_evidence(hidden):
    problem = Linear(10 + hidden, 0.3, hidden)
    found = decide(problem.hypotheses())
    *_, ln_bayes = problem.closed_form()
    order = np.argsort(-ln_bayes)
    assert order[0] == hidden and ln_bayes[order[0]] - ln_bayes[order[1]] > 10
    assert found.verdict == "effect" and found.credible == (f"e{hidden}",)
    for candidate_fit in found.singles:  # the others are fitted only roughly
        ours, exact = found.ln_bayes(candidate_fit), ln_bayes[int(candidate_fit.names[0][1:])]
        assert ours == pytest.approx(exact, abs=0.05 if candidate_fit is found.singles[0] else 0.5)


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing():
    verdicts = [decide(Linear(seed).hypotheses()).verdict for seed in range(100, 120)]
    assert verdicts == ["nothing_detectable"] * 20


@pytest.mark.medium
def test_a_parameter_held_at_a_wrong_value_is_a_local_perturbation_and_no_named_effect():
    problem = Linear(5)
    problem.y = problem.y + 0.5 * problem.held
    found = decide(problem.hypotheses())
    assert found.verdict == "none_explains" and found.perturbation is not None
    assert found.perturbation.names == ("change of held",)
    assert found.perturbation.fit.values["change of held"] == pytest.approx(0.25, abs=0.02)


# -- derivatives -------------------------------------------------------------------------------------------------------


def curved_hypotheses(function=curved, **options):
    model = FunctionModel("curved", ParameterSpace((Parameter("x", 1.0, 0.0, 2.0),)), function)
    targets = {name: (1.0, 0.1) for name in "abcde"}
    return hypotheses_of(model, targets, model.space, (effect("size", lower=0.0),), **options)


def test_derivatives_inside_and_at_the_limits_and_of_effects_outside_the_model():
    fit_problem = curved_hypotheses().fit_problem(())
    for x in (0.0, 1.0, 2.0):
        slope = fit_problem.jacobian({"x": x}, ["x", "size"])
        exact = -np.array([[math.exp(x), 0], [2 * x, 0], [3, 1], [0, x], [0, 0]]) / 0.1
        np.testing.assert_allclose(slope, exact, atol=1e-6 if x == 1.0 else 2e-2)
    both = curved_hypotheses().fit_problem(("size",))
    np.testing.assert_allclose(both.jacobian({"x": 1.0, "size": 2.0}, ["size"])[2, 0], -math.cos(2.0) / 0.1, rtol=1e-6)


def test_the_function_is_never_evaluated_beyond_a_limit():
    function = Counted(curved, refuse=lambda v: not 0 <= v["x"] <= 2 or v.get("size", 0.0) < 0)
    hypotheses = curved_hypotheses(function)
    for x in (0.0, 2.0):
        hypotheses.fit_problem(("size",)).jacobian({"x": x}, ["x", "size"])
    assert hypotheses.failures == ()


def test_the_step_is_an_argument():
    rough = curved_hypotheses(step=0.1).fit_problem(()).jacobian({"x": 1.0}, ["x"])[0, 0]
    assert rough == pytest.approx(-10 * math.e * math.sinh(0.2) / 0.2, rel=1e-9)


# -- evaluations -------------------------------------------------------------------------------------------------------


def test_every_call_is_counted_and_none_is_made_twice():
    problem = Linear(0, 0.05)  # whose base fit does not leave a multiple of the rows, so that no budget ends a search
    hypotheses = problem.hypotheses()
    found = decide(hypotheses)
    asked = problem.function.asked
    # The check at magnitude 0 evaluates the same values with one name more.
    assert hypotheses.evaluations == len(asked) == len(set(asked)) == found.evaluations
    assert len(asked) < 150
    again = decide(hypotheses)
    assert hypotheses.evaluations == found.evaluations and again.verdict == found.verdict


def test_the_results_of_a_decision_evaluate_no_point_twice():
    problem = Linear(0, 0.3)
    model = FunctionModel("linear", problem.space, problem.function)
    targets = {name: (float(v), STD) for name, v in zip(problem.names, problem.y, strict=True)}
    test = calib.ResponseTest(targets, held_out=problem.names[:2])
    why = calib.Problem(model, test).explain([effect(f"e{k}") for k in range(E)])
    asked = problem.function.asked
    assert why.errors["group"].eq("held_out_responses").any()
    assert len(asked) == len(set(asked)) >= why.explanation.explanation.evaluations > 30


def test_fit_problems_share_their_common_points():
    hypotheses = curved_hypotheses()
    hypotheses.fit_problem(("size",)).residual({"x": 0.5, "size": 0.0})
    hypotheses.fit_problem(()).residual({"x": 0.5})
    assert hypotheses.evaluations == 1
    hypotheses.fit_problem(()).jacobian({"x": 0.5}, ["x"])
    assert hypotheses.evaluations == 3
    hypotheses.fit_problem(("size",)).residual({"x": 0.5, "size": 1.0})
    assert hypotheses.evaluations == 3 + 3  # the point, and the check at magnitude 0


def test_an_explanation_is_reproducible_to_the_digit():
    one, other = (decide(Linear(3, 0.3).hypotheses()) for _ in range(2))
    assert one.chosen.fit.values == other.chosen.fit.values
    assert one.base_adequacy.p_family == other.base_adequacy.p_family and one.evaluations == other.evaluations


# -- functions that fail -----------------------------------------------------------------------------------------------


def test_failed_points_do_not_end_the_search():
    problem = Linear(0, 0.3)
    # One side of a difference quotient at the base fit fails, and every point with one effect.
    best = decide(problem.hypotheses()).base.fit.values["t1"]
    assert best > 0
    problem.function = Counted(problem.answer, lambda v: best < v["t1"] - 1e-3 < best + 4e-3 or v.get("e3", 0.0) != 0)
    hypotheses = problem.hypotheses()
    found = decide(hypotheses, Settings(refits=E))
    assert found.verdict == "effect" and found.credible == ("e0",)
    assert "e3" not in [t.names[0] for t in found.singles]
    assert found.base_adequacy.named.size[3] == 0
    assert any(f.effects == ("e3",) and "ZeroDivisionError" in f.outcome.error for f in hypotheses.failures)
    assert any(f.effects == () and f.outcome.values["t1"] > best for f in hypotheses.failures)
    assert hypotheses.evaluations == len(problem.function.asked)


def test_a_base_model_that_always_fails_is_reported():
    problem = Linear(0)
    problem.function = Counted(problem.answer, lambda v: True)
    with pytest.raises(EvaluationError, match="no answer here"):
        decide(problem.hypotheses())


def test_a_response_that_is_missing_or_not_finite_is_a_failed_point():
    for broken in ({"a": 1.0}, {n: math.nan for n in "abcde"}, {n: "x" for n in "abcde"}):
        hypotheses = curved_hypotheses(lambda values, broken=broken: broken)
        with pytest.raises(EvaluationError):
            hypotheses.fit_problem(()).residual({"x": 1.0})
        assert hypotheses.evaluations == len(hypotheses.failures) == 1


def test_an_effect_that_changes_the_model_at_magnitude_0_is_refused():
    def jump(model):
        return lambda values: {n: v + 1e-3 for n, v in model.function(values).items()}

    model = FunctionModel("curved", ParameterSpace((Parameter("x", 1.0, 0.0, 2.0),)), curved)
    targets = {name: (1.0, 0.1) for name in "abcde"}
    hypotheses = hypotheses_of(model, targets, model.space, (effect("jump", jump),))
    with pytest.raises(InputError, match=r"effect jump.*0\.01 standard deviations"):
        decide(hypotheses)
