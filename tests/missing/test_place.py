"""A place is told only where the data themselves single it out."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.decision import decide
from calib.missing.local import local_perturbation
from calib.missing.place import stands_out, takes_enough
from calib.missing.rules import RULES
from tests.missing.verdict_cases import dressed, text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")
NONE = "No single place explains it."


def off_all_places(toy, share):
    """What is missing resembles the effect E0 by ``share`` of its length, and no local perturbation at all.

    The rest of it shows in two modes, so that it is no common factor of all.
    """
    made = toy(effects=3, perturbations=6)
    known = np.column_stack(list(made.columns.values()))
    there = np.isin([row.mode for row in made.rows], ["M0", "M1"])
    other = np.zeros(len(known))
    drawn = np.random.default_rng(5).standard_normal(there.sum())
    other[there] = drawn - known[there] @ np.linalg.lstsq(known[there], drawn, rcond=None)[0]
    own = made.columns["E0"] - known[:, -6:] @ np.linalg.lstsq(known[:, -6:], made.columns["E0"], rcond=None)[0]
    hidden = share * own / np.linalg.norm(own) + np.sqrt(1 - share**2) * other / np.linalg.norm(other)
    return dressed(replace(made, columns={**made.columns, "hidden": hidden}))


@pytest.mark.parametrize("seed", range(4))
def test_no_place_is_told_where_what_is_missing_is_at_none(toy, seed):
    made = off_all_places(toy, 0.6)
    found = decide(made.drawn(np.random.default_rng(seed), {"hidden": 30.0}))
    assert found.verdict in ("none_explains", "partial") and found.base_adequacy.p_family < 0.01
    assert found.perturbation is not None and found.place is None
    assert NONE in text_of(found) and "place:" not in text_of(found)


def test_a_place_that_the_data_single_out_is_told(cases):
    found = cases["none_explains"]
    assert found.place is found.perturbation and found.place.names == ("A7",)
    assert stands_out(found, found.place) and takes_enough(found, found.place)
    assert "Look first at this place: A7" in text_of(found) and NONE not in text_of(found)


def test_without_local_perturbations_no_place_is_denied(cases):
    assert NONE not in text_of(replace(cases["none_explains"], perturbation=None, place=None))


def scored(found, score):
    """The explanation with another score of its place."""
    tests = found.base_adequacy
    z = np.where(np.array(tests.perturbations.owners) == found.perturbation.names[0], score, tests.perturbations.z)
    return replace(found, base_adequacy=replace(tests, perturbations=replace(tests.perturbations, z=z)))


def test_its_score_passes_the_limit_of_so_many(cases):
    found = cases["none_explains"]
    assert stands_out(scored(found, 3.6), found.place)  # 3.4 is the limit for 8 of them
    assert not stands_out(scored(found, 3.0), found.place)
    by_chance = replace(found, base_adequacy=replace(found.base_adequacy, p_perturbations=0.02))
    assert not stands_out(by_chance, found.place)


def moved(found, value, **limits):
    """The place at another magnitude, or with other limits of it."""
    (e,) = found.place.effects
    (name,) = found.place.names
    e = replace(e, magnitude=replace(e.magnitude, **limits))
    fit = found.place.fit
    return replace(found.place, effects=(e,), fit=replace(fit, values={**fit.values, name: value}))


def test_its_interval_excludes_zero(cases):
    found = cases["none_explains"]
    change = local_perturbation(found.place)
    half = (change.high - change.low) / 2
    assert stands_out(found, moved(found, 1.1 * half)) and stands_out(found, moved(found, -1.1 * half))
    assert not stands_out(found, moved(found, 0.9 * half)) and not stands_out(found, moved(found, -0.9 * half))


def test_no_limit_holds_its_magnitude(cases):
    found = cases["none_explains"]
    value = local_perturbation(found.place).value
    assert value > 0 and stands_out(found, moved(found, value, upper=2 * value))
    assert not stands_out(found, moved(found, value, upper=value))


def test_it_takes_a_share_of_the_sum_of_squares(cases):
    found = cases["none_explains"]
    base = found.base.fit

    def taking(share):
        left = np.full(len(base.residual), np.sqrt((1 - share) * base.misfit / len(base.residual)))
        own = found.place.fit
        return replace(found.place, fit=replace(own, residual=left, shift=np.zeros_like(own.shift)))

    assert takes_enough(found, taking(1.01 * RULES.least_share))
    assert not takes_enough(found, taking(0.99 * RULES.least_share))


@pytest.mark.medium
def test_a_partial_explanation_takes_a_share_too(toy):
    """An effect of strong evidence that lowers a huge misfit by less than a fiftieth is not a part of it."""
    made = off_all_places(toy, 0.12)
    for seed in range(3):
        found = decide(made.drawn(np.random.default_rng(seed), {"hidden": 60.0}))
        first = found.singles[0]
        taken = 1 - first.fit.misfit / found.base.fit.misfit
        assert found.ln_bayes(first) > 6 and taken < RULES.least_share
        assert found.verdict == "none_explains"
