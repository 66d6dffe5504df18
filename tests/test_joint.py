"""Several tests of models with parameters in common: closed forms, conditions, and refused input."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.inference.integers import fit_mixed
from calib.problem.joint import JointProblem, joined
from calib.problem.prior import Prior
from calib.problem.problem import PairProblem
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace

TRUTH = {"k": 40.0, "m": 10.0}


def parameter(name, value=5.0, lower=0.0, upper=10.0, **options):
    return Parameter(name, value, lower, upper, **options)


def linear(names, rows, seed, **options):
    """A test of a linear model: its rows, the numbers behind them, and the problem."""
    rng = np.random.default_rng(seed)
    matrix, target = rng.standard_normal((rows, len(names))), rng.standard_normal(rows)
    space = ParameterSpace(tuple(parameter(n, **options) for n in names))

    def function(values):
        return {f"r_{i}": float(row @ [values[n] for n in names]) for i, row in enumerate(matrix)}

    targets = {f"r_{i}": (float(t), 1.0) for i, t in enumerate(target)}
    return matrix, target, PairProblem(ResponseResidual(FunctionProblem(space, function, targets, "")), space)


def resonance(load=0.0):
    """The natural frequency of a mass on a spring, with a load on it that is a condition of the test."""
    space = ParameterSpace(
        (
            parameter("k", 30.0, 1.0, 100.0, unit="kN/m"),
            parameter("m", 7.0, 1.0, 50.0, unit="kg"),
            parameter("load", 0.0, 0.0, 100.0, unit="kg"),
        )
    )

    def function(values):
        return {"f": float(np.sqrt(1e3 * values["k"] / (values["m"] + values["load"])) / (2 * np.pi))}

    told = function({**TRUTH, "load": load})
    held = FunctionProblem(space.freeze({"load": load}), function, {"f": (told["f"], 1e-3 * told["f"])}, "")
    return PairProblem(ResponseResidual(held), space.without({"load": load}))


# -- closed forms ------------------------------------------------------------------------------------------------------


def test_a_joint_fit_is_that_of_all_rows_and_adds_information():
    names = ("a", "b", "c")
    (first, one, p), (second, other, q) = (
        linear(("a", "b"), 6, 1, lower=-90.0, upper=100.0),
        linear(("c", "a"), 5, 2, lower=-90.0, upper=100.0),
    )
    joint = JointProblem({"one": p, "other": q})
    assert joint.space.names == names
    stacked = np.zeros((11, 3))
    stacked[:6, [0, 1]], stacked[6:, [2, 0]] = first, second
    at = {"a": 1.0, "b": -2.0, "c": 3.0}
    np.testing.assert_allclose(joint.residual(at), np.r_[one, other] - stacked @ list(at.values()), rtol=1e-9)
    np.testing.assert_allclose(joint.jacobian(at, names), -stacked, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(joint.jacobian(at, ("c", "b")), -stacked[:, [2, 1]], rtol=1e-7, atol=1e-9)
    best = np.linalg.lstsq(stacked, np.r_[one, other], rcond=None)[0]
    found = fit(joint, joint.space, {}, Prior.none())
    np.testing.assert_allclose([found.values[n] for n in names], best, atol=1e-4)
    told = posterior(names, found.jacobian, np.full(3, np.inf))
    alone = [
        posterior(n, s.jacobian({}, n), np.full(2, np.inf)).covariance[k, k] for s, n, k in ((p, "ab", 0), (q, "ca", 1))
    ]
    assert told.std[0] ** -2 == pytest.approx(sum(1 / v for v in alone), rel=1e-6)  # b and c are of one test each


def test_the_order_of_tests_does_not_matter():
    p, q = (linear(("a", "b"), 6, 1)[2], linear(("b", "c"), 5, 2)[2])
    one, other = JointProblem({"p": p, "q": q}), JointProblem({"q": q, "p": p})
    assert {*one.space.parameters} == {*other.space.parameters}
    found = [fit_mixed(j, j.space).best for j in (one, other)]
    for name in "abc":
        assert found[0].values[name] == pytest.approx(found[1].values[name], rel=1e-7)
    assert one.responses({"a": 1.0}) == other.responses({"a": 1.0})


def test_two_conditions_identify_what_one_cannot():
    """One frequency determines k/m only; with a known load a second one determines both."""
    empty, loaded = resonance(), resonance(25.0)
    joint = JointProblem({"empty": empty, "loaded": loaded})
    found = fit(joint, joint.space, {}, Prior.none())
    assert (found.values["k"], found.values["m"]) == pytest.approx((40.0, 10.0), rel=1e-4)
    assert set(joint.space.names) == {"k", "m"}
    assert not np.isfinite(posterior("km", empty.jacobian(TRUTH, "km"), np.full(2, np.inf)).std).any()
    assert joint.responses(TRUTH)["loaded: f"] == pytest.approx(joint.responses(TRUTH)["empty: f"] * np.sqrt(10 / 35))


# -- rows, counts and errors -------------------------------------------------------------------------------------------


def test_degrees_of_freedom_behind_the_standard_deviation_are_those_of_all_tests():
    p, q = (linear(("a",), n, n)[2] for n in (4, 12))
    given = [replace(x, pair=replace(x.pair, problem=replace(x.pair.problem, repeats=r))) for x, r in ((p, 3), (q, 5))]
    each = [dict(x.std_dof)["r"] for x in given]
    assert each == [8.0, 48.0]
    joint = JointProblem({"p": given[0], "q": given[1]})
    assert joint.std_dof["r"] == pytest.approx(16**2 / (4**2 / 8 + 12**2 / 48))
    assert JointProblem({"p": p, "q": q}).std_dof["r"] >= 1e9


def test_counts_are_those_of_all_tests_once():
    p = linear(("a",), 3, 1)[2]
    q = replace(linear(("a",), 3, 2)[2], counts=p.counts)
    joint = JointProblem({"p": p, "q": q})
    joint.residual({"a": 1.0})
    joint.residual({"a": 1.0})
    assert (joint.counts.solved, joint.counts.reused, joint.counts.asked) == (2, 2, 4)


def test_a_failure_names_its_test():
    good, bad = linear(("a",), 3, 1)[2], linear(("a",), 3, 2)[2]
    bad = replace(bad, pair=replace(bad.pair, problem=replace(bad.pair.problem, function=lambda v: {})))
    joint = JointProblem({"shaker": good, "drop": bad})
    for ask in (joint.residual, joint.responses, lambda values: joint.jacobian(values, ("a",))):
        with pytest.raises(EvaluationError) as told:
            ask({"a": 1.0})
        assert str(told.value).startswith("drop: ")


# -- one space ---------------------------------------------------------------------------------------------------------


def test_limits_constraints_and_free_parameters_are_joined():
    limit = LinearConstraint("sum", (("a", 1.0), ("b", 1.0)), 0.0, 9.0)
    one = ParameterSpace((parameter("a", 2.0, 0.0, 6.0), parameter("b", distribution="fixed")), (limit,))
    other = ParameterSpace((parameter("b", 6.0, 1.0, 8.0, prior_sd=0.5), parameter("a", 9.0, 3.0, 20.0)), (limit,))
    found = joined({"one": one, "other": other})
    a, b = found["a"], found["b"]
    assert (a.lower, a.upper, a.value, a.prior_width) == (3.0, 6.0, 3.0, one["a"].prior_width)
    assert (b.lower, b.upper, b.value, b.prior_sd, b.distribution) == (1.0, 8.0, 6.0, 0.5, "uniform")
    assert found.constraints == (limit,)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (parameter("a", unit="kg"), parameter("a", unit="t")),
        (parameter("a", integer=True), parameter("a")),
        (parameter("a", 2.0, 0.0, 3.0), parameter("a", 5.0, 4.0, 6.0)),
        (parameter("a", 2.0, distribution="fixed"), parameter("a", 3.0, distribution="fixed")),
    ],
)
def test_inconsistent_shared_parameters_are_refused(one, other):
    with pytest.raises(InputError) as told:
        joined({"rig": ParameterSpace((one,)), "track": ParameterSpace((other,))})
    assert all(word in str(told.value) for word in ("a", "rig", "track"))


def test_no_problem_and_values_that_no_test_shares_are_refused():
    joint = JointProblem({"empty": resonance(), "loaded": resonance(25.0)})
    for wrong in (lambda: JointProblem({}), lambda: joint.residual({"load": 3.0})):
        with pytest.raises(InputError):
            wrong()


def test_a_space_without_parameters_keeps_constraints_at_their_values():
    limit = LinearConstraint("sum", (("a", 2.0), ("b", 1.0)), 1.0, 9.0)
    space = ParameterSpace((parameter("a"), parameter("b")), (limit,))
    found = space.without({"a": 3.0})
    assert found.names == ("b",) and found.constraints == (LinearConstraint("sum", (("b", 1.0),), -5.0, 3.0),)
    assert space.without({"a": 1.0, "b": 2.0}).constraints == ()
    with pytest.raises(InputError):
        space.without({"c": 1.0})
