"""Modes with effects on a reduced basis that knows them, and on one that does not."""

import numpy as np
import pytest

from calib.effect import Effect
from calib.measurement.modal import Sensor
from calib.space import Parameter
from calib.structure.affine import parameter
from calib.structure.atoms import atoms
from calib.structure.attach import hung_masses, outer_term
from calib.structure.derivatives import mode_derivatives
from calib.structure.effect_basis import effect_basis
from calib.structure.extend import Addition, extend
from calib.structure.reduced import ReducedModel, reference_matrix
from calib.structure.training import Growth, train_basis

N, COUNT = 120, 6
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 4.0}


def unit(k):
    return np.eye(N)[k]


def spring():
    build = lambda m: Addition((outer_term("spring", [unit(11) - unit(97)], parameter("spring")),))  # noqa: E731
    strength = Parameter("spring", 0.0, 0.0, 1e5, "N/m", prior_sd=4e3)
    return Effect("spring", "", "", "", strength, build)


def hung():
    freq = Parameter("hung_freq", 1.0, 0.2, 5.0, "Hz")
    build = lambda m: hung_masses([unit(33)], "hung", "hung_freq", 0.03)  # noqa: E731
    grid = tuple({"hung": 3.0, "hung_freq": f} for f in (0.5, 1.0, 2.0))
    return Effect("hung", "", "", "", Parameter("hung", 0.0, 0.0, 30.0, "kg", prior_sd=3.0), build, (freq,), grid)


def heavy():
    build = lambda m: Addition(mass=(outer_term("heavy", [unit(75)], parameter("heavy")),))  # noqa: E731
    return Effect("heavy", "", "", "", Parameter("heavy", 0.0, -2.0, 40.0, "kg", prior_sd=5.0), build)


STRENGTHS = {"spring": [{"spring": 1e3}, {"spring": 6e3}], "heavy": [{"heavy": -1.0}, {"heavy": 8.0}]}
STRENGTHS["hung"] = [{"hung": 2.0, "hung_freq": 0.7}, {"hung": 4.0, "hung_freq": 1.6}]
EFFECTS = (spring(), hung(), heavy())


@pytest.fixture(scope="module")
def made(ladder):
    model = ladder(N)
    plain = train_basis(model, model.space, COUNT, seed=1, tolerance=1e-5)
    sensors = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (20, 45, 77, 110)]
    local = [a.effect for a in atoms(model, sensors, {}, 0.5)]
    return model, plain, effect_basis(model, plain, model.space, EFFECTS, local, seed=2), local


def errors(model, basis, effect, strength):
    """Largest relative error of a frequency and largest 1 - MAC, of modes paired in order."""
    wider = extend(model, [effect])
    values = {**POINT, **strength}
    full = wider.modes(values, COUNT)
    reduced = ReducedModel(model, basis).extended([effect])
    found = reduced.modes(values, COUNT)
    a, b = full.shapes[:N], reduced.lift(found.shapes)[:N]
    mac = np.abs(np.einsum("ij,ij->j", a.conj(), b)) ** 2
    mac /= np.einsum("ij,ij->j", a.conj(), a).real * np.einsum("ij,ij->j", b.conj(), b).real
    return np.abs(found.natural_freq / full.natural_freq - 1).max(), np.max(1 - mac)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_modes_with_effects_err_far_less(made, effect):
    model, plain, known, _ = made
    before = np.array([errors(model, plain, effect, s) for s in STRENGTHS[effect.name]])
    after = np.array([errors(model, known, effect, s) for s in STRENGTHS[effect.name]])
    assert np.all(after.max(axis=0) < 0.05 * before.max(axis=0))
    assert after[:, 0].max() < 2e-4 and after[:, 1].max() < 1e-3


def test_the_base_model_loses_nothing(made):
    model, plain, known, _ = made
    full = model.modes(POINT, COUNT).natural_freq
    for basis in (plain, known):
        found = ReducedModel(model, basis).modes(POINT, COUNT).natural_freq
        assert np.abs(found / full - 1).max() < 1e-5
    np.testing.assert_array_equal(known.vectors[:, : plain.size], plain.vectors)
    assert known.version == plain.version + 1 and known.model_fingerprint == model.fingerprint


def test_vectors_are_orthonormal_in_the_energy_product(made):
    model, _, known, _ = made
    gram = known.vectors.T @ (reference_matrix(model, known.reference_values, known.offset) @ known.vectors)
    np.testing.assert_allclose(gram, np.eye(known.size), atol=1e-8)


def test_derivatives_by_local_changes_are_held(made):
    """By how much a plausible strength changes each shape, over the energy of that shape."""
    model, plain, known, local = made
    wider = extend(model, local)
    values = {p.name: p.value for p in model.space.parameters}
    modes = wider.modes(values, COUNT)
    exact = mode_derivatives(wider, values, modes, [a.name for a in local], range(COUNT)).shapes
    left = []
    for basis in (plain, known):
        growth = Growth(model, basis)
        energy = np.einsum("ij,ij->j", modes.shapes.conj(), growth.matrix @ modes.shapes).real
        columns = np.hstack([a.plausible * e / np.sqrt(energy) for a, e in zip(local, exact, strict=True)])
        rest = growth.outside(np.hstack([columns.real, columns.imag]), basis.vectors)
        left.append(np.einsum("ij,ij->j", rest, growth.matrix @ rest).max())
    assert left[1] < 3e-5 < 0.03 * left[0]


def test_degrees_of_freedom_of_effects_stand_for_themselves(made):
    model, plain, _, _ = made
    wider = extend(model, [hung(), spring()])
    basis = plain.carried(wider.space, wider.n_dof)
    assert basis.vectors.shape == (N + 1, plain.size + 1) and basis.count == plain.count + 1
    np.testing.assert_array_equal(basis.vectors[:N, :-1], plain.vectors)
    assert basis.vectors[N].tolist() == [0.0] * plain.size + [1.0] and not basis.vectors[:N, -1].any()
    assert basis.names == wider.space.names and basis.model_fingerprint == model.fingerprint
    assert basis.reference[-3:].tolist() == [0.0, 1.0, 0.0] and basis.upper[-3:].tolist() == [30.0, 5.0, 1e5]
    assert basis.samples.shape == (len(plain.samples), len(wider.space.names))
    same = plain.carried(model.space, model.n_dof)
    np.testing.assert_array_equal(same.vectors, plain.vectors)


def test_same_seed_same_basis(made):
    model, plain, known, local = made
    again = effect_basis(model, plain, model.space, EFFECTS, local, seed=2)
    assert again.digest == known.digest


def test_without_effects_and_local_changes_nothing_is_added(made):
    model, plain, _, _ = made
    assert effect_basis(model, plain, model.space, (), (), seed=2).size == plain.size
