"""Where the rest of a misfit sits that something like an effect nearly explains."""

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.missing.decision import decide
from calib.missing.partial import is_simpler_form, minor_beside, remainder_of
from tests.missing.verdict_cases import dressed, text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")


def nearly(toy, of, seed=3):
    """An effect whose real form differs by what a local perturbation does as well; it shows in the rows ``of``."""
    listed = toy(effects=3, perturbations=6)
    column, modes = listed.columns["E1"], np.array([row.mode for row in listed.rows])
    strength = {m: float((column[modes == m] ** 2).sum()) for m in dict.fromkeys(modes)}
    ranked = sorted(strength, key=lambda m: -strength[m])
    other = np.random.default_rng(seed).standard_normal(len(column)) * np.isin(modes, ranked[of])
    other /= np.linalg.norm(other)
    form = column + 0.12 * np.linalg.norm(column) * other
    changed = {"A2": other * np.linalg.norm(listed.columns["A2"]), "hidden": form}
    real = replace(listed, columns={**listed.columns, **changed})
    rng = np.random.default_rng(1)
    for _ in range(40):
        found = decide(real.drawn(rng, {"hidden": 12.0}))
        if is_simpler_form(found):
            return found, [row.mode for row in real.rows]
    raise AssertionError("no draw is nearly explained")


@pytest.fixture(scope="module")
def inside(toy):
    """What is left shows in the two modes that the effect changes most."""
    return nearly(toy, slice(0, 2))


@pytest.fixture(scope="module")
def outside(toy):
    """What is left shows in other modes."""
    return nearly(toy, slice(4, 6))


def places(of_a2):
    """Perturbations on a line, 1 m to 6 m from the effect, but for one."""
    return {f"A{k}": ("stiffness", (of_a2 if k == 2 else 1.0 + k, 0.0, 0.0), "") for k in range(6)}


def test_what_is_left_near_the_place_of_the_effect_is_told_so(inside):
    found, modes = inside
    near, far = (remainder_of(found, places(x), [(0.0, 0.0, 0.0)], modes) for x in (0.3, 12.0))
    assert (
        near.near
        and near.distance < 0.4
        and near.sentence.startswith("What is left sits near it: local stiffness or mass changes ")
    )
    assert not far.near and far.distance > 1 and far.sentence.startswith("What is left sits elsewhere: ")
    both = remainder_of(found, places(12.0), [(0.0, 0.0, 0.0), (12.1, 0.0, 0.0)], modes)
    assert both.near  # an effect may act at several places: the nearest counts


def test_the_distance_is_that_of_the_only_perturbation_that_would_help(inside):
    found, modes = inside
    scores = found.chosen_adequacy.perturbations
    alone = replace(scores, z=np.where(np.array(scores.owners) == "A2", scores.z, 0.0))
    found = replace(found, chosen_adequacy=replace(found.chosen_adequacy, perturbations=alone))
    squares = [0.3**2 if k == 2 else (1.0 + k) ** 2 for k in range(6)]
    known = [squares[int(name[1:])] for name in scores.owners]
    left = remainder_of(found, places(0.3), [(0.0, 0.0, 0.0)], modes)
    assert left.distance == pytest.approx(0.3 / np.sqrt(np.mean(known)), rel=1e-12)


def test_modes_tell_where_it_is_without_places(inside, outside):
    for (found, modes), near in ((inside, True), (outside, False)):
        left = remainder_of(found, {}, [], modes)
        assert math.isnan(left.distance) and left.near is near and 0 < left.expected < 0.7
        assert left.sentence.startswith(
            f"What is left sits {'near it' if near else 'elsewhere'}: the modes that the effect"
        )
        assert left.entries["distance"] is None and left.entries["near"] is near


def test_nothing_is_told_where_nothing_is_known_or_for_another_verdict(inside):
    found, modes = inside
    left = remainder_of(found, {}, [], [""] * len(modes))
    assert left.near is None and not left.sentence
    assert remainder_of(replace(found, verdict="none_explains"), places(0.3), [(0.0, 0.0, 0.0)], modes) is None


def otherwise(toy, small):
    """E1 as it is really built, which differs from the listed form by ``small`` of what E2 does."""
    made = toy(effects=3, perturbations=6)
    hidden = made.columns["E1"] + small * made.columns["E2"]
    return dressed(replace(made, columns={**made.columns, "hidden": hidden}))


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(2))
def test_a_second_effect_of_almost_no_size_is_not_named_beside_the_first(toy, seed):
    """It would leave nothing over; but the first is only built otherwise than listed."""
    found = decide(otherwise(toy, 0.14).drawn(np.random.default_rng(seed), {"hidden": 5.0}))
    # By its plausible size of 1 the second stands by itself.
    assert abs(found.steps.last.candidate_fit.magnitude("E2")[0]) > 0.4
    assert found.verdict == "two_effects" and found.minor == ()
    large = replace_size(otherwise(toy, 0.14), "E2", 6.0)
    found = decide(large.drawn(np.random.default_rng(seed), {"hidden": 5.0}))
    assert found.verdict == "partial" and found.minor == ("E2",) and is_simpler_form(found)
    assert found.chosen.names == ("E1",) and found.credible == ()
    text = text_of(found)
    assert "something like a lack of E1, but not exactly that" in text and "lack of E2" not in text


def replace_size(made, name, size):
    """The toy with another plausible size of one effect."""
    changed = tuple(
        replace(e, magnitude=replace(e.magnitude, upper=50 * size, prior_sd=size)) if e.name == name else e
        for e in made.effects
    )
    return replace(made, effects=changed)


def test_two_real_effects_are_named_whatever_the_second_gains(cases):
    found = cases["two_effects"]
    assert minor_beside(found, found.singles, found.chosen) == () and found.minor == ()
