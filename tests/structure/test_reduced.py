"""A reduced model against the full one."""

import dataclasses
import pickle

import numpy as np
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import AffineMatrix, Term, parameter
from calib.structure.effects.attach import hung_masses, outer_term
from calib.structure.effects.extend import Addition, extend
from calib.structure.modal_model import ModalModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.reduced_matrix import reduce_matrix
from calib.structure.reduction.training import train_basis

POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 4.0}


GRID = ({"h": 1.0, "h_freq": 4.0},)


def basis_of(model, vectors, count=8, reference=None):
    space = model.space
    return Basis(
        vectors=vectors,
        model_fingerprint=model.fingerprint,
        names=space.names,
        reference=np.array([p.value for p in space.parameters]),
        lower=np.array([p.lower for p in space.parameters]),
        upper=np.array([p.upper for p in space.parameters]),
        offset=0.0 if model.stiffness.selected else 1.0,
        count=count,
        freq_max=np.inf,
        damping_max=0.95,
        tolerance=1e-4,
        samples=np.zeros((0, len(space.names))),
        checks=np.zeros((0, 4)),
        seed=1,
    )


def sure(model: ModalModel) -> ModalModel:
    """A reduced model satisfies the protocol for the type checker too."""
    return model


@pytest.fixture(scope="module")
def random_vectors():
    return lambda n, size: np.linalg.qr(np.random.default_rng(3).standard_normal((n, size)))[0]


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("grounded", [True, False])
def test_a_basis_of_all_motions_gives_the_full_model(ladder, random_vectors, damped, grounded):
    model = ladder(damped=damped, grounded=grounded)
    reduced = ReducedModel(model, basis_of(model, random_vectors(60, 60)))
    full, found = model.modes(POINT, 8), sure(reduced).modes(POINT, 8)
    for name in ("natural_freq", "damped_freq", "damping_ratio"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(full, name), rtol=1e-9 if not damped else 1e-6, atol=1e-7
        )
    lifted = reduced.lift(found.shapes)
    sign = np.sign(np.real(np.einsum("ij,ij->j", full.shapes.conj(), lifted)))
    np.testing.assert_allclose(lifted * sign, full.shapes, atol=(1e-3 if damped else 1e-6) * np.abs(full.shapes).max())
    zeros = [[r.kind for r in modes.excluded if r.kind in ("zero", "spin")] for modes in (full, found)]
    assert zeros[0] == zeros[1] == ([] if grounded else ["zero"] * (2 if damped else 1))
    assert np.all(reduced.indicator(POINT, found) < 1e-8)


def test_zero_eigenvalues_are_distinguished_from_spin(ladder, random_vectors, turned):
    model = turned(ladder(grounded=False))
    kinds = {r.kind for r in ReducedModel(model, basis_of(model, random_vectors(60, 60))).modes(POINT, 4).excluded}
    assert kinds == {"spin"}


@pytest.mark.parametrize("damped", [True, False])
def test_its_results_are_those_of_the_full_model_for_the_lifted_shapes(ladder, random_vectors, damped):
    model = ladder(damped=damped)
    reduced = ReducedModel(model, basis_of(model, random_vectors(60, 23)))
    shapes = reduced.modes(POINT, 8).shapes
    lifted = reduced.lift(shapes)
    assert shapes.shape == (23, 8) and reduced.n_dof == 23
    for names in (("lower",), ("tip", "upper"), reduced.clusters, ()):
        np.testing.assert_allclose(
            reduced.energy_shares(POINT, shapes, names), model.energy_shares(POINT, lifted, names), atol=1e-10
        )
    np.testing.assert_allclose(reduced.strain_energy(POINT, shapes), model.strain_energy(POINT, lifted), rtol=1e-10)
    np.testing.assert_allclose(reduced.displacement(shapes), model.displacement(lifted), atol=1e-12)
    sensors = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in (0, 31, 57)]
    np.testing.assert_allclose(reduced.sensor_rows(sensors) @ shapes, model.sensor_rows(sensors) @ lifted, atol=1e-12)
    assert reduced.mesh is model.mesh and reduced.space is model.space and reduced.assumptions == model.assumptions


def test_matrices_and_derivatives_are_projections(ladder, random_vectors):
    model = ladder()
    v = random_vectors(60, 9)
    reduced = ReducedModel(model, basis_of(model, v))
    for found, full in zip(reduced.matrices(POINT), model.matrices(POINT), strict=True):
        np.testing.assert_allclose(found, v.T @ (full @ v), rtol=1e-10, atol=1e-9)
    for name in model.space.names:
        pairs = zip(reduced.matrix_derivatives(POINT, name), model.matrix_derivatives(POINT, name), strict=True)
        for found, full in pairs:
            expected = v.T @ (full @ v)
            np.testing.assert_allclose(found.toarray(), expected, rtol=1e-10, atol=1e-9)
            np.testing.assert_allclose(found @ (1 + 2j * np.eye(9)), expected @ (1 + 2j * np.eye(9)), atol=1e-9)
            np.testing.assert_allclose(abs(found * -3.0), 3 * np.abs(expected), rtol=1e-10, atol=1e-9)


def test_an_extension_equals_a_projection_of_the_extended_model(ladder, random_vectors):
    """Terms, energy shares and derivatives of the base model are shared; those of the effect are added."""
    model, v = ladder(), random_vectors(60, 12)
    inner = ReducedModel(model, basis_of(model, v))
    row = np.eye(60)[7] - np.eye(60)[31]
    magnitude = Parameter("s", 0.0, 0.0, 5e4, "N/m", prior_sd=2e3)
    spring = Effect("s", "s", "", "", magnitude, lambda m: Addition((outer_term("s", [row], parameter("s")),)))
    mass = Parameter("h", 0.0, 0.0, 5.0, "kg", prior_sd=1.0)
    freq = Parameter("h_freq", 5.0, 1.0, 30.0, "Hz")
    hung = Effect("h", "h", "", "", mass, lambda m: hung_masses([np.eye(60)[20]], "h", "h_freq", 0.04), (freq,), GRID)
    found = inner.extended([spring]).extended([hung])
    wider = extend(model, [spring, hung])
    vectors = np.zeros((61, 13))
    vectors[:60, :12], vectors[60, 12] = v, 1.0
    alone = ReducedModel(wider, basis_of(wider, vectors))
    values = {**POINT, "s": 3e3, "h": 0.7, "h_freq": 3.0}
    for a, b in zip(found.matrices(values), alone.matrices(values), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-9)
    for name in wider.space.names:
        for a, b in zip(found.matrix_derivatives(values, name), alone.matrix_derivatives(values, name), strict=True):
            np.testing.assert_allclose(a.toarray(), b.toarray(), rtol=1e-12, atol=1e-9)
            np.testing.assert_allclose(a @ np.eye(13), b.toarray(), rtol=1e-10, atol=1e-9)
    shapes = alone.modes(values, 5).shapes
    shares = [m.energy_shares(values, shapes, m.clusters) for m in (found, alone)]
    np.testing.assert_allclose(*shares, atol=1e-12)
    without = found.energy_shares({**values, "s": 0.0}, shapes, found.clusters)
    assert np.abs(shares[0] - without).max() > 1e-3


def test_terms_with_few_and_many_nonzero_rows_are_projected_the_same_way(random_vectors):
    v, rng = random_vectors(60, 9), np.random.default_rng(3)
    terms = []
    for touched in (3, 40):
        full, at = np.zeros((60, 60)), rng.choice(60, touched, replace=False)
        part = rng.standard_normal((touched, touched))
        full[np.ix_(at, at)] = part + part.T
        terms.append(Term(f"{touched}", sp.csr_array(full), parameter(f"k{touched}")))
    reduced = reduce_matrix(AffineMatrix(60, tuple(terms)), v)
    assert [block.rows is None for block in reduced.blocks] == [False, True]
    values = {"k3": 2.0, "k40": 0.5}
    whole = sum(t.coefficient(values) * t.matrix for t in terms)
    np.testing.assert_allclose(reduced(values), v.T @ whole @ v, atol=1e-12)
    for term in terms:
        found = reduced.derivative(values, f"k{term.name}")
        np.testing.assert_allclose(found.toarray(), v.T @ term.matrix @ v, atol=1e-12)
        np.testing.assert_allclose(found @ np.eye(9), found.toarray(), atol=1e-12)


@pytest.mark.parametrize("damped", [True, False])
def test_frequencies_of_an_undamped_model_are_upper_bounds_and_the_indicator_estimates_the_error(ladder, damped):
    """The modes of another point are a usable but inaccurate basis here."""
    model = ladder(damped=damped)
    shapes = model.modes({**POINT, "k_rung": 1.3, "mass": 0.85}, 14).shapes
    reduced = ReducedModel(model, basis_of(model, np.linalg.qr(np.hstack([shapes.real, shapes.imag + 0]))[0][:, :14]))
    found, full = reduced.modes(POINT, 6), model.modes(POINT, 6)
    lam = [2 * np.pi * (1j * m.damped_freq - m.damping_ratio * m.natural_freq) for m in (found, full)]
    true = np.abs(lam[0] - lam[1]) / np.abs(lam[1])
    estimate = reduced.indicator(POINT, found)
    assert np.max(true) > 1e-6
    if not damped:
        assert np.all(found.natural_freq >= full.natural_freq * (1 - 1e-12))
    large = true > 1e-7
    assert np.all((estimate > 0.3 * true)[large]) and np.all((estimate < 5 * true)[large])


def test_a_basis_of_another_model_is_refused(ladder):
    model = ladder()
    basis = basis_of(model, np.eye(60)[:, :5])
    with pytest.raises(InputError, match="another model"):
        ReducedModel(ladder(damped=False), basis)
    with pytest.raises(InputError, match="9 modes are requested from a basis trained for 8"):
        ReducedModel(model, basis).modes({}, 9)


def test_fingerprints_follow_model_and_basis(ladder):
    model = ladder()
    basis = basis_of(model, np.eye(60)[:, :9])
    same, other = basis_of(model, np.eye(60)[:, :9]), basis_of(model, np.eye(60)[:, 1:10])
    assert basis.digest == same.digest != other.digest
    assert dataclasses.replace(basis, version=2).digest != basis.digest
    prints = {ReducedModel(model, b).fingerprint for b in (basis, same, other)} | {model.fingerprint}
    assert len(prints) == 3


@pytest.mark.slow
def test_it_can_be_pickled(ladder):
    model = ladder()
    reduced = ReducedModel(model, train_basis(model, model.space, 4, seed=1))
    modes = reduced.modes(POINT, 4)
    before = reduced.indicator(POINT, modes)  # its factor is not pickled
    copy = pickle.loads(pickle.dumps(reduced))
    assert copy.fingerprint == reduced.fingerprint
    assert np.array_equal(copy.modes(POINT, 4).shapes, modes.shapes)
    np.testing.assert_array_equal(copy.indicator(POINT, modes), before)
