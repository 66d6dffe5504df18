"""Strengths at which an effect is tried for what it pairs."""

import numpy as np

from calib.effect import Effect
from calib.missing.partners import tried_points
from calib.space import Parameter


def effect(lower, upper, nuisance=(), grid=()):
    strength = Parameter("k", 0.0, lower, upper, "N/m", prior_sd=1e4)
    return Effect("k", "Spring", "It is left out.", "Look there.", strength, lambda model: None, nuisance, grid)


def test_decades_about_the_plausible_strength_within_its_limits():
    assert [p["k"] for p in tried_points(effect(0.0, 2e5))] == [1e2, 1e3, 1e4, 1e5]
    assert [p["k"] for p in tried_points(effect(-2e3, 1e9))] == [-1e3, -1e2, 1e2, 1e3, 1e4, 1e5, 1e6]


def test_nuisance_parameters_are_those_of_the_grid():
    place = Parameter("x", 1.0, 0.0, 4.0, "m")
    grid = ({"k": 5e3, "x": 3.0}, {"k": 1e4, "x": 1.0}, {"k": 2e4, "x": 1.0})
    points = tried_points(effect(0.0, 2e4, (place,), grid))
    np.testing.assert_allclose([(p["x"], p["k"]) for p in points], [(x, k) for x in (1, 3) for k in (1e2, 1e3, 1e4)])
