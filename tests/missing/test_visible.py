"""Smallest visible magnitudes, against nonlinear models."""

import math
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.missing.decision import decide
from calib.missing.effect_facts import detectable, smallest_visible, visible_within_limits
from calib.missing.score import scores
from calib.missing.tables import effects_table


@dataclass(frozen=True)
class Bent:
    """The fit problem of the toy with one effect that is a nonlinear function of its magnitude."""

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
    """An effect E0 that changes the data by one standard deviation per unit after projection."""
    made = toy(effects=2, size=1.0).drawn(np.random.default_rng(1), {})
    fit = made.calibrated()
    unit = np.linalg.norm(fit.project_out(made.columns["E0"][:, None]))
    made = replace(made, columns={**made.columns, "E0": made.columns["E0"] / unit})
    return made, made.calibrated()


def magnitude(effect, lower, upper):
    return replace(effect, magnitude=replace(effect.magnitude, lower=lower, upper=upper))


def asked(blind, lower, upper, act):
    made, fit = blind
    fit_problem = made.fit_problem(("E0",))
    return visible_within_limits(Bent(fit_problem, "E0", act), fit, magnitude(made.effects[0], lower, upper))


def test_a_linear_effect_shows_where_its_derivative_predicts(blind):
    made, fit = blind
    assert smallest_visible(scores(fit, made.effects, {}), "E0") == pytest.approx(4.0)
    for limit in (4.1, 8.2, 60.0, 5000.0):
        assert 4.0 <= asked(blind, 0.0, limit, lambda s: s) <= 4.0 * 1.1
    assert asked(blind, 0.0, 3.9, lambda s: s) == math.inf


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("onset", [0.01, 1.0, 30.0, 90.0])
def test_the_smallest_visible_magnitude_is_bracketed_wherever_it_lies(blind, power, onset):
    count = [0]

    def act(s):
        count[0] += 1
        return 4.0 * (s / onset) ** power

    assert onset <= asked(blind, 0.0, 100.0, act) <= onset * 1.15
    assert count[0] <= 12


def test_a_jump_is_bracketed_too(blind):
    assert 3.0 < asked(blind, 0.0, 100.0, lambda s: 50.0 if s > 3.0 else 0.0) <= 3.4


def test_an_effect_that_grows_towards_its_limit_shows_there(blind):
    def share(s):
        return 0.5 * s / (1.0 - s)  # 4 at s = 8/9

    found = asked(blind, 0.0, 0.95, share)
    assert 8 / 9 <= found <= 8 / 9 * 1.1
    assert asked(blind, 0.0, 0.85, share) == math.inf


def test_the_easier_of_two_signs_counts(blind):
    assert asked(blind, -8.0, 8.0, lambda s: s if s > 0 else 3 * s) == pytest.approx(4 / 3, rel=0.1)
    assert asked(blind, -1.0, 8.2, lambda s: s if s > 0 else 3 * s) == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(
    ("last", "limit", "shows"), [(9.7, 10.0, True), (5.0, 8.0, True), (3.0, 8.0, False), (0.0, 8.0, False)]
)
def test_a_model_that_fails_at_its_limit_is_evaluated_below_it(blind, last, limit, shows):
    def fails(s):
        if s > last:
            raise EvaluationError("singular")
        return s

    found = asked(blind, 0.0, limit, fails)
    assert 4.0 <= found <= 4.0 * 1.1 if shows else math.isnan(found)  # unknown where the model cannot be evaluated


@pytest.mark.parametrize("gap", [(3.0, 5.0), (5.0, 7.0), (0.5, 3.8), (4.2, 4.3)])
def test_a_model_that_fails_inside_the_bracket_is_evaluated_nearby(blind, gap):
    """A magnitude at which the model fails does not count as invisible."""

    def fails(s):
        if gap[0] < s < gap[1]:
            raise EvaluationError("singular")
        return s

    found = asked(blind, 0.0, 60.0, fails)
    assert 4.0 <= found <= 1.1 * max(4.0, gap[1] if gap[0] < 4.0 < gap[1] else 4.0)


def test_one_sign_that_shows_suffices_although_the_other_fails(blind):
    def fails(s):
        if s < 0:
            raise EvaluationError("singular")
        return s

    assert asked(blind, -8.0, 8.2, fails) == pytest.approx(4.0, rel=0.1)
    assert math.isnan(asked(blind, -8.0, 3.0, fails))


def test_a_fitted_magnitude_is_not_called_invisible(toy):
    """An effect that grows with the square of its magnitude: at the base model its derivative is small."""
    plain = toy(effects=3, size=8.0)

    @dataclass(frozen=True, eq=False)
    class Growing(type(plain)):
        def _straight(self, values):
            s = values.get("E0", 0.0)
            return super()._straight({**values, "E0": 0.05 * s + s**2})

        def slope(self, values, name):
            return super().slope(values, name) * (0.05 + 2 * values.get("E0", 0.0) if name == "E0" else 1.0)

    made = Growing(**{f.name: getattr(plain, f.name) for f in fields(plain)})
    one = made.drawn(np.random.default_rng(4), {"E0": 1.6})
    found = decide(one)
    (named,) = [t for t in found.singles if t.names == ("E0",)]
    assert found.verdict == "effect" and found.ln_bayes(named) > 20
    magnitude = named.fit.values["E0"]
    first = smallest_visible(found.base_adequacy.named, "E0")
    assert first > 3 * magnitude  # the derivative would predict this
    known = detectable(SimpleNamespace(hypotheses=one), found)
    table = effects_table(found, {}, {}, known).set_index("name")
    assert table.loc["E0", "magnitude_min"] < magnitude and table.loc["E0", "visible"]
