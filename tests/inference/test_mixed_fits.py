"""Fits with integer parameters: steps of integers beside least squares, and what is refused."""

import gc
import math
import weakref
from dataclasses import dataclass

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.inference.gauss_newton import fit
from calib.inference.integers import fit_mixed
from calib.problem.prior import Prior
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from tests.inference.test_gauss_newton import Valley, box


@dataclass
class Stations:
    """Two integers that trade a little with each other and with a continuous parameter."""

    def __init__(self, best=(6, 2)):
        self.best = best

    def residual(self, values):
        a, b, x = values["a"] - self.best[0], values["b"] - self.best[1], values["x"]
        return np.array([2 * a + b, b - 0.5 * a + x - 1.3, 3 * (x - 1.3)])

    def jacobian(self, values, names):
        assert tuple(names) == ("x",)
        return np.array([[0.0], [1.0], [3.0]])


STATIONS = ParameterSpace(
    (
        Parameter("a", 4.0, 2.0, 8.0, integer=True),
        Parameter("x", 0.5, 0.0, 2.0, prior_sd=10.0),
        Parameter("b", 5.0, 2.0, 8.0, integer=True),
    )
)


def test_integers_are_found_from_every_start():
    found = fit_mixed(Stations(), STATIONS, [{}, {"a": 8.0, "b": 8.0}, {"a": 2.0, "b": 2.0}])
    for end in (found.best, *found.by_start):
        assert (end.values["a"], end.values["b"]) == (6.0, 2.0)
        assert end.values["x"] == pytest.approx(1.3, abs=0.01)
    assert found.exhausted == ()
    assert set(found.combinations.columns) == {"start", "a", "b", "misfit", "converged"}
    numbers, misfits = found.profile("a")
    assert numbers[np.argmin(misfits)] == 6 and {5.0, 6.0, 7.0} <= set(numbers)
    # All neighbours inside the limits were tried, diagonal ones too.
    tried = set(map(tuple, found.combinations.loc[found.combinations["start"] == 0, ["a", "b"]].to_numpy().tolist()))
    assert {(5, 2), (7, 2), (6, 3), (5, 3), (7, 3)} <= tried
    assert all(2 <= a <= 8 and 2 <= b <= 8 for a, b in tried)


def test_two_integers_that_only_move_together():
    class Trade(Stations):
        def residual(self, values):
            return np.array([10 * (values["a"] + values["b"] - 8), values["a"] - 6, values["x"] - 1.3])

        def jacobian(self, values, names):
            return np.array([[0.0], [0.0], [1.0]])

    found = fit_mixed(Trade(), STATIONS, [{"a": 3.0, "b": 5.0}])
    assert (found.best.values["a"], found.best.values["b"]) == (6.0, 2.0)


def test_a_problem_that_was_fitted_is_freed_at_once():
    problem = Stations()
    gone = weakref.ref(problem)
    gc.disable()  # a collection would free it in a cycle too, but late: it may hold a large basis
    try:
        fit_mixed(problem, STATIONS, [{}, {"a": 8.0, "b": 8.0}])
        del problem
        assert gone() is None
    finally:
        gc.enable()


def test_refits_are_bounded_and_reported():
    found = fit_mixed(Stations(), STATIONS, refits=4)
    assert len(found.combinations) == 4 and found.exhausted == (0,)
    assert not found.complete and fit_mixed(Stations(), STATIONS).complete


def test_in_fit_integers_stay():
    found = fit(Stations(), STATIONS)
    assert (found.values["a"], found.values["b"]) == (4.0, 5.0) and found.names == ("x",)


def test_without_integers_mixed_is_a_multi_start():
    found = fit_mixed(Valley(), box(2, lower=-2.0, upper=2.0), [{"p0": -1.0}, {"p0": 1.5}], Prior.none())
    assert len(found.by_start) == 2 and len(found.combinations) == 2
    assert found.best.values["p0"] == pytest.approx(1.0, abs=0.01)


def test_failed_starts_are_survived_unless_all_fail():
    class Half(Stations):
        def residual(self, values):
            if values["a"] > 6:
                raise EvaluationError("too far")
            return super().residual(values)

    found = fit_mixed(Half(), STATIONS, [{"a": 8.0}, {"a": 3.0}])
    assert found.best.values["a"] == 6.0 and len(found.by_start) == 1
    assert math.isinf(found.combinations.loc[0, "misfit"])
    with pytest.raises(EvaluationError, match=r"^the fit cannot start: too far$"):
        fit_mixed(Half(), STATIONS, [{"a": 8.0}])


def test_integers_alone_are_searched_and_keep_the_constraints():
    class Far(Stations):
        def residual(self, values):
            assert values["a"] + values["b"] <= 12
            return np.array([values["a"] - 7.1, values["b"] - 6.2])

        def jacobian(self, values, names):
            assert not names
            return np.zeros((2, 0))

    limit = LinearConstraint("sum", (("a", 1.0), ("b", 1.0)), 0.0, 12.0)
    space = ParameterSpace(tuple(p for p in STATIONS.parameters if p.integer), (limit,))
    found = fit_mixed(Far(), space)
    assert found.best.values in ({"a": 7.0, "b": 5.0}, {"a": 6.0, "b": 6.0})
    assert found.best.converged and found.best.names == () and found.complete
    assert found.best.misfit == found.best.data_misfit == pytest.approx(min(0.1**2 + 1.2**2, 1.1**2 + 0.2**2))
