"""Which entries of measured FRFs enter: resonances, bands, held-out data; and what accuracy is claimed of them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.accuracy import Claim, frf_claim
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_lines import HALF_POWER, resonances
from calib.measurement.modal import Sensor

FREQ = np.linspace(1.0, 50.0, 2451)
MODES = ((8.0, 0.01, 1.0), (20.0, 0.02, 3.0), (37.0, 0.005, 0.3))
"""Natural frequency in Hz, damping ratio, residue."""


def peak(freq, natural, ratio, residue):
    return residue / (natural**2 - freq**2 + 2j * ratio * natural * freq)


def measured(freq=FREQ, noise=0.0, seed=0):
    """Two responses over two references: each mode moves other functions most, one function was not measured."""
    rng = np.random.default_rng(seed)
    values = np.zeros((len(freq), 2, 2), dtype=complex)
    for k, mode in enumerate(MODES):
        values += peak(freq, *mode)[:, None, None] * np.array([[1.0, 0.2], [-0.5, 0.7]]) * (1, -0.6, 1)[k]
    values += noise * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    values[:, 1, 0] = np.nan
    ends = (Sensor(1, "z"), Sensor(2, "z")), (Sensor(1, "z"), Sensor(7, "x"))
    return MeasuredFRFs(freq, *ends, "receptance", values, np.full(values.shape, 1e-4), 3)


def test_resonances_are_the_modes_with_their_half_power_widths():
    found = resonances(FREQ, measured().power)
    assert len(found) == 3
    for (natural, ratio, _), (freq, width) in zip(MODES, found, strict=True):
        assert freq == pytest.approx(natural, rel=2e-3) and width == pytest.approx(2 * ratio * natural, rel=0.03)


def test_the_power_is_that_of_all_functions_and_of_moduli():
    frfs = measured()
    some = np.abs(frfs.values[:, 0, 0]) ** 2 + np.abs(frfs.values[:, 0, 1]) ** 2 + np.abs(frfs.values[:, 1, 1]) ** 2
    np.testing.assert_allclose(frfs.power, some, rtol=1e-13)


def test_noise_makes_no_resonances():
    frfs = measured(noise=2e-4, seed=3)
    near = replace(frfs, std=np.full(frfs.values.shape, 2e-4)).lines_near_resonances(widths=2.0)
    middles = np.split(near.freq, np.flatnonzero(np.diff(near.freq) > 1.0) + 1)
    assert [round(float(np.median(each))) for each in middles] == [8, 20, 37]
    assert len(resonances(FREQ, frfs.power)) > 3  # where nothing is known of the noise


def test_lines_between_which_a_peak_lies_are_as_wide_as_their_distance():
    coarse = np.arange(1.0, 50.0, 0.6)
    found = resonances(coarse, measured(coarse).power)
    assert [round(freq) for freq, _ in found] == [8, 20, 37]
    # of modes that are 0.16, 0.8 and 0.37 Hz wide
    assert found[0].width == pytest.approx(0.6) and found[2].width == pytest.approx(0.6)
    assert abs(found[1].width - 0.8) < 0.3  # half the distance of lines


def test_a_prominence_below_the_half_power_is_raised_to_it():
    level = np.array([0.0, 2.0, 0.0, 5.0, 0.0])
    found = resonances(np.arange(5.0), 10 ** (level / 10), prominence=0.1)
    assert found == ((3.0, pytest.approx(max(2 * HALF_POWER / 5, 1.0))),)


def test_lines_near_resonances_lie_in_windows_of_so_many_widths():
    frfs = measured()
    near = frfs.lines_near_resonances(widths=4.0)
    expected = np.zeros(len(FREQ), dtype=bool)
    for freq, width in resonances(FREQ, frfs.power):
        expected |= np.abs(FREQ - freq) <= 2.0 * width
    np.testing.assert_array_equal(near.freq, FREQ[expected])
    np.testing.assert_array_equal(near.values, frfs.values[expected])
    np.testing.assert_array_equal(near.std[:, 0, 0], frfs.std[expected, 0, 0])
    assert (near.responses, near.references, near.n_repeats) == (frfs.responses, frfs.references, 3)
    assert len(frfs.lines_near_resonances().freq) > len(near.freq)
    flat = replace(frfs, values=np.ones_like(frfs.values))
    with pytest.raises(InputError, match="6 dB"):
        flat.lines_near_resonances()
    with pytest.raises(InputError, match="positive"):
        frfs.lines_near_resonances(widths=0)


def test_a_band_includes_its_ends():
    frfs = measured(np.arange(1.0, 11.0))
    np.testing.assert_array_equal(frfs.in_band(3.0, 5.0).freq, [3.0, 4.0, 5.0])
    assert len(frfs.in_band(4.0, 4.0).freq) == 1
    for low, high in ((11.0, 20.0), (5.0, 3.0), (3.2, 3.8), (float("nan"), 4.0)):
        with pytest.raises(InputError, match="no line lies in the band"):
            frfs.in_band(low, high)


@pytest.mark.parametrize(
    "held_out",
    [
        {"responses": ["2z"]},
        {"references": ["7x"]},
        {"bands": [(2.0, 3.0), (8.0, 8.0)]},
        {"responses": ["2z"], "references": ["7x"], "bands": [(4.0, 6.0)]},
    ],
)
def test_held_out_data_and_the_rest_are_complements(held_out):
    frfs = measured(np.arange(1.0, 11.0))
    kept, away = frfs.without(**held_out), frfs.only(**held_out)

    def entries(some):
        return {
            (f, r.name, q.name): some.values[k, i, j]
            for k, f in enumerate(some.freq) for i, r in enumerate(some.responses)
            for j, q in enumerate(some.references) if np.isfinite(some.values[k, i, j])
        }  # fmt: skip

    ours, theirs = entries(kept), entries(away)
    assert ours and theirs and not ours.keys() & theirs.keys() and ours | theirs == entries(frfs)
    bands = held_out.get("bands", [])
    for freq, response, reference in theirs:
        assert (
            response in held_out.get("responses", []) or reference in held_out.get("references", [])
            or any(low <= freq <= high for low, high in bands)
        )  # fmt: skip
    for freq, response, reference in ours:
        assert response not in held_out.get("responses", []) and reference not in held_out.get("references", [])
        assert not any(low <= freq <= high for low, high in bands)
    assert np.isfinite(kept.std[np.isfinite(kept.values)]).all() and np.isnan(away.std[np.isnan(away.values)]).all()


def test_what_was_not_measured_cannot_be_held_out_nor_everything():
    frfs = measured(np.arange(1.0, 11.0))
    for given, words in (
        ({"responses": ["7x"]}, "held-out response '7x'"), ({"references": ["2z"]}, "held-out reference '2z'"),
        ({"responses": ["1z", "2z"]}, "no measured FRF is left"), ({"bands": [(60.0, 70.0)]}, "band"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            frfs.without(**given)
    with pytest.raises(InputError, match="no measured FRF is left"):
        frfs.only()


# -- accuracy ----------------------------------------------------------------------------------------------------------


def test_a_claimed_accuracy_joins_the_repeatability():
    frfs = measured(np.arange(1.0, 11.0))
    np.testing.assert_array_equal(frfs.total_std, frfs.std)
    claimed = replace(frfs, accuracy=frf_claim({"share": "2 %", "floor": 3e-4}))
    own = np.sqrt(1e-4**2 + (0.02 * np.abs(frfs.values)) ** 2 + 3e-4**2)
    np.testing.assert_allclose(claimed.total_std, own, rtol=1e-12)
    alone = replace(claimed, std=np.full(frfs.std.shape, np.nan)).total_std
    np.testing.assert_allclose(alone, np.sqrt((0.02 * np.abs(frfs.values)) ** 2 + 3e-4**2), rtol=1e-12)
    np.testing.assert_array_equal(claimed.std, frfs.std)
    assert np.isnan(replace(frfs, std=np.full(frfs.std.shape, np.nan)).total_std).all()


def test_claims_of_frfs():
    assert frf_claim(None) == Claim() and frf_claim("2 %") == Claim(share=0.02) and frf_claim(1e-6) == Claim(own=1e-6)
    both = frf_claim({"share": "2 %", "floor": 1e-6})
    assert both == Claim(0.02, 1e-6) and both.words("m/N") == "2 % and 1e-06 m/N"
    for wrong in ({"size": "2 %"}, {"share": 0.02}, {"floor": "2 %"}, "two", -1.0, {"floor": -1.0}):
        with pytest.raises(ValueError, match=r"accuracy|share"):
            frf_claim(wrong)
