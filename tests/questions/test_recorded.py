"""Least squares reads the ledger: no point is solved a second time, within a run and in the next one."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.scatter import Floors
from calib.errors import EvaluationError
from calib.ledger import Ledger, key_of
from calib.questions.calibrate import calibrate
from calib.questions.judge import RecordedResidual, fitted
from calib.results import Results
from calib.sensitivity.sampling import sample
from calib.study import Study

RIG = Path(__file__).parents[2] / "studies/four_storey_rig"
PLAIN = """
from pathlib import Path
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0), Parameter("b", 2.0, 1.0, 3.0)))

def answer(values):
    with Path("asked").open("a") as stream:
        stream.write("one\\n")
    return {"y": values["a"] ** 2, "z": values["a"] + values["b"], "w": values["b"] ** 3}

def model():
    return FunctionModel("plain", SPACE, answer)
"""
PLAIN_STUDY = """
title = "Plain"
model = "model.py:model"
selection = ["a", "b"]
[measurement]
responses = "measured.csv"
[withheld]
responses = ["w"]
[calibration]
method = "gauss-newton"
starts = 3
cases = [{ name = "A1", seed = 1 }, { name = "A2", seed = 2 }]
"""


@pytest.fixture
def solved(monkeypatch):
    """How often every point was solved."""
    counted, compare = Counter(), ModalProblem.compare

    def counting(self, values):
        counted[key_of(self.space.complete(values))] += 1
        return compare(self, values)

    monkeypatch.setattr(ModalProblem, "compare", counting)
    return counted


def test_modes_are_solved_once_and_not_again_by_the_next_run(tmp_path, solved):
    study = Study.load(RIG)
    space = study.search_space
    starts = [space.complete(x) for x in sample(space, 3, 1).points]
    found = []
    for _ in range(2):
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            solved.clear()
            found.append((fitted(study, RecordedResidual(study.problem, ledger), starts, 1), sum(solved.values())))
            assert sum(solved.values()) <= ledger.count(study.problem.fingerprint) + 1  # and the modes to predict
    (first, many), (second, few) = found
    assert many > 10 and few <= 1
    assert second.values == first.values and second.misfit == first.misfit
    assert np.array_equal(second.fit.jacobian, first.fit.jacobian)
    assert second.predictions.equals(first.predictions)


def test_a_point_that_could_not_be_solved_is_not_tried_again(tmp_path, solved):
    problem = replace(Study.load(RIG).problem, mode_count=5)  # of a model with four
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        said = []
        for _ in range(2):
            with pytest.raises(EvaluationError) as fault:
                RecordedResidual(problem, ledger).residual(problem.space.values)
            said.append(str(fault.value))
    assert said[0] == said[1] and sum(solved.values()) == 1


def test_residuals_in_other_units_are_kept_apart():
    problem = Study.load(RIG).problem
    one, other = ModalResidual(problem), ModalResidual(problem, Floors(freq=0.5))
    assert one.fingerprint == ModalResidual(problem).fingerprint != other.fingerprint


def test_a_function_is_asked_once_a_point(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("plain").mkdir()
    Path("plain/model.py").write_text(PLAIN)
    Path("plain/study.toml").write_text(PLAIN_STUDY)
    Path("plain/measured.csv").write_text("response,value,std\ny,5.0,0.1\nz,4.0,0.1\nw,6.0,0.1\n")
    study, tables = Study.load(Path("plain")), []
    for asked_again in (1, 1):  # to see whether the model answers as it did
        before = len(Path("asked").read_text().split()) if Path("asked").exists() else 0
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            known = ledger.count(study.problem.fingerprint)
            answer = calibrate(study, Results.at(tmp_path / "results", "plain"), ledger)
            new = ledger.count(study.problem.fingerprint) - known
        tables.append(answer.parameters)
        assert len(Path("asked").read_text().split()) - before == new + asked_again
        assert (new > 20) == (known == 0)
    assert tables[0].equals(tables[1])
