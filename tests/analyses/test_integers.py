"""Calibration of integer parameters."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from calib.analyses import case_starts
from calib.command import cli
from calib.inference.rules import RULES
from calib.inference.verdicts import identified_sentence
from tests.template import plain

FUNCTION = """
def answer(values):
    return {"y": values["a"] + values["n"] ** 2, "z": values["n"], "w": values["a"]}
"""
SPACE = '(Parameter("a", 2.0, 1.0, 3.0), Parameter("n", 3.0, 1.0, 9.0, integer=True))'
ASKED = """
[calibration]
starts = 1
cases = [{ name = "A1", seed = 1 }]
"""
UNTRIED = "Not all neighbours of these integers were tried: another combination may fit better."

pytestmark = pytest.mark.usefixtures("functions_in_this_process")


@pytest.mark.medium
@pytest.mark.parametrize("refits", [RULES.refits, 2])
def test_an_incomplete_search_over_integers_is_reported(here, monkeypatch, capsys, refits):
    monkeypatch.setattr(case_starts, "RULES", replace(RULES, refits=refits))
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    measured = {"y": (51.0, 0.1), "z": (7.0, 0.1), "w": (2.0, 0.1)}
    plain.write(Path("plain"), FUNCTION, ASKED, SPACE, '["a", "n"]', **measured)
    assert cli.execute(["calibrate", "plain", "--method", "gauss-newton", "--workers", "1", "--verbose"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (UNTRIED in out) == (refits == 2)
    assert "by how much worse their neighbours fit: n." in out
    verdicts = pd.read_csv("results/plain/gauss-newton/verdicts.csv")  # integers count among the fitted parameters
    assert len(verdicts) == 2 and identified_sentence(verdicts) in out and "of 1 parameters" not in out


WHOLE = """
def answer(values):
    return {"y": values["m"] + values["n"] ** 2, "z": values["n"], "w": values["m"] * values["n"]}
"""
WHOLE_SPACE = """
tuple(Parameter(name, 3.0, 1.0, 9.0, integer=True) for name in "mn"),
(LinearConstraint("sum", (("m", 1.0), ("n", 1.0)), 0.0, 11.0),),
"""


@pytest.mark.slow
@pytest.mark.parametrize("more", ["refine = true", "refine = false", 'method = "gauss-newton"'])
def test_a_study_of_integers_alone_is_calibrated(here, monkeypatch, more):
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    asked = ASKED.replace("starts = 1", f"population = 8\ngenerations = 4\n{more}")
    measured = {"y": (53.02, 0.1), "z": (7.01, 0.1), "w": (28.01, 0.1)}
    plain.write(Path("whole"), WHOLE, asked, WHOLE_SPACE, '["m", "n"]', **measured)
    assert cli.execute(["run" if more == "refine = true" else "calibrate", "whole", "--workers", "1"]) == 0
    found = pd.read_csv("results/whole/parameters.csv").set_index("parameter")
    assert list(found.index) == ["m", "n"] and (found["value"] % 1 == 0).all()
    if more != "refine = false":  # a search this small need not end there
        assert found["value"].to_dict() == {"m": 4.0, "n": 7.0}
        assert found["identified"].all() and found["std"].isna().all()
        points = pd.read_csv("results/whole/points.csv").set_index("point")["sum_of_squares"]
        assert points["least squares"] == pytest.approx((0.2**2 + 0.1**2 + 0.1**2), rel=1e-6)
