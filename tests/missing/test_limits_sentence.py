"""Parameters that a limit holds beside a named effect are told."""

from types import SimpleNamespace

import numpy as np
import pytest

from calib.missing.verdict_words import limits_sentence
from calib.problem.space import Parameter, ParameterSpace


def found(values, names_something=True):
    space = ParameterSpace(tuple(Parameter(n, 1.0, 0.0, 2.0, "kN/m", prior_sd=0.5) for n in ("k", "c", "extra")))
    names = space.names
    fit = SimpleNamespace(
        names=names, values=dict(zip(names, values, strict=True)), covariance=1e-6 * np.eye(3),
        fit_problem=SimpleNamespace(space=space),
    )  # fmt: skip
    chosen = SimpleNamespace(fit=fit, effects=(SimpleNamespace(names=("extra",)),))
    return SimpleNamespace(names_something=names_something, chosen=chosen)


@pytest.mark.parametrize(
    ("values", "begins"),
    [
        ((2.0, 1.0, 1.0), "k ends at its search limit"),
        ((2.0, 0.0, 1.0), "k and c end at their search limits"),
        ((1.0, 1.0, 2.0), ""),
    ],
)
def test_parameters_of_the_model_that_end_at_a_limit_are_told(values, begins):
    told = limits_sentence(found(values))
    assert told.startswith(begins) and bool(told) == bool(begins)


def test_nothing_is_said_where_nothing_is_named():
    assert limits_sentence(found((2.0, 1.0, 1.0), names_something=False)) == ""
