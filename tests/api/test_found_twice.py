"""A mode that the analysis found twice is told before anything is fitted; two modes that the model has are not."""

import numpy as np
import pytest

import calib
from calib.measurement.modal import Sensor
from tests.api import mounted_beam as beam


def modes(extra, freq_ratio=1.006, noise=0.01):
    """The modes of another beam, one of them given once more with its own noise."""
    lambdas, shapes = beam.solved()
    rng = np.random.default_rng(1)
    freq, names = abs(lambdas) / (2 * np.pi), [f"M{k + 1}" for k in range(beam.MODES)]
    order = [*range(beam.MODES), *([] if extra is None else [extra])]
    freq, shapes = freq[order], shapes.real[:, order] + noise * rng.standard_normal((beam.SENSORS, len(order)))
    if extra is not None:
        freq[-1] *= freq_ratio
        names.append(f"{names[extra]}b")
    places = np.linspace(0.0, beam.LENGTH, beam.SENSORS)
    sensors = tuple(Sensor(j + 1, "z", (float(x), 0.0, 0.0)) for j, x in enumerate(places))
    none = np.full(len(freq), np.nan)
    return calib.MeasuredModes(
        names=tuple(names), natural_freq=freq, damped_freq=freq, freq_std=0.002 * freq, damping_ratio=none,
        damping_std=none, sensors=sensors, shapes=shapes, shape_std=np.full(shapes.shape, noise), synthetic=True,
        source="beam",
    )  # fmt: skip


def compared(data):
    (found,) = calib.Problem(beam.model(), calib.ModalTest(data)).compare().by_test.values()
    return found


@pytest.mark.parametrize("extra", [0, 2, 4])
def test_a_mode_found_twice_is_checked_first(extra):
    found = compared(modes(extra))
    (one,) = found.found_twice
    assert (one.first, one.second) == (f"M{extra + 1}", f"M{extra + 1}b")
    assert one.apart == pytest.approx(0.006, abs=1e-4) and one.mac > 0.99
    assert found.answer.then.startswith("Check first") and f"M{extra + 1}b" in found.answer.then
    assert one.sentence in found.doubts and one.sentence in found.hints


@pytest.mark.medium
def test_modes_that_are_found_once_are_not_doubted():
    assert compared(modes(None)).found_twice == ()
    assert compared(modes(2, freq_ratio=1.05)).found_twice == ()  # as a small mass on a spring splits a mode


def test_sensors_that_tell_no_modes_apart_doubt_none():
    data = modes(2)
    few = calib.ModalTest(data, held_out=[f"{j + 1}z" for j in range(1, beam.SENSORS)])
    (found,) = calib.Problem(beam.model(), few).compare().by_test.values()
    assert found.found_twice == ()
