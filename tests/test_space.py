import math
import re

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.problem.parameter import SI_FACTORS
from calib.problem.sampling import wide_sentence
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace


def space() -> ParameterSpace:
    return ParameterSpace(
        (
            Parameter("k", 500.0, 400.0, 800.0, "kN/m"),
            Parameter("m", 20.0, 0.0, 100.0, "kg/m"),
            Parameter("n", 5.0, 2.0, 8.0, integer=True),
            Parameter("g", 9.0, 1.0, 10.0, "GPa", distribution="fixed"),
        ),
        (LinearConstraint("sum", (("m", 2.0), ("g", 1.0)), 20.0, 80.0),),
    )


def test_si_conversion_is_the_units_own_factor():
    si = space().si(space().values)
    assert si == {"k": 500e3, "m": 20.0, "n": 5.0, "g": 9e9}


def test_fixed_parameters_span_no_axis_and_shift_the_constraint():
    s = space()
    assert s.free_names == ("k", "m", "n")
    points = np.array([[500.0, 5.5, 5.0], [500.0, 5.4, 5.0], [500.0, 35.5, 5.0], [500.0, 36.0, 5.0]])
    assert s.feasible(points).tolist() == [True, False, True, False]
    np.testing.assert_allclose(s.violation(points)[:, 0], [0.0, 0.2, 0.0, 1.0], atol=1e-12)


def test_points_outside_limits_are_not_feasible():
    assert not space().feasible(np.array([[399.0, 20.0, 5.0]]))[0]


def test_keep_fixes_the_rest_at_nominal_values():
    kept = space().keep(["m"])
    assert kept.free_names == ("m",)
    assert kept.complete(np.array([30.0])) == {"k": 500.0, "m": 30.0, "n": 5.0, "g": 9.0}
    assert space().free_names == ("k", "m", "n")  # the original is untouched


def test_complete_rounds_integers_and_rejects_unknown_names():
    assert space().complete({"n": 4.6})["n"] == 5.0
    with pytest.raises(InputError, match="unknown parameter 'q'"):
        space().complete({"q": 1.0})
    with pytest.raises(InputError, match="nan"):
        space().complete({"k": math.nan})


def test_prior_width_defaults_to_the_uniform_distribution():
    assert space()["k"].prior_width == pytest.approx(400 / math.sqrt(12))
    assert Parameter("a", 0.0, -1.0, 1.0, prior_sd=0.2).prior_width == 0.2


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"lower": 2.0}, "not below upper"),
        ({"unit": "furlong"}, "unknown unit"),
        ({"value": math.inf}, "value is inf"),
        ({"prior_sd": -1.0}, "prior_sd"),
        ({"integer": True, "value": 0.5}, "fractional"),
    ],
)
def test_bad_parameters_are_named(fields, words):
    given = {"value": 0.0, "lower": -1.0, "upper": 1.0} | fields
    with pytest.raises(InputError, match=words) as caught:
        Parameter("a", **given)
    assert "parameter a" in str(caught.value)


def test_infeasible_constraints_are_found_before_anything_runs():
    s = space()
    tight = ParameterSpace(s.parameters, (LinearConstraint("heavy", (("m", 1.0),), 150.0, 200.0),))
    with pytest.raises(InputError, match="heavy"):
        tight.require_feasible()
    s.require_feasible()
    elsewhere = ParameterSpace(s.parameters, (LinearConstraint("light", (("m", 1.0),), 1.0, 5.0),))
    elsewhere.require_feasible()  # its own value, 20 kg/m, is not
    frozen = s.freeze({"k": 500, "m": 90, "n": 5})
    with pytest.raises(InputError, match="sum"):
        frozen.require_feasible()


def test_selecting_a_fixed_parameter_is_refused():
    with pytest.raises(InputError, match="fixed"):
        space().keep(["g"])


def test_units_are_multiples_of_si():
    """Composed units are what the units in them make."""
    single = {"-": 1, "%": 0.01, "t": 1e3, "kg": 1, "g": 1e-3, "m": 1, "mm": 1e-3, "N": 1, "kN": 1e3, "MN": 1e6,
              "Pa": 1, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "Hz": 1, "rad": 1, "deg": math.pi / 180, "s": 1,
              "in": 0.0254, "ft": 0.3048, "lb": 0.45359237}  # fmt: skip
    single["lbf"] = single["lb"] * 9.80665
    single["kip"] = 1e3 * single["lbf"]
    single |= {"psi": single["lbf"] / single["in"] ** 2, "ksi": single["kip"] / single["in"] ** 2}
    symbol = re.compile(f"({'|'.join(sorted(map(re.escape, single), key=len, reverse=True))})([234]?)")
    assert SI_FACTORS["ms"] == 1e-3  # beside which Nms reads as three units
    for unit, factor in SI_FACTORS.items():
        if unit == "ms":
            continue
        over, _, under = unit.partition("/")
        assert "".join(found[0] for found in symbol.finditer(over + under)) == over + under, unit
        made = [math.prod(single[u] ** int(n or 1) for u, n in symbol.findall(part)) for part in (over, under)]
        assert factor == pytest.approx(made[0] / made[1], rel=1e-12), unit
    assert {"N", "kN", "Nm2", "m2", "mm4"} <= set(SI_FACTORS)  # EA, EI, areas and second moments


def test_limits_over_decades_are_told():
    wide = Parameter("k", 1e5, 1e3, 1e9, "N/m")
    others = (
        Parameter("m", 10.0, 0.0, 1e4, "kg"),
        Parameter("n", 10, 1, 5000, integer=True),
        Parameter("c", 1.0, 0.1, 9.9),
    )
    assert wide_sentence(ParameterSpace(others)) == ""
    assert "k span 6 decades" in wide_sentence(ParameterSpace((wide, *others)))
    assert wide_sentence(ParameterSpace((wide, *others)).freeze({"k": 1e4})) == ""


def test_runs_that_reach_near_zero_are_not_spread_over_decades():
    """The limits are the smallest and largest value: of uniform numbers one of two hundred may lie at a thousandth."""
    unit = (np.arange(200) + 0.2) / 200
    runs = pd.DataFrame({"even": unit, "decades": 1e-3 * 1e3**unit})
    space = ParameterSpace(tuple(Parameter(n, 0.5, float(runs[n].min()), float(runs[n].max())) for n in runs))
    said = wide_sentence(space, runs)
    assert "decades span 3 decades" in said and "even" not in said
    assert "even span 3 decades" in wide_sentence(space)
