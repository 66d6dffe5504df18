"""Unnamed local changes: which one is fitted, and how large it is said to be."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.explain import Settings, explain
from calib.missing.local import LocalChange, local_change


def named_part(made, *names):
    """The same subject with some of its local changes being those of parts."""
    return replace(made, atoms=tuple(replace(a, part=a.name) if a.name in names else a for a in made.atoms))


@pytest.fixture
def hidden(toy):
    """A local change that is hidden, another one that nearly says the same, and a run of the search."""

    def run(likeness, *parts):
        made = named_part(toy().alike("A6", "A5", likeness), *parts)
        return explain(made.drawn(np.random.default_rng(1), {"A5": 1.0}))

    return run


def test_a_part_comes_before_what_is_added_at_a_sensor(hidden):
    assert hidden(0.995, "A5", "A6").atom.names == ("A5",)
    found = hidden(0.995, "A6")
    assert found.verdict == "none_explains" and found.atom.names == ("A6",)


def test_what_is_added_at_a_sensor_is_told_where_no_part_comes_near(hidden):
    assert hidden(0.5, "A6").atom.names == ("A5",)


def test_the_size_is_told_with_its_interval(hidden):
    change = local_change(hidden(0.5, "A5").atom)
    assert change.effect.name == "A5" and change.low < 1.0 < change.high
    assert f"about {100 * change.value:.0f} % more [{100 * change.low:.0f}, {100 * change.high:.0f}]" in change.told


def test_what_is_lost_is_told_as_a_share_lost(toy):
    effect = replace(toy().atoms[0], part="damping of the rear right damper")
    assert LocalChange(effect, -0.6, -0.72, -0.45).told.endswith("about 60 % lost [45, 72]")


@pytest.mark.parametrize(
    ("likeness", "size", "verdict", "untold"),
    [
        (0.999, 1.0, "indistinguishable", ("E0", "A5")),
        (0.9, 1.5, "effect", ("E0",)),
        (0.5, 1.5, "effect", ("E0",)),
    ],
)
def test_a_fault_of_the_measurement_is_a_rival_of_an_effect(toy, likeness, size, verdict, untold):
    made = toy().alike("A5", "E0", likeness)
    atoms = tuple(replace(a, of_measurement=a.name == "A5") for a in made.atoms)
    found = explain(replace(made, atoms=atoms).drawn(np.random.default_rng(1), {"E0": size}))
    assert (found.verdict, found.untold, found.credible) == (verdict, untold, ("E0",))
    assert (found.fault is None) == (len(untold) == 1)


def test_a_used_up_budget_hides_no_fault_of_the_measurement(toy):
    made = toy().alike("A5", "E0", 0.999)
    atoms = tuple(replace(a, of_measurement=a.name == "A5") for a in made.atoms)
    found = explain(replace(made, atoms=atoms).drawn(np.random.default_rng(1), {"E0": 1.0}), Settings(budget=3))
    assert found.evaluations > 3 and found.untold == ("E0", "A5")


def test_a_fault_that_explains_clearly_better_forbids_the_name(toy):
    made = toy().alike("A5", "E0", 0.93)
    atoms = tuple(replace(a, of_measurement=a.name == "A5") for a in made.atoms)
    found = explain(replace(made, atoms=atoms).drawn(np.random.default_rng(1), {"A5": 1.5}))
    assert found.verdict == "none_explains" and found.atom.names == ("A5",) and found.untold == ()


def test_what_looks_the_same_and_is_no_fault_of_the_measurement_is_no_rival(toy):
    made = toy().alike("A5", "E0", 0.999)
    found = explain(made.drawn(np.random.default_rng(1), {"E0": 1.0}))
    assert found.verdict == "effect" and found.fault is None


def test_without_any_local_change_nothing_is_named(toy):
    made = toy()
    for atoms, verdict in ((made.atoms, "effect"), ((), "unconfirmed")):
        found = explain(replace(made, atoms=atoms).drawn(np.random.default_rng(1), {"E0": 1.0}))
        assert (found.verdict, found.chosen.names) == (verdict, ("E0",))
        assert found.unrivalled == (not atoms) and found.names_something == bool(atoms)
