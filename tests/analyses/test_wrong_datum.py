"""One wrong datum and no missing effect: the datum competes with the effects that explain it, and none is added."""

import json
from pathlib import Path

import pandas as pd
import pytest

from calib.analyses.added import to_add, write_nothing_added
from calib.analyses.explain import explain
from calib.missing.rules import RULES
from calib.results.results import Results
from calib.study.study import LoadedStudy

BAD = "frequency of B1x"


def measured_wrong(folder: Path, mode: str, times: float) -> Path:
    """Raise one measured frequency by some multiple of its standard deviation."""
    table = pd.read_csv(folder / "modes.csv", comment="#")
    table.loc[table["mode"] == mode, "freq"] += times * table.loc[table["mode"] == mode, "freq_std"]
    table.to_csv(folder / "modes.csv", index=False)
    return folder


@pytest.fixture(scope="module")
def spoilt(mast, tmp_path_factory):
    folder = tmp_path_factory.mktemp("spoilt")
    study = LoadedStudy.load(measured_wrong(mast.write_study(folder / "mast"), "B1x", 10.0))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


@pytest.mark.slow
def test_a_wrong_frequency_is_indistinguishable_from_the_effect_that_explains_it(spoilt):
    *_, answer = spoilt
    found = answer.explanation
    assert answer.verdict == "indistinguishable" and found.credible == ("guy",)
    assert found.datum.what == BAD and found.equally_good == ("guy", found.datum.in_words)
    row = answer.tables["suspects_explained"].set_index("what").loc[BAD]
    assert row["explains"] and found.datum.ln_evidence > found.chosen.ln_evidence - RULES.credible
    assert found.datum.in_words in answer.sentence and f"measure the {BAD}" in answer.sentence


@pytest.mark.medium
def test_the_summary_names_the_datum(spoilt):
    _, results, answer = spoilt
    datum = json.loads((results.path / "explanation.json").read_text("utf-8"))["wrong_datum"]
    assert datum["what"] == BAD == answer.explanation.datum.what and datum["kind"] == "value"
    assert datum["ln_bayes"] == answer.explanation.datum.ln_evidence - answer.explanation.base.ln_evidence


@pytest.mark.medium
def test_nothing_is_added_for_a_wrong_frequency(spoilt, tmp_path):
    study, _, answer = spoilt
    assert to_add(answer.explanation) is None
    added = write_nothing_added(study, answer.explanation, Results.at(tmp_path, study.name))
    assert added.effects == () and answer.explanation.datum.in_words in added.sentence
