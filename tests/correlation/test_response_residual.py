"""Derivatives of scalar responses: the function's own where it returns them, differences elsewhere."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import EvaluationError
from calib.inference.gauss_newton import fit
from calib.problem.effect import Effect
from calib.problem.problem import PairProblem
from calib.problem.space import Parameter, ParameterSpace
from calib.results.ledger import Ledger
from calib.structure.function_model import FunctionModel, extend_function, slope_entry

SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 1.0, 0.0, 2.0)))
TARGETS = {"x": (4.0, 0.1), "y": (2.0, 0.5)}
AT = {"a": 2.0, "b": 1.0}


class Counted:
    """x = a^2 b, y = a + b with derivatives by a."""

    def __init__(self, *entries):
        self.entries, self.calls = entries, 0

    def __call__(self, values):
        self.calls += 1
        a, b = values["a"], values["b"]
        slopes = {slope_entry("x", "a"): 2 * a * b, slope_entry("y", "a"): 1.0}
        return {"x": a**2 * b, "y": a + b} | {entry: slopes[entry] for entry in self.entries}


BOTH = slope_entry("x", "a"), slope_entry("y", "a")


@pytest.mark.parametrize(("entries", "calls"), [(BOTH, 3), (BOTH[:1], 5), ((), 5)])
def test_derivatives_of_the_function_save_its_calls(entries, calls):
    function = Counted(*entries)
    residual = ResponseResidual(FunctionProblem(SPACE, function, TARGETS, ""))
    slope = residual.jacobian(AT, ["b", "a"])
    assert slope == pytest.approx(-np.array([[4.0, 4.0], [1.0, 1.0]]) / [[0.1], [0.5]], rel=1e-6)
    assert function.calls == calls


class Singular(ResponseResidual):
    """Whose derivative of y by b does not exist."""

    def slope(self, values, names, at):
        slope = super().slope(values, names, at)
        slope[1, [name == "b" for name in names]] = math.nan
        return slope


@pytest.mark.parametrize("stored", [False, True])
def test_a_derivative_that_is_not_finite_is_named(tmp_path, stored):
    store = Ledger.open(tmp_path / "ledger.sqlite") if stored else None
    problem = PairProblem(Singular(FunctionProblem(SPACE, Counted(), TARGETS, "")), SPACE, store)
    assert np.isfinite(problem.jacobian(AT, ["a"])).all()
    for attempt in (lambda: problem.jacobian(AT, ["a", "b"]), lambda: fit(problem, SPACE)):
        with pytest.raises(EvaluationError, match="response y by b"):
            attempt()


def test_an_integer_counts_as_fixed_also_with_a_derivative():
    space = ParameterSpace((replace(SPACE["a"], integer=True), SPACE["b"]))
    residual = ResponseResidual(FunctionProblem(space, Counted(*BOTH), TARGETS, ""))
    assert (residual.jacobian(AT, ["a"]) == 0).all()


def test_derivatives_of_a_function_are_not_those_of_an_effect_built_upon_it():
    base = FunctionModel("base", SPACE, Counted(*BOTH))
    wider = Parameter("wider", 0.0, 0.0, 1.0, prior_sd=0.1)

    def doubled(model):
        def responses(values):
            found = model.function({n: v for n, v in values.items() if n != "wider"})
            return {**found, "x": found["x"] * (1 + values["wider"])}

        return responses

    model = extend_function(base, [Effect("wider", "Wider", "It is not.", "Nothing.", wider, doubled)])
    residual = ResponseResidual(FunctionProblem(model.space, model.function, TARGETS, ""))
    slope = residual.jacobian({**AT, "wider": 0.5}, ["a"])
    assert slope[:, 0] == pytest.approx([-6.0 / 0.1, -1.0 / 0.5], rel=1e-6)
