"""Poles that differ between functions: their scatter, their mean, and two stable poles that are one moving mode."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import calib
from calib.measurement.frf import MeasuredFRFs
from calib.modal_analysis.identify import modes_from_frfs
from calib.modal_analysis.model import most_likely_model
from calib.modal_analysis.scatter import hidden_pairs, scatter, without_split

FREQ = np.linspace(40.0, 80.0, 401)
TRUE, DAMPING = np.array([52.0, 68.0]), np.array([0.01, 0.012])
SHAPES = np.array([[1.0, 0.7, 0.4, -0.6, -0.9, 0.5], [0.6, -0.8, 1.0, 0.7, -0.5, 0.9]])
OFF = np.array([-1.3, 0.9, 0.2, -0.6, 1.4, -0.6])
"""Deviations of the functions, standard deviation 1."""


def measured(freq=FREQ, moved=0.0, noise=0.003, seed=0, true=TRUE, damping=DAMPING, proportional=False):
    """Receptances of two modes at six places under one force; the square of each resonance moves with its function."""
    rng, omega = np.random.default_rng(seed), 2 * np.pi * freq[:, None]
    values = np.zeros((len(freq), 6), complex)
    for f, d, shape in zip(true, damping, SHAPES, strict=True):
        own = 2 * np.pi * f * (1 + moved * OFF)
        values += shape * own**2 / (own**2 + 2j * d * own * omega - omega**2)
    size = noise * (np.abs(values) if proportional else np.abs(values).max())
    values = values + size * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    places = tuple(calib.Sensor(k, "z") for k in range(1, 7))
    std = np.full(values.shape, np.nan)[:, :, None]
    return MeasuredFRFs(freq, places, places[:1], "receptance", values[:, :, None], std, synthetic=True)


def poles(freq=TRUE, damping=DAMPING):
    return 2 * np.pi * freq * (-damping + 1j * np.sqrt(1 - damping**2))


@cache
def scattered(moved, seed=0, proportional=False):
    frfs = measured(moved=moved, seed=seed, proportional=proportional)
    return scatter(frfs, most_likely_model(frfs, poles()), 2)


@pytest.mark.medium
def test_the_scatter_between_functions_and_the_means_are_those_of_the_functions():
    found = scattered(1e-3)
    np.testing.assert_allclose(found.between, 1e-3 * OFF.std(ddof=1), rtol=0.25)
    np.testing.assert_allclose(np.abs(found.poles) / (2 * np.pi), TRUE * (1 + 1e-3 * OFF.mean()), rtol=1e-4)
    np.testing.assert_allclose(-found.poles.real / np.abs(found.poles), DAMPING, rtol=5e-3)
    # the standard deviation of a mean over six
    np.testing.assert_allclose(found.freq_std, TRUE * 1e-3 * OFF.std(ddof=1) / np.sqrt(6), rtol=0.3)


@pytest.mark.medium
@pytest.mark.parametrize("proportional", [False, True])
def test_noise_alone_is_no_scatter_whatever_its_level_over_the_lines(proportional):
    for seed in range(4):
        assert np.array_equal(scattered(0.0, seed, proportional).between, [0.0, 0.0])


@pytest.mark.medium
def test_standard_deviations_without_scatter_are_those_of_the_errors():
    off = []
    for found in (scattered(0.0, seed) for seed in range(8)):
        size = np.abs(found.poles)
        off.append((size / (2 * np.pi) - TRUE) / found.freq_std)
        off.append((-found.poles.real / size - DAMPING) / found.damping_std)
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.4


@pytest.mark.medium
def test_functions_with_poles_of_their_own_describe_what_common_poles_do_not():
    frfs, found = measured(moved=2e-3), scattered(2e-3)
    common = most_likely_model(frfs, poles()).synthesised
    noise = np.sqrt(np.mean(np.abs(measured(moved=2e-3, noise=0.0).values - frfs.values) ** 2))
    error = [np.sqrt(np.mean(np.abs(one - frfs.values) ** 2)) for one in (found.synthesised, common)]
    assert error[0] < 1.1 * noise and error[1] > 3 * noise


@pytest.mark.medium
def test_two_poles_of_one_moving_mode_are_one_and_those_of_a_pair_are_two():
    frfs = measured(moved=3e-3)
    split = np.concatenate([poles(TRUE[:1] - 0.15, DAMPING[:1]), poles(TRUE[:1] + 0.15, DAMPING[:1]), poles()[1:]])
    assert without_split(frfs, split, [9, 20, 20]).tolist() == [1, 2]
    pair = np.array([52.0, 52.5])
    close = measured(true=pair, damping=np.array([0.01, 0.01]))
    assert without_split(close, poles(pair, np.array([0.01, 0.01])), [20, 9]).tolist() == [0, 1]


@pytest.mark.medium
def test_modes_of_a_roving_mass_are_as_many_as_there_are_and_say_that_functions_differ():
    found = modes_from_frfs(measured(moved=3e-3))
    assert found.modes.n_modes == 2 and not found.missed and not found.fit["refused"].any()
    np.testing.assert_allclose(found.modes.damping_ratio, DAMPING, rtol=0.01)
    np.testing.assert_allclose(found.fit["scatter"], 3e-3 * OFF.std(ddof=1), rtol=0.25)
    assert "drift" in found.fit["note"].iloc[0] and any("modes 1, 2" in note for note in found.modes.notes)
    assert not modes_from_frfs(measured()).fit["note"].any()


@pytest.mark.slow
def test_thinned_lines_tell_one_moving_mode_as_all_lines_do():
    frfs = measured(np.linspace(40.0, 80.0, 4001), 3e-3, noise=0.01)
    known = replace(frfs, std=np.full(frfs.std.shape, 0.01 * np.abs(measured(noise=0.0).values).max()))
    found, all_lines = modes_from_frfs(known), modes_from_frfs(frfs)
    assert len(found.curves) < 400 and len(all_lines.curves) == 4001 and found.modes.n_modes == 2
    np.testing.assert_allclose(found.fit["scatter"], all_lines.fit["scatter"], rtol=0.05)
    np.testing.assert_allclose(found.modes.freq_std, all_lines.modes.freq_std, rtol=0.1)


@pytest.mark.medium
def test_one_pole_of_two_modes_is_told_from_one_that_moves():
    pair = np.array([52.0, 52.15])  # a seventh of their widths
    close = measured(true=pair, damping=np.array([0.01, 0.01]), noise=0.001)
    middle = poles(np.array([52.07]), np.array([0.0101]))
    found = scatter(close, most_likely_model(close, middle), 1)
    assert found.between[0] > 0 and hidden_pairs(close, middle, found) == (0,)
    assert hidden_pairs(measured(moved=1e-3), poles(), scattered(1e-3)) == ()


@pytest.mark.medium
def test_one_pole_that_describes_its_surroundings_as_well_as_two_is_one():
    """What the model lacks elsewhere in a band, such as modes above it, moves the poles of single functions too."""
    alone = scattered(0.0)
    biased = replace(alone, between=np.array([0.0, 4e-4]), possible=np.array([1e-5, 4e-4]))
    assert hidden_pairs(measured(), poles(), biased) == ()


def test_two_functions_tell_no_scatter():
    frfs = measured(moved=3e-3)
    few = frfs.without(responses=["1z", "2z", "3z", "4z"])
    assert np.isnan(scatter(few, most_likely_model(few, poles()), 2).between).all()
    assert without_split(few, poles(np.array([52.0, 52.2])), [9, 9]).tolist() == [0, 1]
