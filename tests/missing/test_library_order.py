"""The verdict does not depend on the order of the library, and a strong signal tells collinear effects apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from calib.missing.decision import Settings, decide

pytestmark = pytest.mark.usefixtures("fewer_samples")


def masses(toy, share, truth, seed=1, size=8.0):
    """Two distributed masses E0 and E3 of either sign, whose signatures correlate."""
    made = toy(effects=5, signed=("E0", "E3"), perturbations=6, size=size).correlated("E3", "E0", share)
    return made.drawn(np.random.default_rng(seed), truth)


@pytest.mark.parametrize("share", [-0.985, 0.985])
@pytest.mark.parametrize("hidden", ["E0", "E3"])
@pytest.mark.parametrize("turned", [False, True])
def test_what_a_strong_signal_tells_apart_is_named(toy, share, hidden, turned):
    one = masses(toy, share, {hidden: 1.5}, size=32.0)
    if turned:
        one = replace(one, effects=one.effects[::-1])
    found = decide(one)
    named = found.base_adequacy.named
    assert abs(named.z[named.best(hidden)]) > 25
    assert found.verdict == "effect" and found.credible == (hidden,)
    assert found.chosen.fit.values[hidden] == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("hidden", ["E0", "E3"])
def test_each_effect_of_a_collinear_group_is_fitted(toy, hidden):
    one = masses(toy, 0.997, {hidden: 2.0})
    found = decide(one)
    assert {"E0", "E3"} in [set(g.names) for g in found.groups]
    assert {("E0",), ("E3",)} <= {t.names for t in found.singles}
    assert found.verdict == "indistinguishable" and set(found.credible) == {"E0", "E3"}


@pytest.fixture(scope="module")
def cases(toy):
    """Cases: grouped, told apart, identical signatures, two effects, few refits, nothing missing."""
    same = toy(effects=5, perturbations=6)
    same = replace(same, columns={**same.columns, "E4": same.columns["E1"]})
    few = Settings(refits=2)
    return [
        (masses(toy, -0.985, {"E3": 1.5}, size=32.0), Settings()),
        (masses(toy, 0.99, {"E0": 1.5}), Settings()),
        (masses(toy, -0.995, {"E3": -1.2}, seed=4), Settings()),
        (same.drawn(np.random.default_rng(2), {"E1": 1.3}), Settings()),
        (same.drawn(np.random.default_rng(3), {"E1": 1.3, "E2": 1.3}), Settings()),
        (same.drawn(np.random.default_rng(5), {"E4": 1.3}), few),
        (same.drawn(np.random.default_rng(6), {}), few),
        (toy(effects=5, bump=True, perturbations=6).drawn(np.random.default_rng(7), {"hung": 1.5, "at": 2.6}), few),
    ]


@pytest.mark.medium
@effort(max_examples=6, deadline=None)
@given(data=st.data())
def test_every_order_of_the_library_gives_the_same_explanation(cases, data):
    one, settings = data.draw(st.sampled_from(cases))
    order = data.draw(st.permutations(one.effects))
    first, other = (
        decide(replace(one, count=[0]), settings),
        decide(replace(one, effects=tuple(order), count=[0]), settings),
    )
    assert other.verdict == first.verdict and set(other.credible) == set(first.credible)
    assert {frozenset(g.names) for g in other.groups} == {frozenset(g.names) for g in first.groups}
    assert {t.names for t in other.candidate_fits} == {t.names for t in first.candidate_fits}
    assert other.base_adequacy.p_family == first.base_adequacy.p_family
    assert [g.effect.name for g in other.groups] == [
        e.name for e in order if e.name in {g.effect.name for g in other.groups}
    ]
    if first.chosen is not None:
        assert other.chosen.names == first.chosen.names
        assert other.chosen.ln_evidence == pytest.approx(first.chosen.ln_evidence, abs=1e-6)
