"""First individuals of a search: from a file, from evaluated designs, and as values."""

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.case_starts import initial_population
from calib.errors.errors import InputError
from calib.execution.outcome import Outcome
from calib.results.ledger import Ledger
from calib.study.study import LoadedStudy

SMALL = {"population": 6, "generations": 2, "method": "genetic", "refine": False, "progress": False}


def asked(start, calls=None, **keys):
    """A search of two parameters, one an integer, with all points that it asked for."""
    space = calib.ParameterSpace([calib.Parameter("a", 0.5, 0.0, 1.0), calib.Parameter("n", 3, 0, 9, integer=True)])
    points = [] if calls is None else calls

    def respond(v):
        points.append((v["a"], v["n"]))
        return {"y": 1 + v["a"], "z": 1 + v["n"]}

    test = calib.ResponseTest({"y": (1.25, 0.01), "z": (5.0, 0.1)})
    problem = calib.Problem(calib.FunctionModel("two", space, respond), test)
    return problem.calibrate(start_population=start, **SMALL, **keys), points


@pytest.mark.medium
def test_designs_of_a_file_come_first_and_sampled_ones_fill_up(tmp_path):
    file = tmp_path / "designs.csv"
    file.write_text("rank;case;a;n\n1;GA1;0,125;4\n2;other;0,75;7\n")
    fit, points = asked(str(file))
    assert [(0.125, 4.0), (0.75, 7.0)] in (points[:2], points[1:3])  # a study solves its nominal point first
    assert fit.search.cases[0].asked == 12
    named, others = asked([{"a": 0.125, "n": 4}, {"a": 0.75, "n": 7}])
    table, _ = asked(pd.DataFrame({"n": [4, 7], "a": [0.125, 0.75]}))
    assert points == others and fit.search.parameters.equals(named.search.parameters)
    assert table.search.parameters.equals(named.search.parameters)
    plain, _ = asked(())
    assert not plain.search.parameters.equals(named.search.parameters)
    better, _ = asked([{"a": 0.25, "n": 4}])  # the truth: nothing can be better
    assert better.values["a"] == 0.25 and better.search.cases[0].misfit == 0.0


def test_what_cannot_be_an_individual_is_refused(tmp_path):
    for start, words in (
        ([{"a": 0.5}], "n of design 1 is missing"),
        ([{"a": 0.5, "n": 3}, {"a": 1.5, "n": 3}], "a of design 2 is 1.5"),
        ([{"a": 0.5, "n": 2.5}], "n of design 1 is 2.5"),
        ([{"a": 0.5, "n": 3}] * 7, "7 designs are named for 6 individuals"),
        (["design 4711"], "start_population names design 4711"),
        (["4711"], "start_population"),
        (str(tmp_path / "none.csv"), "none.csv"),
    ):
        with pytest.raises(InputError, match=words):
            asked(start)
    file = tmp_path / "designs.csv"
    file.write_text("a,n\n0.5,3\n0.5,30\n")
    with pytest.raises(InputError, match="it is 30") as refused:
        asked(str(file))
    assert "line 3" in str(refused.value) and "0 to 9" in str(refused.value)
    file.write_text("a,m\n0.5,3\n")
    with pytest.raises(InputError, match="'n'"):
        asked(str(file))


def test_a_quick_run_takes_the_first_designs():
    fit, _ = asked([{"a": 0.1 * k, "n": k} for k in range(6)])
    assert fit.search.cases[0].asked == 12
    with pytest.raises(InputError, match="7 designs"):
        asked([{"a": 0.1 * k, "n": k} for k in range(7)])
    study = fit.problem.study(fit.problem.settings.model_copy(update={"calibration": _named(fit)}))
    few = initial_population(study, None, 4, 1)
    np.testing.assert_allclose(few[:, 0], 0.1 * np.arange(4))


def _named(fit):
    designs = tuple({"a": 0.1 * k, "n": float(k)} for k in range(6))
    return fit.problem.settings.calibration.model_copy(update={"start_population": designs, "population": 6})


MODEL = """
import calib

def two():
    space = calib.ParameterSpace([calib.Parameter("a", 0.5, 0.0, 1.0)])
    return calib.FunctionModel("two", space, lambda v: {"y": 1 + v["a"]})
"""
STUDY = """
title = "Own start"
model = "model.py:two"
[measurement]
responses = "measured.csv"
[calibration]
method = "genetic"
population = 4
generations = 2
start_population = {start}
"""


def test_a_study_names_a_file_or_designs_of_its_ledger(tmp_path):
    (tmp_path / "model.py").write_text(MODEL)
    (tmp_path / "measured.csv").write_text("response,value,std\ny,1.5,0.01\n")
    (tmp_path / "start.csv").write_text("a\n0.875\n")

    def population(start):
        (tmp_path / "study.toml").write_text(STUDY.format(start=start))
        with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
            return initial_population(LoadedStudy.load(tmp_path), ledger, 4, 1)[:, 0]

    sampled = population("[]")
    first = population('"start.csv"')
    assert first[0] == 0.875 and first[1:].tolist() == sampled[1:].tolist()
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        ledger.append("f", [Outcome({"a": 0.0625}, "ok", {"y": 1.0}, "", 0.0)])
    np.testing.assert_array_equal(population('["design 1"]')[0], 0.0625)
    moved = tmp_path / "later"
    moved.mkdir()
    (moved / "study.toml").write_text('base = ".."\n')
    (tmp_path / "study.toml").write_text(STUDY.format(start='"start.csv"'))
    with Ledger.in_memory() as ledger:
        assert initial_population(LoadedStudy.load(moved), ledger, 4, 1)[0, 0] == 0.875
