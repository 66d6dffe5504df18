"""Two channels that took each other's name: told alone and beside an effect; of a sound test no pair is told."""

import json

import pandas as pd
import pytest

from calib.analyses.explain import explain
from calib.results.results import Results
from calib.study.study import LoadedStudy
from tests.analyses.conftest import HELD

pytestmark = pytest.mark.usefixtures("undrawn")
CHANNELS = ("6x", "3x")


def exchanged(folder):
    """The study with the readings of both channels under the name of the other, in every mode."""
    lines = (folder / "shapes.csv").read_text().splitlines()
    other = dict(zip(CHANNELS, CHANNELS[::-1], strict=True))
    for k, line in enumerate(lines[2:], 2):  # below a comment and the header
        mode, node, direction, *more = line.split(",")
        name = other.get(f"{node}{direction}")
        if name:
            lines[k] = ",".join([mode, name[:-1], name[-1], *more])
    (folder / "shapes.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def told(mast, edited, tmp_path_factory):
    def explained(hidden, wrong):
        folder = tmp_path_factory.mktemp("exchanged")
        written = edited(mast.write_study(folder / "mast", hidden), *HELD)
        study = LoadedStudy.load(exchanged(written) if wrong else written)
        results = Results.at(folder / "results", study.name)
        return results.path, explain(study, results)

    return explained


@pytest.mark.medium
@pytest.mark.parametrize("hidden", [{}, {"guy": 20000.0}])
def test_exchanged_channels_are_told(told, hidden):
    folder, answer = told(hidden, wrong=True)
    found = answer.explanation
    assert found.verdict == ("effect" if hidden else "measurement") and found.credible == tuple(hidden)
    ((fault, fit),) = found.faulty
    value, std = fit.magnitude(fault.name)
    assert fault.name == "exchange of sensors 6x and 3x" and abs(value - 1.0) < 4 * std
    assert "sensors 6x and 3x are exchanged" in answer.answer.found and not found.remains
    summary = json.loads((folder / "explanation.json").read_text())
    assert [one["name"] for one in summary["blamed"]] == [fault.name] and summary["pair_faults"] > 100
    faults = pd.read_csv(folder / "faults.csv")
    assert faults.loc[faults["blamed"], "sensor"].tolist() == ["6x 3x"]


@pytest.mark.medium
def test_of_a_sound_test_no_pair_is_told(told):
    folder, answer = told({}, wrong=False)
    assert answer.explanation.verdict == "nothing_detectable" and answer.explanation.faulty == ()
    faults = pd.read_csv(folder / "faults.csv")
    assert (faults["score"].abs() < faults["limit"]).all() and faults["limit"].nunique() == 2
