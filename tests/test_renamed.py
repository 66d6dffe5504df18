"""Former names of keys and tables are refused with the present name, and every present name is in use."""

import json

import pytest

from calib.command import cli
from calib.command.example import write_example
from calib.errors.errors import InputError
from calib.missing import recommendation, tables
from calib.results.former_names import COLUMNS, KEYS, RECORD, TABLES
from calib.results.results import Results
from calib.results.table import read_table
from calib.study.search_settings import CalibrationSettings
from calib.study.settings import ExplainSettings, StudySettings
from calib.study.study_text import read_settings

SECTIONS = {
    "withheld": "[withheld]\nmodes = ['M1']\n",
    "polish": "[calibration]\npolish = false\n",
    "draws": "[explain]\ndraws = 3\n",
}


@pytest.mark.parametrize("old", KEYS)
def test_an_old_key_is_refused_with_its_present_name_and_line(tmp_path, old):
    text = 'title = "t"\nmodel = "model.py:f"\n[measurement]\nfiles = ["m.csv"]\n'
    (tmp_path / "study.toml").write_text(text + SECTIONS[old])
    with pytest.raises(InputError) as told:
        read_settings(tmp_path / "study.toml")
    line = text.count("\n") + SECTIONS[old].split(old)[0].count("\n") + 1
    assert repr(KEYS[old]) in told.value.problem and KEYS[old] in told.value.remedy
    assert told.value.place == f"{tmp_path / 'study.toml'}, line {line}"


def test_present_keys_are_keys():
    known = {*StudySettings.model_fields, *CalibrationSettings.model_fields, *ExplainSettings.model_fields}
    assert set(KEYS.values()) <= known and not set(KEYS) & known


@pytest.mark.parametrize("old", [*TABLES, *RECORD])
def test_results_with_old_names_are_refused(tmp_path, old):
    results = Results.at(tmp_path, "study")
    results.write_json("record", {old: {}} if old in RECORD else {})
    if old in TABLES:
        (results.path / old).write_text("a\n1\n")
    with pytest.raises(InputError, match=repr({**TABLES, **RECORD}[old])):
        results.check_owner(tmp_path / "study.toml")


@pytest.mark.medium
def test_the_command_ends_with_code_2_and_keeps_the_results(undrawn, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_example(tmp_path / "mast")
    assert cli.execute(["compare", "mast"]) == 0
    record = tmp_path / "results/mast/record.json"
    kept = json.loads(record.read_text())
    record.write_text(json.dumps({"questions": kept.pop("analyses"), **kept}))
    before = {p.name: p.read_bytes() for p in record.parent.iterdir() if p.is_file()}
    capsys.readouterr()
    assert cli.execute(["compare", "mast"]) == 2
    assert "'analyses'" in capsys.readouterr().err
    assert before == {p.name: p.read_bytes() for p in record.parent.iterdir() if p.is_file()}


@pytest.mark.parametrize("old", ["phi", "gamma", "freedom"])
def test_an_old_column_is_refused_with_its_present_name(tmp_path, old):
    (tmp_path / "t.csv").write_text(f"name,{old}\na,1\n")
    with pytest.raises(InputError, match=repr(COLUMNS[old])):
        read_table(tmp_path / "t.csv", ["name"], [COLUMNS[old]])


def test_present_columns_of_explanations_are_written():
    written = {*tables.EFFECT_COLUMNS, *recommendation.COLUMNS}
    assert {"unabsorbed", "magnitude", "magnitude_min", "model_probability", "held_out_gain", "measurement"} <= written
    assert not set(COLUMNS) & written
