"""Corrections take out exactly what a fault put in."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.corrections import correctable, corrected
from calib.measurement.modal import MeasuredModes, Sensor

FREQ = np.array([3.0, 7.0, 20.0])
NAMES = ("1x", "2x", "3x")


def modes(shapes, ratio=(0.01, 0.02, 0.03)):
    n = len(FREQ)
    return MeasuredModes(
        names=tuple("ABC"), natural_freq=FREQ, damped_freq=FREQ, freq_std=np.full(n, 0.01),
        damping_ratio=np.array(ratio), damping_std=np.full(n, 1e-3),
        sensors=tuple(Sensor(k + 1, "x", (float(k), 0.0, 0.0)) for k in range(3)), shapes=shapes,
        shape_std=np.full(shapes.shape, 0.02),
    )  # fmt: skip


@pytest.fixture
def shapes():
    rng = np.random.default_rng(1)
    return rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))


def test_each_correction_inverts_its_fault(shapes):
    low, late, mixed = (shapes.copy() for _ in range(3))
    low[1] *= 0.9
    late[1] *= np.exp(-2j * np.pi * FREQ * 2e-3)
    mixed[1] += 0.05 * shapes[0]
    for read, name, by in (
        (low, "gain of sensor 2x", -0.1),
        (late, "delay of sensor 2x", 2.0),
        (mixed, "cross-talk of sensor 1x into 2x", 0.05),
    ):
        found = corrected(modes(read), {name: by})
        np.testing.assert_allclose(found.shapes, shapes)
        assert name in found.notes[-1]
    np.testing.assert_allclose(corrected(modes(low), {"gain of sensor 2x": -0.1}).shape_std[1], 0.02 / 0.9)


@pytest.mark.parametrize(("how", "power"), [("to all modes", 0), ("in proportion to M", -1), ("in proportion to K", 1)])
def test_damping_of_the_analysis_is_taken_off(shapes, how, power):
    pattern = (FREQ / np.exp(np.mean(np.log(FREQ)))) ** power
    true = np.array([0.01, 0.02, 0.03])
    found = corrected(modes(shapes, true + 0.004 * pattern), {f"damping added {how}": 0.004})
    np.testing.assert_allclose(found.damping_ratio, true)


def test_what_cannot_be_corrected_is_refused(shapes):
    assert correctable("gain of sensor 2x") and not correctable("place of sensor 2x along x")
    for name, by in (("place of sensor 2x along x", 10.0), ("gain of sensor 2x", -1.0), ("gain of sensor 9x", 0.1)):
        with pytest.raises(InputError):
            corrected(modes(shapes), {name: by})
    with pytest.raises(InputError, match="less than nothing"):
        corrected(modes(shapes), {"damping added to all modes": 0.015})
