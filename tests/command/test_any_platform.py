"""The command on terminals of old code pages, and with names that no file can have."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from calib.command import cli, terminal

ROOT = Path(__file__).resolve().parents[2]
MODEL = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0),))

def model():
    return FunctionModel("plain", SPACE, lambda v: {"f \u2212 \u6865": v["a"]})
"""
STUDY = """
title = "Bridge \u2212 \u6865\u6881"
model = "model.py:model"
selection = ["a"]
[measurement]
responses = "measured.csv"
[calibration]
cases = [{ name = "A1", seed = 1 }]
"""

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.mark.parametrize(
    ("page", "whole"),
    [pytest.param("ascii", True, marks=pytest.mark.slow), ("ascii", False), ("cp1252", False), ("utf-8", False)],
)
def test_any_name_can_be_told_in_any_code_page(tmp_path, monkeypatch, page, whole):
    """Slowly by a whole command; the other cases call its writing functions."""
    folder = tmp_path / "plain"
    folder.mkdir()
    for name, text in (
        ("model.py", MODEL),
        ("study.toml", STUDY),
        ("measured.csv", "response,value\nf \u2212 \u6865,2.5\n"),
    ):
        (folder / name).write_text(text, encoding="utf-8")
    if whole:
        command = [sys.executable, "-m", "calib", "compare", "plain"]
        given = {**os.environ, "PYTHONIOENCODING": page, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(command, cwd=tmp_path, env=given, capture_output=True)
        assert (done.returncode, done.stderr) == (0, b"")
        told = done.stdout.decode(page)
    else:
        monkeypatch.chdir(tmp_path)
        stream = io.TextIOWrapper(io.BytesIO(), page, write_through=True)
        monkeypatch.setattr(sys, "stdout", stream)
        terminal.write_to_any_code_page()
        assert cli.execute(["compare", "plain"]) == 0
        told = stream.buffer.getvalue().decode(page)
    title, name = ("Bridge \u2212 \u6865\u6881", "f \u2212 \u6865") if page == "utf-8" else ("Bridge - ??", "f - ?")
    assert f"{title}: compare" in told and name in told


@pytest.mark.parametrize("name", ["x" * 300, "deep/" + "\u6865" * 90])
@pytest.mark.parametrize("arguments", [["compare"], ["report"], ["new"], ["compare", "study", "--results"]])
def test_a_name_that_no_folder_can_have(tmp_path, monkeypatch, capsys, arguments, name):
    monkeypatch.chdir(tmp_path)
    assert cli.execute([*arguments, name]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not list(tmp_path.iterdir())
