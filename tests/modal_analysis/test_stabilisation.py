"""The rule by which poles count as modes."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.poles import poles_by_order
from calib.modal_analysis.stabilisation import (
    Chain,
    pole_chains,
    pole_table,
    stable,
    stable_in_parts,
    with_accepted,
)
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
TRUE, _ = WORLDS.roots(*WORLDS.heavy_pair(0.1))


@pytest.fixture(scope="module")
def frfs():
    return WORLDS.pair_test(0.1, 0.0)[0]


def pole(freq, damping):
    return 2 * np.pi * freq * (-damping + 1j * np.sqrt(1 - damping**2))


def changed(value, freq=0.0, damping=0.0):
    size, ratio = np.abs(value) * (1 + freq), -value.real / np.abs(value) * (1 + damping)
    return size * (-ratio + 1j * np.sqrt(1 - ratio**2))


def orders_of(frfs, *sets):
    """Orders at which the chain that holds the first pole was found."""
    return pole_chains(frfs, [np.array(one) for one in sets])[0].orders


def test_a_pole_that_stays_is_one_chain(frfs):
    chains = pole_chains(frfs, [TRUE.copy() for _ in range(4)])
    assert [chain.orders for chain in chains] == [(1, 2, 3, 4)] * 3
    np.testing.assert_allclose([chain.pole for chain in chains], TRUE)
    assert chains[0].residues.shape == (4, 6) and chains[0].spread == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize(
    ("freq", "damping", "follows"),
    [(0.009, 0.0, True), (0.011, 0.0, False), (0.0, 0.045, True), (0.0, 0.055, False), (0.0, -0.055, False)],
)
def test_a_pole_that_moves_by_more_than_the_limits_begins_a_new_chain(frfs, freq, damping, follows):
    moved = changed(TRUE[0], freq, damping)
    assert orders_of(frfs, TRUE.copy(), [moved, *TRUE[1:]]) == ((1, 2) if follows else (1,))


def test_a_chain_may_lack_one_order_and_not_two(frfs):
    none = np.zeros(0, dtype=complex)
    assert orders_of(frfs, [TRUE[2]], none, [TRUE[2]]) == (1, 3)
    assert orders_of(frfs, [TRUE[2]], none, none, [TRUE[2]]) == (1,)


def test_a_pole_with_another_shape_is_not_the_same(frfs):
    # alone near the pair, a pole takes the residues of both, and beside another one only its own
    alone, both = [TRUE[0]], [TRUE[0], TRUE[1], TRUE[2]]
    assert orders_of(frfs, both, both) == (1, 2)
    assert orders_of(frfs, both, alone) == (1,)


def a_chain(value, count, residues):
    return Chain(tuple(range(1, count + 1)), np.full(count, value), np.tile(residues, (count, 1)))


def test_long_chains_count_and_of_two_alike_the_longer():
    one, other = np.array([1.0, 2.0, 3.0]) + 0j, np.array([3.0, -1.0, 0.5]) + 0j
    kept = [a_chain(pole(20.0, 0.01), 12, other), a_chain(pole(10.0, 0.01), 10, one)]
    again = a_chain(pole(10.1, 0.012), 10 - 1, one)  # within a half-power width, the same shape
    beside = a_chain(pole(10.1, 0.012), 9, other)  # another shape
    short = a_chain(pole(15.0, 0.01), 4, other)
    found = stable([*kept, again, beside, short], 20)
    assert [(c.natural_freq[0], len(c.orders)) for c in found] == [
        (pytest.approx(10.0), 10), (pytest.approx(10.1), 9), (pytest.approx(20.0), 12),
    ]  # fmt: skip
    assert len(stable([a_chain(pole(10.0, 0.01), 9, one)], 40)) == 0  # less than a quarter of the orders


def test_the_table_of_the_diagram_holds_every_pole():
    one = np.array([1.0, 2.0]) + 0j
    chains = [a_chain(pole(10.0, 0.01), 6, one), a_chain(pole(30.0, 0.2), 1, one)]
    table = pole_table(chains, stable(chains, 6))
    assert len(table) == 7 and table["mode"].tolist().count(1) == 6
    odd = table[table["freq"] > 20]
    assert not odd["stable"].any() and odd["mode"].tolist() == [0] and odd["damping"].iloc[0] == pytest.approx(0.2)


def test_an_accepted_frequency_keeps_the_longest_chain_near_it_where_none_counts():
    one = np.array([1.0, 2.0]) + 0j
    chains = [a_chain(pole(f, 0.01), n, one) for f, n in ((10.0, 12), (30.0, 3), (30.1, 2), (50.0, 1))]
    counted = stable(chains, 12)

    def freqs(*accept):
        return [round(float(c.natural_freq[0]), 6) for c in with_accepted(chains, counted, accept)]

    assert freqs() == freqs(10.05) == freqs(20.0) == freqs(50.0) == [10.0]
    assert freqs(30.2) == [10.0, 30.0]


@pytest.fixture(scope="module")
def many_modes():
    """Nine modes in a wide band and eight above; the fifth and the seventh hardly move."""
    rng = np.random.default_rng(4)
    freq = np.arange(5.0, 80.0, 0.125)
    own = np.array([12.5, 15.9, 18.6, 25.2, 30.7, 43.3, 48.4, 67.5, 71.0, 120.2, 127.3, 131.8, 155, 175, 186, 209, 233])
    poles = pole(own, np.linspace(0.012, 0.006, len(own)))
    shapes = rng.standard_normal((4, len(own)))
    shapes[:, [4, 6]] *= 0.1
    s = 2j * np.pi * freq[:, None]
    each = s**2 / (s**2 - 2 * poles.real * s + np.abs(poles) ** 2)
    values = np.einsum("fm,im,m->fi", each, shapes, shapes[0])[:, :, None]
    std = 0.005 * np.abs(values)
    values = values + std * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    places = tuple(calib.Sensor(k, "z") for k in range(1, 5))
    return MeasuredFRFs(freq, places, places[:1], "accelerance", values, std=std), own[:9]


@pytest.mark.medium
def test_weak_modes_of_a_wide_band_count_by_its_parts(many_modes):
    frfs, own = many_modes
    poles = poles_by_order(frfs)
    whole = stable(pole_chains(frfs, poles), len(poles))
    further = stable_in_parts(frfs, whole)
    of_whole, of_parts = (np.array([abs(one.pole) / (2 * np.pi) for one in some]) for some in (whole, further))
    assert abs(of_whole - 48.4).min() > 1.0 and abs(of_parts - 48.4).min() < 0.05
    assert all(abs(own / f - 1).min() < 0.003 for f in of_parts)  # none stands for modes beyond a part
    assert not any(abs(of_whole / f - 1).min() < 0.003 for f in of_parts)


def test_few_lines_are_not_cut_into_parts(many_modes):
    assert stable_in_parts(many_modes[0].in_band(50.0, 79.0), ()) == ()
