"""What an added effect brings, in words; and why nothing is added."""

import json
from types import SimpleNamespace

import pandas as pd
import pytest

from calib.questions.added import by_group, conclusion, to_add, write_nothing_added
from calib.questions.record import questions_of, write_record
from calib.questions.stale import stale_answers
from calib.questions.state import ADDED
from calib.results import Results
from calib.study import Study

BETTER = "the model fits better and predicts better what no fit has seen"
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
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (3, 1), "withheld_modes": (3, 1)}, BETTER),
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (3, 3), "withheld_modes": (3, 3.3)}, NO_BETTER),
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (3, 2.97)}, NO_BETTER),  # what is left out is used too
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (3, 1), "withheld_modes": (3, 4)},
         "the model fits better, predicts withheld sensors better, withheld modes no better"),
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (1, 1, 0.5, 0.6), "withheld_modes": (3, 1)},
         f"{BETTER}; withheld sensors stay within the noise"),
        ({"fit": (4, 1), "left_out": (5, 1), "withheld_sensors": (1, 1, 0.5, 0.6)},
         f"{NO_BETTER}; withheld sensors stay within the noise"),
        ({"fit": (4, 1), "left_out": (5, 1)}, "the model fits better and predicts data left out in turn better"),
        ({"fit": (4, 1), "left_out": (5, 6)}, NO_BETTER),
        ({"fit": (4, 4), "left_out": (5, 5), "withheld_modes": (3, 3)}, "the model fits no better, predicts no better"),
    ],
)  # fmt: skip
def test_whether_it_predicts_better_is_judged_by_what_no_fit_has_seen(groups, words):
    assert conclusion(errors(**groups)) == words


def test_groups_are_told_in_their_order_with_both_stages():
    table = by_group(errors(withheld_modes=(3, 2), fit=(4, 1)))
    assert list(table["group"]) == ["fit", "withheld_modes"]
    assert list(table["rms_before"]) == [4, 3] and list(table["rms_after"]) == [1, 2]


@pytest.fixture(scope="module")
def study(mast, tmp_path_factory):
    return Study.load(mast.write_study(tmp_path_factory.mktemp("added") / "mast"))


def found(verdict, *names, untold=()):
    chosen = SimpleNamespace(names=names) if names else None
    return SimpleNamespace(verdict=verdict, chosen=chosen, untold=untold or names, unrivalled=False)


def test_only_what_is_named_without_a_rival_is_added():
    assert to_add(found("effect", "guy")).names == ("guy",)
    assert to_add(found("two_effects", "guy", "lamp")).names == ("guy", "lamp")
    for verdict in ("indistinguishable", "partial", "none_explains"):
        assert to_add(found(verdict, "guy")) is None
    assert to_add(found("two_effects", "guy", "lamp", untold=("guy", "lamp", "ice"))) is None  # ice looks as one does
    assert to_add(found("nothing_detectable")) is None and to_add(found("noise_underestimated")) is None


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("nothing_detectable", "Nothing is missing that these data could show"),
        ("noise_underestimated", "scatter of the measurement has to be mended"),
        ("indistinguishable", "cannot tell between guy and lamp, so none of them is added"),
        ("two_effects", "cannot tell between guy and lamp, so none of them is added"),
        ("partial", "explains a part only"),
        ("none_explains", "No effect of the library explains"),
        ("misfit_unlocated", "look at the measurement that fits worst"),
        ("unconfirmed", "What fits, guy, is not confirmed"),
    ],
)
def test_why_nothing_is_added_is_told_and_written(study, verdict, words, tmp_path):
    answer = write_nothing_added(study, found(verdict, "guy", untold=("guy", "lamp")), Results(tmp_path))
    assert words in answer.sentence and answer.effects == () and answer.errors.empty
    told = json.loads((tmp_path / "added.json").read_text())
    assert told["sentence"] == answer.sentence and told["effects"] == [] and told["conclusion"] == ""


def test_that_nothing_is_added_is_an_answer_of_the_state_it_was_asked_of(study, mast, edited, tmp_path):
    results = Results(tmp_path)
    other = Study.load(edited(mast.write_study(tmp_path / "mast"), '"E", "m_top", ', '"E", '))
    write_nothing_added(study, found("none_explains"), results)
    assert list(stale_answers(other, results).sentences) == ["extend"]
    write_nothing_added(other, found("none_explains"), results)
    assert not stale_answers(other, results).sentences


def test_what_was_added_ends_with_the_answers_it_rests_on(study, tmp_path):
    results = Results(tmp_path)
    write_nothing_added(study, found("none_explains"), results)
    write_record(study, results, "compare", {})
    assert list(questions_of(results)) == ["extend", "compare"]
    results.remove(*ADDED)
    write_record(study, results, "compare", {})
    assert list(questions_of(results)) == ["compare"]
