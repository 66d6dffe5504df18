"""Benefit of an added effect, in words; and why no effect is added."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.analyses import added
from calib.analyses.added import _held_out_modes, by_group, conclusion, to_add, write_nothing_added
from calib.analyses.provenance.record import analyses_of, write_record
from calib.analyses.provenance.stale import stale_answers
from calib.analyses.provenance.state import ADDED
from calib.results.results import Results
from calib.study.study import LoadedStudy

BETTER = "the model fits better and predicts validation data better"
NO_BETTER = "the model fits better, predicts no better"


def errors(**groups):
    """Errors before and after of every group, and their p where it is given."""
    rows = []
    for group, (before, after, *p) in groups.items():
        chances = p or (0.0, 0.01)
        rows += [
            (group, stage, 10, rms, 1.0, c, 0)
            for stage, rms, c in zip(("before", "after"), (before, after), chances, strict=True)
        ]
    return pd.DataFrame(rows, columns=["group", "stage", "rows", "rms", "expected", "p", "unpaired"])


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (3, 1), "held_out_modes": (3, 1)}, BETTER),
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (3, 3), "held_out_modes": (3, 3.3)}, NO_BETTER),
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (3, 2.97)}, NO_BETTER),  # left-out data are used data
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (3, 1), "held_out_modes": (3, 4)},
         "the model fits better, predicts validation sensors better, validation modes no better"),
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (1, 1, 0.5, 0.6), "held_out_modes": (3, 1)},
         "the model fits better and predicts validation modes better; validation sensors stay within the noise"),
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (3, 1), "held_out_modes": (0.97, 0.94, 0.59, 0.74)},
         "the model fits better and predicts validation sensors better; validation modes stay within the noise"),
        ({"fit": (4, 1), "left_out": (5, 1), "held_out_sensors": (1, 1, 0.5, 0.6)},
         f"{NO_BETTER}; validation sensors stay within the noise"),
        ({"fit": (4, 1), "left_out": (5, 1)}, "the model fits better and predicts data left out in turn better"),
        ({"fit": (4, 1), "left_out": (5, 6)}, NO_BETTER),
        ({"fit": (4, 4), "left_out": (5, 5), "held_out_modes": (3, 3)}, "the model fits no better, predicts no better"),
    ],
)  # fmt: skip
def test_predictions_are_compared_with_held_out_data(groups, words):
    assert conclusion(errors(**groups)) == words


def test_a_held_out_mode_that_gets_worse_is_named():
    modes = pd.DataFrame(
        {
            "mode": ["1B", "4B", "5B", "9B"],
            "held_out": [False, True, True, True],
            "error_before": [0.001, -0.0003, 0.04, np.nan],
            "error_after": [0.002, -0.007, -0.01, 0.5],
        }
    )
    words = _held_out_modes(modes)
    assert words == "The frequency error falls in 1 of 2 validation modes; it grows for 4B (0.03 -> 0.70 %)."
    assert _held_out_modes(modes.iloc[[2]]) == "The frequency error falls in 1 of 1 validation mode."
    assert (
        _held_out_modes(modes.iloc[[1]]) == "The frequency error grows in every validation mode: 4B (0.03 -> 0.70 %)."
    )
    assert _held_out_modes(modes.iloc[[0, 3]]) == _held_out_modes(pd.DataFrame()) == ""


def test_groups_are_in_order_with_both_stages():
    table = by_group(errors(held_out_modes=(3, 2), fit=(4, 1)))
    assert list(table["group"]) == ["fit", "held_out_modes"]
    assert list(table["rms_before"]) == [4, 3] and list(table["rms_after"]) == [1, 2]


@pytest.fixture(scope="module")
def study(mast, tmp_path_factory):
    return LoadedStudy.load(mast.write_study(tmp_path_factory.mktemp("added") / "mast"))


def found(verdict, *names, equally_good=()):
    chosen = SimpleNamespace(names=names) if names else None
    return SimpleNamespace(
        verdict=verdict,
        chosen=chosen,
        chosen_adequacy=None,
        equally_good=equally_good or names,
        steps=None,
        uncontested=False,
        granted=(),
        mistakable=(),
    )


def test_only_effects_without_a_competing_model_are_added():
    assert to_add(found("effect", "guy")).names == ("guy",)
    assert to_add(found("two_effects", "guy", "lamp")).names == ("guy", "lamp")
    for verdict in ("indistinguishable", "partial", "none_explains"):
        assert to_add(found(verdict, "guy")) is None
    assert (
        to_add(found("two_effects", "guy", "lamp", equally_good=("guy", "lamp", "ice"))) is None
    )  # ice is a competing model
    assert to_add(found("nothing_detectable")) is None and to_add(found("noise_underestimated")) is None


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("nothing_detectable", "These data show no missing effect"),
        ("noise_underestimated", "Correct the standard deviation of the measurement first"),
        ("indistinguishable", "cannot discriminate between guy and lamp, so none of them is added"),
        ("two_effects", "cannot discriminate between guy and lamp, so none of them is added"),
        ("partial", "explain only part of the misfit"),
        ("none_explains", "No listed cause explains"),
        ("measurement", "nothing is added to the model: correct it first"),
        ("misfit_unlocated", "check the data that fit worst"),
        ("unconfirmed", "The best-fitting explanation, guy, is not confirmed"),
    ],
)
def test_why_nothing_is_added_is_reported_and_written(study, verdict, words, tmp_path):
    answer = write_nothing_added(study, found(verdict, "guy", equally_good=("guy", "lamp")), Results(tmp_path))
    assert words in answer.sentence and answer.effects == () and answer.errors.empty
    written = json.loads((tmp_path / "added.json").read_text())
    assert written["sentence"] == answer.sentence and written["effects"] == [] and written["conclusion"] == ""


def test_something_like_an_effect_is_added_on_request_only(monkeypatch):
    monkeypatch.setattr(added, "is_simpler_form", lambda found: True)
    words = added.nothing_added(found("partial", "guy"))
    assert "like guy is missing" in words and "'calib extend' adds it anyway" in words


def test_the_result_that_nothing_is_added_belongs_to_one_state_of_the_study(study, mast, edited, tmp_path):
    results = Results(tmp_path)
    other = LoadedStudy.load(edited(mast.write_study(tmp_path / "mast"), '"E", "m_top", ', '"E", '))
    write_nothing_added(study, found("none_explains"), results)
    assert list(stale_answers(other, results).sentences) == ["extend"]
    write_nothing_added(other, found("none_explains"), results)
    assert not stale_answers(other, results).sentences


def test_an_extension_leaves_the_record_with_the_analyses_it_rests_on(study, tmp_path):
    results = Results(tmp_path)
    write_nothing_added(study, found("none_explains"), results)
    write_record(study, results, "compare", {})
    assert list(analyses_of(results)) == ["extend", "compare"]
    results.remove(*ADDED)
    write_record(study, results, "compare", {})
    assert list(analyses_of(results)) == ["compare"]
