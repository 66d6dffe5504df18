"""The record beside the results: measurement, assumptions, versions, seeds and sentences."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib import __version__
from calib.analyses.compare import compare
from calib.analyses.provenance.record import limits_table, measured_table, sensors_table, write_record
from calib.analyses.provenance.state import every_rule
from calib.correlation import rules as comparison
from calib.problem.parameter import Parameter
from calib.problem.space import ParameterSpace
from calib.results.results import Results
from calib.sensitivity import rules as sensitivity
from calib.structure.eigenproblem.symmetric_factor import metis
from calib.study.settings import AdoptedSettings
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


def record(results):
    return json.loads((results.path / "record.json").read_text("utf-8"))


def test_held_out_modes_and_sensors_are_listed_and_marked(guyed):
    study, results, _, _ = guyed
    measured = pd.read_csv(results.path / "measured.csv")
    assert list(measured["mode"]) == list(study.whole.names)
    assert list(measured.loc[measured["held_out"], "mode"]) == ["B3x"]
    np.testing.assert_allclose(measured["natural_freq"], study.whole.natural_freq, rtol=1e-9)
    np.testing.assert_allclose(measured["freq_std"], study.whole.freq_std, rtol=1e-9)
    sensors = pd.read_csv(results.path / "sensors.csv")
    assert list(sensors.loc[sensors["held_out"], "sensor"]) == ["2x", "4z"]
    assert list(sensors["sensor"]) == [s.name for s in study.whole.sensors]


def test_the_standard_deviation_of_a_sensor_is_the_root_mean_square_over_its_modes(guyed):
    whole = guyed[0].whole
    std = np.tile([3.0, 4.0], (len(whole.sensors), whole.n_modes))[:, : whole.n_modes].astype(float)
    std[0, 0] = np.nan
    std[1] = np.nan
    table = sensors_table(replace(whole, shape_std=std), ())
    assert table["shape_std"][0] == pytest.approx(np.sqrt(np.mean(std[0, 1:] ** 2)))
    assert np.isnan(table["shape_std"][1])


def test_scalar_responses_are_listed_with_their_standard_deviation(chain):
    study = chain[0]
    table = measured_table(study)
    assert list(table.columns) == ["response", "held_out", "value", "std", "repeats", "std_used"]
    assert dict(zip(table["response"], table["value"], strict=True)) == {n: v for n, (v, _) in study.targets.items()}
    assert not table["held_out"].any()


def test_the_record_names_versions_and_seeds_and_keeps_earlier_analyses(guyed, tmp_path):
    study = guyed[0]
    results = Results.at(tmp_path, study.name)
    answer = compare(LoadedStudy.load(study.file), results)
    write_record(study, results, "sensitivity", {"samples": 7}, ["Two matter."], quick=True)
    content = record(results)
    assert content["study"] == study.name and content["synthetic"] is study.synthetic
    assert content["repeats"] == study.whole.n_repeats
    assert list(content["analyses"]) == ["compare", "sensitivity"]
    first, second = content["analyses"].values()
    assert first["sentences"] == list(answer.sentences) and first["seeds"] == {} and not first["quick"]
    assert second["seeds"] == {"samples": 7} and second["quick"] and second["sentences"] == ["Two matter."]
    assert set(first["rules"]) < set(every_rule()) and first["rules"]["comparison"]["level"] == comparison.RULES.level
    assert second["rules"]["sensitivity"] == asdict(sensitivity.RULES) and "missing" not in first["rules"]
    assert first["versions"]["calib"] == __version__ and first["versions"]["numpy"] == np.__version__
    assert first["versions"].get("pymetis", "") == metis()  # the order of elimination changes last digits


def test_adopted_values_are_recorded_with_their_source(guyed, tmp_path):
    study, results = guyed[0], Results.at(tmp_path, "mast")
    write_record(study, results, "compare", {})
    assert record(results)["adopted"] == {} and record(results)["adopted_from"] is None
    given = study.settings.model_copy(update={"adopted": AdoptedSettings(study="../older", parameters=("E",))})
    write_record(replace(study, settings=given, adopted={"E": 205.0, "K_base": 1.0}), results, "compare", {})
    assert record(results)["adopted"] == {"E": 205.0} and record(results)["adopted_from"] == "../older"


@pytest.mark.parametrize("content", ["{", "[]", '{"analyses": 3}'])
def test_a_damaged_record_is_replaced(guyed, tmp_path, content):
    results = Results.at(tmp_path, guyed[0].name)
    (results.path / "record.json").write_text(content)
    write_record(guyed[0], results, "compare", {})
    assert list(record(results)["analyses"]) == ["compare"]


def test_the_limits_of_the_search_stand_beside_those_of_the_sensitivity():
    space = ParameterSpace(
        (Parameter("k", 2.0, 1.0, 3.0), Parameter("m", 5.0, 4.0, 6.0), Parameter("c", 1.0, 0.5, 2.0))
    )
    search = space.widen({"k": (0.5, 9.0), "m": (2.0, 8.0)}).keep(("k", "m"))
    other = space.replace("k", lower=1.5)
    table = limits_table(search, search, (space, other)).set_index("parameter")
    assert table.loc["k", ["lower", "upper", "search_lower", "search_upper"]].tolist() == [1.5, 3.0, 0.5, 9.0]
    assert table.loc["m", ["lower", "upper", "search_lower", "search_upper"]].tolist() == [4.0, 6.0, 2.0, 8.0]
    assert table.loc["c", ["lower", "upper"]].tolist() == [0.5, 2.0]
    assert table.loc["c", ["search_lower", "search_upper"]].isna().all()  # the calibration holds it


@pytest.mark.medium
def test_the_record_of_a_study_tells_both_limits(tmp_path):
    results = Results.at(tmp_path, "hidden_bogie")
    write_record(LoadedStudy.load(ROOT / "studies/hidden_bogie"), results, "compare", {})
    table = pd.read_csv(results.path / "parameter_space.csv").set_index("parameter")
    limits = ["lower", "upper", "search_lower", "search_upper"]
    assert table.loc["K_contact", limits].tolist() == [15250.0, 35250.0, 5000.0, 60000.0]
    assert table.loc["m_axle", limits[2:]].isna().all()
