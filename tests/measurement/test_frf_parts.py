"""Parts of measured FRFs: those in use and each group of held-out ones, every entry in one of them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import BANDS, REFERENCES, SENSORS, HeldOutFRFs, without_gaps
from calib.measurement.modal import Sensor
from calib.measurement.places import Doubt

FREQ = np.arange(1.0, 11.0)
EVERY = {(f, r, q) for f in FREQ for r in ("1z", "2z", "3z") for q in ("1z", "3z")}


def measured(unmeasured=()):
    """Every entry has a value of its own; ``unmeasured`` are functions as (response, reference)."""
    responses, references = tuple(Sensor(n, "z") for n in (1, 2, 3)), tuple(Sensor(n, "z") for n in (1, 3))
    values = np.arange(1.0, 61.0).reshape(10, 3, 2) * (1 + 0.5j)
    for i, response in enumerate(responses):
        for j, reference in enumerate(references):
            if (response.name, reference.name) in unmeasured:
                values[:, i, j] = np.nan
    return MeasuredFRFs(FREQ, responses, references, "mobility", values, np.full(values.shape, 0.1), 3)


def entries(frfs):
    return {
        (f, r.name, q.name): frfs.values[k, i, j]
        for k, f in enumerate(frfs.freq) for i, r in enumerate(frfs.responses) for j, q in enumerate(frfs.references)
        if np.isfinite(frfs.values[k, i, j])
    }  # fmt: skip


@pytest.mark.parametrize(
    ("held_out", "groups"),
    [
        (HeldOutFRFs(), {}),
        (HeldOutFRFs(sensors=("2z",)), {SENSORS: lambda f, r, q: r == "2z"}),
        (HeldOutFRFs(references=("1z",)), {REFERENCES: lambda f, r, q: q == "1z"}),
        (HeldOutFRFs(bands=((2.0, 3.0), (9.0, 9.0))), {BANDS: lambda f, r, q: f in (2.0, 3.0, 9.0)}),
        (
            HeldOutFRFs(("3z",), ("3z",), ((5.0, 7.0),)),
            {
                SENSORS: lambda f, r, q: r == "3z",
                REFERENCES: lambda f, r, q: r != "3z" and q == "3z",
                BANDS: lambda f, r, q: r != "3z" and q != "3z" and 5.0 <= f <= 7.0,
            },
        ),
    ],
)
def test_every_entry_is_in_use_or_in_the_first_group_that_names_it(held_out, groups):
    whole = measured()
    assert held_out.unknown(whole) is None
    used, unseen = held_out.split(whole)
    values = entries(whole)
    assert set(unseen) == set(groups)
    expected = {group: {e for e in EVERY if of(*e)} for group, of in groups.items()}
    for group, own in expected.items():
        assert entries(unseen[group]) == {e: values[e] for e in own}
    assert entries(used) == {e: values[e] for e in EVERY - set().union(*expected.values())}


def test_data_that_other_groups_took_leave_a_group_out():
    # reference 3z was measured at response 3z only: with that response it is held out already
    whole = measured([("1z", "3z"), ("2z", "3z")])
    held_out = HeldOutFRFs(("3z",), ("3z",), ((4.0, 5.0),))
    assert held_out.unknown(whole) is None
    used, unseen = held_out.split(whole)
    assert set(unseen) == {SENSORS, BANDS}
    assert {(r, q) for _, r, q in entries(unseen[SENSORS])} == {("3z", "1z"), ("3z", "3z")}
    assert {(r, q) for _, r, q in entries(used)} == {("1z", "1z"), ("2z", "1z")}
    assert used.references == (Sensor(1, "z"),) and set(used.freq) == set(FREQ) - {4.0, 5.0}


def test_a_band_whose_lines_other_groups_took_leaves_its_group_out():
    whole = measured()
    whole.values[FREQ == 8.0, :2] = np.nan  # at 8 Hz response 3z alone
    used, unseen = HeldOutFRFs(sensors=("3z",), bands=((8.0, 8.0),)).split(whole)
    assert set(unseen) == {SENSORS} and 8.0 in unseen[SENSORS].freq and 8.0 not in used.freq
    used, unseen = HeldOutFRFs(sensors=("3z",), bands=((8.0, 8.0), (2.0, 2.0))).split(whole)
    assert set(unseen[BANDS].freq) == {2.0} and 2.0 not in used.freq


@pytest.mark.parametrize(
    ("held_out", "at", "words"),
    [
        (HeldOutFRFs(("2z", "9z")), ("sensors", 1), "held-out response '9z' was not measured"),
        (HeldOutFRFs(references=("2z",)), ("references", 0), "held-out reference '2z' was not measured"),
        (HeldOutFRFs(bands=((1.0, 2.0), (20.0, 30.0))), ("bands", 1), "no line lies in the band"),
        (HeldOutFRFs(bands=((3.0, 2.0),)), ("bands", 0), "no line lies in the band"),
        (HeldOutFRFs(("9z",), ("9z",), ((20.0, 30.0),)), ("sensors", 0), "response '9z'"),
        (HeldOutFRFs(("1z", "2z", "3z")), ("sensors", 2), "no measured FRF is left"),
        (HeldOutFRFs(("1z",), ("1z", "3z")), ("references", 1), "no measured FRF is left"),
    ],
)
def test_the_first_entry_that_is_not_there_is_named_by_field_and_position(held_out, at, words):
    found = held_out.unknown(measured())
    assert found is not None
    where, fault = found
    assert where == at and isinstance(fault, InputError) and words in fault.problem and fault.remedy


def test_gaps_are_cut_at_the_ends_and_interpolated_within():
    """A measurement without a first line, and with single lines that one function lacks."""
    freq = np.arange(1.0, 41.0)
    values = np.stack([2 * freq + 1j * freq**2, 3 - 1j * freq], axis=1)[:, :, None]
    holed = values.copy()
    holed[0] = holed[20, 0] = holed[7:9, 1] = np.nan
    ends = (Sensor(1, "x"), Sensor(2, "x"))
    frfs = MeasuredFRFs(freq, ends, ends[:1], "receptance", holed, np.ones(holed.shape))
    found = without_gaps(frfs)
    np.testing.assert_array_equal(found.freq, freq[1:])
    np.testing.assert_allclose(found.values[:, 1], values[1:, 1], rtol=1e-12)  # linear in frequency
    np.testing.assert_allclose(found.values[19, 0], 2 * 21 + 1j * (20**2 + 22**2) / 2)
    assert sum(isinstance(note, Doubt) for note in found.notes) == 3 and np.isfinite(found.std).all()
    holed[30:33, 0] = np.nan
    longer = without_gaps(replace(frfs, values=holed))
    assert np.isnan(longer.values[29:32, 0]).all() and np.isfinite(longer.values[:, 1]).all()
    first = replace(frfs, values=np.where(freq[:, None, None] == 2.0, np.nan, values))
    assert without_gaps(first, found).freq[0] == 2.0 and np.isfinite(without_gaps(first, found).values).all()
    assert without_gaps(replace(frfs, values=values)).freq[0] == 1.0
