from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.mac import mac
from calib.measurement.repeats import Repeat, ShapeSet, combine_repeats

NAMES = ("a", "b", "c")


def repeat(shapes, *, freq=(1.0, 2.0, 3.0), names=NAMES, source="r", named=True, std=None, freq_std=None):
    shapes = np.asarray(shapes, dtype=complex)
    sensors = tuple((k + 1, "y") for k in range(len(shapes)))
    n = shapes.shape[1]
    nan = np.full(n, np.nan)
    given = ShapeSet(source, sensors, shapes, np.full(shapes.shape, np.nan) if std is None else std)
    return Repeat(source, names, named, np.array(freq), nan if freq_std is None else freq_std, nan + 0, nan + 0, given)


def test_repeats_that_differ_by_a_complex_factor_have_no_standard_deviation():
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(8, 3)) + 1j * rng.normal(size=(8, 3))
    factors = rng.normal(size=(4, 1, 3)) + 1j * rng.normal(size=(4, 1, 3))
    out = combine_repeats([repeat(truth * f, source=f"r{k}") for k, f in enumerate(factors)])
    np.testing.assert_allclose(out.shape_std, 0.0, atol=1e-14)
    np.testing.assert_allclose(np.abs(out.shapes).max(axis=0), 1.0)
    np.testing.assert_allclose(np.diag(mac(out.shapes, truth)), 1.0)


@pytest.mark.slow
def test_the_deviation_is_that_of_the_mean():
    """Over many sets of four repeats, the reported standard deviation agrees with that of the means."""
    rng = np.random.default_rng(2)
    truth = np.ones((40, 3))
    truth[0] = 3.0  # the largest, to which shapes are scaled
    for complex_noise in (False, True):
        means, stds = [], []
        for _ in range(25):
            noisy = [truth + 0.05 * rng.normal(size=truth.shape) for _ in range(4)]
            if complex_noise:
                noisy = [s + 0.05j * rng.normal(size=truth.shape) for s in noisy]
            out = combine_repeats([repeat(s) for s in noisy])
            means.append(out.shapes[1:] * np.exp(-1j * np.angle(out.shapes[:1])))
            stds.append(out.shape_std[1:])
        expected = 0.05 / 2 / 3  # noise over sqrt(4), over the scale
        assert np.sqrt(np.mean(np.square(stds))) == pytest.approx(expected, rel=0.06)
        assert np.std(np.real(means), axis=0).mean() == pytest.approx(expected, rel=0.09)


def test_frequencies_are_averaged_with_their_standard_deviation():
    shapes = np.eye(3)
    out = combine_repeats([repeat(shapes, freq=(10.0 + d, 20.0, 30.0)) for d in (-1.0, 0.0, 1.0)])
    np.testing.assert_allclose(out.natural_freq, [10, 20, 30])
    np.testing.assert_allclose(out.freq_std, [1 / np.sqrt(3), 0, 0])


def test_modes_are_matched_by_name_when_every_repeat_names_them():
    rng = np.random.default_rng(3)
    shapes = rng.normal(size=(6, 3))
    turned = repeat(2 * shapes[:, ::-1], freq=(3.0, 2.0, 1.0), names=NAMES[::-1])  # scaled: no copy of the first
    out = combine_repeats([repeat(shapes), turned])
    np.testing.assert_allclose(out.freq_std, 0.0)
    np.testing.assert_allclose(out.shape_std, 0.0, atol=1e-14)
    unnamed = combine_repeats([repeat(shapes), repeat(2 * shapes, names=("1", "2", "3"), named=False)])
    np.testing.assert_allclose(unnamed.shape_std, 0.0, atol=1e-14)
    assert combine_repeats([repeat(shapes), turned], mode_names=("p", "q", "r")).names == ("p", "q", "r")


def test_real_shapes_stay_real():
    rng = np.random.default_rng(4)
    shapes = rng.normal(size=(6, 3))
    out = combine_repeats([repeat(shapes + 0.01 * rng.normal(size=(6, 3))) for _ in range(3)])
    assert out.shapes.dtype == complex
    assert not out.shapes.imag.any()
    assert np.all(out.shape_std > 0)


def test_a_mode_that_is_another_one_is_noted():
    shapes = np.eye(4)[:, :3] + 0.01
    out = combine_repeats([repeat(shapes, source="one.uff"), repeat(shapes[:, [0, 2, 1]], source="two.uff")])
    odd = [note for note in out.notes if "MAC" in note]
    assert len(odd) == 2
    assert "mode b of two.uff" in odd[0] and "mode c of two.uff" in odd[1]


def test_a_sensor_that_failed_in_one_repeat_is_averaged_over_the_others():
    shapes = np.arange(1.0, 10.0).reshape(3, 3)
    failed = shapes.astype(complex)
    failed[0] = np.nan
    out = combine_repeats([repeat(shapes), repeat(failed), repeat(2 * shapes)])
    np.testing.assert_allclose(out.shapes, shapes / shapes.max(axis=0))
    only_one = combine_repeats([repeat(shapes), repeat(failed)])
    assert np.isnan(only_one.shape_std[0]).all() and np.isfinite(only_one.shape_std[1:]).all()


def test_deviations_of_a_single_file():
    shapes, std, freq_std = 4 * np.eye(3), np.full((3, 3), 0.4), np.array([0.2, np.nan, 0.1])
    one = repeat(shapes, std=std, freq_std=freq_std)
    np.testing.assert_allclose(combine_repeats([one]).shape_std, 0.1)
    np.testing.assert_allclose(combine_repeats([one]).freq_std, freq_std)
    halved = combine_repeats([one], std_of="repeat", count=4)
    np.testing.assert_allclose(halved.shape_std, 0.05)
    np.testing.assert_allclose(halved.freq_std, freq_std / 2)
    with pytest.raises(InputError, match="number of repeats is not given"):
        combine_repeats([one], std_of="repeat")
    bare = combine_repeats([repeat(shapes)], std_of="repeat")
    assert np.isnan(bare.freq_std).all()
    assert any("standard deviation of the frequencies is unknown" in note for note in bare.notes)
    assert any("standard deviation of the shapes is unknown" in note for note in bare.notes)


def test_what_a_repeat_lacks_is_averaged_over_the_others():
    rng = np.random.default_rng(5)
    shapes = rng.normal(size=(6, 3))
    whole = [repeat(shapes, freq=(1.0, 2.0, 3.0 + d), source=f"r{d}") for d in (-0.01, 0.01)]
    for short in (
        repeat(shapes[:, :2], names=("a", "b"), freq=(1.0, 2.0), source="two"),
        repeat(shapes[:, :2], names=("1", "2"), freq=(1.0, 2.0), source="two", named=False),
    ):
        for given in ([*whole, short], [short, *whole]):
            out = combine_repeats(given)
            last = out.names.index("c") if "c" in out.names else 2
            np.testing.assert_allclose(np.sort(out.natural_freq), [1, 2, 3])
            np.testing.assert_array_equal(np.delete(out.freq_count, last), 3)
            assert out.freq_count[last] == 2 and out.freq_std[last] == pytest.approx(0.01)
            assert np.all(out.shape_count[:, last] == 2)
            assert np.diag(mac(out.shapes, shapes)) == pytest.approx(1.0)
            assert any(f"mode {out.names[last]} (3 Hz) is in 2 of 3 repeats, not in two" in note for note in out.notes)
    fewer = combine_repeats([*whole, repeat(shapes[:4], source="two")])
    np.testing.assert_array_equal(fewer.shape_count, np.repeat([[3], [3], [3], [3], [2], [2]], 3, axis=1))
    np.testing.assert_allclose(fewer.shape_std, 0.0, atol=1e-14)
    assert any("sensor 6y is not in two" in note for note in fewer.notes)


def test_repeats_with_nothing_in_common_are_refused():
    shapes = np.eye(4)[:, :3]
    with pytest.raises(InputError, match=r"two: none of its modes is in another repeat"):
        combine_repeats([repeat(shapes), repeat(shapes), repeat(shapes, names=("d", "e", "f"), source="two")])
    strange = ShapeSet("two", ((7, "x"),), shapes[:1].astype(complex), np.full((1, 3), np.nan))
    with pytest.raises(InputError, match=r"two: none of its sensors is in another repeat"):
        combine_repeats([repeat(shapes), repeat(shapes), replace(repeat(shapes, source="two"), shape_set=strange)])
    with pytest.raises(InputError, match="2 mode names are given for 3"):
        combine_repeats([repeat(shapes)], mode_names=("a", "b"))
