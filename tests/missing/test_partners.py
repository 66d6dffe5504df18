"""Strengths at which an effect is tried for what it pairs."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from calib.effect import Effect
from calib.missing.anew import _starts
from calib.missing.partners import tried_points
from calib.missing.refits import DEFAULT, Refits
from calib.space import Parameter


def effect(lower, upper, nuisance=(), grid=()):
    strength = Parameter("k", 0.0, lower, upper, "N/m", prior_sd=1e4)
    return Effect("k", "Spring", "It is left out.", "Look there.", strength, lambda model: None, nuisance, grid)


def test_decades_about_the_plausible_strength_within_its_limits():
    assert [p["k"] for p in tried_points(effect(0.0, 2e5))] == [1e2, 1e3, 1e4, 1e5]
    assert [p["k"] for p in tried_points(effect(-2e3, 1e9))] == [-1e3, -1e2, 1e2, 1e3, 1e4, 1e5, 1e6]


def test_nuisance_parameters_are_those_of_the_grid():
    place = Parameter("x", 1.0, 0.0, 4.0, "m")
    grid = ({"k": 5e3, "x": 3.0}, {"k": 1e4, "x": 1.0}, {"k": 2e4, "x": 1.0})
    points = tried_points(effect(0.0, 2e4, (place,), grid))
    np.testing.assert_allclose([(p["x"], p["k"]) for p in points], [(x, k) for x in (1, 3) for k in (1e2, 1e3, 1e4)])


@pytest.fixture
def lost(toy):
    """A toy of which mode M0 has no partner, whatever it predicts, unless E0 is as strong as 5."""
    plain = toy(effects=3, atoms=4)
    first = np.array([row.mode == "M0" for row in plain.rows])

    @dataclass(frozen=True, eq=False)
    class Lost(type(plain)):
        def answer(self, values):
            paired = values.get("E0", 0.0) >= 5.0
            return np.where(first, 0.0 if paired else -10.0, super().answer({**values, "E0": 0.0}))

        def slope(self, values, name):
            return np.where(first | (name == "E0"), 0.0, super().slope(values, name))

        def unpaired(self, names, values):
            self.count[0] += 1
            return frozenset() if values.get("E0", 0.0) >= 5.0 else frozenset({"M0"})

    return Lost(**{f.name: getattr(plain, f.name) for f in fields(plain)}).drawn(np.random.default_rng(1), {"E0": 10.0})


def test_what_effects_pair_beside_a_fit_is_charged_to_no_budget(lost):
    fits = Refits(lost, DEFAULT, 1.0, lambda words: None)
    beside = fits.trial(("E1",), fits.question(("E1",)).space.values)
    charged, asked = fits.allowance.used, lost.evaluations
    found = fits.scores(beside.state, [e for e in lost.effects if e.name != "E1"])
    assert {"E0": 10.0} in found.points and lost.evaluations - asked > 15
    # All but the change of the data at the point that pairs the mode.
    assert fits.allowance.used - charged == 1


def test_effects_are_asked_where_they_pair_from_the_adopted_values_too(lost):
    """To first order E0 does nothing: only where it pairs the mode is there a start for it."""
    fits = Refits(lost, DEFAULT, 1.0, lambda words: None)
    best = min(_starts(fits, lost.effects), key=lambda start: start[0])
    assert best[1] == "E0" and best[2]["E0"] == 10.0
    (promised,) = {round(p) for p, name, start in _starts(fits, lost.effects) if name == "E0" and start["E0"] == 10.0}
    assert promised < min(p for p, name, _ in _starts(fits, lost.effects) if name != "E0") - 100
