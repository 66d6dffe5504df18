"""Errors over the versions of a model: a study and those it was extended from."""

from pathlib import Path

import pandas as pd
import pytest

from calib.analyses.extend import write_extension
from calib.analyses.provenance.record import write_record
from calib.analyses.versions import COLUMNS, write_versions
from calib.results.results import Results
from calib.study.study import LoadedStudy
from calib.study.study_file import shell_argument

GROUPS = ("fit", "left_out", "held_out_sensors")


@pytest.fixture
def chain(mast, tmp_path):
    """A study, and two successive extensions by one effect each."""
    first = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    second = LoadedStudy.load(write_extension(first, ["platform"], tmp_path / "mast_2").file)
    third = LoadedStudy.load(write_extension(second, ["guy"], tmp_path / "mast_3").file)
    return first, second, third


def answers(root: Path, name: str, size: float, table="data_errors"):
    """Errors as a calibration or an explanation writes them."""
    rows = [(group, 10, size + k, 1.0, 0.5, 0) for k, group in enumerate(GROUPS)]
    frame = pd.DataFrame(rows, columns=["group", "rows", "rms", "expected", "p", "unpaired"])
    if table == "errors":
        frame = pd.concat([frame.assign(stage="before"), frame.assign(stage="after", rms=0.1)])
    results = Results.at(root, name)
    results.write_table(table, frame)
    (file,) = (root.parent / name).glob("*.toml")
    write_record(LoadedStudy.load(file), results, "explain" if table == "errors" else "calibrate", {})


@pytest.fixture
def answered(chain, tmp_path):
    """A folder with results of all three."""
    for study in chain:
        answers(tmp_path / "results", study.name, 5.0)
    return tmp_path / "results"


@pytest.mark.medium
def test_versions_are_listed_oldest_first_with_their_effects(chain, tmp_path):
    root = tmp_path / "results"
    for k, study in enumerate(chain):
        answers(root, study.name, 5.0 - k)
    found = write_versions(chain[-1], root)
    table = found.table
    assert list(table.columns) == list(COLUMNS) and found.notes == ()
    assert list(table["version"]) == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert list(table["study"].unique()) == ["mast", "mast_2", "mast_3"]
    assert list(table["effects"].unique()) == ["", "platform", "platform + guy"]
    assert list(table.loc[table["group"] == "fit", "rms"]) == [5.0, 4.0, 3.0]
    written = pd.read_csv(root / "mast_3/versions.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(written, table, check_dtype=False)
    middle = write_versions(chain[1], root).table
    assert list(middle["study"].unique()) == ["mast", "mast_2"]


@pytest.mark.medium
def test_a_version_that_was_only_explained_has_the_errors_of_its_base_model(chain, tmp_path):
    root = tmp_path / "results"
    answers(root, "mast", 5.0, "errors")
    answers(root, "mast_2", 4.0)
    answers(root, "mast_2", 7.0, "errors")  # its calibration has precedence
    table = write_versions(chain[-1], root).table
    assert list(table["study"].unique()) == ["mast", "mast_2"]
    assert list(table.loc[table["group"] == "fit", "rms"]) == [5.0, 4.0]
    assert 0.1 not in set(table["rms"])


@pytest.mark.medium
def test_a_version_without_results_is_left_out_and_keeps_its_number(chain, tmp_path):
    root = tmp_path / "results"
    answers(root, "mast", 5.0)
    answers(root, "mast_3", 3.0)
    found = write_versions(chain[-1], root)
    assert list(found.table["version"].unique()) == [1, 3]
    command = f"calib explain {tmp_path / 'mast_2'} --results {root}"
    assert found.notes == (f"Version 2 (mast_2) has no up-to-date errors under {root}: run '{command}'.",)


@pytest.mark.medium
def test_without_any_results_nothing_is_written(chain, tmp_path):
    found = write_versions(chain[-1], tmp_path / "results")
    table = found.table
    assert [note[:9] for note in found.notes] == ["Version 1", "Version 2", "Version 3"]
    assert table.empty and list(table.columns) == list(COLUMNS)
    assert not list(tmp_path.rglob("versions.csv"))


@pytest.mark.medium
def test_a_study_without_a_base_has_no_versions(chain, tmp_path):
    answers(tmp_path / "results", "mast", 5.0)
    found = write_versions(chain[0], tmp_path / "results")
    assert found.table.empty and found.notes == () and not list(tmp_path.rglob("versions.csv"))


@pytest.mark.medium
def test_a_base_study_with_the_same_effects_is_not_a_version(chain, answered, tmp_path):
    (tmp_path / "apart").mkdir()
    (tmp_path / "apart/study.toml").write_text('title = "the same model"\nbase = "../mast_3"\n')
    assert write_versions(LoadedStudy.load(tmp_path / "apart"), answered).table.empty


@pytest.mark.medium
def test_an_earlier_version_may_be_a_study_file_of_another_name(mast, tmp_path):
    folder = mast.write_study(tmp_path / "mast")
    (folder / "study.toml").rename(folder / "second.toml")
    new = LoadedStudy.load(write_extension(LoadedStudy.load(folder / "second.toml"), ["guy"], tmp_path / "mast_2").file)
    for name in ("mast", "mast_2"):
        answers(tmp_path / "results", name, 5.0)
    root = tmp_path / "results"
    assert list(write_versions(new, root).table["study"].unique()) == ["mast", "mast_2"]
    (root / "mast/data_errors.csv").unlink()
    (note,) = write_versions(new, root).notes
    assert f"calib explain {folder / 'second.toml'} --results" in note


def test_a_command_to_type_names_a_study_by_its_folder_and_quotes_it():
    assert shell_argument(Path("studies/bogie/study.toml")) == "studies/bogie"
    assert (
        shell_argument(Path("my studies/mast/study.toml")) == "'my studies/mast'"
        and shell_argument(Path("rig/other.toml")) == "rig/other.toml"
    )


@pytest.mark.medium
def test_errors_on_another_measurement_are_left_out(chain, answered):
    first, second, _ = chain
    write_record(first, Results.at(answered, "mast"), "calibrate", {})
    assert set(write_versions(second, answered).table["version"]) == {1, 2}
    for name in ("modes.csv", "shapes.csv", "study.toml"):  # the same mode under another name
        file = first.file.parent / name
        file.write_text(file.read_text().replace("B3x", "B3y"))
    answers(answered, "mast_2", 5.0)
    found = write_versions(LoadedStudy.load(second.file), answered)
    assert set(found.table["version"]) == {2} and len(found.notes) == 1


@pytest.mark.medium
def test_stale_errors_of_a_version_are_left_out(chain, answered):
    first, second, _ = chain
    results = Results.at(answered, "mast")
    write_record(first, results, "explain", {})
    write_record(first, results, "calibrate", {})
    text = first.file.read_text()
    first.file.write_text(text.replace('"E", "m_top", ', '"E", '))
    found = write_versions(second, answered)
    assert set(found.table["version"]) == {2} and len(found.notes) == 1
    answers(answered, "mast", 7.0, "errors")
    write_record(LoadedStudy.load(first.file), results, "explain", {})  # its calibration is still stale
    table = write_versions(second, answered).table
    assert set(table["version"]) == {1, 2} and table["rms"].iloc[0] == 7.0
