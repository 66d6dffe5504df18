"""A study in a folder and the same study as a problem in memory: one calculation, one result, nothing dropped."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.calibrate import CalibrationRun, calibrated
from calib.analyses.hypotheses_of_study import faults_of
from calib.command import cli
from calib.command.example import write_example
from calib.results.ledger import Ledger

STUDIES = Path(__file__).resolve().parents[2] / "studies"
QUICK = ["five_mass_chain"]
LONGER = ["four_storey_rig", "four_storey_rig_wide", "four_storey_rig_masses"]
WHOLE = ["hidden_two", "hidden_bogie_joint"]
EVERY = [
    *QUICK,
    *(pytest.param(name, marks=pytest.mark.slow) for name in LONGER),
    *(pytest.param(name, marks=pytest.mark.whole) for name in WHOLE),
]


@pytest.fixture(scope="module", params=EVERY)
def doors(request, tmp_path_factory):
    """A study and its problem in memory."""
    results = tmp_path_factory.mktemp("results")
    study = calib.Study.load(STUDIES / request.param, results, workers=1, progress=False)
    return study, study.problem


def library_of(study):
    """Effects that the models of a study may lack, as a problem in memory takes them."""
    return {one.model.name: one.candidates for one in study.loaded.studies}


def same(mine, own, numbers=1e-7, least=1e-12):
    pd.testing.assert_frame_equal(mine, own, check_exact=False, rtol=numbers, atol=least)


@pytest.mark.medium
def test_a_comparison_is_the_same(doors):
    study, problem = doors
    own, mine = study.compare(), problem.compare()
    same(mine.table.reset_index(drop=True), own.table.reset_index(drop=True))
    assert [a.answer for a in mine.by_test.values()] == [a.answer for a in own.by_test.values()]


@pytest.mark.medium
def test_a_calibration_is_the_same(doors):
    study, problem = doors
    own, mine = study.calibrate().of, problem.calibrate(effects=library_of(study), progress=False)
    assert mine.answer == own.answer
    same(mine.parameters.reset_index(), own.verdicts)
    assert set(mine.calibration.tables) == set(own.tables)
    for name, table in own.tables.items():
        same(mine.calibration.tables[name], table, 1e-6)
    assert mine.calibration.sentences == own.sentences
    for one in study.loaded.studies:
        same(mine.calibration.seen(one.test).errors, own.seen(one.test).errors, 1e-6)
    for sentence in own.sentences:  # what the command prints can be printed in Python
        assert sentence in mine.sentences


@pytest.mark.slow
def test_an_explanation_is_the_same(doors):
    study, problem = doors
    study.calibrate()  # an explanation begins at the calibration of the folder, and at the fit on which it is called
    own = study.explain().of
    library = library_of(study)
    mine = problem.calibrate(effects=library, progress=False).explain(library, progress=False)
    assert (mine.verdict, mine.explanation.answer) == (own.verdict, own.answer)
    same(mine.explanation.effects, own.effects, 1e-6)
    assert mine.explanation.notes == own.notes
    for name in ("pulls", "misfit_kinds", "candidate_fits", "next_measurement"):
        same(mine.explanation.tables[name], own.tables[name], 1e-6, 1e-9)


VERBS = {
    "compare": lambda problem, library: problem.compare(),
    "sensitivity": lambda problem, library: problem.sensitivity(progress=False),
    "calibrate": lambda problem, library: problem.calibrate(progress=False),
    "explain": lambda problem, library: problem.explain(library, progress=False),
}


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    "verb", ["compare", "calibrate", *(pytest.param(v, marks=pytest.mark.slow) for v in ("sensitivity", "explain"))]
)
def test_the_command_and_python_print_the_same(verb, tmp_path, capsys):
    """Below the answer, whose last line names a folder or an attribute; a command may add what to type next."""
    folder = STUDIES / QUICK[0]
    assert cli.execute([verb, str(folder), "--results", str(tmp_path)]) == 0
    out = capsys.readouterr().out.replace("-v shows all", ".entries has all")
    command = [line for line in out.splitlines() if line]
    study = calib.Study.load(folder, tmp_path / "other", workers=1, progress=False)
    python = [line for line in str(VERBS[verb](study.problem, study.effects)).splitlines() if line]
    assert [line.split(":")[0] for line in python[:4]] == ["Found", "How sure", "Next", "Evidence"]
    assert command[1:4] == python[:3] and command[4].startswith("Results:")
    typed = [line for line in command[5:] if line not in python]
    assert len(python) > 6 and [line for line in python[4:] if line not in command] == []
    assert all(line.split(": ")[-1].startswith("calib ") for line in typed)


@pytest.mark.medium
def test_set_ups_are_suspected_from_both_doors(tmp_path):
    folder = shutil.copytree(STUDIES / "hidden_bogie", tmp_path / "bogie")
    file = folder / "study.toml"
    sensors = [sensor.name for sensor in calib.Study.load(folder, progress=False).loaded.measured.sensors]
    assert [sensor.name for sensor in calib.Study(str(folder)).loaded.measured.sensors] == sensors
    first, second = (str(own).replace("'", '"') for own in (sensors[::2], sensors[1::2]))
    text = file.read_text("utf-8").replace("[measurement]", f"[measurement]\nset_ups = {{ a = {first}, b = {second} }}")
    file.write_text(text, "utf-8")
    study = calib.Study.load(folder, progress=False)
    own, mine = (
        [fault.name for fault in faults_of(one) if "set-up" in fault.name]
        for one in (study.loaded, study.problem.study())
    )
    assert own == mine and [name.split()[-1] for name in own] == ["a", "b"]


@pytest.mark.medium
def test_a_key_of_a_study_holds_in_its_problem_until_an_argument_replaces_it(tmp_path):
    write_example(tmp_path / "mast")
    file = tmp_path / "mast/study.toml"
    text = file.read_text("utf-8")
    key = "[explain]\nalpha = 0.2\n"
    file.write_text(text.replace("[explain]\n", key) if "[explain]\n" in text else f"{text}\n{key}", "utf-8")
    problem = calib.Study.load(tmp_path / "mast", tmp_path / "results", progress=False).problem
    assert problem.statistics_at({}).statistics.alpha == 0.2
    fit = problem.calibrate(starts=1, alpha=0.05, progress=False)
    assert fit.statistics.alpha == 0.05 and np.isfinite(fit.statistics.misfit)


LEVERS = """
import calib

def levers():
    whole = [calib.Parameter(name, 3.0, 0.0, 6.0, integer=True) for name in ("a", "b")]
    space = calib.ParameterSpace((calib.Parameter("k", 2.0, 1.0, 5.0), *whole))
    return calib.FunctionModel("levers", space, lambda v: {
        "ka": v["k"] * v["a"], "ab": v["a"] + v["b"] ** 2, "kb": v["k"] + v["b"],
    })
"""
"""Measured at k = 3, a = 2 and b = 5."""


@pytest.mark.medium
def test_integers_are_searched_alike_from_both_doors(tmp_path):
    """Two positions with 49 combinations: a search finds them, where every start would walk to them for itself."""
    folder = tmp_path / "levers"
    folder.mkdir()
    (folder / "model.py").write_text(LEVERS)
    (folder / "measured.csv").write_text("response,value,std\nka,6.0,0.05\nab,27.0,0.1\nkb,8.0,0.05\n")
    keys = 'title = "Levers"\nmodel = "model.py:levers"\nselection = ["k", "a", "b"]\n'
    keys += '[measurement]\nresponses = "measured.csv"\n[calibration]\npopulation = 10\ngenerations = 12\n'
    (folder / "study.toml").write_text(keys)
    study = calib.Study.load(folder, tmp_path / "results", workers=1, progress=False)
    calls, problem = [], study.problem

    def counted(values):
        calls.append(values)
        return problem.model.function(values)

    mine = replace(problem, model=replace(problem.model, function=counted)).calibrate(progress=False)
    with Ledger.in_memory() as ledger:
        own = calibrated(study.loaded, CalibrationRun(ledger, workers=1))
    cases = [mine.cases.best, own.best]
    assert [case.search.asked for case in cases] == [120, 120]  # of both a search, with as many individuals
    assert cases[0].search.values == cases[1].search.values and mine.values == own.best.statistics.values
    assert (round(mine.values["k"], 1), mine.values["a"], mine.values["b"]) == (3.0, 2, 5)
    assert len(calls) < 300


@pytest.mark.medium
def test_held_out_data_that_contradict_are_printed_in_python_too():
    """Two stiffnesses fit two frequencies of a chain exactly; the third, which no fit saw, is far off."""
    parameters = [calib.Parameter(name, 10.0, 1.0, 90.0, "kN/m") for name in ("k1", "k2")]
    space = calib.ParameterSpace(parameters)
    model = calib.FunctionModel("two springs", space, lambda v: {"a": v["k1"], "b": v["k2"], "c": v["k1"] + v["k2"]})
    test = calib.ResponseTest({"a": (20.0, 0.1), "b": (30.0, 0.1), "c": (52.0, 0.1)}, held_out=["c"])
    fit = calib.Problem(model, test).calibrate(progress=False)
    (told,) = fit.contradictions
    assert told in str(fit) and told in fit._repr_html_() and told in fit.sentences
    right = calib.ResponseTest({"a": (20.0, 0.1), "b": (30.0, 0.1), "c": (50.0, 0.1)}, held_out=["c"])
    assert calib.Problem(model, right).calibrate(progress=False).contradictions == ()
