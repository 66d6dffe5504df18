"""Modes from ambient records and their standard deviations against eigenvalues, and what is refused."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.measurement.mac import mac
from calib.measurement.modal import MeasuredModes
from calib.modal_analysis.ambient import modes_from_records
from calib.modal_analysis.identification import Identification
from calib.modal_analysis.setups import merged_setups
from calib.modal_analysis.subspace import pole_distance
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
AMBIENT = module_of(ROOT / "tests/template/ambient_chain.py")
CHAIN = AMBIENT.chain()
FREQ, SHAPES = AMBIENT.modes(CHAIN)


@cache
def long_record():
    return modes_from_records([AMBIENT.record(CHAIN, 60_000, 1)])


def require_close(found, freq, shapes, damping=0.2, agreement=0.99):
    np.testing.assert_allclose(found.modes.natural_freq, freq, rtol=5e-3)
    np.testing.assert_allclose(found.modes.damping_ratio, AMBIENT.DAMPING, rtol=damping)
    assert np.diag(mac(found.modes.shapes, shapes)).min() > agreement


@pytest.mark.slow
def test_a_long_record_gives_the_eigenvalues_and_eigenvectors():
    found = long_record()
    assert found.of == "records" and found.std_from == "parts" and found.modes.n_repeats == 1
    require_close(found, FREQ, SHAPES)
    assert np.abs(found.modes.shapes).max(axis=0) == pytest.approx(1.0)
    # limits are wide: 2.4 standard deviations are exceeded once in sixty
    errors = (found.modes.natural_freq - FREQ) / found.modes.freq_std
    assert np.all(found.modes.freq_std < 5e-3 * FREQ) and np.abs(errors).max() < 4
    np.testing.assert_allclose(found.curves["synthesised"], found.curves["measured"], rtol=0.1)
    named = found.poles[found.poles["mode"] != ""]
    assert set(named["mode"]) == {"1", "2", "3", "4"} and named["stable"].all()
    assert not named.duplicated(["mode", "order"]).any()


@pytest.mark.slow
def test_several_records_have_the_standard_deviations_of_their_scatter():
    records = [AMBIENT.record(CHAIN, 15_000, seed) for seed in (11, 12, 13, 14)]
    found = modes_from_records(records)
    assert found.std_from == "repeats" and found.modes.n_repeats == 4 and "4 records" in found.modes.notes[0]
    require_close(found, FREQ, SHAPES)
    assert np.all(found.modes.freq_std < 5e-3 * FREQ) and np.all(found.modes.freq_std > 0)
    assert np.all(found.modes.shape_std.max(axis=0) > 0)


@pytest.mark.medium
def test_the_band_and_a_faster_rate_leave_the_modes_as_they_are():
    low = modes_from_records([AMBIENT.record(CHAIN, 30_000, seed) for seed in (1, 2)], (1.0, 12.5))
    np.testing.assert_allclose(low.modes.natural_freq, FREQ[:2], rtol=5e-3)
    # enhanced frequency domain decomposition (pyOMA2 1.4.3's EFDD) doubles the damping of a clean mode
    np.testing.assert_allclose(low.modes.damping_ratio, AMBIENT.DAMPING, rtol=0.3)
    assert low.poles["freq"].between(1.0, 12.5).all() and low.curves["freq"].max() <= 12.5


@pytest.mark.slow
def test_a_mode_too_slow_for_the_rate_is_refused_and_a_band_finds_it():
    slow = AMBIENT.chain(4000.0 / 16)  # a quarter of the frequencies: the first lies below a fortieth of the rate
    records = [AMBIENT.record(slow, 40_000, seed) for seed in (1, 2)]
    fit = modes_from_records(records).fit
    assert fit["refused"].iloc[0].endswith("closer above it") and fit["freq"].iloc[0] < AMBIENT.RATE / 40
    np.testing.assert_allclose(modes_from_records(records, (0.3, 6.0)).modes.natural_freq, FREQ / 4, rtol=1e-2)


def part(record, sensors, gain=1.0):
    """Some sensors of a record, in another unit."""
    own = tuple(record.sensors[k] for k in sensors)
    return replace(record, values=gain * record.values[:, sensors], sensors=own, source=f"{record.source} of {sensors}")


@pytest.mark.slow
def test_set_ups_with_a_common_sensor_have_one_shape():
    setups = [part(AMBIENT.record(CHAIN, 20_000, 21), [0, 1, 3]), part(AMBIENT.record(CHAIN, 20_000, 22), [3, 2], 2.0)]
    found = modes_from_records(setups)
    assert [sensor.node for sensor in found.modes.sensors] == [1, 2, 4, 3]
    require_close(found, FREQ, SHAPES[[0, 1, 3, 2]], agreement=0.995)
    assert np.abs((found.modes.natural_freq - FREQ) / found.modes.freq_std).max() < 4
    largest = np.argmax(np.abs(found.modes.shapes), axis=0)
    scale = found.modes.shapes[largest, range(4)].real / SHAPES[[0, 1, 3, 2]][largest, range(4)]
    true = SHAPES[[0, 1, 3, 2]] * scale
    assert np.abs((found.modes.shapes.real - true) / found.modes.shape_std)[found.modes.shape_std > 1e-3].max() < 4
    named = found.poles[found.poles["mode"] != ""]
    assert set(named["mode"]) == {"1", "2", "3", "4"} and any("4x" in note for note in found.modes.notes)


def identified(name, sensors, freq, rows, std=0.01):
    """A set-up that was identified without errors."""
    n = len(freq)
    modes = MeasuredModes(
        tuple(str(k + 1) for k in range(n)), freq, freq, 1e-3 * freq, np.full(n, 0.01), np.full(n, 1e-3),
        tuple(AMBIENT.Sensor(s + 1, "x") for s in sensors), rows, np.full(rows.shape, std), source=name,
    )  # fmt: skip
    fit = pd.DataFrame({
        "mode": modes.names, "freq": freq, "freq_std": 1e-3 * freq, "damping": 0.01, "damping_std": 1e-3, "orders": 20,
        "frac": 0.99, "residual_std": 1.0, "excess": 0.0, "rank_one": 1.0, "mpc": 1.0, "mpd": 0.0, "refused": "",
        "note": "",
    })  # fmt: skip
    poles = pd.DataFrame({"order": 4, "freq": freq, "damping": 0.01, "stable": True, "mode": modes.names})
    curves = pd.DataFrame({"freq": [1.0, 2.0], "measured": 1.0, "synthesised": 1.0})
    return Identification(modes, fit, poles, curves, (), "parts", "records")


def test_shapes_of_set_ups_are_scaled_by_least_squares_over_the_common_sensors():
    rows = SHAPES[:, :3]
    one = identified("one", [0, 1, 3], FREQ[:3], rows[[0, 1, 3]])
    two = identified("two", [3, 2], FREQ[:3] * 1.002, rows[[3, 2]] * np.array([2.0, -0.5, 1j]))
    found = merged_setups([one, two])
    np.testing.assert_allclose(np.diag(mac(found.modes.shapes, rows[[0, 1, 3, 2]])), 1.0, atol=1e-9)
    np.testing.assert_allclose(found.modes.natural_freq, FREQ[:3] * 1.001, rtol=1e-5)
    # set-ups that differ by 1.4 of their standard deviations say so in that of the mean
    np.testing.assert_allclose(found.modes.freq_std, 1e-3 * FREQ[:3], rtol=2e-3)
    sure = identified("sure", [3, 2], FREQ[:3], rows[[3, 2]], std=1e-4)
    assert np.all(merged_setups([one, sure]).modes.shape_std[3] < found.modes.shape_std[3])


def test_a_mode_that_a_set_up_lacks_or_whose_common_sensor_rests_is_refused_and_can_be_accepted():
    rows = SHAPES[:, :3]
    still = rows[[3, 2]].copy()
    still[0, 1] = 1e-3
    one = identified("one", [0, 1, 3], FREQ[:3], rows[[0, 1, 3]])
    found = merged_setups([one, identified("two", [3, 2], FREQ[:2], still[:, :2])])
    assert found.modes.n_modes == 1 and [bool(own) for own in found.fit["refused"]] == [False, True, True]
    assert "two" in found.fit["refused"].iloc[2] and found.verdict
    kept = merged_setups([one, identified("two", [3, 2], FREQ[:2], still[:, :2])], accept=[FREQ[2]])
    assert kept.modes.n_modes == 2 and np.isnan(kept.modes.shapes[3, 1]) and "accepted" in kept.fit["note"].iloc[2]
    with pytest.raises(InputError, match="in common"):
        merged_setups([one, identified("far", [2], FREQ[:3], rows[[2]])])


@pytest.mark.slow
def test_the_unit_of_one_sensor_scales_its_entry_of_the_shapes_alone():
    records = [AMBIENT.record(CHAIN, 20_000, seed) for seed in (3, 4)]
    one = modes_from_records(records)
    other = modes_from_records([replace(own, values=own.values * [1, 1000, 1, 1]) for own in records])
    np.testing.assert_allclose(other.modes.natural_freq, one.modes.natural_freq, rtol=1e-9)
    ratio = other.modes.shapes[1] / other.modes.shapes[0] / (one.modes.shapes[1] / one.modes.shapes[0])
    np.testing.assert_allclose(ratio, 1000, rtol=1e-6)


def test_a_record_that_is_too_short_is_refused():
    with pytest.raises(InputError, match="too few") as fault:
        modes_from_records([AMBIENT.record(CHAIN, 3000, 1)])
    assert fault.value.remedy


@pytest.mark.medium
def test_noise_alone_has_no_mode():
    rng, like = np.random.default_rng(5), AMBIENT.record(CHAIN, 1000, 1)
    with pytest.raises(InputError):
        modes_from_records([replace(like, values=rng.standard_normal((20_000, 4))) for _ in range(2)])


@pytest.mark.parametrize("band", [(5.0, 5.0), (12.0, 3.0), (1.0, 40.0)])
def test_a_band_outside_the_record_is_refused(band):
    with pytest.raises(InputError, match="band"):
        modes_from_records([AMBIENT.record(CHAIN, 10_000, 1)], band)


def test_without_the_package_one_sentence_says_what_to_install(monkeypatch):
    for name in [own for own in sys.modules if own.split(".")[0] == "pyoma2"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyoma2", None)
    with pytest.raises(InputError, match="not installed") as fault:
        modes_from_records([AMBIENT.record(CHAIN, 10_000, 1)])
    assert "calib[ambient]" in fault.value.remedy


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 8))
def test_long_records_of_other_seeds(seed):
    require_close(modes_from_records([AMBIENT.record(CHAIN, 60_000, seed)]), FREQ, SHAPES)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_two_close_modes_are_told_apart(seed):
    stiffness = AMBIENT.close_pair()
    freq, shapes = AMBIENT.modes(stiffness)
    assert freq[1] / freq[0] - 1 < 0.021
    require_close(modes_from_records([AMBIENT.record(stiffness, 60_000, seed)]), freq, shapes)


@pytest.mark.slow
def test_claimed_standard_deviations_are_the_scatter_over_records():
    found = [modes_from_records([AMBIENT.record(CHAIN, 60_000, seed)]).modes for seed in range(100, 120)]
    assert all(one.n_modes == 4 for one in found)
    for value, std, true in (("natural_freq", "freq_std", FREQ), ("damping_ratio", "damping_std", AMBIENT.DAMPING)):
        errors = np.array([getattr(one, value) - true for one in found])
        claimed = np.median([getattr(one, std) for one in found], axis=0)
        ratio = np.sqrt(np.mean(errors**2, axis=0)) / claimed
        # the scatter of 20 records is known to 16 %; what is claimed errs on the large side
        assert np.all(ratio < 1.4) and np.all(ratio > 0.35), ratio


def test_distances_of_poles_are_symmetric_where_some_shapes_are_real():
    poles = np.array([-1 + 20j, -1 + 21j, -2 + 40j])
    shapes = np.array([[1.0, 0.5], [1.0, 0.5 + 0.4j], [1.0, -1.0j]])
    distance = pole_distance(poles, shapes)
    np.testing.assert_array_equal(distance, distance.T)
    unit = shapes / np.linalg.norm(shapes, axis=1, keepdims=True)
    assert distance[0, 1] == pytest.approx(
        abs(poles[0] - poles[1]) / abs(poles[1]) + 1 - abs(unit[0].conj() @ unit[1]) ** 2
    )
