import numpy as np
import pandas as pd
import pytest
from SALib.analyze import morris as peer

from calib.errors.errors import InputError
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.sensitivity.variance import morris_design, morris_effects, sobol_design, sobol_shares

BOX = ParameterSpace(
    (
        Parameter("k", 1.0, 0.0, 10.0),
        Parameter("held", 5.0, 0.0, 10.0, distribution="fixed"),
        Parameter("m", 0.0, -1.0, 1.0),
        Parameter("step", 0.0, -2.0, 3.0, integer=True),
    )
)
BOUND = ParameterSpace(BOX.parameters, (LinearConstraint("mass", (("k", 1.0), ("m", 1.0)), 2.0, 4.0),))


def on(design, **functions):
    points = pd.DataFrame(design.points, columns=list(design.names))
    return pd.DataFrame({name: function(points) for name, function in functions.items()})


def column(table, response, name):
    return table[table["response"] == response].set_index("parameter")[name]


# -- Morris ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", [2, 4, 6, 8])
def test_a_linear_response_gives_its_coefficients_over_the_range_and_zero_standard_deviation(levels):
    design = morris_design(BOX, 8, seed=3, levels=levels)
    assert design.points.shape == (8 * 4, 3) and design.note == ""
    table = morris_effects(design, on(design, line=lambda p: 2.0 * p["k"] - 3.0 * p["m"] + 0.5 * p["step"]))
    assert column(table, "line", "mu").to_dict() == pytest.approx({"k": 20.0, "m": -6.0, "step": 2.5})
    assert column(table, "line", "mu_star").to_dict() == pytest.approx({"k": 20.0, "m": 6.0, "step": 2.5})
    assert column(table, "line", "sigma").to_numpy() == pytest.approx(0.0, abs=1e-12)
    assert set(table["trajectories"]) == {8} and set(table["dropped"]) == {0}


def test_an_even_response_has_size_but_no_mean_and_effects_of_a_product_vary():
    design = morris_design(BOX.freeze({"step": 0.0}), 400, seed=4)
    table = morris_effects(design, on(design, valley=lambda p: p["m"] ** 2, both=lambda p: p["m"] * p["k"]))
    # grid 0, 1/3, 2/3, 1 and steps of 2/3: m**2 changes by -+(1 - 1/9), over 2/3 of the range
    assert column(table, "valley", "mu_star")["m"] == pytest.approx(4 / 3)
    assert abs(column(table, "valley", "mu")["m"]) < 0.2
    assert column(table, "valley", "mu_star")["k"] == 0.0
    assert (column(table, "both", "sigma") > 1.0).all()


def test_points_keep_limits_and_integers_and_change_one_parameter_at_a_time():
    design = morris_design(BOX, 20, seed=5)
    free = BOX.keep(["k", "m", "step"])
    assert free.feasible(design.points).all()
    np.testing.assert_array_equal(design.points[:, 2], np.round(design.points[:, 2]))
    assert {-2.0, 3.0} <= set(design.points[:, 2])
    moved = np.diff(design.points.reshape(20, 4, 3), axis=1) != 0
    assert (moved.sum(axis=2) == 1).all() and (moved.sum(axis=1) == 1).all()


def test_effects_agree_with_an_independent_implementation():
    space = BOX.freeze({"step": 0.0})
    design = morris_design(space, 12, seed=6)
    y = on(design, y=lambda p: np.sin(p["k"]) + p["m"] ** 3 * p["k"])
    table = morris_effects(design, y)
    problem = {"num_vars": 2, "names": ["k", "m"], "bounds": [[0.0, 1.0]] * 2}
    found = peer.analyze(problem, design.unit, y["y"].to_numpy(), num_levels=4, seed=1)
    for name in ("mu", "mu_star", "sigma"):
        np.testing.assert_allclose(table[name], np.asarray(found[name], dtype=float), rtol=1e-9)


def test_trajectories_with_failures_are_dropped_and_counted_for_that_response_only():
    design = morris_design(BOX, 6, seed=7)
    y = on(design, line=lambda p: p["k"], whole=lambda p: p["m"])
    y.loc[[1, 2, 9], "line"] = np.nan  # trajectories of 4 points: the first twice, the third once
    table = morris_effects(design, y)
    assert set(column(table, "line", "trajectories")) == {4} and set(column(table, "line", "dropped")) == {2}
    assert set(column(table, "whole", "dropped")) == {0}
    assert column(table, "line", "mu")["k"] == pytest.approx(10.0)
    y.loc[::4, "line"] = np.nan
    assert column(morris_effects(design, y), "line", "mu_star").isna().all()


# -- Sobol -------------------------------------------------------------------------------------------------------------


def test_ishigami_has_the_shares_of_its_closed_form():
    """Ishigami and Homma (1990): sin x1 + a sin**2 x2 + b x3**4 sin x1, uniform over -pi to pi."""
    a, b = 7.0, 0.1
    space = ParameterSpace(tuple(Parameter(f"x{i}", 0.0, -np.pi, np.pi) for i in (1, 2, 3)))
    design = sobol_design(space, 2048, seed=1)
    assert design.points.shape == (2048 * 5, 3)
    y = on(design, y=lambda p: np.sin(p["x1"]) * (1 + b * p["x3"] ** 4) + a * np.sin(p["x2"]) ** 2)
    table = sobol_shares(design, y, seed=2)
    v1, v2, v13 = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a * a / 8, b * b * np.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    assert column(table, "y", "S1").to_dict() == pytest.approx(
        {"x1": v1 / total, "x2": v2 / total, "x3": 0.0}, abs=0.02
    )
    expected = {"x1": (v1 + v13) / total, "x2": v2 / total, "x3": v13 / total}
    assert column(table, "y", "ST").to_dict() == pytest.approx(expected, abs=0.02)
    assert table[["S1_conf", "ST_conf"]].to_numpy().max() < 0.1
    pd.testing.assert_frame_equal(table, sobol_shares(design, y, seed=2))


def test_integers_have_equal_shares_of_the_points():
    design = sobol_design(BOX, 256, seed=1)
    values, counts = np.unique(design.points[:, 2], return_counts=True)
    assert values.tolist() == [-2, -1, 0, 1, 2, 3] and counts.min() > 0.8 * counts.mean()
    table = sobol_shares(design, on(design, y=lambda p: p["step"], flat=lambda p: 0.0 * p["k"]))
    assert column(table, "y", "S1").to_dict() == pytest.approx({"k": 0.0, "m": 0.0, "step": 1.0}, abs=0.05)
    assert column(table, "flat", "ST").isna().all()


def test_a_missing_value_is_refused_and_named():
    design = sobol_design(BOX, 8, seed=1)
    y = on(design, a=lambda p: p["k"], b=lambda p: p["m"])
    y.loc[[3, 5], "b"] = np.nan
    with pytest.raises(InputError, match="'b' is unknown at 2 of 40 points"):
        sobol_shares(design, y)


# -- both --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make", [lambda s, **o: morris_design(s, 4, 1, **o), lambda s, **o: sobol_design(s, 8, 1, **o)]
)
def test_constraints_are_refused_or_ignored_in_words(make):
    with pytest.raises(InputError, match="bound by 'mass'"):
        make(BOUND)
    assert "ignored ('mass')" in make(BOUND, ignore_constraints=True).note
    np.testing.assert_array_equal(make(BOUND, ignore_constraints=True).points, make(BOX).points)
    assert make(BOUND.freeze({"k": 3.0, "m": 0.0})).note == ""  # it binds nothing that is free


def test_same_seed_same_points_and_the_global_generator_is_left_alone():
    np.random.seed(1)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    for make in (lambda s: morris_design(BOX, 5, s), lambda s: sobol_design(BOX, 8, s)):
        np.testing.assert_array_equal(make(1).points, make(1).points)
        assert not np.array_equal(make(1).points, make(2).points)
    design = sobol_design(BOX, 8, 1)
    sobol_shares(design, on(design, a=lambda p: p["k"]))
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_impossible_requests_are_refused():
    with pytest.raises(InputError, match="power of 2"):
        sobol_design(BOX, 100, 1)
    with pytest.raises(InputError, match="even number of levels"):
        morris_design(BOX, 5, 1, levels=5)
    with pytest.raises(InputError, match="no parameter is free"):
        morris_design(BOX.keep([]), 5, 1)
    design = morris_design(BOX, 5, 1)
    with pytest.raises(InputError, match="19 rows"):
        morris_effects(design, on(design, a=lambda p: p["k"]).iloc[1:])
    with pytest.raises(InputError, match="made for morris"):
        sobol_shares(design, on(design, a=lambda p: p["k"]))
