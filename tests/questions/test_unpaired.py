"""A structure on soft supports that is modelled free: its lowest measured modes have no partner."""

import pandas as pd
import pytest

from calib.loading import module_of
from calib.questions.compare import answer_at
from calib.questions.explain import explain
from calib.results import Results
from calib.study import Study
from tests.questions.conftest import ROOT

TRUE = 7.3e4


@pytest.fixture(scope="module")
def supported(tmp_path_factory):
    """A free model of a beam that was measured on soft springs, and what is found to be missing."""
    folder = tmp_path_factory.mktemp("supported")
    made = module_of(ROOT / "tests/template/free_beam.py")
    study = Study.load(made.write_study(folder / "beam", {"supports": TRUE}))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


def test_the_supports_are_named_by_the_modes_they_pair(supported):
    answer = supported[2]
    assert answer.verdict == "effect" and answer.findings.credible == ("supports",)
    row = answer.effects.set_index("name").loc["supports"]
    assert row["phi_low"] <= TRUE * 1.005 and row["phi_high"] >= TRUE * 0.995 and row["visible"]
    assert row["phi_min"] in (3e4, 3e5)  # decades of the plausible strength; nothing is claimed of less
    unpaired = answer.errors.set_index(["stage", "group"])["unpaired"]
    assert (unpaired["before", "fit"], unpaired["after", "fit"]) == (4, 0)


def test_modes_without_a_partner_are_told_with_what_they_look_like(supported):
    study, results, answer = supported
    table = pd.read_csv(results.path / "unpaired.csv")
    assert table["stage"].tolist() == ["base"] * 4 and table["mode"].tolist() == ["M1", "M2", "M3", "M4"]
    assert table["looks_rigid"].all() and (table["rigid_share"] > 0.9).all()
    assert [note for note in answer.notes if "M1 (3." in note]
    before = answer_at(study, study.model.space.values)
    assert [s for s in before.sentences if "M1, M2, M3, M4" in s]
