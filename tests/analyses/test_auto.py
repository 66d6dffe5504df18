"""Calibration by least squares from random starts until they agree, and by a search where they do not."""

from pathlib import Path

import pytest

from calib.analyses.calibrate import calibrate
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy

MODEL = """
import math

from calib.errors.errors import EvaluationError
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def valleys(waves=0.0, gap=0.0):
    space = ParameterSpace((Parameter("a", 1.0, -3.0, 3.0, "-"),))
    def responses(v):
        if abs(v["a"]) < gap and v["a"] != 1.0:
            raise EvaluationError("it buckles")
        return {"y": v["a"] + waves * math.sin(12.0 * v["a"]), "z": v["a"]}
    return FunctionModel("valleys", space, responses)
"""
STUDY = """
title = "Valleys"
model = "model.py:valleys"
model_options = {{ {options} }}
selection = ["a"]
[measurement]
responses = "measured.csv"
[sensitivity]
samples = 20
[calibration]
population = 10
generations = 8
{more}
cases = [{{ name = "A", seed = 1 }}, {{ name = "B", seed = 2 }}]
"""


@pytest.fixture
def answer(tmp_path):
    def found(options="", more="", quick=False, folder="results"):
        (tmp_path / "model.py").write_text(MODEL)
        (tmp_path / "measured.csv").write_text("response,value,std\ny,2.0,0.01\nz,2.0,0.5\n")
        (tmp_path / "study.toml").write_text(STUDY.format(options=options, more=more))
        study = LoadedStudy.load(tmp_path)
        results = Results.at(Path(tmp_path) / folder, study.name)
        with Ledger.open(results.path / "ledger.sqlite") as ledger:
            return calibrate(study, results, ledger, 1, quick=quick)

    return found


@pytest.mark.medium
def test_starts_that_agree_need_no_search(answer):
    found = answer()
    assert [case.search for case in found.cases] == [None, None]
    assert found.best.result.values["a"] == pytest.approx(2.0, abs=1e-3)  # the prior pulls a little
    assert [words.split(" starts")[0] for words in found.notes] == ["A: 5 of 5", "B: 5 of 5"]


@pytest.mark.slow
def test_a_search_follows_where_every_start_ends_elsewhere(answer):
    found = answer("waves = 2.0")
    assert all(case.search is not None for case in found.cases)
    assert all("A genetic search followed." in words for words in found.notes[:2])


@pytest.mark.slow
def test_least_squares_after_the_search_are_never_worse_than_the_starts(answer):
    starts = answer("waves = 2.0", 'method = "gauss-newton"\nstarts = 20')
    assert answer("waves = 2.0", folder="auto").best.statistics.criterion <= starts.best.statistics.criterion + 1e-6


@pytest.mark.medium
@pytest.mark.parametrize("more", ["weight_freq = 2.0", "refine = false"])
def test_an_objective_that_is_stated_is_searched(answer, more):
    found = answer(more=more)
    assert all(case.search is not None for case in found.cases)


@pytest.mark.medium
def test_points_that_fail_leave_the_search(answer):
    found = answer("gap = 1.5")
    assert all(case.search is not None for case in found.cases)


@pytest.mark.medium
def test_the_same_with_a_quick_run(answer):
    assert [case.search for case in answer(quick=True).cases] == [None, None]
