"""Where the data point to a sensor away from the place of the named effect, the verdict says so."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.tables import effects_table
from calib.missing.verdict import verdict_of
from calib.missing.verdict_words import elsewhere
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from tests.missing.verdict_cases import dressed, errors, first

pytestmark = pytest.mark.usefixtures("fewer_samples")


@pytest.fixture(scope="module")
def found(toy):
    """One effect is named, and local perturbations stand out in the base model."""
    named = first(dressed(toy(effects=5)), {"E2": 1.5}, "effect")
    return replace(named, base_adequacy=replace(named.base_adequacy, p_perturbations=0.001))


@pytest.fixture
def best(found):
    scores = found.base_adequacy.perturbations
    return scores.owners[int(np.argmax(scores.magnitude))]


@pytest.fixture
def places(found, best):
    """Every perturbation acts at a sensor 3 m away, the best one 2 m away."""
    names = found.base_adequacy.perturbations.owners
    return {name: ("mass", (2.0 if name == best else 3.0, 0.0, 0.0), f"s{name}") for name in names}


def near(places, best, x):
    other = next(name for name in places if name != best)
    return places | {other: ("mass", (x, 0.0, 0.0), other)}


def test_it_is_told_where_another_sensor_is_nearer_to_the_effect(found, places, best):
    words = elsewhere(found, near(places, best, 1.9), [(0.0, 0.0, 0.0)])
    assert "list of causes" in words and f"{best} fits best (less well than the E2), 2 m away" in words
    assert elsewhere(found, near(places, best, 2.1), [(0.0, 0.0, 0.0)]) == ""
    # an effect that acts at several places is near where any of them is
    assert elsewhere(found, near(places, best, 1.9), [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)]) == ""


def test_a_part_and_a_perturbation_that_noise_may_explain_are_not_pointed_to(found, places, best):
    there, at = near(places, best, 0.5), [(0.0, 0.0, 0.0)]
    assert elsewhere(found, there, at)
    assert elsewhere(found, there | {best: ("mass", (2.0, 0.0, 0.0), "")}, at) == ""
    calm = replace(found, base_adequacy=replace(found.base_adequacy, p_perturbations=0.02))
    assert elsewhere(calm, there, at) == ""
    assert elsewhere(replace(found, verdict="partial"), there, at) == ""


def test_an_effect_whose_place_is_unknown_or_fitted_is_not_contradicted(found, places, best):
    there = near(places, best, 0.5)
    assert elsewhere(found, there, []) == ""
    unknown = {name: (kind, (np.nan,) * 3, sensor) for name, (kind, _, sensor) in places.items()}
    assert elsewhere(found, unknown, [(0.0, 0.0, 0.0)]) == ""
    movable = Effect(
        "E2", "Mass", "None.", "One.", Parameter("E2", 0.0, 0.0, 3.0, "kg", prior_sd=1.0), lambda model: None,
        (Parameter("E2_place", 1.0, 1.0, 2.0, integer=True),),
        tuple({"E2": 1.0, "E2_place": float(k)} for k in (1, 2)), places=("here", "there"),
    )  # fmt: skip
    fitted = replace(found, chosen=replace(found.chosen, effects=(movable,)))
    assert elsewhere(found, there, [(0.0, 0.0, 0.0)])
    assert elsewhere(fitted, there, [(0.0, 0.0, 0.0)]) == ""


def test_it_stands_in_what_to_do_next_before_the_measurement(found):
    told = verdict_of(found, effects_table(found, {}, {}), errors(), pointed="The data point there.")
    assert told.answer.then == "Look for a broken E2. The data point there." and told.answer.then.count("point") == 1
    assert "The data point there." in told.sentences
