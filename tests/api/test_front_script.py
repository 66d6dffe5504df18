"""One script from files to report, in a folder outside the repository: every verb of the Python interface in a row."""

import ast
import functools
import shutil
import sys
from pathlib import Path

import matplotlib.axes
import pytest

import calib

STUDIES = Path(__file__).resolve().parents[2] / "studies"

SCRIPT = """
import calib
from models.railway import bogie_on_rig, bogie_effects

modes   = calib.read_modes("measured/*.uff", sensors="sensors.csv")
problem = calib.Problem(bogie_on_rig(), [calib.ModalTest(modes, held_out=["4BT"])])

problem.compare()                                   # a table; rich in a notebook
fit = problem.calibrate(["K_primary", "m_crossbar"], starts=1, seed=1)
fit.parameters                                      # value, std, identified, on_limit, confounded_with
why = fit.explain(bogie_effects())
print(why)                                          # what is missing, how sure, where to look, what to measure next
better = problem.with_effects(why.named).calibrate(starts=1)
better.figure("frequency_errors")                   # a matplotlib Axes
better.report("report.html")
calib.Study.load("studies/bogie").run()             # the same from a folder, with ledger, resume and results
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Working folder of the script: a measured bogie, and the study of another one, run in its quick mode."""
    shutil.copytree(STUDIES / "hidden_bogie/measured", tmp_path / "measured")
    (tmp_path / "measured/sensors.csv").rename(tmp_path / "sensors.csv")
    shutil.copytree(STUDIES / "bogie", tmp_path / "studies/bogie")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(calib.Study, "load", staticmethod(functools.partial(calib.Study.load, quick=True)))
    return tmp_path


@pytest.mark.slow
def test_a_script_runs_as_a_notebook_shows_it(folder, monkeypatch, capsys):
    names, shown = {}, []
    monkeypatch.setattr(sys, "displayhook", lambda value: None if value is None else shown.append(value))
    for statement in ast.parse(SCRIPT).body:  # each shows its value, as in a notebook
        exec(compile(ast.Interactive([statement]), "script", "single"), names)
        if isinstance(statement, ast.Expr) and ast.unparse(statement) == "print(why)":
            said = capsys.readouterr().out.splitlines()
    compared, parameters, axes, pages, study = shown
    assert list(compared.table["mode"]) == [f"{k}BT" for k in (1, 2, 3, 5, 6, 7, 8, 9)]  # 4BT is held out
    assert "<table" in compared._repr_html_()
    assert list(parameters.index) == ["K_primary", "m_crossbar"]
    assert {"value", "std", "identified", "on_limit", "confounded_with"} <= set(parameters.columns)
    fit, why, better = names["fit"], names["why"], names["better"]
    labels = ["Found", "How sure", "Next", "Evidence"]
    assert [word for line in said if (word := line.split(":")[0]) in labels] == labels
    printed = str(why).splitlines()
    assert said[-len(printed) :] == printed
    # Two parameters alone do not fit the bogie; no effect but the hidden one may be named.
    assert not fit.statistics.fits and {e.name for e in why.named} <= {"brake_unit"}
    assert why.verdict != "nothing_detectable"
    rms = [one.errors.set_index("group").loc["fit", "rms"] for one in (fit, better)]
    assert rms[1] < rms[0]
    assert isinstance(axes, matplotlib.axes.Axes) and axes.patches
    assert pages == (Path("report.html"),) and "</html>" in (folder / "report.html").read_text("utf-8")
    found = study.folder.path
    assert (folder / found).is_dir() and (folder / found / "report.html").is_file()
    assert list((folder / "results").rglob("ledger.sqlite"))
