"""Hammer records against the modes of a beam by finite differences: FRFs, modes, and hits that do not count."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff
from typer.testing import CliRunner

import calib
from calib.command.cli import app
from calib.errors.errors import InputError
from calib.measurement.doubts import doubts_of
from calib.measurement.files.read_frf import FRFReading, frfs_and_repeats
from calib.measurement.files.read_records import hold_hits, hold_records, read_records
from calib.measurement.mac import mac
from calib.modal_analysis.identify import modes_from_frfs
from calib.study.loading import module_of
from calib.study.study_file import StudyFile

ROOT = Path(__file__).resolve().parents[2]
BEAM = module_of(ROOT / "tests/template/hammer_beam.py")
AMBIENT = module_of(ROOT / "tests/template/ambient_chain.py")
WITHIN = slice(0, 3)
"""Modes below the highest line."""


def accelerances(freq, window_rate=0.0):
    """Of the places under the hammer, (n_freq, n_places), by modal superposition at ``i omega + rate``."""
    s = (2j * np.pi * freq + window_rate)[:, None]
    out = np.zeros((len(freq), len(BEAM.PLACES)), complex)
    for f, ratio, shape in zip(BEAM.FREQ, BEAM.RATIOS, BEAM.SHAPES.T, strict=True):
        omega = 2 * np.pi * f
        at = shape[np.array(BEAM.PLACES) - 1] * shape[BEAM.HIT_AT - 1]
        out += s**2 * at / (s**2 + 2 * ratio * omega * s + omega**2)
    return out


def off(frfs):
    """Distance of FRFs from the true ones over their largest value."""
    true = accelerances(frfs.freq, frfs.window_rate)
    order = [BEAM.PLACES.index(sensor.node) for sensor in frfs.responses]
    return np.abs(frfs.values[:, :, 0] - true[:, order]).max() / np.abs(true).max()


def test_hits_give_the_accelerances_of_the_beam(tmp_path):
    frfs = calib.read_frfs(BEAM.session(tmp_path, 2, noise=0.0), synthetic=True)
    assert frfs.quantity == "accelerance" and frfs.n_repeats == 2
    assert [one.name for one in frfs.functions] == ["10z/30z", "20z/30z", "30z/30z", "40z/30z"]
    assert frfs.freq[-1] <= BEAM.RATE / 2.56 and off(frfs) < 0.01
    # 11 Hz at 1.2 % has 19 % left after 2 s: cut off without a window, FRFs would be off by as much at the peak
    assert frfs.window_rate > 0.5
    assert off(replace(frfs, window_rate=0.0)) > 0.05


def test_units_signs_and_a_statement_of_the_motion_alone(tmp_path):
    table = BEAM.record([(0.05, 100.0)], noise=0.0)
    one = calib.read_frfs(BEAM.write(tmp_path / "si.csv", table))
    grams = table / np.array([1.0, 1e3, *[9.80665] * 4])
    grams[:, 1:3] *= -1
    path = BEAM.write(tmp_path / "other.csv", grams, "g/kN")
    path.write_text(path.read_text().replace("force 30z,10z", "Force_30-z,10-z"))
    np.testing.assert_allclose(calib.read_frfs(path).values, one.values, atol=1e-5 * np.abs(one.values).max())
    path = BEAM.write(tmp_path / "columns.csv", grams, "")
    rest = ",".join(f"Point{place}:+Z (g)" for place in BEAM.PLACES[1:])
    text = path.read_text().split("\n", 1)[1]
    path.write_text(f"Time (s),Hammer 30-Z (kN),Acc 10-Z (g),{rest}\n{text}")
    found = calib.read_frfs(path)
    assert found.quantity == "accelerance" and not any("assumed" in note for note in found.notes)
    np.testing.assert_allclose(found.values, one.values, atol=1e-5 * np.abs(one.values).max())
    path.write_text(f"time,Force 30-z (kN),10-z,{rest.replace(' (g)', '')}\n{text}")
    np.testing.assert_allclose(calib.read_frfs(path, unit="g").values, found.values, rtol=1e-12)
    path = BEAM.write(tmp_path / "motion.csv", table, "m/s2")
    stated = calib.read_frfs(path)
    np.testing.assert_array_equal(stated.values, one.values)
    assert any("N assumed" in note for note in stated.notes)
    path = BEAM.write(tmp_path / "none.csv", table, "")
    np.testing.assert_array_equal(calib.read_frfs(path, unit="(m/s2)/N").values, one.values)
    np.testing.assert_array_equal(calib.read_frfs(path, quantity="accelerance").values, one.values)


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_the_mean_of_the_repeats_is_the_average_and_without_one_that_of_the_others(tmp_path, estimator):
    base, rng, files = BEAM.record([(0.05, 1.0)], noise=0.0, window=0.2), np.random.default_rng(0), []
    for k in range(3):
        table = base * np.array([1.0, *[80.0 + 20 * k] * 5])
        table[:, 2:] += 0.01 * np.abs(table[:, 2:]).max(axis=0) * rng.standard_normal(table[:, 2:].shape)
        files.append(BEAM.write(tmp_path / f"{k}.csv", table))
    whole, repeats = frfs_and_repeats(files, FRFReading(estimator=estimator))
    keys = f'files = ["0.csv", "1.csv", "2.csv"]\nkind = "frf"\nestimator = "{estimator}"\n'
    (tmp_path / "study.toml").write_text(f'title = "Beam"\nmodel = "model.py:beam"\n[measurement]\n{keys}')
    np.testing.assert_array_equal(StudyFile.read(tmp_path).measured_data().values, whole.values)
    every = np.array([one.values for one in repeats])
    np.testing.assert_allclose(every.mean(axis=0), whole.values, rtol=1e-9)
    first, last = (frfs_and_repeats(own, FRFReading(estimator=estimator))[0].values for own in (files[1:], files[:2]))
    change = every[1:].mean(axis=0) - every[:2].mean(axis=0)
    np.testing.assert_allclose(change, first - last, atol=1e-12)
    assert np.abs(change).max() > 1e-3 * np.abs(whole.values).max()


@pytest.mark.medium
def test_noise_of_the_responses_biases_h2_and_noise_of_the_force_h1(tmp_path):
    rng = np.random.default_rng(1)
    files = {"force": [], "moved": []}
    clean = BEAM.record([(0.05, 100.0)], noise=0.0)
    for k in range(12):
        for kind, column in (("force", 1), ("moved", slice(2, None))):
            table, at = clean.copy(), np.abs(clean[:, 1]) > 1
            noise = rng.standard_normal(table.shape)
            size = np.abs(clean).max(axis=0) * (0.2 if kind == "force" else 0.02)
            table[:, column] += (noise * size * (at[:, None] if kind == "force" else 1.0))[:, column]
            files[kind].append(BEAM.write(tmp_path / f"{kind}_{k}.csv", table))

    def gain(kind, estimator):
        found = calib.read_frfs(files[kind], estimator=estimator)
        high = found.freq > 20
        true = accelerances(found.freq, found.window_rate)[high]
        return float(np.median(np.abs(found.values[high, :, 0]) / np.abs(true)))

    assert gain("moved", "H1") == pytest.approx(1.0, abs=0.01) and gain("moved", "H2") > 1.02
    assert gain("force", "H2") == pytest.approx(1.0, abs=0.03) and gain("force", "H1") < 0.95
    assert gain("moved", "H1") < gain("moved", "Hv") < gain("moved", "H2")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "window"), [(1, None), (2, None), (1, 0.25), (3, 0.4)])
def test_modes_have_the_beams_frequencies_and_damping_within_their_standard_deviations(tmp_path, seed, window):
    files = BEAM.session(tmp_path, 5, seed, window=window)
    found = modes_from_frfs(*frfs_and_repeats(files, FRFReading(exponential_window=window, synthetic=True))).modes
    assert found.n_modes == 3 and found.n_repeats == 5
    # Student's t with four degrees of freedom exceeds 7.2 once in five hundred
    assert np.abs((found.natural_freq - BEAM.FREQ[WITHIN]) / found.freq_std).max() < 7.2
    assert np.abs((found.damping_ratio - BEAM.RATIOS[WITHIN]) / found.damping_std).max() < 7.2
    np.testing.assert_allclose(found.natural_freq, BEAM.FREQ[WITHIN], rtol=5e-4)
    np.testing.assert_allclose(found.damping_ratio, BEAM.RATIOS[WITHIN], rtol=0.03)
    true = BEAM.SHAPES[np.array([sensor.node for sensor in found.sensors]) - 1][:, WITHIN]
    np.testing.assert_allclose(np.diag(mac(found.shapes, true)), 1.0, atol=1e-3)


@pytest.mark.medium
def test_a_window_that_is_not_stated_is_taken_for_damping_and_stated_for_frfs_taken_off(tmp_path):
    files = BEAM.session(tmp_path, 1, window=0.25)
    frfs = calib.read_frfs(files)
    assert frfs.window_rate == 0  # responses have decayed, by the window
    found = modes_from_frfs(frfs).modes
    with_window = BEAM.RATIOS[WITHIN] + 4 / (2 * np.pi * BEAM.FREQ[WITHIN])
    np.testing.assert_allclose(found.damping_ratio, with_window, rtol=0.01)
    stated = modes_from_frfs(replace(frfs, window_rate=4.0))
    np.testing.assert_allclose(stated.modes.damping_ratio, BEAM.RATIOS[WITHIN], rtol=0.01)
    np.testing.assert_allclose(stated.modes.natural_freq, BEAM.FREQ[WITHIN], rtol=3e-4)
    assert any("0.25 s" in note for note in stated.modes.notes)
    named = stated.poles[stated.poles["mode"] == "1"]
    assert named["damping"].median() == pytest.approx(BEAM.RATIOS[0], rel=0.05)
    with pytest.raises(InputError, match="damping of the exponential window is all"):
        modes_from_frfs(replace(frfs, window_rate=400.0))


def test_double_hits_and_overloads_are_told_and_do_not_count(tmp_path):
    files = BEAM.session(tmp_path, 3)
    clean = calib.read_frfs(files)
    double = BEAM.write(tmp_path / "double.csv", BEAM.record([(0.05, 100.0), (0.11, 40.0)], 7))
    over = BEAM.write(tmp_path / "over.csv", BEAM.record([(0.05, 100.0)], 8, limit=0.7))
    found = calib.read_frfs([*files, double, over])
    assert found.n_repeats == 3
    np.testing.assert_array_equal(found.values, clean.values)
    told = [one for one in doubts_of(found) if "left out" in one]
    assert len(told) == 2 and "double.csv" in told[0] and "0.06" in told[0] and "over.csv" in told[1]
    with pytest.raises(InputError, match="none of its 2 hits counts"):
        calib.read_frfs([double, over])


def test_a_long_record_is_cut_at_its_hits(tmp_path):
    hits = [(0.5, 100.0), (2.6, 80.0), (4.8, 120.0), (4.9, 30.0), (7.1, 90.0)]
    path = BEAM.write(tmp_path / "session.csv", BEAM.record(hits, samples=int(9.2 * BEAM.RATE), noise=0.0))
    found = calib.read_frfs(path)
    assert found.n_repeats == 3 and off(found) < 0.05
    assert any("4.8" in one and "double" in one for one in doubts_of(found))
    short = BEAM.write(tmp_path / "short.csv", BEAM.record(hits[:3], samples=int(5.2 * BEAM.RATE), noise=0.0))
    assert calib.read_frfs(short).n_repeats == 2  # the record ends 0.4 s after the last hit


def test_a_rounded_record_is_no_overload(tmp_path):
    table = BEAM.record([(0.05, 100.0)])
    table[:, 1:] = np.round(table[:, 1:] / np.abs(table[:, 1:]).max(axis=0) * 200)  # eight bits
    assert calib.read_frfs(BEAM.write(tmp_path / "coarse.csv", table)).n_repeats == 1


@pytest.mark.medium
def test_a_roving_hammer_gives_shapes_at_its_places(tmp_path):
    files = []
    for place in (10, 30, 40):
        for k in range(2):
            table = BEAM.record([(0.05, 80.0 + 10 * k)], place + k, hit_at=place, places=(20,))
            files.append(BEAM.write(tmp_path / f"at_{place}_{k}.csv", table, hit_at=place, places=(20,)))
    found = modes_from_frfs(calib.read_frfs(files, synthetic=True)).modes
    assert [sensor.node for sensor in found.sensors] == [10, 30, 40]
    true = BEAM.SHAPES[np.array([10, 30, 40]) - 1][:, WITHIN]
    np.testing.assert_allclose(np.diag(mac(found.shapes, true)), 1.0, atol=1e-3)


def test_a_universal_file_holds_the_same_hit(tmp_path):
    table = BEAM.record([(0.05, 100.0)])
    sets = []
    for node, column, kind in ((30, 1, 13), *((place, k + 2, 12) for k, place in enumerate(BEAM.PLACES))):
        own = {"rsp_dir": 3, "ordinate_spec_data_type": kind, "abscissa_inc": 1 / BEAM.RATE, "x": table[:, 0]}
        sets.append(AMBIENT.uff_set(node, table[:, column], **own))
    path = tmp_path / "hit.uff"
    pyuff.UFF(str(path)).write_sets([dict(one) for one in sets], mode="overwrite")
    assert hold_hits([path]) and not hold_records([path])
    found = calib.read_frfs(path)
    expected = calib.read_frfs(BEAM.write(tmp_path / "hit.csv", table))
    np.testing.assert_allclose(found.values, expected.values, atol=1e-4 * np.abs(expected.values).max())


def test_what_is_no_hammer_record_is_refused(tmp_path):
    table = BEAM.record([(0.05, 100.0)])
    hit = BEAM.write(tmp_path / "hit.csv", table)
    shaken = table.copy()
    shaken[:, 1] = np.random.default_rng(0).standard_normal(len(table))
    ambient = BEAM.write(tmp_path / "ambient.csv", table)
    ambient.write_text(ambient.read_text().replace("force 30z", "50z"))
    two = BEAM.write(tmp_path / "two.csv", table)
    two.write_text(two.read_text().replace(",10z", ",force 10z"))
    slower = BEAM.write(tmp_path / "slower.csv", table * np.array([2.0, 1, 1, 1, 1, 1]))
    unstated = BEAM.write(tmp_path / "unstated.csv", table, "")
    for files, word in (
        (BEAM.write(tmp_path / "shaken.csv", shaken), "hits"), ([hit, ambient], "no force"), (two, "2 forces"),
        ([hit, slower], "256 Hz"), (unstated, "does not state"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=word) as fault:
            calib.read_frfs(files)
        assert fault.value.remedy
    with pytest.raises(InputError, match="hammer"):
        read_records(hit)
    for wrong in ({"estimator": "H3"}, {"averages": 3}, {"exponential_window": -1.0}, {"quantity": "mobility"},
                  {"channels": ["10z/30z"]}):  # fmt: skip
        with pytest.raises(InputError):
            calib.read_frfs(hit, **wrong)
    with pytest.raises(InputError, match="window"):
        calib.FRFTest(calib.read_frfs(hit))


@pytest.mark.medium
def test_the_command_takes_hammer_records(tmp_path):
    files = BEAM.session(tmp_path, 1, window=0.25)
    into = tmp_path / "out"
    named = [*map(str, files), "--exponential-window", "0.25", "--estimator", "Hv", "--synthetic", "--into", str(into)]
    done = CliRunner().invoke(app, ["modes", *named])
    assert done.exit_code == 0, done.output
    found = calib.read_modes(into / "modes.csv", shapes=into / "shapes.csv")
    np.testing.assert_allclose(found.natural_freq, BEAM.FREQ[WITHIN], rtol=1e-3)
    np.testing.assert_allclose(found.damping_ratio, BEAM.RATIOS[WITHIN], rtol=0.05)
