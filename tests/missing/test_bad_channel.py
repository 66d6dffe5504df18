"""A bad channel is told from an understated standard deviation by the shapes at the other sensors."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.decision import decide
from calib.missing.goodness import common_scale, goodness, lone_sensor, noise_scale
from calib.missing.rules import RULES

pytestmark = pytest.mark.usefixtures("fewer_samples")

BAD = "S3"


def channel(toy, rng, size, noise=1.0):
    """Data of a complete model, one sensor wrong in every mode by ``size`` standard deviations."""
    one = toy.drawn(rng, noise=noise)
    wrong = np.array([row.sensor == BAD for row in one.rows]) * rng.choice((-1.0, 1.0), len(one.rows))
    return replace(one, data=one.data + noise * size * wrong)


@pytest.fixture(scope="module")
def made(toy):
    return toy(modes=10, sensors=16)


@pytest.mark.slow
def test_a_bad_channel_is_no_understated_standard_deviation(made):
    rng, verdicts = np.random.default_rng(1), []
    for _ in range(8):
        one = channel(made, rng, 4.0)
        fit = one.calibrated()
        assert noise_scale(goodness(fit, one)[1]) > 1.1 * RULES.guard  # all modes call for a larger standard deviation
        found = decide(one)
        assert found.credible == () and found.noise_scale == 1.0
        assert found.base_adequacy.sensors["sensor"][0] == BAD
        verdicts.append(found.verdict)
    assert set(verdicts) <= {"misfit_unlocated", "none_explains"} and verdicts.count("misfit_unlocated") >= 5


def test_with_a_bad_channel_the_factor_is_that_of_the_other_sensors(made):
    rng = np.random.default_rng(2)
    for _ in range(8):
        one = channel(made, rng, 6.0, 2.0)
        fit = one.calibrated()
        assert lone_sensor(fit, one, 0.01) == BAD
        assert common_scale(fit, one, 0.01) == pytest.approx(2.0, rel=0.15)
        assert noise_scale(goodness(fit, one)[1]) > 2.5


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_a_sound_sensor_rarely_stands_out(made, noise):
    rng = np.random.default_rng(3)
    drawn = [made.drawn(rng, noise=noise) for _ in range(300)]
    found = [lone_sensor(one.calibrated(), one, 0.05) for one in drawn]
    assert sum(name is not None for name in found) <= 28  # 5 % of 300, and three standard deviations
