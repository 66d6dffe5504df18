"""What a calibration tells about whole-number parameters."""

from pathlib import Path

import pandas as pd
import pytest

from calib import cli
from calib.questions import case
from calib.updating.verdicts import identified_sentence

MODEL = """
from calib.function import FunctionModel
from calib.space import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("a", 2.0, 1.0, 3.0), Parameter("n", 3.0, 1.0, 9.0, integer=True)))

def answer(values):
    return {"y": values["a"] + values["n"] ** 2, "z": values["n"], "w": values["a"]}

def model():
    return FunctionModel("plain", SPACE, answer)
"""
STUDY = """
title = "Plain"
model = "model.py:model"
selection = ["a", "n"]
[measurement]
responses = "measured.csv"
[calibration]
starts = 1
cases = [{ name = "A1", seed = 1 }]
"""
UNTRIED = "Not all neighbours of these whole numbers were tried: another combination may fit better."


@pytest.mark.parametrize("refits", [case.REFITS, 2])
def test_a_search_over_whole_numbers_that_was_cut_short_says_so(tmp_path, monkeypatch, capsys, refits):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(case, "REFITS", refits)
    monkeypatch.setattr(cli, "draw_all", lambda *given: [])
    folder = Path("plain")
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY)
    (folder / "model.py").write_text(MODEL)
    (folder / "measured.csv").write_text("response,value,std\ny,51.0,0.1\nz,7.0,0.1\nw,2.0,0.1\n")
    assert cli.answer(["calibrate", "plain", "--method", "gauss-newton", "--workers", "1"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (UNTRIED in out) == (refits == 2)
    assert "by how much worse their neighbours fit: n." in out
    verdicts = pd.read_csv("results/plain/gauss-newton/verdicts.csv")  # whole numbers count among all that were fitted
    assert len(verdicts) == 2 and identified_sentence(verdicts) in out and "of 1 parameters" not in out
