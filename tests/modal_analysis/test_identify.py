"""Identified modes and their standard deviations against eigenvalues, and what is refused."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import calib
from calib.errors.errors import InputError
from calib.measurement.frf_repeats import combine_frfs
from calib.measurement.mac import mac
from calib.modal_analysis.identify import modes_from_frfs
from calib.study.loading import module_of
from models.solar_panel import MASTERS, solar_panel

ROOT = Path(__file__).resolve().parents[2]
CHAIN = module_of(ROOT / "tests/template/frf_chain.py")
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
MEASURED = ROOT / "studies/solar_panel/measured"
TRUTH = json.loads((ROOT / "tests/truth/solar_panel.json").read_text("utf-8"))

POLES, SHAPES = WORLDS.roots(*CHAIN.by_hand(CHAIN.TRUE))
FREQ, DAMPING = WORLDS.freq_and_damping(POLES[:3])  # the fourth mode lies above the lines


@cache
def chain(seed, count):
    """Mean and repeats of the chain with noise."""
    return WORLDS.with_mean(CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE), seed, count))


def in_std(found):
    """Errors of natural frequencies and damping ratios in their standard deviations, (2, n_modes)."""
    return np.array([(found.natural_freq - FREQ) / found.freq_std, (found.damping_ratio - DAMPING) / found.damping_std])


# -- the chain ---------------------------------------------------------------------------------------------------------


def test_without_noise_modes_are_the_eigenvalues_and_eigenvectors():
    frfs = combine_frfs(CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE), None, 1))
    found = modes_from_frfs(frfs)
    assert found.modes.n_modes == 3 and found.missed == () and found.modes.names == ("1", "2", "3")
    np.testing.assert_allclose(found.modes.natural_freq, FREQ, rtol=1e-8)
    np.testing.assert_allclose(found.modes.damping_ratio, DAMPING, rtol=1e-6)
    rows = SHAPES[np.array(CHAIN.RESPONSES) - 1][:, :3]
    np.testing.assert_allclose(np.diag(mac(found.modes.shapes, rows)), 1.0, atol=1e-8)
    assert np.abs(found.modes.shapes).max(axis=0) == pytest.approx(1.0)
    np.testing.assert_allclose(found.fit["rank_one"], 1.0, atol=1e-8)
    np.testing.assert_allclose(found.curves["synthesised"], found.curves["measured"], rtol=1e-8)


@pytest.mark.slow
def test_errors_are_as_large_as_the_standard_deviations_over_the_repeats_say():
    errors = np.stack([in_std(modes_from_frfs(*chain(seed, 5)).modes) for seed in range(4)])
    # Student's t with four degrees of freedom exceeds 8.6 once in a thousand
    assert np.abs(errors).max() < 8.6
    assert 0.3 < np.median(np.abs(errors)) < 1.5  # 0.74 is expected


@pytest.mark.slow
def test_many_lines_are_thinned_in_all_repeats_alike():
    freq, told = np.linspace(CHAIN.FREQ[0], CHAIN.FREQ[-1], 4000), []
    every = CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE, freq=freq), 3, 5)
    mean, repeats = WORLDS.with_mean([replace(one, freq=freq) for one in every])
    found = modes_from_frfs(mean, repeats, progress=lambda stage, done, total: told.append((done, total)))
    assert len(found.curves) < 1000 and found.missed == () and told == [(k, 6) for k in range(6)]
    errors = in_std(found.modes)
    assert np.abs(errors).max() < 8.6 and np.median(np.abs(errors)) < 1.5
    few = modes_from_frfs(*chain(3, 5)).modes
    assert np.all(found.modes.freq_std < few.freq_std)  # as many more lines tell more


@pytest.mark.medium
def test_two_repeats_give_standard_deviations_and_more_noise_larger_ones():
    found = modes_from_frfs(*chain(7, 2))
    assert found.std_from == "repeats" and found.modes.n_repeats == 2
    assert np.all(found.modes.freq_std > 0) and np.all(found.modes.shape_std >= 0)
    assert "2 repeats" in found.modes.notes[0]
    noisier = WORLDS.with_mean(CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE), 7, 2, share=0.02, floor=4e-3))
    assert np.all(modes_from_frfs(*noisier).modes.damping_std > found.modes.damping_std)


@pytest.mark.medium
def test_one_file_has_standard_deviations_of_its_residuals_and_says_so():
    errors = []
    for seed in range(3):
        found = modes_from_frfs(chain(seed, 4)[0])
        assert found.std_from == "functions" and "not from repeated tests" in found.modes.notes[0]
        assert found.modes.n_repeats == 1
        errors.append(in_std(found.modes))
    assert 0.2 < np.median(np.abs(errors)) < 1.5 and np.abs(errors).max() < 4.5  # 0.67 is expected


@pytest.mark.slow
def test_the_order_of_functions_in_a_repeat_does_not_matter():
    mean, repeats = chain(5, 3)
    back = np.s_[:, ::-1, ::-1]
    turned = replace(
        repeats[1], responses=repeats[1].responses[::-1], references=repeats[1].references[::-1],
        values=repeats[1].values[back], std=repeats[1].std[back],
    )  # fmt: skip
    one, other = (modes_from_frfs(mean, own).modes for own in (repeats, [repeats[0], turned, repeats[2]]))
    assert one.fingerprint == other.fingerprint


def test_a_roving_hammer_gives_the_shape_at_its_places():
    responses, references = (4,), (1, 2, 3, 4)
    true = CHAIN.truth(CHAIN.TRUE, responses=responses, references=references)
    repeats = CHAIN.repeats_of(true, None, 1, responses=responses, references=references)
    found = modes_from_frfs(combine_frfs(repeats)).modes
    assert [sensor.node for sensor in found.sensors] == [1, 2, 3, 4]
    np.testing.assert_allclose(np.diag(mac(found.shapes, SHAPES[:, :3])), 1.0, atol=1e-8)


@pytest.mark.medium
@pytest.mark.parametrize("spacing", [1 / 3, 1 / 7])
def test_lines_that_a_file_rounds_to_six_digits_are_lines(spacing):
    """Abscissas of datasets 58 that pyuff 2.5.8 writes with spacing 0, and tables of most analysers, are rounded."""
    freq = spacing * np.arange(7, int(40 / spacing))
    rounded = np.array([float(f"{f:.5e}") for f in freq])
    assert np.ptp(np.diff(rounded)) > 1e-6
    (one,) = CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE, freq=freq), None, 1)
    found = modes_from_frfs(combine_frfs([replace(one, freq=rounded)])).modes
    np.testing.assert_allclose(found.natural_freq, FREQ, rtol=1e-4)
    np.testing.assert_allclose(found.damping_ratio, DAMPING, rtol=5e-3)


def test_a_resonance_that_no_stable_pole_describes_is_named():
    frfs = combine_frfs(CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE), None, 1))
    values = frfs.values.copy()
    values[32] *= 4.0  # hum of the mains: one line, between two modes
    found = modes_from_frfs(replace(frfs, values=values))
    assert found.missed == pytest.approx((frfs.freq[32],))
    assert f"{frfs.freq[32]:.4g} Hz" in found.verdict


# -- heavy damping -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_heavily_damped_pair_is_identified_where_noise_allows():
    found = modes_from_frfs(*WORLDS.pair_test(0.1, 0.01))
    freq, damping = WORLDS.freq_and_damping(WORLDS.roots(*WORLDS.heavy_pair(0.1))[0])
    np.testing.assert_allclose(found.modes.natural_freq, freq, rtol=1e-3)
    np.testing.assert_allclose(found.modes.damping_ratio, damping, rtol=1e-2)


@pytest.mark.slow
def test_one_pole_for_a_heavily_damped_pair_is_refused_with_the_advice_to_fit_the_frfs():
    with pytest.raises(InputError) as fault:
        modes_from_frfs(*WORLDS.pair_test(0.03, 0.1))
    assert 'kind = "frf"' in str(fault.value)


@pytest.mark.slow
def test_modes_beside_a_refused_pair_are_kept():
    # a lightly damped mode far above, and noise under which the pair is one stable pole
    k, c, m = WORLDS.heavy_pair(0.03)
    k[2, 2], c[2, 2] = 8 * WORLDS.CENTRE, 0.02 * np.sqrt(8 * WORLDS.CENTRE)
    freq = np.linspace(5.0, 50.0, 451)
    whole = WORLDS.receptances(k, c, m, freq)[:, :, 1:] * -((2 * np.pi * freq) ** 2)[:, None, None]
    found = modes_from_frfs(*WORLDS.with_mean(WORLDS.noisy(whole, freq, 0.1, 1, 4)))
    refused = found.fit[found.fit["refused"] != ""]
    assert len(refused) == 1 and 13.0 < refused["freq"].iloc[0] < 15.5
    upper = WORLDS.freq_and_damping(WORLDS.roots(k, c, m)[0][2:])[0]
    np.testing.assert_allclose(found.modes.natural_freq, upper, rtol=1e-3)
    assert 'kind = "frf"' in found.verdict


# -- the solar array ---------------------------------------------------------------------------------------------------


@cache
def panel_truth():
    """Natural frequencies, Hz, and shapes at the sensors of the twin that carries its accelerometers."""
    twin = solar_panel(2)
    stiffness, _, mass = twin.matrices(TRUTH["parameters"])
    points = solar_panel().mesh.points
    sensors = [calib.Sensor(node, "z", tuple(points[node - 1])) for node in MASTERS]
    rows = np.array([twin.locator.row(s.point, k, s.on)[0] for s in sensors for k in range(3)])
    carried = mass.toarray() + TRUTH["accelerometer"] * rows.T @ rows
    squares, vectors = scipy.linalg.eigh(stiffness.toarray(), carried, subset_by_index=[0, 7])
    return np.sqrt(squares) / (2 * np.pi), np.asarray(twin.sensor_rows(sensors) @ vectors)


@pytest.mark.slow
def test_modes_of_the_solar_array_are_those_of_the_structure_that_was_measured():
    def read(files):
        return calib.read_frfs(files, sensors=MEASURED / "sensors.csv", synthetic=True)

    files = sorted(MEASURED.glob("repeat_*.uff"))
    found = modes_from_frfs(read(files), [read(one) for one in files])
    freq, shapes = panel_truth()
    # the first lies between the first two lines, the eighth above the last one
    assert found.modes.n_modes == 6 and found.missed == ()
    loss = TRUTH["loss_factor"]
    np.testing.assert_allclose(found.modes.natural_freq, freq[1:7], rtol=5e-5)
    np.testing.assert_allclose(found.modes.damping_ratio, loss / 2, rtol=0.02)
    # gains of the accelerometers are 1 % off (standard deviation), phases half a degree
    assert np.all(np.diag(mac(found.modes.shapes, shapes[:, 1:7])) > 0.999)
    assert found.modes.sensors[0].point is not None and found.modes.synthetic
