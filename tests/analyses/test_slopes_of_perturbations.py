"""Derivatives that a function returns stay right when a local perturbation of it is in the model."""

import pytest

from calib.hypotheses.function_perturbations import response_perturbations
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel, extend_function, responses_of, slope_entry

SPACE = ParameterSpace(
    (
        Parameter("a", 2.0, 1.0, 3.0),
        Parameter("b", 1.0, 0.5, 2.0),
        Parameter("c", 0.0, 0.0, 4.0, distribution="fixed"),  # moved by its range, having no size
        Parameter("m", 3.0, 1.0, 5.0, distribution="fixed"),
    )
)


def function(v):
    a, b, c, m = (v[name] for name in "abcm")
    slopes = {
        "x_1": {"a": 2 * a * b, "b": a**2, "c": 0.0, "m": 1.0},
        "x_2": {"a": 1.0, "b": c, "c": b, "m": 0.0},
        "y_1": {"a": b * m, "b": a * m, "c": 0.0, "m": a * b},
    }
    entries = {slope_entry(r, p): slope for r, own in slopes.items() for p, slope in own.items()}
    return {"x_1": a**2 * b + m, "x_2": a + b * c, "y_1": a * b * m} | entries


ALL = response_perturbations(SPACE, {"x_1": 7.0, "x_2": 2.0, "y_1": 6.0})


@pytest.mark.parametrize("perturbation", ALL, ids=lambda p: p.effect.name)
@pytest.mark.parametrize("size", [0.13, -0.2])
def test_derivatives_are_those_of_the_perturbed_function(perturbation, size):
    name = perturbation.effect.name
    model = extend_function(FunctionModel("f", SPACE, function), [perturbation.effect])
    at, h = SPACE.values | {name: size, "c": 0.7}, 1e-6
    out = model.function(at)
    by = SPACE.names if perturbation.effect.of_measurement else (*SPACE.names, name)
    for response in responses_of(out):
        for parameter in by:
            high, low = (model.function(at | {parameter: at[parameter] + d})[response] for d in (h, -h))
            assert out[slope_entry(response, parameter)] == pytest.approx((high - low) / (2 * h), abs=1e-7)


def test_all_kinds_of_perturbations_were_tried():
    names = [p.effect.name for p in ALL]
    assert {"change of c", "change of m", "change of a in x", "offset of x", "scale of x"} <= set(names)
