"""Points that other processes solve before they are asked for: results and counts are those of one process."""

import pickle

import numpy as np
import pytest

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.response.problem import FunctionProblem
from calib.correlation.response.residual import ResponseResidual
from calib.errors.errors import EvaluationError
from calib.execution.tasks import shared_by, unreported
from calib.missing.hypotheses import Altered
from calib.problem.joint import JointProblem
from calib.problem.problem import PairProblem
from calib.problem.shared_points import solve_shared


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
