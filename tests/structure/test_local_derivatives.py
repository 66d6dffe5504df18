"""The span of derivatives by local perturbations, against exact derivatives."""

import numpy as np
import pytest

from calib.measurement.modal import Sensor
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import perturbations
from calib.structure.eigenproblem.derivatives import mode_derivatives
from calib.structure.reduction import local_derivatives as module
from calib.structure.reduction.growth import Growth, fewest
from calib.structure.reduction.local_derivatives import LocalDerivatives
from calib.structure.reduction.reduced import reference_matrix
from calib.structure.reduction.training import train_basis

N, COUNT, ERROR = 120, 6, 1e-5


@pytest.fixture(scope="module")
def trained(ladder):
    model = ladder(N)
    return model, train_basis(model, model.space, COUNT, seed=1, tolerance=1e-4)


def locally(model, basis, at=(20, 45, 77, 110)):
    sensors = [Sensor(k, "x", (float(k), 0.0, 0.0)) for k in at]
    return perturbations(model, sensors, {}, float(Growth(model, basis).modes.natural_freq[0]))


def grown(model, basis, local, error=ERROR):
    values = {p.name: p.value for p in model.space.parameters}
    found = LocalDerivatives(Growth(model, basis), basis, values, model.modes(values, basis.count))
    for first in range(0, len(local), module.TOGETHER):
        found.add(local[first : first + module.TOGETHER], error)
    return found


def left(model, basis, vectors, local):
    """Largest squared projection error of the exact derivatives by each perturbation, of plausible magnitude."""
    growth, values = Growth(model, basis), {p.name: p.value for p in model.space.parameters}
    wider = extend(model, [one.effect for one in local])
    modes = model.modes(values, basis.count)
    chosen = np.flatnonzero((modes.natural_freq <= basis.freq_max) & (modes.damping_ratio < basis.damping_max))
    shapes = modes.shapes[:, chosen]
    size = np.sqrt(np.einsum("ij,ij->j", shapes.conj(), growth.matrix @ shapes).real)
    exact = mode_derivatives(wider, values, modes, [one.effect.name for one in local], chosen).shapes
    out = []
    for one, change in zip(local, exact, strict=True):
        columns = change * one.effect.plausible / size
        rest = growth.project_out(np.hstack([columns.real, columns.imag]), vectors)
        out.append(float(np.einsum("ij,ij->j", rest, growth.matrix @ rest).max()))
    return np.array(out)


@pytest.mark.parametrize("error", [3e-5, 1e-6])
def test_exact_derivatives_are_represented_as_accurately_as_asked(trained, error):
    model, basis = trained
    local = locally(model, basis)
    before = left(model, basis, basis.vectors, local)
    after = left(model, basis, grown(model, basis, local, error).vectors, local)
    assert np.count_nonzero(before > 10 * error) >= 3
    assert after.max() < error


def test_static_responses_alone_are_not_enough(trained, monkeypatch):
    """What the equations still lack is found and added: without these rounds the error is larger than allowed."""
    model, basis = trained
    local, error = locally(model, basis), 1e-7
    assert left(model, basis, grown(model, basis, local, error).vectors, local).max() < error
    monkeypatch.setattr(module, "_ROUNDS", 0)
    assert left(model, basis, grown(model, basis, local, error).vectors, local).max() > error


def test_a_perturbation_that_is_represented_adds_nothing(trained):
    model, basis = trained
    local = locally(model, basis)[-4:]
    once = grown(model, basis, local)
    size = once.vectors.shape[1]
    once.add(local, ERROR)
    assert size > basis.size and once.vectors.shape[1] == size


def test_vectors_stay_orthonormal_over_batches_and_the_old_ones_stay(trained, monkeypatch):
    model, basis = trained
    monkeypatch.setattr(module, "TOGETHER", 3)
    found = grown(model, basis, locally(model, basis)).vectors
    energy = reference_matrix(model, basis.reference_values, basis.offset)
    np.testing.assert_allclose(found.T @ (energy @ found), np.eye(found.shape[1]), atol=1e-8)
    np.testing.assert_array_equal(found[:, : basis.size], basis.vectors)


def test_as_few_directions_as_represent_every_vector():
    parts = np.array([[4.0, 0.5, 0.0], [0.0, 1.0, 0.2]])
    assert [fewest(parts, error) for error in (5.0, 4.5, 1.2, 0.6, 0.2, 0.1)] == [0, 1, 2, 2, 3, 3]
    assert fewest(np.zeros((0, 0)), 1.0) == 0
