"""Held-out data have a veto: an explanation that they contradict is neither named nor added automatically."""

import json

import pandas as pd
import pytest

from calib.analyses.added import conclusion, to_add, write_nothing_added
from calib.analyses.explain import explain
from calib.missing.adequacy import contradicting
from calib.missing.rules import RULES
from calib.results.results import Results
from calib.study.study import LoadedStudy

HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')


def raised(folder, mode, by):
    """Raise one measured frequency by a fraction of its value."""
    lines = []
    for line in (folder / "modes.csv").read_text().splitlines():
        name, *rest = line.split(",")
        lines.append(",".join([name, f"{float(rest[0]) * (1 + by):.6f}", *rest[1:]]) if name == mode else line)
    (folder / "modes.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def contradicted(mast, edited, tmp_path_factory):
    """The guyed mast with the held-out mode 5 % above the frequency that a guy rope gives."""
    folder = tmp_path_factory.mktemp("contradicted")
    study = LoadedStudy.load(raised(edited(mast.write_study(folder / "mast", {"guy": 9000.0}), *HELD), "B3x", 0.05))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


@pytest.mark.medium
def test_an_effect_that_held_out_data_contradict_is_not_named(contradicted, guyed):
    _, results, answer = contradicted
    assert answer.verdict == "unconfirmed" and guyed[2].verdict == "effect"
    assert (
        answer.explanation.credible == ()
        and answer.explanation.chosen.names == ("guy",)
        and not answer.effects["credible"].any()
    )
    errors = answer.errors.set_index(["group", "stage"])
    assert errors.loc[("held_out_modes", "attempt"), "p"] < RULES.contradicted < errors.loc[("fit", "attempt"), "p"]
    content = json.loads((results.path / "explanation.json").read_text())
    assert content["verdict"] == "unconfirmed" and content["credible_set"] == [] and content["chosen"] == ["guy"]
    assert set(pd.read_csv(results.path / "errors.csv")["stage"]) == {"before", "attempt"}


@pytest.mark.medium
def test_an_unconfirmed_effect_is_not_added(contradicted, tmp_path):
    found = contradicted[2].explanation
    assert to_add(found) is None
    added = write_nothing_added(contradicted[0], found, Results(tmp_path))
    assert added.effects == () and "guy" in added.sentence


def test_only_held_out_groups_have_the_veto():
    rows = [("fit", "after", 1e-9), ("left_out", "after", 1e-9), ("held_out_sensors", "after", 2e-3),
            ("held_out_modes", "before", 1e-9), ("held_out_modes", "after", 5e-4)]  # fmt: skip
    errors = pd.DataFrame(rows, columns=["group", "stage", "p"])
    assert contradicting(errors, "after") == ("held_out_modes",)
    assert contradicting(errors.iloc[:4], "after") == () == contradicting(errors.iloc[:0], "after")


@pytest.mark.parametrize(("p", "against"), [(5e-4, True), (2e-3, False)])
def test_a_calibrated_model_is_tested_at_the_same_level(p, against):
    rows = [(g, s, 10, rms, 1.0, c, 0) for g, s, rms, c in (
        ("fit", "before", 4.0, 0.0), ("fit", "after", 1.0, 0.5),
        ("held_out_modes", "before", 9.0, 0.0), ("held_out_modes", "after", 2.0, p),
    )]  # fmt: skip
    errors = pd.DataFrame(rows, columns=["group", "stage", "rows", "rms", "expected", "p", "unpaired"])
    assert ("not confirmed: validation modes" in conclusion(errors)) == against
