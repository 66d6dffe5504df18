"""Parameters that are not selected, taken as uncertain by a stated share."""

import json

import pandas as pd
import pytest

from calib.analyses.explain import explain
from calib.analyses.uncertain import uncertain, uncertain_note, with_uncertain
from calib.errors.errors import InputError
from calib.hypotheses.rules import RULES
from calib.results.results import Results
from calib.study.study import LoadedStudy

ALL, TWO = 'selection = ["E", "m_top", "K_base"]', 'selection = ["E", "K_base"]'
"""The mast's true mass at the top is 15 % larger than its nominal value."""


@pytest.fixture
def asked(mast, edited, tmp_path):
    """The explanation of a mast of which two of three parameters are fitted, and its results."""

    def ask(share, hidden=None):
        key = f'[explain]\nfixed_sd = "{share}"\n\n[calibration]' if share else "[calibration]"
        folder = edited(edited(mast.write_study(tmp_path / "mast", hidden), ALL, TWO), "[calibration]", key)
        study, results = LoadedStudy.load(folder), Results.at(tmp_path / "results", "mast")
        return study, explain(study, results), results

    return ask


@pytest.mark.slow
def test_a_parameter_that_is_held_at_a_wrong_value_is_taken_for_a_missing_effect(asked):
    assert asked(None)[1].verdict != "nothing_detectable"


def test_nothing_seems_missing_where_that_parameter_is_uncertain_by_as_much(asked):
    study, answer, results = asked("15 %")
    assert answer.verdict == "nothing_detectable"
    pulls = pd.read_csv(results.path / "pulls.csv").set_index("parameter")
    nominal = study.model.space["m_top"].value
    assert pulls.loc["m_top", "prior_sd"] == pytest.approx(0.15 * nominal)
    assert 0.5 < (pulls.loc["m_top", "value"] - nominal) / pulls.loc["m_top", "prior_sd"] < 1.5
    assert "Parameters that are not selected are uncertain by 15 %: m_top" in answer.notes[-1]
    assert json.loads((results.path / "explanation.json").read_text())["notes"][-1] == answer.notes[-1]


@pytest.mark.slow
def test_an_effect_is_still_named_beside_an_uncertain_parameter(asked):
    _, answer, _ = asked("15 %", {"guy": 12000.0})
    assert answer.verdict == "effect" and answer.explanation.credible == ("guy",)
    low, high = answer.effects.set_index("name").loc["guy", ["magnitude_low", "magnitude_high"]]
    assert low < 12000.0 < high


@pytest.mark.slow
def test_a_parameter_off_by_many_standard_deviations_is_told(asked):
    """A share of 2 % where the mass is 15 % off."""
    _, answer, results = asked("2 %")
    pulls = pd.read_csv(results.path / "pulls.csv").set_index(["model", "parameter"])
    assert bool(pulls.loc[("base", "m_top"), "pulled"])
    assert answer.verdict != "nothing_detectable"


def test_the_unselected_parameters_are_free_about_their_nominal_values(mast, edited, tmp_path):
    folder = edited(mast.write_study(tmp_path / "mast"), ALL, TWO)
    study = LoadedStudy.load(edited(folder, "[calibration]", '[explain]\nfixed_sd = "3 %"\n\n[calibration]'))
    assert [p.name for p in uncertain(study)] == ["m_top"]
    freed, own = with_uncertain(study).search_space, study.search_space
    p = freed["m_top"]
    assert p.prior_width == pytest.approx(0.03 * p.value) and p.upper - p.value == pytest.approx(
        RULES.freed_reach * p.prior_width
    )
    assert set(freed.free_names) == {*own.free_names, "m_top"} and all(freed[n] == own[n] for n in own.free_names)
    assert uncertain_note(study) == ("Parameters that are not selected are uncertain by 3 %: m_top.",)


def test_without_a_share_the_study_is_as_it_was(bare):
    assert with_uncertain(bare[0]) is bare[0] and uncertain_note(bare[0]) == ()


@pytest.mark.parametrize("given", ["0 %", "30 %", "much"])
def test_a_share_that_is_none_is_refused_with_its_line(mast, edited, tmp_path, given):
    folder = edited(
        mast.write_study(tmp_path / "mast"), "[calibration]", f'[explain]\nfixed_sd = "{given}"\n\n[calibration]'
    )
    with pytest.raises(InputError, match="fixed_sd") as refused:
        LoadedStudy.load(folder)
    assert "line" in str(refused.value)
