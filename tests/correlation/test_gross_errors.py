"""Signs, units and orders of measured FRFs that are wrong are found; a wrong model gives no false alarm."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.compare import comparison_at
from calib.correlation.frf.gross_errors import FACTORS, gross_errors
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
STUDIES = Path(__file__).parents[2] / "studies"
MEASURED = WORLD.measured(3, share=0.02)
NOMINAL = {"k": 1e4, "c": 8.0, "m": 2.0}


def found(factor, values=WORLD.TRUE, **changed):
    """What is found where measured functions are multiplied by a factor (n_freq, n_responses, n_references)."""
    read = replace(MEASURED, values=MEASURED.values * factor, std=MEASURED.std * np.abs(factor))
    return gross_errors(read, WORLD.truth(values, **changed))


def of(response=None, reference=None, factor=-1.0):
    out = np.ones(MEASURED.values.shape, dtype=complex)
    out[:, slice(None) if response is None else response, slice(None) if reference is None else reference] *= factor
    return out


@pytest.mark.parametrize("factor", [f * sign for f in FACTORS for sign in (1, -1) if f * sign != 1.0])
def test_a_factor_of_the_whole_test_is_found(factor):
    (error,) = found(of(factor=1.03 * factor))
    assert (error.scope, error.names, error.factor.order) == ("test", (), 0)
    assert error.factor.value == pytest.approx(1.03 * factor, rel=0.01)
    assert ("sign" in error.check) == (factor < 0) and ("units" in error.check) == (abs(factor) != 1.0)


@pytest.mark.parametrize("order", [-2, -1, 1, 2])
def test_an_order_of_the_whole_test_is_found(order):
    (error,) = found(of(factor=(2j * np.pi * WORLD.FREQ[:, None, None]) ** order))
    assert (error.scope, error.factor.order) == ("test", order)
    assert error.factor.value == pytest.approx(1.0, rel=0.01)
    looks = {-2: "receptance", -1: "mobility", 1: "differentiated once", 2: "differentiated twice"}
    assert looks[order] in error.sentence and "quantity" in error.check


def test_single_channels_are_found_and_channels_with_the_same_error_told_together():
    (error,) = found(of(1))
    assert (error.scope, error.names) == ("response", ("3x",)) and "3x" in error.sentence
    (error,) = found(of(1) * of(2))
    assert error.names == ("3x", "4x")
    (error,) = found(of(None, 1, 1 / 4.4482216))
    assert (error.scope, error.names) == ("reference", ("4x",)) and "pounds" in error.sentence
    assert found(of(0, 0)) == ()  # one function: neither its response nor its reference agrees by one factor
    first, second = found(of(factor=1 / 9.80665) * of(1))
    assert (first.scope, second.names) == ("test", ("3x",)) and first.factor.known == pytest.approx(1 / 9.80665)


def test_a_right_test_and_a_model_that_is_wrong_give_none():
    assert found(of(factor=1.0)) == ()
    assert found(of(factor=0.9)) == () and found(of(factor=2.0)) == ()  # a calibration, or a mass: no known factor
    for values in (NOMINAL, {**WORLD.TRUE, "m": 4.0}, {**WORLD.TRUE, "c": 50.0}, {"k": 2e4, "c": 1.0, "m": 5.0}):
        assert found(of(factor=1.0), values) == ()
    assert found(of(factor=1.0), ground=2e4) == () and found(of(factor=1.0), links=3.0) == ()


@pytest.mark.medium
def test_wrong_models_give_no_false_alarm_however_they_are_wrong():
    rng = np.random.default_rng(5)
    limits = np.array([[5e3, 2e4], [1.0, 50.0], [1.0, 5.0], [0.5, 2.0], [1.0, 1e4]])
    for point in np.exp(rng.uniform(*np.log(limits).T, (60, 5))):
        values = dict(zip(("k", "c", "m"), point, strict=False))
        assert found(of(factor=1.0), values, links=point[3], ground=point[4]) == ()


def test_lines_at_0_hz_and_functions_of_zero_are_passed_over():
    read = replace(MEASURED, freq=np.concatenate([[0.0], MEASURED.freq[1:]]), values=MEASURED.values * of(1))
    model = WORLD.truth(WORLD.TRUE)
    assert [e.names for e in gross_errors(read, model)] == [("3x",)]
    assert gross_errors(read, np.zeros_like(model)) == ()


@pytest.mark.medium
def test_they_come_before_the_fit_from_every_door():
    """The comparison, the calibration and what both advise next."""
    read = replace(MEASURED, values=MEASURED.values * of(1))
    problem = calib.Problem(WORLD.chain(**WORLD.TRUE), calib.FRFTest(read))
    compared, fit = problem.compare(), problem.calibrate(starts=1, progress=False)
    ((sentence,),) = (answer.doubts for answer in compared.by_test.values())
    assert (
        "response 3x" in sentence
        and sentence in str(compared)
        and sentence in compared.sentences
        and sentence in fit.sentences
    )
    assert "sign of response 3x" in compared.lines["Next"] and fit.lines["Next"] == compared.lines["Next"]


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    "name",
    [
        "hidden_panel_frf", "solar_panel", "hidden_bogie_frf",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("hidden_bogie_joint", "vehicle_frf")),
    ],
)  # fmt: skip
def test_shipped_studies_have_none(name):
    for study in calib.Study.load(STUDIES / name, progress=False).loaded.studies:
        assert comparison_at(study, study.model.space.values).gross_errors == ()
