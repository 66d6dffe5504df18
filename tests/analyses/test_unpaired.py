"""A structure on soft supports that is modelled free: its lowest measured modes have no partner."""

import pandas as pd
import pytest

from calib.analyses.compare import comparison_at
from calib.analyses.explain import explain
from calib.results.results import Results
from calib.study.loading import module_of
from calib.study.study import LoadedStudy
from tests.analyses.conftest import ROOT

TRUE = 7.3e4


@pytest.fixture(scope="module")
def supported(tmp_path_factory):
    """A free model of a beam that was measured on soft springs, and its explanation."""
    folder = tmp_path_factory.mktemp("supported")
    made = module_of(ROOT / "tests/template/free_beam.py")
    study = LoadedStudy.load(made.write_study(folder / "beam", {"supports": TRUE}))
    results = Results.at(folder / "results", study.name)
    return study, results, explain(study, results)


@pytest.mark.slow
def test_supports_are_named_by_the_modes_they_pair(supported):
    answer = supported[2]
    assert answer.verdict == "effect" and answer.explanation.credible == ("supports",)
    row = answer.effects.set_index("name").loc["supports"]
    assert row["magnitude_low"] <= TRUE * 1.005 and row["magnitude_high"] >= TRUE * 0.995 and row["visible"]
    assert row["magnitude_min"] in (3e4, 3e5)  # magnitudes are tried in decades only
    unpaired = answer.errors.set_index(["stage", "group"])["unpaired"]
    assert (unpaired["before", "fit"], unpaired["after", "fit"]) == (4, 0)


@pytest.mark.slow
def test_unpaired_modes_are_reported_as_rigid_body_motion(supported):
    study, results, answer = supported
    table = pd.read_csv(results.path / "unpaired.csv")
    assert table["stage"].tolist() == ["base"] * 4 and table["mode"].tolist() == ["M1", "M2", "M3", "M4"]
    assert table["looks_rigid"].all() and (table["rigid_share"] > 0.9).all()
    assert [note for note in answer.notes if "M1 (3." in note]
    before = comparison_at(study, study.model.space.values)
    assert [s for s in before.sentences if "M1, M2, M3, M4" in s]
