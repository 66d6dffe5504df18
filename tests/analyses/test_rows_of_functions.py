"""Rows, standard deviations and local perturbations of a function of scalar responses."""

import math

import numpy as np
import pytest

from calib.errors.errors import EvaluationError, InputError
from calib.missing.decision import Settings, decide
from calib.missing.rules import RULES
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel
from calib.study.loading import module_of
from calib.study.study import LoadedStudy
from tests.analyses.function_toys import CHAIN, curved, effect, hypotheses_of

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
        decide(hypotheses_of(model, targets, space, (effect("size"),)))
    enough = {f"r{k}": (1.0, 0.1) for k in range(max(4, free + 2))}
    with pytest.raises(EvaluationError):  # enough responses: the model is evaluated, and fails
        decide(hypotheses_of(model, enough, space, (effect("size"),)))


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
    study = LoadedStudy.load(CHAIN)
    twin = module_of(CHAIN / "make_twin.py")
    held = {p.name: p.value for p in study.search_space.parameters if p.distribution == "fixed"}
    space = ParameterSpace(study.search_space.free)
    model = FunctionModel("bare chain", space, lambda values: study.model.function(held | dict(values)))
    rng = np.random.default_rng([seed, *b"damping"])
    exact = twin.twin_responses(twin.draw(rng, ""))
    off = rng.uniform(0.003, 0.010)
    targets = twin.measure({n: v + off * n.startswith("damping") for n, v in exact.items()}, rng)
    found = decide(hypotheses_of(model, targets, space, study.candidates, repeats=10), Settings(budget=np.inf))
    assert found.verdict == "none_explains" and found.credible == ()


def bare_chain(seed, hidden, fault="", offset=(0.0, 0.0)):
    """A bare chain with an effect, or a measurement error in one kind of response, as in the benchmark of rates."""
    study, twin = LoadedStudy.load(CHAIN), module_of(CHAIN / "make_twin.py")
    held = {p.name: p.value for p in study.search_space.parameters if p.distribution == "fixed"}
    space = ParameterSpace(study.search_space.free)
    model = FunctionModel("bare chain", space, lambda values: study.model.function(held | dict(values)))
    rng = np.random.default_rng([seed, *(hidden or fault).encode()])
    exact = twin.twin_responses(twin.draw(rng, hidden))
    kind, off = fault.partition(" ")[0], rng.uniform(*offset) if fault else 0.0
    off_kind = {"damping": "damping", "frequency": "freq"}.get(kind)
    targets = twin.measure({n: v + off * (n.split("_")[0] == off_kind) for n, v in exact.items()}, rng)
    return decide(hypotheses_of(model, targets, space, study.candidates, repeats=10), Settings(budget=np.inf))


@pytest.mark.medium
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
    assert found.verdict == "indistinguishable" and found.equally_good == (effect, own)
    assert abs(found.fault.ln_evidence - found.chosen.ln_evidence) < RULES.credible


@pytest.mark.slow
def test_a_true_damper_and_damping_measured_too_high_are_indistinguishable():
    found = bare_chain(2, "ground_damper_5")
    assert found.verdict == "indistinguishable" and found.equally_good == ("ground_damper_5", "offset of damping")
    other = bare_chain(2, "ground_spring_3")
    assert other.verdict == "effect" and other.equally_good == ("ground_spring_3",) and other.fault is None


def test_a_perturbed_parameter_is_perturbed_in_effects_too():
    def pulled(model):
        return lambda v: {n: r + v["size"] * v["held"] for n, r in model.function(v).items()}

    space = ParameterSpace((Parameter("x", 1.0, 0.0, 2.0), Parameter("held", 2.0, 0.0, 4.0, distribution="fixed")))
    model = FunctionModel("x", space, lambda v: {f"r{k}": 0.0 for k in range(4)})
    hypotheses = hypotheses_of(model, {f"r{k}": (0.0, 1.0) for k in range(4)}, space, (effect("size", pulled),))
    fit_problem = hypotheses.fit_problem(("change of held", "size"))
    np.testing.assert_allclose(fit_problem.residual({"size": 1.0, "change of held": 0.5}), -3.0)
