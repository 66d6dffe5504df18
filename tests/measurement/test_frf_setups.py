"""Set-ups of FRFs: merged and scaled by what they share, or refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.frf_repeats import FRFRepeat
from calib.measurement.frf_setups import combine_setups
from calib.measurement.mac import mac
from calib.modal_analysis.identify import modes_from_frfs
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
FREQ = np.linspace(5.0, 25.0, 201)
K, C, M = WORLDS.heavy_pair(0.1, 0.01)
TRUE = WORLDS.receptances(K, C, M, FREQ)


def setup(name, pairs, gain=1.0, noise=0.0, seed=0, quantity="receptance"):
    """Functions by the numbers of their response and reference."""
    rng, found = np.random.default_rng(seed), {}
    for i, j in pairs:
        own = gain * TRUE[:, i - 1, j - 1]
        spread = noise * np.abs(own).max()
        error = rng.standard_normal(len(own)) + 1j * rng.standard_normal(len(own))
        found[(i, "x"), (j, "x")] = own + spread * error
    return FRFRepeat(name, FREQ, quantity, found)


def test_set_ups_have_the_scale_of_the_first_by_the_driving_point():
    merged = combine_setups([setup("one", [(1, 1), (2, 1)]), setup("two", [(1, 1), (3, 1)], gain=1.1)], synthetic=True)
    assert [one.name for one in merged.functions] == ["1x/1x", "2x/1x", "3x/1x"] and merged.n_repeats == 1
    np.testing.assert_allclose(merged.values[:, :, 0], TRUE[:, :, 0], rtol=1e-12)
    assert any("0.9091" in note and "1x/1x" in note for note in merged.notes)


def test_a_shared_function_is_the_mean_and_those_of_one_set_up_are_its_own():
    one, two = setup("one", [(1, 1), (2, 1)], noise=0.01), setup("two", [(1, 1), (3, 1)], noise=0.01, seed=1)
    merged = combine_setups([one, two])
    key = (1, "x"), (1, "x")
    scale = np.linalg.norm(one.functions[key]) / np.linalg.norm(two.functions[key])
    np.testing.assert_allclose(merged.values[:, 0, 0], (one.functions[key] + scale * two.functions[key]) / 2)
    np.testing.assert_allclose(merged.values[:, 2, 0], scale * two.functions[(3, "x"), (1, "x")])


def test_repeats_of_each_set_up_give_its_standard_deviation():
    hits = [
        setup(f"{name} {n}", pairs, noise=0.01, seed=10 * k + n)
        for k, (name, pairs) in enumerate((("one", [(1, 1), (2, 1)]), ("two", [(1, 1), (3, 1)])))
        for n in range(3)
    ]
    merged = combine_setups(hits)
    assert merged.n_repeats == 3 and np.isfinite(merged.std).all()
    own = np.array([hit.functions[(2, "x"), (1, "x")] for hit in hits[:3]])
    np.testing.assert_allclose(merged.values[:, 1, 0], own.mean(axis=0))
    shared, alone = merged.std[:, 0, 0].mean() / np.abs(TRUE[:, 0, 0]).max(), 0.01 / np.sqrt(3)
    assert shared == pytest.approx(alone / np.sqrt(2), rel=0.25)


def test_averages_behind_each_set_up_and_its_coherence_give_its_standard_deviation():
    one, two = setup("one", [(1, 1), (2, 1)]), setup("two", [(1, 1), (3, 1)])
    one, two = (
        replace(run, coherence={key: np.full(len(FREQ), gamma) for key in run.functions})
        for run, gamma in ((one, 0.9), (two, 0.8))
    )
    merged = combine_setups([one, two], averages=5)
    for column, gamma in ((1, 0.9), (2, 0.8)):
        share = np.sqrt((1 - gamma) / (2 * 5 * gamma))
        np.testing.assert_allclose(merged.std[:, column, 0], share * np.abs(TRUE[:, column, 0]))
    again = setup("again", [(1, 1), (2, 1)], noise=0.01)
    with pytest.raises(InputError, match="averages are given beside 2 repeats"):
        combine_setups([one, again, two], averages=5)


def test_set_ups_are_linked_in_any_order_and_by_a_common_reference():
    first, last = setup("a", [(1, 1), (1, 2)]), setup("c", [(3, 3), (2, 3)])
    link = setup("b", [(2, 2), (1, 2), (3, 3)])
    merged = combine_setups([first, last, link])
    known = np.isfinite(merged.values).all(axis=0)
    assert known.sum() == 5
    for one in merged.functions:
        np.testing.assert_allclose(
            merged.values[one.index], TRUE[:, one.response.node - 1, one.reference.node - 1], rtol=1e-12
        )
    by_force = combine_setups([setup("a", [(1, 1)]), setup("b", [(2, 1)], gain=1.3)])
    np.testing.assert_allclose(by_force.values[:, 1, 0], 1.3 * TRUE[:, 1, 0])
    assert any("reference" in note for note in by_force.notes)


@pytest.mark.parametrize(
    ("other", "word"),
    [
        (setup("two", [(3, 2)]), "in common"),
        (setup("two", [(1, 1), (3, 1)], gain=1.5), "1.5 times"),
        (setup("two", [(1, 1), (3, 1)], gain=-1.0), "opposite sign"),
        (setup("two", [(1, 1), (3, 1)], quantity="mobility"), "mobility"),
        (setup("two", [(1, 1)]), "2x/1x"),  # a repeat that lacks a function is no set-up
        (replace(setup("two", [(1, 1), (3, 1)]), freq=FREQ + 0.01), "frequencies"),
    ],
)
def test_what_is_no_set_up_is_refused_by_its_name(other, word):
    with pytest.raises(InputError) as fault:
        combine_setups([setup("one", [(1, 1), (2, 1)]), other])
    assert word in str(fault.value) and "two" in str(fault.value)


@pytest.mark.medium
def test_modes_of_two_runs_with_a_roving_accelerometer_have_one_shape():
    runs = [setup("one", [(2, 2), (1, 2)], noise=1e-3), setup("two", [(2, 2), (3, 2)], 1.05, 1e-3, 1)]
    found = modes_from_frfs(combine_setups(runs, synthetic=True)).modes
    freq, _ = WORLDS.freq_and_damping(WORLDS.roots(K, C, M)[0])
    np.testing.assert_allclose(found.natural_freq, freq, rtol=1e-3)
    np.testing.assert_allclose(np.diag(mac(found.shapes, WORLDS.roots(K, C, M)[1][[1, 0, 2]])), 1.0, atol=1e-3)
    assert [sensor.node for sensor in found.sensors] == [2, 1, 3]
