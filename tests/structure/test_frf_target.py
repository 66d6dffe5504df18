"""FRFs on a reduced basis: the error at fresh points, its estimate, loads of the test, effects and derivatives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.affine import parameter
from calib.structure.effects.attach import hung_masses, outer_term
from calib.structure.effects.extend import Addition
from calib.structure.effects.loaded import Load
from calib.structure.frf import frf, frf_derivatives
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.effect_basis import frf_effect_basis
from calib.structure.reduction.frf_target import FRFTarget, error_estimate
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import enrich_basis, space_filling_points, train
from calib.study.loading import module_of
from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]
N = 120
LINES = np.linspace(0.3, 4.0, 20)
POINT = {"k_upper": 61.0, "k_lower": 17.0, "k_rung": 1.1, "c_end": 44.0, "mass": 0.8, "place": 4.0}
MASS = Load(Parameter("carried", 0.5, 0.0, 5.0, "kg", prior_sd=0.5), "mass", np.eye(N)[[20]])


def target_of(model, loads=()):
    """Accelerances of three responses under two forces, with 1 % of their nominal size and a floor."""
    responses, references = np.eye(model.n_dof)[[5, 33, 101]], np.eye(model.n_dof)[[33, 70]]
    nominal = frf(model, {}, LINES, responses, references, "accelerance")
    std = np.hypot(0.01 * np.abs(nominal), 1e-3 * np.abs(nominal).max())
    return FRFTarget(LINES, responses, references, std, "accelerance", loads)


@pytest.fixture(scope="module")
def made(ladder):
    """A ladder, its FRFs, and a basis for them."""
    model = ladder(N)
    target = target_of(model)
    return model, target, train(model, model.space, target, seed=1)


@pytest.mark.medium
def test_the_error_at_fresh_points_is_below_the_tolerance_and_as_estimated(made):
    model, target, basis = made
    reduced = ReducedModel(model, basis)
    assert reduced.n_dof < 0.7 * N
    points = space_filling_points(model.space, 12, np.random.default_rng(77))
    actual = np.array([target.error(reduced, p) for p in points])
    estimate = np.array([target.estimate(reduced, p) for p in points])
    assert actual.max() < target.tolerance
    large = actual > 0.01 * target.tolerance
    assert large.any() and np.all(np.abs(np.log(estimate[large] / actual[large])) < np.log(3))


@pytest.mark.slow
def test_the_error_is_that_of_the_functions_in_standard_deviations(made):
    model, target, _ = made
    poor = ReducedModel(model, train(model, model.space, replace(target, tolerance=0.9), seed=1))
    rows = target.responses, target.references
    full = frf(model, POINT, LINES, *rows, "accelerance")
    own = frf(poor, POINT, LINES, *(r @ poor.basis.vectors for r in rows), "accelerance")
    assert target.error(poor, POINT) == pytest.approx(np.max(np.abs(full - own) / target.std), rel=1e-6)


def chain_on_random_vectors():
    """Six damped masses in a row and two random vectors, orthonormal in the stiffness."""
    row = 2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    chain = StructuralModel.from_matrices(
        2e3 * row, np.eye(6), 0.01 * row + np.diag([5.0, 0, 0, 0, 0, 0]),
        dofs=pd.DataFrame({"node": range(1, 7), "direction": "x"}),
    )  # fmt: skip
    stiffness = chain.matrices({})[0].toarray()
    vectors = np.random.default_rng(4).standard_normal((6, 2))
    vectors = vectors @ np.linalg.inv(np.linalg.cholesky(vectors.T @ stiffness @ vectors).T)
    none = np.zeros(0)
    basis = Basis(
        vectors, chain.fingerprint, (), none, none, none, 0.0, 0, 1.0, np.inf, 0.1, np.zeros((0, 0)),
        np.zeros((0, 4)), 1,
    )  # fmt: skip
    return ReducedModel(chain, basis)


@pytest.mark.parametrize("responses", [[0, 2, 4], [1]])
def test_the_estimate_is_the_dual_weighted_residual_with_the_static_inverse(responses):
    reduced, freq = chain_on_random_vectors(), np.array([0.0, 3.0, 11.0])
    k, c, m = (matrix.toarray() for matrix in reduced.model.matrices({}))
    rows, forces, v = np.eye(6)[responses], np.eye(6)[[1, 5]], reduced.basis.vectors
    found = error_estimate(reduced, {}, freq, rows, forces)
    for line, estimate in zip(freq, found, strict=True):
        z = k + 2j * np.pi * line * c - (2 * np.pi * line) ** 2 * m
        residuals = [side.T - z @ v @ np.linalg.solve(v.T @ z @ v, v.T @ side.T) for side in (rows, forces)]
        expected = residuals[0].T @ np.linalg.solve(k, residuals[1])
        np.testing.assert_allclose(estimate, expected, atol=1e-12 * np.abs(expected).max())
    static = np.linalg.inv(k) - v @ v.T  # where nothing moves dynamically the estimate is the error itself
    np.testing.assert_allclose(found[0], static[np.ix_(responses, [1, 5])], atol=1e-12 * np.abs(static).max())


@pytest.mark.medium
def test_a_basis_records_what_it_was_trained_for_and_how_well_it_is_met(made, tmp_path):
    _, target, basis = made
    table = basis.table()
    last = table[table["round"] == table["round"].max()]
    assert last["indicator"].max() <= 0.5 * target.tolerance
    assert last["error"].dropna().between(0, target.tolerance).all() and last["error"].notna().sum() == 6
    assert basis.request == target.request and basis.tolerance == target.tolerance and basis.freq_max == LINES[-1]
    changed = [replace(target, std=2 * target.std), replace(target, freq=LINES + 1), replace(target, loads=(MASS,))]
    assert len({target.request, *(one.request for one in changed)}) == 4
    basis.save(tmp_path / "basis.npz")
    assert Basis.load(tmp_path / "basis.npz").digest == basis.digest


@pytest.mark.slow
def test_a_function_that_does_not_matter_asks_for_nothing(made):
    model, target, basis = made
    one = target.std.copy()
    one[:, 1:] = np.inf
    assert train(model, model.space, replace(target, std=one), seed=1).size < basis.size


@pytest.mark.medium
def test_derivatives_are_those_of_the_full_model(made):
    model, target, basis = made
    reduced, names = ReducedModel(model, basis), ("k_lower", "c_end", "mass")
    rows = target.responses, target.references
    full = frf_derivatives(model, POINT, LINES, *rows, names, "accelerance")[1]
    own = frf_derivatives(reduced, POINT, LINES, *(r @ basis.vectors for r in rows), names, "accelerance")[1]
    for slope, near in zip(full, own, strict=True):
        assert np.abs((near - slope) / target.std).max() < 1e-3 * np.abs(slope / target.std).max()


@pytest.mark.slow
def test_loads_of_the_test_are_in_the_target(made, ladder):
    model, plain, without = made
    target = replace(plain, loads=(MASS,))
    space = ParameterSpace((*model.space.parameters, MASS.parameter), model.space.constraints)
    basis = train(model, space, target, seed=1)
    assert basis.names == model.space.names  # those of the load belong to the test
    heavy = {**POINT, "carried": 4.5}
    errors = [target.error(target.posed(ReducedModel(model, b)), heavy) for b in (without, basis)]
    assert errors[1] < target.tolerance < errors[0]
    assert target.error(target.posed(ReducedModel(model, basis)), {**POINT, "carried": 0.0}) < target.tolerance


def spring():
    build = lambda m: Addition((outer_term("spring", [np.eye(N)[11] - np.eye(N)[97]], parameter("spring")),))  # noqa: E731
    return Effect("spring", "", "", "", Parameter("spring", 0.0, 0.0, 1e5, "N/m", prior_sd=4e3), build)


def hung():
    freq = Parameter("hung_freq", 1.0, 0.2, 5.0, "Hz")
    build = lambda m: hung_masses([np.eye(N)[33]], "hung", "hung_freq", 0.03)  # noqa: E731
    grid = tuple({"hung": 3.0, "hung_freq": f} for f in (0.5, 1.0, 2.0))
    return Effect("hung", "", "", "", Parameter("hung", 0.0, 0.0, 30.0, "kg", prior_sd=3.0), build, (freq,), grid)


@pytest.mark.parametrize(("effect", "values"), [(spring(), {"spring": 3e3}), (hung(), {"hung": 4.0, "hung_freq": 0.9})])
def test_effects_meet_the_tolerance_too(made, effect, values):
    model, target, basis = made
    wider = frf_effect_basis(model, basis, model.space, [effect], target, seed=2)
    assert wider.version == basis.version + 1
    with_it = target.with_effects([effect])
    point = {**POINT, **values}
    errors = [with_it.error(with_it.posed(ReducedModel(model, b)), point) for b in (basis, wider)]
    assert errors[1] < target.tolerance and errors[1] <= errors[0]
    if effect.name == "spring":  # it joins places that the basis has no static response for
        assert errors[0] > target.tolerance


@pytest.mark.medium
def test_enriching_meets_the_tolerance_outside_of_the_limits(made):
    model, target, _ = made
    narrow = train(model, model.space.keep(["mass"]), target, seed=1)
    outside = model.space.complete(POINT)
    wider = enrich_basis(model, narrow, [outside], target)
    errors = [target.error(ReducedModel(model, b), outside) for b in (narrow, wider)]
    assert errors[1] < target.tolerance < errors[0] and wider.version == 2


@pytest.mark.slow
def test_the_bogie_over_its_limits():
    study = LoadedStudy.load(ROOT / "studies" / "hidden_bogie")
    model, space = study.model, study.search_space
    rows = model.sensor_rows(module_of(ROOT / "studies" / "bogie" / "make_twin.py").sensors())
    freq = np.arange(4.0, 50.0, 2.0)
    nominal = frf(model, space.values, freq, rows, rows[[0, 10]], "accelerance")
    target = FRFTarget(freq, rows, rows[[0, 10]], np.hypot(0.005 * np.abs(nominal), 5e-6), "accelerance")
    basis = train(model, space, target, seed=1)
    reduced = ReducedModel(model, basis)
    assert reduced.n_dof < 170
    points = space_filling_points(space, 8, np.random.default_rng(9))
    assert max(target.error(reduced, p) for p in points) < target.tolerance
