"""Reasons of failed evaluations, and searches without a reduced basis."""

from pathlib import Path

import pytest

import calib
from calib.analyses.calibrate import calibrate
from calib.analyses.failures import reasons, stored_reasons
from calib.analyses.sensitivity import sensitivity
from calib.correlation import basis as requirements
from calib.errors.errors import ToleranceError
from calib.execution.outcome import Outcome
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy

RIG = Path(__file__).parents[2] / "studies/four_storey_rig"


def failed(error, **values):
    return Outcome(values, "failed", {}, error)


def test_reasons_that_differ_only_in_numbers_are_merged_and_the_commonest_comes_first():
    outcomes = [
        failed("no load case 'A'", x=1.0),
        Outcome({"x": 2.0}, "ok", {"y": 1.0}),
        failed("residual 1.5e-3 after 20 steps", x=3.0),
        failed("residual -2 after 21 steps", x=4.0),
    ]
    found = reasons(outcomes)
    assert [(r.error, r.points, r.first.values) for r in found] == [
        ("residual 1.5e-3 after 20 steps", 2, {"x": 3.0}),
        ("no load case 'A'", 1, {"x": 1.0}),
    ]


def test_points_that_succeeded_later_have_no_reason(tmp_path):
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        ledger.append("f", [failed("there was not enough memory", x=1.0), failed("singular", x=2.0)])
        ledger.append("f", [Outcome({"x": 1.0}, "ok", {"y": 1.0})])
        found, points = stored_reasons(ledger, ["f", "another"])
    assert [(r.error, r.points) for r in found] == [("singular", 1)] and points == 2


def test_the_commonest_reason_is_reported(sums, tmp_path):
    file = sums / "model.py"
    file.write_text(file.read_text().replace('v["a"] + v["b"]', 'v["b"] / (v["a"] < 2.0)'))
    study = LoadedStudy.load(sums)
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        answer = sensitivity(study, Results.at(tmp_path / "results", "sums"), ledger, 1, quick=True)
        found, _ = stored_reasons(ledger, [study.problem.fingerprint])
    (reason,) = found
    assert reason.points == answer.failed > 0
    assert reason.error in answer.why_failed and answer.why_failed in answer.sentences


@pytest.mark.parametrize("kept", [0.7, 0.1])
def test_a_screening_tells_lost_points_and_the_trajectories_that_they_take_along(kept):
    """A response is unknown where E and k are both large, another one everywhere known."""
    space = calib.ParameterSpace((calib.Parameter("E", 0.5, 0.0, 1.0), calib.Parameter("k", 0.5, 0.0, 1.0)))

    def beam(v):
        if v["E"] * v["k"] > kept:
            raise RuntimeError("no convergence after 40 steps")
        return {"a": v["E"] + v["k"], "b": v["E"]}

    problem = calib.Problem(calib.FunctionModel("beam", space, beam), calib.ResponseTest({"a": 1.0, "b": 0.5}))
    found = problem.sensitivity(method="morris", progress=False)
    answer, dropped = found.answer, int(found.table["dropped"].max())
    assert 0 < answer.failed < answer.points == 60 and 0 < dropped < 20
    first, why = found.sentences
    assert f"60 points, {answer.failed} failed" in first and f"{dropped} of 20 trajectories" in first
    assert "40 steps" in why and why == answer.why_failed and first in answer.answer.sure
    assert ("Fewer than 10" in first) == (dropped > 10)
    whole = screened_without_loss(space)
    assert whole.sentences == ("60 points.",)


def screened_without_loss(space):
    model = calib.FunctionModel("sum", space, lambda v: {"a": v["E"] + v["k"]})
    return calib.Problem(model, calib.ResponseTest({"a": 1.0})).sensitivity(method="morris", progress=False)


@pytest.mark.slow
def test_a_basis_that_misses_its_tolerance_is_not_used_and_not_tried_again(tmp_path, monkeypatch):
    tried = []

    def missing(self, model, space, progress):
        tried.append(space)
        raise ToleranceError("it misses its tolerance of 1e-05")

    monkeypatch.setattr(requirements, "WORTHWHILE_DOFS", 0)
    monkeypatch.setattr(requirements.BasisRequirements, "trained", missing)
    study = LoadedStudy.load(RIG)
    small = study.settings.calibration.model_copy(update={"population": 6, "generations": 3, "starts": 1})
    study = type(study)(**{**vars(study), "settings": study.settings.model_copy(update={"calibration": small})})
    results = Results.at(tmp_path / "results", "rig")
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        for _ in range(2):
            answer = calibrate(study, results, ledger, 1, method="genetic")
            assert any("it misses its tolerance of 1e-05" in note for note in answer.notes)
    assert len(tried) == 1
