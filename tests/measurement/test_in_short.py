"""Measured data and tests print themselves short."""

import numpy as np
import pytest

import calib
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.record import MeasuredRecord
from calib.measurement.responses import MeasuredResponses

PLACES = tuple(calib.Sensor(k, "z") for k in range(1, 31))
VALUES = np.ones((400, 30, 1), dtype=complex)
FRFS = MeasuredFRFs(np.linspace(1.0, 50.0, 400), PLACES, PLACES[:1], "mobility", VALUES, std=0.01 * abs(VALUES))
NUMBERS = MeasuredResponses({f"f{k}": (float(k), 0.1 if k % 2 else None) for k in range(1, 31)}, {})
RECORD = MeasuredRecord(100.0, np.random.default_rng(1).normal(size=(5000, 30)), PLACES, "velocity", synthetic=True)


@pytest.mark.parametrize("data, words", [
    (FRFS, ["30 FRFs", "mobility", "400 lines", "50 Hz", "1z", "30z"]),
    (NUMBERS, ["30 responses", "f1", "0.1", "18 more"]),
    (RECORD, ["50 s", "100 Hz", "velocity", "synthetic", "30z"]),
    (calib.FRFTest(FRFS, held_out=["7z"], name="empty", condition={"m": 3.0}), ["empty", "m = 3", "7z", "30 FRFs"]),
    (calib.ResponseTest(NUMBERS, held_out=["f3"]), ["f3", "30 responses"]),
])  # fmt: skip
def test_a_few_lines_hold_what_there_is(data, words):
    shown = str(data)
    assert len(shown) < 700 and shown.count("\n") < 18
    assert [word for word in words if word not in shown] == []
