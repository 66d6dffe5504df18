"""The answers of the analyses: numbers are those of the results, and what is doubtful decides what comes next."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.analyses.answers import NAMED, UNTRIED, enumerated, of_comparison, of_fit, of_sensitivity, screening_answer
from calib.correlation.modal.comparison import BEYOND, UNKNOWN, WITHIN


def compared(error, mac=np.nan, noise=np.nan, checks=()):
    return SimpleNamespace(
        comparison=None, std_notes=(), frfs=None, mean_freq_error=error, mean_mac=mac, noise_mac=noise, checks=checks
    )


def verdicts(*identified):
    return pd.DataFrame({"parameter": [f"P{k}" for k in range(len(identified))], "identified": list(identified)})


def statistics(fits=True, suspected=(), ratios_only=False, complete=True, assumed="", held=(), mesh=""):
    considered = pd.DataFrame({"matters": [m for m, _ in held], "words": [w for _, w in held]})
    table = pd.DataFrame({"what": list(suspected), "explains": [True] * len(suspected)}, columns=["what", "explains"])
    return SimpleNamespace(
        fits=fits, p_fit=0.25, suspects=table, assumed=assumed, complete=complete,
        identification=SimpleNamespace(ratios_only=ratios_only), considered=considered, mesh=mesh, between=None,
    )  # fmt: skip


def fit(given=None, table=None, pairs=None, **more):
    table = verdicts(True) if table is None else table
    return of_fit(given or statistics(), table, pairs or {"": (compared(0.05), compared(0.01))}, **more)


def test_a_fit_tells_the_errors_before_and_after_of_every_test():
    pairs = {"empty": (compared(0.05, 0.9), compared(0.01, 0.99, 0.995)), "loaded": (compared(0.2), compared(0.1))}
    found = fit(pairs=pairs).found
    for words in ("empty", "5.00 % -> 1.00 %", "0.900 -> 0.990", "0.995", "loaded", "20.00 % -> 10.00 %"):
        assert words in found
    assert "nan" not in found


def test_a_fit_is_as_sure_as_its_parameters_and_its_assumptions():
    sure = fit(statistics(assumed="shapes 3 %", complete=False), verdicts(True, False), contradictions=("No.",)).sure
    assert "p = 0.25" in sure and "1 of 2" in sure and "P1" in sure
    assert "shapes 3 %" in sure and UNTRIED in sure and "No." in sure
    assert "None" not in fit().sure and "  " not in fit().sure


def test_a_fit_is_as_sure_as_what_is_held_and_as_its_mesh():
    held = [(True, "m is held."), (True, "c is held."), (False, "b is held.")]
    sure = fit(statistics(held=held, mesh="The mesh moves k.")).sure
    assert "m is held." in sure and "The mesh moves k." in sure and "c is held." not in sure
    assert "b is held." not in fit(statistics(held=held[2:])).sure


def test_what_is_wrong_in_the_measurement_is_checked_before_the_model():
    wrong = {"": (compared(0.05, checks=("the sign of response 2x",)), compared(0.01))}
    assert "the sign of response 2x" in fit(statistics(False), verdicts(False), wrong, contradictions=("No.",)).then
    several = {"A": (compared(0.05), compared(0.01)), "B": (compared(0.05), compared(0.01, checks=("sensor 1z",)))}
    assert "sensor 1z in test B" in fit(pairs=several).then


def test_each_doubt_has_its_own_next_step_and_the_gravest_comes_first():
    doubts = [
        fit(statistics(False, ["frequency of B1"]), verdicts(False), contradictions=("No.",), too_few="3 modes: more"),
        fit(statistics(False), verdicts(False), contradictions=("No.",)),
        fit(statistics(False), verdicts(False), too_few="3 modes: more"),
        fit(statistics(None, ratios_only=True), verdicts(False)),
        fit(statistics(None), verdicts(False)),
        fit(statistics(), verdicts(False), agreement="not settled"),
        fit(statistics(), verdicts(True, False)),
        fit(),
    ]
    steps = [answer.then for answer in doubts]
    assert len(set(steps)) == len(steps) and all(steps)
    assert "frequency of B1" in steps[0] and "calib explain" in steps[1] and "P1" in steps[6] and "P0" not in steps[6]
    assert fit(contradictions=("No.",)).then == steps[1]
    assert "3 modes: more" in steps[2] and not any("explain" in step for step in (steps[0], *steps[2:]))


def test_an_explanation_weighs_a_datum_before_the_user_doubts_it():
    then = fit(statistics(False, ["mode 2BT"]), verdicts(False)).then
    assert then.index("calib explain STUDY") < then.index("mode 2BT")
    wrong = {"": (compared(0.05, checks=("sensor 2x",)), compared(0.01))}
    then = fit(statistics(False, ["mode 2BT"]), verdicts(False), wrong).then
    assert "sensor 2x" in then and "explain" not in then


def test_modes_call_for_no_calibration_where_they_agree_and_not_where_nothing_is_known():
    def then(*verdicts, paired=(0,)):
        table = pd.DataFrame({"verdict": verdicts})
        pairing = SimpleNamespace(paired=paired)
        found = SimpleNamespace(
            summary=lambda: ("", ""), far=(), where_it_fails=lambda: table, pairing=pairing,
            measured=SimpleNamespace(has_shapes=True),
        )  # fmt: skip
        return of_comparison(SimpleNamespace(comparison=found, frfs=None, checks=(), std_notes=())).then

    assert "calib calibrate STUDY" in then(WITHIN, BEYOND) and then(UNKNOWN, UNKNOWN) == then(WITHIN, BEYOND)
    assert then(WITHIN, UNKNOWN) == then(WITHIN) != then(BEYOND)
    assert then(UNKNOWN, paired=()).startswith("Check first: places and directions")


def test_responses_that_agree_call_for_no_calibration():
    rows = [("a", 0.10, 5.0), ("b", -0.30, -1.0), ("c", np.nan, np.nan)]
    table = pd.DataFrame(rows, columns=["response", "error", "error_in_std"])
    result = SimpleNamespace(comparison=None, std_notes=(), frfs=None, table=table, mean_freq_error=0.2)
    off = of_comparison(result)
    assert "calib run STUDY" in off.then and "calib calibrate STUDY" in off.then
    assert "20.00 %" in off.found and "-30.00 % (b)" in off.found and "1 of 2" in off.sure
    result.table = table.assign(error_in_std=0.5)
    assert of_comparison(result).then != off.then
    result.table = table.assign(error_in_std=np.nan)
    assert of_comparison(result).then == off.then and "is stated" in of_comparison(result).sure


def test_parameters_that_matter_are_counted_and_what_the_study_does_otherwise_is_told():
    table = pd.DataFrame(
        {"parameter": ["a", "b", "c"], "measured": [True, True, False], "selected": [True, False, True]}
    )
    answer = of_sensitivity(table, "20 samples.")
    assert "2 of 3" in answer.found and "leaves out b" in answer.found and "also selects c" in answer.found
    assert answer.sure == "20 samples." and "calib calibrate" in answer.then


def test_a_screening_ranks_by_the_largest_effect():
    table = pd.DataFrame(
        [("a", "x", 0.1), ("b", "x", 0.3), ("a", "y", 0.7), ("c", "x", np.nan)],
        columns=["parameter", "response", "mu_star"],
    )
    answer = screening_answer("morris", table, "12 points.")
    assert answer.found.index("a (0.7)") < answer.found.index("b (0.3)") and "c (" not in answer.found


@pytest.mark.parametrize("count", [0, 1, NAMED, NAMED + 1, NAMED + 5])
def test_of_many_names_the_first_are_told_and_the_others_counted(count):
    names = [f"n{k}" for k in range(count)]
    told = enumerated(names)
    assert sum(name in told for name in names) == min(count, NAMED) and (f"{count - NAMED} more" in told) == (
        count > NAMED
    )
