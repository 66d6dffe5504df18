"""Full-order modes by correction of reduced ones, against the eigensolution of the full model."""

from dataclasses import replace

import numpy as np
import pytest

from calib.structure.eigenproblem.derivatives import eigenvalues
from calib.structure.reduction import effect_basis, refinement, training
from calib.structure.reduction.mode_target import ModeTarget
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.refinement import modes_near, refined_modes, undamped_count_agrees
from calib.structure.reduction.training import space_filling_points, train_basis

N, COUNT = 120, 6
ACCURACY = 1e-7


@pytest.fixture(scope="module")
def coarse(ladder):
    """A function of a ladder's kind: the model, and a basis of its modes at a single point."""
    made = {}

    def make(damped, grounded):
        if (damped, grounded) not in made:
            model = ladder(N, damped=damped, grounded=grounded)
            basis = train_basis(model, model.space, COUNT, seed=3, tolerance=1e-3)
            made[damped, grounded] = ReducedModel(model, basis)
        return made[damped, grounded]

    return make


def error(modes, full):
    """Largest relative eigenvalue error and largest 1 - MAC, mode by mode."""
    own, other = modes.shapes, full.shapes
    mac = np.abs(np.einsum("ij,ij->j", own.conj(), other)) ** 2
    mac /= np.einsum("ij,ij->j", own.conj(), own).real * np.einsum("ij,ij->j", other.conj(), other).real
    return np.abs(eigenvalues(modes) / eigenvalues(full) - 1).max(), (1 - mac).max()


def lifted(reduced, values):
    modes = reduced.modes(values, COUNT)
    return replace(modes, shapes=reduced.lift(modes.shapes))


@pytest.mark.medium
@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("grounded", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_refined_modes_are_those_of_the_full_model(coarse, damped, grounded):
    reduced = coarse(damped, grounded)
    for values in space_filling_points(reduced.model.space, 2, np.random.default_rng(9)):
        full, refined = reduced.model.modes(values, COUNT), refined_modes(reduced, values, COUNT, ACCURACY)
        before, after = error(lifted(reduced, values), full), error(refined, full)
        assert after[0] < 5 * ACCURACY and after[1] < 20 * ACCURACY  # by an estimate, not a bound
        assert before[0] > 5 * after[0]  # there was something to refine


@pytest.mark.medium
def test_refined_modes_are_scaled_as_solved_ones(coarse):
    reduced = coarse(True, True)
    values = reduced.model.space.values
    modes = refined_modes(reduced, values, COUNT, ACCURACY)
    _, damping, mass = reduced.model.matrices(values)
    lam, shapes = eigenvalues(modes), modes.shapes
    scale = [psi @ (2 * one * (mass @ psi) + damping @ psi) for one, psi in zip(lam, shapes.T, strict=True)]
    np.testing.assert_allclose(scale, 1.0, atol=1e-10)
    free = coarse(False, False)
    (zero,) = refined_modes(free, values, COUNT, ACCURACY).excluded
    assert zero.kind == free.model.modes(values, COUNT).excluded[0].kind


@pytest.mark.medium
def test_each_step_gains_orders_of_magnitude(coarse, monkeypatch):
    reduced = coarse(True, True)
    values = space_filling_points(reduced.model.space, 4, np.random.default_rng(9))[0]
    full = reduced.model.modes(values, COUNT)
    monkeypatch.setattr(refinement, "STEPS", 1)
    once = refined_modes(reduced, values, COUNT, accuracy=1.0)
    assert error(once, full)[0] < 1e-2 * error(lifted(reduced, values), full)[0]
    assert refined_modes(reduced, values, COUNT, accuracy=1e-300) is None  # too few steps: it says so


@pytest.mark.medium
def test_a_mode_that_leaves_the_nearly_critical_ones_is_refined_too(coarse, monkeypatch):
    """Modes above the largest damping ratio are corrected once, and asked again when a step has moved them below."""
    reduced = coarse(True, True)
    seen = 0
    for values in space_filling_points(reduced.model.space, 6, np.random.default_rng(9)):
        full = reduced.model.modes(values, COUNT)
        with monkeypatch.context() as patch:
            patch.setattr(refinement, "STEPS", 1)
            once = refined_modes(reduced, values, COUNT, accuracy=1.0)
        for mode in np.flatnonzero(once.damping_ratio > full.damping_ratio * (1 + 1e-9)):
            limit = (once.damping_ratio[mode] + full.damping_ratio[mode]) / 2
            narrow = ReducedModel(reduced.model, replace(reduced.basis, damping_max=float(limit)))
            found = refined_modes(narrow, values, COUNT, 1e-9)
            if found is not None and found.damping_ratio[mode] < limit:
                seen += 1
                assert abs(eigenvalues(found)[mode] / eigenvalues(full)[mode] - 1) < 5e-9
    assert seen > 2


def lacking(reduced, values, mode):
    """The reduced model without one of its modes at a point: what a basis that never saw it would be."""
    basis, shape = reduced.basis.vectors, reduced.modes(values, COUNT).shapes[:, mode]
    parts = np.column_stack([shape.real, shape.imag]) if np.iscomplexobj(shape) else shape[:, None]
    rest = np.linalg.svd(parts, full_matrices=True)[0][:, parts.shape[1] :]
    return ReducedModel(reduced.model, replace(reduced.basis, vectors=basis @ rest))


@pytest.mark.medium
@pytest.mark.parametrize("damped", [True, False])
def test_a_mode_that_the_basis_lacks_is_counted_and_solved_for(coarse, damped, monkeypatch):
    reduced = coarse(damped, True)
    values = space_filling_points(reduced.model.space, 4, np.random.default_rng(9))[0]
    assert undamped_count_agrees(reduced, values, COUNT)
    blind = lacking(reduced, values, 2)
    full = reduced.model.modes(values, COUNT)
    assert not undamped_count_agrees(blind, values, COUNT)
    found = modes_near(blind, values, COUNT)
    np.testing.assert_array_equal(found.natural_freq, full.natural_freq)
    monkeypatch.setattr(refinement, "refined_modes", lambda *a: pytest.fail("its number is wrong"))
    modes_near(blind, values, COUNT)
    assert ModeTarget(COUNT, np.inf, 0.95, 1e-3).error(blind, values, counted=True) > 1e-3


@pytest.mark.slow
def test_rigid_body_motions_are_counted_too(coarse):
    reduced = coarse(True, False)
    assert undamped_count_agrees(reduced, reduced.model.space.values, COUNT)


@pytest.mark.slow
def test_a_basis_of_refined_snapshots_is_that_of_solved_ones(ladder, monkeypatch):
    model = ladder(N)
    refined = train_basis(model, model.space, COUNT, seed=3)
    solves, original = [], type(model).modes
    monkeypatch.setattr(type(model), "modes", lambda *a: solves.append(1) or original(*a))
    train_basis(model, model.space, COUNT, seed=3)
    few = len(solves)
    monkeypatch.setattr(training, "_FIRST", 10**6)
    solved = train_basis(model, model.space, COUNT, seed=3)
    assert few < 0.6 * (len(solves) - few)
    for values in space_filling_points(model.space, 5, np.random.default_rng(77)):
        full = model.modes(values, COUNT)
        for basis in (refined, solved):
            assert error(lifted(ReducedModel(model, basis), values), full)[0] < 1e-5
    assert abs(refined.size - solved.size) <= 2
    assert effect_basis._REFINED < effect_basis._ERROR
