"""Results that somebody changed after calib wrote them are not shown, and named with the command that makes them."""

import re
from pathlib import Path

import pytest

from calib.analyses.provenance.stale import stale_answers
from calib.command import cli
from calib.results.results import Results
from calib.study.study_file import StudyFile

FOLDER = Path("results/mast")
pytestmark = pytest.mark.usefixtures("undrawn")


def stale():
    return stale_answers(StudyFile.read(Path("mast")), Results(FOLDER))


@pytest.mark.medium
def test_results_as_written_are_shown(answered):
    found = stale()
    assert not found.sentences and not found.files


@pytest.mark.medium
@pytest.mark.parametrize("file", ["parameters.csv", "summary.json", "measured.csv", "record.json"])
def test_a_changed_file_is_not_shown(answered, file, capsys):
    path = FOLDER / file
    before = path.read_text()
    path.write_text(re.sub(r"[1-9](?=[^0-9]*$)", "0", before, count=1))
    assert path.read_text() != before
    found = stale()
    assert set(found.sentences) == ({"compare", "calibrate"} if file == "record.json" else {"calibrate"})
    assert file in found.sentences["calibrate"] and "calib calibrate mast" in found.sentences["calibrate"]
    assert "parameters.csv" in found.files
    cli.execute(["report", "mast"])
    told = capsys.readouterr()
    assert file in told.out + told.err and "calib calibrate mast" in told.out + told.err


@pytest.mark.medium
def test_a_table_of_somebody_else_is_not_shown(answered):
    (FOLDER / "steps.csv").write_text("step,effect,gain\n1,mine,9.0\n")
    found = stale()
    assert "steps.csv" in found.files and not found.sentences


def test_a_table_that_a_spreadsheet_saved_with_the_same_entries_is_shown(answered):
    path = FOLDER / "parameters.csv"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert not stale().sentences
