"""Held-out data that contradict a calibration are reported; those within the noise are not."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.calibrate import calibrate
from calib.analyses.every_mode import contradictions
from calib.analyses.provenance.places import ledger_of, results_of
from calib.command import cli
from calib.errors.errors import InputError
from calib.missing.rules import RULES
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.study.study import LoadedStudy

MODEL = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("a", 0.0, -9.0, 9.0), Parameter("b", 0.5, -9.0, 9.0)))

def line():
    return FunctionModel("line", SPACE, lambda v: {f"y{x}": v["a"] + v["b"] * x for x in range(8)})
"""
STUDY = """
title = "A line"
model = "model.py:line"
selection = ["a", "b"]
[measurement]
responses = "data.csv"
synthetic = true
[held_out]
responses = ["y6", "y7"]
[calibration]
method = "gauss-newton"
starts = 1
cases = [{ name = "A", seed = 1 }]
"""
STD = 0.1


def line(folder: Path, bend: float, seed: int = 5) -> Path:
    """A study of a line with synthetic data that bend beyond the last fitted response."""
    folder.mkdir()
    x = np.arange(8)
    y = 1.0 + 1.0 * x + bend * (x > 5) + STD * np.random.default_rng(seed).standard_normal(8)
    rows = "\n".join(f"y{k},{v:.6f},{STD}" for k, v in zip(x, y, strict=True))
    (folder / "data.csv").write_text(f"response,value,std\n{rows}\n")
    (folder / "model.py").write_text(MODEL)
    (folder / "study.toml").write_text(STUDY)
    return folder


def calibrated(folder: Path):
    study, root = LoadedStudy.load(folder), folder.parent / "results"
    results = results_of(study, root)
    with ledger_of(study, root) as ledger:
        return study, results, calibrate(study, results, ledger, workers=1)


@pytest.mark.slow
def test_contradicting_data_are_reported_everywhere(tmp_path, monkeypatch, capsys):
    line(tmp_path / "bent", 3.0)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    assert cli.execute(["calibrate", "bent", "--workers", "1"]) == 0
    said = " ".join(capsys.readouterr().out.split("\n"))
    folder = Path("results/bent")
    (sentence,) = json.loads((folder / "summary.json").read_text())["contradictions"]
    errors = pd.read_csv(folder / "data_errors.csv").set_index("group")
    assert errors.loc["held_out_responses", "p"] < RULES.contradicted < errors.loc["fit", "p"]
    assert f"{errors.loc['held_out_responses', 'rms']:.2f}" in sentence
    assert said.count(sentence) == 1
    assert all(f"{name} (validation)" in said for name in ("y6", "y7"))
    assert sentence in json.loads((folder / "record.json").read_text())["analyses"]["calibrate"]["sentences"]
    assert sentence in page_summary(StudyResults(folder, "A line", True)).sure
    each = pd.read_csv(folder / "responses.csv").set_index("response")
    assert each.index[each["held_out"]].tolist() == ["y6", "y7"] and len(each) == 8


def test_data_within_their_standard_deviation_do_not_contradict(tmp_path):
    *_, answer = calibrated(line(tmp_path / "straight", 0.0))
    assert answer.errors.set_index("group").loc["held_out_responses", "p"] > RULES.contradicted
    assert answer.contradictions == ()


@pytest.mark.medium
def test_correctly_specified_models_are_hardly_ever_rejected(tmp_path):
    rejected = [bool(calibrated(line(tmp_path / f"s{seed}", 0.0, seed))[2].contradictions) for seed in range(4)]
    assert not any(rejected)


def test_the_rule_is_a_p_value_and_names_what_is_predicted_no_better():
    table = pd.DataFrame(
        [("fit", 1.0, 1.0, 0.5), ("held_out_sensors", 1.2, 1.1, 0.02), ("held_out_modes", 9.0, 1.1, 1e-9)],
        columns=["group", "rms", "expected", "p"],
    )
    rows = [("M1", False, 0.1, 0.2), ("M2", True, 0.1, -0.1), ("M3", True, -0.2, 0.1), ("M4", True, np.nan, 0.1)]
    modes = pd.DataFrame(rows, columns=["mode", "held_out", "error_before", "error_after"])
    (sentence,) = contradictions(table, modes)
    assert sentence.startswith("Validation modes") and "9.00" in sentence and sentence.endswith(": M2.")
    assert contradictions(table.assign(p=np.nan), modes) == ()
    assert len(contradictions(table.assign(p=0.0009), modes)) == 2
    assert contradictions(table.assign(p=0.0011), modes) == ()


def test_a_contradiction_reports_an_assumed_standard_deviation(tmp_path):
    folder = line(tmp_path / "bent", 3.0)
    rows = pd.read_csv(folder / "data.csv").drop(columns="std")
    rows.to_csv(folder / "data.csv", index=False)
    *_, answer = calibrated(folder)
    assert answer.best.statistics.assumed
    assert [answer.best.statistics.assumed in words for words in answer.contradictions] == [True]


@pytest.mark.parametrize("key", ["modes", "sensors"])
def test_scalar_responses_are_held_out_by_their_own_key(tmp_path, key):
    folder = line(tmp_path / "line", 0.0)
    (folder / "study.toml").write_text(STUDY.replace("responses = [", f"{key} = ["))
    with pytest.raises(InputError, match="name responses under"):
        LoadedStudy.load(folder)
