"""Fits whose derivatives cost evaluations: updated between steps, and not evaluated where they are known."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from calib.inference.gauss_newton import FitSettings, fit
from calib.inference.integers import fit_mixed
from calib.problem.prior import Prior
from calib.problem.space import Parameter, ParameterSpace

SPACE = ParameterSpace(tuple(Parameter(name, 1.0, 0.0, 4.0, prior_sd=0.7) for name in ("p0", "p1", "p2")))


@dataclass
class Bent:
    """Sums of exponentials whose derivatives are differences, counting the runs that these take."""

    by_differences: bool
    runs: int = 0
    place: np.ndarray = field(default_factory=lambda: np.linspace(0.0, 1.0, 9))

    def curve(self, values):
        return values["p0"] * np.exp(-values["p1"] * self.place) + values["p2"] * self.place**2

    def residual(self, values):
        self.runs += 1
        return 50.0 * (self.curve(values) - self.curve({"p0": 2.7, "p1": 1.9, "p2": 0.4}))

    def jacobian(self, values, names):
        self.runs += 2 * len(names)
        ends = [[self.curve({**values, n: values[n] + d}) for d in (1e-6, -1e-6)] for n in names]
        return np.column_stack([50.0 * (a - b) / 2e-6 for a, b in ends])


def test_derivatives_that_cost_runs_are_updated_and_the_end_is_the_same():
    """The Jacobian of the result is evaluated at the end all the same: standard deviations rest on it."""
    exact, updated = Bent(False), Bent(True)
    one, other = (fit(problem, SPACE, {"p0": 3.8, "p1": 0.2, "p2": 3.0}) for problem in (exact, updated))
    assert one.converged and other.converged
    for name, value in one.values.items():
        assert other.values[name] == pytest.approx(value, abs=2e-3)
    np.testing.assert_allclose(other.jacobian, exact.jacobian(other.values, other.names), rtol=1e-6)
    assert other.jacobians < one.jacobians and updated.runs < 0.8 * exact.runs


def test_a_fit_begins_with_derivatives_that_are_known_about_and_a_ranking_ends_with_updated_ones():
    start = {"p0": 2.9, "p1": 1.6, "p2": 0.7}
    alone, begun, ranked, wrong = (Bent(True) for _ in range(4))
    end = fit(alone, SPACE, start)
    about = Bent(True).jacobian({"p0": 2.6, "p1": 1.8, "p2": 0.5}, end.names)
    other = fit(begun, SPACE, start, slope=about)
    assert end.converged and other.converged and end.evaluated and other.evaluated
    assert begun.runs < alone.runs and other.jacobians < end.jacobians
    least = fit(ranked, SPACE, start, settings=FitSettings(evaluated_end=False), slope=about)
    assert not least.evaluated and not least.jacobians and ranked.runs == least.evaluations < begun.runs
    misled = fit(wrong, SPACE, start, slope=-about)  # its first step fails, so that derivatives are evaluated there
    for one in (other, least, misled):
        for name, value in end.values.items():
            assert one.values[name] == pytest.approx(value, abs=2e-3)
    exact = Bent(False)
    assert fit(exact, SPACE, start, slope=-about).values == fit(Bent(False), SPACE, start).values


@dataclass
class Stepped(Bent):
    """The same whose sum of squares rises by 900 where a mode would lose its partner: just before the optimum."""

    places: list = field(default_factory=list)

    def residual(self, values):
        return np.append(super().residual(values), 30.0 if values["p0"] < 2.7 + 1e-3 else 0.0)

    def jacobian(self, values, names):
        self.places.append([values[n] for n in names])
        return np.vstack([super().jacobian(values, names), np.zeros(len(names))])


def test_derivatives_are_not_evaluated_again_where_they_are_known_nearby():
    """Every step to the optimum fails at the edge, where other derivatives would not help."""
    problem = Stepped(True)
    found = fit(problem, SPACE, {"p0": 3.8, "p1": 0.2, "p2": 3.0})
    assert found.values["p0"] == pytest.approx(2.7, abs=0.02)
    ranges = np.array([p.upper - p.lower for p in SPACE.free])
    apart = [np.abs(np.subtract(a, b) / ranges).max() for a, b in pairwise(problem.places)]
    assert apart and min(apart) > 0.01


def test_a_fit_that_begins_with_the_jacobian_needs_none_there():
    problem = Bent(True)
    start = {"p0": 2.7, "p1": 1.9, "p2": 0.4}
    slope = problem.jacobian(start, SPACE.names)
    problem.runs = 0
    found = fit(problem, SPACE, start, Prior.none(), slope=slope, exact=True)
    assert found.converged and found.evaluated and problem.runs == 1


class Apart(Bent):
    """The same once more below p0 = 2, where 900 are left of the sum of squares."""

    def curve(self, values):
        return super().curve({**values, "p0": values["p0"] + 1.2 * (values["p0"] < 2.0)})

    def residual(self, values):
        return np.append(super().residual(values), 30.0 * (values["p0"] < 2.0))

    def jacobian(self, values, names):
        return np.vstack([super().jacobian(values, names), np.zeros(len(names))])


def test_a_start_that_cannot_come_near_a_better_one_ends_where_its_steps_promise_little():
    starts = [{"p0": 3.8, "p1": 0.2, "p2": 3.0}, {"p0": 1.7, "p1": 1.0, "p2": 1.0}]
    runs = []
    for some in (starts[:1], starts[1:], starts):
        problem = Apart(True)
        found = fit_mixed(problem, SPACE, some)
        runs.append(problem.runs)
    alone, (best, other) = fit(Apart(True), SPACE, starts[1]), found.by_start
    assert found.best is best and best.converged and alone.converged and not other.converged
    assert alone.values["p0"] == pytest.approx(1.5, abs=0.02) and runs[2] < sum(runs[:2])
    assert alone.misfit <= other.misfit < alone.misfit + 1.0 and "another start ends at" in other.reason
    assert all(end.converged for end in fit_mixed(Apart(False), SPACE, starts).by_start)
