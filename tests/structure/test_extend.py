"""A model with effects against the base model and against matrices assembled by hand."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, SelectedTerm, Term, parameter
from calib.structure.effects.attach import hung_masses, outer_term, soft_mounts
from calib.structure.effects.extend import Addition, addition_of, extend
from calib.structure.model import Assumption, Part

N = 20
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 2.0}


def unit(k):
    return np.eye(N)[k]


def magnitude(name, unit="N/m", size=1e3):
    return Parameter(name, 0.0, 0.0, 50 * size, unit, prior_sd=size)


def effect(name, build, unit="N/m", size=1e3, **more):
    return Effect(name, name, "", "", magnitude(name, unit, size), build, **more)


def spring():
    return effect("spring", lambda m: Addition((outer_term("spring", [unit(4) - unit(15)], parameter("spring")),)))


def heavy():
    def build(model):
        return Addition(mass=(outer_term("heavy", [unit(7)], parameter("heavy")),))

    return effect("heavy", build, "kg", 1.0)


def hung():
    freq = Parameter("hung_freq", 9.0, 2.0, 30.0, "Hz")
    build = lambda m: hung_masses([unit(6), unit(12)], "hung", "hung_freq", 0.05)  # noqa: E731
    return effect("hung", build, "kg", 1.0, nuisance=(freq,), grid=({"hung": 1.0, "hung_freq": 9.0},))


def soft():
    build = lambda m: soft_mounts([unit(2) - unit(12)], "c_end", "soft")  # noqa: E731
    return effect("soft", build, "mm/kN", 100.0)


def guide():
    vectors = {(p,): unit(10 + p) for p in range(1, 6)}
    build = lambda m: Addition(selected=(SelectedTerm("guide", parameter("guide"), ("place",), vectors),))  # noqa: E731
    return effect("guide", build)


def at(model):
    """The point with all magnitudes of the model."""
    return {n: v for n, v in {**POINT, **ON}.items() if n in model.space}


EVERY = (spring, heavy, hung, soft, guide)
ON = {"spring": 4e3, "heavy": 2.0, "hung": 1.5, "hung_freq": 6.0, "soft": 30.0, "guide": 7e3}


@pytest.mark.parametrize("make", EVERY)
def test_at_magnitude_0_it_is_the_base_model(ladder, make):
    model = ladder(N)
    wider = extend(model, [make()])
    more = wider.n_dof - N
    for found, base in zip(wider.matrices(POINT), model.matrices(POINT), strict=True):
        assert (found[:N][:, :N] != base).nnz == 0
        assert abs(found[:N][:, N:]).sum() == abs(found[N:][:, :N]).sum() == 0.0
    own = wider.matrices(POINT)[0].toarray()[N:, N:]
    assert more == 0 or np.linalg.cond(own) < 1e3
    found, base = wider.modes(POINT, 8 + more), model.modes(POINT, 8)
    moving = np.abs(found.shapes[:N]).max(axis=0) > 1e-6 * np.abs(found.shapes).max()
    np.testing.assert_allclose(found.natural_freq[moving][:8], base.natural_freq, rtol=1e-6)
    np.testing.assert_allclose(found.damping_ratio[moving][:8], base.damping_ratio, rtol=1e-5, atol=1e-9)


def test_terms_are_what_was_added(ladder):
    model = ladder(N)
    wider = extend(model, [spring(), heavy(), guide()])
    k, c, m = wider.matrices(at(wider))
    k0, c0, m0 = (a.toarray() for a in model.matrices(POINT))
    b, g = unit(4) - unit(15), unit(12)
    np.testing.assert_allclose(k.toarray(), k0 + 4e3 * np.outer(b, b) + 7e3 * np.outer(g, g), atol=1e-9)
    np.testing.assert_allclose(m.toarray(), m0 + 2.0 * np.outer(unit(7), unit(7)), atol=1e-12)
    np.testing.assert_array_equal(c.toarray(), c0)
    slope = wider.matrix_derivatives(at(wider), "spring")
    np.testing.assert_allclose(slope[0].toarray(), np.outer(b, b), atol=1e-12)


@pytest.mark.parametrize("order", [(4, 3, 2, 1, 0), (2, 0, 3, 4, 1), (3, 2, 1, 0, 4)])
def test_the_order_of_effects_does_not_matter(ladder, order):
    model = ladder(N)
    one = extend(model, [make() for make in EVERY])
    other = extend(model, [EVERY[k]() for k in order])
    a, b = one.modes(at(one), 10), other.modes(at(other), 10)
    np.testing.assert_allclose(a.natural_freq, b.natural_freq, rtol=1e-8)
    np.testing.assert_allclose(a.damping_ratio, b.damping_ratio, rtol=1e-6, atol=1e-10)
    sign = np.sign(np.einsum("ij,ij->j", a.shapes[:N].conj(), b.shapes[:N]).real)
    np.testing.assert_allclose(a.shapes[:N] * sign, b.shapes[:N], atol=1e-5 * np.abs(a.shapes).max())


def test_effects_one_after_the_other_are_the_same_as_together(ladder):
    model = ladder(N)
    together = extend(model, [spring(), heavy(), guide()])
    stepwise = extend(extend(model, [spring()]), [heavy(), guide()])
    for a, b in zip(together.matrices(at(together)), stepwise.matrices(at(stepwise)), strict=True):
        np.testing.assert_array_equal(a.toarray(), b.toarray())
    assert together.fingerprint == stepwise.fingerprint


def test_degrees_of_freedom_of_several_effects_are_separate(ladder):
    model = ladder(N)
    wider = extend(model, [hung(), soft()])
    assert wider.n_dof == N + 3 and len(wider.dofs.node) == len(wider.dofs.direction) == N + 3
    alone = [extend(model, [e]) for e in (hung(), soft())]
    both, first, second = (m.matrices(at(m)) for m in (wider, *alone))
    base = model.matrices(POINT)
    for a, one, two, zero in zip(both, first, second, base, strict=True):
        expected = np.zeros((N + 3, N + 3))
        expected[: N + 2, : N + 2] += one.toarray()
        places = [*range(N), N + 2]
        expected[np.ix_(places, places)] += two.toarray()
        expected[:N, :N] -= zero.toarray()
        np.testing.assert_allclose(a.toarray(), expected, atol=1e-9)
        assert a.toarray()[N : N + 2, N + 2].tolist() == [0.0, 0.0]


def test_sensors_and_displacements_are_those_of_the_base_model(ladder):
    model = ladder(N)
    wider = extend(model, [hung(), soft()])
    sensors = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (0, 6, 19)]
    rows = wider.sensor_rows(sensors)
    np.testing.assert_array_equal(rows, np.hstack([model.sensor_rows(sensors), np.zeros((3, 3))]))
    shapes = np.random.default_rng(1).standard_normal((N + 3, 2))
    np.testing.assert_array_equal(wider.displacement(shapes), model.displacement(shapes[:N]))
    shapes[N:] = 0.0
    np.testing.assert_allclose(
        wider.energy_shares(POINT, shapes, ["tip", "upper"]), model.energy_shares(POINT, shapes[:N], ["tip", "upper"])
    )


def test_the_base_model_is_unchanged(ladder):
    model = ladder(N)
    before = model.fingerprint, model.space.names, model.n_dof
    prints = {extend(model, [make()]).fingerprint for make in EVERY}
    assert (model.fingerprint, model.space.names, model.n_dof) == before
    assert len(prints | {model.fingerprint}) == len(EVERY) + 1
    assert extend(model, [spring()]).fingerprint == extend(model, [spring()]).fingerprint
    assert extend(model, []).fingerprint == model.fingerprint


def test_parameters_parts_and_assumptions_are_added(ladder):
    model = ladder(N)
    part = Part("rungs", "stiffness", model.stiffness.terms[2].matrix, parameter("k_rung"), (0.0, 0.0, 0.0))
    model = replace(model, parts=(part,), assumptions=(Assumption("a", "1", "m", "guessed"),))
    more = replace(hung(), build=lambda m: replace(hung().build(m), assumptions=(Assumption("b", "2", "m", "too"),)))
    wider = extend(model, [more, spring()])
    assert wider.space.names == (*model.space.names, "hung", "hung_freq", "spring")
    assert wider.space.constraints == model.space.constraints
    assert [a.item for a in wider.assumptions] == ["a", "b"]
    assert wider.parts[0].matrix.shape == (N + 2, N + 2)
    assert (wider.parts[0].matrix[:N][:, :N] != part.matrix).nnz == 0


def test_an_addition_that_does_not_fit_is_refused(ladder):
    model = ladder(N)
    with pytest.raises(InputError, match="has 'k_upper' already"):
        extend(model, [effect("k_upper", lambda m: Addition())])
    with pytest.raises(InputError, match="builds NoneType"):
        extend(model, [effect("none", lambda m: None)])
    small = Term("small", sp.csr_array(np.eye(3)), Monomial())
    for kind in ("stiffness", "damping", "mass"):
        with pytest.raises(InputError, match=r"'small' is \(3, 3\), not \(21, 21\)"):
            extend(model, [effect("e", lambda m, kind=kind: Addition(**{kind: (small,)}, n_added=1))])
    vector = SelectedTerm("short", Monomial(), ("place",), {(1,): np.ones(4)})
    with pytest.raises(InputError, match=r"a vector of 'short' is \(4,\), not \(20,\)"):
        extend(model, [effect("e", lambda m: Addition(selected=(vector,)))])


def test_an_effect_is_built_once_for_each_model(ladder):
    built = []
    one = effect("counted", lambda m: built.append(id(m)) or Addition())
    model, other = ladder(), ladder()
    first = addition_of(model, one)
    assert addition_of(model, one) is first and built == [id(model)]
    assert addition_of(other, one) is not first and built == [id(model), id(other)]
    again = effect("counted", one.build)  # of the same name, and another effect
    assert addition_of(model, again) is not first and len(built) == 3
    copy = pickle.loads(pickle.dumps(model))  # a function written on the spot goes nowhere
    assert copy.fingerprint == model.fingerprint and not copy.additions and model.additions


def test_an_error_in_the_function_of_an_effect_names_the_effect(ladder):
    def build(problem, **more):
        def fail(model):
            raise InputError(problem, **more)

        return effect("stay", fail)

    with pytest.raises(InputError) as fault:
        extend(ladder(N), [build("the model has no part 'fram'", place="frame", remedy="its parts are frame")])
    assert str(fault.value) == "effect stay, frame: the model has no part 'fram'; its parts are frame."
    with pytest.raises(InputError) as fault:
        extend(ladder(N), [build("too far")])
    assert str(fault.value) == "effect stay: too far."


def test_the_same_effect_twice_is_refused(ladder):
    with pytest.raises(InputError):
        extend(ladder(N), [spring(), spring()])
