"""Effects given to `Problem.explain` are checked before anything is solved."""

import math
from dataclasses import replace

import pytest

import calib
from calib.errors.errors import InputError

ASKED = []


def falls(values):
    ASKED.append(values)
    return {f"f{k}": math.sqrt(values["k"] / values["m"]) * k for k in range(1, 8)}


SPACE = calib.ParameterSpace((calib.Parameter("k", 30.0, 1.0, 100.0), calib.Parameter("m", 7.0, 1.0, 50.0)))
MEASURED = {f"f{k}": (2.1 * k, 0.01) for k in range(1, 8)}
EFFECT = calib.Effect("lag", "lag", "", "", calib.Parameter("lag", 0.0, 0.0, 1.0, prior_sd=0.3), lambda model: falls)
LATER = replace(EFFECT, magnitude=replace(EFFECT.magnitude, upper=5.0))
TAKEN = replace(EFFECT, name="k", magnitude=replace(EFFECT.magnitude, name="k"))


def problem(name):
    return calib.Problem(calib.FunctionModel(name, SPACE, falls), calib.ResponseTest(MEASURED, name=f"test of {name}"))


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ([EFFECT, LATER], ("'lag' and 'lag'", "both have a parameter")),
        ([TAKEN], ("'k'", "as has the model 'first'")),
        ([replace(EFFECT, build=lambda model: 1 / 0)], ("adding 'lag' failed", "ZeroDivisionError")),
        ({"first": [EFFECT], "second": [LATER]}, ("two models have different effects 'lag'",)),
    ],
)
def test_a_library_that_cannot_be_used_is_refused_before_any_solve(effects, words):
    ASKED.clear()
    with pytest.raises(InputError) as fault:
        calib.Problem.join(problem("first"), problem("second")).explain(effects)
    assert all(word in str(fault.value) for word in words) and not ASKED
