"""Explanation of a function of scalar responses, against closed forms and with functions that fail."""

import math
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.function_hypotheses import function_hypotheses
from calib.correlation.function_problem import FunctionProblem
from calib.correlation.response_residual import ResponseResidual
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.function import FunctionModel
from calib.loading import module_of
from calib.missing.explain import Settings, explain
from calib.missing.rules import RULES
from calib.space import Parameter, ParameterSpace
from calib.study import Study

CHAIN = Path(__file__).resolve().parents[2] / "studies" / "five_mass_chain"
STD = 0.01
N, P, E = 14, 3, 5


def hypotheses_of(model, targets, space, effects, repeats=None, step=1e-4):
    """Hypotheses of a function against measured responses."""
    problem = FunctionProblem(model.space, model.function, targets, "", repeats)
    return function_hypotheses(model, ResponseResidual(problem, step), effects, space)[0]


class Counted:
    """A function that records every point it is called with, and may fail at some."""

    def __init__(self, inner, refuse=lambda values: False):
        self.inner, self.refuse, self.asked = inner, refuse, []

    def __call__(self, values):
        self.asked.append(tuple(sorted(values.items())))
        if self.refuse(values):
            raise ZeroDivisionError("no answer here")
        return self.inner(values)


def effect(name, build=lambda model: None, lower=-10.0, upper=10.0, **options):
    return Effect(name, name, "", "", Parameter(name, 0.0, lower, upper, prior_sd=1.0), build, **options)


class Linear:
    """``y = A theta + B size``: a linear Gaussian model, for which every result has a closed form."""

    def __init__(self, seed, magnitude=0.0, hidden=0):
        rng = np.random.default_rng(seed)
        self.a, self.b = rng.standard_normal((N, P)), 0.3 * rng.standard_normal((N, E))
        self.names = [f"r_{i}" for i in range(N)]
        theta, size = rng.standard_normal(P), np.zeros(E)
        size[hidden] = magnitude
        self.y = self.a @ theta + self.b @ size + STD * rng.standard_normal(N)
        parameters = [Parameter(f"t{k}", 0.0, -20.0, 20.0, prior_sd=1.0) for k in range(P)]
        self.space = ParameterSpace((*parameters, Parameter("held", 2.0, 0.0, 4.0, distribution="fixed")))
        self.held = 0.3 * rng.standard_normal(N)
        self.y = self.y + 2.0 * self.held
        self.function = Counted(self.answer)

    def answer(self, values):
        theta = np.array([values[f"t{k}"] for k in range(P)])
        size = np.array([values.get(f"e{k}", 0.0) for k in range(E)])
        return dict(zip(self.names, self.a @ theta + self.b @ size + values["held"] * self.held, strict=True))

    def hypotheses(self, **options):
        model = FunctionModel("linear", self.space, self.function)
        targets = {name: (float(v), STD) for name, v in zip(self.names, self.y, strict=True)}
        effects = tuple(effect(f"e{k}") for k in range(E))
        return hypotheses_of(model, targets, self.space, effects, **options)

    def closed_form(self):
        """Score, unabsorbed fraction and log Bayes factor of each effect, from the marginal density of the data."""
        r, a, b = (self.y - 2.0 * self.held) / STD, self.a / STD, self.b / STD
        c = np.eye(N) + a @ a.T
        inverse = np.linalg.inv(c)
        size = np.sqrt(np.einsum("ij,ik,kj->j", b, inverse, b))
        z = b.T @ inverse @ r / size

        def ln_density(covariance):
            return -0.5 * (r @ np.linalg.solve(covariance, r) + np.linalg.slogdet(covariance)[1])

        ln_bayes = np.array([ln_density(c + np.outer(g, g)) - ln_density(c) for g in b.T])
        return z, size / np.linalg.norm(b, axis=0), ln_bayes


# -- against closed forms ----------------------------------------------------------------------------------------------


def test_scores_are_those_of_the_marginal_distribution_of_linear_data():
    problem = Linear(0, 0.3)
    found = explain(problem.hypotheses()).base_adequacy
    z, unabsorbed, _ = problem.closed_form()
    assert found.named.owners == tuple(f"e{k}" for k in range(E))
    np.testing.assert_allclose(found.named.z, z, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(found.named.unabsorbed, unabsorbed, rtol=1e-5)


@pytest.mark.parametrize("hidden", range(E))
def test_the_verdict_is_that_of_exact_evidence(hidden):
    problem = Linear(10 + hidden, 0.3, hidden)
    found = explain(problem.hypotheses())
    *_, ln_bayes = problem.closed_form()
    order = np.argsort(-ln_bayes)
    assert order[0] == hidden and ln_bayes[order[0]] - ln_bayes[order[1]] > 10
    assert found.verdict == "effect" and found.credible == (f"e{hidden}",)
    for candidate_fit in found.singles:  # the others are fitted only roughly
        ours, exact = found.ln_bayes(candidate_fit), ln_bayes[int(candidate_fit.names[0][1:])]
        assert ours == pytest.approx(exact, abs=0.05 if candidate_fit is found.singles[0] else 0.5)


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing():
    verdicts = [explain(Linear(seed).hypotheses()).verdict for seed in range(100, 120)]
    assert verdicts == ["nothing_detectable"] * 20


def test_a_parameter_held_at_a_wrong_value_is_a_local_perturbation_and_no_named_effect():
    problem = Linear(5)
    problem.y = problem.y + 0.5 * problem.held
    found = explain(problem.hypotheses())
    assert found.verdict == "none_explains" and found.perturbation is not None
    assert found.perturbation.names == ("change of held",)
    assert found.perturbation.fit.values["change of held"] == pytest.approx(0.25, abs=0.02)


# -- derivatives -------------------------------------------------------------------------------------------------------


def curved(values):
    x, size = values["x"], values.get("size", 0.0)
    return {"a": math.exp(x), "b": x**2, "c": math.sin(size) + 3 * x, "d": x * size, "e": 1.0}


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
    problem = Linear(0, 0.3)
    hypotheses = problem.hypotheses()
    found = explain(hypotheses)
    asked = problem.function.asked
    # The check at magnitude 0 evaluates the same values with one name more.
    assert hypotheses.evaluations == len(asked) == len(set(asked)) == found.evaluations
    assert len(asked) < 150
    again = explain(hypotheses)
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
    one, other = (explain(Linear(3, 0.3).hypotheses()) for _ in range(2))
    assert one.chosen.fit.values == other.chosen.fit.values
    assert one.base_adequacy.p_family == other.base_adequacy.p_family and one.evaluations == other.evaluations


# -- functions that fail -----------------------------------------------------------------------------------------------


def test_failed_points_do_not_end_the_search():
    problem = Linear(0, 0.3)
    # One side of a difference quotient at the base fit fails, and every point with one effect.
    best = explain(problem.hypotheses()).base.fit.values["t1"]
    assert best > 0
    problem.function = Counted(problem.answer, lambda v: best < v["t1"] - 1e-3 < best + 4e-3 or v.get("e3", 0.0) != 0)
    hypotheses = problem.hypotheses()
    found = explain(hypotheses, Settings(refits=E))
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
        explain(problem.hypotheses())


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
        explain(hypotheses)


# -- rows and standard deviations --------------------------------------------------------------------------------------


def test_kinds_are_the_common_prefixes_of_names():
    names = ["freq_1", "freq_2", "shape_1_1", "shape_1_2", "mass_total", "stroke", "stroke_2", "_x", "_y"]
    model = FunctionModel("many", ParameterSpace((Parameter("x", 1.0, 0.0, 2.0),)), lambda v: {})
    hypotheses = hypotheses_of(model, {n: (1.0, 0.1) for n in names}, model.space, (effect("size"),), repeats=4)
    assert [row.sensor for row in hypotheses.rows] == names
    kinds = ["freq", "freq", "shape", "shape", *["response"] * 5]
    assert [row.kind for row in hypotheses.rows] == kinds and {row.mode for row in hypotheses.rows} == {""}
    assert hypotheses.std_dof == {"freq": 6.0, "shape": 6.0, "response": 15.0}
    assert hypotheses.fitted_factors == {}


def test_an_unknown_std_is_one_percent():
    model = FunctionModel("curved", ParameterSpace((Parameter("x", 1.0, 0.0, 2.0),)), curved)
    targets = {"a": (2.0, None), "b": (1.0, 0.5), "c": (1.0, 0.1), "d": (1.0, 0.1)}
    hypotheses = hypotheses_of(model, targets, model.space, (effect("size"),))
    residual = hypotheses.fit_problem(()).residual({"x": 0.0})
    np.testing.assert_allclose(residual[:2], [(2.0 - 1.0) / 0.02, 1.0 / 0.5])
    np.testing.assert_allclose(hypotheses.relative_std, [0.01, 0.5, 0.1, 0.1])
    assert set(hypotheses.std_dof.values()) == {math.inf}


@pytest.mark.parametrize(("count", "free"), [(3, 1), (4, 3), (5, 4)])
def test_too_few_responses_are_refused(count, free):
    space = ParameterSpace(tuple(Parameter(f"t{k}", 1.0, 0.0, 2.0) for k in range(free)))
    model = FunctionModel("few", space, lambda v: {})
    targets = {f"r{k}": (1.0, 0.1) for k in range(count)}
    with pytest.raises(InputError, match=f"{count} measured responses"):
        explain(hypotheses_of(model, targets, space, (effect("size"),)))
    enough = {f"r{k}": (1.0, 0.1) for k in range(max(4, free + 2))}
    with pytest.raises(EvaluationError):  # enough responses: the model is evaluated, and fails
        explain(hypotheses_of(model, enough, space, (effect("size"),)))


def test_every_held_input_and_every_response_has_a_local_perturbation():
    space = ParameterSpace(
        (
            Parameter("free", 1.0, 0.0, 2.0),
            Parameter("held", 2.0, 0.0, 4.0, distribution="fixed"),
            Parameter("nothing", 0.0, -1.0, 3.0, distribution="fixed"),
            Parameter("void", 0.0, 0.0, 0.0, distribution="fixed"),
            Parameter("count", 3.0, 1.0, 4.0, distribution="fixed", integer=True),
        )
    )
    model = FunctionModel("x", space, lambda v: {f"r{k}": v["held"] + k + v["nothing"] for k in range(4)})
    hypotheses = hypotheses_of(model, {f"r{k}": (3.0, 1.0) for k in range(4)}, space, (effect("size"),))
    perturbations = {a.name: a for a in hypotheses.perturbations}
    assert list(perturbations) == ["change of held", "change of nothing", *(f"offset of r{k}" for k in range(4))]
    assert all(a.signed for a in perturbations.values()) and perturbations["change of held"].plausible == 0.3
    assert [a.part for a in perturbations.values()] == ["held", *[""] * 5]
    base = np.array([1.0, 0.0, -1.0, -2.0])
    for name, size, expected in (
        ("change of held", 0.5, base - 1),
        ("change of nothing", 0.25, base - 1),
        ("offset of r2", 0.5, base - [0, 0, 1.5, 0]),
    ):
        residual = hypotheses.fit_problem((name,)).residual({"free": 1.0, name: size})
        np.testing.assert_allclose(residual, expected)
    with pytest.raises(InputError, match="no effect 'unknown'"):
        hypotheses.fit_problem(("unknown",))


def test_fitted_parameters_have_a_local_perturbation_in_one_group_of_responses():
    space = ParameterSpace((Parameter("k", 2.0, 0.0, 4.0), Parameter("about", 0.0, -1.0, 1.0)))
    asked = []

    def answer(v):
        asked.append(v)
        return {"freq_1": v["k"], "freq_2": 2 * v["k"], "damping_1": v["k"] + v["about"], "damping_2": v["about"]}

    targets = {"freq_1": (2.0, 1.0), "freq_2": (4.0, 1.0), "damping_1": (2.0, 1.0), "damping_2": (0.0, 1.0)}
    hypotheses = hypotheses_of(FunctionModel("x", space, answer), targets, space, (effect("size"),))
    assert [a.name for a in hypotheses.perturbations] == [
        "change of k in freq", "change of k in damping", "change of about in freq", "change of about in damping",
        "offset of freq", "scale of freq", "offset of damping", "scale of damping",
    ]  # fmt: skip
    point = {"k": 2.0, "about": 0.0}
    for name, size, expected in (
        ("change of k in freq", 0.5, [-1, -2, 0, 0]),
        ("change of k in damping", 0.5, [0, 0, -1, 0]),
        ("change of about in damping", 0.5, [0, 0, -1, -1]),
        ("offset of freq", 0.1, [-0.3, -0.3, 0, 0]),
        ("scale of freq", 0.1, [-0.2, -0.4, 0, 0]),
    ):
        np.testing.assert_allclose(
            hypotheses.fit_problem((name,)).residual({**point, name: size}), expected, atol=1e-12
        )
    # All groups of responses share the points at which a parameter is changed.
    before = len(asked)
    hypotheses.fit_problem(()).jacobian(point, [a.name for a in hypotheses.perturbations])
    assert len(asked) == before + 2 * 2 and hypotheses.evaluations == len(asked)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_damping_measured_too_high_is_not_a_damper(seed):
    """For a function without fixed parameters; a damper to the ground would explain most of the error."""
    study = Study.load(CHAIN)
    twin = module_of(CHAIN / "make_twin.py")
    held = {p.name: p.value for p in study.search_space.parameters if p.distribution == "fixed"}
    space = ParameterSpace(study.search_space.free)
    model = FunctionModel("bare chain", space, lambda values: study.model.function(held | dict(values)))
    rng = np.random.default_rng([seed, *b"damping"])
    exact = twin.twin_responses(twin.draw(rng, ""))
    off = rng.uniform(0.003, 0.010)
    targets = twin.measure({n: v + off * n.startswith("damping") for n, v in exact.items()}, rng)
    found = explain(hypotheses_of(model, targets, space, study.candidates, repeats=10), Settings(budget=np.inf))
    assert found.verdict == "none_explains" and found.credible == ()


def bare_chain(seed, hidden, fault="", offset=(0.0, 0.0)):
    """A bare chain with an effect, or a measurement error in one kind of response, as in the benchmark of rates."""
    study, twin = Study.load(CHAIN), module_of(CHAIN / "make_twin.py")
    held = {p.name: p.value for p in study.search_space.parameters if p.distribution == "fixed"}
    space = ParameterSpace(study.search_space.free)
    model = FunctionModel("bare chain", space, lambda values: study.model.function(held | dict(values)))
    rng = np.random.default_rng([seed, *(hidden or fault).encode()])
    exact = twin.twin_responses(twin.draw(rng, hidden))
    kind, off = fault.partition(" ")[0], rng.uniform(*offset) if fault else 0.0
    off_kind = {"damping": "damping", "frequency": "freq"}.get(kind)
    targets = twin.measure({n: v + off * (n.split("_")[0] == off_kind) for n, v in exact.items()}, rng)
    return explain(hypotheses_of(model, targets, space, study.candidates, repeats=10), Settings(budget=np.inf))


@pytest.mark.parametrize(
    ("seed", "fault", "offset", "effect"),
    [
        pytest.param(4, "damping too high", (0.003, 0.010), "ground_damper_5", marks=pytest.mark.slow),
        (8, "damping too high", (0.003, 0.010), "ground_damper_5"),
        (11, "frequency too high", (0.05, 0.20), "ground_spring_3"),
        (23, "frequency too high", (0.05, 0.20), "ground_spring_3"),
    ],
)
def test_a_measurement_fault_that_explains_as_well_is_named_beside_the_effect(seed, fault, offset, effect):
    found = bare_chain(seed, "", fault, offset)
    own = f"offset of {'freq' if fault.startswith('freq') else 'damping'}"
    assert found.verdict == "indistinguishable" and found.untold == (effect, own)
    assert abs(found.fault.ln_evidence - found.chosen.ln_evidence) < RULES.credible


@pytest.mark.slow
def test_a_true_damper_and_damping_measured_too_high_are_indistinguishable():
    found = bare_chain(2, "ground_damper_5")
    assert found.verdict == "indistinguishable" and found.untold == ("ground_damper_5", "offset of damping")
    other = bare_chain(2, "ground_spring_3")
    assert other.verdict == "effect" and other.untold == ("ground_spring_3",) and other.fault is None


def test_a_perturbed_parameter_is_perturbed_in_effects_too():
    def pulled(model):
        return lambda v: {n: r + v["size"] * v["held"] for n, r in model.function(v).items()}

    space = ParameterSpace((Parameter("x", 1.0, 0.0, 2.0), Parameter("held", 2.0, 0.0, 4.0, distribution="fixed")))
    model = FunctionModel("x", space, lambda v: {f"r{k}": 0.0 for k in range(4)})
    hypotheses = hypotheses_of(model, {f"r{k}": (0.0, 1.0) for k in range(4)}, space, (effect("size", pulled),))
    fit_problem = hypotheses.fit_problem(("change of held", "size"))
    np.testing.assert_allclose(fit_problem.residual({"size": 1.0, "change of held": 0.5}), -3.0)
