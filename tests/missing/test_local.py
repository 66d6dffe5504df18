"""Choice and magnitude of the fitted local perturbation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.missing.decision import Settings, decide
from calib.missing.local import LocalPerturbation, interval_words, local_perturbation, magnitude_words
from calib.problem.parameter import Parameter


def named_part(made, *names):
    """The toy with some of its local perturbations being those of components."""
    return replace(
        made, perturbations=tuple(replace(a, part=a.name) if a.name in names else a for a in made.perturbations)
    )


@pytest.fixture
def hidden(toy):
    """Explanations of data with a hidden local perturbation, beside another one nearly collinear with it."""

    def run(likeness, *parts):
        made = named_part(toy().correlated("A6", "A5", likeness), *parts)
        return decide(made.drawn(np.random.default_rng(1), {"A5": 1.0}))

    return run


def test_a_component_is_preferred_to_an_addition_at_a_sensor(hidden):
    assert hidden(0.995, "A5", "A6").perturbation.names == ("A5",)
    found = hidden(0.995, "A6")
    assert found.verdict == "none_explains" and found.perturbation.names == ("A6",)


def test_an_addition_at_a_sensor_is_reported_where_no_component_comes_near(hidden):
    assert hidden(0.5, "A6").perturbation.names == ("A5",)


def test_the_magnitude_is_reported_with_its_interval(hidden):
    change = local_perturbation(hidden(0.5, "A5").perturbation)
    assert change.effect.name == "A5" and change.low < 1.0 < change.high
    low, high = 100 * change.low, 100 * change.high
    assert f"about {100 * change.value:.0f} % more (95 %: {low:.0f} to {high:.0f})" in change.in_words


def test_a_loss_is_reported_as_a_percentage(toy):
    effect = replace(toy().perturbations[0], part="damping of the rear right damper")
    assert LocalPerturbation(effect, -0.6, -0.72, -0.45).in_words.endswith("about 60 % lost (95 %: 45 to 72)")


@pytest.mark.parametrize(
    ("likeness", "size", "verdict", "untold"),
    [
        (0.999, 1.0, "indistinguishable", ("E0", "A5")),
        (0.9, 1.5, "effect", ("E0",)),
        (0.5, 1.5, "effect", ("E0",)),
    ],
)
def test_a_measurement_fault_competes_with_an_effect(toy, likeness, size, verdict, untold):
    made = toy().correlated("A5", "E0", likeness)
    perturbations = tuple(replace(a, of_measurement=a.name == "A5") for a in made.perturbations)
    found = decide(replace(made, perturbations=perturbations).drawn(np.random.default_rng(1), {"E0": size}))
    assert (found.verdict, found.equally_good, found.credible) == (verdict, untold, ("E0",))
    assert (found.fault is None) == (len(untold) == 1)


def test_a_measurement_fault_is_fitted_although_the_budget_is_used_up(toy):
    made = toy().correlated("A5", "E0", 0.999)
    perturbations = tuple(replace(a, of_measurement=a.name == "A5") for a in made.perturbations)
    found = decide(
        replace(made, perturbations=perturbations).drawn(np.random.default_rng(1), {"E0": 1.0}), Settings(budget=3)
    )
    assert found.evaluations > 3 and found.equally_good == ("E0", "A5")


def test_no_effect_is_named_when_a_measurement_fault_explains_clearly_better(toy):
    made = toy().correlated("A5", "E0", 0.93)
    perturbations = tuple(replace(a, of_measurement=a.name == "A5") for a in made.perturbations)
    found = decide(replace(made, perturbations=perturbations).drawn(np.random.default_rng(1), {"A5": 1.5}))
    assert found.verdict == "none_explains" and found.perturbation.names == ("A5",) and found.equally_good == ()


def test_a_collinear_local_perturbation_does_not_compete(toy):
    made = toy().correlated("A5", "E0", 0.999)
    found = decide(made.drawn(np.random.default_rng(1), {"E0": 1.0}))
    assert found.verdict == "effect" and found.fault is None


def test_without_any_local_perturbation_nothing_is_named(toy):
    made = toy()
    for perturbations, verdict in ((made.perturbations, "effect"), ((), "unconfirmed")):
        found = decide(replace(made, perturbations=perturbations).drawn(np.random.default_rng(1), {"E0": 1.0}))
        assert (found.verdict, found.chosen.names) == (verdict, ("E0",))
        assert found.uncontested == (not perturbations) and found.names_something == bool(perturbations)


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "words"),
    [
        (63.55, 54.4, 74.2, "kg", "about 64 kg (95 %: 54 to 74)"),
        (11993.0, 11432.0, 12549.0, "N/m", "about 12000 N/m (95 %: 11400 to 12500)"),
        (0.1071, 0.0712, 0.1431, "-", "about 0.107 (95 %: 0.071 to 0.143)"),
        (5.0, 5.0, 5.0, "mm", "about 5 mm"),
        (5.0, math.nan, math.nan, "mm", "about 5 mm"),
    ],
)
def test_a_magnitude_has_as_many_digits_as_its_interval(value, low, high, unit, words):
    assert interval_words(value, low, high, unit) == words


@pytest.mark.parametrize(
    ("unit", "low", "words"),
    [
        ("-", 0.40, "about 0.45 (95 %: 0.40 to 0.50; share of its damping that is lost)"),
        ("-", math.nan, "about 0.45 (share of its damping that is lost)"),
        ("kg", 0.40, "about 0.45 kg (95 %: 0.40 to 0.50)"),
    ],
)
def test_a_magnitude_without_a_unit_is_told_with_what_it_is(unit, low, words):
    p = Parameter("weak", 0.0, 0.0, 1.0, unit, description="share of its damping that is lost")
    assert magnitude_words(p, 0.45, low, 0.50) == words
