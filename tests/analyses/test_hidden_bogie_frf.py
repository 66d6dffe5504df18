"""The blind bogie by its FRFs, on a reduced basis; the truth is read only after the verdict."""

import json
from pathlib import Path

import pytest

from calib.analyses.explain import explain
from calib.results.results import Results
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.whole  # minutes of training; test_frf_reduction.py covers the same with a chain
def test_the_hidden_effect_is_named_and_held_out_errors_fall(tmp_path):
    answer = explain(LoadedStudy.load(ROOT / "studies/hidden_bogie_frf"), Results.at(tmp_path, "hidden_bogie_frf"))
    assert 0 < answer.figures["basis_error"] < 0.05
    best = answer.effects.iloc[0]
    errors = answer.errors.set_index(["group", "stage"])
    for group in ("held_out_sensors", "held_out_bands"):
        assert errors.loc[(group, "after"), "p"] > 0.01
        assert errors.loc[(group, "after"), "rms"] < 0.8 * errors.loc[(group, "before"), "rms"]
    hidden = json.loads((ROOT / "tests/truth/hidden_bogie_frf.json").read_text("utf-8"))
    assert list(answer.explanation.credible) == [best["name"]] == hidden["effects"]
    assert best["magnitude_low"] < hidden["magnitudes"][best["name"]] < best["magnitude_high"]
