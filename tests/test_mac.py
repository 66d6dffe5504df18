import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from calib.errors.errors import InputError
from calib.measurement.mac import (
    align,
    best_pairs,
    comac,
    is_real,
    mac,
    macx,
    most_real,
    noise_mac,
    phase_collinearity,
    relative_motion,
)

seeds = st.integers(0, 2**32 - 1)


def random_shapes(seed: int, n: int = 7, m: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, m)) + 1j * rng.standard_normal((n, m))


def direct(x: np.ndarray, y: np.ndarray) -> float:
    return abs(np.vdot(x, y)) ** 2 / (np.vdot(x, x).real * np.vdot(y, y).real)


@given(seeds)
def test_mac_is_the_squared_cosine_and_ignores_scale_and_phase(seed):
    x, y = random_shapes(seed), random_shapes(seed + 1, m=4)
    found = mac(x, y)
    assert found.shape == (3, 4)
    for i in range(3):
        for j in range(4):
            assert found[i, j] == pytest.approx(direct(x[:, i], y[:, j]), abs=1e-12)
    scaled = mac(x * [2e-150, 3j, -1e150 + 1j], y * np.exp(1j * np.arange(4)))
    np.testing.assert_allclose(scaled, found, atol=1e-12)
    np.testing.assert_allclose(np.diag(mac(x, x)), 1.0)


def test_a_conjugate_is_another_shape_for_mac_but_not_for_macx():
    x = random_shapes(3, m=1)
    assert mac(x, x.conj())[0, 0] < 0.9
    assert macx(x, x.conj())[0, 0] == pytest.approx(1.0)
    real = np.random.default_rng(1).standard_normal((5, 2))
    np.testing.assert_allclose(macx(real, real[:, ::-1]), mac(real, real[:, ::-1]))


@given(seeds)
def test_missing_sensors_are_left_out_for_each_pair_alone(seed):
    x, y = random_shapes(seed), random_shapes(seed + 1)
    x[[0, 4], 1] = np.nan
    y[2, 0] = np.nan
    found = mac(x, y)
    for i in range(3):
        for j in range(3):
            both = ~(np.isnan(x[:, i]) | np.isnan(y[:, j]))
            assert found[i, j] == pytest.approx(direct(x[both, i], y[both, j]), abs=1e-12)


@given(seeds, st.floats(0, 2 * np.pi))
def test_a_real_measurement_meets_the_most_real_part_of_a_complex_shape(seed, angle):
    rng = np.random.default_rng(seed)
    x, y = rng.standard_normal((6, 2)), random_shapes(seed, n=6, m=2)
    angles = np.linspace(0, np.pi, 20_001)
    for j in range(2):
        energy = np.sum(np.real(np.exp(1j * angles)[:, None] * y[:, j]) ** 2, axis=1)
        part = np.real(np.exp(1j * angles[np.argmax(energy)]) * y[:, j])  # by search, not by formula
        for i in range(2):
            assert mac(x, y)[i, j] == pytest.approx(direct(x[:, i], part), abs=2e-3)
    # Neither the phase of the model nor a common phase of the measurement matters.
    np.testing.assert_allclose(mac(x * np.exp(1j * angle), y * np.exp(2j * angle)), mac(x, y), atol=1e-9)


def test_alignment_does_not_penalise_phases_that_were_not_measured():
    y = np.array([[1.0 + 0.2j], [-0.8 + 0.3j], [0.5 - 0.4j]])
    measured = most_real(y[:, 0]).real[:, None]
    assert mac(measured, y)[0, 0] == pytest.approx(1.0)
    assert direct(measured[:, 0].astype(complex), y[:, 0]) < 0.95
    assert is_real(measured)[0] and is_real(1j * measured)[0] and not is_real(y)[0]


def test_real_shapes_give_the_textbook_value_and_zero_shapes_give_zero():
    assert mac(np.array([[1.0], [1.0]]), np.array([[1.0], [0.0]]))[0, 0] == pytest.approx(0.5)
    assert mac(np.zeros((3, 1)), np.ones((3, 2))).tolist() == [[0.0, 0.0]]
    assert mac(np.full((3, 1), np.nan), np.ones((3, 1)))[0, 0] == 0.0
    assert mac(np.ones((3, 1)), np.zeros((3, 1)))[0, 0] == 0.0


def test_shapes_of_other_sizes_or_infinite_are_refused():
    with pytest.raises(InputError, match="3 sensors and model shapes 4"):
        mac(np.ones((3, 1)), np.ones((4, 1)))
    with pytest.raises(InputError, match="infinite"):
        mac(np.array([[np.inf]]), np.ones((1, 1)))
    with pytest.raises(InputError, match="3 dimensions"):
        mac(np.ones((1, 1, 1)), np.ones((1, 1)))


@given(seeds)
def test_comac_ignores_scale_and_phase_of_every_mode(seed):
    x, y = random_shapes(seed), random_shapes(seed + 1)
    factors = np.array([3.0, -1j, 1e-5 * (1 + 1j)])
    np.testing.assert_allclose(comac(x * factors, y), comac(x, y), atol=1e-12)
    np.testing.assert_allclose(comac(x, y * factors), comac(x, y), atol=1e-12)
    np.testing.assert_allclose(comac(x, x * factors), 1.0)
    assert np.all((comac(x, y) >= 0) & (comac(x, y) <= 1))


def test_comac_points_at_the_sensor_that_is_inverted_or_exchanged():
    x = random_shapes(2, n=12, m=5)
    y = x.copy()
    y[4] *= -1
    assert comac(x, y)[4] == 0.0
    assert np.all(np.delete(comac(x, y), 4) > 0.95)
    y = x.copy()
    y[[1, 2]] = y[[2, 1]]
    assert set(np.argsort(comac(x, y))[:2]) == {1, 2}


def test_comac_leaves_out_what_was_not_measured():
    x, y = random_shapes(2), random_shapes(3)
    x[6] = np.nan
    y[:, 2] = 0
    found = comac(x, y)
    assert np.isnan(found[6])
    np.testing.assert_allclose(found[:6], comac(x[:6, :2], y[:6, :2]))


def test_comac_of_a_real_measurement_takes_the_models_real_part():
    y = random_shapes(8)
    x = np.column_stack([most_real(v).real for v in y.T])
    np.testing.assert_allclose(comac(x, y), 1.0)


@given(seeds)
def test_align_is_the_least_squares_factor(seed):
    x, y = random_shapes(seed, m=1)[:, 0], random_shapes(seed + 1, m=1)[:, 0]
    expected = np.linalg.lstsq(y[:, None], x, rcond=None)[0][0]
    assert align(x, y) == pytest.approx(expected)
    assert align(x, 1e-200 * y) * 1e-200 == pytest.approx(expected)
    x[0] = np.nan
    assert align(x, y) == pytest.approx(np.linalg.lstsq(y[1:, None], x[1:], rcond=None)[0][0])
    assert align(x, 0 * y) == 0


@pytest.mark.parametrize(("rms", "expected"), [(0.2, 0.971), (0.3, 0.987), (0.5, 0.995), (0.7, 0.998)])
def test_noise_mac_of_the_article_like_noise(rms, expected):
    """Noise of 2.5 % of the largest value in each part, as derived for shapes of a given rms."""
    n = 24
    shape = np.full((n, 1), rms) * np.exp(1j * np.arange(n))[:, None]
    assert noise_mac(shape, np.full((n, 1), 0.025))[0] == pytest.approx(expected, abs=1.2e-3)


@pytest.mark.parametrize("n", [3, 20])
@pytest.mark.parametrize("kind", ["complex", "real", "uneven"])
def test_noise_mac_is_the_mean_mac_of_a_perfect_model(n, kind):
    rng = np.random.default_rng(n)
    shape = rng.standard_normal((n, 1)) + (0 if kind == "real" else 1j) * rng.standard_normal((n, 1))
    std = np.full((n, 1), 0.05)
    if kind == "uneven":
        std[0] = 0.25
    trials = 20_000
    noise = std * (rng.standard_normal((n, trials)) + (0 if kind == "real" else 1j) * rng.standard_normal((n, trials)))
    measured = shape + noise
    loss = 1 - mac(measured, shape)[:, 0]
    predicted = 1 - noise_mac(measured, np.broadcast_to(std, measured.shape))
    assert predicted.mean() == pytest.approx(loss.mean(), rel=0.04)


def test_noise_mac_is_unknown_where_standard_deviation_is():
    shapes = random_shapes(1)
    std = np.full(shapes.shape, 0.01)
    std[0, 0] = np.nan
    shapes[0, 1], std[0, 1] = np.nan, np.nan  # not measured there, so its standard deviation is not needed
    shapes[:, 2] = np.nan
    assert np.isfinite(noise_mac(shapes, std)).tolist() == [False, True, False]


def test_relative_motion_is_that_of_the_largest_sensor_whatever_the_scale():
    shapes = np.array([[3.0 + 4.0j, 0.0], [0.5j, 2.0], [np.nan, 1.0], [0.0, 0.0]])
    expected = [np.sqrt(0.5), np.sqrt((0.1**2 + 1.0) / 2), 0.5, 0.0]
    np.testing.assert_allclose(relative_motion(shapes), expected)
    np.testing.assert_allclose(relative_motion(shapes * np.array([-7.0, 0.01j])), expected)
    assert np.isnan(relative_motion(np.full((2, 3), np.nan))).all() and not len(relative_motion(np.zeros((0, 3))))


def test_phase_collinearity_is_1_for_a_real_shape_of_any_phase_and_falls_with_the_angle():
    real = np.array([1.0, -0.5, 0.3, np.nan])
    even = np.ones(4)  # a uniform motion has no deviation from its mean
    wide = np.array([1.0, 1j, 1.0, 1j])
    shapes = np.column_stack([real * np.exp(0.7j), even * 2j, wide, np.exp(1j * np.radians([10, -10, 10, -10]))])
    mpc, mpd = phase_collinearity(shapes)
    np.testing.assert_allclose(mpc, [1.0, 1.0, 0.0, np.cos(np.radians(20)) ** 2], atol=1e-12)
    np.testing.assert_allclose(mpd[[0, 1, 3]], [0.0, 0.0, 10.0], atol=1e-6)
    assert mpd[2] == pytest.approx(45.0, abs=1e-6)
    alone = phase_collinearity(np.array([[1j], [np.nan], [0.0]]))
    assert np.isnan(alone).all()


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_best_pairs_have_the_largest_sum_of_any_assignment(share):
    rng, clear = np.random.default_rng(3), 0
    for _ in range(200):
        scores = np.where(rng.uniform(size=(n := rng.integers(0, 7, 2))) < share, rng.uniform(size=n), 0.0)
        rows, columns = best_pairs(scores)
        best = linear_sum_assignment(scores, maximize=True)
        wanted = {(i, j) for i, j in zip(*best, strict=True) if scores[i, j] > 0}
        assert {(i, j) for i, j in zip(rows, columns, strict=True) if scores[i, j] > 0} == wanted
        clear += len(rows) == np.count_nonzero(scores.any(axis=1))
    assert clear > 20
