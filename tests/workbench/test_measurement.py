"""The measurement of the page is what the tables of the results hold, and only what was checked is called sound."""

import shutil
from pathlib import Path

import pandas as pd

from calib.report.numbers import fixed


def seen(page, key):
    return page.get(f"study/{key}/measurement").json()["measurement"]


def test_modes_sensors_and_files_are_those_of_the_study(page, key, here):
    found = seen(page, key)
    table = pd.read_csv(here / "results/mast/measured.csv")
    assert [one["name"] for one in found["rows"]] == list(table["mode"])
    assert [one["cells"][0] for one in found["rows"]] == [fixed(value, 3) for value in table["natural_freq"]]
    assert {"study.toml", "modes.csv", "shapes.csv", "sensors.csv"} <= set(found["files"])
    sensors = pd.read_csv(here / "results/mast/sensors.csv")
    assert [one["name"] for one in found["sensors"]] == list(sensors["sensor"])
    assert [layer["name"] for layer in found["scene"]["layers"]] == ["sensors"] and found["scene"]["stages"] == []
    assert found["order"] == [] and found["measurements"] == []


def test_what_was_not_checked_is_not_called_sound(page, page_of, key, here):
    found = seen(page, key)
    assert found["doubts"] == [] and "No sensor looks wrong." in found["fine"]
    (here / "results/mast/sensor_check.csv").unlink()
    assert "No sensor looks wrong." not in seen(page_of(Path("mast")), key)["fine"]


def test_before_any_analysis_there_is_none(page, key, here):
    shutil.rmtree("results")
    assert seen(page, key) is None


def test_a_file_outside_the_folder_is_named_without_its_path(page, key, here):
    file = Path("mast/study.toml")
    shutil.move("mast/modes.csv", "modes_elsewhere.csv")
    file.write_text(file.read_text().replace('"modes.csv"', '"../modes_elsewhere.csv"'))
    from calib.study.study_file import StudyFile
    from calib.workbench.measurement import _named

    study = StudyFile.read(file)
    assert "modes_elsewhere.csv" in [_named(path, study.folder) for path in study.inputs]
