"""Faults of the measurement that are told first, and those that cannot be told from the model."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.decision import decide
from calib.missing.suspect import COLUMNS
from calib.missing.tables import effects_table
from calib.missing.verdict import Doubts, verdict_of
from tests.missing.test_restarts import TRUTH, turning
from tests.missing.verdict_cases import errors, text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")
CANNOT = "Model or measurement is wrong, and these data cannot tell which"


def beside(made, seed=3):
    """What is left besides: a direction of two modes that nothing has."""
    known = np.column_stack(list(made.columns.values()))
    there = np.isin([row.mode for row in made.rows], ["M6", "M7"])
    hidden = np.zeros(len(known))
    drawn = np.random.default_rng(seed).standard_normal(there.sum())
    hidden[there] = drawn - known[there] @ np.linalg.lstsq(known[there], drawn, rcond=None)[0]
    return replace(made, columns={**made.columns, "hidden": hidden / np.linalg.norm(hidden)})


def test_a_fault_alone_is_named(faulty):
    found = decide(faulty().drawn(np.random.default_rng(1), {"F2": 1.5}))
    assert found.verdict == "measurement" and found.blamed[0].names == ("F2",) and not found.remains
    assert "is what does not fit: F2" in text_of(found)


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(3))
def test_a_fault_far_ahead_is_told_first_although_something_is_left(faulty, seed):
    made = beside(faulty())
    found = decide(made.drawn(np.random.default_rng(seed), {"F2": 4.0, "hidden": 12.0}))
    assert found.verdict == "measurement" and found.remains and found.fault.names == ("F2",)
    assert found.chosen is None and found.credible == () and found.blamed[0].names == ("F2",)
    text = text_of(found)
    assert "The measurement first: F2" in text and "Something may be left besides." in text
    assert "is what does not fit" not in text and "no effect or place stands out" not in text


@pytest.mark.medium
def test_a_fault_that_takes_little_is_not_told_first(faulty):
    made = beside(faulty())
    found = decide(made.drawn(np.random.default_rng(0), {"F2": 1.2, "hidden": 80.0}))
    fault = found.faults[0]
    assert fault.names == ("F2",) and found.ln_bayes(fault) > 8
    assert found.base.fit.misfit - fault.fit.misfit < 0.02 * found.base.fit.misfit
    assert found.verdict == "none_explains"


def test_a_fault_nearly_collinear_with_an_effect_cannot_be_told_from_it(faulty):
    """Also with odds of more than 20:1 for the fault."""
    made = faulty().correlated("F2", "E1", 0.95)
    found = decide(made.drawn(np.random.default_rng(1), {"F2": 2.5}))
    assert found.ln_bayes(found.fault) - found.ln_bayes(found.singles[0]) > 3.0
    assert found.verdict == "indistinguishable" and found.equally_good == ("E1", "F2")
    text = text_of(found)
    assert CANNOT in text and "a lack of E1, about" in text and "nearly collinear" in text
    assert "wrong measurement explains the misfit best" not in text


def test_a_fault_nearly_collinear_with_a_place_cannot_be_told_from_it(faulty):
    made = faulty().correlated("F2", "A1", 0.95)
    found = decide(made.drawn(np.random.default_rng(1), {"F2": 2.5}))
    assert found.verdict == "measurement" and found.place.names == ("A1",)
    text = text_of(found)
    assert CANNOT in text and "; or A1, about" in text


@pytest.mark.parametrize(("kind", "verdict"), [("damping", "indistinguishable"), ("gain", "effect")])
def test_an_effect_like_added_damping_is_never_named_bare(faulty, kind, verdict):
    made = faulty(kind=kind).correlated("F2", "E1", 0.95)
    found = decide(made.drawn(np.random.default_rng(2), {"E1": 2.5}))
    assert found.singles[0].names == ("E1",) and found.singles[0].ln_evidence > found.faults[0].ln_evidence + 3.0
    assert found.verdict == verdict and found.credible == ("E1",)
    assert (CANNOT in text_of(found)) == (kind == "damping")


def doubted(found):
    doubts = Doubts(("Sensor 12y looks turned round.",), ("sensor 12y",))
    return verdict_of(found, effects_table(found, {}, {}), errors(), doubts=doubts)


@pytest.mark.medium
@pytest.mark.parametrize("verdict", ["none_explains", "partial"])
def test_what_a_comparison_finds_in_the_measurement_comes_first(cases, verdict):
    told = doubted(cases[verdict])
    assert told.answer.found.startswith("Sensor 12y looks turned round. The model lacks something")
    assert told.answer.then.startswith("Check first: sensor 12y. ") and told.sentences[0] == told.answer.found


@pytest.mark.parametrize(("doubtful", "alone"), [("mode M2", True), ("mode M3", False)])
def test_nothing_more_is_missing_where_a_mode_found_twice_is_all_that_does_not_fit(cases, doubtful, alone):
    table = pd.DataFrame(
        [("mode M2", "mode", 54, 6e4, 50.0, 1e-9, 0.31, True), ("mode M3", "mode", 54, 9e3, 50.0, 1e-3, np.nan, False)],
        columns=list(COLUMNS),
    )
    for verdict in ("none_explains", "partial"):
        found = replace(cases[verdict], suspects=table)
        doubts = Doubts(("Two modes look like one.",), ("modes M1 and M2",), ("mode M1", doubtful))
        told = verdict_of(found, effects_table(found, {}, {}), errors(), pointed="Look there.", doubts=doubts).answer
        assert told.found.startswith("Two modes look like one. ") and told.then.startswith("Check first: modes M1")
        assert ("lacks" in told.found) is not alone and ("Look there." in told.then) is not alone
        assert ("mode M2" in told.found and "0.31" in told.found) is alone
        assert ("ask again" in told.then) is alone


@pytest.mark.parametrize("verdict", ["nothing_detectable", "effect"])
def test_a_doubt_that_the_data_do_not_share_is_not_told(cases, verdict):
    told = doubted(cases[verdict])
    assert "12y" not in told.answer.found and "12y" not in told.answer.then


def test_faults_are_fitted_from_the_nominal_values_too(toy):
    """A gross fault has drawn the base fit into another valley, from which no fit with the fault returns."""
    made = turning(toy, 150.0, 30.0)
    fault = replace(made.effects[0])
    object.__setattr__(fault, "of_measurement", True)
    made = replace(made, effects=made.effects[1:], faults=(fault,))
    found = decide(made.drawn(np.random.default_rng(1), TRUTH))
    assert found.begun_anew and abs(found.base.fit.values["P0"]) > 2.4
    assert found.verdict == "measurement" and found.blamed[0].names == ("E0",) and not found.remains
    assert found.fault.fit.values["P0"] == pytest.approx(TRUTH["P0"], abs=0.5)
