"""The bounded fit against closed forms and an enumeration of all active sets."""

import itertools
import math
from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from calib.errors.errors import EvaluationError, InputError
from calib.inference.even_weights import EvenWeights
from calib.inference.gauss_newton import FitSettings, fit
from calib.inference.integers import fit_mixed
from calib.problem.prior import Prior
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace


@dataclass
class Linear:
    """``matrix @ theta - data``, recording the points evaluated."""

    names: tuple[str, ...]
    matrix: np.ndarray
    data: np.ndarray
    points: list = field(default_factory=list)

    def residual(self, values):
        self.points.append(dict(values))
        return self.matrix @ np.array([values[n] for n in self.names]) - self.data

    def jacobian(self, values, names):
        return self.matrix[:, [self.names.index(n) for n in names]]


def box(n, constraints=(), **changes):
    options = {"value": 1.0, "lower": 0.0, "upper": 4.0, "prior_sd": 0.7} | changes
    return ParameterSpace(tuple(Parameter(f"p{k}", **options) for k in range(n)), tuple(constraints))


def linear(seed, n=3, rows=7):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, n)) * 10.0 ** rng.uniform(-1, 1, n)
    return Linear(
        tuple(f"p{k}" for k in range(n)), matrix, matrix @ rng.uniform(0.5, 3.5, n) + rng.standard_normal(rows)
    )


def test_linear_problem_ends_at_the_posterior_mean():
    space, problem = box(3, lower=-50.0, upper=50.0), linear(1)
    found = fit(problem, space)
    hessian = problem.matrix.T @ problem.matrix + np.eye(3) / 0.7**2
    exact = np.linalg.solve(hessian, problem.matrix.T @ problem.data + np.ones(3) / 0.7**2)
    np.testing.assert_allclose([found.values[n] for n in problem.names], exact, atol=1e-3 * 0.7)
    assert found.converged and found.active_limits == () and found.active_constraints == ()
    assert found.misfit == pytest.approx(found.data_misfit + found.prior_misfit)
    assert found.evaluations == len(problem.points) and found.jacobians == found.iterations + 1
    assert found.history["misfit"].is_monotonic_decreasing
    np.testing.assert_allclose(found.residual, problem.residual(found.values))
    assert fit(problem, space).values == found.values


def test_the_prior_can_be_switched_off_or_moved():
    space, problem = box(2, lower=-50.0, upper=50.0), linear(2, 2)
    tight = FitSettings(gain=1e-12)
    free = fit(problem, space, prior=Prior.none(), settings=tight)
    exact = np.linalg.lstsq(problem.matrix, problem.data, rcond=None)[0]
    np.testing.assert_allclose([free.values[n] for n in problem.names], exact, atol=1e-5)
    assert free.prior_misfit == 0
    prior = Prior({"p0": Parameter("p0", 30.0, -50.0, 50.0, prior_sd=1e-4)})
    moved = fit(problem, space, prior=prior, settings=tight)
    assert moved.values["p0"] == pytest.approx(30.0, abs=1e-3)


def best_over_active_sets(problem, limits, space, centre, sd, cost):
    """Lowest cost of a linear problem: every set of constraints is tried as the active one."""
    hessian = problem.matrix.T @ problem.matrix + np.eye(3) / sd**2
    pull = problem.matrix.T @ problem.data + centre / sd**2
    lowest = math.inf
    for count in range(4):
        for active in itertools.combinations(limits, count):
            rows = np.array([row for row, _ in active]).reshape(-1, 3)
            if np.linalg.matrix_rank(rows) < count:
                continue
            whole = np.block([[hessian, rows.T], [rows, np.zeros((count, count))]])
            x = np.linalg.solve(whole, np.concatenate([pull, [value for _, value in active]]))[:3]
            if space.feasible(x)[0]:
                lowest = min(lowest, cost(x))
    return lowest


@pytest.mark.medium
@hypothesis_settings(max_examples=40)
@given(seed=st.integers(0, 10_000), limit=st.floats(1.0, 5.0), equal=st.booleans())
def test_limits_and_constraints_against_all_active_sets(seed, limit, equal):
    con = LinearConstraint("sum", (("p0", 1.0), ("p1", 2.0), ("p2", 1.0)), limit if equal else -math.inf, limit)
    space, problem = box(3, [con], value=0.3, upper=2.0), linear(seed)
    found = fit(problem, space, settings=FitSettings(gain=1e-10))
    x = np.array([found.values[n] for n in problem.names])
    assert space.feasible(x)[0]

    def cost(x):
        return float(np.sum((problem.matrix @ x - problem.data) ** 2) + np.sum((x - 0.3) ** 2) / 0.7**2)

    row = np.array([1.0, 2.0, 1.0])
    limits = [(np.eye(3)[k], v) for k in range(3) for v in (0.0, 2.0)] + [(row, limit)]
    assert found.misfit == pytest.approx(cost(x))
    assert cost(x) <= best_over_active_sets(problem, limits, space, 0.3, 0.7, cost) * (1 + 1e-9) + 1e-8
    for k, name in enumerate(space.names):
        assert (f"{name} at its lower limit" in found.active_limits) == (x[k] < 2e-6)
    assert ("sum at its upper limit" in found.active_constraints) == (row @ x > limit - 1e-5)


def test_every_point_tried_keeps_limits_and_constraints():
    con = LinearConstraint("mass", (("p0", 4.46), ("p1", 3.56), ("p2", 5.26)), 8.0, 12.0)
    space, problem = box(3, [con]), linear(5)
    fit(problem, space, {"p0": 4.0, "p1": 4.0, "p2": 4.0})
    points = np.array([[v[n] for n in space.names] for v in problem.points])
    assert len(points) > 1 and space.feasible(points).all()


class Valley:
    """Rosenbrock's function, as a sum of squares."""

    def residual(self, values):
        x, y = values["p0"], values["p1"]
        return np.array([10 * (y - x * x), 1 - x])

    def jacobian(self, values, names):
        x = values["p0"]
        return np.array([[-20 * x, 10.0], [-1.0, 0.0]])[:, [("p0", "p1").index(n) for n in names]]


def test_a_curved_valley():
    space = box(2, lower=-2.0, upper=2.0)
    found = fit(Valley(), space, {"p0": -1.2, "p1": 1.0}, Prior.none(), FitSettings(gain=1e-14))
    assert found.converged
    np.testing.assert_allclose([found.values["p0"], found.values["p1"]], 1.0, atol=1e-5)
    assert found.evaluations < 60
    few = fit(Valley(), space, {"p0": -1.2, "p1": 1.0}, Prior.none(), FitSettings(gain=1e-14, evaluations=6))
    assert not few.converged and 6 <= few.evaluations < found.evaluations and "before it converged" in few.reason
    short = fit(Valley(), space, {"p0": -1.2, "p1": 1.0}, Prior.none(), FitSettings(iterations=3))
    assert not short.converged and short.iterations == 3 and "before it converged" in short.reason
    away = fit(Valley(), space.widen({"p0": (-2.0, 0.5)}), {"p0": -1.2, "p1": 1.0}, Prior.none())
    assert away.active_limits == ("p0 at its upper limit",)
    assert away.values["p1"] == pytest.approx(0.25, abs=1e-3)


def test_points_that_cannot_be_evaluated_are_stepped_back_from():
    class Hole(Valley):
        def residual(self, values):
            if values["p0"] > 0.9:
                raise EvaluationError("no modes here")
            return super().residual(values) if values["p1"] < 0.85 else np.array([math.nan, 0.0])

    start = {"p0": -1.2, "p1": 0.8}
    found = fit(Hole(), box(2, lower=-2.0, upper=2.0), start, Prior.none())
    assert found.values["p0"] <= 0.9 and found.misfit < 0.1
    with pytest.raises(EvaluationError, match="cannot start: no modes here"):
        fit(Hole(), box(2, lower=-2.0, upper=2.0), {"p0": 1.5}, Prior.none())


def test_a_cost_that_cannot_fall_ends_the_fit():
    class Lying(Linear):
        def jacobian(self, values, names):
            return -super().jacobian(values, names)

    true = linear(1)
    found = fit(Lying(true.names, true.matrix, true.data), box(3), prior=Prior.none())
    assert not found.converged and found.iterations == 0 and "no step lowers" in found.reason


def test_a_decrease_that_is_noise_is_not_sought_for_long():
    """A large residual that nothing moves, with a slope of rounding: one part in 1e8 of its square seems to be won."""

    class Rounded(Linear):
        def jacobian(self, values, names):
            return super().jacobian(values, names) + np.array([[1e-4], [0.0]])

    problem = Rounded(("p0",), np.array([[0.0], [1.0]]), np.array([-1e3, 0.5]))
    found = fit(problem, box(1), {"p0": 0.5}, Prior.none())
    assert found.converged and found.iterations == 0 and len(problem.points) == 5
    sought = fit(problem, box(1), {"p0": 0.5}, Prior.none(), FitSettings(noise=0.0))
    assert not sought.converged and sought.evaluations > 2 * found.evaluations


class Far:
    """A line, and a misfit that no parameter changes."""

    def __init__(self, rest):
        self.rest = rest

    def residual(self, values):
        return np.array([values["p0"] - 3.0, self.rest])

    def jacobian(self, values, names):
        return np.array([[1.0], [0.0]])


@pytest.mark.parametrize(
    ("rest", "settings", "moves"),
    [
        # From 1 the step to 3 promises 4 of a sum of squares of 10004.
        (100.0, FitSettings(gain=1e-9, relative=4.1e-4), False),
        (100.0, FitSettings(gain=1e-9, relative=3.9e-4), True),
        (100.0, FitSettings(gain=4.1, relative=0.0), False),
        (100.0, FitSettings(gain=3.9, relative=0.0), True),
        (0.0, FitSettings(gain=1e-9, relative=4.1e-4), True),
    ],
)
def test_a_fit_ends_when_the_promise_is_a_small_part_of_a_large_misfit(rest, settings, moves):
    found = fit(Far(rest), box(1), {"p0": 1.0}, Prior.none(), settings)
    assert found.converged and found.reason == "no step promises to lower the misfit"
    if moves:
        assert found.values["p0"] == pytest.approx(3.0, abs=0.1) and found.iterations > 0
    else:
        assert found.values["p0"] == 1.0 and found.iterations == 0 and found.misfit == 4.0 + rest**2


def test_bad_problems_are_refused():
    with pytest.raises(InputError, match="no parameter is free"):
        fit(Valley(), box(2).freeze({"p0": 1.0, "p1": 1.0}))
    con = LinearConstraint("mass", (("p0", 1.0), ("p1", 1.0)), 10.0, 11.0)
    with pytest.raises(InputError, match="mass"):
        fit(Valley(), box(2, [con]))
    frozen = box(2, [LinearConstraint("mass", (("p0", 1.0),), 2.0, 3.0)]).freeze({"p0": 1.0})
    with pytest.raises(InputError, match="the fixed values break it"):
        fit(Valley(), frozen)
    with pytest.raises(InputError, match="no start"):
        fit_mixed(Valley(), box(2), [])


def test_a_step_that_failed_is_not_tried_again():
    class Steep:
        def __init__(self):
            self.asked = []

        def residual(self, values):
            self.asked.append(values["p0"])
            return np.array([np.arctan(40 * (values["p0"] - 1.0))])

        def jacobian(self, values, names):
            return np.array([[40 / (1 + (40 * (values["p0"] - 1.0)) ** 2)]])

    problem = Steep()
    found = fit(problem, box(1), {"p0": 1.5}, Prior.none(), FitSettings(damping=1e-9))
    assert found.values["p0"] == pytest.approx(1.0, abs=1e-3)
    assert problem.asked[:2] == [1.5, 0.0]  # the undamped step ends at the limit, and fails
    assert 0.1 * 1.5 < problem.asked[2] < 1.5


# -- rows of shapes ----------------------------------------------------------------------------------------------------


Row = namedtuple("Row", "mode kind sensor")


class Shapes:
    """One frequency, and a shape at many sensors that nearly agrees at each third of the parameter, as another one."""

    def __init__(self, sensors):
        self.rows = (Row("1", "frequency", ""), *(Row("1", "shape", "1z") for _ in range(sensors)))
        self.asked = []

    def residual(self, values):
        self.asked.append(values["p0"])
        off = values["p0"] - 0.9
        return np.array([50 * off, *((3 + 4 * off) * np.sin(3 * np.pi * off) for _ in self.rows[1:])])

    def jacobian(self, values, names):
        off = values["p0"] - 0.9
        slope = 4 * np.sin(3 * np.pi * off) + (3 + 4 * off) * 3 * np.pi * np.cos(3 * np.pi * off)
        return np.array([[50.0], *([slope] for _ in self.rows[1:])])


@pytest.mark.parametrize("start", [0.4, 1.4, 1.6])
def test_many_rows_of_a_shape_hide_no_minimum_further_on(start):
    problem, space = Shapes(400), box(1, lower=0.0, upper=2.0)
    first = EvenWeights.of(problem)
    stuck = fit_mixed(problem, space, [{"p0": start}], Prior.none())
    found = fit_mixed(problem, space, [{"p0": start}], Prior.none(), first=first)
    assert stuck.best.converged and abs(stuck.best.values["p0"] - 0.9) > 0.2
    assert found.best.values["p0"] == pytest.approx(0.9, abs=1e-4) and found.best.misfit < 1e-4
    # A start that fits stays where it is, and few rows need no other weights.
    asked = len(problem.asked)
    assert fit_mixed(problem, space, [{"p0": 0.9}], Prior.none(), first=first).best.values["p0"] == 0.9
    assert set(problem.asked[asked:]) == {0.9}
    assert EvenWeights.of(Shapes(20)) is None
