"""Thinned lines of FRFs: how well parameters are then known, and whether what is measured stays the same."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import calib
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.rules import RULES
from calib.measurement.thinning import resonances_of_many, thinned

N = 20
TRUE = {"k1": 1.02, "k2": 0.97, "c": 1.3}
AT = (3, 8, 14, 19)


@cache
def matrices():
    """K of both halves, C and M of masses in a row, by hand."""
    whole = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    whole[-1, -1] = 1
    first = np.zeros((N, N))
    for k in range(N // 2):
        b = np.eye(N)[k] - (np.eye(N)[k - 1] if k else 0)
        first += np.outer(b, b)
    return 1e6 * first, 1e6 * (whole - first), 20.0 * whole, 10.0 * np.eye(N)


def functions(freq, values, quantity="accelerance"):
    """Of `AT` under a force at the end, (n_freq, n_at, 1), and derivatives, (3, ...), by modal superposition."""
    first, second, c, m = matrices()
    out, slopes = [], []
    power = {"receptance": 0, "accelerance": 2}[quantity]
    for w in 2 * np.pi * freq:
        z = np.linalg.inv(values["k1"] * first + values["k2"] * second + 1j * w * values["c"] * c - w**2 * m)
        out.append((1j * w) ** power * z[list(AT), -1])
        each = (first, second, 1j * w * c)
        slopes.append([-((1j * w) ** power) * (z[list(AT)] @ one @ z[:, -1]) for one in each])
    return np.array(out)[:, :, None], np.moveaxis(np.array(slopes), 1, 0)[..., None]


def sensor(k):
    return calib.Sensor(k + 1, "x")


@cache
def measured(n=6001, seed=0):
    freq = np.linspace(0.5, 110.0, n)
    true, _ = functions(freq, TRUE)
    rng, std = np.random.default_rng(seed), 0.01 * np.abs(true) + 1e-4
    values = true + std * (rng.standard_normal(true.shape) + 1j * rng.standard_normal(true.shape))
    return MeasuredFRFs(freq, tuple(map(sensor, AT)), (sensor(N - 1),), "accelerance", values, std)


def known(frfs):
    """Standard deviations of the three parameters, and by how many of them a linear fit from the truth is off."""
    true, slopes = functions(frfs.freq, TRUE)
    rows = (slopes / frfs.std).reshape(3, -1)
    covariance = np.linalg.inv(np.real(rows.conj() @ rows.T))
    shift = covariance @ np.real(rows.conj() @ ((frfs.values - true) / frfs.std).ravel())
    return np.sqrt(np.diag(covariance)), shift


@pytest.mark.slow
def test_parameters_are_known_as_by_all_lines_and_nothing_is_biased():
    all_lines, few = measured(), thinned(measured())
    assert len(few.freq) < 700 and few.behind.sum() == all_lines.values.size
    (std, shift), (own, off) = known(all_lines), known(few)
    np.testing.assert_allclose(own, std, rtol=0.05)
    assert np.abs((off - shift) / std).max() < 1.0  # where means alone are 20 off
    true, _ = functions(few.freq, TRUE)
    errors = np.abs(few.values - true) / few.std / np.sqrt(2)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.05) and errors.max() < 4


@pytest.mark.medium
def test_claimed_and_assumed_standard_deviations_are_those_of_means():
    frfs = replace(measured(), accuracy=calib.FRFTest(measured(), accuracy="3 %").frfs.accuracy)
    few = thinned(frfs)
    one = np.flatnonzero(few.behind[:, 0, 0] >= 20)[0]
    claimed = 0.03 * np.abs(few.values[one]) / np.sqrt(few.behind[one])
    np.testing.assert_allclose(few.total_std[one], np.hypot(few.std[one], claimed))
    part = few.in_band(20.0, 40.0)
    assert part.behind.shape == part.values.shape


@pytest.mark.medium
def test_few_lines_stay_and_gaps_count_fewer():
    frfs = measured()
    assert thinned(frfs, most=len(frfs.freq)) is frfs
    values = frfs.values.copy()
    values[3000:3010, 1] = np.nan
    few = thinned(replace(frfs, values=values))
    assert few.behind[:, 1].sum() == few.behind[:, 0].sum() - 10
    true, _ = functions(few.freq, TRUE)
    errors = np.abs(few.values - true) / few.std / np.sqrt(2)
    assert np.sqrt(np.nanmean(errors**2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_resonance_beside_an_end_of_the_lines_keeps_its_lines():
    frfs, exact = measured(), functions(measured().freq, TRUE)[0]
    last = frfs.resonances()[-1]
    quiet = replace(frfs, values=exact + 0.01 * (frfs.values - exact), std=0.01 * frfs.std)
    few = thinned(quiet.in_band(1.0, last.freq + 0.4 * last.width), most=1000).in_band(last.freq - last.width, 200.0)
    errors = np.abs(few.values - functions(few.freq, TRUE)[0]) / few.std / np.sqrt(2)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.25)


def test_repeats_are_thinned_by_the_resonances_of_their_mean():
    frfs, rng = measured(1200), np.random.default_rng(5)
    noise = frfs.std * rng.standard_normal(frfs.values.shape)
    repeats = [replace(frfs, values=frfs.values + sign * noise) for sign in (-1, 1)]
    few, *each = (thinned(one, 1000, frfs) for one in (frfs, *repeats))
    assert len(few.freq) < 700
    np.testing.assert_array_equal(each[0].freq, few.freq)
    np.testing.assert_allclose((each[0].values + each[1].values) / 2, few.values, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("std_known", [True, False])
def test_peaks_of_noise_are_no_resonances(std_known):
    """Noise of a few repeats has a standard deviation of its own on each line, much too small on some."""
    frfs, rng = measured(8000), np.random.default_rng(6)
    parts = 3 * np.median(np.abs(frfs.values)) * rng.standard_normal((5, 2, *frfs.values.shape))
    std = np.sqrt(np.mean(np.var(parts, axis=0, ddof=1), axis=0) / 5)
    loud = frfs.values + (parts[:, 0] + 1j * parts[:, 1]).mean(axis=0)
    few = thinned(replace(frfs, values=loud, std=std if std_known else np.full(std.shape, np.nan)))
    assert len(few.freq) < 1000
    peaks = [one.freq for one in resonances_of_many(replace(frfs, values=loud, std=std))]
    assert peaks and all(min(abs(peak - one.freq) for one in frfs.resonances()) < 1.0 for peak in peaks)


@pytest.mark.slow
def test_a_test_with_many_lines_compares_few_of_them():
    first, second, c, m = matrices()
    dofs = [(k + 1, "x") for k in range(N)]
    parameters = [calib.Parameter(name, 1.0, 0.5, 2.0, "-") for name in ("k1", "k2", "c")]
    model = calib.StructuralModel.from_matrices({"k1": first, "k2": second}, m, {"c": c}, dofs=dofs,
                                                parameters=parameters)  # fmt: skip
    test = calib.FRFTest(measured(), held_out_bands=[(60.0, 65.0)])
    assert len(test.measured.freq) == 6001 and len(test.used.freq) < 700 < RULES.lines_most
    assert any("6001" in note or "lines count as" in note for note in test.used.notes)
    fit = calib.Problem(model, test).calibrate(starts=1)
    std, _ = known(test.used)
    for value, wanted, sure in zip((fit.values[name] for name in TRUE), TRUE.values(), std, strict=True):
        assert value == pytest.approx(wanted, abs=5 * sure)
