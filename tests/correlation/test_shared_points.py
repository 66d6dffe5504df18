"""Points that other processes solve before they are asked for: results and counts are those of one process."""

import pickle

import numpy as np
import pytest

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import EvaluationError, InputError
from calib.execution.tasks import shared_by, unreported
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import least_squares_fit, linearised
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem
from calib.problem.shared_points import run_shared, solve_shared


@pytest.fixture
def model(build):
    return build()


@pytest.fixture
def pair(model, twin):
    truth = {"k_along": 46.0, "k_across": 12.5, "mass": 8.5, "c_end": 500.0}
    return ModalResidual(ModalProblem(model, twin(model, truth), mode_count=6))


@pytest.fixture
def new(pair, model):
    """A problem of its own: what it has solved is known to nobody else."""
    return lambda: PairProblem(pair, model.space)


class Elsewhere:
    """Does tasks as other processes do; what it did."""

    processes = 2

    def __init__(self):
        self.calls = []

    def __call__(self, function, shared, items, told=unreported):
        self.calls.append(len(items))
        there, content = pickle.loads(pickle.dumps((function, shared)))
        return [pickle.loads(pickle.dumps(there(content, item))) for item in items]


def points(model, names=("k_along", "mass")):
    return [{name: model.space[name].value * factor} for name in names for factor in (0.9, 1.1)]


def test_residuals_and_counts_are_those_of_one_process(new, model, monkeypatch):
    alone, shared, share = new(), new(), Elsewhere()
    expected = [alone.residual(values) for values in points(model)]
    with shared_by(share):
        solve_shared((shared, values) for values in [*points(model), points(model)[0]])
        with monkeypatch.context() as patch:
            patch.setattr(ModalResidual, "solve", lambda *given: pytest.fail("it is solved again"))
            found = [shared.residual(values) for values in points(model)]
        assert share.calls == [4] and (shared.counts.solved, shared.counts.reused) == (4, 0)
        solve_shared((shared, values) for values in points(model))  # known
        assert share.calls == [4]
    for one, other in zip(expected, found, strict=True):
        assert one.tobytes() == other.tobytes()
    assert shared.at(points(model)[0]).model is shared.pair.problem.model
    assert (alone.counts.solved, alone.counts.failed) == (shared.counts.solved, shared.counts.failed)


def test_a_point_that_fails_is_told_when_it_is_asked_for(new, model, monkeypatch):
    first, second, *_ = points(model)
    solve = ModalResidual.solve

    def fails(self, values, solved=None):
        if values["k_along"] == second["k_along"]:
            raise EvaluationError("no modes")
        return solve(self, values, solved)

    monkeypatch.setattr(ModalResidual, "solve", fails)
    problem = new()
    with shared_by(Elsewhere()):
        solve_shared([(problem, first), (problem, second)])
        problem.residual(first)
        for _ in range(2):
            with pytest.raises(EvaluationError, match="no modes"):
                problem.residual(second)
    assert (problem.counts.solved, problem.counts.failed) == (1, 2)


def test_points_of_several_problems_are_solved_together_and_held_values_count(new, model):
    one, other, share = new(), new(), Elsewhere()
    held, (first, *_) = {"mass": 1.05 * model.space["mass"].value}, points(model)
    joint = JointProblem({"a": one, "b": other})
    with shared_by(share):
        solve_shared([(Altered(one, 2.0, held=held), first), (joint, first)])
        assert share.calls == [3]
        joint.residual(first)
        Altered(one, held=held).residual(first)
    assert one.counts.solved == 2 and other.counts.solved == 1


def test_nothing_is_solved_without_others_or_of_a_users_function(new, model):
    problem, share, asked = new(), Elsewhere(), []
    solve_shared((problem, values) for values in points(model))

    def function(values):
        asked.append(values)
        return {"r": values["k_along"]}

    user = FunctionProblem(model.space, function, {"r": (1.0, 1.0)}, "")
    with shared_by(share):
        solve_shared((PairProblem(ResponseResidual(user), model.space), values) for values in points(model))
        solve_shared([(problem, points(model)[0])])  # one point is not shared
    assert share.calls == [] and asked == [] and problem.counts.asked == 0
    assert np.isfinite(problem.residual(points(model)[0])).all()


def fitted(problem, values):
    """A fit, which asks for points and slopes, from named values."""
    return least_squares_fit(problem, (), values)


def test_a_fit_finds_all_that_another_process_evaluated_and_counts_it(new, model, monkeypatch):
    alone, shared, share = new(), new(), Elsewhere()
    expected = [fitted(alone, values) for values in points(model)[:2]]
    with shared_by(share):
        run_shared(fitted, ((Altered(shared), values) for values in points(model)[:2]))
        assert share.calls[0] == 2 and shared.counts.asked == 0
        with monkeypatch.context() as patch:
            for name in ("solve", "slope"):
                patch.setattr(ModalResidual, name, lambda *given: pytest.fail("it is evaluated again"))
            found = [fitted(shared, values) for values in points(model)[:2]]
    for one, other in zip(expected, found, strict=True):
        assert one.values == other.values and one.slope.tobytes() == other.slope.tobytes()
    assert vars(alone.counts) == vars(shared.counts) and shared.counts.solved > 4


def test_what_was_not_foreseen_is_evaluated(new, model):
    alone, shared = new(), new()
    first, second, third, *_ = points(model)
    with shared_by(Elsewhere()):
        run_shared(fitted, [(shared, first), (shared, second)])
        found = linearised(shared, (), third)
    expected = linearised(alone, (), third)
    assert found.slope.tobytes() == expected.slope.tobytes() and vars(alone.counts) == vars(shared.counts)


def refused(problem, values):
    """A computation that asks for one point, and fails."""
    problem.residual(values)
    raise InputError("no", place="here", remedy="none")


def test_a_failure_is_left_to_the_one_who_asks(new, model):
    problem, share = new(), Elsewhere()
    first, second, *_ = points(model)
    with shared_by(share):
        run_shared(refused, [(problem, first), (problem, second)])
        assert share.calls == [2]
        with pytest.raises(InputError, match="no"):
            refused(problem, first)
    assert problem.counts.solved == 1


def test_a_users_function_is_left_to_the_one_who_asks(new, model):
    user = FunctionProblem(model.space, lambda values: {"r": values["k_along"]}, {"r": (1.0, 1.0)}, "")
    own, share = PairProblem(ResponseResidual(user), model.space), Elsewhere()
    first, second, *_ = points(model)
    with shared_by(share):
        run_shared(fitted, [(own, first), (own, second), (JointProblem({"a": new(), "b": own}), first)])
    assert share.calls == [] and own.counts.asked == 0


def test_no_fit_is_made_ahead_by_a_process_alone(new, model):
    problem, share = new(), Elsewhere()
    share.processes = 1
    first, second, *_ = points(model)
    with shared_by(share):
        run_shared(fitted, [(problem, first), (problem, second)])
    assert share.calls == [] and problem.ahead == {}


@pytest.mark.parametrize("most", [1, 3])
def test_what_is_kept_is_limited_and_changes_nothing(new, model, monkeypatch, most):
    monkeypatch.setattr("calib.problem.problem.AHEAD", most)
    alone, shared = new(), new()
    starts = points(model)[:2]
    with shared_by(Elsewhere()):
        run_shared(fitted, [(shared, values) for values in starts])
        assert len(shared.ahead) == most
        found = [fitted(shared, values) for values in starts]
    for one, values in zip(found, starts, strict=True):
        assert one.values == fitted(alone, values).values
    assert vars(alone.counts) == vars(shared.counts)


def test_a_point_that_fails_within_a_fit_counts_as_alone(new, model, monkeypatch):
    solve, failed = ModalResidual.solve, []

    def fails(self, values, solved=None):
        if abs(values["mass"] / model.space["mass"].value - 1) > 0.02 and values["k_along"] != starts[1]["k_along"]:
            failed.append(values)
            raise EvaluationError("no modes")
        return solve(self, values, solved)

    starts = points(model)[:2]
    monkeypatch.setattr(ModalResidual, "solve", fails)
    alone, shared = new(), new()
    with shared_by(Elsewhere()):
        run_shared(fitted, [(shared, values) for values in starts])
        assert failed
        found = [fitted(shared, values).values for values in starts]
    assert found == [fitted(alone, values).values for values in starts]
    assert vars(alone.counts) == vars(shared.counts) and alone.counts.failed > 0


class Other:
    """A fit problem of another kind."""


def test_problems_of_another_kind_are_left_to_the_one_who_asks(new, model):
    share, (first, second, *_) = Elsewhere(), points(model)
    with shared_by(share):
        solve_shared([(Other(), first), (Altered(Other()), first)])
        run_shared(fitted, [(Other(), first), (Altered(Other()), second)])
    assert share.calls == []
