"""Staged calibration: a study that adopts values found by an earlier one."""

import json
import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.provenance.isolation import isolated
from calib.analyses.provenance.stale import stale_answers
from calib.analyses.staged import earliest_first, values_found
from calib.command import cli
from calib.errors.errors import InputError
from calib.results.results import Results
from calib.study.study import EvaluationSource, LoadedStudy
from calib.study.study_file import StudyFile
from calib.study.study_text import read_settings

MODEL = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

SPACE = ParameterSpace(tuple(Parameter(name, 2.0, 1.0, 3.0) for name in "abc"))

def answer(values):
    a, b, c = (values[n] for n in "abc")
    return {"p": a + b, "q": a - b, "r": a * c, "s": b + c}

def model():
    return FunctionModel("plain", SPACE, answer)
"""
STUDY = """
title = "{title}"
model = "model.py:model"
selection = {selection}
{adopted}
[measurement]
responses = "measured.csv"
[calibration]
method = "gauss-newton"
starts = 2
cases = [{{ name = "A1", seed = 1 }}]
"""
ROOT = Path("results")
ADOPTED = '[adopted]\nstudy = "../one"\nparameters = ["a", "b"]\n'

pytestmark = pytest.mark.usefixtures("functions_in_this_process", "undrawn")


def write(folder, title, selection, measured, adopted=""):
    folder.mkdir()
    (folder / "model.py").write_text(MODEL)
    (folder / "measured.csv").write_text("response,value,std\n" + "".join(f"{n},{v},0.01\n" for n, v in measured))
    (folder / "study.toml").write_text(STUDY.format(title=title, selection=json.dumps(selection), adopted=adopted))
    return folder


def insert(folder, before, line):
    path = Path(folder, "study.toml")
    path.write_text(path.read_text().replace(before, line + before, 1))


def write_both(home):
    """Stage one finds a = 2.3 and b = 1.2; stage two holds them and finds c = 1.5."""
    write(home / "one", "One", ["a", "b"], (("p", 3.5), ("q", 1.1)))
    write(home / "two", "Two", ["c"], (("r", 3.45), ("s", 2.7)), ADOPTED)


@pytest.fixture
def stages(tmp_path, monkeypatch):
    """Both studies in the current folder."""
    monkeypatch.chdir(tmp_path)
    write_both(tmp_path)


@pytest.fixture(scope="module")
def calibrated(functions_in_this_process, tmp_path_factory):
    """A folder in which stage one was calibrated."""
    home = tmp_path_factory.mktemp("calibrated")
    write_both(home)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        patch.setattr("calib.report.figures.Figures.save", lambda *given: [])
        assert cli.execute(["calibrate", "one"]) == 0
    return home


@pytest.fixture
def found(stages, calibrated):
    """Both studies in the current folder, with the results of stage one."""
    shutil.copytree(calibrated / "results", "results")


@pytest.mark.medium
def test_the_earlier_study_runs_first_and_its_values_are_held(stages, capsys):
    assert cli.execute(["calibrate", "two"]) == 0
    assert "One comes first: two takes over what it finds." in capsys.readouterr().out
    found = pd.read_csv("results/two/parameters.csv")
    assert found["parameter"].tolist() == ["c"] and found["value"].item() == pytest.approx(1.5, abs=1e-3)
    study = LoadedStudy.load(Path("two"), *values_found(LoadedStudy.load(Path("one")), Path("results")))
    assert study.search_space.values["a"] == pytest.approx(2.3, abs=1e-3)
    assert study.search_space.free_names == ("c",) and study.sensitivity_space.free_names == ("c",)


@pytest.mark.medium
def test_values_in_another_unit_are_refused(found, capsys):
    table, model = Path("results/one/parameters.csv"), Path("two/model.py")
    told = pd.read_csv(table)
    Results(table.parent).write_table("parameters", told.assign(unit=["kg", *told["unit"][1:]]))
    assert cli.execute(["compare", "two"]) == 2
    said = capsys.readouterr().err
    assert "a is in kg" in said and "parameters.csv" in said
    Results(table.parent).write_table("parameters", told)
    model.write_text(model.read_text().replace("2.0, 1.0, 3.0)", '2.0, 1.0, 3.0, "mm")'))
    assert cli.execute(["compare", "two"]) == 2
    said = capsys.readouterr().err
    assert "a is in mm here and in - in one" in said and "study.toml" in said


@pytest.mark.medium
def test_uncertainty_of_the_first_stage_widens_the_second(stages):
    """r = a c and s = b + c, a and b to 0.01 / sqrt(2) each from their sum and difference."""
    assert cli.execute(["calibrate", "two"]) == 0
    a, c, std = 2.3, 1.5, 0.01
    known = 1 / (a**2 + 1)
    drift = known * np.array([a * c, 1.0]) / np.sqrt(2)  # of c by one standard deviation of a and of b
    expected = std * np.sqrt(known + drift @ drift)
    found = pd.read_csv("results/two/parameters.csv")["std"].item()
    assert found == pytest.approx(expected, rel=0.02) and found > 1.2 * std * np.sqrt(known)


@pytest.mark.medium
def test_existing_results_are_reused_silently(found, capsys):
    made = Path("results/one/summary.json").stat().st_mtime_ns
    for verb in ("compare", "calibrate"):
        assert cli.execute([verb, "two"]) == 0
        assert "comes first" not in capsys.readouterr().out
    assert Path("results/one/summary.json").stat().st_mtime_ns == made


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("measured.csv", "3.5", "3.6"),
        ("model.py", "a + b", "a + 1.01 * b"),
        ("study.toml", "starts = 2", "starts = 3"),
        ("study.toml", "selection = [", 'parameters.a.search = [1.5, 3.0]\nselection = ['),
    ],
)  # fmt: skip
def test_results_of_another_state_of_the_study_are_repeated(found, capsys, file, old, new):
    path = Path("one", file)
    path.write_text(path.read_text().replace(old, new))
    assert cli.execute(["compare", "two"]) == 0
    assert "One comes first" in capsys.readouterr().out
    assert cli.execute(["compare", "two"]) == 0
    assert "comes first" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("on_paper", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_results_that_rest_on_adopted_values_are_stale_when_those_change(stages, on_paper):
    def outdated():
        given = StudyFile.read(Path("two")) if on_paper else _two()
        return stale_answers(given, Results(ROOT / "two")).sentences

    assert cli.execute(["calibrate", "two"]) == 0 and not outdated()
    assert cli.execute(["calibrate", "one"]) == 0 and not outdated()
    path = Path("one/measured.csv")
    path.write_text(path.read_text().replace("3.5", "3.6"))
    assert cli.execute(["calibrate", "one"]) == 0
    assert set(outdated()) == {"compare", "calibrate"} and all("adopted from" in w for w in outdated().values())
    assert cli.execute(["calibrate", "two"]) == 0 and not outdated()


@pytest.mark.medium
def test_damaged_results_of_the_earlier_study_make_nothing_stale(stages):
    assert cli.execute(["calibrate", "two"]) == 0
    Path("results/one/summary.json").write_text("{}")
    assert not stale_answers(StudyFile.read(Path("two")), Results(ROOT / "two")).sentences


@pytest.mark.slow
def test_a_quick_run_accepts_quick_results(stages, capsys):
    assert cli.execute(["calibrate", "two", "--quick"]) == 0
    assert Path("results/one/quick/summary.json").exists() and not Path("results/one/summary.json").exists()
    assert cli.execute(["calibrate", "two"]) == 0
    assert capsys.readouterr().out.count("One comes first") == 2 and Path("results/one/summary.json").exists()


@pytest.mark.medium
def test_a_quick_run_takes_the_selection_of_a_quick_sensitivity_analysis(stages):
    file = Path("one/study.toml")
    file.write_text(file.read_text().replace('["a", "b"]', '"from sensitivity"') + "[sensitivity]\nsamples = 20\n")
    assert cli.execute(["calibrate", "two", "--quick", "--workers", "1"]) == 0
    assert Path("results/one/quick/selection.csv").exists() and not Path("results/one/selection.csv").exists()
    found = values_found(LoadedStudy.load(Path("one")), Path("results"), quick=True)
    assert found.values["a"] == pytest.approx(2.3, abs=1e-3)


@pytest.mark.medium
def test_what_a_worker_starts_from_holds_the_values_too(found):
    study = _two()
    evaluate = pickle.loads(pickle.dumps(EvaluationSource.of(study, study.problem)))()
    assert evaluate({"c": 1.4}) == study.problem.evaluate({"c": 1.4})
    assert evaluate({"c": 1.4})["r"] == pytest.approx(2.3 * 1.4, abs=1e-2)


@pytest.mark.slow
def test_worker_processes_hold_the_values_too(found, monkeypatch):
    text = Path("two/study.toml").read_text().replace('method = "gauss-newton"', "population = 6\ngenerations = 3")
    Path("two/study.toml").write_text(text)
    shutil.copytree("results", "again")
    assert cli.execute(["calibrate", "two", "--workers", "1", "--results", "again"]) == 0
    monkeypatch.setattr("calib.api.staged.isolated", isolated)
    assert cli.execute(["calibrate", "two", "--workers", "2"]) == 0
    first, second = (Path(root, "two/parameters.csv").read_bytes() for root in ("results", "again"))
    assert first == second


@pytest.mark.medium
def test_three_stages(stages):
    write(Path("three"), "Three", ["c"], (("r", 3.45), ("s", 2.7)), ADOPTED.replace("one", "two"))
    assert [f.parent.name for f in earliest_first(Path("three"))] == ["one", "two", "three"]
    assert cli.execute(["compare", "three"]) == 0
    held = LoadedStudy.load(Path("three"), *values_found(_two(), Path("results"))).search_space.values
    assert held["b"] == pytest.approx(1.2, abs=1e-3)


def _two():
    return LoadedStudy.load(Path("two"), *values_found(LoadedStudy.load(Path("one")), Path("results")))


@pytest.mark.medium
def test_an_extended_study_holds_the_same_values_in_any_folder(stages):
    for folder in ("one", "two"):
        insert(folder, "selection", 'effects = "effects.py:library"\n')
        Path(folder, "effects.py").write_text(EFFECTS)
    Path("deep/er").mkdir(parents=True)
    assert cli.execute(["extend", "two", "more", "--into", "deep/er/two_more"]) == 0
    assert read_settings(Path("deep/er/two_more/study.toml")).adopted.study == "../../../one"
    assert cli.execute(["calibrate", "deep/er/two_more"]) == 0


EFFECTS = """
from calib.problem.effect import Effect
from calib.problem.space import Parameter

def library():
    def build(model):
        return lambda v: model.function(v) | {"r": model.function(v)["r"] + v["more"]}
    return (Effect("more", "More", "nothing", "nothing", Parameter("more", 0.0, 0.0, 1.0, "-", prior_sd=0.1), build),)
"""


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("../one", "../none"), "there is no study '../none' to adopt values from"),
        (("../one", "../two"), "it adopts values from itself"),
        (('"a", "b"', '"a", "z"'), "the value of 'z' is to come from the study '../one' and is not known"),
        (('parameters = ["a", "b"]', "parameters = []"), "adopted.parameters"),
        (("[measurement]", "[parameters.a]\nvalue = 2.5\n[measurement]"), "'a' is adopted and changed as well"),
    ],
)
def test_invalid_adoptions_are_refused(stages, capsys, change, said, one_sentence):
    path = Path("two/study.toml")
    path.write_text(path.read_text().replace(*change))
    assert cli.execute(["compare", "two"]) == 2
    told = capsys.readouterr().err
    assert said in told and "study.toml" in told and one_sentence(told)


@pytest.mark.medium
def test_a_held_parameter_cannot_be_selected(stages, capsys):
    path = Path("two/study.toml")
    path.write_text(path.read_text().replace('["c"]', '["c", "a"]'))
    assert cli.execute(["compare", "two"]) == 2
    assert "'a' is fixed and cannot be selected" in capsys.readouterr().err


def test_without_values_a_study_that_needs_them_is_not_loaded(stages):
    with pytest.raises(InputError, match="the value of 'a' is to come from"):
        LoadedStudy.load(Path("two"))


def test_a_circular_adoption_is_refused(stages, capsys):
    insert("one", "[measurement]", '[adopted]\nstudy = "../two"\nparameters = ["c"]\n')
    assert cli.execute(["compare", "two"]) == 2
    assert "adopts values from itself" in capsys.readouterr().err


@pytest.mark.slow
def test_deleted_results_are_repeated(stages, capsys):
    assert cli.execute(["compare", "two"]) == 0
    shutil.rmtree("results/one")
    capsys.readouterr()
    assert cli.execute(["compare", "two"]) == 0 and "One comes first" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("summary.json", lambda text: "{"),
        ("summary.json", lambda text: text.replace('"A1"', "7", 1)),
        ("parameters.csv", lambda text: "".join(text.splitlines(keepends=True)[:-1])),
        ("parameters.csv", lambda text: text + text.splitlines(keepends=True)[-1]),
        ("parameters.csv", lambda text: text.replace("A1,b", "A2,b")),
        ("parameters.csv", lambda text: text.replace("A1,b", "A1,d")),
        ("parameters.csv", lambda text: re.sub(r"A1,b,[^,]+", "A1,b,7.0", text)),
        ("parameters.csv", lambda text: re.sub(r"A1,b,[^,]+", "A1,b,", text)),
        ("parameters.csv", lambda text: re.sub(r"A1,b,[^,]+", "A1,b,1_2", text)),
        ("parameters.csv", lambda text: text.replace("value", "worth")),
    ],
)
def test_damaged_results_are_refused_and_left_unchanged(found, capsys, file, damage, one_sentence):
    path = Path("results/one", file)
    damaged = damage(path.read_text())
    assert damaged != path.read_text()
    path.write_text(damaged)
    assert cli.execute(["compare", "two"]) == 2
    told = capsys.readouterr()
    assert file in told.err and one_sentence(told.err) and path.read_text() == damaged


@pytest.mark.medium
@pytest.mark.parametrize("file", ["summary.json", "parameters.csv"])
def test_results_changed_by_somebody_else_are_not_adopted(found, capsys, file, one_sentence):
    """A value within its limits, in a table that can be read."""
    path = Path("results/one", file)
    changed = re.sub(r"A1,a,[^,]+", "A1,a,2.9", path.read_text()).replace('"best_case"', '"noted": 1, "best_case"')
    assert changed != path.read_text()
    path.write_text(changed)
    assert cli.execute(["compare", "two"]) == 2
    told = capsys.readouterr().err
    assert file in told and "calib calibrate" in told and "one' again" in told and one_sentence(told)
    assert cli.execute(["calibrate", "one"]) == 0 and cli.execute(["compare", "two"]) == 0


@pytest.mark.medium
def test_a_selection_changed_by_somebody_else_is_not_used(stages, capsys, one_sentence):
    file = Path("one/study.toml")
    file.write_text(file.read_text().replace('["a", "b"]', '"from sensitivity"') + "[sensitivity]\nsamples = 20\n")
    assert cli.execute(["sensitivity", "one"]) == 0
    path = Path("results/one/selection.csv")
    path.write_text(path.read_text().replace("True", "False", 1))
    assert cli.execute(["calibrate", "one"]) == 2
    told = capsys.readouterr().err
    assert "selection.csv" in told and "calib sensitivity one" in told and one_sentence(told)


def test_results_saved_by_a_spreadsheet_are_read(found):
    before = values_found(LoadedStudy.load(Path("one")), Path("results"))
    path = Path("results/one/parameters.csv")
    path.write_bytes(
        b"\xef\xbb\xbf" + path.read_bytes().replace(b",", b";").replace(b".", b",").replace(b"\n", b"\r\n")
    )
    assert values_found(LoadedStudy.load(Path("one")), Path("results")) == before
