"""Parts that resist few motions, and damped parts of many: neither is made dense, and a basis takes few vectors."""

import tracemalloc

import numpy as np
import pytest
import scipy.sparse as sp

import calib
from calib.errors.errors import InputError
from calib.structure.affine import Monomial
from calib.structure.elongations import MOST_MOTIONS, elongations, few_motions
from calib.structure.model import Part
from calib.structure.reduction.basis import Basis
from calib.structure.reduction.growth import Growth, reference_modes


def chain(size):
    """Stiffness of masses in a row between two walls, springs of 1 N/m."""
    rows = [-np.ones(size - 1), np.full(size, 2.0), -np.ones(size - 1)]
    return sp.csr_array(sp.diags_array(rows, offsets=[-1, 0, 1]))


@pytest.mark.parametrize("size", [40, 600])  # dense, and by products with random vectors
def test_few_motions_are_the_eigenvectors_of_the_dense_matrix(size):
    rng = np.random.default_rng(1)
    columns = sp.csc_array(np.where(rng.random((size, 5)) < 0.3, rng.standard_normal((size, 5)), 0.0))
    matrix = sp.csr_array(columns @ sp.diags_array([1.0, 10.0, 1e3, 1e-3, 5.0]) @ columns.T)
    seen, sizes, motions = few_motions(matrix, 20)
    np.testing.assert_array_equal(seen, np.unique(columns.nonzero()[0]))
    np.testing.assert_allclose(motions.T @ motions, np.eye(5), atol=1e-12)
    inner = matrix[seen][:, seen].toarray()
    np.testing.assert_allclose((motions * sizes) @ motions.T, inner, atol=1e-10 * np.abs(inner).max())
    assert few_motions(matrix, 4) is None


def test_a_part_of_thirty_thousand_degrees_of_freedom_is_refused_without_a_dense_matrix():
    size = 30_000
    part = Part("wall", "stiffness", chain(size), Monomial(), (0.0, 0.0, 0.0))
    tracemalloc.start()
    with pytest.raises(InputError, match=f"part 'wall': it has more than {MOST_MOTIONS} elastic motions"):
        elongations(part)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6 < 8 * size**2


def test_a_joint_that_carries_many_points_has_its_own_motion():
    """A spring between the means of two faces: one motion over 600 degrees of freedom."""
    size = 600
    row = sp.csr_array(np.concatenate([np.ones(size // 2), -np.ones(size // 2)])[None, :] / (size // 2))
    part = Part("joint", "stiffness", sp.csr_array(7.0 * row.T @ row), Monomial(), (0.0, 0.0, 0.0))
    found = elongations(part).toarray()
    assert found.shape == (1, size)
    np.testing.assert_allclose(found[0] / np.sign(found[0, 0]), np.sqrt(7.0) * row.toarray()[0], atol=1e-12)


def strip(size, share=0.08):
    """A chain with material damping on a part of its length, and a damper to the ground."""
    pairs = sp.csr_array(sp.diags_array([np.ones(size), -np.ones(size - 1)], offsets=[0, 1]))
    damped = pairs[size // 3 : size // 3 + int(share * size)]
    point = sp.csr_array(([1.0], ([size // 2], [size // 2])), shape=(size, size))
    length = 1.0 / size
    return calib.StructuralModel.from_matrices(
        stiffness={"k": chain(size) / length},
        mass=sp.eye_array(size) * length,
        damping={"c": damped.T @ damped / length, "damper": point},
        dofs=[(node + 1, "x") for node in range(size)],
        parameters=[calib.Parameter("k", 1.0, 0.5, 2.0), calib.Parameter("c", 0.02, 0.0, 0.05),
                    calib.Parameter("damper", 0.1, 0.0, 0.5)],
    )  # fmt: skip


def statics(model):
    """Static vectors of a basis about the nominal values, orthonormal in its energy."""
    nominal = np.array(list(model.space.values.values()))
    basis = Basis(
        np.zeros((model.n_dof, 0)), model.fingerprint, model.space.names, nominal, nominal, nominal, 0.0, 6, np.inf,
        0.95, 1e-5, np.zeros((0, 3)), np.zeros((0, 4)), 1,
    )  # fmt: skip
    modes = reference_modes(model, model.space.values)
    return Growth(model, basis, modes).statics(np.zeros((model.n_dof, 0)))


def test_a_damped_strip_adds_few_vectors_however_fine_its_mesh():
    coarse, fine = statics(strip(2000)), statics(strip(6000))
    assert coarse.shape[1] == fine.shape[1] < 60
