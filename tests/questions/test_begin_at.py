"""Where least squares begins beside where a search has ended."""

from pathlib import Path

import pytest

from calib.ledger import Ledger
from calib.questions.calibrate import calibrate
from calib.questions.case import CaseFinder
from calib.results import Results
from calib.study import Study

MODEL = """
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

def wave():
    space = ParameterSpace((Parameter("a", 0.0, -3.0, 3.0, "-"),))
    return FunctionModel("wave", space, lambda v: {"y": v["a"] ** 3 - 3 * v["a"], "z": 0.01 * v["a"]})
"""
STUDY = """
title = "Two valleys"
model = "model.py:wave"
selection = ["a"]
[measurement]
responses = "measured.csv"
[sensitivity]
samples = 20
[calibration]
{more}
cases = [{{ name = "A", seed = 1 }}]
"""
VALLEYS = (-1.0, 2.0)
"""Both have y = 2, the first touches it only; z tells that the second is right."""


@pytest.fixture
def study(tmp_path):
    def load(more):
        (tmp_path / "model.py").write_text(MODEL)
        (tmp_path / "measured.csv").write_text("response,value,std\ny,2.0,0.01\nz,0.02,0.01\n")
        (tmp_path / "study.toml").write_text(STUDY.format(more=more))
        return Study.load(tmp_path)

    return load


def answer(study, tmp_path, method):
    results = Results.at(Path(tmp_path) / "results", study.name)
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        return calibrate(study, results, ledger, 1, method=method)


@pytest.mark.parametrize("valley", VALLEYS)
def test_least_squares_end_in_the_valley_they_begin_in(study, tmp_path, valley):
    found = answer(study(f"starts = 1\nbegin_at = {{ a = {valley + 0.1} }}"), tmp_path, "gauss-newton")
    assert found.best.result.values["a"] == pytest.approx(valley, abs=0.1)


def test_a_search_is_followed_from_its_end_and_from_what_is_known(study, tmp_path, monkeypatch):
    asked, polished = [], CaseFinder.polished

    def watched(self, reduction, starts, *rest):
        asked.append(starts)
        return polished(self, reduction, starts, *rest)

    monkeypatch.setattr(CaseFinder, "polished", watched)
    small = "population = 4\ngenerations = 2\n"
    answer(study(small), tmp_path, "genetic")
    found = answer(study(small + "begin_at = { a = 1.9 }"), tmp_path, "genetic")
    assert [len(starts) for starts in asked] == [1, 2] and asked[1][1]["a"] == 1.9
    assert asked[0][0] == asked[1][0]  # the search itself does not know it
    assert found.best.result.values["a"] == pytest.approx(VALLEYS[1], abs=0.01)
