"""What a basis lacks of snapshots, and vectors that bases share."""

import dataclasses
import pickle

import numpy as np
import pytest

from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.effects.attach import hung_masses
from calib.structure.effects.extend import extend
from calib.structure.reduction.basis import _ROOM
from calib.structure.reduction.growth import Growth, Snapshots
from calib.structure.reduction.training import train_basis

N = 60


@pytest.fixture(scope="module")
def trained(ladder):
    model = ladder(N)
    return model, train_basis(model, model.space, 4, seed=1, tolerance=1e-3)


def test_principal_directions_do_not_depend_on_how_snapshots_arrive(trained):
    model, basis = trained
    growth, rng = Growth(model, basis), np.random.default_rng(4)
    columns = rng.standard_normal((N, 7)) @ rng.standard_normal((7, 90))  # more than are multiplied at a time
    error = 1e-6 * float(np.einsum("ij,ij->j", columns, growth.matrix @ columns).max())
    whole = growth.widened(basis.vectors, [columns], error)
    pieces = Snapshots(growth, basis.vectors)
    for some in np.array_split(columns, 11, axis=1):
        pieces.add(some)
    assert whole.shape[1] == basis.size + 7
    cosines = np.linalg.svd(whole.T @ growth.matrix @ pieces.represented(error), compute_uv=False)
    np.testing.assert_allclose(cosines, np.ones(whole.shape[1]), atol=1e-9)
    rest = growth.project_out(columns, whole)
    assert np.einsum("ij,ij->j", rest, growth.matrix @ rest).max() < error


def test_snapshots_that_a_basis_represents_add_nothing(trained):
    model, basis = trained
    growth = Growth(model, basis)
    assert growth.widened(basis.vectors, [2.0 * basis.vectors[:, :3]], 1e-9) is basis.vectors
    assert growth.widened(basis.vectors, [], 1e-9) is basis.vectors


def hung(name, count):
    freq = Parameter(f"{name}_freq", 1.0, 0.2, 5.0, "Hz")

    def build(model):
        return hung_masses([np.eye(N)[k] for k in range(count)], name, freq.name, 0.03)

    magnitude = Parameter(name, 0.0, 0.0, 30.0, "kg", prior_sd=3.0)
    return Effect(name, "", "", "", magnitude, build, (freq,), ({name: 3.0, freq.name: 1.0},))


@pytest.mark.parametrize("count", [1, 3, _ROOM + 2])
def test_a_carried_basis_has_a_vector_for_each_added_degree_of_freedom_and_shares_the_rest(trained, count):
    model, basis = trained
    wider = extend(model, [hung("unit", count)])
    added = wider.n_dof - N
    carried, again = (basis.carried(wider.space, wider.n_dof) for _ in range(2))
    np.testing.assert_array_equal(
        carried.vectors,
        np.block([[basis.vectors, np.zeros((N, added))], [np.zeros((added, basis.size)), np.eye(added)]]),
    )
    assert np.shares_memory(carried.vectors, again.vectors) and not carried.vectors.flags.writeable
    assert basis.carried(model.space, N).vectors is basis.vectors


@pytest.mark.parametrize("sent", [False, True])
def test_every_basis_of_the_same_vectors_has_them_in_one_array(trained, sent):
    """Also those made before the first degree of freedom was added, and of a basis that another process has read."""
    model, own = trained
    basis = pickle.loads(pickle.dumps(own)) if sent else dataclasses.replace(own)
    same = basis.carried(model.space, N)
    wider = extend(model, [hung("unit", 2)])
    carried = same.carried(wider.space, wider.n_dof)
    assert same.vectors is basis.vectors and basis.vectors.base is carried.vectors.base
    assert not basis.vectors.flags.writeable
    np.testing.assert_array_equal(basis.vectors, own.vectors)
