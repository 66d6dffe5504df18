"""Folders of results: all of them, without studies that a run wrote among them."""

import shutil

import pytest

from calib.analyses.extend import extend_among
from calib.analyses.provenance.places import answers_of, results_of
from calib.errors.errors import InputError
from calib.results.results import Results
from calib.study.study import LoadedStudy
from calib.study.study_file import StudyFile


def test_only_folders_with_results_are_listed(mast, tmp_path):
    study, home = LoadedStudy.load(mast.write_study(tmp_path / "mast")), tmp_path / "results/mast"
    assert answers_of(study, tmp_path / "results") == ()
    for part in ("quick", "case_A1", "empty", ".hidden"):
        if part in ("quick", "case_A1"):
            Results.at(tmp_path / "results", "mast", part).write_json("answer", {})
        (home / part).mkdir(exist_ok=True)
        if part != "empty":
            (home / part / "parameters.csv").write_text("case,parameter\n")
    written = extend_among(study, ["guy"], home).file.parent
    (written / "notes.csv").write_text("a table of the user beside the study\n")
    assert answers_of(study, tmp_path / "results") == (Results(home / "case_A1"), Results(home / "quick"))
    (home / "comparison_before.csv").write_text("mode\n")
    assert answers_of(study, tmp_path / "results")[0] == Results(home)


@pytest.mark.parametrize("first", ["quick", ""])
def test_an_extended_study_of_a_quick_run_and_of_a_full_run_share_one_folder(mast, tmp_path, first):
    root, origin = tmp_path / "results", mast.write_study(tmp_path / "mast")
    results_of(StudyFile.read(origin), root).claim()
    places = {part: root / "mast" / part / "mast_extended" for part in ("quick", "")}
    for place in places.values():
        shutil.copytree(origin, place)
    second = {"quick": "", "": "quick"}[first]
    results_of(StudyFile.read(places[first]), root, bool(first)).claim()
    found = results_of(StudyFile.read(places[second]), root, bool(second))
    assert found.path == root / "mast_extended" / second
    shutil.copytree(origin, tmp_path / "other/mast_extended")
    with pytest.raises(InputError, match="another study"):
        results_of(StudyFile.read(tmp_path / "other/mast_extended"), root)
