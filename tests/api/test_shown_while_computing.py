"""Calls from Python: how far they are below a notebook's cell, and the user's line in a failure."""

import io
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console

import calib
from calib.api import progress
from calib.command.example import write_example
from calib.errors.own_code import defined_at

SPACE = calib.ParameterSpace((calib.Parameter("a", 2.0, 1.0, 3.0), calib.Parameter("b", 1.0, 0.5, 2.0)))
ACTS = {
    "calibrate": lambda problem, **how: problem.calibrate(starts=1, **how),
    "sensitivity": lambda problem, **how: problem.sensitivity(samples=20, **how),
    "search": lambda problem, **how: problem.search(cases=1, population=4, generations=2, **how),
    "explain": lambda problem, **how: problem.explain(**how),
}


def answer(values):
    return {f"y{k}": values["a"] * k + values["b"] for k in range(1, 7)}


def lacking(values):
    return {"y1": 1.0}


def problem_of(function):
    measured = {f"y{k}": (2.1 * k + 0.9 + 0.01 * (-1) ** k, 0.02) for k in range(1, 7)}
    return calib.Problem(calib.FunctionModel("plain", SPACE, function), calib.ResponseTest(measured))


@pytest.fixture
def cell(monkeypatch):
    """What a notebook shows below the cell, one entry a change."""
    shown = []

    def display(data, raw, display_id):
        shown.append(data["text/plain"])
        return SimpleNamespace(update=lambda data, raw: shown.append(data["text/plain"]))

    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    console = Console(file=io.StringIO(), force_jupyter=True)
    monkeypatch.setattr(progress, "error_stream", lambda: console)
    monkeypatch.setattr(progress, "OFTEN", 0.0)
    return shown


@pytest.mark.parametrize("verb", ACTS)
def test_a_notebook_shows_the_stage_until_the_end(cell, verb):
    ACTS[verb](problem_of(answer))
    assert len(cell) > 2 and all(words.startswith(f"{verb}: ") for words in cell[:-1]) and cell[-1] == ""
    assert len(set(cell)) > 2


@pytest.mark.parametrize("verb", ACTS)
def test_a_notebook_shows_nothing_that_is_not_wanted(cell, verb):
    ACTS[verb](problem_of(answer), progress=False)
    assert cell == []


def test_the_line_is_cleared_by_a_failure_too(cell):
    with pytest.raises(calib.EvaluationError):
        problem_of(lacking).sensitivity(samples=20)
    assert len(cell) > 1 and cell[-1] == ""


def test_a_terminal_shows_a_bar_and_a_file_nothing(monkeypatch):
    terminal, file = io.StringIO(), io.StringIO()
    for stream, is_terminal in ((terminal, True), (file, False)):
        console = Console(file=stream, force_terminal=is_terminal, width=80)
        monkeypatch.setattr(progress, "error_stream", lambda console=console: console)
        problem_of(answer).calibrate(starts=1)
    assert "calibrate" in terminal.getvalue() and file.getvalue() == ""


def test_two_analyses_at_once_share_a_terminal(monkeypatch):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=80)
    monkeypatch.setattr(progress, "error_stream", lambda: console)
    with progress.in_python("outer") as outer:
        fit = problem_of(answer).calibrate(starts=1)
        outer("last", 1, 2)
    assert fit.statistics.fits and "outer: last 1/2" in stream.getvalue()


@pytest.mark.parametrize("act", [*ACTS.values(), calib.Problem.compare, lambda problem: problem.statistics_at({})])
def test_a_wrong_result_shows_the_function_that_gave_it(act):
    with pytest.raises((calib.EvaluationError, calib.InputError)) as caught:
        act(problem_of(lacking))
    place = defined_at(lacking)
    assert caught.value.at == place and f"{place.line} | {place.text}" in caught.value.__notes__[-1]


@pytest.mark.medium
@pytest.mark.parametrize("wanted", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_study_shows_its_stage_unless_told_otherwise(cell, wanted, tmp_path, unrendered):
    write_example(tmp_path / "mast")
    study = calib.Study.load(tmp_path / "mast", tmp_path / "results", workers=1, quick=True, progress=wanted)
    study.compare()
    assert any(words.startswith("compare: ") for words in cell) == wanted
    assert (cell[-1:] == [""]) == wanted
    cell.clear()
    for table in ("mesh_points", "deflection_before"):  # of the figures in space, which take longest
        (study.folder.path / f"{table}.csv").unlink()
    calib.Study.load(tmp_path / "mast", tmp_path / "results", progress=wanted).report()
    assert any(words.startswith("report: ") for words in cell) == wanted
