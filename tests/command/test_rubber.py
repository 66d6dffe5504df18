"""``calib explain`` of a bogie whose primary springs are rubber, from files alone; the measurement is synthetic."""

import json
import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

BOGIE = runpy.run_path(str(Path(__file__).with_name("rubber_bogie.py")))
SHARE, CORNER = 0.6, 8.0
pytestmark = pytest.mark.slow


def relaxing(lam):
    return 1 + SHARE * lam / (lam + 2 * np.pi * CORNER)


def explained(folder, asked, law):
    BOGIE["write_study"](folder, law, 1)
    out = asked(folder, "explain", ".", "--results", "r")
    (results,) = (folder / "r").iterdir()
    told = json.loads((results / "explanation.json").read_text("utf-8"))
    return told, pd.read_csv(results / "effects.csv").set_index("name"), out


def test_relaxing_rubber_of_the_primary_suspension_is_named_with_its_interval(tmp_path, asked):
    told, effects, out = explained(tmp_path, asked, relaxing)
    assert told["verdict"] == "effect" and told["chosen"] == told["credible_set"] == ["primary_rubber"]
    row = effects.loc["primary_rubber"]
    assert row["magnitude_low"] < SHARE < row["magnitude_high"] and row["ln_bayes"] > 10
    assert "The model lacks rubber that relaxes in the primary springs" in out
    assert "Add it with: calib extend . primary_rubber" in out and "[synthetic measurement]" in out


def test_primary_springs_of_steel_are_left_alone(tmp_path, asked):
    told, _, out = explained(tmp_path, asked, lambda lam: 1.0)
    assert told["verdict"] == "nothing_detectable" and told["chosen"] == []
    assert "no missing effect is detectable" in out
