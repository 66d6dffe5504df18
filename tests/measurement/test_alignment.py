"""Shapes of several repeats in a common scale and phase, with wrong channels and without motion."""

import numpy as np

from calib.measurement.alignment import aligned_repeats, median_of_repeats

N_REPEATS, N_SENSORS = 4, 9


def shapes(seed=1):
    """Two modes, their largest entry 1, and repeats of them of any scale and phase."""
    rng = np.random.default_rng(seed)
    true = rng.standard_normal((N_SENSORS, 2)) + 1j * rng.standard_normal((N_SENSORS, 2))
    true /= np.abs(true).max(axis=0)
    factor = rng.uniform(0.1, 10, (N_REPEATS, 1, 2)) * np.exp(2j * np.pi * rng.random((N_REPEATS, 1, 2)))
    return true, factor * true


def test_scale_and_phase_are_removed():
    true, stack = shapes()
    found = aligned_repeats(stack)
    np.testing.assert_allclose(found, np.broadcast_to(found[:1], found.shape), rtol=1e-9)
    np.testing.assert_allclose(np.abs(found[0]), np.abs(true), rtol=1e-9)


def test_a_channel_that_is_turned_round_does_not_rotate_the_others():
    _, stack = shapes()
    right = aligned_repeats(stack)
    stack[0, 3] *= -1.0
    found = aligned_repeats(stack)
    others = np.arange(N_SENSORS) != 3
    phase = np.angle(found[0, others] * found[1, others].conj())
    assert np.abs(phase).max() < 0.01
    # least squares would shrink the repeat by half or more
    np.testing.assert_allclose(np.abs(found[:, others]), np.abs(right[:, others]), rtol=0.02)


def test_the_factors_are_those_of_the_trusted_entries():
    _, stack = shapes()
    expected = aligned_repeats(stack)
    trusted = np.ones(stack.shape, dtype=bool)
    trusted[0, :5] = False
    stack[0, :5] = 100.0  # most of a repeat is wrong
    found = aligned_repeats(stack, trusted)
    # the common phase of all repeats is free
    turned = found[1, -1] / expected[1, -1]
    np.testing.assert_allclose(found[0, 5:] / turned, expected[0, 5:], rtol=1e-6)


def test_what_does_not_move_or_was_seen_once_stays_as_it_is():
    _, stack = shapes()
    stack[:, :, 0] = 0.0
    stack[1:, :, 1] = np.nan
    np.testing.assert_array_equal(aligned_repeats(stack), stack)


def test_the_middle_is_the_median_of_the_known_values():
    stack = np.array([1.0 + 5j, 2.0 + 1j, 9.0 + 3j, np.nan])[:, None] * np.ones(2)
    stack[:, 1] = complex(np.nan, np.nan)
    found = median_of_repeats(stack)
    assert found[0] == 2.0 + 3j and np.isnan(found[1])
