"""Repeats that disagree at one place are named; clean ones are left as they are."""

import numpy as np
import pytest

from calib.measurement.disagreements import value_disagreements
from calib.measurement.outliers import find_outlying
from calib.measurement.repeats import Repeat, ShapeSet, combine_repeats

N_SENSORS, N_MODES = 12, 6
SENSORS = tuple((n, d) for n in range(1, 5) for d in ("x", "y", "z"))
FREQ = np.array([8.0, 12.0, 15.0, 21.0, 34.0, 55.0])
NAMES = tuple("abcdef")
TRUTH = np.random.default_rng(42).normal(size=(N_SENSORS, N_MODES))
SCATTER = 0.01


def repeats(seed, count=5, is_complex=True):
    """Repeats with Gaussian noise; each mode of each file has its own factor."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        noise = rng.normal(size=TRUTH.shape) + (1j * rng.normal(size=TRUTH.shape) if is_complex else 0)
        factor = rng.uniform(0.5, 2, N_MODES) * (np.exp(1j * rng.uniform(0, 6, N_MODES)) if is_complex else 1)
        shapes = (TRUTH + SCATTER * np.abs(TRUTH).max() * noise) * factor
        freq = FREQ * (1 + 0.002 * rng.normal(size=N_MODES))
        damping = 0.02 * np.exp(0.1 * rng.normal(size=N_MODES))
        nothing = np.full(N_MODES, np.nan)
        given = ShapeSet(f"r{k}", SENSORS, shapes.astype(complex), np.full(TRUTH.shape, np.nan))
        out.append(Repeat(f"r{k}", NAMES, True, freq, nothing, damping, nothing, given))
    return out


def places(found):
    return {(d.kind, d.repeat, d.sensor, d.mode) for d in found.disagreements}


def pooled(found):
    return np.sqrt(np.nanmean(found.shape_std**2))


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("is_complex", [True, False])
@pytest.mark.parametrize("count", [3, 5, 10])
def test_clean_repeats_are_not_touched(count, is_complex):
    for seed in range(4):
        given = repeats(seed, count, is_complex)
        robust, plain = (combine_repeats(given, pooling=p) for p in ("robust", "plain"))
        assert robust.disagreements == ()
        for name in ("natural_freq", "freq_std", "damping_ratio", "damping_std", "shapes", "shape_std"):
            np.testing.assert_array_equal(getattr(robust, name), getattr(plain, name))


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, pytest.param(5, marks=pytest.mark.slow), 10])
@pytest.mark.parametrize("bad", [0, 2])
@pytest.mark.parametrize(("factor", "gain"), [(-1.0, -1.0), (0.0, 0.0), (0.5, 0.5)])
def test_a_channel_that_is_wrong_in_one_repeat(count, bad, factor, gain):
    given = repeats(7, count)
    row = SENSORS.index((2, "z"))
    given[bad].shape_set.shapes[row] *= factor
    robust, plain = (combine_repeats(given, pooling=p) for p in ("robust", "plain"))
    assert places(robust) == places(plain) == {("sensor", f"r{bad}", "2z", "")}
    (one,), (kept,) = robust.disagreements, plain.disagreements
    assert one.value == pytest.approx(gain, abs=0.1)
    assert one.left_out and not kept.left_out
    assert np.all(robust.shape_count[row] == count - 1) and np.all(np.delete(robust.shape_count, row, 0) == count)
    clean = combine_repeats(repeats(7, count))
    assert pooled(robust) == pytest.approx(pooled(clean), rel=0.2)
    assert pooled(plain) > 1.5 * pooled(clean)
    assert one.std_with > 3 * one.std_without
    np.testing.assert_allclose(np.abs(robust.shapes), np.abs(clean.shapes), atol=0.02)


@pytest.mark.medium
def test_two_wrong_channels_in_two_repeats_do_not_mask_each_other():
    given = repeats(8)
    for k, row in ((1, 3), (3, 3), (3, 7)):
        given[k].shape_set.shapes[row] *= -1
    names = ["".join(map(str, SENSORS[row])) for row in (3, 7)]
    expected = {("sensor", "r1", names[0], ""), ("sensor", "r3", names[0], ""), ("sensor", "r3", names[1], "")}
    assert places(combine_repeats(given)) == expected


@pytest.mark.parametrize("bad", [0, 3])
def test_a_bad_shape_and_a_bad_entry(bad):
    given = repeats(9)
    rng = np.random.default_rng(0)
    given[bad].shape_set.shapes[:, 2] = rng.normal(size=N_SENSORS) + 1j * rng.normal(size=N_SENSORS)
    given[1].shape_set.shapes[4, 5] *= 3
    found = combine_repeats(given)
    assert places(found) == {("shape", f"r{bad}", "", "c"), ("entry", "r1", "2y", "f")}
    assert found.freq_count.tolist() == [5] * N_MODES  # its frequency agrees with the others
    assert pooled(found) == pytest.approx(pooled(combine_repeats(repeats(9))), rel=0.2)


def test_a_bad_frequency_and_its_effect_on_the_mean():
    given = repeats(10)
    given[4].natural_freq[3] *= 1.1
    robust, plain = (combine_repeats(given, pooling=p) for p in ("robust", "plain"))
    assert places(robust) == {("frequency", "r4", "", "d")}
    (one,) = robust.disagreements
    assert (one.mean_with, one.std_with) == pytest.approx((plain.natural_freq[3], plain.freq_std[3]))
    assert (one.mean_without, one.std_without) == pytest.approx((robust.natural_freq[3], robust.freq_std[3]))
    assert one.value == pytest.approx(given[4].natural_freq[3])
    assert robust.freq_count.tolist() == [5, 5, 5, 4, 5, 5]
    assert robust.natural_freq[3] == pytest.approx(FREQ[3], rel=0.005)


def frequencies(rng, count, modes=5, uneven=0.0):
    """Frequencies (n_repeats, n_modes) with noise of 0.2 %, which differs between modes by a factor exp(uneven)."""
    std = 0.002 * np.exp(uneven * rng.normal(size=modes))
    return np.linspace(8.0, 60.0, modes) * (1 + std * rng.normal(size=(count, modes)))


def value_places(table, robust=True):
    labels, names = [f"r{k}" for k in range(len(table))], [f"m{k}" for k in range(table.shape[1])]
    found = value_disagreements("frequency", labels, names, table, robust)
    assert robust or not any(one.left_out for one in found)
    return {one.index[::2]: one.left_out for one in found}


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(("count", "times", "least"), [(5, 25, 0.95), (5, 10, 0.2), (3, 100, 0.95), (10, 10, 0.9)])
def test_a_far_frequency_is_left_out(count, times, least):
    """Five modes: an outlier changes the standard deviation of its own mode, but not those of the others."""
    rng, runs, left_out = np.random.default_rng(20), 60, 0
    for _ in range(runs):
        table = frequencies(rng, count)
        table[1, 3] *= 1 + 0.002 * times
        left_out += value_places(table).get((1, 3), False)
    assert left_out >= least * runs


@pytest.mark.medium
def test_far_frequencies_of_two_modes_do_not_mask_each_other():
    rng, runs, left_out = np.random.default_rng(21), 60, 0
    for _ in range(runs):
        table = frequencies(rng, 5)
        table[1, 3] *= 1.06
        table[4, 0] *= 0.95
        found = value_places(table)
        left_out += found.get((1, 3), False) and found.get((4, 0), False)
    assert left_out >= 0.9 * runs


@pytest.mark.medium
def test_what_three_repeats_cannot_decide_is_named_and_kept():
    rng, runs, named, kept = np.random.default_rng(22), 60, 0, 0
    for _ in range(runs):
        table = frequencies(rng, 3)
        table[1, 3] *= 1 + 0.002 * 25
        found = value_places(table)
        named += (1, 3) in found
        kept += found.get((1, 3)) is False
    assert named >= 0.9 * runs
    assert kept > 0.3 * runs
    given = repeats(10, 3)
    given[2].natural_freq[3] *= 1.035
    robust, plain = (combine_repeats(given, pooling=p) for p in ("robust", "plain"))
    assert places(robust) == places(plain) == {("frequency", "r2", "", "d")}
    (one,) = robust.disagreements
    assert not one.left_out and one.value == given[2].natural_freq[3]
    assert (one.mean_with, one.std_with) == pytest.approx((plain.natural_freq[3], plain.freq_std[3]))
    assert one.mean_without == pytest.approx(np.mean([r.natural_freq[3] for r in given[:2]]))
    np.testing.assert_array_equal(robust.natural_freq, plain.natural_freq)
    np.testing.assert_array_equal(robust.freq_std, plain.freq_std)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "uneven"),
    [
        (3, 0.0),
        (10, 0.5),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((3, 0.5), (5, 0.0), (5, 0.5), (10, 0.0))),
    ],
)
def test_clean_frequencies_are_rarely_named_and_more_rarely_left_out(count, uneven):
    rng, runs, named, left_out = np.random.default_rng(23), 200, 0, 0
    for k in range(runs):
        found = value_places(frequencies(rng, count, (4, 8, 12)[k % 3], uneven))
        named += bool(found)
        left_out += any(found.values())
    assert named <= 0.05 * runs
    assert left_out <= 0.01 * runs


def test_of_two_repeats_none_is_left_out():
    given = repeats(11, 2)
    given[0].shape_set.shapes[5] *= -1
    given[1].shape_set.shapes[8] *= 0.001
    found = combine_repeats(given)
    by_sensor = {d.sensor: d for d in found.disagreements}
    assert set(by_sensor) == {"2z", "3z"}
    assert by_sensor["3z"].repeat == "r1"
    assert "r0" in by_sensor["2z"].repeat and "r1" in by_sensor["2z"].repeat
    assert not any(d.left_out for d in found.disagreements)
    assert np.all(found.shape_count == 2)
    assert combine_repeats(repeats(11, 2)).disagreements == ()


def test_rounded_values_are_no_outliers():
    """All but one repeat round to the same digits."""
    given = repeats(12)
    for k, one in enumerate(given):
        one.natural_freq[:] = np.round(FREQ, 1) + (0.1 if k == 2 else 0.0) * (np.arange(N_MODES) == 1)
    assert combine_repeats(given).disagreements == ()


@pytest.mark.slow
def test_the_rate_of_false_alarms():
    """Groups of equal standard deviation, or different by a factor e: at most a few of a hundred tables of any size."""
    rng = np.random.default_rng(0)
    for uneven, most in ((0.0, 1), (1.0, 4)):
        alarms = 0
        for k in range(200):
            scale = np.exp(uneven * rng.normal(size=(1, 12, 1)))
            alarms += bool(find_outlying(scale * rng.normal(size=((3, 5)[k % 2], 12, 1))))
        assert alarms <= most


@pytest.mark.medium
@pytest.mark.parametrize(
    ("count", "most"),
    [(3, 1), *(pytest.param(n, m, marks=pytest.mark.slow) for n, m in ((4, 1), (5, 2), (10, 2)))],
)
def test_groups_by_themselves_are_called_outlying_at_the_level(count, most):
    """Two groups give no prior: one step is an exact test but for Bonferroni, several at most double the level."""
    rng, level, runs = np.random.default_rng(31), 0.05, 500
    rate = np.mean([bool(find_outlying(rng.normal(size=(count, 2, 1)), level=level)) for _ in range(runs)])
    doubt = 3 * np.sqrt(level / runs)
    assert level - doubt < rate < most * level + doubt
