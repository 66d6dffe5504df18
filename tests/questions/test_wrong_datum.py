"""One wrong datum of a measurement that lacks nothing: a rival of every effect that explains it, and none is added."""

import json
from pathlib import Path

import pandas as pd
import pytest

from calib.missing.rules import RULES
from calib.questions.added import to_add, write_nothing_added
from calib.questions.explain import explain
from calib.results import Results
from calib.study import Study

BAD = "frequency of B1x"


def measured_wrong(folder: Path, mode: str, times: float) -> Path:
    """The study with one frequency that is so many of its standard deviations too high."""
    table = pd.read_csv(folder / "modes.csv", comment="#")
    table.loc[table["mode"] == mode, "freq"] += times * table.loc[table["mode"] == mode, "freq_std"]
    table.to_csv(folder / "modes.csv", index=False)
    return folder


@pytest.fixture(scope="module")
def spoilt(mast, tmp_path_factory):
    folder = tmp_path_factory.mktemp("spoilt")
    study = Study.load(measured_wrong(mast.write_study(folder / "mast"), "B1x", 10.0))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


def test_a_wrong_frequency_cannot_be_told_from_the_effect_that_explains_it(spoilt):
    *_, answer = spoilt
    found = answer.findings
    assert answer.verdict == "indistinguishable" and found.credible == ("guy",)
    assert found.datum.what == BAD and found.untold == ("guy", found.datum.told)
    row = answer.tables["suspects_explained"].set_index("what").loc[BAD]
    assert row["explains"] and found.datum.ln_evidence > found.chosen.ln_evidence - RULES.credible
    assert found.datum.told in answer.sentence and f"measure the {BAD} again" in answer.sentence


def test_the_summary_tells_which_datum(spoilt):
    _, results, answer = spoilt
    told = json.loads((results.path / "explanation.json").read_text("utf-8"))["wrong_datum"]
    assert told["what"] == BAD == answer.findings.datum.what and told["kind"] == "value"
    assert told["ln_bayes"] == answer.findings.datum.ln_evidence - answer.findings.base.ln_evidence


def test_nothing_is_added_for_a_wrong_frequency(spoilt, tmp_path):
    study, _, answer = spoilt
    assert to_add(answer.findings) is None
    added = write_nothing_added(study, answer.findings, Results.at(tmp_path, study.name))
    assert added.effects == () and answer.findings.datum.told in added.sentence
