"""Strengths from which effects show, against models that saturate."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.errors import EvaluationError
from calib.missing.score import scores
from calib.missing.visible import smallest_visible, visible_within_limits


@dataclass(frozen=True)
class Bent:
    """The toy's question with one effect whose strength acts through a function of itself."""

    inner: object
    name: str
    act: object

    @property
    def space(self):
        return self.inner.space

    def residual(self, values):
        return self.inner.residual({**values, self.name: self.act(values[self.name])})


@pytest.fixture(scope="module")
def blind(toy):
    """An effect E0 that moves the data by a standard deviation a unit, once the parameters have followed."""
    made = toy(effects=2, size=1.0).drawn(np.random.default_rng(1), {})
    state = made.calibrated()
    unit = np.linalg.norm(state.outside(made.columns["E0"][:, None]))
    made = replace(made, columns={**made.columns, "E0": made.columns["E0"] / unit})
    return made, made.calibrated()


def strength(effect, lower, upper):
    return replace(effect, strength=replace(effect.strength, lower=lower, upper=upper))


def asked(blind, lower, upper, act):
    made, state = blind
    question = made.question(("E0",))
    return visible_within_limits(Bent(question, "E0", act), state, strength(made.effects[0], lower, upper))


def test_a_straight_effect_shows_where_its_derivative_says(blind):
    made, state = blind
    assert smallest_visible(scores(state, made.effects, {}), "E0") == pytest.approx(4.0)
    assert 4.0 <= asked(blind, 0.0, 8.2, lambda s: s) <= 4.0 + 8.2 / 4
    assert asked(blind, 0.0, 3.9, lambda s: s) == math.inf


def test_one_that_grows_towards_its_limit_shows_there(blind):
    def share(s):
        return 0.5 * s / (1.0 - s)  # 4 at s = 8/9

    found = asked(blind, 0.0, 0.95, share)
    assert 8 / 9 <= found <= 8 / 9 + 0.95 / 4
    assert asked(blind, 0.0, 0.85, share) == math.inf


def test_the_easier_of_two_signs_counts(blind):
    assert asked(blind, -8.0, 8.0, lambda s: s if s > 0 else 3 * s) == pytest.approx(2.0)
    assert asked(blind, -1.0, 8.2, lambda s: s if s > 0 else 3 * s) == pytest.approx(4.1)


def test_where_the_model_fails_nothing_shows(blind):
    def fails(s):
        if s > 5.0:
            raise EvaluationError("singular")
        return s

    assert asked(blind, 0.0, 8.0, fails) == math.inf
