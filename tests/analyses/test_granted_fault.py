"""A gain of one channel beside an effect that the model lacks: both are told, through tables and summary."""

import json

import pandas as pd
import pytest

from calib.analyses.added import nothing_added, to_add
from calib.analyses.explain import explain
from calib.results.results import Results
from calib.study.study import LoadedStudy
from tests.analyses.conftest import HELD

pytestmark = pytest.mark.usefixtures("undrawn")
CHANNEL, FACTOR = (3, "x"), 1.3


def misread(folder):
    """The study with one channel that reads too much in every mode."""
    head, *lines = (folder / "shapes.csv").read_text().splitlines()
    out = [head, lines[0]]
    for line in lines[1:]:
        mode, node, direction, value, *more = line.split(",")
        own = (int(node), direction) == CHANNEL
        out.append(",".join([mode, node, direction, f"{float(value) * (FACTOR if own else 1.0):.6f}", *more]))
    (folder / "shapes.csv").write_text("\n".join(out) + "\n")
    return folder


@pytest.fixture(scope="module")
def told(mast, edited, tmp_path_factory):
    folder = tmp_path_factory.mktemp("misread")
    study = LoadedStudy.load(misread(edited(mast.write_study(folder / "mast", {"guy": 20000.0}), *HELD)))
    results = Results.at(folder / "results", study.name)
    return results.path, explain(study, results)


@pytest.mark.medium
def test_effect_and_fault_are_told_together(told):
    _, answer = told
    found = answer.explanation
    assert found.verdict == "effect" and found.credible == ("guy",)
    ((fault, fit),) = found.faulty
    value, std = fit.magnitude(fault.name)
    assert fault.name == "gain of sensor 3x" and abs(value - (FACTOR - 1)) < 4 * std
    assert abs(found.chosen.magnitude("guy")[0] - 20000.0) < 4 * found.chosen.magnitude("guy")[1]
    assert "Guy rope along x" in answer.answer.found and "sensor 3x reads" in answer.answer.found
    assert "Check its calibration" in answer.answer.then and f'"{fault.name}" = {value:.3g}' in answer.sentence


@pytest.mark.medium
def test_it_is_written_as_it_is_told(told):
    folder, answer = told
    summary = json.loads((folder / "explanation.json").read_text())
    assert [one["name"] for one in summary["blamed"]] == ["gain of sensor 3x"]
    assert summary["credible_set"] == ["guy"] and summary["chosen"] == ["guy"]
    faults = pd.read_csv(folder / "faults.csv")
    assert faults.loc[faults["blamed"], "fault"].tolist() == ["gain of sensor 3x"]
    errors = pd.read_csv(folder / "errors.csv").set_index(["group", "stage"])["rms"]
    assert errors["fit", "after"] < 1.3 and errors["fit", "after"] < 0.7 * errors["fit", "before"]
    assert any("Validation data" in note for note in answer.notes)


@pytest.mark.medium
def test_nothing_is_added_before_the_measurement_is_corrected(told):
    found = told[1].explanation
    assert to_add(found) is None and "correct them first" in nothing_added(found)
