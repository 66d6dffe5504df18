"""The blind bogie by its modes and FRFs together; the truth is read only after the verdict."""

import json
from pathlib import Path

import pandas as pd
import pytest

from calib.command import cli
from calib.study.several import load

ROOT = Path(__file__).resolve().parents[2]
HELD_OUT = {"modes": ["held_out_sensors"], "frfs": ["held_out_sensors", "held_out_bands"]}


@pytest.mark.slow
def test_each_test_holds_out_what_its_own_study_holds_out():
    study = load(ROOT / "studies/hidden_bogie_joint")
    for one, name in zip(study.studies, ("hidden_bogie", "hidden_bogie_frf"), strict=True):
        alone = load(ROOT / f"studies/{name}")
        assert one.settings.held_out == alone.settings.held_out and one.settings.pairing == alone.settings.pairing
        assert one.settings.parameters == alone.settings.parameters
        assert one.problem.measured.fingerprint == alone.problem.measured.fingerprint


@pytest.mark.whole  # seven minutes; tests/study/test_modes_and_frfs.py covers the same with a chain
def test_both_tests_together_determine_more_than_each_alone_and_held_out_errors_fall(undrawn, tmp_path):
    study = str(ROOT / "studies/hidden_bogie_joint")
    assert cli.execute(["run", study, "--results", str(tmp_path), "--workers", "1"]) == 0
    stds = pd.read_csv(tmp_path / "hidden_bogie_joint_extended/std_by_test.csv")
    wide = stds.pivot(index="parameter", columns="test", values="std")
    alone = wide[["modes", "frfs"]].min(axis=1)
    shared = [name for name in wide.index if " in test " not in name]
    assert "brake_unit" in shared and (wide["all tests"] < alone)[shared].all()
    # A sensor's place is in one test alone; left-out parameters may move it more where others are fitted better.
    assert (wide["all tests"] < 1.001 * alone).all()
    for test, groups in HELD_OUT.items():
        errors = pd.read_csv(tmp_path / f"hidden_bogie_joint.{test}/added_errors.csv").set_index(["group", "stage"])
        for group in groups:
            assert errors.loc[(group, "after"), "rms"] < 0.8 * errors.loc[(group, "before"), "rms"]
            assert errors.loc[(group, "after"), "p"] > 0.01
    effects = pd.read_csv(tmp_path / "hidden_bogie_joint/effects.csv").set_index("name")
    hidden = json.loads((ROOT / "tests/truth/hidden_bogie_frf.json").read_text("utf-8"))
    assert effects.index[effects["credible"]].tolist() == hidden["effects"]
    own = effects.loc["brake_unit"]
    assert own["magnitude_low"] < hidden["magnitudes"]["brake_unit"] < own["magnitude_high"]
