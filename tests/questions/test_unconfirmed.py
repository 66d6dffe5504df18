"""Withheld data have a veto: what fits the used data and fails on them is not named, and never added in silence."""

import json

import pandas as pd
import pytest

from calib.missing.held_out import contradicting
from calib.missing.rules import RULES
from calib.questions.added import conclusion, to_add, write_nothing_added
from calib.questions.explain import explain
from calib.results import Results
from calib.study import Study

HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')


def raised(folder, mode, by):
    """Measured modes with one frequency that is higher by a part of itself."""
    lines = []
    for line in (folder / "modes.csv").read_text().splitlines():
        name, *rest = line.split(",")
        lines.append(",".join([name, f"{float(rest[0]) * (1 + by):.6f}", *rest[1:]]) if name == mode else line)
    (folder / "modes.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def contradicted(mast, edited, tmp_path_factory):
    """The guyed mast whose withheld mode lies 5 % beside what a guy rope would make of it."""
    folder = tmp_path_factory.mktemp("contradicted")
    study = Study.load(raised(edited(mast.write_study(folder / "mast", {"guy": 9000.0}), *HELD), "B3x", 0.05))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


def test_what_withheld_data_contradict_is_not_named(contradicted, guyed):
    _, results, answer = contradicted
    assert answer.verdict == "unconfirmed" and guyed[2].verdict == "effect"
    assert (
        answer.findings.credible == ()
        and answer.findings.chosen.names == ("guy",)
        and not answer.effects["credible"].any()
    )
    errors = answer.errors.set_index(["group", "stage"])
    assert errors.loc[("withheld_modes", "attempt"), "p"] < RULES.contradicted < errors.loc[("fit", "attempt"), "p"]
    told = json.loads((results.path / "explanation.json").read_text())
    assert told["verdict"] == "unconfirmed" and told["credible_set"] == [] and told["chosen"] == ["guy"]
    assert set(pd.read_csv(results.path / "errors.csv")["stage"]) == {"before", "attempt"}


def test_what_is_not_confirmed_is_not_added(contradicted, tmp_path):
    found = contradicted[2].findings
    assert to_add(found) is None
    added = write_nothing_added(contradicted[0], found, Results(tmp_path))
    assert added.effects == () and "guy" in added.sentence


def test_only_withheld_groups_have_the_veto():
    rows = [("fit", "after", 1e-9), ("left_out", "after", 1e-9), ("withheld_sensors", "after", 2e-3),
            ("withheld_modes", "before", 1e-9), ("withheld_modes", "after", 5e-4)]  # fmt: skip
    errors = pd.DataFrame(rows, columns=["group", "stage", "p"])
    assert contradicting(errors, "after") == ("withheld_modes",)
    assert contradicting(errors.iloc[:4], "after") == () == contradicting(errors.iloc[:0], "after")


@pytest.mark.parametrize(("p", "against"), [(5e-4, True), (2e-3, False)])
def test_a_calibrated_model_is_judged_by_the_same_chance(p, against):
    rows = [(g, s, 10, rms, 1.0, c, 0) for g, s, rms, c in (
        ("fit", "before", 4.0, 0.0), ("fit", "after", 1.0, 0.5),
        ("withheld_modes", "before", 9.0, 0.0), ("withheld_modes", "after", 2.0, p),
    )]  # fmt: skip
    errors = pd.DataFrame(rows, columns=["group", "stage", "rows", "rms", "expected", "p", "unpaired"])
    assert ("not confirmed: withheld modes" in conclusion(errors)) == against
