"""Poles at ascending orders, against eigenvalues, and the lines that they need."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.frf_repeats import combine_frfs
from calib.modal_analysis.poles import poles_by_order
from calib.modal_analysis.rules import RULES
from calib.modal_analysis.stabilisation import pole_chains, stable
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
CHAIN = module_of(ROOT / "tests/template/frf_chain.py")
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
TRUE = WORLDS.roots(*CHAIN.by_hand(CHAIN.TRUE))[0]


def chain(freq=CHAIN.FREQ):
    return WORLDS.with_mean(WORLDS.noisy(CHAIN.truth(CHAIN.TRUE, freq), freq, 0.0, 0, 1, floor=0.0))[0]


def nearest(found, wanted):
    return found[np.argmin(np.abs(found - wanted))]


@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_without_noise_the_poles_in_the_band_are_the_eigenvalues(offset):
    freq = 2.0 + 0.5 * (offset + np.arange(76))  # 2 to 39.5 Hz: the fourth mode lies above
    highest = poles_by_order(chain(freq))[-1]
    for pole in TRUE[:3]:
        assert abs(nearest(highest, pole) / pole - 1) < 1e-4
    assert np.all(highest.real < 0) and np.all(highest.imag > 0)
    size = np.abs(highest) / (2 * np.pi)
    assert np.all(np.diff(size) >= 0) and freq[0] <= size[0] and size[-1] <= freq[-1]


@pytest.mark.parametrize("quantity", ["receptance", "mobility"])
def test_the_quantity_of_the_functions_does_not_matter(quantity):
    frfs = chain()
    power = {"receptance": -2, "mobility": -1}[quantity]
    factor = (2j * np.pi * frfs.freq)[:, None, None] ** power
    other = replace(frfs, quantity=quantity, values=frfs.values * factor)
    # low orders differ between quantities; poles of rounding errors at the highest ones differ anyway
    for one, two in zip(poles_by_order(frfs, 7), poles_by_order(other, 7), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-6)


def test_the_highest_order_leaves_enough_lines_for_each_pole():
    assert len(poles_by_order(chain())) == len(CHAIN.FREQ) // RULES.lines_per_order
    assert len(poles_by_order(chain(np.linspace(2, 40, 401)))) == RULES.frf_order_most


def test_lines_must_be_enough_and_above_zero():
    frfs = chain()
    for bad, word in ((frfs.in_band(2.0, 10.0), "too few"), (replace(frfs, freq=frfs.freq - frfs.freq[0]), "0 Hz")):
        with pytest.raises(InputError, match=word):
            poles_by_order(bad)


def test_lines_may_be_uneven_and_differ_between_functions():
    freq = np.sort(np.concatenate([np.linspace(2, 40, 77), np.linspace(16, 18, 20)[1:-1]]))
    frfs = chain(freq)
    known = np.ones(frfs.values.shape, dtype=bool)
    known[40:50, 0], known[-1] = False, False
    frfs = replace(frfs, values=np.where(known, frfs.values, np.nan))
    highest = poles_by_order(frfs)[-1]
    for pole in TRUE[:3]:
        assert abs(nearest(highest, pole) / pole - 1) < 1e-4


@pytest.mark.parametrize("band", [(14.0, 20.0), (26.0, 36.0), (10.0, 38.0)])
def test_a_band_of_any_place_is_as_good_as_another(band):
    freq = np.linspace(*band, 61)
    truth = CHAIN.truth(CHAIN.TRUE, freq)
    noisy = WORLDS.noisy(truth, freq, 0.01, 3, 1, floor=0.01 * float(np.sqrt(np.mean(np.abs(truth) ** 2))))
    frfs = WORLDS.with_mean(noisy)[0]
    poles = poles_by_order(frfs)
    inside = [pole for pole in TRUE if band[0] < abs(pole) / (2 * np.pi) < band[1]]
    found = stable(pole_chains(frfs, poles), len(poles))
    assert len(found) == len(inside)
    for chain_found, pole in zip(found, inside, strict=True):
        assert abs(chain_found.pole / pole - 1) < 2e-3


def test_functions_that_were_not_measured_are_left_out():
    pairs = CHAIN.repeats_of(CHAIN.truth(CHAIN.TRUE))[0]
    some = dict(list(pairs.functions.items())[:4])  # of three responses under two references
    highest = poles_by_order(combine_frfs([replace(pairs, functions=some)]))[-1]
    assert abs(nearest(highest, TRUE[1]) / TRUE[1] - 1) < 1e-4
