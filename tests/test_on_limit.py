"""When a value is on its limit."""

import math

import numpy as np
import pandas as pd
import pytest

from calib.inference.cases import CaseResult, parameters_table
from calib.inference.identify import identify
from calib.inference.verdicts import parameter_verdicts
from calib.problem.parameter import RULES, LimitRules, limit_at
from calib.problem.space import Parameter, ParameterSpace

LOWER, UPPER = 20.0, 60.0
RANGE = UPPER - LOWER


def test_the_distances_are_documented_numbers():
    assert LimitRules() == RULES == LimitRules(of_range=0.001, of_std=0.05, searched=0.01)


@pytest.mark.parametrize("searched", [False, True])
@pytest.mark.parametrize(
    ("std", "near"),
    [
        (None, 1e-3 * RANGE),
        (math.nan, 1e-3 * RANGE),
        (math.inf, 1e-3 * RANGE),
        (1e3, 1e-3 * RANGE),
        (0.02 * RANGE, 1e-3 * RANGE),  # where both distances are equal
        (0.01 * RANGE, 0.05 * 0.01 * RANGE),
        (1e-5 * RANGE, 0.05 * 1e-5 * RANGE),
    ],
)
def test_a_value_is_on_its_limit_within_the_smaller_distance(std, near, searched):
    """Of the range, and of the standard deviation where a least-squares fit ended."""
    near = 0.01 * RANGE if searched else near
    inside, outside = near * (1 - 1e-6), near * (1 + 1e-6)
    p = Parameter("k", 40.0, LOWER, UPPER, "kN/m")
    for of in (lambda v: limit_at(v, LOWER, UPPER, std, searched), lambda v: p.limit_at(v, std, searched)):
        assert of(LOWER + inside) == of(LOWER) == of(LOWER - 1.0) == "lower"
        assert of(UPPER - inside) == of(UPPER) == of(UPPER + 1.0) == "upper"
        assert of(LOWER + outside) is of(0.5 * (LOWER + UPPER)) is of(UPPER - outside) is None


def test_an_integer_is_on_its_limit_only_when_it_equals_it():
    p = Parameter("n", 5.0, 1.0, 8.0, integer=True)
    assert [p.limit_at(float(n)) for n in range(1, 9)] == ["lower", *[None] * 6, "upper"]


def test_verdicts_and_tables_of_searches_follow_the_definition():
    """Two parameters at the same distance from a limit: the standard deviation tells whether a fit is on it."""
    space = ParameterSpace((Parameter("sharp", 5.0, 0.0, 10.0), Parameter("loose", 5.0, 0.0, 10.0)))
    values = {"sharp": 9.995, "loose": 9.995}
    jacobian = np.diag([1 / 0.01, 1 / 1.0])  # standard deviations, beside wide priors

    def table(searched):
        found = identify(space, space.names, jacobian, values=values, searched=searched)
        verdicts = parameter_verdicts(space, values, found).set_index("parameter")
        known = found.parameters.set_index("parameter")["identified"]
        assert known.to_dict() == verdicts["identified"].to_dict()
        return verdicts

    fitted, searched = table(False), table(True)
    assert fitted["on_limit"].to_dict() == {"sharp": False, "loose": True}
    assert fitted["identified"]["sharp"] and "limit" in fitted["not_identified"]["loose"]
    assert searched["on_limit"].all() and (searched["not_identified"].str.contains("limit")).all()
    end = CaseResult("A", values, 0.1, {}, pd.DataFrame(), 2, 2, 0, 0, 0, 1.0)
    assert parameters_table([end], space)["on_limit"].tolist() == [True, True]


def test_beside_an_infinite_limit_the_standard_deviation_says_what_is_near():
    near = RULES.of_std * 2.0
    assert limit_at(UPPER - 0.9 * near, -math.inf, UPPER, 2.0, searched=True) == "upper"
    assert limit_at(UPPER - 1.1 * near, -math.inf, UPPER, 2.0) is None
    for std in (None, math.nan, math.inf):
        assert limit_at(UPPER - 1.0, -math.inf, UPPER, std) is None
        assert limit_at(LOWER + 1.0, LOWER, math.inf, std) is None
