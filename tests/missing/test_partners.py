"""Points at which an effect pairs further modes."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.missing.partners import tried_points
from calib.missing.refits import Refits
from calib.missing.restarts import _starts
from calib.missing.settings import DEFAULT
from calib.problem.effect import Effect
from calib.problem.space import Parameter


def effect(lower, upper, nuisance=(), grid=()):
    magnitude = Parameter("k", 0.0, lower, upper, "N/m", prior_sd=1e4)
    return Effect("k", "Spring", "It is left out.", "Look there.", magnitude, lambda model: None, nuisance, grid)


def test_decades_about_the_plausible_magnitude_within_its_limits():
    assert [p["k"] for p in tried_points(effect(0.0, 2e5))] == [1e2, 1e3, 1e4, 1e5]
    assert [p["k"] for p in tried_points(effect(-2e3, 1e9))] == [-1e3, -1e2, 1e2, 1e3, 1e4, 1e5, 1e6]


def test_nuisance_parameters_are_those_of_the_grid():
    place = Parameter("x", 1.0, 0.0, 4.0, "m")
    grid = ({"k": 5e3, "x": 3.0}, {"k": 1e4, "x": 1.0}, {"k": 2e4, "x": 1.0})
    points = tried_points(effect(0.0, 2e4, (place,), grid))
    np.testing.assert_allclose([(p["x"], p["k"]) for p in points], [(x, k) for x in (1, 3) for k in (1e2, 1e3, 1e4)])


@pytest.fixture
def lost(toy):
    """A toy whose mode M0 is unpaired unless the magnitude of E0 is at least 5."""
    plain = toy(effects=3, perturbations=4)
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


def test_the_search_for_pairing_points_is_not_charged(lost):
    fits = Refits(lost, DEFAULT, 1.0, silent)
    beside = fits.candidate_fit(("E1",), fits.fit_problem(("E1",)).space.values)
    charged, evaluations = fits.allowance.used, lost.evaluations
    found = fits.scores(beside.fit, [e for e in lost.effects if e.name != "E1"])
    assert {"E0": 10.0} in found.points and lost.evaluations - evaluations > 15
    # Only the difference at the point that pairs the mode is charged.
    assert fits.allowance.used - charged == 1


def test_pairing_points_are_starts_from_the_nominal_values_too(lost):
    """The derivative by E0 is zero: only the point that pairs the mode is a start."""
    fits = Refits(lost, DEFAULT, 1.0, silent)
    best = min(_starts(fits, lost.effects), key=lambda start: start[0])
    assert best[1] == "E0" and best[2]["E0"] == 10.0
    (predicted,) = {round(p) for p, name, start in _starts(fits, lost.effects) if name == "E0" and start["E0"] == 10.0}
    assert predicted < min(p for p, name, _ in _starts(fits, lost.effects) if name != "E0") - 100
