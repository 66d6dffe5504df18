import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import InputError
from calib.structure.energy import strain_energy, strain_energy_shares

seeds = st.integers(0, 2**32 - 1)


def random_case(seed: int, n: int = 9, m: int = 3) -> tuple[sp.csc_array, np.ndarray, dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((n, n))
    shapes = rng.standard_normal((n, m)) + 1j * rng.standard_normal((n, m))
    order = rng.permutation(n)
    return sp.csc_array(half @ half.T), shapes, {"a": order[:2], "b": order[2:5], "c": order[5:]}


@given(seeds)
def test_shares_of_a_partition_add_up_to_one_whatever_scale_and_phase(seed):
    stiffness, shapes, clusters = random_case(seed)
    shares, total = strain_energy_shares(stiffness, shapes, clusters)
    assert shares.shape == (3, 3)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    np.testing.assert_allclose(total, 0.5 * np.einsum("ij,ij->j", shapes.conj(), stiffness @ shapes).real)
    rotated, _ = strain_energy_shares(stiffness, shapes * [1j, 3.0, -2 + 1j], clusters)
    np.testing.assert_allclose(rotated, shares, atol=1e-10)


@given(seeds)
def test_real_shapes_follow_the_published_blockwise_formula(seed):
    stiffness, shapes, clusters = random_case(seed)
    phi, k = shapes.real, stiffness.toarray()
    shares, _ = strain_energy_shares(stiffness, phi, clusters)
    for row, own in enumerate(clusters.values()):
        for j in range(3):
            part = sum(phi[own, j] @ k[np.ix_(own, other)] @ phi[other, j] for other in clusters.values())
            assert shares[row, j] == pytest.approx(part / (phi[:, j] @ k @ phi[:, j]), abs=1e-10)


def test_two_springs_in_series_keep_energy_in_proportion():
    # ground -k1- 1 -k2- 2; the clusters are degrees of freedom, so the second holds phi_2 k2 (phi_2 - phi_1).
    k1, k2 = 3.0, 5.0
    stiffness = sp.csc_array(np.array([[k1 + k2, -k2], [-k2, k2]]))
    shape = np.array([[1.0], [2.0]])
    shares, total = strain_energy_shares(stiffness, shape, {"second": np.array([1])})
    assert total[0] == pytest.approx(0.5 * (k1 * 1 + k2 * 1))
    assert shares[0, 0] == pytest.approx(2 * k2 / (k1 + k2))


def test_clusters_outside_the_model_are_refused():
    with pytest.raises(InputError, match=r"cluster 'far' names a degree of freedom outside 0\.\.1"):
        strain_energy_shares(sp.csc_array(np.eye(2)), np.ones((2, 1)), {"far": np.array([2])})


@given(seeds)
def test_the_total_does_not_need_clusters(seed):
    stiffness, shapes, clusters = random_case(seed)
    expected = strain_energy_shares(stiffness, shapes, clusters)[1]
    np.testing.assert_allclose(strain_energy(stiffness, shapes), expected)
    np.testing.assert_allclose(strain_energy(stiffness.toarray(), shapes), expected)
