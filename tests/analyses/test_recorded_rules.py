"""Rules in the record: each analysis holds those it depends on, and is stale once one of them changes."""

from dataclasses import fields, is_dataclass, replace

import pytest

from calib.analyses.provenance.state import WRITES, every_rule, made_from, rules_of, state_differences
from calib.study.study_file import StudyFile

PLACES = {
    "reading": "calib.measurement.rules.RULES",
    "degrees_of_freedom": "calib.problem.degrees_of_freedom.RULES",
    "floors": "calib.correlation.standard_deviations.USUAL",
    "comparison": "calib.correlation.rules.RULES",
    "faults": "calib.correlation.fault_rules.RULES",
    "models": "calib.structure.rules.RULES",
    "sensitivity": "calib.sensitivity.rules.RULES",
    "prognosis": "calib.sensitivity.rules.PROGNOSIS",
    "limits": "calib.problem.parameter.RULES",
    "inference": "calib.inference.rules.RULES",
    "analyses": "calib.hypotheses.rules.RULES",
    "missing": "calib.missing.rules.RULES",
}


def test_all_rules_are_frozen_and_recorded_by_some_analysis():
    assert set(every_rule()) == set(PLACES) == {name for analysis in WRITES for name in rules_of(analysis)}
    for rules in every_rule().values():
        assert is_dataclass(rules) and type(rules).__dataclass_params__.frozen and fields(rules)


@pytest.mark.parametrize("analysis", ["compare", "sensitivity", "calibrate", "explain"])
@pytest.mark.parametrize("name", PLACES)
def test_an_analysis_is_stale_once_one_of_its_rules_changes(guyed, monkeypatch, analysis, name):
    study = guyed[0]
    file = StudyFile.read(study.file)
    then = made_from(study, analysis)
    assert state_differences(then, made_from(study, analysis)) == []
    rules = every_rule()[name]
    first = fields(rules)[0].name
    monkeypatch.setattr(PLACES[name], replace(rules, **{first: 2 * getattr(rules, first)}))
    expected = ["the rules of calib"] if name in rules_of(analysis) else []
    assert state_differences(then, made_from(study, analysis)) == expected
    assert state_differences(then, made_from(file, analysis)) == expected
