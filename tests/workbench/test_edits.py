"""Edits of study.toml from the page: shown first, with comments kept, undone again, and never over another's change."""

from pathlib import Path

import pytest

from calib.errors.errors import InputError
from calib.study.study_file import StudyFile
from calib.workbench.edits import Edits

PAIR = {"what": "pair", "name": "B1x", "value": 2}


@pytest.fixture
def file(here):
    return Path("mast/study.toml")


@pytest.fixture
def make(file):
    """Makes an edit as a page does, shown first, and returns the settings that follow."""
    edits = Edits()

    def made(edit, test=""):
        study = StudyFile.read(file, test)
        edits.make(study, edit, edits.shown(study, edit)["digest"])
        return StudyFile.read(file, test).settings

    made.edits = edits
    return made


@pytest.mark.parametrize(
    ("edit", "of"),
    [
        (PAIR, lambda settings: settings.pairing.override["B1x"] == 2),
        ({"what": "mode", "name": "B2x"}, lambda settings: settings.held_out.modes == ("B2x",)),
        ({"what": "sensor", "name": "6x"}, lambda settings: settings.held_out.sensors == ("6x",)),
        (
            {"what": "flip", "name": "6x"},
            lambda settings: settings.measurement.corrected == {"gain of sensor 6x": -2.0},
        ),
        (
            {"what": "start", "name": "here", "value": {"E": 207.5}},
            lambda settings: settings.calibration.begin_at == {"E": 207.5},
        ),
        (
            {"what": "start", "name": "a design", "value": 12},
            lambda settings: settings.calibration.begin_at == "design 12",
        ),
    ],
)
def test_an_edit_changes_its_key_alone_and_is_undone(file, make, edit, of):
    before = file.read_text()
    settings = make(edit)
    assert of(settings)
    old, new = before.splitlines(), file.read_text().splitlines()
    assert 1 <= len(set(new) - set(old)) <= 2 and [line for line in new if line in old] == [
        line for line in old if line in new
    ]
    comments = [line.split("#", 1)[1] for line in old if "#" in line]
    assert [line.split("#", 1)[1] for line in new if "#" in line] == comments
    make.edits.undo(StudyFile.read(file))
    assert file.read_text() == before


@pytest.mark.parametrize(
    "edit", [{"what": "mode", "name": "B2x"}, {"what": "sensor", "name": "6x"}, {"what": "flip", "name": "6x"}]
)
def test_what_is_edited_twice_is_as_before(make, file, edit):
    before = StudyFile.read(file).settings
    make(edit)
    assert make(edit) == before


def test_a_pair_is_taken_back_to_the_automatic_one(make):
    make(PAIR)
    assert make({"what": "unpair", "name": "B1x"}).pairing.override == {}
    with pytest.raises(InputError, match="no pair of B1x"):
        make({"what": "unpair", "name": "B1x"})


def test_what_is_shown_changes_nothing(file):
    before = file.read_text()
    shown = Edits().shown(StudyFile.read(file), PAIR)
    assert file.read_text() == before
    assert any(line.startswith("+") and "B1x = 2" in line for line in shown["diff"])
    assert any(line.startswith("-") and "override" in line for line in shown["diff"])


def test_a_change_of_an_editor_is_never_overwritten(file, make):
    edits, study = make.edits, StudyFile.read(file)
    digest = edits.shown(study, PAIR)["digest"]
    own = file.read_text().replace("threshold = 0.3", "threshold = 0.5")
    file.write_text(own)
    with pytest.raises(InputError, match="changed in an editor"):
        edits.make(study, PAIR, digest)
    assert file.read_text() == own
    make(PAIR)
    other = file.read_text().replace("threshold = 0.5", "threshold = 0.6")
    file.write_text(other)
    with pytest.raises(InputError, match="changed in an editor"):
        edits.undo(StudyFile.read(file))
    assert file.read_text() == other


def test_an_edit_that_makes_no_valid_study_is_refused(file, make, monkeypatch):
    before = file.read_text()
    monkeypatch.setattr("calib.workbench.edits._FLIPPED", "much")
    with pytest.raises(InputError):
        make({"what": "flip", "name": "6x"})
    assert file.read_text() == before and not list(file.parent.glob(".*"))


@pytest.mark.parametrize(
    "edit",
    [
        {"what": "pair", "name": "B1x", "value": True}, {"what": "pair", "name": "B1x", "value": 0},
        {"what": "model", "name": "x"}, {"what": "mode", "name": 3}, {"what": "mode", "name": "x" * 201}, {},
        {"what": "start", "name": "here", "value": {"E": "much"}}, {"what": "start", "name": "here", "value": {}},
    ],
)  # fmt: skip
def test_other_edits_are_refused(file, edit):
    with pytest.raises(InputError):
        Edits().shown(StudyFile.read(file), edit)


def test_an_edit_of_one_of_several_tests_stands_in_its_table(file, make):
    text = file.read_text()
    start, end = text.index("[measurement]"), text.index("[parameters.K_base]")
    test = '[[tests]]\nname = "{}"\nfiles = ["modes.csv"]\nshapes = ["shapes.csv"]\nsensors = "sensors.csv"\n'
    test += 'std_of = "mean"\n\n'
    file.write_text(text[:start] + test.format("first") + test.format("second") + text[end:])
    assert make({"what": "mode", "name": "B2x"}, "second").held_out.modes == ("B2x",)
    assert make(PAIR, "second").pairing.override == {"B1x": 2}
    assert make({"what": "flip", "name": "6x"}, "second").measurement.corrected == {"gain of sensor 6x": -2.0}
    first = StudyFile.read(file, "first").settings
    assert first.held_out.modes == () and first.pairing.override == {} and first.measurement.corrected == {}


def test_what_the_base_holds_out_stays_held_out(file, make, here):
    make({"what": "mode", "name": "B2x"})
    (here / "more").mkdir()
    (here / "more/study.toml").write_text('title = "More"\nbase = "../mast"\n')
    study, edits = StudyFile.read(Path("more")), Edits()
    edits.make(study, {"what": "mode", "name": "B1z"}, edits.shown(study, {"what": "mode", "name": "B1z"})["digest"])
    assert StudyFile.read(Path("more")).settings.held_out.modes == ("B2x", "B1z")
    assert StudyFile.read(file).settings.held_out.modes == ("B2x",)


def test_the_page_shows_makes_and_undoes_an_edit(page, key, file):
    before = file.read_text()
    shown = page.post(f"study/{key}/edit", json={"edit": PAIR}).json()
    assert file.read_text() == before
    page.post(f"study/{key}/edit", json={"edit": PAIR, "digest": shown["digest"], "make": True})
    states = {one["verb"]: one["state"] for one in page.get(f"study/{key}").json()["analyses"]}
    assert states["compare"] == "stale"  # at once
    assert page.get(f"study/{key}/correlation").json()["undo"] == shown["words"]
    assert page.post(f"study/{key}/undo", json={}).status_code == 200
    assert file.read_text() == before
    assert page.post(f"study/{key}/undo", json={}).status_code == 409
