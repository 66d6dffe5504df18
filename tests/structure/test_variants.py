"""One model for all effects that add no degrees of freedom."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.execution.outcome import NotSent
from calib.execution.shared_store import SharedStore, read
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import parameter
from calib.structure.effects.attach import hung_masses, outer_term
from calib.structure.effects.extend import Addition, extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.effects.variants import Variants
from calib.structure.reduction.effect_basis import effect_basis
from calib.structure.reduction.training import train_basis

N = 20
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 2.0}


def spring(name, a, b):
    row = np.eye(N)[a] - np.eye(N)[b]
    magnitude = Parameter(name, 0.0, 0.0, 5e4, "N/m", prior_sd=2e3)
    return Effect(name, name, "", "", magnitude, lambda m: Addition((outer_term(name, [row], parameter(name)),)))


def hung(name, nodes):
    freq = Parameter(f"{name}_freq", 5.0, 1.0, 30.0, "Hz")
    magnitude = Parameter(name, 0.0, 0.0, 5.0, "kg", prior_sd=1.0)
    rows = [np.eye(N)[k] for k in nodes]
    grid = tuple({name: 1.0, freq.name: f} for f in (4.0, 8.0))
    return Effect(name, name, "", "", magnitude, lambda m: hung_masses(rows, name, freq.name, 0.04), (freq,), grid)


EFFECTS = (spring("s1", 2, 15), hung("h1", [5]), spring("s2", 8, 12), hung("h2", [3, 14]))


@pytest.fixture
def variants(ladder):
    model = ladder(N)
    return Variants(model, EFFECTS, tuple(a.effect for a in perturbations(model, (), POINT, 1.0)))


def test_effects_without_degrees_of_freedom_share_one_model(variants):
    common = variants.with_effects(())
    for names in (("s1",), ("s1", "s2"), ("stiffness of rungs",), ("s2", "mass of fixed")):
        assert variants.with_effects(names) is common
    assert {"s1", "s2", "stiffness of rungs"} <= set(common.space.names) and "h1" not in common.space
    assert common.n_dof == N


def test_effects_with_degrees_of_freedom_have_a_model_for_every_set(variants):
    one, two, both = (variants.with_effects(n) for n in (("h1",), ("h2",), ("h1", "h2")))
    assert [m.n_dof for m in (one, two, both)] == [N + 1, N + 2, N + 3]
    assert variants.with_effects(("h2", "s1", "h1")) is both and variants.with_effects(("s2", "h1")) is one
    assert [variants.added(n) for n in ((), ("s1",), ("h1",), ("h2", "h1", "s1"))] == [0, 0, 1, 3]
    assert variants.added(("mass of fixed",)) == 0


@pytest.mark.parametrize("names", [(), ("s1",), ("h1",), ("h2", "s2"), ("h1", "h2", "s1")])
def test_modes_are_those_of_the_model_with_just_these(variants, names):
    magnitudes = {"s1": 3e3, "s2": 5e3, "h1": 0.7, "h1_freq": 3.0, "h2": 1.3, "h2_freq": 6.0}
    alone = extend(variants.model, [e for e in EFFECTS if e.name in names])
    values = {**POINT, **{n: v for n, v in magnitudes.items() if n[:2] in names}}
    found, expected = variants.with_effects(names).modes(values, 7), alone.modes(values, 7)
    np.testing.assert_allclose(found.natural_freq, expected.natural_freq, rtol=1e-8)
    np.testing.assert_allclose(found.damping_ratio, expected.damping_ratio, rtol=1e-6)


def test_models_that_were_built_are_not_sent(variants):
    built = variants.with_effects(("h1", "h2"))
    store = SharedStore()
    sent, own = read(store.written((variants, built)))
    store.close()
    assert own.n_dof == N + 3 and sent.with_effects(("s1",)).n_dof == N  # that of all effects without them is sent
    with pytest.raises(NotSent):  # what builds it stays here, so that its task is done here
        sent.with_effects(("h1", "h2"))


def test_an_unknown_effect_is_refused(variants):
    with pytest.raises(InputError, match="there is no effect 's9'"):
        variants.with_effects(("s1", "s9"))


@pytest.mark.medium
def test_on_a_reduced_basis(variants):
    model, local = variants.model, perturbations(variants.model, (), POINT, 1.0)
    basis = effect_basis(model, train_basis(model, model.space, 5, seed=1), model.space, EFFECTS, local, seed=2)
    reduced = Variants(model, EFFECTS, tuple(one.effect for one in local), basis)
    assert reduced.with_effects(("s1",)) is reduced.with_effects(())
    assert reduced.with_effects(("h2",)).n_dof == basis.size + 2
    values = {**POINT, "s1": 3e3, "h2": 1.0, "h2_freq": 4.0}
    full = variants.with_effects(("s1", "h2")).modes(values, 7)
    found = reduced.with_effects(("s1", "h2")).modes(values, 7)
    np.testing.assert_allclose(found.natural_freq, full.natural_freq, rtol=2e-3)


def test_an_effect_with_degrees_of_freedom_and_no_grid_is_refused(ladder):
    """Without a grid its signature would be a derivative of a model that lacks its degrees of freedom."""
    size = Parameter("it", 0.0, 0.0, 5.0, "kg", prior_sd=1.0)
    build = lambda model: hung_masses([np.eye(model.n_dof)[3]], "it", "mass", 0.03)  # noqa: E731
    variants = Variants(ladder(20), (Effect("it", "it", "", "", size, build),), ())
    with pytest.raises(InputError, match="effect it: it adds degrees of freedom and has no grid; give it a grid"):
        variants.with_effects([])
