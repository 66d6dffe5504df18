"""What is refused and told beside modes, and refused modes that are accepted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.identification import modes_table
from calib.modal_analysis.identify import modes_from_frfs
from calib.modal_analysis.judgement import accepted_modes, complex_shape, none_counts
from calib.results.results import Results
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
FREQ, WHY = np.array([10.0, 20.0, 20.5]), ["", "because of a", "because of b"]


def turned(n_references=1, freq=None):
    """Two modes at five places; the shape of the second, 20 Hz, turns round over them."""
    freq = np.linspace(5.0, 30.0, 251) if freq is None else freq
    s = 2j * np.pi * freq[:, None, None]
    places = tuple(calib.Sensor(k, "z") for k in range(1, 6))
    values = np.zeros((len(freq), 5, n_references), complex)
    for f, shape in ((10.0, np.linspace(0.4, 1, 5) + 0j), (20.0, np.exp(1.3j * np.arange(5)))):
        pole = 2 * np.pi * f * (-0.01 + 1j)
        residue = np.outer(shape, shape[:n_references])
        values += residue / (s - pole) + residue.conj() / (s - np.conj(pole))
    return MeasuredFRFs(
        freq, places, places[:n_references], "receptance", values, np.full(values.shape, np.nan), synthetic=True
    )


def test_an_accepted_frequency_is_that_of_the_nearest_refused_mode():
    damping = np.full(3, 0.005)
    assert list(accepted_modes([20.05], FREQ, damping, WHY, "x")) == [1]
    both = accepted_modes([20.4, 20.0], FREQ, damping, WHY, "x")
    assert set(both) == {1, 2} and "because of b" in both[2]
    assert accepted_modes([10.0], FREQ, damping, WHY, "x") == {}  # counts already
    # within its half-power width, 20 %
    assert list(accepted_modes([17.0], FREQ, np.full(3, 0.1), WHY, "x")) == [1]
    with pytest.raises(InputError) as fault:
        accepted_modes([15.0], FREQ, damping, WHY, "x")
    assert "15 Hz" in str(fault.value) and "20, 20.5 Hz" in str(fault.value)


@pytest.mark.medium
def test_a_complex_shape_is_refused_under_one_reference_only():
    assert complex_shape(0.3, 40.0, 1) and not complex_shape(0.3, 40.0, 2)
    assert not complex_shape(0.9, 10.0, 1) and not complex_shape(np.nan, np.nan, 1)
    found = modes_from_frfs(turned())
    assert found.modes.natural_freq == pytest.approx([10.0], rel=1e-3)
    assert found.fit["refused"].astype(bool).tolist() == [False, True] and np.isnan(found.fit["rank_one"]).all()
    assert "MPC 0." in found.fit["refused"][1] and "20" in found.verdict
    assert modes_from_frfs(turned(2)).modes.n_modes == 2


@pytest.mark.medium
def test_an_accepted_mode_has_its_standard_deviation_and_a_note_that_travels(tmp_path):
    found = modes_from_frfs(turned(), accept=[20.0])
    assert found.modes.natural_freq == pytest.approx([10.0, 20.0], rel=1e-3)
    assert np.isfinite(found.modes.freq_std).all() and np.isfinite(found.modes.damping_std).all()
    assert not found.fit["refused"].any() and "MPC" in found.fit["note"][1]
    assert any(note.startswith("mode 2 ") for note in found.modes.notes)
    Results.at(tmp_path, "out").write_table("modes", modes_table(found))
    again = calib.read_modes(tmp_path / "out/modes.csv", synthetic=True)
    assert any("mode 2" in note and found.fit["note"][1] in note for note in again.notes)
    np.testing.assert_allclose(again.damping_ratio, found.modes.damping_ratio)


@pytest.mark.medium
def test_where_no_mode_counts_the_remedy_names_how_to_keep_one():
    alone = turned().in_band(15.0, 25.0)
    with pytest.raises(InputError) as fault:
        modes_from_frfs(alone)
    assert "--accept 20" in str(fault.value)
    assert modes_from_frfs(alone, accept=[20.0]).modes.n_modes == 1


def test_where_no_pole_is_stable_the_remedy_fits_the_lines():
    freq, rng = np.linspace(5.0, 30.0, 60), np.random.default_rng(0)
    frfs = turned(freq=freq)
    noise = rng.standard_normal(frfs.values.shape) + 1j * rng.standard_normal(frfs.values.shape)
    noise[[20, 40]] *= 300.0  # one line each: no resonance that lines resolve
    remedy = none_counts(replace(frfs, values=noise), []).remedy
    assert f"{freq[20]:.4g}" in remedy and f"{freq[40]:.4g}" in remedy and "finer lines" in remedy
    fine = none_counts(turned(freq=np.linspace(5.0, 30.0, 1001)), []).remedy
    assert 'kind = "frf"' in fine and "finer" not in fine


@pytest.mark.medium
def test_a_line_at_zero_is_not_used():
    freq = np.linspace(0.0, 30.0, 301)
    frfs = turned(2, np.where(freq > 0, freq, 1e-9))
    values = frfs.values.copy()
    values[0] = 7.0
    found = modes_from_frfs(replace(frfs, freq=freq, values=values))
    assert found.modes.n_modes == 2 and found.curves["freq"].iloc[0] > 0
