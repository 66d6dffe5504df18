"""What linear constraints tell of a fit: narrow ones count as data, wide ones may hold parameters as limits do."""

import math
import re

import numpy as np
import pytest
from scipy import stats

import calib
from calib.inference.constraints import Hold, constraint_rows
from calib.inference.identify import posterior

ROOM = dict(progress=False, reduction=False)


def weighed(*constraints, m2_freqs=None, held_out=()):
    """Two masses about 20 t; three frequencies see the first one alone, to 0.025 t."""
    masses = (calib.Parameter("m1", 20.0, 10.0, 30.0, "t"), calib.Parameter("m2", 20.0, 10.0, 30.0, "t"))
    space = calib.ParameterSpace(masses, tuple(calib.LinearConstraint(*c) for c in constraints))
    measured = {f"freq_{i}": (9.759 * i, 0.01 * i) for i in (1, 2, 3)} | (m2_freqs or {})

    def solve(v):
        own = {f"freq_{i}": 10.0 * i / math.sqrt(v["m1"] / 20.0) for i in (1, 2, 3)}
        return own | {name: 10.0 / math.sqrt(v["m2"] / 20.0) for name in m2_freqs or {}}

    test = calib.ResponseTest(measured, held_out=list(held_out))
    return calib.Problem(calib.FunctionModel("two masses", space, solve), test)


def beam(upper=5.0, *constraints):
    """A joint k in series with a beam; without a limit the data say k = 2.39."""
    space = calib.ParameterSpace(
        (calib.Parameter("E", 200.0, 150.0, 250.0, "GPa"), calib.Parameter("k", 2.0, 0.5, upper, "MN/m")), constraints
    )
    model = calib.FunctionModel(
        "beam", space, lambda v: {f"w_{n}": 1000.0 / v["k"] + 4.0e4 * n / v["E"] for n in (1, 2, 3, 4)}
    )
    return calib.Problem(model, calib.ResponseTest({f"w_{n}": (420.0 + 180.0 * n, 6.0) for n in (1, 2, 3, 4)}))


def cap(lower, upper, **coefficients):
    return calib.LinearConstraint("cap", tuple(coefficients.items()), lower, upper)


SUM = (("m1", 1.0), ("m2", 1.0))


# -- constraints that count as data ------------------------------------------------------------------------------------


def test_a_narrow_constraint_is_information():
    fit = weighed(("total mass", SUM, 39.99, 40.01, "t")).calibrate(**ROOM)
    table = fit.parameters
    alone = table.loc["m1", "std"]
    assert alone == pytest.approx(0.0248, rel=0.01)
    assert table.loc["m2", "std"] == pytest.approx(math.hypot(alone, 0.02 / math.sqrt(12)), rel=1e-3)
    assert table["identified"].all() and table.loc["m2", "data_share"] > 0.999
    assert fit.statistics.dof == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("half_width", [0.1, 0.35])
def test_a_constraint_that_counts_as_data_holds_nothing(half_width):
    """The first mass is 1 t more than its nominal value, so that the sum ends on the upper limit of the constraint."""
    fit = weighed(("total mass", SUM, 40.0 - half_width, 40.0 + half_width, "t")).calibrate(**ROOM)
    table = fit.parameters
    assert table["value"].sum() == pytest.approx(40.0 + half_width)
    assert table.loc["m2", "data_share"] > 0.99 and table["not_identified"].to_list() == ["", ""]


@pytest.mark.medium
def test_a_wide_constraint_that_is_not_reached_tells_nothing():
    free, wide = (weighed(*c).calibrate(**ROOM).parameters for c in ((), [("total mass", SUM, 15.0, 65.0, "t")]))
    np.testing.assert_allclose(wide["std"], free["std"], rtol=1e-9)
    assert wide["not_identified"].to_dict() == free["not_identified"].to_dict() == {"m1": "", "m2": "wide, prior"}


@pytest.mark.medium
def test_an_equality_leaves_one_parameter_less():
    """The covariance is that of the fit with one parameter in the place of both."""
    fit = beam(5.0, cap(0.0, 0.0, E=1.0, k=-100.0)).calibrate(**ROOM)
    values, table = fit.values, fit.parameters
    assert values["E"] == pytest.approx(100.0 * values["k"], rel=1e-9)
    slope = np.array([-1000.0 / values["k"] ** 2 - 4.0e4 * n / values["E"] ** 2 * 100.0 for n in (1, 2, 3, 4)]) / 6.0
    sd = 1 / math.sqrt(slope @ slope + (math.sqrt(12) / 4.5) ** 2 + (100.0 * math.sqrt(12) / 100.0) ** 2)
    assert table.loc["k", "std"] == pytest.approx(sd, rel=1e-4)
    assert table.loc["E", "std"] == pytest.approx(100.0 * sd, rel=1e-4)
    assert table["identified"].all() and fit.statistics.dof == pytest.approx(3.0, abs=0.01)
    searched = beam(5.0, cap(0.0, 0.0, E=1.0, k=-100.0)).calibrate(method="genetic", generations=10, **ROOM)
    assert searched.values["k"] == pytest.approx(values["k"], rel=1e-4)


@pytest.mark.medium
def test_what_is_held_out_is_predicted_with_the_constraint():
    """The second mass has its own frequency, 2 % off: the constraint alone tells that this contradicts the model."""
    off = {"own": (10.0 / math.sqrt(19.0 / 20.0) * 1.02, 0.01)}
    constraints = ((), [("total mass", SUM, 39.99, 40.01, "t")])
    errors = [weighed(*c, m2_freqs=off, held_out=["own"]).calibrate(**ROOM).errors for c in constraints]
    free, known = (table.set_index("group").loc["held_out_responses"] for table in errors)
    assert free["p"] > 0.5 and known["p"] < 1e-6
    assert known["expected"] < 2 < free["expected"]


def test_the_standard_deviation_of_a_constraint_is_that_of_a_uniform_distribution():
    space = calib.ParameterSpace(
        (calib.Parameter("a", 0.0, -1.0, 1.0), calib.Parameter("b", 0.0, -1.0, 1.0), calib.Parameter("h", 0.0, -1, 1)),
        (calib.LinearConstraint("sum", (("a", 1.0), ("b", 2.0), ("h", 3.0)), -0.3, 0.3),),
    )
    rows = constraint_rows(space.freeze({"h": 0.0}), ("a", "b"), np.diag([0.04, 0.01]), {"h": 0.1})
    np.testing.assert_allclose(rows.slope, np.array([[1.0, 2.0]]) * math.sqrt(12) / 0.6)
    np.testing.assert_allclose(rows.held, [[0.3 * math.sqrt(12) / 0.6]])
    assert not len(constraint_rows(space, ("a", "b"), np.diag([0.01, 0.0049])).slope)  # wider than what is known
    endless = constraint_rows(space, ("a", "b"), np.diag([math.inf, 0.01]))
    assert np.isfinite(endless.slope).all()
    found = posterior(("a", "b"), np.vstack([[[0.0, 10.0]], endless.slope]), np.full(2, math.inf))
    assert np.isfinite(found.std).all()


# -- constraints that hold ---------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_a_constraint_holds_a_parameter_as_a_limit_does():
    by_limit, by_constraint = beam(2.30).calibrate(**ROOM), beam(5.0, cap(0.5, 2.30, k=1.0)).calibrate(**ROOM)
    one_sided = beam(5.0, cap(-math.inf, 2.30, k=1.0)).calibrate(**ROOM)
    limit = by_limit.parameters.loc["k"]
    assert limit["value"] == pytest.approx(2.30) and limit["not_identified"] == "limit"
    for fit in (by_constraint, one_sided):
        held, free = fit.parameters.loc["k"], fit.parameters.loc["E"]
        assert held["value"] == pytest.approx(2.30)
        assert not held["identified"] and held["not_identified"] == "constraint"
        assert held["std"] == pytest.approx(limit["std"], rel=0.02)  # of the data, not near 0
        assert held["high"] == pytest.approx(2.30) and held["low"] == pytest.approx(limit["low"], rel=2e-3)
        assert "'cap'" in held["sentence"] and free["not_identified"] == "beside_limit" and "'cap'" in free["sentence"]
        assert fit.statistics.identification.posterior.std.min() > 0.01
    free = beam().calibrate(**ROOM).parameters.loc["k"]
    assert free["value"] > 2.35 and free["identified"]
    assert free["high"] - free["value"] == pytest.approx(1.96 * free["std"])


@pytest.mark.medium
def test_a_limit_against_which_the_fit_is_holds_what_it_moves():
    """The data say E = 222 ± 3.3; with k stopped at 2.30 it is 228, and the fit is still adequate."""
    free, slightly, held = (beam(upper).calibrate(**ROOM) for upper in (5.0, 2.36, 2.30))
    assert held.statistics.fits is True
    by = {fit: fit.parameters.loc["E"] for fit in (free, slightly, held)}
    one, moved = by[held], by[held]["value"] - by[free]["value"]
    assert moved > 1.5 * one["std"] and one["std"] < one["needed"]
    assert one["not_identified"] == "beside_limit" and "the limit of k" in one["sentence"]
    told = float(re.search(r"moves it by ([\d.]+) standard", one["sentence"])[1])
    assert told == pytest.approx(moved / one["std"], rel=0.1)
    assert (one["low"], one["high"]) == pytest.approx(
        (one["value"] - 1.96 * one["std"], one["value"] + 1.96 * one["std"])
    )
    # Moved by half a standard deviation only.
    assert by[slightly]["identified"] and slightly.parameters.loc["k", "not_identified"] == "limit"


def test_of_a_sum_that_is_held_the_parameter_that_the_data_know_is_identified():
    table = weighed(("cap", SUM, -math.inf, 38.0, "t")).calibrate(**ROOM).parameters
    assert table["not_identified"].to_dict() == {"m1": "", "m2": "wide, prior, constraint"}


@pytest.mark.parametrize("beyond", [0.0, 1.5, 8.0, 60.0])
def test_an_interval_of_one_side_is_that_of_a_truncated_normal_distribution(beyond):
    low, high = Hold("cap", 1, beyond, 1.0).interval(2.0)
    assert high == 0.0
    if beyond < 10:  # beyond, SciPy's own loses its digits
        assert low == pytest.approx(stats.truncnorm.ppf(0.05, -np.inf, -beyond, 2.0 * beyond, 2.0), rel=1e-6)
    assert low < high
    assert Hold("cap", -1, beyond, 1.0).interval(2.0) == pytest.approx((0.0, -low))
    wide = Hold("cap", 1, beyond, 0.6).interval(2.0)
    assert wide[1] == pytest.approx(1.96 * 2.0 * 0.8, rel=1e-4) and -wide[0] > wide[1]
