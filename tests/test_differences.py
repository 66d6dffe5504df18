"""Finite-difference derivatives against closed forms, at limits and where the model fails."""

import math

import numpy as np
import pytest

from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import EvaluationError, InputError
from calib.inference.gauss_newton import fit
from calib.problem.differences import central_jacobian, difference
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace

WHOLE = Parameter("n", 4.0, 2.0, 8.0, integer=True)


def box(n):
    return ParameterSpace(tuple(Parameter(f"p{k}", 1.0, 0.0, 4.0, prior_sd=0.7) for k in range(n)))


def responses(function, targets, space):
    return ResponseResidual(FunctionProblem(space, function, targets, ""))


def test_scalar_responses():
    space = box(2)

    def answer(values):
        return {"one": values["p0"] ** 2, "two": math.exp(values["p1"]), "other": 1.0}

    problem = responses(answer, {"one": (9.0, 0.01), "two": (4.0, None)}, space)
    at = {"p0": 2.0, "p1": 1.0}
    np.testing.assert_allclose(problem.residual(at), [(9 - 4) / 0.01, (4 - math.e) / 0.04])
    np.testing.assert_allclose(
        problem.jacobian(at, ("p1", "p0")), [[0.0, -4 / 0.01], [-math.e / 0.04, 0.0]], rtol=1e-6, atol=1e-9
    )
    found = fit(problem, space, prior=Prior.none())
    np.testing.assert_allclose([found.values["p0"], found.values["p1"]], [3.0, math.log(4.0)], rtol=1e-4)
    with pytest.raises(EvaluationError, match="gave no one"):
        responses(lambda v: {}, {"one": (9.0, 0.01)}, space).residual(at)
    with pytest.raises(EvaluationError, match="'one' is nan"):
        responses(answer, {"one": (9.0, 0.01)}, space).of({"one": math.nan})
    with pytest.raises(InputError, match="is 0 and its standard deviation unknown"):
        responses(answer, {"one": (0.0, None)}, space)


def test_differences_stay_inside_the_limits():
    space = box(1)
    asked = []

    def line(values):
        asked.append(values["p0"])
        return np.array([3.0 * values["p0"]])

    for value in (0.0, 4.0):
        np.testing.assert_allclose(central_jacobian(line, space, {"p0": value}, ("p0",)), [[3.0]])
    assert min(asked) >= 0.0 and max(asked) <= 4.0


# -- one at a time -----------------------------------------------------------------------------------------------------


def cubic(lower=-math.inf, upper=math.inf):
    """``(p0^3, 2 p0 + n)``, which cannot be evaluated outside limits of its own."""

    def answer(values):
        x = values["p0"]
        if not lower <= x <= upper:
            raise EvaluationError(f"nothing at {x:g}")
        return np.array([x**3, 2 * x + values.get("n", 0.0)])

    return answer


def along(residual, at=2.0, step=0.01):
    """Half a difference is 0.04."""
    return difference(residual, {"p0": at}, Parameter("p0", 1.0, 0.0, 4.0), step)


def test_a_difference_is_central_where_both_ends_can_be_had():
    np.testing.assert_allclose(along(cubic()), [3 * 2.0**2 + 0.04**2, 2.0])


@pytest.mark.parametrize(
    ("failing", "other"), [({"upper": 2.0}, -0.04), ({"lower": 2.0}, 0.04)], ids=["above fails", "below fails"]
)
def test_a_difference_is_one_sided_where_one_end_fails(failing, other):
    np.testing.assert_allclose(along(cubic(**failing)), [3 * 2.0**2 + 3 * 2.0 * other + other**2, 2.0])


@pytest.mark.parametrize(("at", "other"), [(0.0, 0.04), (4.0, -0.04)])
def test_a_difference_is_one_sided_at_a_limit(at, other):
    np.testing.assert_allclose(along(cubic(), at), [3 * at**2 + 3 * at * other + other**2, 2.0])


def test_a_difference_that_cannot_be_had_on_either_side_is_said():
    with pytest.raises(EvaluationError, match=r"nothing at 1\.96"):
        along(cubic(lower=2.0, upper=2.0))
    with pytest.raises(EvaluationError, match=r"nothing at 0\.04"):  # at a limit there is one side only
        along(cubic(upper=0.0), at=0.0)


def test_integer_and_held_parameters_have_no_derivative():
    values = {"p0": 2.0, "n": 4.0}
    held = Parameter("p0", 2.0, 2.0, 2.0, distribution="fixed")
    for p in (WHOLE, held):
        np.testing.assert_array_equal(difference(cubic(), values, p, 0.01), np.zeros(2))
    space = ParameterSpace((Parameter("p0", 1.0, 0.0, 4.0), WHOLE))
    matrix = central_jacobian(cubic(), space, values, ("n", "p0"))
    np.testing.assert_allclose(matrix, [[0.0, 12.0], [0.0, 2.0]], rtol=1e-6)


def test_without_a_continuous_parameter_the_derivative_has_no_columns():
    space = ParameterSpace((Parameter("n", 2.0, 1.0, 4.0, "-", integer=True),))
    asked = responses(lambda v: {"a": v["n"], "b": 2 * v["n"]}, {"a": (2.0, 0.1), "b": (4.0, 0.1)}, space)
    assert asked.jacobian({"n": 2.0}, ()).shape == (2, 0)


def test_a_one_sided_difference_takes_one_point_and_the_other_end_only_where_that_one_tells_nothing():
    (p,) = box(1).parameters
    asked = []

    def curve(values):
        asked.append(values["p0"])
        if values["p0"] > 3.0:
            raise EvaluationError("too far")
        return np.array([values["p0"] ** 2, math.nan if values["p0"] > 2.0 else values["p0"]])

    slope = difference(curve, {"p0": 1.0}, p, 1e-3, one_sided=True)
    np.testing.assert_allclose(slope, [2.0 + 4e-3, 1.0])  # a step of 1e-3 of the range
    assert asked == [1.004, 1.0]
    for value, ends in ((4.0, []), (3.0, [3.004, 2.996]), (2.0, [2.004, 1.996])):
        asked.clear()
        if not ends:  # at a limit it goes the other way
            with pytest.raises(EvaluationError, match="too far"):
                difference(curve, {"p0": value}, p, 1e-3, one_sided=True)
            assert asked == [3.996]
            continue
        np.testing.assert_allclose(difference(curve, {"p0": value}, p, 1e-3, one_sided=True)[0], 2 * value, rtol=2e-3)
        assert asked[:2] == pytest.approx(ends)
    near = 4.0 - 1e-9  # not to a limit that is too near
    found = difference(lambda v: np.array([round(v["p0"], 7)]), {"p0": near}, p, 1e-3, one_sided=True)
    np.testing.assert_allclose(found, [1.0], rtol=1e-4)
