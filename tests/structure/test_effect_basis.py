"""Modes with effects on a reduced basis with and without enrichment for them."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import AffineMatrix, parameter
from calib.structure.effects.attach import hung_masses, outer_term
from calib.structure.effects.extend import Addition, extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.eigenproblem.derivatives import mode_derivatives
from calib.structure.reduction.effect_basis import covering_fits, effect_basis
from calib.structure.reduction.growth import Growth
from calib.structure.reduction.reduced import ReducedModel, reference_factor, reference_matrix
from calib.structure.reduction.training import train_basis

pytestmark = pytest.mark.slow

N, COUNT = 120, 6
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 4.0}


def unit(k):
    return np.eye(N)[k]


def spring():
    build = lambda m: Addition((outer_term("spring", [unit(11) - unit(97)], parameter("spring")),))  # noqa: E731
    magnitude = Parameter("spring", 0.0, 0.0, 1e5, "N/m", prior_sd=4e3)
    return Effect("spring", "", "", "", magnitude, build)


def hung():
    freq = Parameter("hung_freq", 1.0, 0.2, 5.0, "Hz")
    build = lambda m: hung_masses([unit(33)], "hung", "hung_freq", 0.03)  # noqa: E731
    grid = tuple({"hung": 3.0, "hung_freq": f} for f in (0.5, 1.0, 2.0))
    return Effect("hung", "", "", "", Parameter("hung", 0.0, 0.0, 30.0, "kg", prior_sd=3.0), build, (freq,), grid)


def tuned():
    freq = Parameter("tuned_freq", 2.0, 0.2, 5.0, "Hz")
    build = lambda m: hung_masses([np.eye(m.n_dof)[50]], "tuned", "tuned_freq", 0.02)  # noqa: E731
    grid = ({"tuned": 1.0, "tuned_freq": 2.0},)
    return Effect("tuned", "", "", "", Parameter("tuned", 0.0, 0.0, 30.0, "kg", prior_sd=3.0), build, (freq,), grid)


def heavy():
    build = lambda m: Addition(mass=(outer_term("heavy", [unit(75)], parameter("heavy")),))  # noqa: E731
    return Effect("heavy", "", "", "", Parameter("heavy", 0.0, -2.0, 40.0, "kg", prior_sd=5.0), build)


MAGNITUDES = {"spring": [{"spring": 1e3}, {"spring": 6e3}], "heavy": [{"heavy": -1.0}, {"heavy": 8.0}]}
MAGNITUDES["hung"] = [{"hung": 2.0, "hung_freq": 0.7}, {"hung": 4.0, "hung_freq": 1.6}]
EFFECTS = (spring(), hung(), heavy())


@pytest.fixture(scope="module")
def made(ladder):
    model = ladder(N)
    trained = train_basis(model, model.space, COUNT, seed=1, tolerance=1e-5)
    sensors = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (20, 45, 77, 110)]
    local = perturbations(model, sensors, {}, float(Growth(model, trained).modes.natural_freq[0]))
    return model, trained, effect_basis(model, trained, model.space, EFFECTS, local, seed=2), local


def errors(model, basis, effect, magnitude):
    """Largest relative error of a frequency and largest 1 - MAC, of modes paired in order."""
    wider = extend(model, [effect])
    values = {**POINT, **magnitude}
    full = wider.modes(values, COUNT)
    reduced = ReducedModel(model, basis).extended([effect])
    found = reduced.modes(values, COUNT)
    a, b = full.shapes[:N], reduced.lift(found.shapes)[:N]
    mac = np.abs(np.einsum("ij,ij->j", a.conj(), b)) ** 2
    mac /= np.einsum("ij,ij->j", a.conj(), a).real * np.einsum("ij,ij->j", b.conj(), b).real
    return np.abs(found.natural_freq / full.natural_freq - 1).max(), np.max(1 - mac)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_modes_with_effects_have_far_smaller_errors(made, effect):
    model, trained, enriched, _ = made
    before = np.array([errors(model, trained, effect, s) for s in MAGNITUDES[effect.name]])
    after = np.array([errors(model, enriched, effect, s) for s in MAGNITUDES[effect.name]])
    assert np.all(after.max(axis=0) < 0.05 * before.max(axis=0))
    assert after[:, 0].max() < 2e-4 and after[:, 1].max() < 1e-3


def test_the_base_model_loses_nothing(made):
    model, trained, enriched, _ = made
    full = model.modes(POINT, COUNT).natural_freq
    for basis in (trained, enriched):
        found = ReducedModel(model, basis).modes(POINT, COUNT).natural_freq
        assert np.abs(found / full - 1).max() < 1e-5
    np.testing.assert_array_equal(enriched.vectors[:, : trained.size], trained.vectors)
    assert enriched.version == trained.version + 1 and enriched.model_fingerprint == model.fingerprint


def test_vectors_are_orthonormal_in_the_energy_product(made):
    model, _, enriched, _ = made
    gram = enriched.vectors.T @ (reference_matrix(model, enriched.reference_values, enriched.offset) @ enriched.vectors)
    np.testing.assert_allclose(gram, np.eye(enriched.size), atol=1e-8)


def test_derivatives_by_local_perturbations_are_represented(made):
    """Change of each shape by a plausible magnitude, relative to the energy of that shape."""
    model, trained, enriched, local = made
    local = [one.effect for one in local]
    wider = extend(model, local)
    values = {p.name: p.value for p in model.space.parameters}
    modes = wider.modes(values, COUNT)
    exact = mode_derivatives(wider, values, modes, [a.name for a in local], range(COUNT)).shapes
    left = []
    for basis in (trained, enriched):
        growth = Growth(model, basis)
        energy = np.einsum("ij,ij->j", modes.shapes.conj(), growth.matrix @ modes.shapes).real
        columns = np.hstack([a.plausible * e / np.sqrt(energy) for a, e in zip(local, exact, strict=True)])
        rest = growth.project_out(np.hstack([columns.real, columns.imag]), basis.vectors)
        left.append(np.einsum("ij,ij->j", rest, growth.matrix @ rest).max())
    assert left[1] < 3e-5 < 0.03 * left[0]


def test_degrees_of_freedom_of_effects_are_basis_vectors(made):
    model, trained, _, _ = made
    wider = extend(model, [hung(), spring()])
    basis = trained.carried(wider.space, wider.n_dof)
    assert basis.vectors.shape == (N + 1, trained.size + 1) and basis.count == trained.count + 1
    np.testing.assert_array_equal(basis.vectors[:N, :-1], trained.vectors)
    assert basis.vectors[N].tolist() == [0.0] * trained.size + [1.0] and not basis.vectors[:N, -1].any()
    assert basis.names == wider.space.names and basis.model_fingerprint == model.fingerprint
    assert basis.reference[-3:].tolist() == [0.0, 1.0, 0.0] and basis.upper[-3:].tolist() == [30.0, 5.0, 1e5]
    assert basis.samples.shape == (len(trained.samples), len(wider.space.names))
    same = trained.carried(model.space, model.n_dof)
    np.testing.assert_array_equal(same.vectors, trained.vectors)


def test_the_factor_of_the_base_model_serves_models_with_effects(made):
    """Where every magnitude is 0, what effects add is apart: static responses are those of the whole model's factor."""
    model, trained, _, _ = made
    once = ReducedModel(model, trained).extended([spring(), hung()])
    for wider in (once, once.extended([tuned()])):
        forces = np.random.default_rng(4).standard_normal((wider.model.n_dof, 3)) * (1 + 2j)
        whole = reference_factor(wider.model, wider.basis.reference_values, wider.basis.offset)
        expected = whole.solve(forces.real) + 1j * whole.solve(forces.imag)
        np.testing.assert_allclose(wider.static_response(forces), expected, rtol=1e-8, atol=1e-12)


def test_looking_whether_fits_are_covered_keeps_no_factor(made):
    model, trained, _, _ = made
    reduced = ReducedModel(model, trained)
    fits = [((), POINT), ((spring(),), {**POINT, "spring": 6e3}), ((hung(),), {**POINT, "hung": 2.0, "hung_freq": 0.7})]
    grown = covering_fits(reduced, fits)
    assert grown.size > trained.size and "_reference_factor" not in vars(reduced)


def test_matrices_with_effects_need_no_pattern_of_their_own(made):
    model, trained, _, local = made
    common = ReducedModel(model, trained).extended([spring(), *(one.effect for one in local)])
    wider = common.extended([hung()])
    values = {**POINT, "spring": 1e3, "hung": 2.0, "hung_freq": 0.7, local[0].effect.name: 0.2}
    found = wider.full_matrices(values)
    assert not any("_pattern" in vars(getattr(wider.model, kind)) for kind in ("stiffness", "damping", "mass"))
    for one, other in zip(found, wider.model.matrices(values), strict=True):
        size = abs(other).max()
        np.testing.assert_allclose(one.toarray(), other.toarray(), rtol=0, atol=1e-14 * size)


def test_terms_of_the_base_model_stay_over_its_own_degrees_of_freedom(made):
    """A reduced model with effects holds no wider copy of every term; its matrices and derivatives are the same."""
    model, trained, _, _ = made
    narrow, wide = ReducedModel(model, trained).extended([hung()]).model, extend(model, [hung()])
    assert {t.matrix.shape[0] for t in narrow.mass.terms} == {N, N + 1} and narrow.stiffness.leading
    assert all(t.matrix.shape[0] == N + 1 for t in wide.mass.terms)
    values = {**POINT, "hung": 2.0, "hung_freq": 0.7}
    for one, other in zip(narrow.matrices(values), wide.matrices(values), strict=True):
        np.testing.assert_array_equal(one.toarray(), other.toarray())
    for name in ("k_upper", "hung", "mass"):
        for one, other in zip(
            narrow.matrix_derivatives(values, name), wide.matrix_derivatives(values, name), strict=True
        ):
            np.testing.assert_array_equal(one.toarray(), other.toarray())
    with pytest.raises(InputError, match="term"):
        AffineMatrix(N + 1, narrow.mass.terms)


def test_same_seed_same_basis(made):
    model, trained, enriched, local = made
    again = effect_basis(model, trained, model.space, EFFECTS, local, seed=2)
    assert again.digest == enriched.digest


def test_without_effects_and_local_perturbations_nothing_is_added(made):
    model, trained, _, _ = made
    assert effect_basis(model, trained, model.space, (), (), seed=2).size == trained.size
