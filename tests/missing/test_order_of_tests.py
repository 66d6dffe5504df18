"""The recommended measurements are a test order: the cheapest first, with excitation, sensors, band and gain."""

import math
from dataclasses import replace

import pandas as pd
import pytest

from calib.missing.competing import BayesFactor, CandidateMeasurement, Excitation
from calib.missing.recommendation import HELD_OUT, Interval
from calib.missing.rules import RULES
from calib.missing.test_order import first_steps
from calib.missing.test_order import test_order as order_of
from tests.missing.measurement_designs import SENSOR, TWICE, Told, design

MODE = CandidateMeasurement(
    "a further mode, computed at 10 Hz", "mode", rows=SENSOR.rows, excitation=Excitation((1, 2, 3), "y", 10.0, 0.02)
)
HELD = CandidateMeasurement(f"mode 9B{HELD_OUT}", "mode", rows=SENSOR.rows)
BENCH = CandidateMeasurement("stiffness (P1) tested by itself to 3 %", "bench", prior_sd={"P1": 0.05})
ALL = (BENCH, SENSOR, MODE, HELD, TWICE)
WIDE = {"E0": Interval(54.0, 74.0, "kg")}


def ordered(gains, measurements=ALL, told=("E0",), intervals=WIDE, **more):
    """The order for gains by measurement, for the first effect; others gain ten times as much."""
    rows = [(m.name, m.kind, "E0", gains[m.name], math.nan, math.nan) for m in measurements]
    rows += [(m.name, m.kind, "E1", 10 * gains[m.name], math.nan, math.nan) for m in measurements]
    table = pd.DataFrame(rows, columns=["measurement", "kind", "effect", "gain", "ln_bayes", "chance"])
    plan = replace(design(measurements=measurements), repeats=5, band=(3.0, 40.0), **more)
    return order_of(table, plan, told, intervals)


def of(value):
    return {m.name: value for m in ALL}


def test_the_cheapest_kind_comes_first_whatever_it_gains_and_held_out_data_never():
    steps = ordered(of(2.0) | {TWICE.name: 1.4, BENCH.name: 9.0})
    assert steps["kind"].tolist() == ["repeats", "mode", "sensor", "bench"] and steps["step"].tolist() == [1, 2, 3, 4]
    assert not steps["what"].str.contains("9B").any()


def test_what_gains_too_little_is_no_step_and_of_a_kind_the_best_is_one():
    more = CandidateMeasurement("two sensors below", "sensor", rows=SENSOR.rows)
    gains = of(RULES.worthwhile - 0.01) | {SENSOR.name: 1.3, more.name: 1.9}
    steps = ordered(gains, (*ALL, more))
    assert steps["kind"].tolist() == ["sensor"] and more.name in steps["sensors"][0]


def test_the_cheapest_step_is_told_and_the_best_where_it_is_another():
    told = first_steps(ordered(of(2.0) | {MODE.name: 4.0, TWICE.name: 1.4}), "To narrow it")
    assert told.startswith("To narrow it, ") and told.index("20 -> 14 kg") < told.index(MODE.name) < told.index(
        "-> 5 kg"
    )
    assert SENSOR.name not in told
    (step,) = ordered({TWICE.name: 2.0}, (TWICE,)).to_dict("records")
    alone = first_steps(ordered(of(2.0) | {TWICE.name: 9.0}), "To narrow it")
    assert step["best"] and alone.count("kg wide") == 1 and "10 repeats" in alone


def test_an_interval_narrows_by_the_gain():
    steps = ordered(of(2.0)).set_index("kind")
    assert steps.loc["repeats", ["width_now", "width_then", "unit"]].tolist() == [20.0, 10.0, "kg"]
    assert "20 → 10 kg" in steps.loc["repeats", "narrows"] and "E0" not in steps.loc["repeats", "narrows"]
    assert "of E1: " in ordered(of(2.0), told=("E0", "E1"), intervals={"E1": Interval(1, 2, "kg")})["narrows"][0]
    unknown = ordered(of(2.0), intervals={}).set_index("kind")
    assert unknown["width_then"].isna().all() and "2 times" in unknown.loc["repeats", "narrows"]


def test_repeats_are_doubled_and_need_at_least_three():
    assert ordered(of(2.0)).set_index("kind").loc["repeats", "repeats"] == 10
    rows = [(TWICE.name, "repeats", "E0", 1.4, math.nan, math.nan)]
    table = pd.DataFrame(rows, columns=["measurement", "kind", "effect", "gain", "ln_bayes", "chance"])
    assert order_of(table, design(measurements=(TWICE,)), ["E0"], {})["repeats"].tolist() == [3]


def test_the_band_of_the_same_test_is_said_to_be_that_of_the_fit():
    steps = ordered(of(2.0)).set_index("kind")["how"]
    assert "the fit uses" in steps["repeats"] and "the fit uses" not in steps["mode"]


@pytest.mark.parametrize(("damping", "band", "lines", "by"), [
    (0.02, (8.0, 12.0), 0.08, "hammer"), (0.2, (4.0, 16.0), 0.8, "slow sweep"), (0.0, (8.0, 12.0), 0.01, "hammer"),
])  # fmt: skip
def test_a_mode_is_excited_where_it_moves_in_a_band_and_with_lines_that_its_damping_asks_for(damping, band, lines, by):
    mode = replace(MODE, excitation=MODE.excitation._replace(damping=damping))
    (r,) = ordered({MODE.name: 2.0}, (mode,)).to_dict("records")
    assert "(1.00, 2.00, 3.00) m along y" in r["excite"] and by in r["excite"]
    assert (r["freq_low"], r["freq_high"]) == pytest.approx(band) and r["resolution"] == pytest.approx(lines)
    assert f"resolution {lines:g} Hz" in r["how"]
    assert (f"{100 * damping:.0f} % damping" in r["excite"]) == (by == "slow sweep")


def test_what_hangs_on_the_structure_gets_an_accelerometer_of_its_own():
    mode = replace(MODE, excitation=MODE.excitation._replace(hung="brake_unit"))
    (r,) = ordered({MODE.name: 2.0}, (mode,)).to_dict("records")
    assert "accelerometer on the brake unit itself" in r["sensors"] and "on the brake unit itself" in r["excite"]
    assert r["what"] == "the mode that the brake unit adds, computed at 10 Hz"


def test_between_two_models_a_step_tells_odds():
    names = {m.name: BayesFactor(4.0, 2.0, 6.0, 0.8) for m in ALL}
    rows = [(m.name, m.kind, "E0", 2.0, 4.0 if m is SENSOR else 1.0, 0.8) for m in ALL]
    table = pd.DataFrame(rows, columns=["measurement", "kind", "effect", "gain", "ln_bayes", "chance"])
    (r,) = order_of(table, replace(design(measurements=ALL), competing=Told(names)), ["E0"], WIDE).to_dict("records")
    assert r["kind"] == "sensor" and "55:1" in r["narrows"] and "80 %" in r["narrows"] and math.isnan(r["width_now"])
