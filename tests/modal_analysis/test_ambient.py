"""Modes from ambient records and their standard deviations against eigenvalues, and what is refused."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.mac import mac
from calib.modal_analysis.ambient import modes_from_records
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


def test_the_band_and_a_faster_rate_leave_the_modes_as_they_are():
    low = modes_from_records([AMBIENT.record(CHAIN, 30_000, seed) for seed in (1, 2)], (1.0, 12.5))
    np.testing.assert_allclose(low.modes.natural_freq, FREQ[:2], rtol=5e-3)
    assert low.poles["freq"].between(1.0, 12.5).all() and low.curves["freq"].max() <= 12.5


@pytest.mark.slow
def test_a_mode_too_slow_for_the_rate_is_refused_and_a_band_finds_it():
    slow = AMBIENT.chain(4000.0 / 16)  # a quarter of the frequencies: the first lies below a fortieth of the rate
    records = [AMBIENT.record(slow, 40_000, seed) for seed in (1, 2)]
    fit = modes_from_records(records).fit
    assert fit["refused"].iloc[0].endswith("closer above it") and fit["freq"].iloc[0] < AMBIENT.RATE / 40
    np.testing.assert_allclose(modes_from_records(records, (0.3, 6.0)).modes.natural_freq, FREQ / 4, rtol=1e-2)


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
