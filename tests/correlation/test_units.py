import math

import numpy as np
import pytest

from calib.correlation.units import frequency_hint, response_hints

MODEL = np.array([3.1, 8.7, 9.4, 21.0, 33.0, 47.0, 58.0])


@pytest.mark.parametrize("factor", [2 * math.pi, 60.0, 1e3, 1e6])
@pytest.mark.parametrize("by_shape", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_known_factor_is_reported_on_either_side(factor, by_shape, seed):
    rng = np.random.default_rng(seed)
    seen = np.sort(rng.choice(len(MODEL), 4, replace=False)) if by_shape else np.arange(4)
    measured = MODEL[seen] * np.exp(0.05 * rng.normal(size=4)) * factor
    mac = np.full((4, len(MODEL)), 0.1)
    mac[np.arange(4), seen] = 0.9
    mac[3] = 0.2  # one without a partner
    given = mac if by_shape else None
    word = f"{factor:.3g}"
    assert word in frequency_hint(measured, MODEL, given)
    # a free structure: rigid-body modes before the others
    if not by_shape:
        assert word in frequency_hint(measured / factor**2, np.concatenate([np.full(6, 1e-6), MODEL]))


@pytest.mark.medium
def test_ordinary_errors_give_no_hint():
    """Models off by up to a factor of two in frequency, modes missing on either side: one in a hundred at most."""
    hints = 0
    rng = np.random.default_rng(4)
    beams = (np.arange(1, 9) - 0.5) ** 2  # the first two are a factor of 9 apart
    for _ in range(1000):
        model = beams if rng.random() < 0.5 else np.sort(rng.uniform(1, 60, 8))
        seen = np.sort(rng.choice(8, rng.integers(2, 7), replace=False))
        scale = np.exp(rng.uniform(-math.log(2), math.log(2)))
        measured = model[seen] * scale * np.exp(0.1 * rng.normal(size=len(seen)))
        shift = int(rng.integers(0, 3))
        hints += frequency_hint(measured, model[shift:]) is not None
    assert hints <= 10


def test_responses_far_from_the_model_are_reported():
    model = {"freq_1": 1.0, "freq_2": 2.0, "freq_3": 3.0, "mass": 1200.0, "sag": 0.003, "none": 0.0}
    assert response_hints({name: 1.3 * value for name, value in model.items()}, model) == ()
    (sag,) = response_hints(model | {"sag": 3.0}, model)
    assert "sag" in sag and "1000" in sag
    (mass,) = response_hints(model | {"mass": 1.2e-3}, model)
    assert "mass" in mass and "1e+06" in mass
    scaled = {name: value * (2 * math.pi if name.startswith("freq") else 1.0) for name, value in model.items()}
    (radians,) = response_hints(scaled, model)
    assert "freq_" in radians and "rad/s" in radians
