"""Tests of `calib.modal_analysis.first_look`: what modes, FRFs and records tell by themselves, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.record import MeasuredRecord
from calib.modal_analysis import first_look as seen

_PLACES = tuple(calib.Sensor(k + 1, "z", (0.5 * k, 0.0, 0.0)) for k in range(4))
_SHAPES = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, -1.0, 0.9], [1.0, 0.5, 1.1]])


def modes(shapes=_SHAPES, freq=(5.0, 9.0, 14.0), source="one"):
    freq, unknown = np.array(freq), np.full(len(freq), np.nan)
    names = tuple(f"m{k + 1}" for k in range(len(freq)))
    none = np.full(shapes.shape, np.nan)
    return calib.MeasuredModes(names, freq, freq, unknown, unknown, unknown, _PLACES, shapes, none, source=source)


def test_the_auto_mac_tells_which_shape_is_most_alike():
    table = seen.modes_seen(modes())
    a, b = _SHAPES[:, 0], _SHAPES[:, 2]
    alike = (a @ b) ** 2 / (a @ a) / (b @ b)
    assert table["like"].tolist()[::2] == ["m3", "m1"]
    assert table["mac"].to_numpy()[::2] == pytest.approx([alike, alike])
    square = seen.auto_mac(modes()).drop(columns="mode").to_numpy()
    assert np.diag(square) == pytest.approx(1.0) and square == pytest.approx(square.T)


def test_complexity_is_that_of_the_phases():
    turned = np.array([1.0, 1.0, 1.0, 1.0]) * np.exp(1j * np.radians([0.0, 0.0, 60.0, 60.0]))
    (row,) = seen.modes_seen(modes(turned[:, None], (5.0,))).to_dict("records")
    assert row["mpd"] == pytest.approx(30.0)  # half of them 30 degrees to each side of the mean phase
    assert row["mpc"] == pytest.approx(np.cos(np.radians(60.0)) ** 2)
    assert row["mcf"] == pytest.approx(1.0 - row["mpc"])
    assert row["like"] == "" and np.isnan(row["mac"])


def test_a_sensor_that_is_turned_in_one_repeat_has_the_lowest_comac():
    places = tuple(calib.Sensor(k + 1, "z") for k in range(8))
    shapes = np.cos(np.outer((np.arange(8) + 0.5) / 8 * np.pi, [0, 1, 2]))
    none = np.full(3, np.nan)

    def repeat(gains, source):
        freq = np.array([5.0, 9.0, 14.0])
        return calib.MeasuredModes(
            ("a", "b", "c"), freq, freq, none, none, none, places, shapes * np.array(gains)[:, None],
            np.full((8, 3), np.nan), source=source,
        )  # fmt: skip

    one = [1.0] * 8
    flipped = [1.0, 1.0, -1.0, *one[3:]]
    table = seen.repeats_comac([repeat(one, "1"), repeat(one, "2"), repeat(flipped, "3")])
    assert table.iloc[0][["sensor", "repeat"]].tolist() == ["3z", 3]
    assert table["comac"].iloc[0] < 0.1 and (table["comac"].iloc[1:] > 0.9).all()
    largest = np.abs(shapes[0]) / np.abs(shapes).max(axis=0)
    assert table.set_index("sensor")["motion"]["1z"] == pytest.approx(np.sqrt(np.mean(largest**2)))
    assert seen.repeats_comac([repeat(one, "1")]).empty


def frfs(quantity="receptance", std=None, n_repeats=1):
    """Two modes at 5.0 and 5.2 Hz whose shapes are orthogonal at two places, driven at both."""
    freq = np.linspace(4.0, 6.5, 501)
    s = 2j * np.pi * freq[:, None, None]
    values = sum(
        np.outer(v, v) / (s**2 + 2 * 0.005 * w * s + w**2)
        for v, w in ((np.array([1.0, 1.0]), 2 * np.pi * 5.0), (np.array([1.0, -1.0]), 2 * np.pi * 5.2))
    )
    values = values * {"receptance": 1.0, "mobility": s, "accelerance": s**2}[quantity]
    spread = np.full(values.shape, np.nan) if std is None else std * np.abs(values)
    return MeasuredFRFs(freq, _PLACES[:2], _PLACES[:2], quantity, values, spread, n_repeats)


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_indicators_have_their_extremes_at_the_modes(quantity):
    table = seen.indicators(frfs(quantity))
    assert list(table.columns) == ["freq", "cmif_1", "cmif_2", "mif"]
    first = table["cmif_1"].to_numpy()
    peaks = np.flatnonzero((first[1:-1] > first[:-2]) & (first[1:-1] > first[2:])) + 1
    assert table["freq"].to_numpy()[peaks] == pytest.approx([5.0, 5.2], abs=0.011)
    low = table[table["mif"] < 0.3]["freq"]
    assert len(low) and (np.minimum(abs(low - 5.0), abs(low - 5.2)) < 0.05).all()


def test_the_coherence_is_that_of_which_the_standard_deviations_follow():
    gamma, n = 0.9, 12
    std = np.sqrt((1 - gamma) / gamma / 2 / n)
    found = seen.coherences(frfs(std=std, n_repeats=n))
    assert set(found) == {"1z/1z", "2z/1z", "1z/2z", "2z/2z"}
    assert found["1z/2z"] == pytest.approx(gamma)
    assert seen.coherences(frfs()) == {}
    table = seen.functions_seen(frfs(std=std, n_repeats=n), found)
    assert table["coherence"].to_numpy() == pytest.approx(gamma) == table["coherence_least"].to_numpy()
    assert table["peak_freq"].to_numpy() == pytest.approx(5.0, abs=0.25)
    assert seen.functions_seen(frfs(), {})["coherence"].isna().all()


def records(values):
    return MeasuredRecord(100.0, values, _PLACES[: values.shape[1]], "acceleration")


def test_records_tell_clipped_channels_and_where_their_spectra_peak():
    t, rng = np.arange(8000) / 100.0, np.random.default_rng(1)
    own = np.sin(2 * np.pi * 12.5 * t)
    values = np.column_stack([own + 1e-3 * rng.normal(size=8000), np.clip(own, -0.5, 0.5)])
    table = seen.channels_seen([records(values)]).set_index("sensor")
    assert table["rms"]["1z"] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert table["crest"]["1z"] == pytest.approx(np.sqrt(2), rel=1e-2)
    assert table["held"]["2z"] > 0.5 > 0.01 > table["held"]["1z"]
    spectra = seen.spectra([records(values), records(values)])
    assert spectra["freq"][spectra["cmif_1"].idxmax()] == pytest.approx(12.5, abs=0.1)
    width = spectra["freq"].diff().median()  # the power of both sine waves: 1/2, and that of the clipped one
    power = np.mean(values[:, 0] ** 2) + np.mean(values[:, 1] ** 2)
    near = (spectra["freq"] - 12.5).abs() < 1.0
    assert spectra["cmif_1"][near].sum() * width == pytest.approx(power, rel=0.02)


def test_nodes_have_their_directions_and_unknown_places():
    table = seen.nodes_seen([*_PLACES[:2], replace(_PLACES[0], direction="x"), calib.Sensor(9, "y")])
    assert table["node"].tolist() == [1, 2, 9]
    assert table["directions"].tolist() == ["z x", "z", "y"]
    assert np.isnan(table["x"].iloc[-1]) and table["x"].iloc[1] == 0.5
